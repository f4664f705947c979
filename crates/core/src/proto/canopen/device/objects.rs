//! Reading and writing values: the firmware's, and the protocol's own with the rules of CiA 301.

use super::comm::CONSUMERS_MAX;
use super::{CanEnd, Firmware, Group};
use crate::proto::canopen::od::{Entry, OWN};
use crate::proto::canopen::pdo::{self, BITS_MAX, CobId};
use crate::proto::canopen::sdo::Abort;
use crate::time::Instant;

/// What must be written to 1010h: `save`.
const SAVE: u64 = 0x6576_6173;
/// What must be written to 1011h: `load`.
const LOAD: u64 = 0x6461_6F6C;

impl<const N: usize> CanEnd<N> {
    /// The value of an object of fixed length.
    #[inline]
    pub(super) fn value(
        &mut self,
        entry: &'static Entry,
        firmware: &mut impl Firmware,
    ) -> Result<u64, Abort> {
        if entry.tag == OWN {
            return self.own_value(entry.index(), entry.sub(), firmware);
        }
        Ok(firmware.get(entry.tag))
    }

    /// Writes an object of fixed length.
    #[inline]
    pub(super) fn set_value(
        &mut self,
        now: Instant,
        entry: &'static Entry,
        raw: u64,
        firmware: &mut impl Firmware,
    ) -> Result<(), Abort> {
        let number = entry.kind.number(raw);
        let (least, greatest) = entry.limits;
        if number > greatest {
            return Err(Abort::TOO_HIGH);
        }
        if number < least {
            return Err(Abort::TOO_LOW);
        }
        if entry.tag == OWN {
            return self.set_own(now, entry, number as u64, firmware);
        }
        firmware.set(now, entry.tag, number.cast_unsigned())
    }

    /// The value of one of the protocol's own objects.
    pub(super) fn own_value(
        &mut self,
        index: u16,
        sub: u8,
        firmware: &mut impl Firmware,
    ) -> Result<u64, Abort> {
        match (index, sub) {
            (0x1001, _) => return Ok(self.error_register(firmware).into()),
            (0x1003, _) => return self.alarms.history(sub).map(u64::from).ok_or(Abort::NO_DATA),
            (0x1010 | 0x1011, 1..) => return Ok(1),
            (0x1018, 4) if firmware.serial() != 0 => return Ok(firmware.serial().into()),
            _ => {}
        }
        if let Some(value) = self.comm.value(index, sub) {
            return Ok(value);
        }
        let entry = firmware.dictionary().find(index, sub);
        entry.map(|entry| entry.factory(self.node)).ok_or(Abort::NO_OBJECT)
    }

    fn set_own(
        &mut self,
        now: Instant,
        entry: &'static Entry,
        value: u64,
        firmware: &mut impl Firmware,
    ) -> Result<(), Abort> {
        let (index, sub) = (entry.index(), entry.sub());
        match index {
            0x1003 if value == 0 => self.alarms.clear_history(),
            0x1003 => return Err(Abort::VALUE),
            0x1010 => return self.store(now, sub, value),
            0x1011 => return self.restore(sub, value, firmware),
            0x1400..=0x1BFF => return self.set_pdo(now, index, sub, value, firmware),
            _ => {
                self.check(index, sub, value as u32)?;
                self.comm.put(index, sub, value);
            }
        }
        match index {
            0x1005 | 0x1006 | 0x1012 | 0x1019 => self.apply_sync(now),
            0x1007 => self.apply_window(),
            0x1016 => self.restart_watch(usize::from(sub) - 1),
            0x1017 => self.start_heartbeat(now),
            _ => {}
        }
        Ok(())
    }

    /// What stands against a value of an object before 1400h.
    fn check(&self, index: u16, sub: u8, value: u32) -> Result<(), Abort> {
        let comm = &self.comm;
        let id = CobId(value).id();
        let moves = |old: u32| CobId(old).id() != id;
        let err = |wrong: bool, abort: Abort| if wrong { Err(abort) } else { Ok(()) };
        let reserved = is_reserved(id) || CobId(value).is_extended();
        match index {
            0x1005 => {
                let produces = comm.sync_cob & CobId::FLAG != 0;
                err(produces && value & CobId::FLAG != 0 && moves(comm.sync_cob), Abort::STATE)?;
                err(reserved && id != 0x80, Abort::VALUE)
            }
            0x1012 => err(reserved && id != 0x100, Abort::VALUE),
            0x1014 => {
                let there = CobId(comm.emcy_cob).is_valid() && CobId(value).is_valid();
                err(there && moves(comm.emcy_cob), Abort::STATE)?;
                err(reserved, Abort::VALUE)
            }
            0x1015 => Ok(()),
            0x1016 => {
                let node = (value >> 16) as u8;
                let others = (0..CONSUMERS_MAX).filter(|n| *n + 1 != usize::from(sub));
                let is_there = |n: usize| {
                    let other = comm.consumers[n];
                    other & 0xFFFF != 0 && (other >> 16) as u8 == node
                };
                err(value >> 23 != 0, Abort::VALUE)?;
                err(
                    value & 0xFFFF != 0 && node != 0 && { others }.any(is_there),
                    Abort::INCOMPATIBLE,
                )
            }
            0x1019 => {
                err(value == 1 || value > 240, Abort::VALUE)?;
                err(comm.sync_period_us != 0, Abort::STATE)
            }
            _ => Ok(()),
        }
    }

    fn store(&mut self, now: Instant, sub: u8, value: u64) -> Result<(), Abort> {
        if value != SAVE {
            return Err(Abort::NOT_STORED);
        }
        let done = self.store.begin(now, group(sub)?, self.node, &self.comm);
        self.mail.stores = true;
        self.arm(done);
        Ok(())
    }

    fn restore(&mut self, sub: u8, value: u64, firmware: &mut impl Firmware) -> Result<(), Abort> {
        if value != LOAD {
            return Err(Abort::NOT_STORED);
        }
        let group = group(sub)?;
        self.store.restore(group);
        if group != Group::Communication {
            firmware.restore(group);
        }
        Ok(())
    }

    /// An object of a PDO, by the standard's procedure: off, mapping off, entries, mapping on, on.
    fn set_pdo(
        &mut self,
        now: Instant,
        index: u16,
        sub: u8,
        value: u64,
        firmware: &mut impl Firmware,
    ) -> Result<(), Abort> {
        if index & 0x200 == 0 {
            self.check_communication(index, sub, value as u32)?;
        } else {
            self.check_mapping(index, sub, value as u32, firmware)?;
        }
        self.comm.put(index, sub, value);
        let n = usize::from(index & 0x1FF);
        if index < 0x1800 {
            self.apply_take(n, firmware);
        } else {
            self.apply_send(now, n, firmware);
        }
        Ok(())
    }

    fn check_communication(&mut self, index: u16, sub: u8, value: u32) -> Result<(), Abort> {
        let lenient = self.options.lenient;
        let pdo = *self.comm.pdo(index).ok_or(Abort::NO_OBJECT)?;
        let (is, was) = (CobId(value), CobId(pdo.cob));
        let stays = is.is_valid() && was.is_valid();
        match sub {
            1 if is.is_extended() => Err(Abort::VALUE),
            1 if is.is_valid() && is_reserved(is.id()) => Err(Abort::VALUE),
            1 if stays && is.id() != was.id() && !lenient => Err(Abort::STATE),
            2 if matches!(value, 241..=251) => Err(Abort::VALUE),
            2 if index < 0x1800 && matches!(value, 252 | 253) => Err(Abort::VALUE),
            3 | 6 if pdo.is_valid() && !lenient => Err(Abort::STATE),
            6 if value > 240 => Err(Abort::VALUE),
            _ => Ok(()),
        }
    }

    fn check_mapping(
        &mut self,
        index: u16,
        sub: u8,
        value: u32,
        firmware: &mut impl Firmware,
    ) -> Result<(), Abort> {
        let lenient = self.options.lenient;
        let pdo = *self.comm.pdo(index).ok_or(Abort::NO_OBJECT)?;
        if pdo.is_valid() && !lenient {
            return Err(Abort::ACCESS);
        }
        if sub > 0 {
            let entry = pdo::Entry::from(value);
            return match pdo.count > 0 && !lenient {
                true => Err(Abort::ACCESS),
                false => mappable(entry, index >= 0x1800, lenient, firmware),
            };
        }
        if value as usize > pdo.map.len() {
            return Err(Abort::PDO_LENGTH);
        }
        let entries = pdo.map.iter().take(value as usize).map(|raw| pdo::Entry::from(*raw));
        let mut bits = 0;
        for entry in entries {
            mappable(entry, index >= 0x1800, lenient, firmware)?;
            bits += u32::from(entry.bits);
        }
        if bits > u32::from(BITS_MAX) { Err(Abort::PDO_LENGTH) } else { Ok(()) }
    }
}

/// Whether an object can be mapped so.
fn mappable(
    entry: pdo::Entry,
    sends: bool,
    lenient: bool,
    firmware: &impl Firmware,
) -> Result<(), Abort> {
    let object = entry.object;
    if entry.is_gap() && object.index > 0 {
        return if sends || object.sub != 0 { Err(Abort::NOT_MAPPABLE) } else { Ok(()) };
    }
    let found = firmware.dictionary().find(object.index, object.sub).ok_or(Abort::NO_OBJECT)?;
    let allowed = if sends { found.access.is_sendable() } else { found.access.is_receivable() };
    // [I] A drive was seen in the field with half an object mapped.
    let fits = match found.kind.bits() {
        Some(bits) if lenient => entry.bits > 0 && entry.bits <= bits,
        Some(bits) => entry.bits == bits,
        None => false,
    };
    if allowed && fits && found.tag != OWN { Ok(()) } else { Err(Abort::NOT_MAPPABLE) }
}

/// Identifiers that no service but its owner may have (CiA 301, restricted CAN-IDs).
const fn is_reserved(id: u32) -> bool {
    matches!(id, 0..=0x7F | 0x101..=0x180 | 0x581..=0x5FF | 0x601..=0x67F | 0x6E0..)
}

fn group(sub: u8) -> Result<Group, Abort> {
    match sub {
        1 => Ok(Group::All),
        2 => Ok(Group::Communication),
        3 => Ok(Group::Application),
        _ => Err(Abort::READ_ONLY),
    }
}
