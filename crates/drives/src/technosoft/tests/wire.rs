//! The examples of the communication manual, chapter 3, byte for byte.

use super::{DriveFixture, NOTHING, frame, messages};
use polepair_core::proto::tml::online::{Cell, OnlineMessage};
use polepair_core::proto::tml::wire::{IdCode, Instruction};

#[test]
fn kpp_is_set_and_read_as_printed() {
    let mut fixture = DriveFixture::new();
    let request = [0x08, 0x0F, 0xF0, 0xB0, 0x04, 0x0F, 0xF1, 0x02, 0x5E, 0x1B];
    let printed = [0x0A, 0x0F, 0xF1, 0xB4, 0x04, 0x0F, 0xF0, 0x02, 0x5E, 0x01, 0x20, 0x42];
    let answer = fixture.bytes(&request);
    assert_eq!(answer[0], 0x4F);
    assert_eq!(answer[1..], printed);
    assert_eq!(fixture.bytes(&[0x06, 0x0F, 0xF0, 0x20, 0x5E, 0x00, 0x05, 0x88]), [0x4F]);
    assert_eq!(fixture.bytes(&request)[10..12], [0, 5]);
    fixture.wait(10);
}

#[test]
fn a_bad_sum_is_met_with_silence_and_changes_nothing() {
    let mut fixture = DriveFixture::new();
    assert_eq!(fixture.bytes(&[0x06, 0x0F, 0xF0, 0x20, 0x5E, 0x00, 0x05, 0x89]), NOTHING);
    let request = [0x08, 0x0F, 0xF0, 0xB0, 0x04, 0x0F, 0xF1, 0x02, 0x5E, 0x1B];
    assert_eq!(fixture.bytes(&request)[10..12], [1, 0x20]);
}

#[test]
fn a_lost_byte_is_made_up_for_by_synchronisation() {
    let mut fixture = DriveFixture::new();
    assert_eq!(fixture.bytes(&[0x06, 0x0F, 0xF0, 0x5E, 0x00, 0x05, 0x88]), NOTHING);
    assert_eq!(fixture.bytes(&[0x0D]), NOTHING, "it ends the broken frame");
    assert_eq!(fixture.bytes(&[0x0D]), [0x0D]);
    assert_eq!(fixture.bytes(&[0x0D]), [0x0D]);
    assert_eq!(fixture.bytes(&[0x06, 0x0F, 0xF0, 0x20, 0x5E, 0x00, 0x05, 0x88]), [0x4F]);
}

#[test]
fn on_rs485_one_axis_acknowledges_and_no_other_does() {
    let mut fixture = DriveFixture::at(Some(1), &[("wire", "rs485")]);
    assert_eq!(fixture.read(0x030B), 1, "CSR");
    let order = Instruction::of(0x205E, [7]);
    assert_eq!(fixture.bytes(&frame(IdCode::axis(1), order)), [0x4F]);
    for to in [IdCode::axis(0), IdCode::axis(2), IdCode::groups(1), IdCode::BROADCAST] {
        assert_eq!(fixture.bytes(&frame(to, order)), NOTHING, "{to:?}");
    }
    let cell = Cell::short(0x025E);
    let instruction = OnlineMessage::GiveMeData { sender: IdCode::axis(255), cell }.emit();
    assert_eq!(fixture.bytes(&frame(IdCode::axis(0), instruction)), NOTHING);
    assert_eq!(fixture.bytes(&[0x0D; 15]), NOTHING, "all would answer at once");
    let answer = fixture.bytes(&frame(IdCode::axis(1), instruction));
    let sender = IdCode::axis(1);
    assert_eq!(messages(&answer[1..])[0].to, IdCode::axis(255), "no host bit");
    assert_eq!(
        OnlineMessage::parse(&messages(&answer[1..])[0].instruction),
        Some(OnlineMessage::TakeData { sender, cell, value: 7 })
    );
}

/// TML communication manual, chapter 3: where there is no host, a drive may be master on RS-485.
#[test]
fn a_drive_is_master_on_rs485() {
    let mut master = DriveFixture::at(Some(1), &[("wire", "rs485")]);
    let mut slave = DriveFixture::at(Some(2), &[("wire", "rs485")]);
    slave.long(0x0368, 1234);
    // [2]{KPP = 5}; VAR_LF = [2] VAR_LF; END
    let program = [0x9401, 0x0020, 0x205E, 5, 0xE568, 0x0020, 0x0368, 0x0001];
    master.load(0x8300, &program);
    master.send_instruction(0x7400, &[0x8300]);
    for _ in 0..10 {
        master.wait(1);
        let bytes = master.sent();
        let answered = slave.bytes(&bytes);
        assert!(slave.bytes(&[]).is_empty());
        assert!(master.bytes(&answered).is_empty());
    }
    assert_eq!((master.read_long(0x0368), slave.read(0x025E)), (1234, 5));
}

#[test]
fn a_slow_line_holds_back_what_it_cannot_carry_yet() {
    use polepair_core::medium::{STREAM_UNIT_MAX, Stream};
    use polepair_core::station::{Station, Timed};
    let mut fixture = DriveFixture::timed();
    let request = [0x08, 0x0F, 0xF0, 0xB0, 0x04, 0x0F, 0xF1, 0x02, 0x5E, 0x1B];
    Station::<Stream>::handle_input(&mut fixture.device, fixture.now, &request);
    let mut out = [0; STREAM_UNIT_MAX];
    let mut poll = |fixture: &mut DriveFixture| {
        Station::<Stream>::poll_transmit(&mut fixture.device, fixture.now, &mut out)
    };
    assert_eq!(poll(&mut fixture), Some(1), "the acknowledgement");
    assert_eq!(poll(&mut fixture), None);
    let free = fixture.device.poll_timeout().unwrap();
    assert_eq!(free.since(fixture.now).as_micros(), 1145, "eleven bits at 9600 baud");
    fixture.now = free;
    assert_eq!(poll(&mut fixture), Some(12));
}
