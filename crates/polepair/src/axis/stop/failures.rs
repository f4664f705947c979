//! Failures of a stop's request, and their consequences.

use crate::error::Error;
use polepair_core::error::{Failure, Unsupported};

/// The failure in an error of the drive or the wire.
pub fn failure_of(error: &Error) -> Option<Failure> {
    let Error::Failed { outcome, .. } = error else { return None };
    outcome.failure()
}

/// Returns whether a later stop or motion replaced it. The stop is still pending then.
pub fn is_superseded(error: &Error) -> bool {
    failure_of(error) == Some(Failure::Cancelled)
}

/// Returns whether a repeated stop may still arrive. A drive that refused it has received it.
pub fn may_be_lost(error: &Error) -> bool {
    matches!(failure_of(error), Some(Failure::Silent | Failure::Misbehaved | Failure::LinkDown))
}

/// Returns whether the drive has no stop, so that a repetition is of no use.
pub fn is_impossible(error: &Error) -> bool {
    matches!(error, Error::Unsupported { why, .. } if *why != Unsupported::Busy)
}
