//! Axes that a verb powers and sets in motion, and that are stopped whatever ends it.

use polepair::Axis;
use polepair_core::axis::{Command, Verb};

use super::{keep_unconfirmed, run_optional_verb, stop_started};
use crate::interrupt;
use crate::outcome::to_problem;
use crate::problem::{Problem, Result};
use crate::session;

/// Axes that this verb powers and sets in motion. Whatever ends it stops them, a panic too.
pub(super) struct StartedMotion {
    pub(super) started: Vec<StartedAxis>,
    _holding: interrupt::HoldGuard,
}

/// An axis that this verb set in motion.
pub(super) struct StartedAxis {
    pub(super) axis: Axis,
    /// True if it was not powered before.
    pub(super) enabled_here: bool,
    /// True if a motion was requested, whether it was received or not.
    pub(super) moved: bool,
}

impl StartedMotion {
    pub(super) fn new(url: &str) -> Self {
        Self { started: Vec::new(), _holding: interrupt::hold_motion(url) }
    }

    pub(super) fn arm(&mut self, axis: &Axis) -> Result<()> {
        axis.arm().map_err(to_problem)?;
        self.started.push(StartedAxis { axis: axis.clone(), enabled_here: false, moved: false });
        Ok(())
    }

    /// Arms all axes, and powers each in the mode of its command, before any of them moves.
    pub(super) fn power_all(
        &mut self,
        commands: &[(Axis, Command)],
        unconfirmed: &mut Option<Problem>,
    ) -> Result<()> {
        commands.iter().try_for_each(|(axis, _)| self.arm(axis))?;
        for (one, (axis, command)) in self.started.iter_mut().zip(commands) {
            if !session::is_enabled(axis)? {
                // Noted before the request: whether or not it is answered, the power is this program's to take away.
                one.enabled_here = true;
                axis.interface().prepare_mode(command.verb).map_err(to_problem)?;
                keep_unconfirmed(run_optional_verb(axis, Verb::Enable), unconfirmed)?;
            }
        }
        Ok(())
    }

    /// A motion is asked for.
    pub(super) fn mark_moved(&mut self) {
        self.started.iter_mut().for_each(|one| one.moved = true);
    }

    /// Text once all of it was stopped.
    pub(super) fn stopped_text(&self) -> &'static str {
        if self.started.iter().any(|one| one.moved) {
            "the motion was stopped"
        } else {
            "no motion was started"
        }
    }

    /// The motion goes on without this process.
    pub(super) fn detach(mut self) {
        self.started.clear();
    }

    /// Stops the started axes, all at once, and takes the power off that this program put on.
    pub(super) fn finish(mut self, arrived: bool) -> Result<()> {
        stop_started(&std::mem::take(&mut self.started), arrived)
    }
}

impl Drop for StartedMotion {
    fn drop(&mut self) {
        if !self.started.is_empty() {
            let _ = stop_started(&std::mem::take(&mut self.started), false);
        }
    }
}

impl StartedAxis {
    /// Possible state of a motor whose stop was not confirmed.
    pub(super) const fn risk_text(&self) -> &'static str {
        if self.moved { "still turn" } else { "still be powered" }
    }
}
