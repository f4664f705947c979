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

/// A node that was told to be quiet may still send what was on its way.
const QUIET_NS: u64 = 100_000_000;
/// A state that goes back and forth so often without an order is two nodes'.
const FLIPS_MAX: u8 = 3;
/// The same state so often is one node's.
const SAME_MAX: u8 = 4;
/// Requests to a node that was never heard, until that is told: whoever looks who is there asks less.
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
    /// It is a drive by CiA 402.
    pub is_drive: bool,
    /// What its objects were last seen to be.
    pub values: HashMap<ObjectIndex, i64>,
    seen: bool,
    /// Nothing but its heartbeat was heard of it.
    only_heartbeats: bool,
    /// It said something since it started.
    in_use: bool,
    unanswered_count: u8,
    /// That it does not answer was told.
    unanswered_reported: bool,
    state: Option<NmtState>,
    previous_state: Option<NmtState>,
    flips: u8,
    /// How often it told the same state since the last other one.
    same_count: u8,
    /// What the master last ordered, and when, while the node has not told its state since.
    commanded: Option<(NmtState, Option<Timestamp>)>,
    reset_pending: bool,
    pub boots: BootMonitor,
    duplicate_reported: bool,
    /// It sent process data while it said that it must not.
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

    /// It said something beside its state. `counts` tells that it has started by then.
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

    /// A request had no answer, or was sent again. Whether that is told: once until it answers, and
    /// of a node that was never heard only when it was asked again and again.
    pub fn record_unanswered(&mut self, given_up: bool) -> bool {
        let first = !self.unanswered_reported;
        if given_up {
            self.unanswered_count = self.unanswered_count.saturating_add(1);
            self.unanswered_reported = true;
        }
        if self.seen { first } else { given_up && self.unanswered_count == UNHEARD_MAX }
    }

    /// It answered a request.
    pub fn record_answer(&mut self, notices: &mut Vec<SessionNotice>) {
        self.unanswered_reported = false;
        self.record_activity(true, notices);
    }

    /// It is asked for its state.
    pub fn record_guard_request(&mut self, at: FrameRef, notices: &mut Vec<SessionNotice>) {
        self.expire_guard(notices);
        self.guard.record_request(at);
    }

    /// It did not tell its state.
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
        // Who tells its state is believed, of others the order is all there is.
        if self.seen && !self.heartbeat.is_seen() && !self.guard.is_seen() {
            self.set_state(state, notices);
        }
    }

    /// It says 0: that it has started, mostly. `beginning` tells that its heartbeat is being switched
    /// on. True if it has started for sure.
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

    /// What was suspected of its boot-ups is so: by `now`, or in any case.
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

    /// It tells its state by itself.
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

    /// It tells its state, by itself or because it was asked.
    pub fn handle_state(
        &mut self,
        state: NmtState,
        now: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        self.mark_present(true, notices);
        self.reset_pending = false;
        if matches!(state, NmtState::Other(_)) {
            return;
        }
        self.confirm_suspicion(None, notices);
        if let (Some((ordered, when)), true) = (self.commanded, self.state != Some(state)) {
            // A state told at once may be that of before.
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

    /// It sent process data, said before and says now that it must not, and nobody ordered anything.
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

    /// It sent process data.
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
        // Without a heartbeat the order is what it was told to be.
        if let Some((state @ (NmtState::PreOperational | NmtState::Stopped), Some(when))) =
            self.commanded
            && now.is_some_and(|now| now.since(when) > QUIET_NS)
            && !core::mem::replace(&mut self.forbidden_reported, true)
        {
            let text = format!("sends process data although it was told to be {}", state.name());
            notices.push(anomaly(AnomalyKind::Malformed, self.id, text));
        }
    }

    /// Its heartbeat stays out.
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
