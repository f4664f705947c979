//! State of a drive in the host: its form of replies, pending replies, and the requests that feed its
//! timeout stop.

use super::interpretation::{Interpretation, ReplyFormat};
use super::wire::CommandWord;
use crate::proto::reply_ledger::OutstandingReplies;
use crate::time::{Instant, earliest};

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
    /// The format is [`Silent`](ReplyFormat::Silent) because output commands had no reply, not because this host
    /// set VM.
    pub is_silence_observed: bool,
    /// True once it has replied.
    pub has_answered: bool,
    /// Time of the last frame that was sent to it.
    pub last_sent: Instant,
    /// Replies that may still come; by command word.
    pub outstanding: OutstandingReplies<CommandWord, OUTSTANDING_MAX>,
    /// Time of its timeout stop as this host set it, ms.
    stop_timeout_ms: u16,
    lease_until: Instant,
}

impl NodeState {
    const NEW: Self = Self {
        reply_format: ReplyFormat::Echo,
        is_silence_observed: false,
        has_answered: false,
        last_sent: Instant::ZERO,
        outstanding: OutstandingReplies::NONE,
        stop_timeout_ms: 0,
        lease_until: Instant::ZERO,
    };

    /// Returns whether a reply to an older request may still arrive.
    pub fn is_in_doubt(&mut self, now: Instant) -> bool {
        self.outstanding.expire(now);
        !self.outstanding.is_empty()
    }

    /// A query was answered: nothing older can come, unless this was it.
    pub fn clear_outstanding(&mut self, now: Instant, command: CommandWord) {
        if !self.outstanding.may_include(now, command) {
            self.outstanding = OutstandingReplies::NONE;
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
            if !node.has_answered || !node.outstanding.may_probe() || busy(id) {
                continue;
            }
            if let Some(command) = node.outstanding.next_probe(now, &PROBES) {
                return Some((id, command));
            }
        }
        None
    }

    /// Time of the next action.
    pub fn next_due(&self) -> Option<Instant> {
        let of = |mask: u128| set_bits(mask).map(|id| &self.nodes[usize::from(id)]);
        let doubts = of(self.in_doubt)
            .filter(|node| !node.outstanding.is_empty())
            .map(|node| node.outstanding.until())
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
