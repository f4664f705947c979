//! Faults of a drive by their codes: name, cause, remedy.

use polepair_core::profile::{Fault, Profile};

/// The fault with this code; for faults as bits, one for each set bit.
#[must_use]
pub fn faults(profile: &'static Profile, code: u32) -> Vec<&'static Fault> {
    profile.faults_for_code(code).collect()
}
