//! A client: what it holds, and what it says next.

use std::collections::BTreeMap;

use polepair_core::time::Instant;
use polepair_serve::bench::Session;
use polepair_sim::random::{Ppm, Random};

/// How far a client came with an axis that it holds.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Step {
    /// It has the lease.
    Held,
    /// Motion is let through.
    Armed,
    /// The motor is powered, where that is a verb of its own.
    Enabled,
    /// It was told to turn.
    Moved,
}

/// A lease that a client has.
#[derive(Clone, Copy, Debug)]
pub struct Hold {
    /// Its epoch.
    pub epoch: u64,
    /// When it is renewed next.
    pub renew_at: Instant,
    /// How far the client came.
    pub step: Step,
    /// A command is under way.
    pub waits: bool,
}

/// How a client is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Mood {
    /// It works.
    Here,
    /// It says and renews nothing until then, and goes on as if nothing had been.
    Hangs(Instant),
    /// It went. The server notices at the first instant, if at all; it comes back at the second.
    Gone(Option<Instant>, Instant),
}

/// A client of the bench.
#[derive(Debug)]
pub struct Person {
    /// The session that it has now.
    pub name: Session,
    /// How often it came back with a new one.
    pub returns: u32,
    /// How it is.
    pub mood: Mood,
    /// When it does something next.
    pub next: Instant,
    /// What it holds.
    pub holds: BTreeMap<u16, Hold>,
    /// Its next word is a stop: this share of a million.
    stops: u32,
    /// It vanishes or hangs: this share of a million.
    leaves: u32,
}

/// What a client does.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Word {
    /// Wants the lease; `true` takes it from whoever has it.
    Take(u16, bool),
    /// A verb of an axis that it holds.
    Verb(u16, &'static str),
    /// Gives the lease back.
    Drop(u16),
    /// Stops an axis, which needs no lease.
    Stop(u16),
    /// Stops everything, which locks motion.
    StopAll,
    /// Lets motion again.
    Release,
    /// Asks for the speed now.
    Read(u16),
    /// Goes without a word.
    Vanish,
    /// Says nothing for a while.
    Hang,
    /// Nothing.
    Wait,
}

impl Person {
    /// One that begins about then.
    pub fn new(number: usize, random: &mut Random, begin: Instant) -> Self {
        Self {
            name: format!("client-{number}").into(),
            returns: 0,
            mood: Mood::Here,
            next: begin.plus_ms(random.below(600) as u32),
            holds: BTreeMap::new(),
            stops: random.pick(&[20_000, 60_000, 200_000]),
            leaves: random.pick(&[0, 20_000, 80_000]),
        }
    }

    /// What it does now.
    pub fn choose(&self, random: &mut Random, axes: u16, locked: bool) -> Word {
        let axis = random.below(u64::from(axes)) as u16;
        if locked && random.chance(Ppm(250_000)) {
            return Word::Release;
        }
        if random.chance(Ppm(self.leaves)) {
            return if random.chance(Ppm(500_000)) { Word::Vanish } else { Word::Hang };
        }
        if random.chance(Ppm(self.stops)) {
            return if random.chance(Ppm(250_000)) { Word::StopAll } else { Word::Stop(axis) };
        }
        if random.chance(Ppm(40_000)) {
            return Word::Read(axis);
        }
        match self.holds.get(&axis) {
            None => Word::Take(axis, random.chance(Ppm(120_000))),
            Some(hold) if hold.waits => Word::Wait,
            Some(Hold { step: Step::Held, .. }) => Word::Verb(axis, "arm"),
            Some(Hold { step: Step::Armed, .. }) => Word::Verb(axis, "enable"),
            Some(Hold { step: Step::Enabled, .. }) => Word::Verb(axis, "velocity"),
            Some(_) => match random.below(100) {
                0..30 => Word::Verb(axis, "velocity"),
                30..42 => Word::Verb(axis, "stop"),
                42..46 => Word::Verb(axis, "disable"),
                46..49 => Word::Verb(axis, "disarm"),
                49..54 => Word::Drop(axis),
                _ => Word::Wait,
            },
        }
    }
}
