use super::super::alarm::Alarm;
use super::*;
use polepair_core::profile::Severity;
use std::string::ToString;

/// Fn_00 = 1, RAM, this speed in rpm, on.
fn turning(rpm: i16) -> DriveFixture {
    let mut fixture = DriveFixture::new();
    for (number, value) in [(0x00, 1), (0x99, 1), (0x33, rpm as u16), (0x38, 1)] {
        fixture.write(number, value);
    }
    fixture.advance(1000);
    assert_eq!(fixture.rpm(), rpm);
    fixture
}

fn trips(fixture: &mut DriveFixture, within_ms: u32, text: &str) {
    for _ in 0..within_ms / 10 {
        fixture.advance(10);
        if fixture.alarm() != 0 {
            break;
        }
    }
    let name = text.as_bytes();
    let wanted = Alarm::of_glyphs([name[0], name[1]]);
    assert_eq!(Some(Alarm(fixture.alarm())), wanted, "wanted {text}");
    let truth = fixture.truth();
    assert!(!truth.enabled, "{text} takes the power off");
    assert_eq!(truth.fault, u32::from(fixture.alarm()));
    assert_eq!(fixture.read(0x38), 0, "and Fn_38 with it");
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
        let mut fixture = turning(300);
        fixture.act(Act::Fault(fault.code));
        assert_eq!(u32::from(fixture.alarm()), fault.code);
        assert!(!fixture.truth().enabled);
        assert_eq!(fixture.device.take_notice(), Some(fault.name));
        let blinking = fixture.shown().trim().to_uppercase();
        assert_eq!(blinking, shown(fault.name, &fixture), "{}", fault.name);
        count += 1;
    }
    assert_eq!(count, 23);
}

#[test]
fn what_is_no_alarm_is_not_raised() {
    let mut fixture = turning(300);
    for code in [0, 0x8681, 0x8682, 0x8683, 0x1_1614] {
        assert!(!fixture.device.act(fixture.now, Act::Fault(code)), "{code:X}");
    }
    assert_eq!(fixture.alarm(), 0);
    assert!(fixture.truth().enabled);
}

/// The panel blinks, so a name is there or nothing is.
fn shown(name: &str, fixture: &DriveFixture) -> std::string::String {
    let lit = (fixture.now.0 / 250_000_000).is_multiple_of(2);
    if lit { name.to_uppercase() } else { "".to_string() }
}

#[test]
fn a_blocked_motor_stalls() {
    let mut fixture = turning(300);
    fixture.act(Act::Jam(true));
    trips(&mut fixture, 3000, "St");
}

#[test]
fn a_blocked_path_has_a_following_error() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.fill(1, 1002, 3_600_000, 600, [100, 100, 0, 0]);
    fixture.trigger(1);
    fixture.advance(300);
    fixture.act(Act::Jam(true));
    trips(&mut fixture, 2000, "PE");
    assert!(!fixture.busy());
}

#[test]
fn too_much_load_for_too_long_is_an_overload() {
    let mut fixture = turning(300);
    fixture.act(Act::Load(-1.2));
    fixture.advance(20_000);
    assert_eq!(fixture.alarm(), 0, "less than the rated 1.3 N·m is for ever");
    fixture.act(Act::Load(-3.0));
    trips(&mut fixture, 10_000, "oL");
}

#[test]
fn a_load_that_drives_the_motor_too_fast_is_an_over_current() {
    let mut fixture = turning(3000);
    fixture.act(Act::Supply(24.0));
    fixture.act(Act::Load(12.0));
    trips(&mut fixture, 5000, "oc");
}

#[test]
fn the_supply_is_watched() {
    let mut fixture = turning(300);
    fixture.act(Act::Supply(15.0));
    trips(&mut fixture, 100, "LU");
    let mut fixture = turning(300);
    fixture.act(Act::Supply(75.0));
    trips(&mut fixture, 100, "oU");
    let mut fixture = DriveFixture::new();
    fixture.write(0x00, 1);
    fixture.act(Act::Supply(0.0));
    fixture.write(0x38, 1);
    trips(&mut fixture, 100, "dE");
}

#[test]
fn the_sensors_are_watched() {
    let mut fixture = turning(300);
    fixture.act(Act::EncoderBroken(true));
    trips(&mut fixture, 100, "EC");
    let mut fixture = turning(300);
    fixture.act(Act::HallBroken(true));
    trips(&mut fixture, 100, "EH");
}

#[test]
fn heat_is_watched() {
    let mut fixture = turning(300);
    fixture.act(Act::Ambient(95.0));
    fixture.advance(20_000);
    assert_eq!(fixture.alarm(), 0, "metal takes its time");
    trips(&mut fixture, 400_000, "ot");
}

#[test]
fn a_load_that_is_braked_all_the_time_heats_the_braking_circuit() {
    let mut fixture = turning(3000);
    fixture.act(Act::Load(1.2));
    trips(&mut fixture, 60_000, "oH");
}

#[test]
fn two_inputs_of_one_purpose_are_an_alarm() {
    let mut fixture = DriveFixture::with(&[("inputs", "12345660")]);
    trips(&mut fixture, 10, "Id");
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
        let mut fixture = DriveFixture::positioning(&[]);
        fixture.fill(1, first, 90_000, rpm, [100, 100, 0, 0]);
        fixture.trigger(1);
        trips(&mut fixture, 10, text);
    }
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.write(fn_registers::HOMING_WAY, 28_000 - 2000);
    fixture.write(fn_registers::HOMING_TRIGGER, 1);
    assert!(fixture.busy(), "C = 6 is a way");
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.write(fn_registers::HOMING_WAY, 9000);
    fixture.write(fn_registers::HOMING_TRIGGER, 1);
    trips(&mut fixture, 10, "PA");
}

fn cleared(mut fixture: DriveFixture, clear: impl FnOnce(&mut DriveFixture)) {
    fixture.act(Act::Fault(0x1614));
    fixture.write(0x38, 1);
    assert!(!fixture.truth().enabled && fixture.read(0x38) == 0, "no power with an alarm");
    clear(&mut fixture);
    assert_eq!(fixture.alarm(), 0);
    fixture.advance(500);
    assert!(!fixture.truth().enabled, "clearing starts nothing");
    fixture.write(0x33, 100);
    fixture.write(0x38, 1);
    fixture.advance(500);
    assert_eq!(fixture.rpm(), 100);
}

#[test]
fn four_ways_clear_an_alarm() {
    cleared(turning(300), |fixture| fixture.act(Act::PowerCycle));
    cleared(turning(300), |fixture| {
        fixture.act(Act::Key(1, true));
        fixture.advance(1100);
        fixture.act(Act::Key(1, false));
    });
    cleared(turning(300), |fixture| {
        fixture.act(Act::Input(2, true));
        fixture.advance(5);
    });
    let mut fixture = DriveFixture::with(&[("ds102", "1")]);
    fixture.write(0x00, 1);
    fixture.write(0x99, 1);
    cleared(fixture, |fixture| fixture.write(0x53, 1));
    let mut fixture = turning(300);
    fixture.act(Act::Fault(0x1614));
    fixture.write(0x53, 1);
    assert_eq!(fixture.alarm(), 0x1614, "a TS knows no Fn_53");
}

#[test]
fn an_alarm_comes_back_while_its_cause_is_there() {
    let mut fixture = turning(300);
    fixture.act(Act::Supply(75.0));
    trips(&mut fixture, 100, "oU");
    fixture.act(Act::PowerCycle);
    trips(&mut fixture, 100, "oU");
    fixture.act(Act::Supply(48.0));
    fixture.act(Act::PowerCycle);
    fixture.advance(100);
    assert_eq!(fixture.alarm(), 0);
}
