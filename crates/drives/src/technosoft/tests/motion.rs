//! Motion modes, one by one.

use super::DriveFixture;
use crate::surroundings::SurroundingsControl;

#[test]
fn a_trapezoid_ends_exactly_where_it_was_sent() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.move_to(20_000);
    fixture.wait(100);
    assert_eq!(fixture.read(0x090E) & 0x0400, 0, "in motion");
    assert!(fixture.read_fixed(0x02B4) > 20.0, "TSPD");
    assert!(fixture.read_fixed(0x022C) > 15.0, "ASPD");
    fixture.wait(2000);
    assert_eq!((fixture.read_long(0x0228), fixture.read_long(0x02B2)), (20_000, 20_000));
    assert_eq!((fixture.read(0x090E), fixture.read(0x090F)), (0x8400, 0x0201));
    let truth = fixture.device.ground_truth(fixture.now);
    assert!((truth.position - 10.0 * core::f64::consts::TAU).abs() < 0.01);
}

#[test]
fn a_trapezoid_takes_the_time_that_its_numbers_say() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.fixed(0x02A0, 10.0);
    fixture.fixed(0x02A2, 0.1);
    fixture.move_to(10_000);
    // 100 ms up to 10 counts/ms, 900 ms at it, 100 ms down.
    fixture.wait(1095);
    assert_eq!(fixture.read(0x090E) & 0x0400, 0);
    fixture.wait(10);
    assert_eq!(fixture.read(0x090E) & 0x0400, 0x0400);
}

#[test]
fn relative_moves_add_up_and_additive_ones_to_the_last_target() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.long(0x029E, 1000);
    for _ in 0..2 {
        fixture.mode_pp();
        fixture.send_instruction(0x5909, &[0xDFFF, 0]);
        fixture.send_instruction(0x5909, &[0xFFFF, 0x4000]);
        fixture.update();
        fixture.wait(1000);
    }
    assert_eq!(fixture.read_long(0x02B2), 2000);
    fixture.send_instruction(0x5C00, &[0x0912, 0xFFFF, 0x0800]);
    fixture.update();
    fixture.update();
    fixture.wait(1000);
    assert_eq!(fixture.read_long(0x02B2), 4000);
    assert_eq!(fixture.read_long(0x0228), 4000);
    assert_eq!(fixture.device.ground_truth(fixture.now).unrepeatable, 4);
    let starts = fixture.device.ground_truth(fixture.now).starts;
    assert_eq!(starts, 5, "AXISON and four moves");
    fixture.send_instruction(0x0002, &[]);
    fixture.update();
    fixture.long(0x02B2, 5000);
    assert_eq!(
        fixture.device.ground_truth(fixture.now).starts,
        starts,
        "without power nothing starts"
    );
    fixture.send_instruction(0x0102, &[]);
    fixture.long(0x02B2, 5000);
    assert_eq!(fixture.device.ground_truth(fixture.now).starts, starts + 2);
}

#[test]
fn speed_mode_reaches_its_speed_and_stop_holds() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.fixed(0x02A0, -10.0);
    fixture.send_instruction(0x5909, &[0xBBC1, 0x8301]);
    fixture.update();
    fixture.wait(1000);
    assert!((fixture.read_fixed(0x022C) + 10.0).abs() < 0.2);
    assert_eq!(fixture.read(0x090E), 0x8400, "the speed is reached");
    fixture.send_instruction(0x01C4, &[]);
    assert_eq!(fixture.read(0x090E) & 0x0400, 0, "braking");
    fixture.wait(500);
    let there = fixture.read_long(0x0228);
    fixture.wait(500);
    assert_eq!(fixture.read_long(0x0228), there);
    assert_eq!(fixture.read(0x090E), 0x8400);
}

#[test]
fn an_s_curve_is_slower_and_is_not_to_be_updated_under_way() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.long(0x029E, 10_000);
    fixture.long(0x08D2, 100);
    fixture.send_instruction(0x5909, &[0xBFC1, 0x8707]);
    fixture.send_instruction(0x5909, &[0xFFFF, 0x2000]);
    fixture.update();
    fixture.wait(50);
    fixture.update();
    assert_eq!(fixture.read(0x03AD), 1 << 9);
    assert_eq!(fixture.read(0x08FC), 1 << 14);
    fixture.wait(2000);
    assert_eq!(fixture.read_long(0x0228), 10_000);
    fixture.send_instruction(0x1C04, &[]);
    assert_eq!(fixture.read(0x08FC), 0);
}

#[test]
fn torque_modes_drive_a_current() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.word(0x0281, 3000);
    fixture.word(0x0280, 100);
    fixture.send_instruction(0x5909, &[0xB1C8, 0x8108]);
    fixture.update();
    fixture.wait(10);
    let ramp = i32::from(fixture.read(0x0230));
    assert!((900..1200).contains(&ramp), "{ramp}");
    fixture.wait(50);
    let full = i32::from(fixture.read(0x0230));
    assert!((2950..3050).contains(&full), "{full}");
    assert!(fixture.device.ground_truth(fixture.now).velocity > 1.0);
}

#[test]
fn external_speed_follows_what_is_written() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.send_instruction(0x5909, &[0xB3C0, 0x8300]);
    fixture.update();
    fixture.fixed(0x02A8, 4.0);
    fixture.wait(300);
    assert!((fixture.read_fixed(0x022C) - 4.0).abs() < 0.2);
}

#[test]
fn nothing_moves_while_the_axis_is_off() {
    let mut fixture = DriveFixture::new();
    fixture.move_to(5000);
    fixture.wait(500);
    assert_eq!(fixture.read_long(0x0228), 0);
    fixture.send_instruction(0x0102, &[]);
    assert_eq!(fixture.read(0x08FC), 1 << 14, "AXISON before ENDINIT");
    fixture.send_instruction(0x0020, &[]);
    fixture.send_instruction(0x0102, &[]);
    fixture.wait(500);
    assert_eq!(fixture.read_long(0x0228), 0, "AXISON starts no old motion");
}

#[test]
fn the_position_can_be_renamed() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.move_to(1000);
    fixture.wait(1000);
    fixture.send_instruction(0x8400, &[0xFC18, 0xFFFF]);
    assert_eq!((fixture.read_long(0x0228), fixture.read_long(0x02B2)), (-1000, -1000));
    fixture.move_to(0);
    fixture.wait(1000);
    assert_eq!(fixture.read_long(0x0228), 0);
    let turns = fixture.device.ground_truth(fixture.now).position / core::f64::consts::TAU;
    assert!((turns - 1.0).abs() < 0.01);
}

#[test]
fn counts_wrap_and_moves_go_on() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.send_instruction(0x8400, &[0xFFF0, 0x7FFF]);
    fixture.move_to(i32::MIN + 100);
    fixture.wait(1000);
    assert_eq!(fixture.read_long(0x0228), i32::MIN + 100);
    let turns = fixture.device.ground_truth(fixture.now).position / core::f64::consts::TAU;
    assert!(turns > 0.0 && turns < 0.1, "the short way round: {turns}");
}

#[test]
fn relative_moves_rest_on_the_very_count() {
    for counts in ["400", "2000", "4096"] {
        let mut fixture = DriveFixture::with(&[("counts", counts)]);
        fixture.axis_on();
        fixture.fixed(0x02A0, 20.0);
        let mut index = 0;
        for by in [1000, 1000, -300, 1, 7777, -1, -4000, 123, 1000, 1000] {
            fixture.long(0x029E, by);
            fixture.mode_pp();
            fixture.send_instruction(0x5909, &[0xDFFF, 0]);
            fixture.send_instruction(0x5909, &[0xFFFF, 0x4000]);
            fixture.update();
            index += by;
            for _ in 0..3 {
                fixture.wait(1000);
                let found = (fixture.read_long(0x0228), fixture.read_long(0x02B2));
                assert_eq!(found, (index, index), "{counts} counts, by {by}");
            }
        }
    }
}

#[test]
fn position_triggers_tell_what_was_reached() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.long(0x091A, 500);
    fixture.long(0x091E, 1500);
    fixture.move_to(1000);
    fixture.wait(1000);
    assert_eq!(fixture.read(0x090F), 0x0203, "the first trigger, not the third");
    assert_eq!(fixture.read(0x0306) & 1 << 12, 1 << 12, "ISR");
    fixture.move_to(2000);
    fixture.wait(1000);
    assert_eq!(fixture.read(0x090F), 0x020B);
    fixture.move_to(0);
    fixture.wait(1000);
    assert_eq!(fixture.read(0x090F), 0x0201, "and back");
}

#[test]
fn an_update_while_the_axis_is_being_switched_on_is_ignored_and_reported() {
    let mut fixture = DriveFixture::with(&[("axison-ms", "300")]);
    fixture.send_instruction(0x0020, &[]);
    fixture.send_instruction(0x0102, &[]);
    assert_eq!(fixture.read(0x090E) & 0x8000, 0, "it takes its time");
    fixture.wait(100);
    fixture.move_to(5000);
    assert_eq!((fixture.read(0x03AD), fixture.read(0x08FC)), (1 << 4, 1 << 14));
    fixture.wait(300);
    assert_eq!(fixture.read(0x090E), 0x8400);
    assert_eq!(fixture.read_long(0x0228), 0, "nothing moved");
    fixture.send_instruction(0x1C04, &[]);
    fixture.move_to(5000);
    fixture.wait(1000);
    assert_eq!(fixture.read_long(0x0228), 5000);
    fixture.send_instruction(0x0002, &[]);
    fixture.send_instruction(0x0102, &[]);
    fixture.send_instruction(0x0002, &[]);
    fixture.wait(1000);
    assert_eq!(fixture.read(0x090E) & 0x8000, 0, "AXISOFF ends it");
}

#[test]
fn a_gear_slave_follows_its_master_by_the_ratio() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.fixed(0x02AC, -0.5);
    fixture.long(0x02AA, 70_000);
    fixture.send_instruction(0x5909, &[0xB7C5, 0x8705]);
    fixture.update();
    assert_eq!(
        fixture.read_long(0x0228),
        0,
        "where the master is does not matter, but where it goes"
    );
    for step in 1..=500 {
        fixture.long(0x02AA, 70_000 + 10 * step);
        fixture.wait(1);
    }
    fixture.wait(500);
    // It began on the edge of a count, as it was enabled.
    assert!((fixture.read_long(0x0228) + 2500).abs() <= 1, "{}", fixture.read_long(0x0228));
    assert_eq!(fixture.read(0x090F) & 1 << 12, 1 << 12, "in gear");
}

#[test]
fn a_new_event_is_not_the_one_before() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.send_instruction(0x700F, &[]); // !MC
    fixture.wait(2);
    assert_eq!(fixture.read(0x090E) >> 14 & 1, 1);
    fixture.move_to(10_000);
    fixture.send_instruction(0x700F, &[]);
    assert_eq!(fixture.read(0x090E) >> 14 & 1, 0, "within the same tick");
}
