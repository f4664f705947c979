//! Values longer than one frame: segments and blocks.

extern crate std;

use super::{
    Answer, CONTROL, Failure, HostFixture, HostOptions, HostRequest, ObjectIndex, RequestClass,
    STATUS, T_MS, Ticket, read, write,
};
use crate::proto::canopen::sdo;
use crate::station::{HostData, Timed as _};

#[test]
fn longer_values_come_in_segments() {
    let mut b = HostFixture::new();
    let name = ObjectIndex::new(0x1008, 0);
    b.submit(1, read(2, name));
    b.sent_frames();
    b.receive("582#4108100008000000");
    assert_eq!(b.sent_frames(), ["602#6000000000000000"]);
    b.receive("582#0054532073657276");
    assert_eq!(b.sent_frames(), ["602#7000000000000000"]);
    // A copy of the segment before is passed over.
    b.receive("582#0054532073657276");
    assert_eq!((b.sent_frames().len(), b.events().len()), (0, 0));
    b.receive("582#1D6F000000000000");
    let bits = u64::from_le_bytes(*b"TS servo");
    assert_eq!(b.one(), Ok(Answer::Value { object: name, bits, len: 8 }));
}

#[test]
fn the_first_eight_bytes_of_a_string_are_enough() {
    let mut b = HostFixture::new();
    let name = ObjectIndex::new(0x1008, 0);
    b.submit(1, read(2, name));
    b.sent_frames();
    b.receive("582#4108100027000000");
    b.sent_frames();
    b.receive("582#0054532073657276");
    b.sent_frames();
    b.receive("582#106F206472697665");
    let bits = u64::from_le_bytes(*b"TS servo");
    assert_eq!(b.one(), Ok(Answer::Value { object: name, bits, len: 39 }));
    assert_eq!(b.sent_frames(), ["602#8008100005000405"], "the rest is let go");
}

#[test]
fn a_wrong_toggle_ends_a_transfer() {
    let mut b = HostFixture::new();
    b.submit(1, read(2, ObjectIndex::new(0x1008, 0)));
    b.sent_frames();
    b.receive("582#4108100008000000");
    b.sent_frames();
    b.receive("582#1054532073657276");
    assert_eq!(b.events(), []);
    b.receive("582#1054532073657276");
    assert_eq!(b.one(), Err(Failure::Misbehaved));
    assert_eq!(b.sent_frames(), ["602#8008100000000305"]);
}

#[test]
fn a_node_lost_in_the_middle_is_reported_so() {
    let mut b = HostFixture::new();
    b.submit(1, read(2, ObjectIndex::new(0x1008, 0)));
    b.sent_frames();
    b.receive("582#4108100027000000");
    b.sent_frames();
    b.wait(T_MS);
    assert_eq!(b.one(), Err(Failure::Silent));
    assert_eq!(b.sent_frames(), ["602#8008100000000405"]);
    // A segment that comes now belongs to nothing.
    b.receive("582#0054532073657276");
    b.submit(2, read(2, STATUS));
    b.sent_frames();
    b.receive("582#0054532073657276");
    assert_eq!(b.events(), []);
    b.receive("582#4B41600037000000");
    assert!(b.one().is_ok());
}

#[test]
fn eight_bytes_are_written_in_two_segments() {
    let mut b = HostFixture::new();
    let object = ObjectIndex::new(0x2100, 1);
    b.submit(1, write(object, u64::from_le_bytes(*b"polepair"), 8, RequestClass::ReadBack));
    assert_eq!(b.sent_frames(), ["602#2100210108000000"]);
    b.receive("582#6000210100000000");
    assert_eq!(b.sent_frames(), ["602#00706F6C65706169"]);
    b.receive("582#2000000000000000");
    assert_eq!(b.sent_frames(), ["602#1D72000000000000"]);
    b.receive("582#3000000000000000");
    assert!(matches!(b.one(), Ok(Answer::Written { .. })));
}

#[test]
fn an_upload_in_segments_waits_for_whoever_takes_it() {
    let mut b = HostFixture::new();
    b.submit(
        1,
        HostRequest::Upload { node: 2, object: ObjectIndex::new(0x1F50, 1), block: false, max: 0 },
    );
    b.sent_frames();
    b.receive("582#41501F01DC050000");
    let (mut toggle, mut requested) = (0u8, 0);
    while !b.sent_frames().is_empty() {
        b.receive(&std::format!("582#{toggle:02X}41424344454647"));
        toggle ^= 0x10;
        requested += 1;
    }
    assert_eq!(requested, 127, "as much as it holds");
    let mut out = [0; 1000];
    assert_eq!(b.host.poll_bytes(Ticket(1), &mut out), Some(889));
    assert_eq!(&out[..9], b"ABCDEFGAB");
    assert_eq!(b.sent_frames().len(), 1);
    b.receive(&std::format!("582#{:02X}41424300000000", toggle | 9));
    assert_eq!(b.events(), [], "not before the rest is taken");
    assert_eq!(b.host.poll_bytes(Ticket(1), &mut out), Some(3));
    assert_eq!(b.one(), Ok(Answer::Transferred(892)));
    assert_eq!(b.host.poll_bytes(Ticket(1), &mut out), None);
}

#[test]
fn blocks_are_read_and_what_was_lost_is_asked_again() {
    let mut b = HostFixture::new();
    b.submit(
        1,
        HostRequest::Upload { node: 2, object: ObjectIndex::new(0x1008, 0), block: true, max: 0 },
    );
    assert_eq!(b.sent_frames(), ["602#A40810007F000000"]);
    b.receive("582#C608100011000000");
    assert_eq!(b.sent_frames(), ["602#A300000000000000"]);
    b.receive("582#0154696E79204E6F");
    // The second one is lost; the last one alone does not count.
    b.receive("582#8321210000000000");
    assert_eq!(b.sent_frames(), ["602#A2017E0000000000"]);
    b.receive("582#016465202D204D65");
    b.receive("582#8267617300000000");
    assert_eq!(b.sent_frames(), ["602#A2027C0000000000"]);
    let text = b"Tiny Node - Megas";
    let crc = sdo::crc(0, text);
    b.receive(&std::format!("582#D1{:02X}{:02X}0000000000", crc & 0xFF, crc >> 8));
    assert_eq!(b.sent_frames(), ["602#A100000000000000"]);
    let mut out = [0; 64];
    assert_eq!(b.host.poll_bytes(Ticket(1), &mut out), Some(17));
    assert_eq!(&out[..17], text);
    assert_eq!(b.one(), Ok(Answer::Transferred(17)));
}

#[test]
fn a_wrong_check_over_blocks_is_reported() {
    let mut b = HostFixture::new();
    b.submit(
        1,
        HostRequest::Upload { node: 2, object: ObjectIndex::new(0x1008, 0), block: true, max: 0 },
    );
    b.sent_frames();
    b.receive("582#C608100003000000");
    b.sent_frames();
    b.receive("582#8141424300000000");
    b.sent_frames();
    b.receive("582#D100000000000000");
    assert_eq!(b.one(), Err(Failure::Misbehaved));
    assert_eq!(b.sent_frames(), ["602#8008100004000405"]);
}

#[test]
fn blocks_are_written_and_what_was_lost_goes_again() {
    let mut b = HostFixture::new();
    let object = ObjectIndex::new(0x1F50, 1);
    b.submit(1, HostRequest::Download { node: 2, object, block: true, size: 17 });
    assert_eq!(b.sent_frames(), ["602#C6501F0111000000"]);
    b.receive("582#A4501F0102000000");
    assert_eq!(b.sent_frames(), [""; 0], "nobody gave a byte yet");
    let text = b"Tiny Node - Megas";
    assert_eq!(b.host.feed_bytes(Ticket(1), text), Some(17));
    assert_eq!(b.sent_frames(), ["602#0154696E79204E6F", "602#026465202D204D65"]);
    b.receive("582#A201050000000000");
    assert_eq!(b.sent_frames(), ["602#016465202D204D65", "602#8267617300000000"]);
    b.receive("582#A202050000000000");
    let crc = sdo::crc(0, text);
    assert_eq!(
        b.sent_frames(),
        [std::format!("602#D1{:02X}{:02X}0000000000", crc & 0xFF, crc >> 8)]
    );
    b.receive("582#A100000000000000");
    assert_eq!(b.one(), Ok(Answer::Transferred(17)));
}

/// A block of 127 segments that begins.
pub(super) fn block() -> HostFixture {
    let mut b = HostFixture::with(HostOptions { bit_rate: 1_000_000, ..HostOptions::new(0) });
    b.submit(
        1,
        HostRequest::Download {
            node: 2,
            object: ObjectIndex::new(0x1F50, 1),
            block: true,
            size: 889,
        },
    );
    b.sent_frames();
    b.receive("582#A4501F017F000000");
    assert_eq!(b.host.feed_bytes(Ticket(1), &[0x55; 889]), Some(889));
    b
}

#[test]
fn a_block_goes_no_faster_than_the_wire_and_behind_all_else() {
    let mut b = block();
    let mut sent = b.sent_frames().len();
    assert_eq!(sent, 8, "a few ahead");
    b.submit(2, read(3, STATUS));
    assert_eq!(b.sent_frames(), ["603#4041600000000000"]);
    b.submit(3, read(4, STATUS));
    while sent < 127 {
        b.now = b.host.poll_timeout().unwrap();
        b.host.handle_timeout(b.now);
        let lines = b.sent_frames();
        let first = usize::from(lines[0].starts_with("604"));
        assert_eq!(lines.len() - first, 4.min(127 - sent), "half of them at once");
        assert_eq!(first == 1, sent == 8, "what was asked goes first");
        sent += lines.len() - first;
    }
    // 111 us for each, and not a moment more than the wire takes.
    assert!((118 * 111..127 * 111).contains(&(b.now.0 / 1000)), "{:?}", b.now);
    b.receive("582#A27F7F0000000000");
    assert!(b.sent_frames()[0].starts_with("602#C1"));
}

#[test]
fn a_stop_of_a_node_ends_the_block_that_is_sent_to_it() {
    let mut b = block();
    b.sent_frames();
    b.submit(2, write(CONTROL, 0, 2, RequestClass::Stop));
    assert_eq!(b.sent_frames(), ["602#80501F0100000405", "602#2B40600000000000"]);
    assert_eq!(b.one(), Err(Failure::Silent), "perhaps written");
    b.wait(1);
    b.receive("582#6040600000000000");
    assert!(b.one().is_ok());
}

#[test]
fn a_download_waits_for_bytes() {
    let mut b = HostFixture::new();
    b.submit(
        1,
        HostRequest::Download {
            node: 2,
            object: ObjectIndex::new(0x1F50, 1),
            block: false,
            size: 10,
        },
    );
    b.sent_frames();
    b.receive("582#60501F0100000000");
    assert_eq!(b.sent_frames(), [""; 0]);
    assert_eq!(b.host.feed_bytes(Ticket(1), b"012345"), Some(6));
    assert_eq!(b.sent_frames(), [""; 0], "less than a segment");
    assert_eq!(b.host.feed_bytes(Ticket(1), b"6789abc"), Some(4), "no more than it said");
    assert_eq!(b.sent_frames(), ["602#0030313233343536"]);
    b.receive("582#2000000000000000");
    assert_eq!(b.sent_frames(), ["602#1937383900000000"]);
    b.receive("582#3000000000000000");
    assert_eq!(b.one(), Ok(Answer::Transferred(10)));
}

#[test]
fn a_node_without_blocks_answers_in_segments() {
    let mut b = HostFixture::new();
    let object = ObjectIndex::new(0x1F50, 1);
    b.submit(1, HostRequest::Upload { node: 2, object, block: true, max: 0 });
    assert_eq!(b.sent_frames(), ["602#A4501F017F000000"]);
    b.receive("582#41501F0109000000");
    assert_eq!(b.sent_frames(), ["602#6000000000000000"]);
    b.receive("582#0030313233343536");
    assert_eq!(b.sent_frames(), ["602#7000000000000000"]);
    b.receive("582#1B37380000000000");
    let mut bytes = [0; 16];
    assert_eq!(b.host.poll_bytes(Ticket(1), &mut bytes), Some(9));
    assert_eq!(&bytes[..9], b"012345678");
    assert_eq!(b.one(), Ok(Answer::Transferred(9)));
}

#[test]
fn a_node_without_blocks_refuses_with_the_object_of_another_request() {
    let mut b = HostFixture::new();
    let object = ObjectIndex::new(0x1F50, 1);
    b.submit(1, HostRequest::Download { node: 2, object, block: true, size: 10 });
    b.sent_frames();
    b.receive("582#8000100001000405");
    assert_eq!(b.one(), Err(Failure::Refused { code: 0x0504_0001 }));
    // Any other refusal of another object is not its own.
    b.submit(2, HostRequest::Download { node: 2, object, block: true, size: 10 });
    b.sent_frames();
    b.receive("582#8000100000000206");
    assert!(b.events().is_empty());
}
