//! Limits of set-points, and times by size.

use super::{Bounds, Excess, Setpoint, Spread, Trend};
use core::time::Duration;

const MS: f64 = 1e-3;

#[test]
fn a_step_is_held_to_every_bound() {
    let bounds = Bounds {
        position: Some((-1.0, 1.0)),
        velocity: Some(10.0),
        acceleration: Some(2_000.0),
        torque: Some(0.5),
    };
    let mut path = Trend::resting(0.99);
    let mut position = |next| path.take(&bounds, Setpoint::Position, next, MS);
    assert_eq!(position(1.001), Err(Excess::Position));
    assert_eq!(position(0.97), Err(Excess::Velocity));
    assert_eq!(position(0.987), Err(Excess::Acceleration), "3 m/s at once");
    assert_eq!(position(f64::NAN), Err(Excess::Number));
    assert_eq!(position(0.9885), Ok(()));
    assert_eq!(position(0.986), Ok(()), "faster again");
    assert_eq!(position(0.99), Err(Excess::Acceleration), "and not back at once");
    let mut speed = Trend::resting(0.0);
    assert_eq!(speed.take(&bounds, Setpoint::Velocity, 1.0, MS), Ok(()));
    assert!(!speed.may_end(Setpoint::Velocity));
    assert_eq!(speed.take(&bounds, Setpoint::Velocity, 4.0, MS), Err(Excess::Acceleration));
    assert_eq!(speed.take(&bounds, Setpoint::Velocity, -11.0, 1.0), Err(Excess::Velocity));
    let mut torque = Trend::resting(0.0);
    assert_eq!(torque.take(&bounds, Setpoint::Torque, 0.5, MS), Ok(()));
    assert_eq!(torque.take(&bounds, Setpoint::Torque, 0.6, MS), Err(Excess::Torque));
    assert!(torque.take(&bounds, Setpoint::Torque, 0.0, MS).is_ok());
    assert!(torque.may_end(Setpoint::Torque));
}

#[test]
fn the_middle_of_many_times_is_known_to_an_eighth() {
    let mut spread = Spread::new();
    assert_eq!(spread.summary(), None);
    for ns in [7, 1_000, 1_000_000, 50_000, 3_000_000_000] {
        spread.note(ns);
    }
    let (least, middle, most) = spread.summary().unwrap();
    assert_eq!((least, most), (Duration::from_nanos(7), Duration::from_secs(3)));
    let middle = middle.as_nanos();
    assert!((43_750..=50_000).contains(&middle), "{middle}");
    let mut one = Spread::new();
    one.note(u64::MAX);
    assert_eq!(one.summary().unwrap().1.as_nanos(), u128::from(u64::MAX));
}
