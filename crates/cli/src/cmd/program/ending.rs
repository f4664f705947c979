//! The end of a program: it and its motion are ended, and the power that was put on is removed.

use polepair::LocalAxis;
use polepair::axis::STOP_RETRY_MAX;
use polepair_core::axis::Verb;
use polepair_core::profile::Signal;

use crate::motion;
use crate::problem::Result;
use crate::session::{read_signal, run_optional_verb};
use crate::terminal::print_warning;

/// Whether the motor has power, as far as the drive tells.
pub fn is_powered(axis: &LocalAxis) -> Result<bool> {
    Ok(read_signal(axis, Signal::Enabled)?.is_some_and(|read| read.raw != 0))
}

/// Ends the program and the motion, and takes the power off that was put on.
pub fn end_program(axis: &LocalAxis, powered: bool) -> Result<()> {
    let mut stop_retry_notice = motion::StopRetryNotice::new();
    let ended = axis.abort_with_retry(STOP_RETRY_MAX, |axis, _| {
        stop_retry_notice.report_retry(&axis.label(), "still turn")
    });
    let ended = stop_retry_notice.report_end(&axis.label(), ended);
    let rested = if ended.is_ok() { motion::wait_standstill(axis) } else { Ok(()) };
    let off = if powered { Ok(None) } else { run_optional_verb(axis, Verb::Disable) };
    if ended.is_err() && (powered || off.is_err()) {
        print_warning(&format!("{} may still turn: cut its supply", axis.label()));
    }
    ended.and(rested).and(off.map(drop))
}
