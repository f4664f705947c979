//! State of a drive in the host: its form of replies, pending replies, and the requests that feed its
//! timeout stop.

use super::interpretation::{Interpretation, ReplyFormat};
use super::wire::CommandWord;
use crate::time::{Instant, earliest};

/// Probes sent to a drive in doubt at most.
pub const PROBES_MAX: u8 = 4;
/// Replies that may still come and are remembered of a drive: three attempts and every probe.
const OUTSTANDING_MAX: usize = 8;
/// Time after the application's last request for which a drive's timeout stop (ST) is fed: a program that hangs does
/// not keep a motor turning.
pub const LEASE_MS: u32 = 1_000;
/// Feeds of a timeout stop within its time.
const FEEDS_PER_TIMEOUT: u64 = 3;

/// Queries that change nothing, each with letters of its own.
const PROBES: [CommandWord; 5] =
    [CommandWord::QP, CommandWord::QT, CommandWord::EQ, CommandWord::QC, CommandWord::QV];

/// One drive.
#[derive(Clone, Copy, Debug)]
pub(super) struct NodeState {
    /// Format of the replies to TC and VC.
    pub reply_format: ReplyFormat,
    /// True once it has replied.
    pub has_answered: bool,
    /// Time of the last frame that was sent to it.
    pub last_sent: Instant,
    outstanding: [CommandWord; OUTSTANDING_MAX],
    outstanding_len: u8,
    probes: u8,
    doubt_until: Instant,
    /// Time of its timeout stop as this host set it, ms.
    stop_timeout_ms: u16,
    lease_until: Instant,
}

impl NodeState {
    const NEW: Self = Self {
        reply_format: ReplyFormat::Echo,
        has_answered: false,
        last_sent: Instant::ZERO,
        outstanding: [CommandWord(0); OUTSTANDING_MAX],
        outstanding_len: 0,
        probes: 0,
        doubt_until: Instant::ZERO,
        stop_timeout_ms: 0,
        lease_until: Instant::ZERO,
    };

    fn outstanding(&self) -> &[CommandWord] {
        &self.outstanding[..usize::from(self.outstanding_len)]
    }

    /// Replies to this command that may still come for older requests.
    pub fn outstanding_count(&self, command: CommandWord) -> u8 {
        self.outstanding().iter().filter(|command_word| **command_word == command).count() as u8
    }

    /// A reply to this command may still come, until then.
    pub fn add_outstanding(&mut self, command: CommandWord, until: Instant) {
        if let Some(slot) = self.outstanding.get_mut(usize::from(self.outstanding_len)) {
            *slot = command;
            self.outstanding_len += 1;
        }
        self.doubt_until = self.doubt_until.max(until);
    }

    /// Returns whether a reply to an older request may still arrive.
    pub fn is_in_doubt(&mut self, now: Instant) -> bool {
        if now >= self.doubt_until {
            (self.outstanding_len, self.probes) = (0, 0);
        }
        self.outstanding_len > 0
    }

    /// A query was answered: nothing older can come, unless this was it.
    pub fn clear_outstanding(&mut self, command: CommandWord) {
        if self.outstanding_count(command) == 0 {
            (self.outstanding_len, self.probes, self.doubt_until) = (0, 0, Instant::ZERO);
        }
    }

    /// When it is to be fed next, while the application's lease lasts.
    fn feed_due(&self) -> Option<Instant> {
        let due =
            self.last_sent.plus_ns(u64::from(self.stop_timeout_ms) * 1_000_000 / FEEDS_PER_TIMEOUT);
        (self.stop_timeout_ms > 0 && due <= self.lease_until.plus_ms(LEASE_MS)).then_some(due)
    }
}

/// Every drive that there can be on a bus.
#[derive(Debug)]
pub(super) struct NodeTable {
    nodes: [NodeState; 128],
    /// Drives in doubt, a bit each.
    in_doubt: u128,
    /// Drives with a timeout stop that this host set, a bit each.
    with_stop_timeout: u128,
}

impl NodeTable {
    pub const fn new() -> Self {
        Self { nodes: [NodeState::NEW; 128], in_doubt: 0, with_stop_timeout: 0 }
    }

    pub const fn get_mut(&mut self, id: u8) -> &mut NodeState {
        &mut self.nodes[(id & 0x7F) as usize]
    }

    /// Renews the lease after a request of the application.
    pub const fn renew_lease(&mut self, id: u8, now: Instant) {
        self.get_mut(id).lease_until = now;
    }

    /// A drive is in doubt.
    pub const fn mark_in_doubt(&mut self, id: u8) {
        self.in_doubt |= 1 << (id & 0x7F);
    }

    /// The drive stops after that time without a command, 0 for never.
    pub const fn set_stop_timeout(&mut self, id: u8, ms: u16, now: Instant) {
        let node = self.get_mut(id);
        (node.stop_timeout_ms, node.last_sent) = (ms, now);
        let bit = 1 << (id & 0x7F);
        self.with_stop_timeout =
            if ms > 0 { self.with_stop_timeout | bit } else { self.with_stop_timeout & !bit };
    }

    /// Clears the timeouts after the loss of the link: no drive is fed until a timeout is set again.
    pub const fn clear_stop_timeouts(&mut self) {
        self.with_stop_timeout = 0;
    }

    /// Returns whether a drive is fed, while the application's lease lasts.
    pub fn needs_feeding(&self) -> bool {
        set_bits(self.with_stop_timeout).any(|id| self.nodes[usize::from(id)].feed_due().is_some())
    }

    /// A drive whose timeout stop has to be fed now.
    pub fn next_to_feed(&self, now: Instant) -> Option<(u8, Interpretation)> {
        set_bits(self.with_stop_timeout)
            .find(|id| self.nodes[usize::from(*id)].feed_due().is_some_and(|at| at <= now))
            .map(|id| (id, Interpretation::default()))
    }

    /// A drive in doubt without a pending request, and a probe with an unmistakable reply.
    pub fn next_probe(
        &mut self,
        now: Instant,
        busy: impl Fn(u8) -> bool,
    ) -> Option<(u8, CommandWord)> {
        for id in set_bits(self.in_doubt) {
            let node = &mut self.nodes[usize::from(id)];
            if !node.is_in_doubt(now) {
                self.in_doubt &= !(1 << id);
                continue;
            }
            if !node.has_answered || node.probes >= PROBES_MAX || busy(id) {
                continue;
            }
            let fresh = PROBES.into_iter().find(|command| node.outstanding_count(*command) == 0);
            if let Some(command) = fresh {
                node.probes += 1;
                return Some((id, command));
            }
        }
        None
    }

    /// Time of the next action.
    pub fn next_due(&self) -> Option<Instant> {
        let of = |mask: u128| set_bits(mask).map(|id| &self.nodes[usize::from(id)]);
        let doubts = of(self.in_doubt)
            .filter(|node| node.outstanding_len > 0)
            .map(|node| node.doubt_until)
            .min();
        earliest(doubts, of(self.with_stop_timeout).filter_map(NodeState::feed_due).min())
    }
}

/// The numbers of the bits that are set.
fn set_bits(mut mask: u128) -> impl Iterator<Item = u8> {
    core::iter::from_fn(move || {
        let bit = (mask != 0).then(|| mask.trailing_zeros() as u8)?;
        mask &= mask - 1;
        Some(bit)
    })
}
