//! Checks that drives of several protocols can share a CAN bus: identifiers and bus load.

use crate::registry::ProtocolInfo;
use polepair_core::medium::Frame;
use polepair_core::proto::AxisNumber;
use polepair_sim::can_bus::bits;

/// The share of its bits that a bus may be planned for. Beyond it the frames of low priority wait
/// for too long, and an error frame is not made up for.
pub(crate) const LOAD_MAX: f64 = 0.8;
/// Number of 11-bit identifiers, and the index of all 29-bit ones.
const STANDARD_IDS: u32 = 0x800;
/// Default lengths of request and reply: one full frame each.
const EXCHANGE_LENGTHS: [u32; 2] = [8, 8];

/// Bits that a frame takes of a bus' time, stuff bits and the pause behind it counted.
#[must_use]
pub fn frame_bits(frame: &Frame) -> u32 {
    bits::wire_bits(frame)
}

/// An address on a bus, and its protocol.
#[derive(Clone, Debug)]
pub(crate) struct BusAddress {
    pub(crate) protocol: ProtocolInfo,
    pub(crate) address: u32,
}

impl BusAddress {
    /// An identifier that both have, of 29 bits or not.
    pub(crate) fn shared_identifier(&self, other: &Self) -> Option<(u32, bool)> {
        if self.protocol.name == other.protocol.name {
            return (self.address == other.address).then_some((self.address, false));
        }
        let both = |id, extended| {
            (self.protocol.uses_identifier)(self.address, id, extended)
                && (other.protocol.uses_identifier)(other.address, id, extended)
        };
        let extended = both(0, true).then_some((0, true));
        (0..STANDARD_IDS).find(|id| both(*id, false)).map(|id| (id, false)).or(extended)
    }

    /// `canopen 2`.
    pub(crate) fn label(&self) -> String {
        format!("{} {}", self.protocol.name, AxisNumber(self.address))
    }
}

impl ProtocolInfo {
    /// The host's address on a bus with `others`: the default, or the last free one.
    pub(crate) fn host_among(&self, drives: &[u32], others: &[BusAddress]) -> Option<u32> {
        let usual = self.host?;
        // The host must not answer to an identifier that a drive of another protocol listens to.
        let free = |address: &u32| {
            !drives.contains(address)
                && !others
                    .iter()
                    .any(|other| other.shared_identifier(&self.bus_entry(*address)).is_some())
        };
        if free(&usual) {
            return None;
        }
        // Better one that no drive of the others could have: their hosts hear those too.
        let claimed = claimed_identifiers(others);
        let every = || self.byte_addresses().rev();
        every()
            .find(|address| {
                free(address) && !uses_claimed(&claimed, self.uses_identifier, *address)
            })
            .or_else(|| every().find(free))
    }

    fn bus_entry(&self, address: u32) -> BusAddress {
        BusAddress { protocol: self.clone(), address }
    }
}

/// 11-bit identifiers of all possible drives of these protocols.
pub(crate) fn claimed_identifiers(seats: &[BusAddress]) -> Vec<bool> {
    (0..STANDARD_IDS).map(|id| seats.iter().any(|bus_address| could_use(bus_address, id))).collect()
}

fn could_use(bus_address: &BusAddress, id: u32) -> bool {
    bus_address
        .protocol
        .byte_addresses()
        .any(|a| (bus_address.protocol.uses_identifier)(a, id, false))
}

/// Orders protocols so that one whose drives have no identifiers but another's comes after it: its
/// questions could be commands to the other's drives, which are then known.
pub(crate) fn sort_guests_last<T>(requests: &mut [T], protocol: impl Fn(&T) -> &ProtocolInfo) {
    let all: Vec<&ProtocolInfo> = requests.iter().map(&protocol).collect();
    let ranks: Vec<(&str, usize)> = all.iter().map(|one| one.name).zip(guest_ranks(&all)).collect();
    requests.sort_by_key(|one| {
        ranks.iter().find(|(name, _)| *name == protocol(one).name).map_or(0, |(_, rank)| *rank)
    });
}

/// For each protocol, how many of the others have all of its drives' identifiers. A question of a protocol with any
/// could be a command to a drive of another one.
pub(crate) fn guest_ranks(protocols: &[&ProtocolInfo]) -> Vec<usize> {
    let ids = |one: &ProtocolInfo| -> Vec<bool> {
        let uses =
            |id| one.addresses.clone().any(|address| (one.uses_identifier)(address, id, false));
        (0..STANDARD_IDS).map(uses).collect()
    };
    let all: Vec<(&str, Vec<bool>)> = protocols.iter().map(|one| (one.name, ids(one))).collect();
    all.iter()
        .map(|(name, ids)| {
            let any = ids.contains(&true);
            all.iter().filter(|(other, its)| other != name && any && is_subset(its, ids)).count()
        })
        .collect()
}

fn is_subset(other: &Vec<bool>, ids: &[bool]) -> bool {
    ids.iter().zip(other).all(|(mine, its)| !mine || *its)
}

/// Returns whether an address has one of those identifiers.
pub(crate) fn uses_claimed(
    claimed: &[bool],
    uses: fn(u32, u32, bool) -> bool,
    address: u32,
) -> bool {
    (0..STANDARD_IDS).zip(claimed).any(|(id, claimed)| *claimed && uses(address, id, false))
}

/// Describes why these addresses cannot be on one bus, if they cannot.
pub(crate) fn find_clash(seats: &[BusAddress]) -> Option<String> {
    seats.iter().enumerate().find_map(|(n, bus_address)| {
        if let Err(why) = bus_address.protocol.check_address(bus_address.address) {
            return Some(format!("{}: {why}: {}", bus_address.label(), why.hint()));
        }
        let (other, met) =
            seats[..n].iter().find_map(|o| Some((o, o.shared_identifier(bus_address)?)))?;
        Some(match met {
            _ if other.protocol.name == bus_address.protocol.name => {
                format!("{} is used twice: give each drive its own address", bus_address.label())
            }
            (_, true) => {
                format!(
                    "{} and {} both use the 29-bit identifiers",
                    other.label(),
                    bus_address.label()
                )
            }
            (id, false) => format!(
                "{} and {} both use the identifier {id:X}h: give one of them another address",
                other.label(),
                bus_address.label()
            ),
        })
    })
}

/// Load of a bus by its drives, as shares of its time.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct BusLoadRange {
    /// Share of the bits without a single stuff bit, 0 to 1.
    pub least: f64,
    /// Load with as many stuff bits as possible.
    pub most: f64,
}

impl BusLoadRange {
    /// Adds frames of these lengths in bytes, `rate` times a second; without lengths a full frame in each direction.
    pub(crate) fn add(&mut self, bit_rate: u32, extended: bool, rate: f64, lengths: &[u32]) {
        debug_assert!(rate >= 0.0);
        let lengths = if lengths.is_empty() { &EXCHANGE_LENGTHS } else { lengths };
        self.least += load_share(
            lengths.iter().map(|bytes| bits::unstuffed_bits(extended, *bytes)).sum(),
            rate,
            bit_rate,
        );
        self.most += load_share(
            lengths.iter().map(|bytes| bits::max_wire_bits(extended, *bytes)).sum(),
            rate,
            bit_rate,
        );
    }

    /// The sum, where it is too much.
    pub(crate) fn overload_reason(self) -> Option<String> {
        let max = LOAD_MAX * 100.0;
        (self.most > LOAD_MAX).then(|| {
            format!("its drives take {self} of the bus; at most {max:.0} % can be planned for")
        })
    }
}

fn load_share(bits: u32, rate: f64, bit_rate: u32) -> f64 {
    debug_assert!(bit_rate > 0, "a bus without a bit rate has no load");
    rate * f64::from(bits) / f64::from(bit_rate.max(1))
}

impl std::fmt::Display for BusLoadRange {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.1} to {:.1} %", self.least * 100.0, self.most * 100.0)
    }
}

#[cfg(test)]
mod tests;
