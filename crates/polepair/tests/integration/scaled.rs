//! Values that are written together with what scales them, and whether a motor is shown as moving.

use polepair::axis::PendingWrites;
use polepair::settings::{AxisSettings, Settings};
use polepair::{Amount, LocalLink};
use polepair_core::profile::Signal;
use std::time::Duration;

fn ts() -> LocalLink {
    polepair::connect_local("sim:modbus-rtu?fn00=1&time=virtual").unwrap()
}

#[test]
fn a_way_is_converted_by_the_gear_that_goes_with_it() {
    let link = ts();
    let axis = &link.axes()[0];
    let id = |name: &str| axis.find(name).unwrap();
    let (gear, way) = (id("Fn_206"), id("path 1 position"));
    assert!(axis.scales(gear) && !axis.scales(way));
    let turn = Amount::Text("360 deg".to_owned());
    let before = axis.raw_of(way, &turn).unwrap();
    let was = axis.read(gear).unwrap();
    let mut pending = PendingWrites::default();
    pending.insert(gear, was * 10);
    let planned = axis.raw_of_after(way, &turn, &pending).unwrap();
    assert_ne!(planned, before);
    assert_eq!(axis.read(gear).unwrap(), was, "nothing is written by it");
    axis.write(gear, was * 10, false).unwrap();
    assert_eq!(axis.raw_of(way, &turn).unwrap(), planned, "as it is once the gear is written");
}

#[test]
fn settings_are_what_they_mean_by_the_scales_of_their_file() {
    let link = ts();
    let axis = &link.axes()[0];
    let gear = axis.find("Fn_206").unwrap();
    let way = axis.find("path 1 position").unwrap();
    let name = |id| axis.profile().parameter(id).unwrap().name;
    let was = axis.read(gear).unwrap();
    axis.write(gear, was * 10, false).unwrap();
    let wanted = axis.raw_of(way, &Amount::Text("360 deg".to_owned())).unwrap();
    axis.write(gear, was, false).unwrap();
    let text = format!(
        "[axis.1]\nprofile = \"{}\"\n[axis.1.settings]\n\"{}\" = \"360 deg\"\n\"{}\" = {{ raw = {} }}\n",
        axis.profile().name,
        name(way),
        name(gear),
        was * 10
    );
    let settings = Settings::parse("file.toml", &text).unwrap();
    let changes = settings.axes[0].changes(axis, &mut |_, _| {}).unwrap();
    let found: Vec<_> = changes.iter().map(|change| (change.id, change.wanted.raw)).collect();
    assert_eq!(found, [(gear, was * 10), (way, wanted)], "the gear first, the way by it");
    let shown = changes[1].wanted.value;
    assert!((shown - 360.0).abs() < 1.0, "{shown}");
    for change in &changes {
        axis.write(change.id, change.wanted.raw, false).unwrap();
    }
    assert!(settings.axes[0].changes(axis, &mut |_, _| {}).unwrap().is_empty());
}

#[test]
fn a_motor_that_turns_at_a_speed_is_shown_as_moving() {
    for url in ["sim:modbus-rtu?fn00=1&", "sim:tml?", "sim:cia402:5?", "sim:tmcl?", "sim:thruster?"]
    {
        let link = polepair::connect_local(&format!("{url}time=virtual")).unwrap();
        let axis = &link.axes()[0];
        let all: Vec<Signal> = axis.profile().signals.iter().map(|s| s.signal).collect();
        let moving = || {
            axis.signals(&all).unwrap_or_else(|e| panic!("{url}: {e}"));
            axis.moving(&axis.state())
        };
        let armed = axis.armed().unwrap_or_else(|e| panic!("{url}: {e}"));
        axis.velocity("120 rpm").unwrap_or_else(|e| panic!("{url}: {e}"));
        link.sleep(Duration::from_secs(5));
        assert_eq!(moving(), Some(true), "{url}: it turns");
        axis.stop().unwrap();
        link.sleep(Duration::from_secs(3));
        assert_eq!(moving(), Some(false), "{url}: it stands");
        armed.release().unwrap();
    }
}

/// A file of a later version is refused with its line, before its keys are read; one without a version is of the first.
#[test]
fn a_file_of_a_later_version_is_refused() {
    let parse = |text: &str| Settings::parse("file.toml", text).map_err(|error| error.to_string());
    for head in ["", "version = 1\n", "version = 2\n"] {
        assert!(
            parse(&format!("{head}[axis.1]\nprofile = \"tmcm-171\"\n[axis.1.settings]\n")).is_ok(),
            "{head}"
        );
    }
    let later = parse("# saved\nversion = 3\nnew_key = 1\n[axis.1]\n").unwrap_err();
    let reason = "the file has version 3; this program reads version 2: use a newer polepair";
    assert_eq!(later, format!("file.toml:2:11: {reason}"));
    assert!(parse("version = \"1\"\n").unwrap_err().contains("`version` is a string"));
    let link = polepair::connect_local("sim:tmcl?time=virtual").unwrap();
    let axes = vec![AxisSettings::read(&link.axes()[0], &mut |_, _| {}).unwrap()];
    let saved = Settings { axes }.to_string();
    assert!(saved.contains("\nversion = 2\n"), "{saved}");
    assert!(parse(&saved).is_ok());
}

/// User variables have decimal numbers, as in the manual, in instructions and in addresses. Files of version 1 number
/// them in hexadecimal, as do older ones of the program, which have `count`.
#[test]
fn user_variables_are_numbered_in_decimal_and_older_files_are_read() {
    let link = polepair::connect_local("sim:tmcm-6110?time=virtual").unwrap();
    let axis = &link.axes()[0];
    axis.set_raw("user variable 10", 77).unwrap();
    assert_eq!(axis.get_raw("GP 10.2").unwrap(), 77);
    assert_eq!(axis.get_raw("GP 16.2").unwrap(), 0);
    assert!(axis.get_raw("user variable 1F").is_err());
    for (head, count, written, number) in [
        ("version = 2\n", "count = 1\n", "10", 10),
        ("version = 1\n", "count = 1\n", "10", 16),
        ("version = 1\n", "", "FF", 255),
        ("", "count = 1\n", "A", 10),
        ("", "", "10", 10),
    ] {
        let text = format!(
            "{head}[axis.1]\n{count}profile = \"tmcm-6110\"\n[axis.1.settings]\n\"user variable {written}\" = 5\n"
        );
        let read = Settings::parse("old.toml", &text).unwrap().to_string();
        assert!(read.contains(&format!("\"user variable {number}\" = ")), "{text}{read}");
    }
}
