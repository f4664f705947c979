//! PVT and PT.

use super::DriveFixture;
use polepair_core::proto::tml::online::{OnlineMessage, PtPoint, PvtPoint};

impl DriveFixture {
    fn pvt(&mut self, position: i32, velocity: f64, time: u16, counter: u8) {
        let velocity = (velocity * 65536.0) as i32;
        let point = OnlineMessage::Pvt(PvtPoint { position, velocity, time, counter }).emit();
        self.send_instruction(point.opcode, point.data());
    }

    fn mode_pvt(&mut self, relative: bool) {
        self.send_instruction(0x5909, &[0xFFC1, 0x8709]);
        self.send_instruction(0x5909, if relative { &[0xDFFF, 0] } else { &[0xFFFF, 0x2000] });
        self.send_instruction(0x5909, &[0xFFFF, 0x4000]);
        self.send_instruction(0x1880, &[0x8000]);
    }
}

/// TML communication manual, chapter 5, example 3: -1000 counts in 500 ms, -10 counts/ms at the
/// end. That does not rest, so the drive stops quickly.
#[test]
fn the_printed_point_is_reached_and_its_speed_stopped() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.mode_pvt(true);
    fixture.send_instruction(0x1800, &[0xFC18, 0xFF00, 0xFFF6, 0x01F4]);
    fixture.update();
    fixture.wait(250);
    let half_way = fixture.read_long(0x02B2);
    assert!((half_way - 125).abs() <= 1, "a cubic to that end speed swings out: {half_way}");
    fixture.wait(250);
    assert!((fixture.read_long(0x02B2) + 1000).abs() <= 1);
    assert!((fixture.read_fixed(0x02B4) + 10.0).abs() < 0.1);
    fixture.wait(500);
    assert!(fixture.read_long(0x0228) < -1050);
    assert_eq!(fixture.read(0x0863), 0xC801, "empty, low, quick stop, counter 1");
    assert_eq!(fixture.read(0x090E), 0x8400);
}

#[test]
fn a_path_of_points_is_followed() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.mode_pvt(false);
    fixture.pvt(500, 10.0, 100, 0);
    fixture.pvt(1500, 10.0, 100, 1);
    fixture.pvt(2000, 0.0, 100, 2);
    assert_eq!(fixture.read(0x0863), 0x4003);
    fixture.update();
    fixture.wait(150);
    assert!((fixture.read_long(0x02B2) - 1000).abs() <= 10);
    assert!((fixture.read_fixed(0x022C) - 10.0).abs() < 1.0);
    fixture.wait(400);
    assert_eq!(fixture.read_long(0x0228), 2000);
    assert_eq!(fixture.read(0x0863), 0xC003);
    fixture.pvt(1000, 0.0, 200, 3);
    assert_eq!(fixture.read(0x090E) & 0x0400, 0, "it goes on without UPD");
    fixture.wait(400);
    assert_eq!((fixture.read_long(0x0228), fixture.read(0x090E)), (1000, 0x8400));
}

#[test]
fn a_wrong_counter_takes_no_point_until_the_right_one_comes() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.mode_pvt(true);
    fixture.pvt(100, 0.0, 100, 0);
    fixture.pvt(100, 0.0, 100, 2);
    assert_eq!(fixture.read(0x0863), 0x5001);
    fixture.pvt(100, 0.0, 100, 1);
    assert_eq!(fixture.read(0x0863), 0x4002);
    fixture.update();
    fixture.wait(300);
    assert_eq!(fixture.read_long(0x0228), 200);
}

#[test]
fn a_full_buffer_takes_no_point_and_the_counter_shows_it() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.mode_pvt(true);
    for counter in 0..9 {
        fixture.pvt(10, 0.0, 100, counter);
    }
    assert_eq!(fixture.read(0x0863), 0x2007 | 0x1000, "point 8 came before point 7");
}

#[test]
fn pt_points_are_joined_by_lines() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.send_instruction(0x5909, &[0xFFC0, 0x870A]);
    fixture.send_instruction(0x5909, &[0xDFFF, 0]);
    fixture.send_instruction(0x1880, &[0x8000]);
    for counter in 0..3 {
        let point = OnlineMessage::Pt(PtPoint { position: 500, time: 100, counter }).emit();
        fixture.send_instruction(point.opcode, point.data());
    }
    fixture.update();
    fixture.wait(250);
    assert!((fixture.read_fixed(0x02B4) - 5.0).abs() < 0.1);
    fixture.wait(300);
    assert_eq!(fixture.read_long(0x0228), 1500);
}
