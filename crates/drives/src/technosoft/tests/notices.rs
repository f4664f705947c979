//! Messages of type C.

use super::Vec;
use super::{DriveFixture, NOTHING, messages};
use crate::surroundings::Act;
use polepair_core::proto::tml::online::OnlineMessage;
use polepair_core::proto::tml::wire::IdCode;

/// TML communication manual, chapter 3, example 3.
#[test]
fn motion_complete_is_reported_as_printed() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.word(0x0962, 0x0400);
    fixture.move_to(2000);
    assert_eq!(fixture.unsolicited.len(), 1, "the start");
    let mut received = Vec::new();
    for _ in 0..1000 {
        fixture.wait(1);
        received.extend(fixture.sent());
    }
    let printed = [0x0A, 0x0F, 0xF1, 0xD5, 0xFF, 0x09, 0x0E, 0x84, 0x00, 0x02, 0x01, 0x7C];
    assert_eq!(received, printed);
}

#[test]
fn the_start_of_a_motion_is_reported_too() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.word(0x0962, 0x0400);
    fixture.long(0x029E, 2000);
    fixture.mode_pp();
    let answer = fixture.send(IdCode::axis(255), 0x0108, &[]);
    let reports = messages(&answer[1..]);
    assert_eq!(
        OnlineMessage::parse(&reports[0].instruction),
        Some(OnlineMessage::TakeData2 {
            sender: 255,
            address: 0x090E,
            long: true,
            value: 0x0001_8000
        })
    );
    assert_eq!(reports[0].to, IdCode::host_at(255));
}

#[test]
fn an_error_is_named_by_its_mask() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.word(0x0965, 1 << 12);
    fixture.act(Act::Supply(70.0));
    let mut received = Vec::new();
    for _ in 0..20 {
        fixture.wait(1);
        received.extend(fixture.sent());
    }
    let reports = messages(&received);
    assert_eq!(
        OnlineMessage::parse(&reports[0].instruction),
        Some(OnlineMessage::TakeData2 { sender: 255, address: 0x08FC, long: false, value: 0x1000 })
    );
}

#[test]
fn on_rs485_no_drive_sends_unasked() {
    let mut fixture = DriveFixture::at(Some(1), &[("wire", "rs485")]);
    fixture.send_instruction(0x0020, &[]);
    fixture.send_instruction(0x0102, &[]);
    fixture.word(0x0962, 0x0400);
    fixture.word(0x0927, 0x0FF1);
    fixture.move_to(2000);
    for _ in 0..1000 {
        fixture.wait(1);
        assert_eq!(fixture.sent(), NOTHING);
    }
}

#[test]
fn a_drive_wakes_by_itself_to_tell() {
    use polepair_core::station::Timed;
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    assert_eq!(fixture.device.poll_timeout(), None);
    fixture.word(0x0962, 0x0400);
    fixture.move_to(2000);
    for _ in 0..1000 {
        let at = fixture.device.poll_timeout().expect("there is something to tell");
        fixture.now = fixture.now.max(at);
        fixture.device.handle_timeout(fixture.now);
        if !messages(&fixture.sent()).is_empty() {
            return;
        }
    }
    panic!("the motion never ended");
}
