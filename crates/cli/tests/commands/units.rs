//! Meaning of a number without a unit, in each family.

use crate::run::{self, polepair};

const FAMILIES: [&str; 9] = [
    "sim:tmcl",
    "sim:tmcm-6110",
    "sim:tmcm-170",
    "sim:tml",
    "sim:tmlcan",
    "sim:modbus-rtu",
    "sim:canopen",
    "sim:thruster-servo",
    "sim:thruster-actuator",
];

#[test]
fn a_position_without_a_unit_is_refused_in_every_family() {
    for url in FAMILIES {
        for options in [&["90"][..], &["-0x10"], &["1e2", "--rel"], &["2.5", "--dry-run"]] {
            let refused = polepair(&[&["move", url], options].concat());
            assert_eq!((refused.code, &*refused.out), (2, ""), "{url} {options:?}: {refused:?}");
            let (number, err) = (options[0], &refused.err);
            assert!(err.contains("error[E217]"), "{url} {options:?}: {err}");
            assert!(err.contains(&format!("{number:?} has no unit")), "{url} {options:?}: {err}");
            assert!(err.contains("deg or ") && err.contains("--raw"), "{url} {options:?}: {err}");
        }
        // Zero is the same in all units.
        run::ok(&["move", url, "0", "--dry-run"]);
    }
}

/// A number after the manual's or the vendor's own symbol is sent to the drive unchanged.
#[test]
fn behind_the_makers_symbol_a_bare_number_is_the_drives_own() {
    for (url, written, shown) in [
        ("sim:tmcl", "AP 6=12", "max current = 1.2 A (12)"),
        ("sim:tmcl", "ap 6=0x0C", "max current = 1.2 A (12)"),
        ("sim:tmcl", "max current=12", "max current = 12 A (120)"),
        ("sim:tmcl", "AP 6=1.3A", "max current = 1.3 A (13)"),
        ("sim:tmcl+can", "AP 4=500", "max positioning velocity = 500 rpm (500)"),
        ("sim:tmcm-1260", "AP 4=20000", "max positioning velocity = 23.437 rpm (20000)"),
        ("sim:tmcm-1140", "AP 140=4", "microstep resolution = 16 (4)"),
        ("sim:tmcm-1140", "microstep resolution=4", "microstep resolution = 4 (2)"),
        ("sim:tml", "POSOKLIM=2", "settle band = 0.001 turn (2)"),
        ("sim:tml", "CSPD=20", "speed command = 600 rpm (20)"),
        ("sim:tmlcan", "CSPD=0.5", "speed command = 15 rpm (0.5)"),
        ("sim:technocan", "CTIME=5", "CTIME = 0.005 s (5)"),
        ("sim:tml", "GEAR=1.5", "gear ratio = 1.5"),
        ("sim:canopen", "0x6083=5000", "profile acceleration = 30 rpm/s (5000)"),
        ("sim:canopen", "6083h=0x1388", "profile acceleration = 30 rpm/s (5000)"),
    ] {
        assert_eq!(
            run::ok(&["set", url, written, "--arm"]),
            format!("{shown}\n"),
            "{url} {written}"
        );
    }
}

#[test]
fn a_value_between_two_counts_is_not_rounded() {
    for (url, written, hint) in [
        ("sim:tmcl", "AP 6=1.2", "try: write 1.2A, or 1.2 for `max current`"),
        ("sim:tml", "POSOKLIM=0.5", "try: write 0.5turn, or 0.5 for `settle band`"),
    ] {
        let refused = polepair(&["set", url, written]);
        assert_eq!((refused.code, &*refused.out), (2, ""), "{written}: {refused:?}");
        assert!(refused.err.contains("error[E217]") && refused.err.contains(hint), "{refused:?}");
    }
}

#[test]
fn a_plan_shows_the_drives_own_numbers_too() {
    let planned = run::ok(&["set", "sim:tmcl", "AP 6=12", "max current=10A", "--dry-run"]);
    assert!(planned.starts_with("max current: 10 A (100) -> 1.2 A (12)\n"), "{planned}");
    let planned = run::ok(&["set", "sim:tmcl", "AP 6=100", "--dry-run"]);
    assert_eq!(planned, "max current = 10 A (100), as it is\n");
}

#[cfg(unix)]
#[test]
fn a_length_turns_the_motor_by_the_mechanics_that_the_drive_stores() {
    let sim = run::Served::new("syntron-ts?fn00=14");
    let refused = polepair(&["move", &sim.url, "10mm"]);
    assert_eq!(refused.code, 2, "{}", refused.err);
    let why = "Fn_205 = 1 and Fn_206 = 360 are no travel in mm";
    assert!(refused.err.contains(why), "{}", refused.err);
    let set = polepair(&["set", &sim.url, "Fn_205=2", "Fn_206=5"]);
    assert_eq!(set.code, 0, "{}", set.err);
    let ran = polepair(&["move", &sim.url, "10mm", "--vel", "5mm/s"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(ran.err.contains("axis 1: 10mm is 1440 deg of the motor"), "{}", ran.err);
    assert!(ran.err.contains("axis 1: 5mm/s is 120 rpm of the motor"), "{}", ran.err);
    let place = polepair(&["get", &sim.url, "encoder position"]);
    let degrees = place.out.split_whitespace().find_map(|word| word.parse::<f64>().ok());
    assert!(degrees.is_some_and(|degrees| (degrees - 1440.0).abs() < 1.0), "{}", place.out);
    let angle = polepair(&["move", &sim.url, "0.5A"]);
    assert!(angle.code == 2 && angle.err.contains("error[E217]"), "{}", angle.err);
}
