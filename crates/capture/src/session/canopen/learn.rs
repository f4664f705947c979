//! What the values of objects teach: whoever reads or writes them in the capture, they hold from
//! then on.

use polepair_core::profile::Profile;
use polepair_core::proto::canopen::cia402;
use polepair_core::proto::canopen::cob;
use polepair_core::proto::canopen::explain::say;
use polepair_core::proto::canopen::pdo::CobId;
use polepair_core::proto::canopen::sdo::Object;

use super::meaning::{Book, VALUES_MAX};
use super::sdo::{Channel, Settled};
use super::services::Service;
use super::{CHANNELS_MAX, Canopen, pdo};
use crate::session::{Notice, Quality, Signal};

/// Further channels of which something is known.
const SERVERS_MAX: usize = 256;

/// A channel that the capture makes: by the node's object 1200h and on, or by its client's 1280h.
#[derive(Clone, Copy, Debug)]
pub(super) struct Server {
    /// Where it is configured.
    owner: u8,
    index: u16,
    node: u8,
    request: Option<CobId>,
    reply: Option<CobId>,
}

impl Canopen {
    /// A value was read or written.
    pub(super) fn learn(&mut self, id: u8, settled: &Settled, notices: &mut Vec<Notice>) {
        let Settled { object, bits, len, .. } = *settled;
        if is_text(object) {
            return;
        }
        let raw = number(object, bits, len, self.profile_of(id));
        let known = self.node(id).values.insert_bounded(object, raw);
        self.identify(id, object, raw, notices);
        self.tell(id, settled, raw, notices);
        let profile = self.profile_of(id);
        let node = self.node(id);
        node.power.take(id, object, raw, &mut node.faults, profile, notices);
        let drive = match object.index {
            0x1000 => raw as u16 == cia402::PROFILE_NUMBER,
            0x603F..=0x60FF => true,
            _ => false,
        };
        let scales = known != Some(raw) && is_scale(object, profile);
        let node = self.node(id);
        let became = drive && !node.drive;
        node.drive |= drive;
        if became || scales {
            self.pdos.of(id).for_each(pdo::Pdo::forget);
        }
        if (0x1000..0x2000).contains(&object.index) {
            self.configure(id, object, bits as u32);
        }
    }

    /// The value may tell which drive it is, and so what everything else of it is called.
    fn identify(&mut self, id: u8, object: Object, raw: i64, notices: &mut Vec<Notice>) {
        let stated = self.stated;
        if let Some(change) = self.node(id).product.learn(id, object, raw, stated) {
            notices.push(Notice::Change(change));
            self.pdos.of(id).for_each(pdo::Pdo::forget);
        }
    }

    /// Gives the value as a signal.
    fn tell(&mut self, id: u8, settled: &Settled, raw: i64, notices: &mut Vec<Notice>) {
        let (profile, request) = (self.profile_of(id), Some(settled.asked));
        let book = Book { profile, values: &self.node(id).values };
        for meaning in book.meanings(settled.object) {
            let masked = raw & meaning.mask;
            let exact = meaning.equals.map_or(masked, |equals| (masked == equals).into());
            notices.push(Notice::Signal(Signal {
                axis: id.into(),
                name: meaning.name,
                value: exact as f64 * meaning.factor,
                exact: Some(exact),
                unit: meaning.unit,
                quality: Quality::Good,
                request,
            }));
        }
    }

    /// An object of communication has that value.
    fn configure(&mut self, id: u8, object: Object, raw: u32) {
        match (object.index, object.sub) {
            (0x1005, 0) => self.services.put(CobId(raw).id(), Service::Sync),
            (0x1014, 0) => self.move_emergencies(id, CobId(raw)),
            (0x1016, 1..) => {
                let (node, ms) = ((raw >> 16) as u8, raw & 0xFFFF);
                if (1..=polepair_core::proto::canopen::NODE_MAX).contains(&node) {
                    self.node(node).beat.allow(ms.into());
                }
            }
            (0x1017, 0) => self.node(id).beat.configure(raw.into()),
            (0x1019, 0) => self.sync.configure(raw as u8),
            (0x1200..=0x12FF, 1..=3) => self.server(id, object, raw),
            _ => {
                if let Some(moved) = self.pdos.learn(id, object, raw) {
                    self.services.moved(&moved, &mut self.pdos);
                }
            }
        }
    }

    fn move_emergencies(&mut self, id: u8, cob: CobId) {
        let usual = u32::from(cob::EMCY | u16::from(id));
        if cob.is_valid() && cob.id() != usual {
            if self.services.of(usual, false, &mut self.pdos) == Service::Emcy(id) {
                self.services.put(usual, Service::Nobody);
            }
            self.services.put(cob.id(), Service::Emcy(id));
        }
    }

    /// A channel gets its identifiers one by one.
    fn server(&mut self, owner: u8, Object { index, sub }: Object, raw: u32) {
        let same = |server: &Server| (server.owner, server.index) == (owner, index);
        let at = self.servers.iter().position(same).unwrap_or(self.servers.len());
        if at == SERVERS_MAX {
            return;
        }
        if at == self.servers.len() {
            self.servers.push(Server { owner, index, node: owner, request: None, reply: None });
        }
        let server = &mut self.servers[at];
        let cob = Some(CobId(raw)).filter(|cob| cob.is_valid() && cob.id() != 0);
        match sub {
            1 => server.request = cob,
            2 => server.reply = cob,
            _ if index >= 0x1280 => server.node = raw as u8 & 0x7F,
            _ => {}
        }
        let Server { node, request, reply, .. } = *server;
        if let (Some(request), Some(reply), 1..) = (request, reply, node) {
            self.open(node, request.id(), reply.id());
        }
    }

    /// A channel with identifiers of its own.
    fn open(&mut self, node: u8, request: u32, reply: u32) {
        let usual = (cob::SDO_REQUEST | u16::from(node), cob::SDO_REPLY | u16::from(node));
        if (request, reply) == (usual.0.into(), usual.1.into()) {
            return;
        }
        if let Some(at) = self.channel(node) {
            self.services.put(request, Service::Request(at));
            self.services.put(reply, Service::Reply(at));
        }
    }

    /// One more channel to a node.
    pub(super) fn channel(&mut self, node: u8) -> Option<u16> {
        let at = self.channels.len();
        (at < CHANNELS_MAX).then(|| {
            self.channels.push(Channel::new(node, self.began));
            at as u16
        })
    }
}

/// The bytes of a value as a number.
fn number(object: Object, bits: u64, len: u8, profile: Option<&'static Profile>) -> i64 {
    match len {
        0..=4 => say::number(object, bits as u32, len, profile),
        _ if say::signed(object, profile) => {
            let rest = 64 - 8 * u32::from(len.min(8));
            (bits << rest).cast_signed() >> rest
        }
        _ => bits.cast_signed(),
    }
}

/// Name and versions are texts.
const fn is_text(object: Object) -> bool {
    matches!(object.index, 0x1008..=0x100A)
}

/// Whether scales of other objects hang on this one.
fn is_scale(object: Object, profile: Option<&'static Profile>) -> bool {
    let Some(profile) = say::own(profile) else { return false };
    let scales = profile.parameters.iter().flat_map(|p| [p.scale.times, p.scale.over]).flatten();
    let mut of = scales.filter_map(|id| profile.parameter(id));
    of.any(|p| (p.index, p.space) == (object.index, object.sub))
}

/// A table that does not grow without end.
trait Bounded {
    /// Puts a value in if there is room, and gives what was there.
    fn insert_bounded(&mut self, object: Object, raw: i64) -> Option<i64>;
}

impl Bounded for std::collections::HashMap<Object, i64> {
    fn insert_bounded(&mut self, object: Object, raw: i64) -> Option<i64> {
        if self.len() < VALUES_MAX || self.contains_key(&object) {
            return self.insert(object, raw);
        }
        None
    }
}
