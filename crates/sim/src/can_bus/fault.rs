//! Faults of a CAN bus, with their probabilities.
//!
//! The CRC and the acknowledgement exclude damaged frames, so these faults are losses, delays and
//! repetitions. Numbers of the fault model: F1 disturbed bit, F2 cut payload, F3 repeated frame, F4 late
//! frame, F5 lost frame, F6 echo of the adapter. Other faults are caused at controllers and drives: F8 two
//! drives with one address, F9 controller in bus-off or a busy bus, F14 drive without supply, F21 second
//! program on the bus, F25 frame of an intruder.

use crate::random::{Ppm, Random};

/// Faults of a CAN bus. Chances are per frame, or per frame and receiver.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct CanFaults {
    /// A disturbed bit: an error frame ends it, and its sender repeats it by itself (F1).
    pub error: Ppm,
    /// Disturbed in its last bit, which its sender alone notices: receivers take it, it is
    /// repeated, and they take it again (F3).
    pub last_bit: Ppm,
    /// A receiver's controller or adapter drops it, while others acknowledge it (F5).
    pub lose: Ppm,
    /// An adapter hands a drive's frame to its host late, and whatever comes behind it (F4).
    pub late: Ppm,
    /// The latest of those, ms.
    pub late_max_ms: u32,
    /// The one it is meant for sees a shorter payload (F2), as behind a gateway with a fault: on the
    /// bus itself the CRC forbids it.
    pub cut: Ppm,
    /// A host's adapter hands it its own frames too (F6).
    pub echo: bool,
}

/// Number of faults were made on a CAN bus, by kind.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct InjectedCanFaults {
    /// Frames ended by an error frame.
    pub errors: u64,
    /// Frames that met another of their own identifier.
    pub collided: u64,
    /// Frames taken twice.
    pub taken_twice: u64,
    /// Frames that one receiver did not get.
    pub lost: u64,
    /// Frames that a host got late.
    pub late: u64,
    /// Frames that one receiver got with a shorter payload.
    pub cut: u64,
    /// Controllers that went bus-off.
    pub bus_off: u64,
    /// Frames of intruders.
    pub intruder_frames: u64,
}

impl InjectedCanFaults {
    /// Adds another count to this one.
    pub fn add(&mut self, other: &Self) {
        self.errors += other.errors;
        self.collided += other.collided;
        self.taken_twice += other.taken_twice;
        self.lost += other.lost;
        self.late += other.late;
        self.cut += other.cut;
        self.bus_off += other.bus_off;
        self.intruder_frames += other.intruder_frames;
    }
}

impl CanFaults {
    /// A set drawn from `random`; late frames come within `late_max_ms`. Each kind is on or off by
    /// the toss of a coin, so that no kind hides behind another.
    pub fn random(random: &mut Random, late_max_ms: u32) -> Self {
        Self {
            error: random_chance(random, &[1_000, 10_000, 100_000]),
            last_bit: random_chance(random, &[500, 2_000, 20_000]),
            lose: random_chance(random, &[500, 2_000, 10_000]),
            late: random_chance(random, &[500, 2_000, 10_000]),
            late_max_ms,
            cut: random_chance(random, &[500, 2_000, 10_000]),
            echo: random.chance(Ppm(200_000)),
        }
    }
}

/// Off one time in two, else one of `choices`.
fn random_chance(random: &mut Random, choices: &[u32]) -> Ppm {
    if random.chance(Ppm(500_000)) { Ppm(random.pick(choices)) } else { Ppm::NEVER }
}
