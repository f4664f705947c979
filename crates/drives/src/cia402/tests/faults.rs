//! Faults, lost links, and what survives power-off.

use super::*;

fn emergency(fixture: &DriveFixture) -> Option<Vec<u8>> {
    fixture.received.iter().find(|frame| frame.id == 0x082).map(|frame| frame.bytes().to_vec())
}

#[test]
fn a_fault_is_reported_shown_and_reset() {
    let faults: [(Act, Act, u16, u8); 5] = [
        (Act::Supply(80.0), Act::Supply(48.0), 0x3210, 0x05),
        (Act::Supply(10.0), Act::Supply(48.0), 0x3220, 0x05),
        (Act::Ambient(120.0), Act::Ambient(25.0), 0x4310, 0x09),
        (Act::EncoderBroken(true), Act::EncoderBroken(false), 0x7305, 0x81),
        (Act::HallBroken(true), Act::HallBroken(false), 0x7122, 0x81),
    ];
    for (breaks, mends, code, register) in faults {
        let mut fixture = DriveFixture::enabled(3);
        fixture.received.clear();
        fixture.act(breaks);
        let mut ms = 0;
        while emergency(&fixture).is_none() && ms < 600_000 {
            fixture.advance(10);
            ms += 10;
        }
        let [low, high] = code.to_le_bytes();
        assert_eq!(emergency(&fixture).unwrap(), [low, high, register, 0, 0, 0, 0, 0]);
        fixture.advance(100);
        assert_eq!(fixture.status() & 0x6F, 0x08, "{code:04X}");
        assert_eq!((fixture.read(0x603F, 0), fixture.truth().enabled), (code.into(), false));
        fixture.control(0x80);
        fixture.advance(2);
        assert_eq!(fixture.status() & 0x6F, 0x08, "{code:04X}: the cause lasts");
        fixture.act(mends);
        fixture.advance(600_000 * u32::from(code == 0x4310));
        fixture.received.clear();
        fixture.control(0);
        fixture.control(0x80);
        assert_eq!(fixture.status() & 0x6F, 0x40, "{code:04X}");
        fixture.advance(1);
        assert_eq!(fixture.read(0x603F, 0), 0);
    }
}

#[test]
fn a_motor_that_cannot_follow_is_a_fault_and_one_that_may_is_none() {
    let mut fixture = DriveFixture::enabled(1);
    fixture.act(Act::Jam(true));
    fixture.hand_over_point(100_000, 0);
    fixture.wait_for_bit(3, 2000);
    assert_eq!(fixture.read(0x603F, 0), 0x8611);
    let mut fixture = DriveFixture::enabled(1);
    fixture.write(0x6065, 0, 0xFFFF_FFFF);
    fixture.act(Act::Jam(true));
    fixture.hand_over_point(100_000, 0);
    fixture.advance(500);
    assert_eq!(fixture.status() & 8, 0, "any following error is allowed");
    fixture.advance(2000);
    assert_eq!(fixture.read(0x603F, 0), 0x7121, "but not a blocked motor");
}

#[test]
fn a_fault_brakes_as_605e_says() {
    for (option, ms) in [(0, 0), (1, 100), (2, 20)] {
        let mut fixture = DriveFixture::enabled(3);
        fixture.write(0x605E, 0, option);
        fixture.write(0x60FF, 0, 100_000);
        fixture.advance(200);
        fixture.act(Act::Fault(0x1000));
        let reacts = if ms > 0 { 0x0F } else { 0x08 };
        assert_eq!(fixture.status() & 0x6F, reacts, "{option}");
        fixture.advance(ms + 60);
        assert_eq!(fixture.status() & 0x6F, 0x08, "{option}");
        assert_eq!(fixture.turns() > 5.0, option == 0, "{option}: {}", fixture.turns());
    }
}

#[test]
fn a_lost_master_stops_the_motor() {
    // 6007h: nothing, a fault, power off, quick stop.
    for (option, state) in [(0, 0x27), (1, 0x08), (2, 0x40), (3, 0x40)] {
        let mut fixture = DriveFixture::enabled(3);
        fixture.write(0x6007, 0, option);
        fixture.write(0x1016, 1, 0x7F_0064);
        fixture.write(0x60FF, 0, 50_000);
        for _ in 0..5 {
            fixture.send(Frame::standard(0x77F, &[5]));
            fixture.advance(90);
        }
        assert!((fixture.turns() - 5.0).abs() < 0.1, "{option}");
        fixture.received.clear();
        fixture.advance(200);
        assert!(emergency(&fixture).is_some_and(|data| data[..2] == [0x30, 0x81]), "{option}");
        assert_eq!(fixture.status() & 0x6F, state, "{option}");
        assert_eq!(fixture.turns() > 4.0, option == 0, "{option}");
    }
}

#[test]
fn settings_survive_power_off_when_they_were_stored() {
    let bits = u32::from_le_bytes(*b"save");
    let save =
        SdoRequest::Write(ObjectIndex::new(0x1010, 1), ExpeditedData { bits, len: 4 }).emit(2);
    let mut fixture = DriveFixture::enabled(1);
    fixture.write(0x6081, 0, 1234);
    fixture.write(0x607A, 0, 77);
    fixture.send(save);
    fixture.act(Act::PowerCycle);
    assert_eq!(fixture.read(0x6081, 0), 100_000, "power went while it stored");
    fixture.write(0x6081, 0, 1234);
    fixture.write(0x607A, 0, 77);
    fixture.send(save);
    fixture.advance(50);
    fixture.act(Act::PowerCycle);
    assert_eq!(
        (fixture.read(0x6081, 0), fixture.read(0x607A, 0)),
        (1234, 0),
        "a command is no setting"
    );
    assert_eq!(fixture.status() & 0x6F, 0x40);
    fixture.write(0x1011, 1, i64::from(u32::from_le_bytes(*b"load")));
    fixture.send(Frame::standard(0, &[129, 2]));
    assert_eq!(fixture.read(0x6081, 0), 100_000);
}
