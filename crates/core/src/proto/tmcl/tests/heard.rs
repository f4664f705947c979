//! Counters of a query that gets no reply.

extern crate std;

use std::boxed::Box;
use std::vec::Vec;

use super::pair::TestWire;
use crate::error::Failure;
use crate::proto::HostOptions;
use crate::proto::tmcl::SerialHost;
use crate::proto::tmcl::device::Quirks;
use crate::station::Host;

#[test]
fn a_spoiled_reply_is_one_frame_with_a_wrong_check() {
    for baud in [9600, 115_200] {
        // With 0, and with the value of the byte that goes out alone, in it.
        for flip in [0x55, 0xAA] {
            let mut wire = TestWire::new(baud, Quirks::default());
            let spoiled = move |r: &[u8]| r.iter().map(|byte| byte ^ flip).collect::<Vec<_>>();
            wire.replies = Box::new(move |_, r| {
                Some(Vec::from([(0, [&r[..1], &spoiled(&r[1..])[..]].concat())]))
            });
            assert_eq!(wire.read(1), Err(Failure::Silent));
            let counted = wire.host.counters();
            assert_eq!((counted.corrupt, counted.skipped), (2, 0), "{counted:?}");
            assert_eq!((counted.echoed, counted.foreign), (0, 0), "{counted:?}");
        }
    }
}

#[test]
fn a_request_that_the_module_calls_spoiled_is_counted() {
    let mut wire = TestWire::new(9600, Quirks::default());
    wire.requests = Box::new(|_, r| {
        let mut spoiled = r.to_vec();
        *spoiled.last_mut()? ^= 0xFF;
        Some(Vec::from([(0, spoiled)]))
    });
    assert_eq!(wire.read(1), Err(Failure::Refused { code: 1 }));
    let counted = wire.host.counters();
    assert!(counted.corrupt > 0 && counted.foreign == 0, "{counted:?}");
}

#[test]
fn a_late_reply_belongs_to_no_other_request() {
    let mut wire = TestWire::new(9600, Quirks::default());
    wire.host = SerialHost::new(&HostOptions { probe_seed: Some(7), ..HostOptions::new(9600) });
    wire.replies = Box::new(|_, r| Some(Vec::from([(250, r.to_vec())])));
    assert_eq!(wire.read(1), Err(Failure::Silent));
    let counted = wire.host.counters();
    assert!(counted.late > 0 && counted.foreign == 0, "{counted:?}");
}
