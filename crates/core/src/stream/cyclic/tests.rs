//! Limits of set-points, and times by size.

use super::{BoundsViolation, DurationHistogram, SetpointBounds, SetpointKind, SetpointTracker};
use core::time::Duration;

const MS: f64 = 1e-3;

#[test]
fn a_step_is_held_to_every_bound() {
    let bounds = SetpointBounds {
        position: Some((-1.0, 1.0)),
        velocity: Some(10.0),
        acceleration: Some(2_000.0),
        torque: Some(0.5),
    };
    let mut path = SetpointTracker::at_rest(0.99);
    let mut position = |next| path.accept(&bounds, SetpointKind::Position, next, MS);
    assert_eq!(position(1.001), Err(BoundsViolation::Position));
    assert_eq!(position(0.97), Err(BoundsViolation::Velocity));
    assert_eq!(position(0.987), Err(BoundsViolation::Acceleration), "3 m/s at once");
    assert_eq!(position(f64::NAN), Err(BoundsViolation::NotANumber));
    assert_eq!(position(0.9885), Ok(()));
    assert_eq!(position(0.986), Ok(()), "faster again");
    assert_eq!(position(0.99), Err(BoundsViolation::Acceleration), "and not back at once");
    let mut speed = SetpointTracker::at_rest(0.0);
    assert_eq!(speed.accept(&bounds, SetpointKind::Velocity, 1.0, MS), Ok(()));
    assert!(!speed.may_end(SetpointKind::Velocity));
    assert_eq!(
        speed.accept(&bounds, SetpointKind::Velocity, 4.0, MS),
        Err(BoundsViolation::Acceleration)
    );
    assert_eq!(
        speed.accept(&bounds, SetpointKind::Velocity, -11.0, 1.0),
        Err(BoundsViolation::Velocity)
    );
    let mut torque = SetpointTracker::at_rest(0.0);
    assert_eq!(torque.accept(&bounds, SetpointKind::Torque, 0.5, MS), Ok(()));
    assert_eq!(torque.accept(&bounds, SetpointKind::Torque, 0.6, MS), Err(BoundsViolation::Torque));
    assert!(torque.accept(&bounds, SetpointKind::Torque, 0.0, MS).is_ok());
    assert!(torque.may_end(SetpointKind::Torque));
}

#[test]
fn the_middle_of_many_times_is_known_to_an_eighth() {
    let mut spread = DurationHistogram::new();
    assert_eq!(spread.summary(), None);
    for ns in [7, 1_000, 1_000_000, 50_000, 3_000_000_000] {
        spread.record(ns);
    }
    let (min, middle, max) = spread.summary().unwrap();
    assert_eq!((min, max), (Duration::from_nanos(7), Duration::from_secs(3)));
    let middle = middle.as_nanos();
    assert!((43_750..=50_000).contains(&middle), "{middle}");
    let mut one = DurationHistogram::new();
    one.record(u64::MAX);
    assert_eq!(one.summary().unwrap().1.as_nanos(), u128::from(u64::MAX));
}
