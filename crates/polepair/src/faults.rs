//! Faults of a drive by their codes: name, cause, remedy.

use polepair_core::profile::{Fault, Profile, Severity};

use crate::interface::FaultReport;

/// The fault with this code; for faults as bits, one for each set bit.
#[must_use]
pub fn faults(profile: &'static Profile, code: u32) -> Vec<&'static Fault> {
    profile.faults_for_code(code).collect()
}

/// The active faults and warnings in a raw value of the drive's fault signal. A code that the profile does not know
/// is a fault as well.
#[must_use]
pub fn active_faults(profile: &'static Profile, raw: i64) -> Vec<FaultReport> {
    let code = profile.fault_word(raw);
    if code == 0 {
        return Vec::new();
    }
    let known = faults(profile, code);
    if known.is_empty() {
        return vec![FaultReport {
            code,
            name: format!("code {code:#x}").into(),
            text: "not known to this profile".into(),
            cause: "".into(),
            remedy: "look it up in the drive's manual".into(),
            is_warning: false,
        }];
    }
    let active = known.into_iter().filter(|fault| fault.severity != Severity::Note);
    active.map(FaultReport::from).collect()
}
