//! Order of writes that configure a PDO: switch it off, clear its mapping, write the mapping and its
//! length, switch it on (CiA 301, 7.5.2.36 and 7.5.2.38).

use super::{AxisSettings, SettingChange};
use crate::axis::LocalAxis;
use crate::eds::{Eds, raw_value};
use crate::error::Error;
use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::{Encoding, ParameterId};
use std::collections::BTreeSet;

/// Communication and mapping parameters of all PDOs, 512 each: 1400h, 1600h, 1800h, 1A00h.
const PROCESS_DATA: std::ops::Range<u16> = 0x1400..0x1C00;
/// Index offset of a mapping from its communication parameters.
const MAPPING: u16 = 0x200;
/// The bit of a COB-ID that switches a PDO off.
const INVALID: i64 = 0x8000_0000;

/// Returns whether a DCF maps nothing by an entry: it counts fewer.
pub(super) fn is_unused_entry(eds: &Eds, index: u16, sub: u8) -> bool {
    let is_mapping = PROCESS_DATA.contains(&index) && index & MAPPING != 0;
    let count = eds.entry(index, 0).and_then(|entry| entry.value.as_ref());
    let count = count.and_then(|value| raw_value(Encoding::U8, value, 0));
    is_mapping && sub > 0 && count.is_some_and(|count| i64::from(sub) > count)
}

/// Returns whether an error is a drive's refusal of a mapping entry.
pub(super) fn is_refused_entry(axis: &LocalAxis, id: ParameterId, error: &Error) -> bool {
    let Error::Failed { outcome: Outcome::NotDone(Failure::Refused { .. }), .. } = error else {
        return false;
    };
    let parameter = axis.parameter(id).filter(|_| axis.protocol() == crate::lss::PROTOCOL);
    parameter.is_some_and(|p| PROCESS_DATA.contains(&p.index) && p.index & MAPPING != 0)
}

/// One write of those that [`AxisSettings::writes`] gives.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SettingWrite {
    /// Parameter of the drive.
    pub id: ParameterId,
    /// Raw value to write.
    pub raw: i64,
    /// Others follow that belong to it: it need not be kept over power-off yet.
    pub is_step: bool,
}

impl AxisSettings {
    /// Writes for changes, in order. A PDO of a CANopen node with any change is configured as a whole, and disabled
    /// meanwhile.
    ///
    /// # Errors
    /// [`Error`] by blame: the COB-ID of a PDO that is configured is read.
    pub fn writes(
        &self,
        axis: &LocalAxis,
        changes: &[SettingChange],
    ) -> Result<Vec<SettingWrite>, Error> {
        let (mut writes, mut pdos) = (Vec::new(), BTreeSet::new());
        for change in changes {
            let index = axis.parameter(change.id).map(|parameter| parameter.index);
            match index.filter(|_| axis.protocol() == crate::lss::PROTOCOL) {
                Some(index) if PROCESS_DATA.contains(&index) => {
                    pdos.insert(index & !MAPPING);
                }
                _ => writes.push(SettingWrite {
                    id: change.id,
                    raw: change.wanted.raw,
                    is_step: false,
                }),
            }
        }
        for communication in pdos {
            self.write_pdo(axis, communication, &mut writes)?;
        }
        Ok(writes)
    }

    /// The writes that configure one PDO as the settings have it.
    fn write_pdo(
        &self,
        axis: &LocalAxis,
        communication: u16,
        writes: &mut Vec<SettingWrite>,
    ) -> Result<(), Error> {
        let mapping = communication | MAPPING;
        let (mut cob_id, mut count) = (None, None);
        let (mut entries, mut others) = (Vec::new(), Vec::new());
        for (id, raw) in self.raw_values(axis)? {
            let Some(parameter) = axis.parameter(id) else { continue };
            match (parameter.index, parameter.space) {
                (index, 1) if index == communication => cob_id = Some(raw),
                (index, 0) if index == mapping => count = Some((id, raw)),
                (index, _) if index == mapping => entries.push((id, raw, parameter.space)),
                (index, _) if index == communication => others.push((id, raw)),
                _ => {}
            }
        }
        let cob_object = axis.find(&format!("0x{communication:04X}:1:u32"))?;
        let present = axis.read(cob_object)?;
        let mut step = |id, raw, is_step| writes.push(SettingWrite { id, raw, is_step });
        step(cob_object, present | INVALID, true);
        others.into_iter().for_each(|(id, raw)| step(id, raw, true));
        if let Some((id, count)) = count {
            step(id, 0, true);
            let mapped = entries.into_iter().filter(|(.., sub)| i64::from(*sub) <= count);
            mapped.for_each(|(id, raw, _)| step(id, raw, true));
            step(id, count, true);
        }
        step(cob_object, cob_id.unwrap_or(present), false);
        Ok(())
    }
}
