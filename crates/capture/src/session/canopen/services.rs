//! Whose an identifier is: as the predefined connection set has it, or as the capture moved it.

use polepair_core::proto::canopen::cob::Cob;

use super::pdo::{Moved, Pdos};

/// Identifiers of 11 bits.
const SHORT: usize = 1 << 11;
/// Identifiers of 29 bits that a capture may give a service.
const LONG_MAX: usize = 256;

/// What an identifier is for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Service {
    /// Not looked up yet.
    Unknown,
    /// Nothing that is followed.
    Nobody,
    /// Network management.
    Nmt,
    /// The beat.
    Sync,
    /// Faults of that node.
    Emcy(u8),
    /// The PDO at that place.
    Pdo(u16),
    /// To the node, on the channel at that place; the usual one of a node stands at its number.
    Request(u16),
    /// From the node, on the channel at that place.
    Reply(u16),
    /// A node's state.
    State(u8),
    /// Layer setting: from the master, or from a device.
    Lss(bool),
}

/// Services by identifier.
#[derive(Debug)]
pub(super) struct Services {
    short: Vec<Service>,
    long: Vec<(u32, Service)>,
}

impl Default for Services {
    fn default() -> Self {
        Self { short: vec![Service::Unknown; SHORT], long: Vec::new() }
    }
}

impl Services {
    /// What an identifier is for. One that nobody moved is what it is by default.
    #[inline]
    pub fn of(&mut self, id: u32, extended: bool, pdos: &mut Pdos) -> Service {
        if extended {
            let known = self.long.iter().find(|(long, _)| *long == id);
            return known.map_or(Service::Nobody, |(_, service)| *service);
        }
        let at = id as usize & (SHORT - 1);
        match self.short[at] {
            Service::Unknown => {
                self.short[at] = by_default(at as u16, pdos);
                self.short[at]
            }
            known => known,
        }
    }

    /// What an identifier of 11 bits was last for.
    #[inline]
    pub fn known(&self, id: u32) -> Service {
        self.short.get(id as usize).map_or(Service::Unknown, |service| *service)
    }

    /// Whether the capture gave an identifier to a service.
    pub fn claims(&self, id: u32, extended: bool) -> bool {
        match extended {
            true => self.long.iter().any(|(long, _)| *long == id),
            false => !matches!(
                self.short.get(id as usize),
                None | Some(Service::Unknown | Service::Nobody)
            ),
        }
    }

    /// Gives an identifier to a service.
    pub fn put(&mut self, id: u32, service: Service) {
        if let Some(place) = self.short.get_mut(id as usize) {
            *place = service;
            return;
        }
        match self.long.iter().position(|(long, _)| *long == id) {
            Some(at) => self.long[at].1 = service,
            None if self.long.len() < LONG_MAX => self.long.push((id, service)),
            None => {}
        }
    }

    /// A PDO has another identifier. Where one node sends what others receive, it is the sender's.
    pub fn moved(&mut self, moved: &Moved, pdos: &mut Pdos) {
        let Ok(at) = u16::try_from(moved.at) else { return };
        let service = Service::Pdo(at);
        if let Some(from) = moved.from
            && Some(from) != moved.to
            && self.of(from, from > 0x7FF, pdos) == service
        {
            self.put(from, Service::Nobody);
        }
        let Some(to) = moved.to else { return };
        let taken = match self.of(to, to > 0x7FF, pdos) {
            Service::Pdo(other) => pdos.all.get(usize::from(other)).is_some_and(|pdo| pdo.told),
            _ => false,
        };
        if pdos.all[moved.at].told || !taken {
            self.put(to, service);
        }
    }
}

fn by_default(id: u16, pdos: &mut Pdos) -> Service {
    let pdo = |pdos: &mut Pdos, node, told, number: u8| {
        let at = pdos.at(node, told, number.into());
        at.and_then(|at| u16::try_from(at).ok()).map_or(Service::Nobody, Service::Pdo)
    };
    match Cob::of(id) {
        Cob::Nmt => Service::Nmt,
        Cob::Sync => Service::Sync,
        Cob::Emcy(node) => Service::Emcy(node),
        Cob::Tpdo(number, node) => pdo(pdos, node, true, number),
        Cob::Rpdo(number, node) => pdo(pdos, node, false, number),
        Cob::Heartbeat(node) => Service::State(node),
        Cob::SdoRequest(node) => Service::Request(u16::from(node)),
        Cob::SdoReply(node) => Service::Reply(u16::from(node)),
        Cob::LssRequest => Service::Lss(true),
        Cob::LssReply => Service::Lss(false),
        _ => Service::Nobody,
    }
}
