//! Messages of nodes, and messages that the host sends by itself: heartbeat and SYNC.

use super::node_set::NodeSet;
use crate::medium::Frame;
use crate::proto::canopen::NODE_MAX;
use crate::proto::canopen::heartbeat::Heartbeat;
use crate::proto::canopen::host_request::{Answer, HostRequest};
use crate::proto::canopen::nmt::NmtState;
use crate::proto::canopen::sdo::ObjectIndex;
use crate::proto::canopen::sync::SyncMessage;
use crate::station::RequestClass;
use crate::time::{Instant, earliest};

const NODES: usize = NODE_MAX as usize + 1;
/// Producer heartbeat time, ms.
const HEARTBEAT_TIME: ObjectIndex = ObjectIndex::new(0x1017, 0);
/// Consumer heartbeat time: the first place.
const CONSUMER_HEARTBEAT: ObjectIndex = ObjectIndex::new(0x1016, 1);
/// Heartbeats of the host within the time after which it is missed: one may be late, or lost.
// One late heartbeat is no death, and a bus loses one now and then (CANOPEN-7).
const BEATS_PER_TIMEOUT: u32 = 3;
/// Periods after which a heartbeat counts as missed.
const TIMEOUT_PERIODS: u32 = 2;
/// The application's lease: our heartbeat continues for this time after the last request, ms.
pub const LEASE_MS: u32 = 1_000;

#[derive(Clone, Copy, Debug)]
struct NetworkNode {
    state: Option<NmtState>,
    /// Answers to guarding alternate; the next one has this toggle, once one came.
    guard_toggle: Option<bool>,
    /// Longest time between two heartbeats of the node; 0 is no limit.
    heartbeat_timeout_ms: u32,
    heartbeat_due: Option<Instant>,
}

#[derive(Debug)]
pub struct Network {
    nodes: [NetworkNode; NODES],
    /// The earliest of the heartbeats that are due.
    due: Option<Instant>,
    own_heartbeat: OwnHeartbeat,
    /// Nodes that this host had watch its heartbeat.
    watchers: NodeSet,
    /// True if the caller requested a heartbeat.
    heartbeat_wanted: bool,
    sync: Option<(u64, Instant)>,
}

/// The host's own heartbeat.
#[derive(Debug)]
struct OwnHeartbeat {
    id: u8,
    period_ms: u32,
    next: Option<Instant>,
    lease_until: Instant,
}

impl Network {
    pub fn new(id: u8, heartbeat_ms: Option<u32>) -> Self {
        let node = NetworkNode {
            state: None,
            guard_toggle: None,
            heartbeat_timeout_ms: 0,
            heartbeat_due: None,
        };
        let period_ms = heartbeat_ms.unwrap_or(0);
        let own_heartbeat = OwnHeartbeat { id, period_ms, next: None, lease_until: Instant::ZERO };
        let heartbeat_wanted = period_ms > 0;
        Self {
            nodes: [node; NODES],
            due: None,
            own_heartbeat,
            watchers: NodeSet::EMPTY,
            heartbeat_wanted,
            sync: None,
        }
    }

    pub fn state(&self, node: u8) -> Option<NmtState> {
        self.nodes.get(usize::from(node))?.state
    }

    /// Returns whether nodes monitor the host's heartbeat or follow its SYNC.
    pub const fn sends_keepalive(&self) -> bool {
        let watched = self.watchers.first().is_some();
        let beats = self.own_heartbeat.next.is_some() && (watched || self.heartbeat_wanted);
        beats || self.sync.is_some()
    }

    /// Nothing is known any more.
    pub fn reset(&mut self) {
        for node in &mut self.nodes {
            (node.state, node.guard_toggle) = (None, None);
        }
    }

    /// Takes a boot-up or heartbeat; true for a change.
    pub fn note_state(&mut self, now: Instant, node: u8, state: NmtState) -> bool {
        let node = &mut self.nodes[usize::from(node & NODE_MAX)];
        // Two restarts in a row are two events.
        let new = node.state.replace(state) != Some(state) || state == NmtState::BootUp;
        if state == NmtState::BootUp {
            // The object has its unknown power-on value again.
            (node.heartbeat_timeout_ms, node.heartbeat_due, node.guard_toggle) = (0, None, None);
        }
        if node.heartbeat_timeout_ms > 0 {
            node.heartbeat_due = Some(now.plus_ms(node.heartbeat_timeout_ms));
            self.due = earliest(self.due, node.heartbeat_due);
        }
        new
    }

    /// Takes an answer to guarding; false when its toggle is the one before's.
    pub fn note_guarding(&mut self, node: u8, beat: Heartbeat) -> bool {
        let node = &mut self.nodes[usize::from(node & NODE_MAX)];
        node.state = Some(beat.state);
        node.guard_toggle.replace(!beat.toggle).is_none_or(|expected| expected == beat.toggle)
    }

    /// Learns from an answer how often a node's heartbeat comes, and that a node watches ours from now on.
    #[inline]
    pub fn learn_heartbeat_time(&mut self, node: u8, answer: &Answer) {
        match *answer {
            // A consumer starts its timer with the first heartbeat that it receives (CiA 301, 7.2.8.3.2.2):
            // until then nothing stops its motor if this host is killed. So the next one is due at once.
            Answer::Written { object: CONSUMER_HEARTBEAT, bits } if bits != 0 => {
                self.own_heartbeat.next = self.own_heartbeat.next.map(|_| Instant::ZERO);
            }
            Answer::Value { object: HEARTBEAT_TIME, bits, .. }
            | Answer::Written { object: HEARTBEAT_TIME, bits } => {
                let node = &mut self.nodes[usize::from(node & NODE_MAX)];
                // It counts from the first heartbeat on (CiA 301, 7.2.8.3.2.2).
                (node.heartbeat_timeout_ms, node.heartbeat_due) =
                    ((bits as u32 & 0xFFFF) * TIMEOUT_PERIODS, None);
            }
            _ => {}
        }
    }

    /// A node whose heartbeat is missing, once each.
    pub fn next_lost(&mut self, now: Instant) -> Option<u8> {
        if self.due.is_none_or(|due| due > now) {
            return None;
        }
        let at =
            self.nodes.iter().position(|node| node.heartbeat_due.is_some_and(|due| due <= now));
        match at {
            Some(at) => (self.nodes[at].heartbeat_due, self.nodes[at].state) = (None, None),
            // Worked out anew only when the noted one has passed: it is asked for with every frame.
            None => self.due = self.nodes.iter().filter_map(|node| node.heartbeat_due).min(),
        }
        at.map(|at| at as u8)
    }

    /// The application is alive.
    #[inline]
    pub fn renew_lease(&mut self, now: Instant) {
        if self.own_heartbeat.period_ms > 0 {
            self.own_heartbeat.lease_until = now.plus_ms(LEASE_MS);
            self.own_heartbeat.next = self.own_heartbeat.next.or(Some(now));
        }
    }

    /// The request that makes a node monitor the host's heartbeat.
    pub const fn watch_request(&self, node: u8, ms: u16) -> HostRequest {
        // CiA 301, 7.5.2.19: reserved byte, node-ID, milliseconds.
        let bits = if ms == 0 { 0 } else { (self.own_heartbeat.id as u64) << 16 | ms as u64 };
        HostRequest::Write {
            node,
            object: CONSUMER_HEARTBEAT,
            bits,
            len: 4,
            class: RequestClass::ReadBack,
        }
    }

    /// Records that a node watches the host's heartbeat, which is sent at least thrice within `ms` from now on; 0 ends
    /// the watch.
    pub fn set_watch_time(&mut self, now: Instant, node: u8, ms: u16) {
        match ms {
            0 => self.watchers.remove(node),
            _ => self.watchers.insert(node),
        }
        let period_ms = u32::from(ms) / BEATS_PER_TIMEOUT;
        if period_ms > 0
            && (self.own_heartbeat.period_ms == 0 || period_ms < self.own_heartbeat.period_ms)
        {
            // The shortest one that any node asks for; the others are served by it as well.
            self.own_heartbeat.period_ms = period_ms;
            self.renew_lease(now);
        }
    }

    /// Sets the period of SYNC, µs; 0 ends it.
    pub fn set_sync_period(&mut self, now: Instant, us: u32) {
        self.sync = (us > 0).then_some((u64::from(us) * 1_000, now));
    }

    #[inline]
    pub fn deadline(&self) -> Option<Instant> {
        let own = earliest(self.own_heartbeat.next, self.sync.map(|(_, next)| next));
        earliest(self.due, own)
    }

    /// The frames that the host sends by itself now.
    #[inline]
    pub fn transmit(&mut self, now: Instant) -> Option<Frame> {
        if let Some((period, next)) = &mut self.sync
            && *next <= now
        {
            // Those that are overdue are left out: SYNC keeps its beat.
            let missed = (now.0 - next.0) / *period;
            debug_assert!(*period > 0, "no SYNC is no period");
            *next = next.plus_ns((missed + 1) * *period);
            return Some(SyncMessage::default().emit());
        }
        let next = self.own_heartbeat.next.filter(|next| *next <= now)?;
        // The application went silent, so drives that watch this host shall notice (CANOPEN-8).
        if now > self.own_heartbeat.lease_until {
            self.own_heartbeat.next = None;
            return None;
        }
        self.own_heartbeat.next = Some(next.max(now).plus_ms(self.own_heartbeat.period_ms));
        Some(Heartbeat { state: NmtState::Operational, toggle: false }.emit(self.own_heartbeat.id))
    }
}
