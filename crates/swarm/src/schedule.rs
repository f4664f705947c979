//! Faults of the wires and drives, with their times.

use polepair_core::time::Instant;
use polepair_drives::surroundings::Act;
use polepair_sim::random::{Ppm, Random};

use crate::wire::WireCondition;

/// Something that happens to a wire.
#[derive(Clone, Copy, Debug)]
pub struct WireDisturbance {
    /// Time.
    pub at: Instant,
    /// To which wire.
    pub wire: usize,
    /// Condition of the wire from then on.
    pub condition: WireCondition,
}

/// Something that happens to a drive, and ends what its motor does.
#[derive(Clone, Copy, Debug)]
pub struct DriveEvent {
    /// Time.
    pub at: Instant,
    /// To which axis.
    pub axis: usize,
    /// The event.
    pub kind: DriveEventKind,
}

/// Event of a drive.
#[derive(Clone, Copy, Debug)]
pub enum DriveEventKind {
    /// An act that lasts to the end of the world: a released motor turns again without a command.
    Act(Act),
    /// Another host begins to load a program into it, and goes: it stores each request from then on.
    Download,
}

/// Plans the events of drives until `calm`, in order.
pub fn plan_drive_events(
    random: &mut Random,
    axes: usize,
    begin: Instant,
    calm: Instant,
) -> Vec<DriveEvent> {
    let span = calm.since(begin).as_millis() as i64;
    let mut events = Vec::new();
    for axis in 0..axes {
        if random.chance(Ppm(600_000)) {
            continue;
        }
        let at = begin.plus_ms(random.between(300, span) as u32);
        let kind = match random.below(6) {
            0 => DriveEventKind::Act(Act::Jam(true)),
            1 => DriveEventKind::Act(Act::PowerCycle),
            2 | 3 => DriveEventKind::Download,
            _ => {
                let at = random.between(-300, 900) as f64 / 100.0;
                DriveEventKind::Act(Act::Switch { which: 1, at })
            }
        };
        events.push(DriveEvent { at, axis, kind });
    }
    events.sort_by_key(|event| event.at);
    events
}

/// All calamities of a world, in order; from `calm` on every wire is well.
pub fn plan_disturbances(
    random: &mut Random,
    wires: usize,
    begin: Instant,
    calm: Instant,
) -> Vec<WireDisturbance> {
    let mut all = Vec::new();
    for wire in 0..wires {
        let mut at = begin.plus_ms(random.between(300, 2500) as u32);
        // One world in eight has no such wire: it shows what works.
        if random.chance(Ppm(125_000)) {
            continue;
        }
        while at < calm {
            let (condition, lasts) = random_condition(random);
            let ends = at.plus_ms(lasts).min(calm);
            if random.chance(Ppm(150_000)) {
                add_flapping(random, wire, at, ends, &mut all);
            } else {
                all.push(WireDisturbance { at, wire, condition });
                // A port that comes back may still drop who opens it, or be silent.
                if random.chance(Ppm(250_000)) {
                    let half = at.plus_ns(ends.since(at).as_nanos() as u64 / 2);
                    let condition = random_condition(random).0;
                    all.push(WireDisturbance { at: half, wire, condition });
                }
            }
            all.push(WireDisturbance { at: ends, wire, condition: WireCondition::Working });
            at = ends.plus_ms(random.between(100, 4000) as u32);
        }
    }
    all.sort_by_key(|calamity| calamity.at);
    all
}

/// A calamity, and how long it lasts, ms.
fn random_condition(random: &mut Random) -> (WireCondition, u32) {
    let condition = match random.below(12) {
        0..3 => WireCondition::Gone,
        3..5 => WireCondition::Drops(random.pick(&[0, 1, 5, 30, 120, 300])),
        5..7 => WireCondition::Silent { to_drives: true, to_host: true },
        7 => WireCondition::Silent { to_drives: true, to_host: false },
        8 => WireCondition::Silent { to_drives: false, to_host: true },
        9 | 10 => WireCondition::Busy,
        _ => WireCondition::Slow(random.pick(&[5, 40, 150, 400, 900])),
    };
    let lasts = match random.below(3) {
        0 => random.between(10, 300),
        1 => random.between(300, 1500),
        _ => random.between(1500, 7000),
    };
    (condition, lasts as u32)
}

/// Cut and back, again and again.
fn add_flapping(
    random: &mut Random,
    wire: usize,
    mut at: Instant,
    ends: Instant,
    all: &mut Vec<WireDisturbance>,
) {
    while at < ends {
        let bad = if random.chance(Ppm(700_000)) {
            WireCondition::Gone
        } else {
            random_condition(random).0
        };
        all.push(WireDisturbance { at, wire, condition: bad });
        at = at.plus_ms(random.between(5, 400) as u32).min(ends);
        all.push(WireDisturbance { at, wire, condition: WireCondition::Working });
        at = at.plus_ms(random.between(5, 600) as u32);
    }
}
