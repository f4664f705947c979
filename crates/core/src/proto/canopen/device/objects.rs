//! Reads and writes objects: those of the firmware, and those of the protocol by the rules of CiA 301.

use super::communication::CONSUMERS_MAX;
use super::{CanEndpoint, Firmware, SettingsGroup};
use crate::proto::canopen::nmt::NmtState;
use crate::proto::canopen::od::{ObjectEntry, PROTOCOL_TAG};
use crate::proto::canopen::pdo::{self, BITS_MAX, CobId};
use crate::proto::canopen::sdo::AbortCode;
use crate::time::Instant;

/// Signature for 1010h: `save`.
const SAVE: u64 = 0x6576_6173;
/// Signature for 1011h: `load`.
const LOAD: u64 = 0x6461_6F6C;

impl<const N: usize> CanEndpoint<N> {
    /// The value of an object of fixed length.
    #[inline]
    pub(super) fn value(
        &mut self,
        entry: &'static ObjectEntry,
        firmware: &mut impl Firmware,
    ) -> Result<u64, AbortCode> {
        if entry.tag == PROTOCOL_TAG {
            return self.protocol_value(entry.index(), entry.sub(), firmware);
        }
        Ok(firmware.get(entry.tag))
    }

    /// Writes an object of fixed length.
    #[inline]
    pub(super) fn set_value(
        &mut self,
        now: Instant,
        entry: &'static ObjectEntry,
        raw: u64,
        firmware: &mut impl Firmware,
    ) -> Result<(), AbortCode> {
        let number = entry.kind.number(raw);
        let (min, greatest) = entry.limits;
        if number > greatest {
            return Err(AbortCode::TOO_HIGH);
        }
        if number < min {
            return Err(AbortCode::TOO_LOW);
        }
        if entry.tag == PROTOCOL_TAG {
            return self.set_protocol_value(now, entry, number as u64, firmware);
        }
        firmware.set(now, entry.tag, number.cast_unsigned())
    }

    /// The value of one of the protocol's own objects.
    pub(super) fn protocol_value(
        &mut self,
        index: u16,
        sub: u8,
        firmware: &mut impl Firmware,
    ) -> Result<u64, AbortCode> {
        match (index, sub) {
            (0x1001, _) => return Ok(self.error_register(firmware).into()),
            (0x1003, _) => {
                return self.emergencies.history(sub).map(u64::from).ok_or(AbortCode::NO_DATA);
            }
            (0x1010 | 0x1011, 1..) => return Ok(1),
            (0x1018, 4) if firmware.serial() != 0 => return Ok(firmware.serial().into()),
            _ => {}
        }
        if let Some(value) = self.communication.value(index, sub) {
            return Ok(value);
        }
        let entry = firmware.dictionary().find(index, sub);
        entry.map(|entry| entry.default_bits(self.node)).ok_or(AbortCode::NO_OBJECT)
    }

    fn set_protocol_value(
        &mut self,
        now: Instant,
        entry: &'static ObjectEntry,
        value: u64,
        firmware: &mut impl Firmware,
    ) -> Result<(), AbortCode> {
        let (index, sub) = (entry.index(), entry.sub());
        match index {
            0x1003 if value == 0 => self.emergencies.clear_history(),
            0x1003 => return Err(AbortCode::VALUE),
            0x1010 => return self.store_settings(now, sub, value),
            0x1011 => return self.restore_settings(sub, value, firmware),
            0x1400..=0x1BFF => return self.set_pdo(now, index, sub, value, firmware),
            _ => {
                self.check_value(index, sub, value as u32)?;
                self.communication.set(index, sub, value);
            }
        }
        match index {
            0x1005 | 0x1006 | 0x1012 | 0x1019 => self.apply_sync(now),
            0x1007 => self.apply_window(),
            0x1016 => self.restart_consumer(usize::from(sub) - 1),
            0x1017 => self.start_heartbeat(now),
            _ => {}
        }
        Ok(())
    }

    /// Checks a value of an object before 1400h.
    fn check_value(&self, index: u16, sub: u8, value: u32) -> Result<(), AbortCode> {
        let comm = &self.communication;
        let id = CobId(value).id();
        let reserved = is_reserved(id) || CobId(value).is_extended();
        match index {
            0x1005 => {
                let produces = comm.sync_cob & CobId::FLAG != 0;
                abort_if(
                    produces && value & CobId::FLAG != 0 && moves_cob_id(comm.sync_cob, id),
                    AbortCode::STATE,
                )?;
                abort_if(reserved && id != 0x80, AbortCode::VALUE)
            }
            0x1012 => abort_if(reserved && id != 0x100, AbortCode::VALUE),
            0x1014 => {
                let there = CobId(comm.emcy_cob).is_valid() && CobId(value).is_valid();
                abort_if(there && moves_cob_id(comm.emcy_cob, id), AbortCode::STATE)?;
                abort_if(reserved, AbortCode::VALUE)
            }
            0x1015 => Ok(()),
            0x1016 => {
                let node = (value >> 16) as u8;
                let others = (0..CONSUMERS_MAX).filter(|n| *n + 1 != usize::from(sub));
                abort_if(value >> 23 != 0, AbortCode::VALUE)?;
                abort_if(
                    value & 0xFFFF != 0 && node != 0 && { others }.any(|n| {
                        let other = comm.consumers[n];
                        other & 0xFFFF != 0 && (other >> 16) as u8 == node
                    }),
                    AbortCode::INCOMPATIBLE,
                )
            }
            0x1019 => {
                abort_if(value == 1 || value > 240, AbortCode::VALUE)?;
                abort_if(comm.sync_period_us != 0, AbortCode::STATE)
            }
            _ => Ok(()),
        }
    }

    fn store_settings(&mut self, now: Instant, sub: u8, value: u64) -> Result<(), AbortCode> {
        if value != SAVE {
            return Err(AbortCode::NOT_STORED);
        }
        let done = self.settings_store.begin_write(
            now,
            settings_group(sub)?,
            self.node,
            &self.communication,
        );
        self.send_slots.awaits_store = true;
        self.schedule(done);
        Ok(())
    }

    fn restore_settings(
        &mut self,
        sub: u8,
        value: u64,
        firmware: &mut impl Firmware,
    ) -> Result<(), AbortCode> {
        if value != LOAD {
            return Err(AbortCode::NOT_STORED);
        }
        let group = settings_group(sub)?;
        self.settings_store.restore(group);
        if group != SettingsGroup::Communication {
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
    ) -> Result<(), AbortCode> {
        if self.quirks.maps_pre_operational && self.state != NmtState::PreOperational {
            return Err(AbortCode::STATE);
        }
        if index & 0x200 == 0 {
            self.check_communication(index, sub, value as u32)?;
        } else {
            self.check_mapping(index, sub, value as u32, firmware)?;
        }
        self.communication.set(index, sub, value);
        let n = usize::from(index & 0x1FF);
        if index < 0x1800 {
            self.apply_rpdo(n, firmware);
        } else {
            self.apply_tpdo(now, n, firmware);
        }
        Ok(())
    }

    fn check_communication(&mut self, index: u16, sub: u8, value: u32) -> Result<(), AbortCode> {
        let lenient = self.quirks.lenient;
        let pdo = *self.communication.pdo(index).ok_or(AbortCode::NO_OBJECT)?;
        let (is, was) = (CobId(value), CobId(pdo.cob));
        let stays = is.is_valid() && was.is_valid();
        match sub {
            1 if is.is_extended() => Err(AbortCode::VALUE),
            1 if is.is_valid() && is_reserved(is.id()) => Err(AbortCode::VALUE),
            1 if stays && is.id() != was.id() && !lenient => Err(AbortCode::STATE),
            2 if matches!(value, 241..=251) => Err(AbortCode::VALUE),
            2 if index < 0x1800 && matches!(value, 252 | 253) => Err(AbortCode::VALUE),
            3 | 6 if pdo.is_valid() && !lenient => Err(AbortCode::STATE),
            6 if value > 240 => Err(AbortCode::VALUE),
            _ => Ok(()),
        }
    }

    fn check_mapping(
        &mut self,
        index: u16,
        sub: u8,
        value: u32,
        firmware: &mut impl Firmware,
    ) -> Result<(), AbortCode> {
        let lenient = self.quirks.lenient;
        let pdo = *self.communication.pdo(index).ok_or(AbortCode::NO_OBJECT)?;
        if pdo.is_valid() && !lenient {
            return Err(AbortCode::ACCESS);
        }
        if sub > 0 {
            let entry = pdo::MappingEntry::from(value);
            return if pdo.count > 0 && !lenient {
                Err(AbortCode::ACCESS)
            } else {
                check_mappable(entry, index >= 0x1800, lenient, firmware)
            };
        }
        if value as usize > pdo.map.len() {
            return Err(AbortCode::PDO_LENGTH);
        }
        let entries = pdo.map.iter().take(value as usize).map(|raw| pdo::MappingEntry::from(*raw));
        let mut bits = 0;
        for entry in entries {
            check_mappable(entry, index >= 0x1800, lenient, firmware)?;
            bits += u32::from(entry.bits);
        }
        if bits > u32::from(BITS_MAX) { Err(AbortCode::PDO_LENGTH) } else { Ok(()) }
    }
}

fn abort_if(wrong: bool, abort: AbortCode) -> Result<(), AbortCode> {
    if wrong { Err(abort) } else { Ok(()) }
}

fn moves_cob_id(old: u32, id: u32) -> bool {
    CobId(old).id() != id
}

/// Checks whether an object can be mapped.
fn check_mappable(
    entry: pdo::MappingEntry,
    sends: bool,
    lenient: bool,
    firmware: &impl Firmware,
) -> Result<(), AbortCode> {
    let object = entry.object;
    if entry.is_gap() && object.index > 0 {
        return if sends || object.sub != 0 { Err(AbortCode::NOT_MAPPABLE) } else { Ok(()) };
    }
    let found = firmware.dictionary().find(object.index, object.sub).ok_or(AbortCode::NO_OBJECT)?;
    let allowed = if sends { found.access.is_sendable() } else { found.access.is_receivable() };
    // [I] A drive was seen in the field with half an object mapped.
    let fits = match found.kind.bits() {
        Some(bits) if lenient => entry.bits > 0 && entry.bits <= bits,
        Some(bits) => entry.bits == bits,
        None => false,
    };
    if allowed && fits && found.tag != PROTOCOL_TAG { Ok(()) } else { Err(AbortCode::NOT_MAPPABLE) }
}

/// Identifiers that no service but its owner may have (CiA 301, restricted CAN-IDs).
const fn is_reserved(id: u32) -> bool {
    matches!(id, 0..=0x7F | 0x101..=0x180 | 0x581..=0x5FF | 0x601..=0x67F | 0x6E0..)
}

fn settings_group(sub: u8) -> Result<SettingsGroup, AbortCode> {
    match sub {
        1 => Ok(SettingsGroup::All),
        2 => Ok(SettingsGroup::Communication),
        3 => Ok(SettingsGroup::Application),
        _ => Err(AbortCode::READ_ONLY),
    }
}
