//! Reports of a CANopen node: its transmit PDOs, mapped to what is asked for (CiA 301, 7.5.2.37 and 7.5.2.38).

use super::{ASK_INSTEAD, RunningReports};
use crate::axis::LocalAxis;
use crate::axis::cyclic::{is_enabled, with_mapping_hint};
use crate::error::Error;
use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::{Parameter, ParameterId};
use polepair_core::proto::{drive_address, sub_axis};

/// TPDOs with an identifier from the predefined connection set.
const TPDOS: u8 = 4;
/// Bytes of a PDO.
const BYTES_MAX: u8 = 8;
/// The bit of a COB-ID that switches a PDO off.
const INVALID: i64 = 0x8000_0000;
/// Transmission by event, or by the event time of the device profile.
const BY_EVENT: i64 = 255;
/// Steps of the inhibit time in a millisecond.
const INHIBIT_PER_MS: i64 = 10;

/// Maps PDOs that are switched off, and has them sent every `ms` milliseconds.
pub(super) fn start(
    axis: &LocalAxis,
    parameters: &[ParameterId],
    ms: u16,
) -> Result<RunningReports, Error> {
    if sub_axis(axis.number()) > 1 {
        let what = format!("{}: its values cannot be mapped", axis.label());
        let hint = format!("process data are mapped for the first axis of a node; {ASK_INSTEAD}");
        return Err(Error::usage("E217", what, &hint));
    }
    let groups = pack(axis, parameters)?;
    let free = free_pdos(axis, groups.len())?;
    let mut running = RunningReports { axis: axis.clone(), undo: Vec::new() };
    let mapped = map_all(axis, &groups, &free, ms, &mut running.undo);
    if let Err(error) = mapped {
        check_may_be_pre_operational(axis, error)?;
        running.restore()?;
        while_pre_operational(axis, || map_all(axis, &groups, &free, ms, &mut running.undo))?;
    }
    axis.raw("nmt start")?;
    Ok(running)
}

/// Writes the settings that were there before.
pub(super) fn restore(axis: &LocalAxis, writes: &[(ParameterId, i64)]) -> Result<(), Error> {
    let write_all = || writes.iter().try_for_each(|(id, raw)| axis.write(*id, *raw, false));
    write_all().or_else(|error| {
        check_may_be_pre_operational(axis, error)?;
        while_pre_operational(axis, write_all)
    })
}

/// Returns unless the error is other than a refusal, or the drive has power: some drives change their process data only
/// while they are pre-operational, where they take no command by PDO.
fn check_may_be_pre_operational(axis: &LocalAxis, error: Error) -> Result<(), Error> {
    if !is_refusal(&error) {
        Err(error)
    } else if is_enabled(axis)? {
        Err(with_mapping_hint(error))
    } else {
        Ok(())
    }
}

/// Does that while the node is pre-operational, and starts it again.
fn while_pre_operational(
    axis: &LocalAxis,
    act: impl FnOnce() -> Result<(), Error>,
) -> Result<(), Error> {
    axis.raw("nmt pre-operational")?;
    let done = act();
    axis.raw("nmt start").map(drop).and(done)
}

fn is_refusal(error: &Error) -> bool {
    let Error::Failed { outcome, .. } = error else { return false };
    matches!(outcome, Outcome::NotDone(Failure::Refused { .. }))
}

/// An object that a node need not have.
fn read_if_there(axis: &LocalAxis, id: ParameterId) -> Result<Option<i64>, Error> {
    match axis.read(id) {
        Ok(raw) => Ok(Some(raw)),
        Err(error) if is_refusal(&error) => Ok(None),
        Err(error) => Err(error),
    }
}

/// The parameters of each PDO, in the order asked for.
fn pack(axis: &LocalAxis, parameters: &[ParameterId]) -> Result<Vec<Vec<ParameterId>>, Error> {
    let mut groups: Vec<(u8, Vec<ParameterId>)> = Vec::new();
    for id in parameters {
        // The host finds a value in a PDO by the objects of the profile.
        let in_profile = axis.params().get(usize::from(id.0)).map(|p| p.encoding.size());
        let size = in_profile.filter(|size| (1..=BYTES_MAX).contains(size));
        let size = size.ok_or_else(|| axis.does_not_send(*id))?;
        match groups.iter_mut().find(|(used, _)| used + size <= BYTES_MAX) {
            Some((used, group)) => {
                *used += size;
                group.push(*id);
            }
            None => groups.push((size, vec![*id])),
        }
    }
    Ok(groups.into_iter().map(|(_, group)| group).collect())
}

/// Numbers of `count` PDOs that nothing uses, the last ones first: the first ones are those that masters use.
fn free_pdos(axis: &LocalAxis, count: usize) -> Result<Vec<u8>, Error> {
    let mut free = Vec::new();
    for number in (1..=TPDOS).rev() {
        let cob_id = read_if_there(axis, TransmitPdo(number).identifier(axis)?)?;
        if cob_id.is_some_and(|cob_id| cob_id & INVALID != 0) {
            free.push(number);
        }
    }
    if free.len() < count {
        let what = format!(
            "{}: these values need {count} process data objects, and {} of {TPDOS} are switched off",
            axis.label(),
            free.len()
        );
        let hint = format!("ask for fewer, or switch one off (1800h:1 and on); {ASK_INSTEAD}");
        return Err(Error::usage("E217", what, &hint));
    }
    free.truncate(count);
    Ok(free)
}

fn map_all(
    axis: &LocalAxis,
    groups: &[Vec<ParameterId>],
    free: &[u8],
    ms: u16,
    undo: &mut Vec<(ParameterId, i64)>,
) -> Result<(), Error> {
    for (group, number) in groups.iter().zip(free) {
        let pdo = TransmitPdo(*number);
        undo.extend(pdo.read_settings(axis, group.len())?);
        pdo.map(axis, group, ms)?;
    }
    Ok(())
}

/// A PDO that a node sends, by its number from 1 on.
#[derive(Clone, Copy)]
struct TransmitPdo(u8);

impl TransmitPdo {
    fn communication(self, axis: &LocalAxis, sub: u8, kind: &str) -> Result<ParameterId, Error> {
        axis.find(&format!("0x{:04X}:{sub}:{kind}", 0x17FF + u16::from(self.0)))
    }

    fn mapping(self, axis: &LocalAxis, sub: u8, kind: &str) -> Result<ParameterId, Error> {
        axis.find(&format!("0x{:04X}:{sub}:{kind}", 0x19FF + u16::from(self.0)))
    }

    fn identifier(self, axis: &LocalAxis) -> Result<ParameterId, Error> {
        self.communication(axis, 1, "u32")
    }

    fn inhibit_time(self, axis: &LocalAxis) -> Result<ParameterId, Error> {
        self.communication(axis, 3, "u16")
    }

    /// The writes that restore its settings, of which `mapped` entries will change. The drive may lack an entry behind
    /// those that count, and the inhibit time.
    fn read_settings(
        self,
        axis: &LocalAxis,
        mapped: usize,
    ) -> Result<Vec<(ParameterId, i64)>, Error> {
        let (identifier, count) = (self.identifier(axis)?, self.mapping(axis, 0, "u8")?);
        let cob_id = axis.read(identifier)?;
        let mut writes = vec![(identifier, cob_id | INVALID), (count, 0)];
        let entries = axis.read(count)?;
        for sub in 1..=mapped.max(usize::try_from(entries).unwrap_or(0)).min(8) as u8 {
            let entry = self.mapping(axis, sub, "u32")?;
            let raw = read_if_there(axis, entry)?.filter(|_| i64::from(sub) <= entries);
            writes.extend(raw.map(|raw| (entry, raw)));
        }
        writes.push((count, entries));
        let others = [
            self.communication(axis, 2, "u8")?,
            self.inhibit_time(axis)?,
            self.communication(axis, 5, "u16")?,
        ];
        for id in others {
            writes.extend(read_if_there(axis, id)?.map(|raw| (id, raw)));
        }
        writes.push((identifier, cob_id));
        Ok(writes)
    }

    /// Maps it: off, mapping away, entries, count, on.
    fn map(self, axis: &LocalAxis, group: &[ParameterId], ms: u16) -> Result<(), Error> {
        let (identifier, count) = (self.identifier(axis)?, self.mapping(axis, 0, "u8")?);
        let write = |id, raw| axis.write(id, raw, false);
        write(identifier, self.cob_id(axis) | INVALID)?;
        write(self.communication(axis, 2, "u8")?, BY_EVENT)?;
        let inhibit_time = self.inhibit_time(axis)?;
        if read_if_there(axis, inhibit_time)?.is_some() {
            let steps = i64::from(ms) * INHIBIT_PER_MS;
            write(inhibit_time, steps.min(i64::from(u16::MAX)))?;
        }
        write(self.communication(axis, 5, "u16")?, ms.into())?;
        write(count, 0)?;
        for (sub, id) in (1..).zip(group) {
            let entry = axis.parameter(*id).map(mapping_entry);
            write(self.mapping(axis, sub, "u32")?, entry.unwrap_or_default())?;
        }
        write(count, group.len() as i64)?;
        write(identifier, self.cob_id(axis))
    }

    /// The identifier of the predefined connection set (CiA 301, 7.3.5).
    fn cob_id(self, axis: &LocalAxis) -> i64 {
        let node = i64::from(drive_address(axis.number()));
        0x80 + 0x100 * i64::from(self.0) + node
    }
}

/// The entry of a mapping: index, sub-index and bits.
fn mapping_entry(parameter: &Parameter) -> i64 {
    let bits = 8 * i64::from(parameter.encoding.size());
    i64::from(parameter.index) << 16 | i64::from(parameter.space) << 8 | bits
}
