//! A velocity step of the simulated motor at default gains, as CSV, or as a picture.
//!
//! ```text
//! cargo run --example velocity_step > step.csv
//! cargo run --example velocity_step -- --svg > docs/images/velocity-step.svg
//! ```
//! Twice the same step: with the current that the motor bears, and with less than the ramp needs.

use polepair_core::plant::{Conditions, Goal, Limits, Motor, MotorParameters, Servo, TICK_S};
use std::fmt::Write as _;

const SPEED_RAD_PER_S: f64 = 150.0;
const RAMP_RAD_PER_S2: f64 = 1000.0;
const LOAD_NM: f64 = 0.05;
const LOAD_AT_S: f64 = 0.5;
const END_S: f64 = 0.8;
/// Current limits of the two runs, A: what the motor bears, and less than the ramp needs.
const LIMITS_A: [f64; 2] = [20.0, 1.2];

/// One instant of a run.
struct Sample {
    time: f64,
    setpoint: f64,
    velocity: f64,
    current: f64,
    voltage: f64,
}

fn run(limit: f64) -> Vec<Sample> {
    let mut motor = Motor::new(MotorParameters::BLDC_24V);
    let mut servo = Servo::new(motor.parameters());
    servo.max_current = limit;
    servo.set_limits(Limits::trapezoid(1e4, RAMP_RAD_PER_S2));
    servo.enable(&motor);
    servo.set_goal(Goal::Velocity(SPEED_RAD_PER_S));
    let sample = |tick: u32| {
        let time = f64::from(tick) * TICK_S;
        let load = if time < LOAD_AT_S { 0.0 } else { -LOAD_NM };
        servo.step(&mut motor, Conditions { bus: 24.0, load });
        Sample {
            time,
            setpoint: servo.setpoint().velocity,
            velocity: motor.velocity(),
            current: motor.current(),
            voltage: motor.voltage(),
        }
    };
    (0..(END_S / TICK_S) as u32).map(sample).collect()
}

fn main() {
    let runs = LIMITS_A.map(run);
    if std::env::args().any(|word| word == "--svg") {
        return print!("{}", picture(&runs));
    }
    println!("limit [A],time [s],setpoint [rad/s],velocity [rad/s],current [A],voltage [V]");
    for (limit, run) in LIMITS_A.iter().zip(&runs) {
        for s in run {
            let Sample { time, setpoint, velocity, current, voltage } = s;
            println!("{limit},{time:.3},{setpoint:.3},{velocity:.3},{current:.4},{voltage:.3}");
        }
    }
}

/// A panel: where it lies and what its vertical axis shows.
struct Panel {
    title: &'static str,
    top: f64,
    max: f64,
    marks: &'static [f64],
}

const WIDTH: f64 = 720.0;
const LEFT: f64 = 56.0;
const HEIGHT: f64 = 170.0;

impl Panel {
    fn at(&self, time: f64, value: f64) -> (f64, f64) {
        let x = LEFT + time / END_S * (WIDTH - LEFT - 16.0);
        (x, self.top + HEIGHT * (1.0 - value / self.max))
    }

    fn frame(&self, out: &mut String) {
        let (left, right) = (self.at(0.0, 0.0).0, self.at(END_S, 0.0).0);
        let top = self.top - 10.0;
        line(
            out,
            &format!(r##"<text x="{left}" y="{top}" font-weight="bold">{}</text>"##, self.title),
        );
        for mark in self.marks {
            let y = self.at(0.0, *mark).1;
            line(out, &format!(r##"<path d="M{left} {y:.1}H{right}" stroke="#d0d7de"/>"##));
            let (x, y) = (left - 8.0, y + 4.0);
            line(out, &format!(r##"<text x="{x}" y="{y:.1}" text-anchor="end">{mark}</text>"##));
        }
    }

    fn curve(&self, out: &mut String, run: &[Sample], scan: &str, value: impl Fn(&Sample) -> f64) {
        let points = run.iter().map(|s| self.at(s.time, value(s)));
        let points: Vec<String> = points.map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
        line(out, &format!(r##"<polyline fill="none" {scan} points="{}"/>"##, points.join(" ")));
    }
}

fn line(out: &mut String, text: &str) {
    // Writing into a String cannot fail.
    let _ = writeln!(out, "{text}");
}

fn picture(runs: &[Vec<Sample>; 2]) -> String {
    let speed =
        Panel { title: "speed, rad/s", top: 40.0, max: 180.0, marks: &[0.0, 50.0, 100.0, 150.0] };
    let current =
        Panel { title: "current, A", top: 270.0, max: 2.0, marks: &[0.0, 0.5, 1.0, 1.5, 2.0] };
    let looks =
        [r##"stroke="#0969da" stroke-width="2""##, r##"stroke="#bc4c00" stroke-width="2""##];
    let grey = r##"stroke="#57606a" stroke-width="1.5" stroke-dasharray="5 4""##;
    let mut out = String::new();
    line(
        &mut out,
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 720 500" width="720" height="500" font-family="system-ui, sans-serif" font-size="13" fill="#24292f">"##,
    );
    line(&mut out, r##"<rect width="720" height="500" rx="6" fill="#ffffff" stroke="#d0d7de"/>"##);
    speed.frame(&mut out);
    current.frame(&mut out);
    speed.curve(&mut out, &runs[0], grey, |s| s.setpoint);
    for (run, scan) in runs.iter().zip(looks) {
        speed.curve(&mut out, run, scan, |s| s.velocity);
        current.curve(&mut out, run, scan, |s| s.current);
    }
    for tick in 0..=8 {
        let (x, y) = current.at(f64::from(tick) / 10.0, 0.0);
        let y = y + 18.0;
        line(
            &mut out,
            &format!(
                r##"<text x="{x:.1}" y="{y:.1}" text-anchor="middle">{:.1}</text>"##,
                f64::from(tick) / 10.0
            ),
        );
    }
    let keys = [("#57606a", "set-point"), ("#0969da", "limit 20 A"), ("#bc4c00", "limit 1.2 A")];
    for (n, (colour, word)) in keys.into_iter().enumerate() {
        let x = 300.0 + 130.0 * n as f64;
        line(
            &mut out,
            &format!(
                r##"<path d="M{x} 26h24" stroke="{colour}" stroke-width="2"/><text x="{}" y="30">{word}</text>"##,
                x + 30.0
            ),
        );
    }
    line(
        &mut out,
        r##"<text x="390" y="486" text-anchor="middle">time, s; a load of 0.05 Nm from 0.5 s on</text>"##,
    );
    out + "</svg>\n"
}
