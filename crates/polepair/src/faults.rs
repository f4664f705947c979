//! Faults of a drive by their codes: name, cause, remedy.

use polepair_core::profile::{Fault, Profile};

/// The fault of that code; where a drive tells faults as bits, every bit that is set.
#[must_use]
pub fn faults(profile: &'static Profile, code: u32) -> Vec<&'static Fault> {
    profile.faults_for_code(code).collect()
}
