//! What a fault code stands for.

use polepair_core::profile::{Fault, Profile};

/// The fault of that code; where a drive tells faults as bits, every bit that is set.
#[must_use]
pub fn faults(profile: &'static Profile, code: u32) -> Vec<&'static Fault> {
    if let Some(fault) = profile.faults.iter().find(|fault| fault.code == code) {
        return vec![fault];
    }
    let bits = profile.faults.iter().all(|fault| fault.code.is_power_of_two());
    let set = |fault: &&Fault| bits && fault.code & code != 0;
    profile.faults.iter().filter(set).collect()
}
