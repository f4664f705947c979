//! Faults as tuples.

use std::borrow::Cow;

use polepair::interface::FaultReport;

/// Code, name, text, cause, remedy, and whether it is a warning only.
pub type FaultTuple =
    (u32, Cow<'static, str>, Cow<'static, str>, Cow<'static, str>, Cow<'static, str>, bool);

/// A fault as a caller has it.
pub fn fault_tuple(fault: FaultReport) -> FaultTuple {
    let FaultReport { code, name, text, cause, remedy, is_warning } = fault;
    (code, name, text, cause, remedy, is_warning)
}
