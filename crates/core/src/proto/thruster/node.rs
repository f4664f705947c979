//! What a host remembers of each drive: how it answers, what it may still say, what feeds its
//! timeout stop.

use super::readings::{Form, Readings};
use super::wire::Command;
use crate::time::{Instant, earliest};

/// Probes sent to a drive in doubt at most.
pub const PROBES_MAX: u8 = 4;
/// Replies that may still come and are remembered of a drive: three attempts and every probe.
const OWED_MAX: usize = 8;
/// How long a drive's timeout stop (ST) is fed behind the application's last request: a program that
/// hangs does not keep a motor turning.
pub const LEASE_MS: u32 = 1_000;
/// A timeout stop is fed so many times within its time.
const FEEDS: u64 = 3;

/// Queries that change nothing, each with letters of its own.
const PROBES: [Command; 5] = [Command::QP, Command::QT, Command::EQ, Command::QC, Command::QV];

/// One drive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    /// What TC and VC are answered with.
    pub form: Form,
    /// It ever answered.
    pub heard: bool,
    /// When something was last sent to it.
    pub fed: Instant,
    owed: [Command; OWED_MAX],
    count: u8,
    probes: u8,
    until: Instant,
    /// Time of its timeout stop as this host set it, ms.
    timeout_ms: u16,
    lease: Instant,
}

impl Node {
    const NEW: Self = Self {
        form: Form::Echo,
        heard: false,
        fed: Instant::ZERO,
        owed: [Command(0); OWED_MAX],
        count: 0,
        probes: 0,
        until: Instant::ZERO,
        timeout_ms: 0,
        lease: Instant::ZERO,
    };

    fn all_owed(&self) -> &[Command] {
        &self.owed[..usize::from(self.count)]
    }

    /// Replies to this command that may still come for older requests.
    pub fn owed(&self, command: Command) -> u8 {
        self.all_owed().iter().filter(|owed| **owed == command).count() as u8
    }

    /// A reply to this command may still come, until then.
    pub fn doubt(&mut self, command: Command, until: Instant) {
        if let Some(slot) = self.owed.get_mut(usize::from(self.count)) {
            *slot = command;
            self.count += 1;
        }
        self.until = self.until.max(until);
    }

    /// Whether anything may still come for older requests.
    pub fn is_in_doubt(&mut self, now: Instant) -> bool {
        if now >= self.until {
            (self.count, self.probes) = (0, 0);
        }
        self.count > 0
    }

    /// A query was answered: nothing older can come, unless this was it.
    pub fn trust(&mut self, command: Command) {
        if self.owed(command) == 0 {
            (self.count, self.probes, self.until) = (0, 0, Instant::ZERO);
        }
    }

    /// When it is to be fed next, while the application's lease lasts.
    fn hunger(&self) -> Option<Instant> {
        let due = self.fed.plus_ns(u64::from(self.timeout_ms) * 1_000_000 / FEEDS);
        (self.timeout_ms > 0 && due <= self.lease.plus_ms(LEASE_MS)).then_some(due)
    }
}

/// Every drive that there can be on a bus.
#[derive(Debug)]
pub(super) struct Nodes {
    nodes: [Node; 128],
    /// Those in doubt.
    doubtful: u128,
    /// Those with a timeout stop that this host set.
    watched: u128,
}

impl Nodes {
    pub const fn new() -> Self {
        Self { nodes: [Node::NEW; 128], doubtful: 0, watched: 0 }
    }

    pub const fn get_mut(&mut self, id: u8) -> &mut Node {
        &mut self.nodes[(id & 0x7F) as usize]
    }

    /// The application asked something: what it set is fed for a while again.
    pub const fn renew(&mut self, id: u8, now: Instant) {
        self.get_mut(id).lease = now;
    }

    /// A drive is in doubt.
    pub const fn doubtful(&mut self, id: u8) {
        self.doubtful |= 1 << (id & 0x7F);
    }

    /// The drive stops after that time without a command, 0 for never.
    pub const fn watch(&mut self, id: u8, ms: u16, now: Instant) {
        let node = self.get_mut(id);
        (node.timeout_ms, node.fed) = (ms, now);
        let bit = 1 << (id & 0x7F);
        self.watched = if ms > 0 { self.watched | bit } else { self.watched & !bit };
    }

    /// The link is down: nobody is fed until somebody sets a timeout anew.
    pub const fn unwatch(&mut self) {
        self.watched = 0;
    }

    /// Whether any is fed, while the application's lease lasts.
    pub fn feeds(&self) -> bool {
        bits(self.watched).any(|id| self.nodes[usize::from(id)].hunger().is_some())
    }

    /// A drive whose timeout stop wants to be fed now.
    pub fn hungry(&self, now: Instant) -> Option<(u8, Readings)> {
        let due = |id: &u8| self.nodes[usize::from(*id)].hunger().is_some_and(|at| at <= now);
        bits(self.watched).find(due).map(|id| (id, Readings::default()))
    }

    /// A drive in doubt that nothing is asked of, and a question whose answer cannot be mistaken.
    pub fn probe(&mut self, now: Instant, busy: impl Fn(u8) -> bool) -> Option<(u8, Command)> {
        for id in bits(self.doubtful) {
            let node = &mut self.nodes[usize::from(id)];
            if !node.is_in_doubt(now) {
                self.doubtful &= !(1 << id);
                continue;
            }
            if !node.heard || node.probes >= PROBES_MAX || busy(id) {
                continue;
            }
            let fresh = PROBES.into_iter().find(|command| node.owed(*command) == 0);
            if let Some(command) = fresh {
                node.probes += 1;
                return Some((id, command));
            }
        }
        None
    }

    /// When something of all this is due.
    pub fn next(&self) -> Option<Instant> {
        let of = |mask: u128| bits(mask).map(|id| &self.nodes[usize::from(id)]);
        let doubts = of(self.doubtful).filter(|node| node.count > 0).map(|node| node.until).min();
        earliest(doubts, of(self.watched).filter_map(Node::hunger).min())
    }
}

/// The numbers of the bits that are set.
fn bits(mut mask: u128) -> impl Iterator<Item = u8> {
    core::iter::from_fn(move || {
        let bit = (mask != 0).then(|| mask.trailing_zeros() as u8)?;
        mask &= mask - 1;
        Some(bit)
    })
}
