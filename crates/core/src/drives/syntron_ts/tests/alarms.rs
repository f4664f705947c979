use super::super::alarm::Alarm;
use super::*;
use crate::profile::Severity;
use std::string::ToString;

/// Fn_00 = 1, RAM, so many rpm, on.
fn turning(rpm: i16) -> DriveFixture {
    let mut desk = DriveFixture::new();
    for (number, value) in [(0x00, 1), (0x99, 1), (0x33, rpm as u16), (0x38, 1)] {
        desk.write(number, value);
    }
    desk.advance(1000);
    assert_eq!(desk.rpm(), rpm);
    desk
}

fn trips(desk: &mut DriveFixture, within_ms: u32, text: &str) {
    for _ in 0..within_ms / 10 {
        desk.advance(10);
        if desk.alarm() != 0 {
            break;
        }
    }
    let name = text.as_bytes();
    let wanted = Alarm::of_glyphs([name[0], name[1]]);
    assert_eq!(Some(Alarm(desk.alarm())), wanted, "wanted {text}");
    let truth = desk.truth();
    assert!(!truth.enabled, "{text} takes the power off");
    assert_eq!(truth.fault, u32::from(desk.alarm()));
    assert_eq!(desk.read(0x38), 0, "and Fn_38 with it");
}

/// All 22 of the manual and the DS102's: the code is the two characters of the panel.
#[test]
fn every_code_is_its_characters_and_stops_the_motor() {
    let profile = SyntronTs::profiles()[0];
    let faults = profile.faults.iter().filter(|f| f.severity == Severity::Fault);
    let mut count = 0;
    for fault in faults {
        let text = fault.name.strip_prefix("ERR_").unwrap().as_bytes();
        let code = u16::try_from(fault.code).unwrap();
        assert!(Alarm(code).glyphs().eq_ignore_ascii_case(text), "{}", fault.name);
        assert_eq!(Alarm::of_glyphs([text[0], text[1]]), Some(Alarm(code)), "{}", fault.name);
        for text in [fault.text, fault.cause, fault.remedy] {
            assert!(text.len() > 10 && text.ends_with('.'), "{}: {text}", fault.name);
        }
        let mut desk = turning(300);
        desk.act(Act::Fault(fault.code));
        assert_eq!(u32::from(desk.alarm()), fault.code);
        assert!(!desk.truth().enabled);
        assert_eq!(desk.device.take_notice(), Some(fault.name));
        let blinking = desk.shown().trim().to_uppercase();
        assert_eq!(blinking, shown(fault.name, &desk), "{}", fault.name);
        count += 1;
    }
    assert_eq!(count, 23);
}

/// The panel blinks, so a name is there or nothing is.
fn shown(name: &str, desk: &DriveFixture) -> std::string::String {
    let lit = (desk.now.0 / 250_000_000).is_multiple_of(2);
    if lit { name.to_uppercase() } else { "".to_string() }
}

#[test]
fn a_blocked_motor_stalls() {
    let mut desk = turning(300);
    desk.act(Act::Jam(true));
    trips(&mut desk, 3000, "St");
}

#[test]
fn a_blocked_path_has_a_following_error() {
    let mut desk = DriveFixture::positioning(&[]);
    desk.fill(1, 1002, 3_600_000, 600, [100, 100, 0, 0]);
    desk.trigger(1);
    desk.advance(300);
    desk.act(Act::Jam(true));
    trips(&mut desk, 2000, "PE");
    assert!(!desk.busy());
}

#[test]
fn too_much_load_for_too_long_is_an_overload() {
    let mut desk = turning(300);
    desk.act(Act::Load(-1.2));
    desk.advance(20_000);
    assert_eq!(desk.alarm(), 0, "less than the rated 1.3 N·m is for ever");
    desk.act(Act::Load(-3.0));
    trips(&mut desk, 10_000, "oL");
}

#[test]
fn a_load_that_drives_the_motor_too_fast_is_an_over_current() {
    let mut desk = turning(3000);
    desk.act(Act::Supply(24.0));
    desk.act(Act::Load(12.0));
    trips(&mut desk, 5000, "oc");
}

#[test]
fn the_supply_is_watched() {
    let mut desk = turning(300);
    desk.act(Act::Supply(15.0));
    trips(&mut desk, 100, "LU");
    let mut desk = turning(300);
    desk.act(Act::Supply(75.0));
    trips(&mut desk, 100, "oU");
    let mut desk = DriveFixture::new();
    desk.write(0x00, 1);
    desk.act(Act::Supply(0.0));
    desk.write(0x38, 1);
    trips(&mut desk, 100, "dE");
}

#[test]
fn the_sensors_are_watched() {
    let mut desk = turning(300);
    desk.act(Act::EncoderBroken(true));
    trips(&mut desk, 100, "EC");
    let mut desk = turning(300);
    desk.act(Act::HallBroken(true));
    trips(&mut desk, 100, "EH");
}

#[test]
fn heat_is_watched() {
    let mut desk = turning(300);
    desk.act(Act::Ambient(95.0));
    desk.advance(20_000);
    assert_eq!(desk.alarm(), 0, "metal takes its time");
    trips(&mut desk, 400_000, "ot");
}

#[test]
fn a_load_that_is_braked_all_the_time_heats_the_braking_circuit() {
    let mut desk = turning(3000);
    desk.act(Act::Load(1.2));
    trips(&mut desk, 60_000, "oH");
}

#[test]
fn two_inputs_of_one_purpose_are_an_alarm() {
    let mut desk = DriveFixture::with(&[("inputs", "12345660")]);
    trips(&mut desk, 10, "Id");
    assert!(
        SyntronTs::create_device(
            SyntronTs::profiles()[0],
            &DeviceOptions { extra: &[("inputs", "1234")], ..OPTIONS }
        )
        .is_err()
    );
}

#[test]
fn paths_that_make_no_sense_are_alarms() {
    for (first, rpm, text) in [(9, 100, "PA"), (1002, 0, "SL")] {
        let mut desk = DriveFixture::positioning(&[]);
        desk.fill(1, first, 90_000, rpm, [100, 100, 0, 0]);
        desk.trigger(1);
        trips(&mut desk, 10, text);
    }
    let mut desk = DriveFixture::positioning(&[]);
    desk.write(fn_registers::HOMING_WAY, 28_000 - 2000);
    desk.write(fn_registers::HOMING_TRIGGER, 1);
    assert!(desk.busy(), "C = 6 is a way");
    let mut desk = DriveFixture::positioning(&[]);
    desk.write(fn_registers::HOMING_WAY, 9000);
    desk.write(fn_registers::HOMING_TRIGGER, 1);
    trips(&mut desk, 10, "PA");
}

fn cleared(mut desk: DriveFixture, clear: impl FnOnce(&mut DriveFixture)) {
    desk.act(Act::Fault(0x1614));
    desk.write(0x38, 1);
    assert!(!desk.truth().enabled && desk.read(0x38) == 0, "no power with an alarm");
    clear(&mut desk);
    assert_eq!(desk.alarm(), 0);
    desk.advance(500);
    assert!(!desk.truth().enabled, "clearing starts nothing");
    desk.write(0x33, 100);
    desk.write(0x38, 1);
    desk.advance(500);
    assert_eq!(desk.rpm(), 100);
}

#[test]
fn four_ways_clear_an_alarm() {
    cleared(turning(300), |desk| desk.act(Act::PowerCycle));
    cleared(turning(300), |desk| {
        desk.act(Act::Key(1, true));
        desk.advance(1100);
        desk.act(Act::Key(1, false));
    });
    cleared(turning(300), |desk| {
        desk.act(Act::Input(2, true));
        desk.advance(5);
    });
    let mut desk = DriveFixture::with(&[("ds102", "1")]);
    desk.write(0x00, 1);
    desk.write(0x99, 1);
    cleared(desk, |desk| desk.write(0x53, 1));
    let mut desk = turning(300);
    desk.act(Act::Fault(0x1614));
    desk.write(0x53, 1);
    assert_eq!(desk.alarm(), 0x1614, "a TS knows no Fn_53");
}

#[test]
fn an_alarm_comes_back_while_its_cause_is_there() {
    let mut desk = turning(300);
    desk.act(Act::Supply(75.0));
    trips(&mut desk, 100, "oU");
    desk.act(Act::PowerCycle);
    trips(&mut desk, 100, "oU");
    desk.act(Act::Supply(48.0));
    desk.act(Act::PowerCycle);
    desk.advance(100);
    assert_eq!(desk.alarm(), 0);
}
