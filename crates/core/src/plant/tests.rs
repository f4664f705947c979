extern crate std;

use super::*;
use std::vec::Vec;

const NO_LOAD: Conditions = Conditions { bus: 24.0, load: 0.0 };

fn enabled_servo() -> (Motor, Servo) {
    let motor = Motor::new(MotorParameters::BLDC_24V);
    let mut servo = Servo::new(motor.parameters());
    servo.enable(&motor);
    (motor, servo)
}

#[test]
fn a_velocity_step_settles_without_error_and_obeys_its_limits() {
    let (mut motor, mut servo) = enabled_servo();
    servo.max_current = 5.0;
    servo.set_goal(Goal::Velocity(200.0));
    let (mut before, mut fastest, mut strongest) = (0.0, 0.0f64, 0.0f64);
    for tick in 0..2000 {
        let load = if tick < 1000 { 0.0 } else { -0.05 };
        servo.step(&mut motor, Conditions { bus: 24.0, load });
        if tick % 20 == 0 {
            strongest = strongest.max((motor.velocity() - before) / (20.0 * TICK_S));
            before = motor.velocity();
        }
        fastest = fastest.max(motor.velocity());
        assert!(motor.current().abs() <= 5.0 + 1e-9, "current {}", motor.current());
        assert!(motor.voltage().abs() <= 24.0 + 1e-9, "voltage {}", motor.voltage());
    }
    assert!((motor.velocity() - 200.0).abs() < 1e-3, "settled at {}", motor.velocity());
    assert!(fastest < 202.0, "overshoot to {fastest}");
    assert!(strongest < 1100.0, "acceleration {strongest}");
}

#[test]
fn the_energy_balance_is_exact_whatever_happens() {
    let (mut motor, mut servo) = enabled_servo();
    let mut moved = 0.0f64;
    for tick in 0..20_000u32 {
        match tick {
            500 => servo.set_goal(Goal::Velocity(300.0)),
            2_000 => servo.set_goal(Goal::Velocity(-300.0)),
            4_000 => servo.set_goal_from(&motor, Goal::Current(3.0)),
            6_000 => servo.disable(),
            8_000 => servo.enable(&motor),
            9_000 => servo.set_goal_from(&motor, Goal::Position(50.0)),
            11_000 => motor.set_jammed(true),
            12_000 => motor.set_jammed(false),
            13_000 => servo.set_goal(Goal::Voltage(20.0)),
            15_000 => servo.set_goal(Goal::Voltage(-20.0)),
            17_000 => servo.set_goal_from(&motor, Goal::Velocity(0.0)),
            _ => {}
        }
        let load = if tick % 3000 < 1500 { -0.1 } else { 0.08 };
        let before = motor.energy();
        servo.step(&mut motor, Conditions { bus: 24.0, load });
        moved += (motor.energy().electrical - before.electrical).abs();
        assert!(
            motor.energy().copper >= before.copper && motor.energy().friction >= before.friction
        );
        assert!(
            motor.energy_error().abs() < 1e-9 * (1.0 + moved),
            "tick {tick}: {}",
            motor.energy_error()
        );
    }
    assert!(moved > 50.0, "only {moved} J went in: the test tests nothing");
}

#[test]
fn energy_never_appears_from_nothing() {
    let mut motor = Motor::new(MotorParameters::BLDC_24V);
    for _ in 0..300 {
        motor.step(Inputs { winding: Winding::Voltage(24.0), bus: 24.0, load: 0.0 });
    }
    let given = motor.energy().electrical;
    for winding in [Winding::Current(-20.0), Winding::Open] {
        for _ in 0..200 {
            motor.step(Inputs { winding, bus: 24.0, load: 0.0 });
            let back = given - motor.energy().electrical;
            assert!(winding != Winding::Open || back < given);
        }
    }
    let mut motor = Motor::new(MotorParameters::BLDC_24V);
    for _ in 0..300 {
        motor.step(Inputs { winding: Winding::Voltage(24.0), bus: 24.0, load: 0.0 });
    }
    let mut stored = motor.stored_energy();
    for _ in 0..5000 {
        motor.step(Inputs { winding: Winding::Open, bus: 24.0, load: 0.0 });
        assert!(motor.stored_energy() <= stored, "a coasting motor gained energy");
        stored = motor.stored_energy();
    }
    assert_eq!(motor.velocity(), 0.0);
}

#[test]
fn it_sticks_and_does_not_creep() {
    let mut motor = Motor::new(MotorParameters::BLDC_24V);
    for _ in 0..10_000 {
        motor.step(Inputs { winding: Winding::Open, bus: 24.0, load: 0.0129 });
    }
    assert_eq!((motor.position(), motor.velocity()), (0.0, 0.0));
    motor.step(Inputs { winding: Winding::Open, bus: 24.0, load: 0.0131 });
    assert!(motor.velocity() > 0.0, "broken loose, it moves");
}

#[test]
fn it_coasts_to_rest_and_stays() {
    let (mut motor, mut servo) = enabled_servo();
    servo.set_goal(Goal::Velocity(100.0));
    (0..500).for_each(|_| servo.step(&mut motor, NO_LOAD));
    servo.disable();
    servo.step(&mut motor, NO_LOAD);
    assert!(motor.velocity() > 95.0 && motor.current() == 0.0);
    (0..5000).for_each(|_| servo.step(&mut motor, NO_LOAD));
    let rest = motor.position();
    (0..5000).for_each(|_| servo.step(&mut motor, NO_LOAD));
    assert_eq!((motor.position(), motor.velocity()), (rest, 0.0));
}

#[test]
fn a_low_bus_caps_the_speed_and_the_loop_does_not_wind_up() {
    let (mut motor, mut servo) = enabled_servo();
    servo.set_goal(Goal::Velocity(600.0));
    (0..4000).for_each(|_| servo.step(&mut motor, NO_LOAD));
    let top = motor.velocity();
    assert!(top < 400.0 && top > 380.0, "24 V over 0.06 V·s less friction: {top}");
    servo.set_goal(Goal::Velocity(100.0));
    let mut min = top;
    for _ in 0..2000 {
        servo.step(&mut motor, NO_LOAD);
        min = min.min(motor.velocity());
    }
    assert!((motor.velocity() - 100.0).abs() < 1e-2);
    assert!(min > 85.0, "undershoot to {min}");
}

#[test]
fn a_jammed_motor_stalls_at_its_current_limit() {
    let (mut motor, mut servo) = enabled_servo();
    servo.max_current = 4.0;
    let mut stall = StallDetector::after(200);
    servo.set_goal(Goal::Velocity(100.0));
    for _ in 0..1000 {
        servo.step(&mut motor, NO_LOAD);
        assert!(!stall.step(motor.velocity(), motor.current(), servo.max_current));
    }
    motor.set_jammed(true);
    let tripped = (0..1000).position(|_| {
        servo.step(&mut motor, NO_LOAD);
        stall.step(motor.velocity(), motor.current(), servo.max_current)
    });
    assert!(tripped.is_some_and(|ticks| (199..260).contains(&ticks)), "{tripped:?}");
    assert!((motor.current() - 4.0).abs() < 1e-6);
}

#[test]
fn a_move_arrives_and_rests() {
    let (mut motor, mut servo) = enabled_servo();
    servo.set_limits(Limits::trapezoid(200.0, 2000.0));
    servo.set_goal(Goal::Position(25.0));
    (0..2000).for_each(|_| servo.step(&mut motor, NO_LOAD));
    assert!((motor.position() - 25.0).abs() < 2e-3, "{}", motor.position());
    let rest = motor.position();
    (0..20_000).for_each(|_| servo.step(&mut motor, NO_LOAD));
    assert!((motor.position() - rest).abs() < 1e-3, "it hunts: {rest} {}", motor.position());
}

#[test]
fn a_limit_that_is_lowered_and_raised_on_the_way_makes_no_leap() {
    let (mut motor, mut servo) = enabled_servo();
    servo.set_limits(Limits::trapezoid(100.0, 200.0));
    servo.set_goal(Goal::Position(200.0));
    let mut before = 0.0;
    for tick in 0..900 {
        match tick {
            400 => servo.set_limits(Limits::trapezoid(4.0, 200.0)),
            460 => servo.set_limits(Limits::trapezoid(30.0, 200.0)),
            _ => {}
        }
        servo.step(&mut motor, NO_LOAD);
        if tick % 10 == 0 {
            let change = (motor.velocity() - before).abs() / (10.0 * TICK_S);
            assert!(change < 400.0, "tick {tick}: {change} rad/s²");
            before = motor.velocity();
        }
    }
}

fn run_ticks(trajectory: &mut Trajectory, ticks: usize) -> Vec<Setpoint> {
    (0..ticks).map(|_| trajectory.step()).collect()
}

#[test]
fn a_trapezoid_arrives_exactly_without_overshoot() {
    let limits =
        Limits { velocity: 50.0, acceleration: 300.0, deceleration: 700.0, smoothing_s: 0.0 };
    for target in [1e-7, 3.3e-4, 0.01, 0.7, 5.0, 123.456, -0.02, -77.7] {
        let mut t = Trajectory::new(limits, 0.0);
        t.set_position_goal(target);
        let path = run_ticks(&mut t, 4000);
        assert_eq!(path[3999].position, target);
        assert!(t.arrived());
        let mut before = Setpoint::default();
        for s in &path {
            assert!(s.position.abs() <= target.abs(), "{target}: overshoot {}", s.position);
            assert!(s.velocity.abs() <= 50.0 + 1e-9);
            let change = s.velocity.abs() - before.velocity.abs();
            assert!((-0.7 - 1e-6..=0.3 + 1e-9).contains(&change), "{target}: {change}");
            before = *s;
        }
    }
}

#[test]
fn an_s_curve_arrives_exactly_with_bounded_jerk() {
    for (smoothing_s, target) in [(0.02, 5.0), (0.1, 30.0), (0.25, -40.0), (1.0, 12.0), (0.1, 0.01)]
    {
        let limits =
            Limits { velocity: 50.0, acceleration: 300.0, deceleration: 300.0, smoothing_s };
        let mut t = Trajectory::new(limits, 0.0);
        t.set_limits(limits);
        t.set_position_goal(target);
        let path = run_ticks(&mut t, 5000);
        assert_eq!(path[4999].position, target);
        assert!(t.arrived());
        for s in &path {
            assert!(s.position.abs() <= f64::abs(target) + 1e-9, "overshoot {}", s.position);
            assert!(s.velocity.abs() <= 50.0 + 1e-9, "{smoothing_s}: {}", s.velocity);
            assert!(s.acceleration.abs() <= 1.05 * 300.0, "{smoothing_s}: {}", s.acceleration);
        }
        let span = (smoothing_s / 4.0 / TICK_S) as usize;
        for pair in path.windows(span + 1) {
            let change = (pair[span].acceleration - pair[0].acceleration).abs();
            let jerk = change / (span as f64 * TICK_S);
            assert!(jerk <= 2.2 * 300.0 / smoothing_s, "{smoothing_s}: jerk {jerk}");
        }
    }
}

/// Swarm can:13500: after a stop within an S-curve, a set-point first comes to the speed that was
/// asked for, and is held to that.
#[test]
fn the_stop_of_an_s_curve_may_take_its_smoothing_time() {
    let limits =
        Limits { velocity: 50.0, acceleration: 300.0, deceleration: 300.0, smoothing_s: 0.08 };
    let mut t = Trajectory::new(limits, 0.0);
    t.set_position_goal(40.0);
    assert_eq!(t.smoothed_velocity(), 0.0);
    run_ticks(&mut t, 100);
    t.stop();
    let before = t.setpoint().velocity;
    let mut fastest = before;
    while !t.arrived() {
        let held_to = t.smoothed_velocity();
        let velocity = t.step().velocity;
        assert!(velocity <= held_to.max(fastest) + 1e-9, "{velocity}, held to {held_to}");
        fastest = fastest.max(velocity);
    }
    assert!(fastest > before + 1.0, "it went on for a while: {before} to {fastest}");
    run_ticks(&mut t, 200);
    assert_eq!(t.smoothed_velocity(), 0.0, "left behind");
}

/// Swarm can:1116971: a move by, and then a turning, with a lower speed came while an S-curve still gained speed.
#[test]
fn an_s_curve_that_is_held_to_less_in_flight_is_held_to_what_it_still_smooths() {
    for goal in [Goal::Position(4.0), Goal::Velocity(9.0)] {
        let (mut motor, mut servo) = enabled_servo();
        let limits = Limits { smoothing_s: 0.02, ..Limits::trapezoid(28.0, 1000.0) };
        servo.set_limits(limits);
        servo.set_goal(Goal::Velocity(28.0));
        let mut fly = |servo: &mut Servo, ticks| {
            let mut fastest = 0.0_f64;
            for _ in 0..ticks {
                let (before, held_to) = (servo.setpoint().velocity, servo.bounds().velocity);
                servo.step(&mut motor, Conditions { bus: 48.0, load: 0.0 });
                let velocity = servo.setpoint().velocity;
                assert!(velocity <= held_to.max(before) + 1e-6, "{velocity}, held to {held_to}");
                fastest = fastest.max(velocity);
            }
            fastest
        };
        let before = fly(&mut servo, 20);
        assert_eq!(servo.bounds().velocity, 28.0, "the limit, whatever rounding adds");
        servo.set_goal(goal);
        servo.set_limits(Limits { velocity: 9.0, ..limits });
        assert!(fly(&mut servo, 100) > before + 1.0, "it gained speed for a while");
        assert_eq!(servo.bounds().velocity, 9.0, "left behind");
    }
}

#[test]
fn a_new_goal_in_flight_is_met_from_where_it_is() {
    for smoothing_s in [0.0, 0.08] {
        let limits =
            Limits { velocity: 50.0, acceleration: 500.0, deceleration: 500.0, smoothing_s };
        let mut t = Trajectory::new(limits, 0.0);
        t.set_position_goal(40.0);
        let mut path = run_ticks(&mut t, 300);
        t.set_position_goal(2.0);
        path.extend(run_ticks(&mut t, 3000));
        t.set_velocity_goal(-20.0);
        path.extend(run_ticks(&mut t, 500));
        assert!((t.setpoint().velocity + 20.0).abs() < 1e-9 && t.arrived());
        t.stop();
        path.extend(run_ticks(&mut t, 500));
        assert_eq!(t.setpoint().velocity, 0.0);
        for pair in path.windows(2) {
            assert!((pair[1].velocity - pair[0].velocity).abs() <= 0.53, "{smoothing_s}: {pair:?}");
            assert!((pair[1].position - pair[0].position).abs() <= 0.05 + 1e-9);
        }
        assert_eq!(path[3299].position, 2.0);
    }
}

#[test]
fn no_ramp_is_a_step_and_a_speed_of_zero_goes_nowhere() {
    let mut t = Trajectory::new(Limits::trapezoid(50.0, 0.0), 0.0);
    t.set_velocity_goal(50.0);
    assert_eq!(t.step().velocity, 50.0);
    let mut t = Trajectory::new(Limits::trapezoid(0.0, 100.0), 1.0);
    t.set_position_goal(9.0);
    assert_eq!(run_ticks(&mut t, 100)[99].position, 1.0);
}

#[test]
fn a_body_warms_up_as_resistance_and_capacity_say() {
    let mut body = ThermalModel::new(2.0, 50.0, 25.0);
    (0..100_000).for_each(|_| body.step(10.0, TICK_S));
    let expected = 25.0 + 20.0 * (1.0 - libm::exp(-1.0));
    assert!((body.temperature() - expected).abs() < 0.01, "{}", body.temperature());
    body.step(10.0, 1e9);
    assert!((body.temperature() - 45.0).abs() < 1e-3);
}

#[test]
fn an_encoder_counts_both_ways_and_loses_what_it_did_not_see() {
    let turn = core::f64::consts::TAU;
    let mut encoder = Encoder::new(4096);
    assert_eq!(encoder.count(turn), 4096);
    assert_eq!(encoder.count(-turn / 4096.0), -1);
    encoder.reconfigure(turn, 4096, true);
    assert_eq!(encoder.count(turn), 4096, "a change of direction keeps the reading");
    assert_eq!(encoder.count(2.0 * turn), 0);
    encoder.set_broken(turn, true);
    assert_eq!(encoder.count(9.0 * turn), 4096);
    encoder.set_broken(9.0 * turn, false);
    assert_eq!(encoder.count(10.0 * turn), 0);
    encoder.preset(10.0 * turn, 711);
    assert_eq!(encoder.count(10.0 * turn), 711);
    assert!((encoder.position_of(711) - 10.0 * turn).abs() < 1e-9);
    assert!(encoder.index_between(0.9 * turn, 1.1 * turn));
    assert!(!encoder.index_between(1.1 * turn, 1.9 * turn));
}

#[test]
fn a_stepper_follows_its_field_until_the_load_is_too_much() {
    let parameters = StepperParameters::NEMA_17;
    let mut motor = Stepper::new(parameters);
    let mut field = 0.0;
    let mut run = |motor: &mut Stepper, ticks: u32, speed: f64, load: f64| {
        for _ in 0..ticks {
            field += speed * TICK_S;
            motor.step(StepperInputs { field, current: 1.1, bus: 24.0, load });
        }
        field - motor.position()
    };
    let period = core::f64::consts::TAU / 50.0;
    assert!(run(&mut motor, 2000, 10.0, 0.0).abs() < period / 4.0);
    assert!((motor.velocity() - 10.0).abs() < 0.5);
    assert!(motor.load_share() < 0.2, "{}", motor.load_share());
    assert!(run(&mut motor, 2000, 10.0, -0.25).abs() < period / 4.0, "a load within its torque");
    assert!(motor.load_share() > 0.5, "{}", motor.load_share());
    assert!(run(&mut motor, 2000, 10.0, -0.6) > period, "one beyond it");
    run(&mut motor, 3000, 0.0, 0.0);
    let lag = motor.lag() / period;
    assert!((lag - libm::round(lag)).abs() < 0.1 && motor.is_at_rest(), "{lag} whole periods");
}
