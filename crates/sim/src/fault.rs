//! Faults of a serial wire, with their probabilities.
//!
//! Each fault has its own probability; zero switches it off. [`SerialFaults::random`] draws a set by a
//! seed, as in swarm testing: each kind is on or off at random, so that no kind hides another.

use crate::random::{Ppm, Random};

/// Faults of one serial wire. Chances are per byte, or per transmission: all that a station sends
/// at once.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct SerialFaults {
    /// Per byte: one bit is inverted.
    pub flip: Ppm,
    /// Per byte: from here on up to [`burst_max`](Self::burst_max) bytes are random.
    pub burst: Ppm,
    /// Longest burst, bytes.
    pub burst_max: u8,
    /// Per byte: it is lost.
    pub lose: Ppm,
    /// Per byte: another is inserted before it; one time in two 0x00 or 0xFF, as line drivers make
    /// when they are switched.
    pub insert: Ppm,
    /// Per transmission: its end is cut off, at any offset.
    pub truncate: Ppm,
    /// Per transmission: it arrives in pieces of any length.
    pub chunk: Ppm,
    /// Longest silence between pieces, µs.
    pub chunk_gap_us: u32,
    /// Per reply: it is sent twice.
    pub duplicate: Ppm,
    /// Per reply: it is late, and so are all later frames of this drive.
    pub late: Ppm,
    /// The host's patience, ms: half of the late replies arrive within a hair of it.
    pub host_timeout_ms: u32,
    /// The latest reply, ms.
    pub late_max_ms: u32,
    /// Per request: it never arrives.
    pub lose_request: Ppm,
    /// Per reply: it never arrives.
    pub lose_reply: Ppm,
    /// Per reply: another sender transmits at the same time.
    pub collide: Ppm,
    /// Delay of the host's line driver in releasing the line, bits (half duplex).
    pub release_late_bits: u8,
    /// Period of an adapter that hands bytes to the host, as on USB, ms; 0 = at once.
    pub latency_ms: u8,
    /// The host's end is set to this baud rate; 0 = the right one.
    pub host_baud: u32,
}

/// Number of faults were made, by kind. Shows that a test tested something.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct InjectedSerialFaults {
    /// Bytes changed, lost or inserted.
    pub bytes: u64,
    /// Transmissions cut short.
    pub truncated: u64,
    /// Transmissions delivered in pieces.
    pub chunked: u64,
    /// Replies sent twice.
    pub duplicated: u64,
    /// Replies sent late.
    pub late: u64,
    /// Requests that never arrived.
    pub requests_lost: u64,
    /// Replies that never arrived.
    pub replies_lost: u64,
    /// Transmissions that met another on the wire.
    pub collided: u64,
}

impl InjectedSerialFaults {
    /// Adds another count to this one.
    pub fn add(&mut self, other: &Self) {
        self.bytes += other.bytes;
        self.truncated += other.truncated;
        self.chunked += other.chunked;
        self.duplicated += other.duplicated;
        self.late += other.late;
        self.requests_lost += other.requests_lost;
        self.replies_lost += other.replies_lost;
        self.collided += other.collided;
    }
}

impl SerialFaults {
    /// A wire that works.
    pub const NONE: Self = Self {
        flip: Ppm::NEVER,
        burst: Ppm::NEVER,
        burst_max: 0,
        lose: Ppm::NEVER,
        insert: Ppm::NEVER,
        truncate: Ppm::NEVER,
        chunk: Ppm::NEVER,
        chunk_gap_us: 0,
        duplicate: Ppm::NEVER,
        late: Ppm::NEVER,
        host_timeout_ms: 0,
        late_max_ms: 0,
        lose_request: Ppm::NEVER,
        lose_reply: Ppm::NEVER,
        collide: Ppm::NEVER,
        release_late_bits: 0,
        latency_ms: 0,
        host_baud: 0,
    };

    /// A set drawn from `random`, for a wire whose hosts wait `host_timeout_ms` for a reply and whose
    /// drives may take up to `late_max_ms`.
    pub fn random(random: &mut Random, host_timeout_ms: u32, late_max_ms: u32) -> Self {
        Self {
            flip: byte_chance(random),
            burst: byte_chance(random),
            burst_max: random.between(2, 20) as u8,
            lose: byte_chance(random),
            insert: byte_chance(random),
            truncate: unit_chance(random),
            chunk: random_chance(random, &[10_000, 200_000, 1_000_000]),
            chunk_gap_us: random.pick(&[0, 100, 1_000, 5_000]),
            duplicate: unit_chance(random),
            late: unit_chance(random),
            host_timeout_ms,
            late_max_ms,
            lose_request: unit_chance(random),
            lose_reply: unit_chance(random),
            collide: unit_chance(random),
            release_late_bits: random.pick(&[0, 0, 0, 1, 3]),
            latency_ms: random.pick(&[0, 0, 1, 16, 20]),
            host_baud: 0,
        }
    }

    /// When a late reply comes, ns after it should have: half of them within a hair of the host's
    /// patience, the others anywhere up to the latest.
    pub(crate) fn lateness_ns(&self, random: &mut Random) -> u64 {
        const HAIR_NS: i64 = 2_000_000;
        let at = i64::from(self.host_timeout_ms) * 1_000_000;
        let latest = u64::from(self.late_max_ms) * 1_000_000;
        // Half of the replies come within a hair of the host's limit, where its decisions are hardest.
        let late = if random.chance(Ppm(500_000)) {
            at.saturating_add(random.between(-HAIR_NS, HAIR_NS)).max(0) as u64
        } else {
            random.below(latest)
        };
        late.min(latest)
    }

    /// Changes the bytes of one transmission in place. Returns how many faults it made.
    pub(crate) fn corrupt(&self, random: &mut Random, bytes: &mut Vec<u8>) -> u64 {
        let any = self.flip.0 + self.burst.0 + self.lose.0 + self.insert.0;
        let mut made = 0;
        let mut at = 0;
        while any > 0 && at < bytes.len() {
            let draw = random.below(1_000_000) as u32;
            if draw < any {
                made += 1;
                at = self.corrupt_at(draw, random, bytes, at);
            } else {
                at += 1;
            }
        }
        made
    }

    /// One fault at byte `at`. Returns where to go on.
    fn corrupt_at(&self, draw: u32, random: &mut Random, bytes: &mut Vec<u8>, at: usize) -> usize {
        if draw < self.flip.0 {
            bytes[at] ^= 1 << random.below(8);
            return at + 1;
        }
        if draw < self.flip.0 + self.burst.0 {
            let end = at + 1 + random.below(u64::from(self.burst_max)) as usize;
            debug_assert!(at < bytes.len());
            let end = end.min(bytes.len());
            bytes[at..end].fill_with(|| random.next_byte());
            return end;
        }
        if draw < self.flip.0 + self.burst.0 + self.lose.0 {
            bytes.remove(at);
            return at;
        }
        let noise = random.next_byte();
        // Noise on a line is often a break or an idle level.
        bytes.insert(at, random.pick(&[noise, noise, 0x00, 0xFF]));
        at + 2
    }
}

fn unit_chance(random: &mut Random) -> Ppm {
    random_chance(random, &[500, 2_000, 10_000, 50_000])
}

fn byte_chance(random: &mut Random) -> Ppm {
    random_chance(random, &[50, 200, 1_000, 5_000])
}

/// Off one time in two, else one of `choices`.
fn random_chance(random: &mut Random, choices: &[u32]) -> Ppm {
    if random.chance(Ppm(500_000)) { Ppm(random.pick(choices)) } else { Ppm::NEVER }
}
