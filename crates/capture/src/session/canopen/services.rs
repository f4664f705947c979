//! The service of an identifier: by the predefined connection set, or as the capture changed it.

use polepair_core::proto::canopen::cob::Cob;

use super::pdo::{PdoMove, PdoTable};

/// Identifiers of 11 bits.
const STANDARD_IDS: usize = 1 << 11;
/// Identifiers of 29 bits that a capture may give a service.
const EXTENDED_MAX: usize = 256;

/// Service of an identifier.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Service {
    /// Not looked up yet.
    Unknown,
    /// Nothing that is followed.
    Untracked,
    /// Network management.
    Nmt,
    /// The beat.
    Sync,
    /// Faults of that node.
    Emcy(u8),
    /// The PDO at that place.
    Pdo(u16),
    /// A request to the node, on the channel with that index; a node's default channel has its number.
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
pub(super) struct ServiceTable {
    standard: Vec<Service>,
    extended: Vec<(u32, Service)>,
}

impl Default for ServiceTable {
    fn default() -> Self {
        Self { standard: vec![Service::Unknown; STANDARD_IDS], extended: Vec::new() }
    }
}

impl ServiceTable {
    /// Service of an identifier: by the objects, otherwise by default.
    #[inline]
    pub fn lookup(&mut self, id: u32, extended: bool, pdos: &mut PdoTable) -> Service {
        if extended {
            let known = self.extended.iter().find(|(long, _)| *long == id);
            return known.map_or(Service::Untracked, |(_, service)| *service);
        }
        let at = id as usize & (STANDARD_IDS - 1);
        match self.standard[at] {
            Service::Unknown => {
                self.standard[at] = default_service(at as u16, pdos);
                self.standard[at]
            }
            known => known,
        }
    }

    /// Last service of an identifier of 11 bits.
    #[inline]
    pub fn cached(&self, id: u32) -> Service {
        self.standard.get(id as usize).map_or(Service::Unknown, |service| *service)
    }

    /// Returns whether the capture gave an identifier to a service.
    pub fn claims_id(&self, id: u32, extended: bool) -> bool {
        if extended {
            self.extended.iter().any(|(long, _)| *long == id)
        } else {
            !matches!(
                self.standard.get(id as usize),
                None | Some(Service::Unknown | Service::Untracked)
            )
        }
    }

    /// Gives an identifier to a service.
    pub fn assign(&mut self, id: u32, service: Service) {
        if let Some(position) = self.standard.get_mut(id as usize) {
            *position = service;
            return;
        }
        match self.extended.iter().position(|(long, _)| *long == id) {
            Some(at) => self.extended[at].1 = service,
            None if self.extended.len() < EXTENDED_MAX => self.extended.push((id, service)),
            None => {}
        }
    }

    /// A PDO has another identifier. If one node sends it to others, it is the sender's.
    pub fn move_pdo(&mut self, moved: &PdoMove, pdos: &mut PdoTable) {
        let Ok(at) = u16::try_from(moved.index) else { return };
        let service = Service::Pdo(at);
        if let Some(from) = moved.old_id
            && Some(from) != moved.new_id
            && self.lookup(from, from > 0x7FF, pdos) == service
        {
            self.assign(from, Service::Untracked);
        }
        let Some(to) = moved.new_id else { return };
        let accepted = match self.lookup(to, to > 0x7FF, pdos) {
            Service::Pdo(other) => {
                pdos.all.get(usize::from(other)).is_some_and(|pdo| pdo.from_node)
            }
            _ => false,
        };
        if pdos.all[moved.index].from_node || !accepted {
            self.assign(to, service);
        }
    }
}

fn default_service(id: u16, pdos: &mut PdoTable) -> Service {
    match Cob::of(id) {
        Cob::Nmt => Service::Nmt,
        Cob::Sync => Service::Sync,
        Cob::Emcy(node) => Service::Emcy(node),
        Cob::Tpdo(number, node) => pdo_index(pdos, node, true, number),
        Cob::Rpdo(number, node) => pdo_index(pdos, node, false, number),
        Cob::Heartbeat(node) => Service::State(node),
        Cob::SdoRequest(node) => Service::Request(u16::from(node)),
        Cob::SdoReply(node) => Service::Reply(u16::from(node)),
        Cob::LssRequest => Service::Lss(true),
        Cob::LssReply => Service::Lss(false),
        _ => Service::Untracked,
    }
}

fn pdo_index(pdos: &mut PdoTable, node: u8, reported: bool, number: u8) -> Service {
    let at = pdos.find_or_add(node, reported, number.into());
    at.and_then(|at| u16::try_from(at).ok()).map_or(Service::Untracked, Service::Pdo)
}
