//! The printed frames, lengths, settings, the forms of VM, what is sent by itself.

extern crate std;

use super::{DriveFixture, hex, profile};
use crate::surroundings::Act;
use crate::{DeviceOptions, Family};
use polepair_core::medium::Frame;
use std::vec::Vec;

fn data(frames: &[Frame]) -> Vec<&[u8]> {
    frames.iter().map(Frame::bytes).collect()
}

#[test]
fn the_printed_frames_are_answered_as_printed() {
    let mut rig = DriveFixture::thruster();
    rig.ok("54 43 00 00 00 00 00 00");
    for frame in [
        "54 43 00 00 00 00 00 05",
        "54 43 00 00 00 00 FF FB",
        "43 49 00 00 00 00 00 7F",
        "43 42 00 00 00 00 03 E8",
        "53 54 00 00 00 00 13 88",
        "56 43 00 00 00 00 01 F4",
        "56 4D 00 00 00 00 00 00",
        "4C 53 00 00 00 00 00 00",
    ] {
        rig.ok(frame);
    }
    for query in ["51 56 00 00", "51 43 00 00", "51 50 00 00", "46 52 00 00", "43 46 00 00"] {
        let padded = std::format!("{query} 00 00 00 00");
        assert_eq!(rig.request(query), rig.request(&padded), "{query}");
    }
    assert_eq!(rig.value("QP"), 480);
}

#[test]
fn an_unknown_instruction_is_refused_and_not_ignored() {
    let mut rig = DriveFixture::thruster();
    rig.refused("58 58 00 00");
    rig.refused("54 43 00 00");
    rig.refused("53 50 12 34 00 00 00 01");
    rig.refused("52 50 12 34");
    for length in [0, 1, 3, 5, 7] {
        assert!(rig.to(11, &hex("51 50 00 00 00 00 00 00")[..length]).is_empty(), "{length}");
    }
    assert!(rig.to(12, &hex("51 50 00 00")).is_empty());
    assert!(rig.to(0, &hex("51 50 00 00")).is_empty(), "there is no broadcast");
}

#[test]
fn values_out_of_range_are_refused() {
    let mut rig = DriveFixture::thruster();
    rig.ok("54 43 00 00 00 00 00 00");
    for frame in [
        "54 43 00 00 00 00 00 65",
        "54 43 00 00 00 00 FF 9B",
        "56 43 00 00 00 00 00 1D",
        "43 49 00 00 00 00 00 00",
        "43 49 00 00 00 00 00 80",
        "43 42 00 00 00 00 01 F5",
        "53 54 00 00 00 00 00 63",
        "53 54 00 00 00 00 EA 61",
        "56 4D 00 00 00 01 00 00",
    ] {
        rig.refused(frame);
    }
    rig.ok("54 43 00 00 FF FF FF 9C");
    rig.ok("56 43 00 00 00 00 00 1E");
    rig.ok("53 54 00 00 00 00 EA 60");
    rig.ok("53 54 00 00 00 00 00 00");
}

#[test]
fn id_and_bit_rate_hold_from_the_next_start_on() {
    let mut rig = DriveFixture::thruster();
    rig.ok("43 49 00 00 00 00 00 7F");
    rig.ok("43 42 00 00 00 00 00 53");
    rig.ok("51 50 00 00");
    rig.act(Act::PowerCycle);
    assert!(rig.to(11, &hex("51 50 00 00")).is_empty());
    let answers = rig.to(127, &hex("51 50 00 00"));
    assert_eq!(answers[0].id, 0x2FF);
    let line = polepair_core::station::Station::<polepair_core::medium::Can>::line(&rig.device);
    assert_eq!(line.bit_rate, 83_333);
}

#[test]
fn the_traces_of_vm() {
    let mut rig = DriveFixture::thruster();
    rig.ok("54 43 00 00 00 00 00 00");
    rig.ok("56 43 00 00 00 00 01 F4");
    rig.wait(3000);
    rig.ok("56 4D 00 00 00 00 01 00");
    let vc = hex("56 43 00 00 00 00 01 F4");
    let bare = rig.to(11, &vc);
    let [a, b, c, d, e, f, 0, 0] = *bare[0].bytes() else { panic!("{bare:?}") };
    let word = |a, b| i16::from_be_bytes([a, b]);
    assert!((498..=502).contains(&word(a, b)), "{bare:?}");
    assert_eq!(word(c, d), 480);
    assert!((2..=6).contains(&word(e, f)), "tenths of an ampere in water: {bare:?}");
    rig.ok("56 4D 00 00 00 00 00 03");
    let both = rig.to(11, &vc);
    let heads: Vec<_> = data(&both).iter().map(|data| data[..2].to_vec()).collect();
    assert_eq!(heads, [[0x56, 1], [0x56, 2]]);
    assert_eq!(both[1].bytes()[2..], [0, 0, 0, 16, 0, 16], "{both:?}");
    rig.ok("56 4D 00 00 00 00 02 00");
    assert!(rig.to(11, &vc).is_empty());
    assert!(rig.to(11, &hex("54 43 00 00 00 00 00 65")).is_empty(), "nor a refusal");
    assert!((498..=502).contains(&rig.value("QV")), "queries are answered");
    rig.ok("56 4D 00 00 00 00 00 00");
    rig.ok("56 43 00 00 00 00 01 F4");
    rig.ok("56 4D 00 00 00 00 00 04");
    rig.act(Act::PowerCycle);
    rig.ok("56 43 00 00 00 00 00 00");
}

#[test]
fn the_other_readings_can_be_chosen() {
    let extra =
        [("vm-flags", "table"), ("refusal", "zero"), ("vm-reply", "swapped"), ("values", "32")];
    let mut rig = DriveFixture::with(&profile::THRUSTER, &extra);
    assert_eq!(rig.request("54 43 00 00 00 00 00 05")[4..], [0; 4], "refused by zero");
    rig.ok("54 43 00 00 00 00 00 00");
    rig.ok("54 43 00 00 00 00 FF FB");
    rig.wait(1000);
    assert_eq!(rig.request("51 56 00 00")[4..6], [0xFF, 0xFF], "32 bits");
    assert_eq!(rig.request("56 4D 00 00 00 00 01 00")[6..], [0, 1], "swapped");
    assert!(rig.to(11, &hex("54 43 00 00 00 00 00 05")).is_empty(), "bit 0 is silent");
    let mut rig =
        DriveFixture::with(&profile::THRUSTER, &[("slow-speed", "runs"), ("zero-point", "off")]);
    rig.ok("56 43 00 00 00 00 00 05");
    rig.wait(2000);
    assert_eq!(rig.value("QV"), 30);
    let wrong = [("vm-flags", "both")];
    let options = DeviceOptions {
        address: None,
        wires: &["thruster"],
        standard: None,
        untimed: true,
        seed: 1,
        extra: &wrong,
    };
    assert_eq!(
        super::ThrusterFamily::create_device(&profile::THRUSTER, &options).err(),
        Some("both")
    );
}

#[test]
fn what_is_sent_by_itself() {
    let mut rig = DriveFixture::thruster();
    rig.ok("4D 4D 00 00");
    let received = rig.wait(1000);
    assert_eq!(received.len(), 20, "two every 100 ms");
    assert_eq!(data(&received)[0][..4], hex("51 43 00 00"));
    assert_eq!(data(&received)[1][..4], hex("51 56 00 00"));
    rig.ok("4D 4C 00 00");
    assert_eq!(rig.wait(2000).len(), 4, "two every second");
    rig.ok("4D 51 00 00");
    assert!(rig.wait(3000).is_empty());

    rig.act(Act::PowerCycle);
    rig.ok("53 52 00 00 00 03 00 C8");
    let received = rig.wait(1000);
    assert_eq!(received.len(), 10, "two every 200 ms");
    assert_eq!(
        (data(&received)[0][..2].to_vec(), data(&received)[1][..2].to_vec()),
        (hex("41 01"), hex("41 02"))
    );
    rig.ok("4D 51 00 00");
    assert!(rig.wait(1000).is_empty(), "paused");
    rig.ok("53 52 00 00 00 03 00 C8");
    assert_eq!(rig.wait(1000).len(), 10, "set again, it holds at once");
    rig.ok("4D 51 00 00");
    assert!(rig.wait(1000).is_empty(), "paused");
    rig.act(Act::PowerCycle);
    assert_eq!(rig.wait(1000).len(), 10, "kept");
    rig.ok("53 52 00 00 00 00 00 C8");
    assert!(rig.wait(1000).is_empty());
    rig.ok("53 52 00 00 00 01 00 01");
    let received = rig.wait(1000);
    assert_eq!(received.len(), 100, "10 ms at least");
}
