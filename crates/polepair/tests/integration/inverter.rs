//! Inverters: drives of CiA 402 whose only speed mode is the velocity mode (mode 2).

use polepair::eds::{Eds, SheetValues};
use polepair::{LocalAxis, LocalLink, connect_local};
use polepair_core::profile::Signal;
use std::time::Duration;

const RPM: f64 = std::f64::consts::TAU / 60.0;

fn open(url: &str) -> LocalLink {
    connect_local(url).unwrap_or_else(|error| panic!("{url}: {error}"))
}

fn speed(axis: &LocalAxis) -> f64 {
    axis.signals(&[Signal::Velocity]).expect("a speed")[0].value / RPM
}

fn motor_speed(link: &LocalLink) -> f64 {
    link.simulation().expect("a simulation").truth(0, 0).expect("a motor").velocity / RPM
}

#[test]
fn an_inverter_is_recognized_by_its_modes_and_turns_in_rpm() {
    let link = open("sim:cia402-vl:5?time=virtual");
    let axis = &link.axes()[0];
    assert_eq!(axis.profile().name, "cia402-vl");
    axis.arm(true);
    axis.enable().expect("enabled");
    for rpm in [600.0, -300.0] {
        axis.velocity(rpm * RPM).expect("starts");
        link.sleep(Duration::from_secs(2));
        assert!((speed(axis) - rpm).abs() < 1.0, "{}", speed(axis));
        assert!((motor_speed(&link) - rpm).abs() < 1.0, "{}", motor_speed(&link));
    }
    axis.stop().expect("a measured standstill");
    assert!(motor_speed(&link).abs() < 0.5, "{}", motor_speed(&link));
    // Halt is taken back by the next speed, and not by enabling.
    axis.velocity(60.0 * RPM).expect("starts");
    link.sleep(Duration::from_secs(1));
    assert!((motor_speed(&link) - 60.0).abs() < 1.0, "{}", motor_speed(&link));
    axis.disable().expect("off");
    assert_eq!(axis.move_by("1 turn").expect_err("no positions").code(), "E218");
}

/// The generic drive has this mode too, and is moved by the others.
#[test]
fn a_servo_drive_is_no_inverter() {
    for url in ["sim:cia402:5?time=virtual", "sim:canopen:5?time=virtual"] {
        let link = open(url);
        assert_eq!(link.axes()[0].profile().name, "cia402", "{url}");
    }
}

#[test]
fn speeds_in_steps_of_the_drives_own_are_refused() {
    let link = open("sim:cia402-vl:5?time=virtual");
    let axis = &link.axes()[0];
    axis.set_raw("vl dimension divisor", 10).expect("a factor");
    axis.arm(true);
    axis.enable().expect("enabled");
    let refused = axis.velocity(60.0 * RPM).expect_err("not rpm");
    assert!(format!("{refused:?}").contains("604Ch"), "{refused:?}");
    link.sleep(Duration::from_secs(1));
    assert!(motor_speed(&link).abs() < 0.5);
}

#[test]
fn a_data_sheet_of_an_inverter_turns_it() {
    let link = open("sim:cia402-vl:5?time=virtual");
    let sheet = Eds::of_drive(&link.axes()[0], SheetValues::None, &mut |_, _| {}).expect("a sheet");
    let file = std::env::temp_dir().join(format!("polepair-inverter-{}.eds", std::process::id()));
    std::fs::write(&file, sheet.to_string()).expect("a file");
    let link = open(&format!("sim:canopen:5?eds={}&time=virtual", file.display()));
    let axis = &link.axes()[0];
    assert_eq!(speed(axis), 0.0);
    axis.arm(true);
    axis.enable().expect("enabled");
    axis.velocity(600.0 * RPM).expect("starts");
    link.sleep(Duration::from_secs(3));
    assert!((speed(axis) - 600.0).abs() < 1.0, "{}", speed(axis));
    let _ = std::fs::remove_file(file);
}
