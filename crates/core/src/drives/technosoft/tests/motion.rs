//! Motion modes, one by one.

use super::DriveFixture;
use crate::drives::bench::BenchControl;

#[test]
fn a_trapezoid_ends_exactly_where_it_was_sent() {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.move_to(20_000);
    desk.wait(100);
    assert_eq!(desk.read(0x090E) & 0x0400, 0, "in motion");
    assert!(desk.read_fixed(0x02B4) > 20.0, "TSPD");
    assert!(desk.read_fixed(0x022C) > 15.0, "ASPD");
    desk.wait(2000);
    assert_eq!((desk.read_long(0x0228), desk.read_long(0x02B2)), (20_000, 20_000));
    assert_eq!((desk.read(0x090E), desk.read(0x090F)), (0x8400, 0x0201));
    let truth = desk.device.ground_truth(desk.now);
    assert!((truth.position - 10.0 * core::f64::consts::TAU).abs() < 0.01);
}

#[test]
fn a_trapezoid_takes_the_time_that_its_numbers_say() {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.fixed(0x02A0, 10.0);
    desk.fixed(0x02A2, 0.1);
    desk.move_to(10_000);
    // 100 ms up to 10 counts/ms, 900 ms at it, 100 ms down.
    desk.wait(1095);
    assert_eq!(desk.read(0x090E) & 0x0400, 0);
    desk.wait(10);
    assert_eq!(desk.read(0x090E) & 0x0400, 0x0400);
}

#[test]
fn relative_moves_add_up_and_additive_ones_to_the_last_target() {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.long(0x029E, 1000);
    for _ in 0..2 {
        desk.mode_pp();
        desk.send_instruction(0x5909, &[0xDFFF, 0]);
        desk.send_instruction(0x5909, &[0xFFFF, 0x4000]);
        desk.update();
        desk.wait(1000);
    }
    assert_eq!(desk.read_long(0x02B2), 2000);
    desk.send_instruction(0x5C00, &[0x0912, 0xFFFF, 0x0800]);
    desk.update();
    desk.update();
    desk.wait(1000);
    assert_eq!(desk.read_long(0x02B2), 4000);
    assert_eq!(desk.read_long(0x0228), 4000);
    assert_eq!(desk.device.ground_truth(desk.now).unrepeatable, 4);
    let starts = desk.device.ground_truth(desk.now).starts;
    assert_eq!(starts, 5, "AXISON and four moves");
    desk.send_instruction(0x0002, &[]);
    desk.update();
    desk.long(0x02B2, 5000);
    assert_eq!(desk.device.ground_truth(desk.now).starts, starts, "without power nothing starts");
    desk.send_instruction(0x0102, &[]);
    desk.long(0x02B2, 5000);
    assert_eq!(desk.device.ground_truth(desk.now).starts, starts + 2);
}

#[test]
fn speed_mode_reaches_its_speed_and_stop_holds() {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.fixed(0x02A0, -10.0);
    desk.send_instruction(0x5909, &[0xBBC1, 0x8301]);
    desk.update();
    desk.wait(1000);
    assert!((desk.read_fixed(0x022C) + 10.0).abs() < 0.2);
    assert_eq!(desk.read(0x090E), 0x8400, "the speed is reached");
    desk.send_instruction(0x01C4, &[]);
    assert_eq!(desk.read(0x090E) & 0x0400, 0, "braking");
    desk.wait(500);
    let there = desk.read_long(0x0228);
    desk.wait(500);
    assert_eq!(desk.read_long(0x0228), there);
    assert_eq!(desk.read(0x090E), 0x8400);
}

#[test]
fn an_s_curve_is_slower_and_is_not_to_be_updated_under_way() {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.long(0x029E, 10_000);
    desk.long(0x08D2, 100);
    desk.send_instruction(0x5909, &[0xBFC1, 0x8707]);
    desk.send_instruction(0x5909, &[0xFFFF, 0x2000]);
    desk.update();
    desk.wait(50);
    desk.update();
    assert_eq!(desk.read(0x03AD), 1 << 9);
    assert_eq!(desk.read(0x08FC), 1 << 14);
    desk.wait(2000);
    assert_eq!(desk.read_long(0x0228), 10_000);
    desk.send_instruction(0x1C04, &[]);
    assert_eq!(desk.read(0x08FC), 0);
}

#[test]
fn torque_modes_drive_a_current() {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.word(0x0281, 3000);
    desk.word(0x0280, 100);
    desk.send_instruction(0x5909, &[0xB1C8, 0x8108]);
    desk.update();
    desk.wait(10);
    let ramp = i32::from(desk.read(0x0230));
    assert!((900..1200).contains(&ramp), "{ramp}");
    desk.wait(50);
    let full = i32::from(desk.read(0x0230));
    assert!((2950..3050).contains(&full), "{full}");
    assert!(desk.device.ground_truth(desk.now).velocity > 1.0);
}

#[test]
fn external_speed_follows_what_is_written() {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.send_instruction(0x5909, &[0xB3C0, 0x8300]);
    desk.update();
    desk.fixed(0x02A8, 4.0);
    desk.wait(300);
    assert!((desk.read_fixed(0x022C) - 4.0).abs() < 0.2);
}

#[test]
fn nothing_moves_while_the_axis_is_off() {
    let mut desk = DriveFixture::new();
    desk.move_to(5000);
    desk.wait(500);
    assert_eq!(desk.read_long(0x0228), 0);
    desk.send_instruction(0x0102, &[]);
    assert_eq!(desk.read(0x08FC), 1 << 14, "AXISON before ENDINIT");
    desk.send_instruction(0x0020, &[]);
    desk.send_instruction(0x0102, &[]);
    desk.wait(500);
    assert_eq!(desk.read_long(0x0228), 0, "AXISON starts no old motion");
}

#[test]
fn the_position_can_be_renamed() {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.move_to(1000);
    desk.wait(1000);
    desk.send_instruction(0x8400, &[0xFC18, 0xFFFF]);
    assert_eq!((desk.read_long(0x0228), desk.read_long(0x02B2)), (-1000, -1000));
    desk.move_to(0);
    desk.wait(1000);
    assert_eq!(desk.read_long(0x0228), 0);
    let turns = desk.device.ground_truth(desk.now).position / core::f64::consts::TAU;
    assert!((turns - 1.0).abs() < 0.01);
}

#[test]
fn counts_wrap_and_moves_go_on() {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.send_instruction(0x8400, &[0xFFF0, 0x7FFF]);
    desk.move_to(i32::MIN + 100);
    desk.wait(1000);
    assert_eq!(desk.read_long(0x0228), i32::MIN + 100);
    let turns = desk.device.ground_truth(desk.now).position / core::f64::consts::TAU;
    assert!(turns > 0.0 && turns < 0.1, "the short way round: {turns}");
}

#[test]
fn relative_moves_rest_on_the_very_count() {
    for counts in ["400", "2000", "4096"] {
        let mut desk = DriveFixture::with(&[("counts", counts)]);
        desk.axis_on();
        desk.fixed(0x02A0, 20.0);
        let mut place = 0;
        for by in [1000, 1000, -300, 1, 7777, -1, -4000, 123, 1000, 1000] {
            desk.long(0x029E, by);
            desk.mode_pp();
            desk.send_instruction(0x5909, &[0xDFFF, 0]);
            desk.send_instruction(0x5909, &[0xFFFF, 0x4000]);
            desk.update();
            place += by;
            for _ in 0..3 {
                desk.wait(1000);
                let found = (desk.read_long(0x0228), desk.read_long(0x02B2));
                assert_eq!(found, (place, place), "{counts} counts, by {by}");
            }
        }
    }
}

#[test]
fn position_triggers_tell_what_was_reached() {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.long(0x091A, 500);
    desk.long(0x091E, 1500);
    desk.move_to(1000);
    desk.wait(1000);
    assert_eq!(desk.read(0x090F), 0x0203, "the first trigger, not the third");
    assert_eq!(desk.read(0x0306) & 1 << 12, 1 << 12, "ISR");
    desk.move_to(2000);
    desk.wait(1000);
    assert_eq!(desk.read(0x090F), 0x020B);
    desk.move_to(0);
    desk.wait(1000);
    assert_eq!(desk.read(0x090F), 0x0201, "and back");
}

#[test]
fn an_update_while_the_axis_is_being_switched_on_is_ignored_and_told() {
    let mut desk = DriveFixture::with(&[("axison-ms", "300")]);
    desk.send_instruction(0x0020, &[]);
    desk.send_instruction(0x0102, &[]);
    assert_eq!(desk.read(0x090E) & 0x8000, 0, "it takes its time");
    desk.wait(100);
    desk.move_to(5000);
    assert_eq!((desk.read(0x03AD), desk.read(0x08FC)), (1 << 4, 1 << 14));
    desk.wait(300);
    assert_eq!(desk.read(0x090E), 0x8400);
    assert_eq!(desk.read_long(0x0228), 0, "nothing moved");
    desk.send_instruction(0x1C04, &[]);
    desk.move_to(5000);
    desk.wait(1000);
    assert_eq!(desk.read_long(0x0228), 5000);
    desk.send_instruction(0x0002, &[]);
    desk.send_instruction(0x0102, &[]);
    desk.send_instruction(0x0002, &[]);
    desk.wait(1000);
    assert_eq!(desk.read(0x090E) & 0x8000, 0, "AXISOFF ends it");
}

#[test]
fn a_gear_slave_follows_its_master_by_the_ratio() {
    let mut desk = DriveFixture::new();
    desk.axis_on();
    desk.fixed(0x02AC, -0.5);
    desk.long(0x02AA, 70_000);
    desk.send_instruction(0x5909, &[0xB7C5, 0x8705]);
    desk.update();
    assert_eq!(desk.read_long(0x0228), 0, "where the master is does not matter, but where it goes");
    for step in 1..=500 {
        desk.long(0x02AA, 70_000 + 10 * step);
        desk.wait(1);
    }
    desk.wait(500);
    // It began on the edge of a count, as it was enabled.
    assert!((desk.read_long(0x0228) + 2500).abs() <= 1, "{}", desk.read_long(0x0228));
    assert_eq!(desk.read(0x090F) & 1 << 12, 1 << 12, "in gear");
}
