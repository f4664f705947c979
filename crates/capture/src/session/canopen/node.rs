//! A node as seen on the bus: NMT state, presence, and whether two devices share its node-ID.

use std::collections::HashMap;

use polepair_core::proto::canopen::nmt::{NmtCommand, NmtState};
use polepair_core::proto::canopen::sdo::ObjectIndex;

use super::boot::{BootContext, BootMonitor, ZeroMeaning};
use super::emcy::NodeFaults;
use super::guard::NodeGuardMonitor;
use super::heartbeat::HeartbeatMonitor;
use super::power::PowerMonitor;
use super::product::NodeProduct;
use super::sdo::FrameRef;
use super::{anomaly, anomaly_at};
use crate::session::{AnomalyKind, ChangeNotice, InternedName, SessionNotice};
use crate::timestamp::Timestamp;

/// Time in which a node that was stopped may still send frames that were on their way.
const QUIET_NS: u64 = 100_000_000;
/// A state that alternates this many times without a command comes from two nodes with one number.
const FLIPS_MAX: u8 = 3;
/// Repetitions of the same state that are possible for one node.
const SAME_MAX: u8 = 4;
/// Requests to a node without any received frame until that is reported: a search for nodes sends fewer.
const UNHEARD_MAX: u8 = 4;

/// One node.
#[derive(Debug)]
pub(super) struct NodeTracker {
    pub id: u8,
    pub heartbeat: HeartbeatMonitor,
    pub guard: NodeGuardMonitor,
    pub faults: NodeFaults,
    pub power: PowerMonitor,
    pub product: NodeProduct,
    /// True if it is a drive by CiA 402.
    pub is_drive: bool,
    /// Last known values of its objects.
    pub values: HashMap<ObjectIndex, i64>,
    seen: bool,
    /// True if only heartbeats were received.
    only_heartbeats: bool,
    /// True if it has sent other frames since its start.
    in_use: bool,
    unanswered_count: u8,
    /// True if its missing reply was reported.
    unanswered_reported: bool,
    state: Option<NmtState>,
    previous_state: Option<NmtState>,
    flips: u8,
    /// Repetitions of the same state since the last other one.
    same_count: u8,
    /// Last NMT command of the master, and its time, while the node has not sent its state since.
    commanded: Option<(NmtState, Option<Timestamp>)>,
    reset_pending: bool,
    pub boots: BootMonitor,
    duplicate_reported: bool,
    /// Time of process data in a state that forbids them, if there were any.
    forbidden_data: Option<Option<Timestamp>>,
    forbidden_reported: bool,
}

impl NodeTracker {
    /// A node of which nothing is known but whether everybody was ordered to start again.
    pub fn new(id: u8, reset_pending: bool) -> Self {
        Self {
            id,
            heartbeat: HeartbeatMonitor::default(),
            guard: NodeGuardMonitor::default(),
            faults: NodeFaults::default(),
            power: PowerMonitor::default(),
            product: NodeProduct::default(),
            is_drive: false,
            values: HashMap::new(),
            seen: false,
            only_heartbeats: true,
            in_use: false,
            unanswered_count: 0,
            unanswered_reported: false,
            state: None,
            previous_state: None,
            flips: 0,
            same_count: 0,
            commanded: None,
            reset_pending,
            boots: BootMonitor::default(),
            duplicate_reported: false,
            forbidden_data: None,
            forbidden_reported: false,
        }
    }

    /// Records a frame beside its state. `counts` is true if it proves that the node has started.
    pub fn record_activity(&mut self, counts: bool, notices: &mut Vec<SessionNotice>) {
        self.only_heartbeats = false;
        self.mark_present(counts, notices);
    }

    fn mark_present(&mut self, counts: bool, notices: &mut Vec<SessionNotice>) {
        self.in_use |= counts;
        if !self.seen {
            self.seen = true;
            notices.push(self.change_notice("presence", "", "present"));
        }
    }

    /// Records a request without a reply, or a repetition. Returns whether to report it: once until it replies, and for
    /// a node without any received frame only after several requests.
    pub fn record_unanswered(&mut self, given_up: bool) -> bool {
        let first = !self.unanswered_reported;
        if given_up {
            self.unanswered_count = self.unanswered_count.saturating_add(1);
            self.unanswered_reported = true;
        }
        // A host that searches for nodes asks each number; silence there is normal.
        if self.seen { first } else { given_up && self.unanswered_count == UNHEARD_MAX }
    }

    /// Records a reply.
    pub fn record_answer(&mut self, notices: &mut Vec<SessionNotice>) {
        self.unanswered_reported = false;
        self.record_activity(true, notices);
    }

    /// Records a guarding request.
    pub fn record_guard_request(&mut self, at: FrameRef, notices: &mut Vec<SessionNotice>) {
        self.expire_guard(notices);
        self.guard.record_request(at);
    }

    /// Records a guarding request without a reply.
    pub fn expire_guard(&mut self, notices: &mut Vec<SessionNotice>) {
        if self.guard.give_up(self.id, notices) && self.record_unanswered(true) {
            let text = "does not answer to guarding".to_owned();
            notices.push(anomaly(AnomalyKind::Unanswered, self.id, text));
        }
    }

    fn change_notice(
        &self,
        what: InternedName,
        from: InternedName,
        to: InternedName,
    ) -> SessionNotice {
        SessionNotice::Change(ChangeNotice { axis: Some(self.id.into()), what, from, to })
    }

    fn set_state(&mut self, state: NmtState, notices: &mut Vec<SessionNotice>) {
        if self.state != Some(state) {
            let from = self.state.map_or("", NmtState::name);
            notices.push(self.change_notice("nmt", from, state.name()));
            (self.previous_state, self.state) = (self.state, Some(state));
        }
    }

    /// The master orders something of it.
    pub fn handle_command(
        &mut self,
        command: NmtCommand,
        now: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        // After an order a change of state is expected, and proves no second device.
        (self.flips, self.forbidden_data, self.forbidden_reported) = (0, None, false);
        let state = match command {
            NmtCommand::Start => NmtState::Operational,
            NmtCommand::Stop => NmtState::Stopped,
            NmtCommand::PreOperational => NmtState::PreOperational,
            NmtCommand::ResetNode | NmtCommand::ResetCommunication => {
                (self.reset_pending, self.commanded) = (true, None);
                self.heartbeat.suspend();
                self.guard.restart();
                return;
            }
            NmtCommand::Other(_) => return,
        };
        self.commanded = Some((state, now));
        // A reported state is certain; for other nodes the command is all there is.
        if self.seen && !self.heartbeat.is_seen() && !self.guard.is_seen() {
            self.set_state(state, notices);
        }
    }

    /// Handles a 0, which mostly means a start. `beginning` is true if its heartbeat is being enabled. True if it has
    /// started for sure.
    pub fn handle_boot_up(
        &mut self,
        now: Option<Timestamp>,
        beginning: bool,
        notices: &mut Vec<SessionNotice>,
    ) -> bool {
        let about = BootContext {
            only_zero: self.state == Some(NmtState::BootUp),
            in_use: self.in_use,
            reset_ordered: core::mem::take(&mut self.reset_pending),
            heartbeat_starting: beginning,
            period: self.heartbeat.last_period(),
        };
        let zero = self.boots.classify(now, &about);
        if zero == ZeroMeaning::Heartbeat {
            return false;
        }
        if zero == ZeroMeaning::Restart {
            self.report_restart(None, notices);
        }
        self.mark_present(false, notices);
        (self.in_use, self.commanded, self.forbidden_data) = (false, None, None);
        self.heartbeat.suspend();
        self.guard.restart();
        self.set_state(NmtState::BootUp, notices);
        self.flips = 0;
        true
    }

    fn report_restart(&self, when: Option<Timestamp>, notices: &mut Vec<SessionNotice>) {
        if !self.duplicate_reported {
            let text = "started again by no order, while it was in use".to_owned();
            notices.push(anomaly_at(AnomalyKind::Restart, self.id, when, text));
        }
    }

    /// Confirms a suspicion on its boot-ups: by `now`, or in any case.
    pub fn confirm_suspicion(&mut self, now: Option<Timestamp>, notices: &mut Vec<SessionNotice>) {
        let Some(suspicion) = self.boots.take_confirmed(now) else { return };
        if suspicion.kind == AnomalyKind::Restart {
            return self.report_restart(suspicion.when, notices);
        }
        let ms = suspicion.after / 1_000_000;
        self.report_duplicate(&format!("started twice within {ms} ms, by one order"), notices);
    }

    /// Two devices have its number.
    pub fn report_duplicate(&mut self, why: &str, notices: &mut Vec<SessionNotice>) {
        if !core::mem::replace(&mut self.duplicate_reported, true) {
            let text = format!("two devices may have this node-ID: {why}");
            notices.push(anomaly(AnomalyKind::DuplicateAddress, self.id, text));
        }
    }

    /// Handles a heartbeat with its state.
    pub fn handle_heartbeat(
        &mut self,
        state: NmtState,
        now: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        self.handle_state(state, now, notices);
        if self.heartbeat.record(now) {
            notices.push(self.change_notice("presence", "silent", "present"));
        }
        if let Some(why) = self.heartbeat.two_senders() {
            self.report_duplicate(why, notices);
        }
    }

    /// Handles its state, from a heartbeat or a reply.
    pub fn handle_state(
        &mut self,
        state: NmtState,
        now: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        self.mark_present(true, notices);
        // Any state proves that the start is over, also where its boot-up message was lost.
        self.reset_pending = false;
        // Makers use spare numbers for states of their own.
        if matches!(state, NmtState::Other(_)) {
            return;
        }
        // A state right after two boot-ups: the node runs, so both were real.
        self.confirm_suspicion(None, notices);
        if let (Some((ordered, when)), true) = (self.commanded, self.state != Some(state)) {
            // A state that is sent at once may be the previous one.
            let soon = when.zip(now).is_none_or(|(when, now)| now.since(when) < QUIET_NS);
            if ordered != state && soon {
                return;
            }
        }
        self.check_flips(state, notices);
        self.report_forbidden_data(state, notices);
        self.commanded = None;
        self.set_state(state, notices);
    }

    /// Looks whether its state goes back and forth by no order, as two nodes' would.
    fn check_flips(&mut self, state: NmtState, notices: &mut Vec<SessionNotice>) {
        if self.state == Some(state) {
            self.same_count = self.same_count.saturating_add(1);
            return;
        }
        let back = self.commanded.is_none()
            && self.previous_state == Some(state)
            && self.same_count < SAME_MAX;
        (self.flips, self.same_count) = (if back { self.flips + 1 } else { 0 }, 0);
        if self.flips == FLIPS_MAX {
            let other = self.state.map_or("", NmtState::name);
            let why = format!("it is {} and {other} by turns, by no order", state.name());
            self.report_duplicate(&why, notices);
        }
    }

    /// Reports process data between two states that forbid them, without a command.
    fn report_forbidden_data(&mut self, state: NmtState, notices: &mut Vec<SessionNotice>) {
        let Some(when) = self.forbidden_data.take() else { return };
        let quiet = matches!(state, NmtState::PreOperational | NmtState::Stopped);
        if quiet
            && self.state == Some(state)
            && self.commanded.is_none()
            && !self.forbidden_reported
        {
            self.forbidden_reported = true;
            let text = format!("sends process data although it is {}", state.name());
            notices.push(anomaly_at(AnomalyKind::Malformed, self.id, when, text));
        }
    }

    /// Process data of it change nothing: it is there, and may send them.
    pub const fn may_send_data(&self) -> bool {
        let free = !matches!(self.state, Some(NmtState::PreOperational | NmtState::Stopped))
            && !matches!(self.commanded, Some((NmtState::PreOperational | NmtState::Stopped, _)));
        free && self.seen && self.in_use && !self.only_heartbeats
    }

    /// Records process data.
    pub fn record_process_data(
        &mut self,
        now: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        self.record_activity(true, notices);
        let reported = matches!(self.state, Some(NmtState::PreOperational | NmtState::Stopped));
        if reported && self.commanded.is_none() && self.heartbeat.is_seen() {
            self.forbidden_data.get_or_insert(now);
        }
        // Without a heartbeat the command is the best knowledge.
        if let Some((state @ (NmtState::PreOperational | NmtState::Stopped), Some(when))) =
            self.commanded
            && now.is_some_and(|now| now.since(when) > QUIET_NS)
            && !core::mem::replace(&mut self.forbidden_reported, true)
        {
            let text = format!("sends process data although a command set it to {}", state.name());
            notices.push(anomaly(AnomalyKind::Malformed, self.id, text));
        }
    }

    /// Checks for a missing heartbeat.
    pub fn check_silence(
        &mut self,
        now: Timestamp,
        commanded: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        let last = self.heartbeat.last();
        let Some((period, since)) = self.heartbeat.check_missed(now) else { return };
        notices.push(self.change_notice("presence", "present", "silent"));
        // A master that has ended asks nothing any more either.
        if self.only_heartbeats && commanded < last {
            return;
        }
        let (ms, every) = (since / 1_000_000, period / 1_000_000);
        let text = format!("no heartbeat for {ms} ms, which came every {every} ms");
        notices.push(anomaly(AnomalyKind::Silent, self.id, text));
    }
}
