//! Stop of a drive that was not identified, for protocols without a broadcast stop: the writes that all
//! profiles of the protocol have in common and that depend on no reading.
//!
//! Why: STOP-6.

use crate::detected_drive::DetectedDrive;
use crate::error::Error;
use crate::identify::{ProbeResult, Prober};
use crate::protocol_line::ProtocolLine;
use polepair_core::axis::Verb;
use polepair_core::error::{Failure, Outcome};
use polepair_core::plan::{Operand, Step};
use polepair_core::profile::{Encoding, Profile};

const SHARED_STOP_SENT: &str = "it was sent the common stop of this protocol's known drives, and its standstill is not \
     confirmed";

/// A write by where it lies on the wire: space, number, encoding, raw value.
type WireWrite = (u8, u16, Encoding, i64);

/// The stop that all known drives of a protocol share, as a profile and a verb. A quick stop serves if a reading
/// decides about the usual one. `None` if drives differ.
pub(super) fn shared_stop(
    known: &[&'static Profile],
    wanted: Verb,
) -> Option<(&'static Profile, Verb)> {
    let (first, others) = known.split_first()?;
    [wanted, Verb::QuickStop, Verb::Stop].into_iter().find_map(|verb| {
        let writes = plan_writes(first, verb)?;
        let same =
            |other: &&'static Profile| self::plan_writes(other, verb).as_ref() == Some(&writes);
        others.iter().all(same).then_some((*first, verb))
    })
}

/// Writes of a plan before it waits; `None` if it does anything else first.
fn plan_writes(profile: &'static Profile, verb: Verb) -> Option<Vec<WireWrite>> {
    profile
        .plan(verb)?
        .before_wait()
        .iter()
        .map(|step| {
            let Step::Write(id, Operand::Constant(raw)) = step else { return None };
            let found = profile.parameter(*id)?;
            Some((found.space, found.index, found.encoding, *raw))
        })
        .collect()
}

/// Identifies the address again.
pub(super) fn reidentify(
    prober: &Prober<'_>,
    line: &ProtocolLine,
    number: u32,
) -> Result<Option<DetectedDrive>, Error> {
    Ok(match prober.probe(number)? {
        ProbeResult::Found { profile, identified, doubtful: false, .. } => {
            let known = !identified.is_generic();
            known.then(|| DetectedDrive {
                identified,
                ..DetectedDrive::with_known_profile(line, number, profile)
            })
        }
        _ => None,
    })
}

/// Returns whether a device is none of the known drives of a protocol where a write may mean anything to another
/// device: a register number of Modbus. On CANopen a device without the object refuses the write.
pub(super) fn is_other_device(line: &ProtocolLine, probe: &ProbeResult) -> bool {
    let is_modbus = line.protocol.name.starts_with("modbus");
    is_modbus && matches!(probe, ProbeResult::Found { lacks_identity: true, .. })
}

/// Result of the common stop of a protocol's known drives.
pub(super) enum SharedStop {
    /// The device is none of them.
    OtherDevice,
    /// They have none in common.
    None,
    /// The stop was sent.
    Sent(Result<(), Error>),
}

/// The error for a drive that was queried repeatedly and not identified, and how its stop, if one was sent,
/// ended.
pub(super) fn unidentified_error(
    prober: &Prober<'_>,
    number: u32,
    unknown: Error,
    result: SharedStop,
) -> Error {
    // What could not be asked is no usage error any more once a stop was sent.
    let is_usage = matches!(unknown, Error::Usage { .. });
    let unknown = match result {
        SharedStop::Sent(_) if is_usage => prober.unknown_error(number),
        _ => unknown,
    };
    let Error::Failed { what, outcome, received, hint, .. } =
        prober.with_profile_hint(unknown.clone())
    else {
        return unknown;
    };
    let (execution_text, outcome) = match (result, outcome) {
        (SharedStop::OtherDevice, _) => {
            ("no stop was sent: it lacks what every known drive of this protocol has", outcome)
        }
        (SharedStop::None, _) => {
            ("no stop was sent: the known drives of this protocol need different stops", outcome)
        }
        (SharedStop::Sent(Err(Error::Failed { outcome: part @ Outcome::Partly(..), .. })), _) => {
            (SHARED_STOP_SENT, part)
        }
        (SharedStop::Sent(_), Outcome::NotDone(failure @ Failure::AnsweredTwice)) => {
            (SHARED_STOP_SENT, Outcome::Unknown(failure))
        }
        // Whatever came, nothing confirms the stop.
        (SharedStop::Sent(_), _) => (SHARED_STOP_SENT, Outcome::Unknown(Failure::Silent)),
    };
    Error::Failed {
        what,
        execution: execution_text.to_owned(),
        outcome,
        received,
        may_turn: true,
        hint,
    }
}
