//! Faults, lost links, and what survives power-off.

use super::*;

fn emergency(desk: &DriveFixture) -> Option<Vec<u8>> {
    desk.received.iter().find(|frame| frame.id == 0x082).map(|frame| frame.bytes().to_vec())
}

#[test]
fn a_fault_is_told_shown_and_reset() {
    let faults: [(Act, Act, u16, u8); 5] = [
        (Act::Supply(80.0), Act::Supply(48.0), 0x3210, 0x05),
        (Act::Supply(10.0), Act::Supply(48.0), 0x3220, 0x05),
        (Act::Ambient(120.0), Act::Ambient(25.0), 0x4310, 0x09),
        (Act::EncoderBroken(true), Act::EncoderBroken(false), 0x7305, 0x81),
        (Act::HallBroken(true), Act::HallBroken(false), 0x7122, 0x81),
    ];
    for (breaks, mends, code, register) in faults {
        let mut desk = DriveFixture::enabled(3);
        desk.received.clear();
        desk.act(breaks);
        let mut ms = 0;
        while emergency(&desk).is_none() && ms < 600_000 {
            desk.advance(10);
            ms += 10;
        }
        let [low, high] = code.to_le_bytes();
        assert_eq!(emergency(&desk).unwrap(), [low, high, register, 0, 0, 0, 0, 0]);
        desk.advance(100);
        assert_eq!(desk.status() & 0x6F, 0x08, "{code:04X}");
        assert_eq!((desk.read(0x603F, 0), desk.truth().enabled), (code.into(), false));
        desk.control(0x80);
        desk.advance(2);
        assert_eq!(desk.status() & 0x6F, 0x08, "{code:04X}: the cause lasts");
        desk.act(mends);
        desk.advance(600_000 * u32::from(code == 0x4310));
        desk.received.clear();
        desk.control(0);
        desk.control(0x80);
        assert_eq!(desk.status() & 0x6F, 0x40, "{code:04X}");
        desk.advance(1);
        assert_eq!(desk.read(0x603F, 0), 0);
    }
}

#[test]
fn a_motor_that_cannot_follow_is_a_fault_and_one_that_may_is_none() {
    let mut desk = DriveFixture::enabled(1);
    desk.act(Act::Jam(true));
    desk.hand_over_point(100_000, 0);
    desk.wait_for_bit(3, 2000);
    assert_eq!(desk.read(0x603F, 0), 0x8611);
    let mut desk = DriveFixture::enabled(1);
    desk.write(0x6065, 0, 0xFFFF_FFFF);
    desk.act(Act::Jam(true));
    desk.hand_over_point(100_000, 0);
    desk.advance(500);
    assert_eq!(desk.status() & 8, 0, "any following error is allowed");
    desk.advance(2000);
    assert_eq!(desk.read(0x603F, 0), 0x7121, "but not a blocked motor");
}

#[test]
fn a_fault_brakes_as_605e_says() {
    for (option, ms) in [(0, 0), (1, 100), (2, 20)] {
        let mut desk = DriveFixture::enabled(3);
        desk.write(0x605E, 0, option);
        desk.write(0x60FF, 0, 100_000);
        desk.advance(200);
        desk.act(Act::Fault(0x1000));
        let reacts = if ms > 0 { 0x0F } else { 0x08 };
        assert_eq!(desk.status() & 0x6F, reacts, "{option}");
        desk.advance(ms + 60);
        assert_eq!(desk.status() & 0x6F, 0x08, "{option}");
        assert_eq!(desk.turns() > 5.0, option == 0, "{option}: {}", desk.turns());
    }
}

#[test]
fn a_lost_master_stops_the_motor() {
    // 6007h: nothing, a fault, power off, quick stop.
    for (option, state) in [(0, 0x27), (1, 0x08), (2, 0x40), (3, 0x40)] {
        let mut desk = DriveFixture::enabled(3);
        desk.write(0x6007, 0, option);
        desk.write(0x1016, 1, 0x7F_0064);
        desk.write(0x60FF, 0, 50_000);
        for _ in 0..5 {
            desk.send(Frame::standard(0x77F, &[5]));
            desk.advance(90);
        }
        assert!((desk.turns() - 5.0).abs() < 0.1, "{option}");
        desk.received.clear();
        desk.advance(200);
        assert!(emergency(&desk).is_some_and(|data| data[..2] == [0x30, 0x81]), "{option}");
        assert_eq!(desk.status() & 0x6F, state, "{option}");
        assert_eq!(desk.turns() > 4.0, option == 0, "{option}");
    }
}

#[test]
fn settings_survive_power_off_when_they_were_stored() {
    let bits = u32::from_le_bytes(*b"save");
    let save =
        SdoRequest::Write(ObjectIndex::new(0x1010, 1), ExpeditedData { bits, len: 4 }).emit(2);
    let mut desk = DriveFixture::enabled(1);
    desk.write(0x6081, 0, 1234);
    desk.write(0x607A, 0, 77);
    desk.send(save);
    desk.act(Act::PowerCycle);
    assert_eq!(desk.read(0x6081, 0), 100_000, "power went while it stored");
    desk.write(0x6081, 0, 1234);
    desk.write(0x607A, 0, 77);
    desk.send(save);
    desk.advance(50);
    desk.act(Act::PowerCycle);
    assert_eq!((desk.read(0x6081, 0), desk.read(0x607A, 0)), (1234, 0), "a command is no setting");
    assert_eq!(desk.status() & 0x6F, 0x40);
    desk.write(0x1011, 1, i64::from(u32::from_le_bytes(*b"load")));
    desk.send(Frame::standard(0, &[129, 2]));
    assert_eq!(desk.read(0x6081, 0), 100_000);
}
