//! Checks the steps of a plan against the drive, before the first of them is sent.

use alloc::vec::Vec;

use super::slot::AxisSlot;
use super::watch::targets_position;
use crate::axis::Command;
use crate::error::Unsupported;
use crate::plan::{Argument, Operand, Step};
use crate::profile::ParameterId;
use crate::station::RequestClass;

const NO_OBJECT: &str = "the drive has no object for this: its maker left out what the standard does \
                       not demand";
const NO_SPEED: &str =
    "a move at speed zero never arrives: give a greater speed, or none for the drive's own";

impl<R: crate::station::Request, A: Copy + 'static> AxisSlot<R, A> {
    /// The request of a step that writes several parameters at once.
    ///
    /// # Errors
    /// As [`operand_value`](Self::operand_value), or why they are not written together.
    pub fn write_together_request(
        &self,
        writes: &[(ParameterId, Operand)],
        command: &Command,
        class: RequestClass,
    ) -> Result<R, Unsupported> {
        let value = |&(id, operand): &(ParameterId, Operand)| {
            let raw = self.operand_value(operand, command, Some(id))?;
            let raw = raw.ok_or(Unsupported::BadArgument)?;
            Ok((self.check_writable(id, raw)?, raw))
        };
        let values: Vec<_> = writes.iter().map(value).collect::<Result<_, Unsupported>>()?;
        self.driver.write_together_request(&values, class)
    }

    /// Checks whether steps can be carried out, as far as known.
    pub fn check_steps(&self, steps: &[Step], command: &Command) -> Result<(), Unsupported> {
        if targets_position(command.verb) && command.velocity == Some(0.0) {
            return Err(Unsupported::Forbidden(NO_SPEED));
        }
        steps.iter().try_for_each(|step| self.check_step(step, command).map(drop))
    }

    /// Checks whether a step can be carried out, as far as known. `Ok(false)` when a scale is still
    /// missing.
    pub fn check_step(&self, step: &Step, command: &Command) -> Result<bool, Unsupported> {
        if let Step::SkipBySign { argument, .. } = *step {
            let is_number = command.argument(argument).is_none_or(f64::is_finite);
            return is_number.then_some(true).ok_or(Unsupported::BadArgument);
        }
        let mut is_known = true;
        for (operand, like) in step.operands() {
            is_known &= self.check_operand(step, operand, like, command)?;
        }
        Ok(is_known)
    }

    /// Checks a value of a step. `Ok(false)` when its scale is still missing.
    fn check_operand(
        &self,
        step: &Step,
        operand: Operand,
        like: Option<ParameterId>,
        command: &Command,
    ) -> Result<bool, Unsupported> {
        if let (Some(which), Some(id)) = (operand.argument(), like) {
            match command.argument(which) {
                Some(si) if !si.is_finite() => return Err(Unsupported::BadArgument),
                // Drives count from one: zero is none, and a fraction would be rounded to another path.
                Some(si) if which == Argument::Path && (si < 1.0 || si % 1.0 != 0.0) => {
                    let (value, max) = (si as i64, self.parameter(id).map_or(i64::MAX, |p| p.max));
                    return Err(Unsupported::OutOfRange { parameter: id, value, min: 1, max });
                }
                // A speed or a limit that the caller named must not be dropped silently (PROFILE-2).
                Some(_) if self.lacks_parameter(id) => {
                    return Err(Unsupported::Forbidden(NO_OBJECT));
                }
                Some(_) if self.missing_factor(id).is_some() => return Ok(false),
                _ => {}
            }
        }
        let raw = self.operand_value(operand, command, like)?;
        // Too slow for the drive's own numbers.
        if raw == Some(0)
            && operand.argument() == Some(Argument::Velocity)
            && targets_position(command.verb)
        {
            return Err(Unsupported::Forbidden(NO_SPEED));
        }
        if let (Step::Write(..) | Step::WriteTogether(_), Some(id), Some(raw)) = (step, like, raw) {
            self.check_writable(id, raw)?;
        }
        Ok(true)
    }
}
