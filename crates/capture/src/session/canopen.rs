//! Conversations of CANopen nodes on one bus: SDO transfers with several frames, process data by the
//! mapping that the capture shows, and states of nodes.
//!
//! ```text
//!   services   whose an identifier is: by default, or as the capture moved it
//!    ├ sdo     transfers, one at a time on each channel
//!    ├ pdo     contents of PDOs; mapping, the place of each value; meaning, its object; wording;
//!    │         process, all of these put together
//!    ├ node    NMT state and presence, by beat (heartbeat) and guard; who shares a number
//!    ├ emcy    faults
//!    ├ power   the states of a CiA 402 drive
//!    ├ sync    the beat of the bus
//!    ├ lss     layer setting
//!    ├ product the drive that a node identifies as
//!    └ learn   what the values of objects teach about all of these
//! ```

mod annotate;
mod boot;
mod emcy;
mod guard;
mod heartbeat;
mod learn;
mod lss;
mod mapping;
mod meaning;
mod node;
mod pdo;
mod power;
mod process_data;
mod process_text;
mod product;
mod sdo;
mod services;
mod sync;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use polepair_core::explain::RawFrame;
use polepair_core::medium::Frame;
use polepair_core::profile::Profile;
use polepair_core::proto::canopen::NODE_MAX;
use polepair_core::proto::canopen::cia402::STATUSWORD;
use polepair_core::proto::canopen::cob;
use polepair_core::proto::canopen::emcy::Emergency;
use polepair_core::proto::canopen::heartbeat::Heartbeat;
use polepair_core::proto::canopen::nmt::{NmtCommand, NmtMessage, NmtState};
use polepair_core::proto::canopen::sdo::ObjectIndex;
use polepair_core::proto::canopen::sync::SyncMessage;

use super::{AnomalyKind, AnomalyNotice, ObservedFrame, ProtocolTracker, SessionNotice};
use crate::explanation::Explanation;
use crate::timestamp::Timestamp;
use lss::LssTracker;
pub use mapping::{MappedValue, Mapping};
use meaning::ObjectLookup;
use node::NodeTracker;
use pdo::{MappingContext, PdoTable};
pub use process_data::ProcessData;
pub(crate) use process_text::ProcessText;
use sdo::SdoChannel;
use services::{Service, ServiceTable};
use sync::SyncMonitor;

/// Channels of service data on one bus: one a node, and those that the capture makes.
const CHANNELS_MAX: usize = 3 * NODE_MAX as usize;
/// A node-ID is an index into the table of nodes.
const NODES: usize = NODE_MAX as usize + 1;

/// Follows the CANopen of one bus.
#[derive(Debug)]
pub(super) struct CanopenTracker {
    skips_signals: bool,
    services: ServiceTable,
    pdos: PdoTable,
    channels: Vec<SdoChannel>,
    channel_configs: Vec<learn::SdoChannelConfig>,
    nodes: Vec<Option<Box<NodeTracker>>>,
    sync: SyncMonitor,
    lss: LssTracker,
    /// Drive whose names are used for nodes that do not identify as another one.
    profile: Option<&'static Profile>,
    /// Drive that a person stated.
    stated_profile: Option<&'static Profile>,
    /// Time of the capture's begin, and of the last frame.
    start_time: Option<Timestamp>,
    last_time: Option<Timestamp>,
    /// Nothing is due before.
    next_due: Timestamp,
    /// True if requests are in the capture of this bus.
    sees_requests: bool,
    /// Everybody was ordered to start again.
    all_reset: bool,
    /// Time of the master's last frame: a request, an NMT command, a heartbeat, process data to a node.
    last_command: Option<Timestamp>,
}

/// Period of a node's heartbeat.
const HEARTBEAT_TIME: ObjectIndex = ObjectIndex::new(0x1017, 0);
const NEVER: Timestamp = Timestamp(u64::MAX);

impl CanopenTracker {
    /// A tracker, without notices of the values of objects if `skips_signals`.
    pub(super) fn new(skips_signals: bool) -> Self {
        Self {
            skips_signals,
            services: ServiceTable::default(),
            pdos: PdoTable::default(),
            channels: (0..=NODE_MAX).map(|node| SdoChannel::new(node, None)).collect(),
            channel_configs: Vec::new(),
            nodes: (0..NODES).map(|_| None).collect(),
            sync: SyncMonitor::default(),
            lss: LssTracker::default(),
            profile: None,
            stated_profile: None,
            start_time: None,
            last_time: None,
            next_due: NEVER,
            sees_requests: false,
            all_reset: false,
            last_command: None,
        }
    }
}

impl ProtocolTracker for CanopenTracker {
    fn handle_frame(
        &mut self,
        observed: &ObservedFrame<'_>,
        explanation: &mut Explanation,
        notices: &mut Vec<SessionNotice>,
    ) {
        let Some(id) = observed.raw.id.filter(|_| !observed.echo) else { return };
        if self.start_time.is_none() {
            self.start_time = observed.time;
            self.channels.iter_mut().for_each(|channel| channel.set_start(observed.time));
        }
        self.set_profile(observed.profile, observed.profile_stated);
        let bytes = observed.raw.bytes;
        let service = self.services.lookup(id, observed.raw.extended, &mut self.pdos);
        if self.is_from_master(service) {
            self.last_command = observed.time.max(self.last_command);
        }
        if observed.deferred && !matches!(service, Service::Pdo(_)) {
            annotate::explain_as_default(bytes, observed.raw.id, self.profile, explanation);
        }
        match service {
            Service::Pdo(_) if observed.remote => {}
            Service::Pdo(at) => self.handle_process_data(at.into(), observed, explanation, notices),
            Service::State(node) => self.handle_state(node, observed, notices),
            _ if observed.remote => {}
            Service::Request(at) => self.handle_request(at.into(), observed, explanation, notices),
            Service::Reply(at) => self.handle_reply(at.into(), observed, explanation, notices),
            Service::Nmt => self.handle_nmt(bytes, observed.time, notices),
            Service::Emcy(node) => self.handle_emergency(node, observed, explanation, notices),
            Service::Sync => {
                if let Ok(SyncMessage { counter }) = SyncMessage::parse(bytes) {
                    self.sync.handle_sync(counter, observed.time, notices);
                }
            }
            Service::Lss(asks) => self.handle_lss(asks, observed, notices),
            Service::Unknown | Service::Untracked => {}
        }
        self.last_time = observed.time.max(self.last_time);
    }

    fn advance_time(&mut self, now: Timestamp, notices: &mut Vec<SessionNotice>) {
        if now > self.next_due {
            self.check_deadlines(now, notices);
        }
    }

    fn unchanged_process_data(
        &mut self,
        frame: &Frame,
        now: Timestamp,
    ) -> Option<&Arc<ProcessData>> {
        let Service::Pdo(at) = self.services.cached(frame.id) else { return None };
        if now > self.next_due || self.start_time.is_none() {
            return None;
        }
        let pdo = &self.pdos.all[usize::from(at)];
        let process = pdo.matching_process_data(frame.len)?;
        let node = self.nodes[usize::from(pdo.node)].as_deref_mut()?;
        if pdo.from_node {
            let free = node.may_send_data();
            let data = u64::from_le_bytes(frame.data);
            (free && process.is_unchanged(data, &mut node.power)).then_some(())?;
        } else {
            self.last_command = Some(now).max(self.last_command);
        }
        self.last_time = Some(now).max(self.last_time);
        Some(process)
    }

    fn is_repeatable(&self, id: u32) -> bool {
        use Service::{Nmt, Request, State, Sync};
        // Also where one was moved to an answer's place: the dissector looks at no request.
        matches!(self.services.cached(id), Nmt | Sync | State(_) | Request(_))
    }

    fn keeps_explanation(&self, frame: &RawFrame<'_>) -> bool {
        let Some(id) = frame.id.filter(|_| !frame.extended) else { return false };
        let Some(bytes) = service_bytes(frame.bytes) else { return false };
        let (at, function) = match self.services.cached(id) {
            Service::Request(at) => (at, cob::SDO_REQUEST),
            Service::Reply(at) => (at, cob::SDO_REPLY),
            _ => return false,
        };
        let channel = &self.channels[usize::from(at)];
        let is_usual = id == u32::from(function | u16::from(channel.node));
        // A node that is known by now has other names than those of the explanation.
        is_usual
            && !self.naming_profile(channel.node).1
            && match function {
                cob::SDO_REQUEST => channel.begins_read(bytes),
                // Its bits get names by the mode.
                _ => channel.ends_read(bytes) && channel.object() != STATUSWORD,
            }
    }

    fn claims_id(&self, id: u32, extended: bool) -> bool {
        self.services.claims_id(id, extended)
    }

    fn finish(&mut self, notices: &mut Vec<SessionNotice>) {
        self.channels.iter_mut().for_each(|channel| channel.finish(notices));
        self.lss.finish(notices);
        self.nodes.iter_mut().flatten().for_each(|node| node.confirm_suspicion(None, notices));
    }
}

impl CanopenTracker {
    /// The names that count from now on.
    fn set_profile(&mut self, profile: Option<&'static Profile>, stated: bool) {
        self.stated_profile = profile.filter(|_| stated);
        let same = match (self.profile, profile) {
            (Some(one), Some(other)) => core::ptr::eq(one, other),
            (one, other) => one.is_none() && other.is_none(),
        };
        if !same {
            self.profile = profile;
            self.pdos.all.iter_mut().for_each(pdo::Pdo::clear_mapping);
        }
    }

    /// The drive whose names a node has.
    fn node_profile(&self, id: u8) -> Option<&'static Profile> {
        let node = self.nodes[usize::from(id & NODE_MAX)].as_deref();
        node.map_or(self.profile, |node| node.product.naming_profile(self.profile))
    }

    /// Profile for the names of a node, and whether the frame was explained by other names.
    fn naming_profile(&self, id: u8) -> (Option<&'static Profile>, bool) {
        let profile = self.node_profile(id);
        (profile, profile_address(profile) != profile_address(self.profile))
    }

    fn is_from_master(&self, service: Service) -> bool {
        match service {
            Service::Nmt | Service::Sync | Service::Request(_) | Service::Lss(true) => true,
            Service::Pdo(at) => !self.pdos.all[usize::from(at)].from_node,
            _ => false,
        }
    }

    fn node_mut(&mut self, node: u8) -> &mut NodeTracker {
        let node_tracker = &mut self.nodes[usize::from(node & NODE_MAX)];
        node_tracker.get_or_insert_with(|| Box::new(NodeTracker::new(node, self.all_reset)))
    }

    /// Something is due then.
    fn schedule(&mut self, due: Option<Timestamp>) {
        self.next_due = due.map_or(self.next_due, |due| self.next_due.min(due));
    }

    /// Reports deadlines that have passed.
    fn check_deadlines(&mut self, now: Timestamp, notices: &mut Vec<SessionNotice>) {
        for at in 0..self.channels.len() {
            let before = notices.len();
            self.channels[at].advance_time(now, notices);
            self.suppress_unanswered(at, before, Some(now), notices);
        }
        self.lss.advance_time(now, notices);
        for node in self.nodes.iter_mut().flatten() {
            if node.guard.due().is_some_and(|due| due < now) {
                node.expire_guard(notices);
            }
            node.confirm_suspicion(Some(now), notices);
        }
        self.check_heartbeats(now, notices);
        self.next_due = NEVER;
        let channels = self.channels.iter().filter_map(SdoChannel::due);
        let nodes = self.nodes.iter().flatten();
        let nodes = nodes
            .flat_map(|node| [node.heartbeat.due(), node.guard.due(), node.boots.due()])
            .flatten();
        self.next_due = channels.chain(nodes).chain(self.lss.due()).min().unwrap_or(NEVER);
    }

    /// Checks for missing heartbeats. If no frame at all was received, several nodes are not silent: the capture
    /// paused, or the bus was down.
    fn check_heartbeats(&mut self, now: Timestamp, notices: &mut Vec<SessionNotice>) {
        let missing = self.nodes.iter().flatten().filter_map(|node| missed_heartbeat(node, now));
        let (count, first) = missing.fold((0, NEVER), |(n, first), due| (n + 1, first.min(due)));
        let paused = count > 1 && self.last_time.is_some_and(|latest| latest < first);
        if let (true, Some(latest)) = (paused, self.last_time) {
            let ms = now.since(latest) / 1_000_000;
            let text = format!("no frame of any node for {ms} ms, {count} heartbeats are missing");
            let (kind, axis, time) = (AnomalyKind::Silent, None, Some(latest));
            notices.push(SessionNotice::Anomaly(AnomalyNotice { kind, axis, time, text }));
        }
        for node in self.nodes.iter_mut().flatten() {
            if paused {
                node.heartbeat.suspend();
            } else {
                node.check_silence(now, self.last_command, notices);
            }
        }
    }

    /// Suppresses notices of unanswered requests in a search for nodes; repeated requests give one. The notice waits
    /// for a reply that is only late.
    fn suppress_unanswered(
        &mut self,
        channel: usize,
        before: usize,
        now: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        if notices.len() == before {
            return;
        }
        let node = self.channels[channel].node;
        let mut at = before;
        while at < notices.len() {
            let given_up = match &notices[at] {
                SessionNotice::Anomaly(anomaly) if sdo::is_unanswered(anomaly) => Some(true),
                SessionNotice::Anomaly(AnomalyNotice { kind: AnomalyKind::Retry, .. }) => {
                    Some(false)
                }
                _ => None,
            };
            match given_up {
                Some(given_up) if !self.node_mut(node).record_unanswered(given_up) => {
                    notices.remove(at);
                }
                _ => at += 1,
            }
        }
        self.channels[channel].hold_unanswered(before, now, notices);
        let due = self.channels[channel].due();
        self.schedule(due);
    }

    /// The master orders something of one node, or of all that are known.
    fn handle_nmt(
        &mut self,
        bytes: &[u8],
        now: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        let Ok(NmtMessage { command, node }) = NmtMessage::parse(bytes) else { return };
        if matches!(command, NmtCommand::Other(_)) {
            return;
        }
        self.sync.restart_counter();
        if node != 0 {
            self.node_mut(node);
        }
        for known in self.nodes.iter_mut().flatten().filter(|n| node == 0 || n.id == node) {
            known.handle_command(command, now, notices);
        }
        if matches!(command, NmtCommand::ResetNode | NmtCommand::ResetCommunication) {
            self.all_reset |= node == 0;
            self.channels
                .iter_mut()
                .filter(|channel| node == 0 || channel.node == node)
                .for_each(|it| it.reset(now, notices));
        }
    }

    /// Boot-up, heartbeat, or guarding.
    fn handle_state(
        &mut self,
        id: u8,
        observed: &ObservedFrame<'_>,
        notices: &mut Vec<SessionNotice>,
    ) {
        let at = (observed.number, observed.time);
        if observed.remote {
            let node = self.node_mut(id);
            node.record_guard_request(at, notices);
            let due = node.guard.due();
            return self.schedule(due);
        }
        let Ok(Heartbeat { state, toggle }) = Heartbeat::parse(observed.raw.bytes) else { return };
        let beginning = self.channels[usize::from(id)].is_writing(HEARTBEAT_TIME, observed.time);
        let node = self.node_mut(id);
        if state == NmtState::BootUp {
            let started = node.handle_boot_up(observed.time, beginning, notices);
            let due = node.boots.due();
            self.schedule(due);
            if started {
                self.handle_restart(id, observed.time, notices);
            }
        } else if node.guard.handle_answer(id, toggle, at, notices) {
            node.record_answer(notices);
            node.handle_state(state, observed.time, notices);
        } else {
            node.handle_heartbeat(state, observed.time, notices);
            let due = node.heartbeat.due();
            self.schedule(due);
        }
    }

    /// Handles a node's start: its settings may be lost, running transfers are.
    fn handle_restart(&mut self, id: u8, now: Option<Timestamp>, notices: &mut Vec<SessionNotice>) {
        self.pdos.of_node(id).for_each(pdo::Pdo::mark_stale);
        self.channels
            .iter_mut()
            .filter(|channel| channel.node == id)
            .for_each(|channel| channel.reset(now, notices));
    }

    fn handle_emergency(
        &mut self,
        id: u8,
        observed: &ObservedFrame<'_>,
        explanation: &mut Explanation,
        notices: &mut Vec<SessionNotice>,
    ) {
        let bytes = observed.raw.bytes;
        let default = u32::from(cob::EMCY | u16::from(id));
        let (profile, renamed) = self.naming_profile(id);
        if renamed || observed.raw.id != Some(default) {
            annotate::explain_as_default(bytes, Some(default), profile, explanation);
        }
        let Ok(emergency) = Emergency::parse(bytes) else { return };
        let words = emcy::FaultText::lookup(emergency.code.into(), bytes.len() == 2, profile);
        if words.inferred {
            annotate::annotate_inferred(&words, explanation);
        }
        let node = self.node_mut(id);
        // A starting node reports that it has no fault, before or behind its boot-up.
        node.record_activity(emergency.code != 0, notices);
        node.faults.handle_emergency(id, &emergency, words, observed.time, notices);
    }

    /// Reads process data by their mapping.
    fn handle_process_data(
        &mut self,
        at: usize,
        observed: &ObservedFrame<'_>,
        explanation: &mut Explanation,
        notices: &mut Vec<SessionNotice>,
    ) {
        let bytes = observed.raw.bytes;
        let Ok(len @ 0..=8) = u8::try_from(bytes.len()) else { return };
        let (id, reported) = (self.pdos.all[at].node, self.pdos.all[at].from_node);
        self.node_mut(id);
        let profile = self.node_profile(id);
        let Some(node) = self.nodes[usize::from(id)].as_deref_mut() else { return };
        if reported {
            node.record_process_data(observed.time, notices);
        }
        let pdo = &mut self.pdos.all[at];
        let book = ObjectLookup { profile, values: &node.values };
        pdo.resolve_mapping(
            len,
            &MappingContext {
                lookup: book,
                is_drive: node.is_drive,
                values_only: explanation.is_values_only(),
            },
        );
        pdo.check_length(len, notices);
        let mode = node.power.mode();
        if let Some(process) = pdo.process_data().filter(|it| len >= it.mapping().bytes()) {
            let data = bytes_to_word(bytes);
            process.mapping().for_each_signal(data, |mapped, exact, value| {
                if process.tells_state(mapped) {
                    let (power, faults) = (&mut node.power, &mut node.faults);
                    power.handle_value(id, mapped.object, exact, faults, profile, notices);
                }
                notices.push(process.signal_notice(mapped, exact, value));
            });
        }
        // The words of a statusword are those of the mode, which may come in the same frame.
        let mode_now = node.power.mode();
        if mode_now != mode {
            self.pdos.of_node(id).for_each(|pdo| pdo.set_mode(mode_now));
        }
        let pdo = &mut self.pdos.all[at];
        annotate::explain_process_data(
            pdo,
            bytes,
            observed.raw.id,
            (profile, mode_now),
            explanation,
        );
    }

    fn handle_request(
        &mut self,
        at: usize,
        observed: &ObservedFrame<'_>,
        explanation: &mut Explanation,
        notices: &mut Vec<SessionNotice>,
    ) {
        let Some(bytes) = service_bytes(observed.raw.bytes) else { return };
        let (before, position) = (notices.len(), (observed.number, observed.time));
        self.sees_requests = true;
        let part = self.channels[at].handle_request(bytes, position, notices);
        let channel = &self.channels[at];
        let (profile, renamed) = self.naming_profile(channel.node);
        let usual = u32::from(cob::SDO_REQUEST | u16::from(channel.node));
        let moved = renamed || observed.raw.id != Some(usual);
        annotate::annotate_part(
            channel,
            part,
            observed.raw.bytes,
            false,
            moved,
            profile,
            explanation,
        );
        let due = channel.due();
        self.schedule(due);
        self.learn_transferred(at, notices);
        self.suppress_unanswered(at, before, observed.time, notices);
    }

    fn handle_reply(
        &mut self,
        at: usize,
        observed: &ObservedFrame<'_>,
        explanation: &mut Explanation,
        notices: &mut Vec<SessionNotice>,
    ) {
        let Some(bytes) = service_bytes(observed.raw.bytes) else { return };
        let position = (observed.number, observed.time);
        let id = self.channels[at].node;
        self.node_mut(id).record_answer(notices);
        let channel = &mut self.channels[at];
        let part = channel.handle_reply(bytes, position, self.sees_requests, notices);
        let (two, due) = (channel.is_answered_by_two(), channel.due());
        let (profile, renamed) = self.naming_profile(id);
        let moved = renamed || observed.raw.id != Some(u32::from(cob::SDO_REPLY | u16::from(id)));
        annotate::annotate_part(
            &self.channels[at],
            part,
            observed.raw.bytes,
            true,
            moved,
            profile,
            explanation,
        );
        self.schedule(due);
        if two {
            self.node_mut(id).report_duplicate("its requests are answered twice", notices);
        }
        self.learn_transferred(at, notices);
        if self.channels[at].object() == STATUSWORD {
            process_text::name_status_bits(self.node_mut(id).power.mode(), &mut explanation.text);
        }
    }

    /// Handles an LSS frame, of the master or a device.
    fn handle_lss(
        &mut self,
        asks: bool,
        observed: &ObservedFrame<'_>,
        notices: &mut Vec<SessionNotice>,
    ) {
        let at = (observed.number, observed.time);
        let Some(bytes) =
            service_bytes(observed.raw.bytes).filter(|_| observed.raw.bytes.len() == 8)
        else {
            return;
        };
        if asks {
            self.lss.handle_request(bytes, at, notices)
        } else {
            self.lss.handle_reply(bytes, at, notices)
        }
        let due = self.lss.due();
        self.schedule(due);
    }

    /// Learns the value of a transfer.
    fn learn_transferred(&mut self, at: usize, notices: &mut Vec<SessionNotice>) {
        let id = self.channels[at].node;
        if let Some(settled) = self.channels[at].take_transferred() {
            self.learn_value(id, &settled, notices);
        }
    }
}

fn missed_heartbeat(node: &NodeTracker, now: Timestamp) -> Option<Timestamp> {
    node.heartbeat.due().filter(|due| *due < now)
}

fn profile_address(profile: Option<&'static Profile>) -> Option<*const Profile> {
    profile.map(core::ptr::from_ref)
}

/// Up to eight bytes as a number, the first lowest.
fn bytes_to_word(bytes: &[u8]) -> u64 {
    let mut all = [0; 8];
    all.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
    u64::from_le_bytes(all)
}

/// Service data of eight bytes, or of seven where the last does not count.
fn service_bytes(bytes: &[u8]) -> Option<[u8; 8]> {
    matches!(bytes.len(), 7 | 8).then(|| bytes_to_word(bytes).to_le_bytes())
}

/// Something that a healthy bus does not do.
fn anomaly(kind: AnomalyKind, node: u8, text: String) -> SessionNotice {
    anomaly_at(kind, node, None, text)
}

/// An anomaly with an earlier time than that of its frame.
fn anomaly_at(kind: AnomalyKind, node: u8, time: Option<Timestamp>, text: String) -> SessionNotice {
    SessionNotice::Anomaly(AnomalyNotice { kind, axis: Some(node.into()), time, text })
}
