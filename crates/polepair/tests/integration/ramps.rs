//! Ramps of drives that take the duration of a ramp as a setting.

use polepair::{LocalAxis, LocalLink};
use polepair_core::axis::{Command, Verb};
use std::f64::consts::TAU;

const RPM: f64 = TAU / 60.0;

fn open(url: &str) -> LocalLink {
    polepair::connect_local(url).unwrap_or_else(|error| panic!("{url}: {error}"))
}

fn read(axis: &LocalAxis, name: &str) -> i64 {
    axis.read(axis.find(name).unwrap()).unwrap()
}

fn turn(verb: Verb) -> Command {
    Command { target: Some(TAU), ..Command::new(verb) }
}

#[test]
fn path_32_gets_the_times_to_the_speed_of_its_command() {
    let link = open("sim:modbus-rtu?fn00=14&time=virtual");
    let axis = &link.axes()[0];
    let _armed = axis.armed().unwrap();
    let with = Command {
        velocity: Some(600.0 * RPM),
        acceleration: Some(2000.0 * RPM),
        deceleration: Some(6000.0 * RPM),
        ..turn(Verb::MoveBy)
    };
    axis.run(with).unwrap();
    assert_eq!(read(axis, "path 32 acceleration time"), 300);
    assert_eq!(read(axis, "path 32 deceleration time"), 100);
    // Without a velocity the path has 300 rpm.
    axis.run(Command { velocity: None, ..with }).unwrap();
    assert_eq!(read(axis, "path 32 acceleration time"), 150);
    assert_eq!(read(axis, "path 32 deceleration time"), 50);
    axis.run(turn(Verb::MoveBy)).unwrap();
    assert_eq!(read(axis, "path 32 acceleration time"), 200, "the plan's own");
}

#[test]
fn the_s_time_of_a_path_is_refused_where_the_ramp_is_too_short() {
    let link = open("sim:modbus-rtu?fn00=14&time=virtual");
    let axis = &link.axes()[0];
    let _armed = axis.armed().unwrap();
    axis.run(Command { jerk_time: Some(0.05), ..turn(Verb::CurveBy) }).unwrap();
    assert_eq!(read(axis, "path 32 s-time"), 50);
    axis.run(Command::new(Verb::Reached)).unwrap();
    let refused = axis.run(Command { jerk_time: Some(0.1), ..turn(Verb::CurveBy) }).unwrap_err();
    assert!(refused.to_string().contains("needs a ramp of more than 200 ms"), "{refused}");
    assert_eq!(read(axis, "path 32 s-time"), 50, "nothing was written");
    axis.run(turn(Verb::MoveBy)).unwrap();
    assert_eq!(read(axis, "path 32 s-time"), 0, "a plain move has trapezoidal ramps");
}

#[test]
fn the_objects_of_the_ts_get_the_times_to_3000_rpm() {
    let link = open("sim:syntron-ts-canopen:2?fn00=20&time=virtual");
    let axis = &link.axes()[0];
    let _armed = axis.armed().unwrap();
    let with = Command {
        acceleration: Some(6000.0 * RPM),
        deceleration: Some(12000.0 * RPM),
        ..turn(Verb::MoveBy)
    };
    axis.run(with).unwrap();
    assert_eq!(read(axis, "profile acceleration"), 500);
    assert_eq!(read(axis, "profile deceleration"), 250);
    let spin = Command {
        velocity: Some(100.0 * RPM),
        acceleration: Some(3000.0 * RPM),
        ..Command::new(Verb::Velocity)
    };
    axis.run(spin).unwrap();
    assert_eq!(read(axis, "profile acceleration"), 1000);
    assert_eq!(read(axis, "profile deceleration"), 250, "not given");
}

#[test]
fn an_acceleration_without_an_end_is_refused_before_a_byte() {
    let link = open("sim:modbus-rtu?fn00=14&time=virtual");
    let axis = &link.axes()[0];
    let _armed = axis.armed().unwrap();
    // The gear that scales the target is read once.
    axis.run(turn(Verb::MoveBy)).unwrap();
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-9] {
        let before = link.counters(axis);
        let error = axis.run(Command { acceleration: Some(bad), ..turn(Verb::MoveBy) });
        assert!(error.is_err(), "{bad}");
        assert_eq!(link.counters(axis), before, "{bad}");
    }
}

#[test]
fn a_cia402_drive_has_a_deceleration_of_its_own() {
    let link = open("sim:cia402:5?time=virtual");
    let axis = &link.axes()[0];
    let _armed = axis.armed().unwrap();
    let both =
        Command { acceleration: Some(100.0), deceleration: Some(300.0), ..turn(Verb::MoveBy) };
    axis.run(both).unwrap();
    let (up, down) = (read(axis, "profile acceleration"), read(axis, "profile deceleration"));
    assert!((down as f64 / up as f64 - 3.0).abs() < 0.01, "{up} {down}");
}
