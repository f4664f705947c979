use super::{BusAddress, BusLoadRange, find_clash};
use crate::registry::find_protocol;
use polepair_core::medium::MediumKind;

fn seats(all: &[(&str, u32)]) -> Vec<BusAddress> {
    let entry = |(name, address): &(&str, u32)| BusAddress {
        protocol: find_protocol(name, MediumKind::Can).expect("a protocol on CAN"),
        address: *address,
    };
    all.iter().map(entry).collect()
}

#[test]
fn drives_that_agree_share_a_bus() {
    let all = [("canopen", 2), ("technocan", 5), ("technocan", 7), ("tmcl", 0x61), ("tmlcan", 5)];
    assert_eq!(
        find_clash(&seats(&[&all[..], &[("thruster", 11), ("thruster", 12)]].concat())),
        None
    );
}

#[test]
fn clashes_are_reported_with_the_identifier() {
    for (all, text) in [
        ([("canopen", 11), ("thruster", 11)], "both use the identifier 28Bh"),
        ([("technocan", 5), ("tmcl", 1)], "both use the identifier 1h"),
        ([("canopen", 2), ("canopen", 2)], "canopen 2 is used twice"),
        ([("canopen", 2), ("technocan", 32)], "multiple of 32"),
        ([("canopen", 2), ("tmcl", 0x82)], "both use the identifier 82h"),
    ] {
        let output = find_clash(&seats(&all)).unwrap_or_else(|| panic!("{all:?}"));
        assert!(output.contains(text), "{all:?}: {output}");
    }
}

#[test]
fn a_host_gives_way_to_other_protocols() {
    let tmcl = find_protocol("tmcl", MediumKind::Can).expect("known");
    assert_eq!(tmcl.host_among(&[0x61], &seats(&[("canopen", 2)])), None);
    let host = tmcl.host_among(&[0x61], &seats(&[("technocan", 5)])).expect("another");
    assert!(find_clash(&seats(&[("technocan", 5), ("tmcl", host), ("tmcl", 0x61)])).is_none());
}

/// The mixed bus at 1 Mbit/s, by hand: SYNC and four PDOs of 4 bytes 1000 times a second are 363 to
/// 435 bits each, and five exchanges of two full frames at 100 Hz.
#[test]
fn a_load_is_the_sum_of_its_frames() {
    let mut load = BusLoadRange::default();
    load.add(1_000_000, false, 1000.0, &[0, 4, 4, 4, 4]);
    assert!((load.least - 0.363).abs() < 1e-9, "{load}");
    for _ in 0..5 {
        load.add(1_000_000, false, 100.0, &[]);
    }
    assert!((load.least - 0.474).abs() < 1e-9, "{load}");
    assert!(load.most < 0.8 && load.overload_reason().is_none());
    load.add(1_000_000, false, 1500.0, &[]);
    assert!(load.overload_reason().expect("too much").contains("at most 80 %"));
}
