//! Contours and cams, and what else the table has beside motion.

extern crate std;

use std::vec::Vec;

use super::{DriveFixture, messages};
use crate::surroundings::SurroundingsControl;
use polepair_core::proto::tml::online::{Cell, OnlineMessage};
use polepair_core::proto::tml::wire::{IdCode, low_first};

const MODE_PC: [u16; 2] = [0xBFC2, 0x8702];
const MODE_SC: [u16; 2] = [0xBBC2, 0x8302];
const MODE_TC: [u16; 2] = [0xB1C3, 0x8103];
const MODE_VC: [u16; 2] = [0xB0C3, 0x8003];
const MODE_CS: [u16; 2] = [0xB7C6, 0x8706];
const SEGMENT_DUE: u16 = 1 << 10;

impl DriveFixture {
    /// SEG: a number of slow loops, and the step in each.
    fn segment(&mut self, periods: u16, step: f64) {
        let [low, high] = low_first(((step * 65536.0) as i32).cast_unsigned());
        self.send_instruction(0x7800, &[periods, low, high]);
    }

    fn mode(&mut self, masks: [u16; 2]) {
        self.send_instruction(0x5909, &masks);
    }
}

#[test]
fn a_position_contour_goes_through_its_segments() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.mode(MODE_PC);
    fixture.segment(100, 2.0);
    fixture.update();
    fixture.wait(10);
    assert_eq!(fixture.read(0x0308) & SEGMENT_DUE, SEGMENT_DUE, "MSR asks for one");
    fixture.segment(200, -0.5);
    assert_eq!(fixture.read(0x0308) & SEGMENT_DUE, 0);
    assert_eq!(fixture.read(0x090E) & 0x0400, 0, "in motion");
    fixture.wait(90);
    let half = fixture.read_long(0x02B2);
    assert!((195..=205).contains(&half), "{half}");
    fixture.segment(0, 0.0);
    fixture.wait(300);
    // From where the motor was, which is not the very edge of a count.
    let (target, actual) = (fixture.read_long(0x02B2), fixture.read_long(0x0228));
    assert!((99..=101).contains(&target) && (target - actual).abs() <= 1, "{target} {actual}");
    assert_eq!(fixture.read(0x090E) & 0x0400, 0x0400, "motion complete");
}

#[test]
fn a_position_contour_without_a_next_segment_stops() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.fixed(0x0858, 1.0);
    fixture.mode(MODE_PC);
    fixture.segment(100, 5.0);
    fixture.update();
    fixture.wait(1000);
    let truth = fixture.device.ground_truth(fixture.now);
    assert!(truth.velocity.abs() < 0.1, "{truth:?}");
    assert!((500..700).contains(&fixture.read_long(0x0228)));
}

#[test]
fn one_segment_waits_and_a_third_is_an_error_unless_a_program_sends_it() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.mode(MODE_PC);
    fixture.segment(100, 1.0);
    fixture.segment(100, 1.0);
    assert_eq!(fixture.read(0x08FC) & 0x4000, 0x4000, "command error");
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    let program = [
        0x5909, MODE_PC[0], MODE_PC[1], 0x7800, 100, 0, 1,      // SEG 100, 1
        0x0108, // UPD
        0x7800, 100, 0, 2, 0x7800, 100, 0, 1, 0x7800, 0, 0, 0, 0x0001,
    ];
    fixture.load(0x8300, &program);
    fixture.send_instruction(0x7400, &[0x8300]);
    fixture.wait(400);
    assert_eq!(fixture.read(0x08FC), 0);
    assert!((399..=401).contains(&fixture.read_long(0x02B2)));
}

#[test]
fn speed_torque_and_voltage_contours_ramp_their_reference() {
    for (mode, step) in [(MODE_SC, 0.1), (MODE_TC, 20.0), (MODE_VC, 100.0)] {
        let mut fixture = DriveFixture::new();
        fixture.axis_on();
        fixture.mode(mode);
        fixture.segment(100, step);
        fixture.update();
        fixture.wait(50);
        let half = fixture.read_fixed(0x02AE);
        fixture.wait(100);
        let whole = fixture.read_fixed(0x02AE);
        assert!((half - 50.0 * step).abs() <= 2.0 * step, "{mode:04X?}: {half}");
        assert!((whole - 100.0 * step).abs() <= step, "{mode:04X?}: {whole}");
        let truth = fixture.device.ground_truth(fixture.now);
        assert!(truth.velocity > 1.0, "{mode:04X?}: {truth:?}");
        fixture.send_instruction(0x01C4, &[]);
        fixture.wait(3000);
        let truth = fixture.device.ground_truth(fixture.now);
        assert!(truth.velocity.abs() < 0.1, "{mode:04X?}: {truth:?}");
    }
}

/// A table of three points, 16 master counts apart, in the EEPROM.
fn cam() -> Vec<u16> {
    let mut words = std::vec![4 << 13 | 2, 100, 0, 0, 0];
    for y in [0_i32, 1000, 400] {
        words.extend(low_first(y.cast_unsigned()));
    }
    words.push(words.iter().fold(0, |sum: u16, word| sum.wrapping_add(*word)));
    words
}

#[test]
fn a_cam_moves_the_slave_by_the_masters_position() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.mode(MODE_CS);
    fixture.update();
    assert_eq!(fixture.read(0x08FC) & 0x4000, 0x4000, "no table is there");
    fixture.send_instruction(0x1C04, &[]);
    fixture.word(0x032B, 0x4200);
    for word in cam() {
        fixture.send_instruction(0x9028, &[0x032B, word]);
    }
    fixture.send_instruction(0xD840, &[0x4200, 0x9000]);
    fixture.word(0x03AE, 0x9000);
    fixture.long(0x02AA, 100);
    fixture.mode(MODE_CS);
    fixture.update();
    assert_eq!((fixture.read(0x08FC), fixture.read(0x090F) & 0x4000), (0, 0x4000));
    for (master, slave) in [(108, 500), (116, 1000), (124, 700), (132, 400), (900, 400), (100, 0)] {
        let from = fixture.read_long(0x02AA);
        for n in 1..=100 {
            fixture.long(0x02AA, from + (master - from) * n / 100);
            fixture.wait(1);
        }
        fixture.wait(300);
        let count = fixture.read_long(0x0228);
        assert!((count - slave).abs() <= 1, "{master}: {count}, not {slave}");
    }
    fixture.send_instruction(0x0002, &[]);
    assert_eq!(fixture.read(0x090F) & 0x4000, 0);
}

#[test]
fn a_damaged_cam_table_is_not_copied() {
    let mut fixture = DriveFixture::new();
    fixture.word(0x032B, 0x4200);
    for word in cam().iter().rev() {
        fixture.send_instruction(0x9028, &[0x032B, *word]);
    }
    fixture.send_instruction(0xD840, &[0x4200, 0x9000]);
    assert_eq!((fixture.read(0x08FC) & 0x4000, fixture.request(0xB004, 0x9000)), (0x4000, 0));
}

#[test]
fn groups_are_set_joined_and_left() {
    let mut fixture = DriveFixture::new();
    fixture.send_instruction(0x0802, &[0x0A]);
    assert_eq!(fixture.read(0x030C), 0x0AFF);
    let order = |fixture: &mut DriveFixture, group: u8, value: u16| {
        fixture.send(IdCode::groups(1 << (group - 1)), 0x205E, &[value]);
        fixture.read(0x025E)
    };
    assert_eq!(order(&mut fixture, 2, 7), 7);
    assert_eq!(order(&mut fixture, 1, 8), 7, "no longer a member of group 1");
    fixture.word(0x0366, 1);
    fixture.send_instruction(0x0902, &[0x0366]);
    assert_eq!(order(&mut fixture, 1, 9), 9);
}

#[test]
fn break_halts_a_program_and_continue_goes_on() {
    let mut fixture = DriveFixture::new();
    // VAR_I1 += 1 for ever.
    fixture.load(0x8300, &[0x3966, 1, 0x7400, 0x8300]);
    fixture.send_instruction(0x7400, &[0x8300]);
    fixture.wait(5);
    fixture.send_instruction(0x0010, &[]);
    let halted = fixture.read(0x0366);
    assert_ne!(halted, 0);
    fixture.wait(20);
    assert_eq!(fixture.read(0x0366), halted);
    fixture.send_instruction(0x0110, &[]);
    fixture.wait(5);
    assert_ne!(fixture.read(0x0366), halted);
    fixture.send_instruction(0x0001, &[]);
}

#[test]
fn dispwm_lets_the_motor_coast_and_enpwm_holds_it() {
    let mut fixture = DriveFixture::new();
    fixture.send_instruction(0x0540, &[]);
    assert_eq!(fixture.read(0x08FC) & 0x4000, 0x4000, "the axis is off");
    fixture.send_instruction(0x1C04, &[]);
    fixture.axis_on();
    fixture.send_instruction(0x0440, &[]);
    assert!(!fixture.device.ground_truth(fixture.now).enabled);
    assert_eq!(fixture.read(0x090E) & 0x8000, 0x8000, "the axis stays on");
    fixture.move_to(2000);
    fixture.wait(500);
    assert_eq!(fixture.read_long(0x0228), 0, "without its stage nothing turns");
    fixture.send_instruction(0x0540, &[]);
    fixture.move_to(2000);
    fixture.wait(2000);
    assert_eq!(fixture.read_long(0x0228), 2000);
}

#[test]
fn every_kind_of_stop_waits_for_the_event() {
    for opcode in [0x0004, 0x0044, 0x0084, 0x00C4] {
        let mut fixture = DriveFixture::new();
        fixture.axis_on();
        fixture.send_instruction(0x7092, &[0x0228, 1000, 0]); // !ALPO 1000
        fixture.send_instruction(opcode, &[]);
        fixture.move_to(200_000);
        fixture.wait(5000);
        let truth = fixture.device.ground_truth(fixture.now);
        assert!(truth.velocity.abs() < 0.1, "{opcode:04X}: {truth:?}");
        assert!((1000..190_000).contains(&fixture.read_long(0x0228)), "{opcode:04X}");
    }
}

#[test]
fn send_tells_a_variable_to_its_master_but_not_on_rs485() {
    let mut fixture = DriveFixture::new();
    fixture.word(0x0366, 77);
    let told = fixture.send(IdCode::axis(255), 0xC166, &[]);
    let message = messages(&told[1..])[0];
    assert_eq!(message.to, IdCode::host_at(255));
    let cell = Cell::short(0x0366);
    let expected =
        OnlineMessage::TakeData2 { sender: 255, address: cell.address, long: false, value: 77 };
    assert_eq!(OnlineMessage::parse(&message.instruction), Some(expected));
    let told = fixture.send(IdCode::axis(255), 0xC428, &[]);
    assert!(matches!(
        OnlineMessage::parse(&messages(&told[1..])[0].instruction),
        Some(OnlineMessage::TakeData2 { address: 0x0228, long: true, .. })
    ));
    let mut fixture = DriveFixture::at(Some(1), &[("wire", "rs485")]);
    assert_eq!(fixture.send(IdCode::axis(1), 0xC166, &[]), [0x4F]);
    assert_eq!(fixture.read(0x08FC) & 0x4000, 0x4000);
}

#[test]
fn the_connected_drive_answers_for_axis_id_0() {
    let mut fixture = DriveFixture::new();
    let host = IdCode::host_at(255).word();
    let answer = fixture.send(IdCode::axis(0), 0xB004, &[host, 0x030C]);
    let message = messages(&answer[1..])[0];
    assert_eq!(message.to, IdCode::host_at(255));
    assert!(matches!(
        OnlineMessage::parse(&message.instruction),
        Some(OnlineMessage::TakeData { value: 0x01FF, .. })
    ));
}

#[test]
fn the_axis_id_comes_from_the_switches_where_the_setup_leaves_it_to_them() {
    for (extra, axis) in [(&[][..], 255), (&[("switches", "9")], 9)] {
        let mut fixture = DriveFixture::at(Some(0), extra);
        assert_eq!((fixture.axis(), fixture.read(0x030C)), (axis, 0x0100 | u16::from(axis)));
        assert_eq!(fixture.read(0x030B) & 0x4000, 0x4000, "CSR.14: from hardware");
    }
}

#[test]
fn a_line_that_is_an_input_takes_no_output() {
    let mut fixture = DriveFixture::new();
    fixture.send_instruction(0xEC00, &[3, 3]);
    assert_eq!(fixture.read(0x09B8), 3);
    fixture.send_instruction(0xEE00, &[1]);
    assert_eq!(fixture.read(0x09B8), 2);
    fixture.send_instruction(0xEC00, &[1, 1]);
    assert_eq!((fixture.read(0x09B8), fixture.read(0x08FC) & 0x4000), (2, 0x4000));
    fixture.send_instruction(0xEF00, &[1]);
    fixture.send_instruction(0xEC00, &[1, 1]);
    assert_eq!(fixture.read(0x09B8), 3);
}
