//! Learns from the values of objects that the capture shows being read or written. They are valid from then
//! on.

use polepair_core::profile::Profile;
use polepair_core::proto::canopen::cia402;
use polepair_core::proto::canopen::cob;
use polepair_core::proto::canopen::explain::meanings;
use polepair_core::proto::canopen::pdo::CobId;
use polepair_core::proto::canopen::sdo::ObjectIndex;

use super::meaning::{ObjectLookup, VALUES_MAX};
use super::sdo::{SdoChannel, TransferredValue};
use super::services::Service;
use super::{CHANNELS_MAX, CanopenTracker, pdo};
use crate::session::{Quality, SessionNotice, SignalNotice};

/// Further channels of which something is known.
const CHANNEL_CONFIGS_MAX: usize = 256;

/// A channel that the capture makes: by the node's object 1200h and on, or by its client's 1280h.
#[derive(Clone, Copy, Debug)]
pub(super) struct SdoChannelConfig {
    /// Node with its configuration.
    owner: u8,
    index: u16,
    node: u8,
    request: Option<CobId>,
    reply: Option<CobId>,
}

impl CanopenTracker {
    /// A value was read or written.
    pub(super) fn learn_value(
        &mut self,
        id: u8,
        settled: &TransferredValue,
        notices: &mut Vec<SessionNotice>,
    ) {
        let TransferredValue { object, bits, len, .. } = *settled;
        if is_text(object) {
            return;
        }
        let raw = value_number(object, bits, len, self.node_profile(id));
        let known = self.node_mut(id).values.insert_bounded(object, raw);
        self.identify(id, object, raw, notices);
        if !self.skips_signals {
            self.emit_signals(id, settled, raw, notices);
        }
        let profile = self.node_profile(id);
        let node = self.node_mut(id);
        let mode = node.power.mode();
        if !meanings::is_part_of_word(object, len) {
            node.power.handle_value(id, object, raw, &mut node.faults, profile, notices);
        }
        let mode_now = node.power.mode();
        if mode_now != mode {
            self.pdos.of_node(id).for_each(|pdo| pdo.set_mode(mode_now));
        }
        let drive = match object.index {
            0x1000 => raw as u16 == cia402::PROFILE_NUMBER,
            0x603F..=0x60FF => true,
            _ => false,
        };
        let scales = known != Some(raw) && is_scale(object, profile);
        let node = self.node_mut(id);
        let became = drive && !node.is_drive;
        node.is_drive |= drive;
        if became || scales {
            self.pdos.of_node(id).for_each(pdo::Pdo::clear_mapping);
        }
        if (0x1000..0x2000).contains(&object.index) {
            self.configure(id, object, bits as u32);
        }
    }

    /// Identifies the drive by the value, which decides the names of all its objects.
    fn identify(
        &mut self,
        id: u8,
        object: ObjectIndex,
        raw: i64,
        notices: &mut Vec<SessionNotice>,
    ) {
        let stated = self.stated_profile;
        if let Some(change) = self.node_mut(id).product.learn_value(id, object, raw, stated) {
            notices.push(SessionNotice::Change(change));
            self.pdos.of_node(id).for_each(pdo::Pdo::clear_mapping);
        }
    }

    /// Gives the value as a signal.
    fn emit_signals(
        &mut self,
        id: u8,
        settled: &TransferredValue,
        raw: i64,
        notices: &mut Vec<SessionNotice>,
    ) {
        let (profile, request) = (self.node_profile(id), Some(settled.request_number));
        let book = ObjectLookup { profile, values: &self.node_mut(id).values };
        for meaning in book.meanings(settled.object) {
            let masked = raw & meaning.mask;
            let exact = meaning.equals.map_or(masked, |equals| (masked == equals).into());
            notices.push(SessionNotice::Signal(SignalNotice {
                axis: id.into(),
                name: meaning.name,
                value: meaning.value(exact),
                exact: Some(exact),
                unit: meaning.unit,
                quality: Quality::Good,
                request,
            }));
        }
    }

    /// An object of communication has that value.
    fn configure(&mut self, id: u8, object: ObjectIndex, raw: u32) {
        match (object.index, object.sub) {
            (0x1005, 0) => self.services.assign(CobId(raw).id(), Service::Sync),
            (0x1014, 0) => self.move_emergencies(id, CobId(raw)),
            (0x1016, 1..) => {
                let (node, ms) = ((raw >> 16) as u8, raw & 0xFFFF);
                if (1..=polepair_core::proto::canopen::NODE_MAX).contains(&node) {
                    self.node_mut(node).heartbeat.set_tolerance(ms.into());
                }
            }
            (0x1017, 0) => self.node_mut(id).heartbeat.configure(raw.into()),
            (0x1019, 0) => self.sync.configure(raw as u8),
            (0x1200..=0x12FF, 1..=3) => self.configure_channel(id, object, raw),
            _ => {
                if let Some(moved) = self.pdos.learn_object(id, object, raw) {
                    self.services.move_pdo(&moved, &mut self.pdos);
                }
            }
        }
    }

    fn move_emergencies(&mut self, id: u8, cob: CobId) {
        let usual = u32::from(cob::EMCY | u16::from(id));
        if cob.is_valid() && cob.id() != usual {
            if self.services.lookup(usual, false, &mut self.pdos) == Service::Emcy(id) {
                self.services.assign(usual, Service::Untracked);
            }
            self.services.assign(cob.id(), Service::Emcy(id));
        }
    }

    /// A channel gets its identifiers one by one.
    fn configure_channel(&mut self, owner: u8, ObjectIndex { index, sub }: ObjectIndex, raw: u32) {
        let at = self
            .channel_configs
            .iter()
            .position(|server| (server.owner, server.index) == (owner, index))
            .unwrap_or(self.channel_configs.len());
        if at == CHANNEL_CONFIGS_MAX {
            return;
        }
        if at == self.channel_configs.len() {
            self.channel_configs.push(SdoChannelConfig {
                owner,
                index,
                node: owner,
                request: None,
                reply: None,
            });
        }
        let server = &mut self.channel_configs[at];
        let cob = Some(CobId(raw)).filter(|cob| cob.is_valid() && cob.id() != 0);
        match sub {
            1 => server.request = cob,
            2 => server.reply = cob,
            _ if index >= 0x1280 => server.node = raw as u8 & 0x7F,
            _ => {}
        }
        let SdoChannelConfig { node, request, reply, .. } = *server;
        if let (Some(request), Some(reply), 1..) = (request, reply, node) {
            self.open_channel(node, request.id(), reply.id());
        }
    }

    /// A channel with identifiers of its own.
    fn open_channel(&mut self, node: u8, request: u32, reply: u32) {
        let usual = (cob::SDO_REQUEST | u16::from(node), cob::SDO_REPLY | u16::from(node));
        if (request, reply) == (usual.0.into(), usual.1.into()) {
            return;
        }
        if let Some(at) = self.add_channel(node) {
            self.services.assign(request, Service::Request(at));
            self.services.assign(reply, Service::Reply(at));
        }
    }

    /// One more channel to a node.
    pub(super) fn add_channel(&mut self, node: u8) -> Option<u16> {
        let at = self.channels.len();
        (at < CHANNELS_MAX).then(|| {
            self.channels.push(SdoChannel::new(node, self.start_time));
            at as u16
        })
    }
}

/// The bytes of a value as a number.
fn value_number(object: ObjectIndex, bits: u64, len: u8, profile: Option<&'static Profile>) -> i64 {
    match len {
        0..=4 => meanings::decode_number(object, bits as u32, len, profile),
        _ if meanings::is_signed(object, profile) => {
            let rest = 64 - 8 * u32::from(len.min(8));
            (bits << rest).cast_signed() >> rest
        }
        _ => bits.cast_signed(),
    }
}

/// Name and versions are texts.
const fn is_text(object: ObjectIndex) -> bool {
    matches!(object.index, 0x1008..=0x100A)
}

/// Returns whether scales of other objects hang on this one.
fn is_scale(object: ObjectIndex, profile: Option<&'static Profile>) -> bool {
    let Some(profile) = meanings::canopen_profile(profile) else { return false };
    let scales = profile.parameters.iter().flat_map(|p| p.scale.inputs(profile));
    let mut of = scales.filter_map(|id| profile.parameter(id));
    of.any(|p| (p.index, p.space) == (object.index, object.sub))
}

/// A table that does not grow without end.
trait BoundedInsert {
    /// Puts a value in if there is room, and returns the previous one.
    fn insert_bounded(&mut self, object: ObjectIndex, raw: i64) -> Option<i64>;
}

impl BoundedInsert for std::collections::HashMap<ObjectIndex, i64> {
    fn insert_bounded(&mut self, object: ObjectIndex, raw: i64) -> Option<i64> {
        if self.len() < VALUES_MAX || self.contains_key(&object) {
            return self.insert(object, raw);
        }
        None
    }
}
