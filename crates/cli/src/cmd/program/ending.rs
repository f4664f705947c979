//! The end of a program: it and its motion are ended, and the power that was put on is removed.

use polepair::LocalAxis;
use polepair_core::profile::Signal;

use crate::motion;
use crate::problem::Result;
use crate::session::read_signal;

/// Returns whether the motor has power, as far as the drive reports it.
pub fn is_powered(axis: &LocalAxis) -> Result<bool> {
    Ok(read_signal(axis, Signal::Enabled)?.is_some_and(|read| read.raw != 0))
}

/// Ends the program and the motion, and takes the power off that was put on.
pub fn end_program(axis: &LocalAxis, powered: bool) -> Result<()> {
    motion::end_motion(axis.clone().into(), !powered)
}
