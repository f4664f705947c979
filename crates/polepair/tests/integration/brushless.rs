//! Trinamic's brushless and servo modules, which are known from the maker's library: units, motion and faults.

use polepair::active_faults;
use polepair::{LocalAxis, LocalLink, connect_local};
use polepair_core::profile::Signal;
use polepair_drives::surroundings::Act;
use std::f64::consts::TAU;
use std::time::Duration;

/// The modules with units of positions, and the commutation mode of each by encoder.
const MODULES: [(&str, i64); 9] = [
    ("tmcm-1617", 3),
    ("tmcm-1630", 7),
    ("tmcm-1633", 7),
    ("tmcm-1636", 3),
    ("tmcm-1637", 3),
    ("tmcm-1638", 3),
    ("tmcm-1640", 7),
    ("tmcm-1670", 7),
    ("tmcm-2611", 3),
];

fn open(url: &str) -> (LocalLink, LocalAxis) {
    let link = connect_local(&format!("sim:{url}")).unwrap();
    let axis = link.axis(1).unwrap();
    (link, axis)
}

fn truth(link: &LocalLink) -> (f64, f64) {
    let truth = link.simulation().unwrap().truth(0, 0).unwrap();
    (truth.position, truth.velocity * 60.0 / TAU)
}

#[test]
fn every_brushless_module_turns_moves_and_stops() {
    for (name, mode) in MODULES {
        for medium in ["", "+can"] {
            let (link, axis) = open(&format!("{name}{medium}?time=virtual"));
            assert_eq!(axis.profile().name, name);
            assert_eq!(axis.get_raw("commutation mode").unwrap(), mode, "{name}");
            let armed = axis.armed().unwrap();
            armed.velocity("600 rpm").unwrap();
            link.sleep(Duration::from_secs(2));
            let shown = armed.signals(&[Signal::Velocity]).unwrap()[0].value * 60.0 / TAU;
            let (_, rpm) = truth(&link);
            assert!(
                (rpm - 600.0).abs() < 5.0 && (shown - rpm).abs() < 5.0,
                "{name}: {rpm} {shown}"
            );
            armed.stop().unwrap();
            assert!(truth(&link).1.abs() < 5.0, "{name}");
            let before = truth(&link).0;
            let from = armed.signals(&[Signal::Position]).unwrap()[0].value;
            armed.move_by("2.5 turn").unwrap();
            armed.wait(Duration::from_secs(30)).unwrap();
            let moved = truth(&link).0 - before;
            let to = armed.signals(&[Signal::Position]).unwrap()[0].value;
            assert!((moved - 2.5 * TAU).abs() < 0.05, "{name}: {moved}");
            assert!((to - from - moved).abs() < 0.02, "{name}: shown {}", to - from);
        }
    }
}

/// With commutation by hall sensors a turn has other counts. Each mode has its own factor, or none.
#[test]
fn positions_are_scaled_by_the_sensor_that_counts_them() {
    for name in ["tmcm-1630", "tmcm-1633", "tmcm-1640"] {
        let (link, axis) = open(&format!("{name}?time=virtual"));
        axis.set_raw("motor poles", 10).unwrap();
        let armed = axis.armed().unwrap();
        for (mode, counts) in [(7, 4096.0), (6, 30.0)] {
            armed.set_raw("commutation mode", mode).unwrap();
            armed.set_raw("actual position", 0).unwrap();
            let before = truth(&link).0;
            armed.move_to("3 turn").unwrap();
            armed.wait(Duration::from_secs(30)).unwrap();
            let raw = armed.get_raw("actual position").unwrap() as f64;
            assert!((raw - 3.0 * counts).abs() <= 5.0, "{name}, mode {mode}: {raw}");
            let moved = truth(&link).0 - before;
            assert!((moved - 3.0 * TAU).abs() < TAU * 6.0 / counts, "{name}, mode {mode}: {moved}");
        }
        // Open loop: no sensor counts, so there is no unit.
        armed.set_raw("commutation mode", 8).unwrap();
        let refused = armed.move_to("1 turn").unwrap_err();
        assert_eq!(refused.code(), "E217", "{refused}");
        assert!(refused.to_string().contains("no sensor"), "{refused}");
    }
    for name in ["tmcm-1617", "tmcm-1638", "tmcm-2611"] {
        let (link, axis) = open(&format!("{name}?time=virtual"));
        axis.set_raw("position scaler", 24).unwrap();
        let armed = axis.armed().unwrap();
        armed.move_to("2 turn").unwrap();
        armed.wait(Duration::from_secs(30)).unwrap();
        assert!((armed.get_raw("actual position").unwrap() - 48).abs() <= 5, "{name}");
        let moved = truth(&link).0;
        assert!((moved - 2.0 * TAU).abs() < 5.5 / 24.0 * TAU, "{name}: {moved}");
    }
}

/// Nothing explains the counts of one module: its positions are raw, its speeds are not.
#[test]
fn a_module_without_known_counts_takes_raw_positions_only() {
    let (link, axis) = open("tmcm-1690?time=virtual");
    let armed = axis.armed().unwrap();
    assert_eq!(armed.move_to("1 turn").unwrap_err().code(), "E217");
    armed.velocity("-300 rpm").unwrap();
    link.sleep(Duration::from_secs(1));
    assert!((truth(&link).1 + 300.0).abs() < 5.0);
}

#[test]
fn each_motor_of_a_module_turns_for_itself() {
    let link = connect_local("sim:tmcm-2611?time=virtual").unwrap();
    assert_eq!(link.axes().len(), 2);
    let [left, right] = ["1", "1.1"].map(|name| link.axis_named(name).unwrap().armed().unwrap());
    left.velocity("200 rpm").unwrap();
    right.velocity("-400 rpm").unwrap();
    link.sleep(Duration::from_secs(1));
    let speeds = [&left, &right].map(|axis| axis.get_raw("actual velocity").unwrap());
    assert!((speeds[0] - 200).abs() <= 3 && (speeds[1] + 400).abs() <= 3, "{speeds:?}");
    left.stop().unwrap();
    assert!(left.get_raw("actual velocity").unwrap().abs() <= 3);
    assert!((right.get_raw("actual velocity").unwrap() + 400).abs() <= 3);
}

#[test]
fn torque_is_a_current_and_the_limit_holds() {
    for (name, _) in MODULES {
        let (link, axis) = open(&format!("{name}?time=virtual"));
        axis.set("max current", "1 A").unwrap();
        link.simulation().unwrap().act(0, 0, Act::Jam(true));
        let armed = axis.armed().unwrap();
        for (wanted, expected) in [("0.4 A", 0.4), ("5 A", 1.0)] {
            armed.torque(wanted).unwrap();
            link.sleep(Duration::from_millis(200));
            let current = armed.signals(&[Signal::Current]).unwrap()[0].value;
            assert!((current - expected).abs() < 0.05, "{name}: {wanted} is {current}");
        }
    }
}

/// The flags are those of the TMCM-1690, whose class names them; the TMCM-2611's are not explained, so that no fault is
/// claimed for it, and its motor at rest is noticed.
#[test]
fn faults_switch_the_motor_off_and_are_shown() {
    for (name, _) in MODULES.into_iter().filter(|(name, _)| *name != "tmcm-2611") {
        let (link, axis) = open(&format!("{name}?time=virtual"));
        let armed = axis.armed().unwrap();
        armed.velocity("300 rpm").unwrap();
        link.sleep(Duration::from_secs(1));
        link.simulation().unwrap().act(0, 0, Act::Supply(7.0));
        link.sleep(Duration::from_secs(3));
        assert!(truth(&link).1.abs() < 5.0, "{name} turns on");
        let faults = || {
            let raw = axis.get_raw("status flags").unwrap();
            let faults = active_faults(axis.profile(), raw & 0xEF);
            faults.iter().map(|fault| fault.name.to_string()).collect::<Vec<_>>()
        };
        assert_eq!(faults(), ["UNDERVOLTAGE"], "{name}");
        assert!(armed.velocity("300 rpm").is_err(), "{name}");
        link.simulation().unwrap().act(0, 0, Act::Supply(24.0));
        assert!(faults().is_empty(), "{name}");
        armed.velocity("300 rpm").unwrap();
        link.sleep(Duration::from_secs(1));
        assert!((truth(&link).1 - 300.0).abs() < 5.0, "{name}");
    }
}

#[test]
fn a_disabled_module_refuses_to_turn() {
    for (name, _) in MODULES {
        let (link, axis) = open(&format!("{name}?time=virtual"));
        let armed = axis.armed().unwrap();
        armed.enable().unwrap();
        armed.disable().unwrap();
        let refused = armed.velocity("100 rpm").unwrap_err();
        assert!(refused.to_string().contains("refused"), "{name}: {refused}");
        link.sleep(Duration::from_secs(1));
        assert_eq!(truth(&link).1, 0.0, "{name}");
        armed.enable().unwrap();
        armed.velocity("100 rpm").unwrap();
    }
}
