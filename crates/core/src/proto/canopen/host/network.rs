//! What nodes say of themselves, and what the host says by itself: its own heartbeat, and SYNC.

use super::nodes::NodeSet;
use crate::medium::Frame;
use crate::proto::canopen::NODE_MAX;
use crate::proto::canopen::ask::{Answer, Ask};
use crate::proto::canopen::heartbeat::Heartbeat;
use crate::proto::canopen::nmt::State;
use crate::proto::canopen::sdo::Object;
use crate::proto::canopen::sync::Sync;
use crate::station::Class;
use crate::time::{Instant, earliest};

const NODES: usize = NODE_MAX as usize + 1;
/// Producer heartbeat time, ms.
const HEARTBEAT_TIME: Object = Object::new(0x1017, 0);
/// Consumer heartbeat time: the first place.
const CONSUMER: Object = Object::new(0x1016, 1);
/// Heartbeats of the host within the time after which it is missed: one may be late, or lost.
const BEATS: u32 = 3;
/// A heartbeat is missed after so many of its periods.
const PERIODS: u32 = 2;
/// The application's lease: our own heartbeat goes on for so long after it last asked something, ms.
pub const LEASE_MS: u32 = 1_000;

#[derive(Clone, Copy, Debug)]
struct Node {
    state: Option<State>,
    /// Answers to guarding alternate; the next one has this toggle, once one came.
    toggle: Option<bool>,
    /// The node's heartbeat comes within so long; 0 is never.
    within_ms: u32,
    due: Option<Instant>,
}

#[derive(Debug)]
pub struct Network {
    nodes: [Node; NODES],
    /// The earliest of the heartbeats that are due.
    due: Option<Instant>,
    own: Beat,
    /// Nodes that this host had watch its heartbeat.
    watchers: NodeSet,
    /// Whoever opened the link wants a heartbeat.
    wanted: bool,
    sync: Option<(u64, Instant)>,
}

/// The host's own heartbeat.
#[derive(Debug)]
struct Beat {
    id: u8,
    period_ms: u32,
    next: Option<Instant>,
    lease: Instant,
}

impl Network {
    pub fn new(id: u8, heartbeat_ms: Option<u32>) -> Self {
        let node = Node { state: None, toggle: None, within_ms: 0, due: None };
        let period_ms = heartbeat_ms.unwrap_or(0);
        let own = Beat { id, period_ms, next: None, lease: Instant::ZERO };
        let wanted = period_ms > 0;
        Self { nodes: [node; NODES], due: None, own, watchers: NodeSet::EMPTY, wanted, sync: None }
    }

    pub fn state(&self, node: u8) -> Option<State> {
        self.nodes.get(usize::from(node))?.state
    }

    /// Whether nodes wait for the host's heartbeat, or follow its SYNC.
    pub const fn keeps_alive(&self) -> bool {
        let watched = self.watchers.first().is_some();
        let beats = self.own.next.is_some() && (watched || self.wanted);
        beats || self.sync.is_some()
    }

    /// Nothing is known any more.
    pub fn forget(&mut self) {
        for node in &mut self.nodes {
            (node.state, node.toggle) = (None, None);
        }
    }

    /// Takes a boot-up or heartbeat; true when it tells something new.
    pub fn heard(&mut self, now: Instant, node: u8, state: State) -> bool {
        let node = &mut self.nodes[usize::from(node & NODE_MAX)];
        let new = node.state.replace(state) != Some(state) || state == State::BootUp;
        if state == State::BootUp {
            // The object has its value from power-on again; nobody knows which.
            (node.within_ms, node.due, node.toggle) = (0, None, None);
        }
        if node.within_ms > 0 {
            node.due = Some(now.plus_ms(node.within_ms));
            self.due = earliest(self.due, node.due);
        }
        new
    }

    /// Takes an answer to guarding; false when its toggle is the one before's.
    pub fn guarded(&mut self, node: u8, beat: Heartbeat) -> bool {
        let node = &mut self.nodes[usize::from(node & NODE_MAX)];
        node.state = Some(beat.state);
        node.toggle.replace(!beat.toggle).is_none_or(|expected| expected == beat.toggle)
    }

    /// Learns from an answer how often a node's heartbeat comes.
    #[inline]
    pub fn learn(&mut self, node: u8, answer: &Answer) {
        match *answer {
            Answer::Value { object: HEARTBEAT_TIME, bits, .. }
            | Answer::Written { object: HEARTBEAT_TIME, bits } => {
                let node = &mut self.nodes[usize::from(node & NODE_MAX)];
                // It counts from the first heartbeat on (CiA 301, 7.2.8.3.2.2).
                (node.within_ms, node.due) = ((bits as u32 & 0xFFFF) * PERIODS, None);
            }
            _ => {}
        }
    }

    /// A node whose heartbeat failed to come, once each.
    pub fn lost(&mut self, now: Instant) -> Option<u8> {
        if self.due.is_none_or(|due| due > now) {
            return None;
        }
        let late = |node: &Node| node.due.is_some_and(|due| due <= now);
        let at = self.nodes.iter().position(late);
        match at {
            Some(at) => (self.nodes[at].due, self.nodes[at].state) = (None, None),
            None => self.due = self.nodes.iter().filter_map(|node| node.due).min(),
        }
        at.map(|at| at as u8)
    }

    /// The application is alive.
    #[inline]
    pub fn renew(&mut self, now: Instant) {
        if self.own.period_ms > 0 {
            self.own.lease = now.plus_ms(LEASE_MS);
            self.own.next = self.own.next.or(Some(now));
        }
    }

    /// What has a node watch the host's heartbeat.
    pub const fn watched(&self, node: u8, ms: u16) -> Ask {
        let bits = if ms == 0 { 0 } else { (self.own.id as u64) << 16 | ms as u64 };
        Ask::Write { node, object: CONSUMER, bits, len: 4, class: Class::Confirm }
    }

    /// A node watches the host's heartbeat, which comes at least thrice within so many ms from now on;
    /// with none, the node watches it no more.
    pub fn beat_within(&mut self, now: Instant, node: u8, ms: u16) {
        match ms {
            0 => self.watchers.remove(node),
            _ => self.watchers.insert(node),
        }
        let period_ms = u32::from(ms) / BEATS;
        if period_ms > 0 && (self.own.period_ms == 0 || period_ms < self.own.period_ms) {
            self.own.period_ms = period_ms;
            self.renew(now);
        }
    }

    /// SYNC every so many µs from now on, or no more.
    pub fn sync_every(&mut self, now: Instant, us: u32) {
        self.sync = (us > 0).then_some((u64::from(us) * 1_000, now));
    }

    #[inline]
    pub fn deadline(&self) -> Option<Instant> {
        let own = earliest(self.own.next, self.sync.map(|(_, next)| next));
        earliest(self.due, own)
    }

    /// What the host says by itself now.
    #[inline]
    pub fn transmit(&mut self, now: Instant) -> Option<Frame> {
        if let Some((period, next)) = &mut self.sync
            && *next <= now
        {
            // Those that are overdue are left out: SYNC keeps its beat.
            let missed = (now.0 - next.0) / *period;
            *next = next.plus_ns((missed + 1) * *period);
            return Some(Sync::default().emit());
        }
        let next = self.own.next.filter(|next| *next <= now)?;
        if now > self.own.lease {
            self.own.next = None;
            return None;
        }
        self.own.next = Some(next.max(now).plus_ms(self.own.period_ms));
        Some(Heartbeat { state: State::Operational, toggle: false }.emit(self.own.id))
    }
}
