//! Cost of the physics of a simulated drive: one tick of its servo loops and its motor.
//!
//! A tick is a millisecond of the drive's time, so a second of a drive costs a thousand of them.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use polepair_core::plant::{Conditions, Goal, Motor, MotorParameters, Servo};

/// Steps one motor on and on; `aim` is called each time this many ticks have passed.
fn ticks(c: &mut Criterion, name: &str, every: u32, mut aim: impl FnMut(&mut Servo)) {
    let mut motor = Motor::new(MotorParameters::BLDC_24V);
    let mut servo = Servo::new(motor.parameters());
    servo.enable(&motor);
    let mut tick = 0;
    c.bench_function(name, |b| {
        b.iter(|| {
            if tick % every == 0 {
                aim(&mut servo);
            }
            tick = (tick + 1) % every;
            servo.step(&mut motor, black_box(Conditions { bus: 24.0, load: 0.02 }));
            black_box(motor.velocity())
        });
    });
}

fn plant(c: &mut Criterion) {
    ticks(c, "a tick at constant speed", u32::MAX, |servo| servo.set_goal(Goal::Velocity(100.0)));
    let mut there = false;
    ticks(c, "a tick of moves back and forth", 1_000, |servo| {
        there = !there;
        servo.set_goal(Goal::Position(if there { 20.0 } else { 0.0 }));
    });
}

criterion_group!(benches, plant);
criterion_main!(benches);
