//! Two drives with one axis ID on one line: their acknowledgements and answers collide.

use super::Bench;
use polepair_core::axis::Verb;
use polepair_core::error::{Failure, Outcome};
use polepair_core::proto::HostOptions;

#[test]
fn two_drives_with_one_id_on_rs485_are_not_believed_and_not_moved() {
    let mut bench = Bench::rs485(HostOptions::new(9600), &[5], &[5, 5]);
    for _ in 0..8 {
        assert_eq!(bench.read(0, "KPP"), Outcome::NotDone(Failure::Silent));
    }
    assert_eq!(bench.write(0, "KPP", 300), Outcome::Unknown(Failure::Silent));
    assert_eq!(bench.verb(0, Verb::Enable), Outcome::NotDone(Failure::Silent));
    let counters = bench.counters();
    assert_eq!(counters.answered, 0);
    assert!(counters.corrupt > 0, "somebody is there: {counters:?}");
    for drive in 0..2 {
        assert_eq!((bench.truth(drive).starts, bench.truth(drive).enabled), (0, false));
    }
}
