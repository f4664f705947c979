//! A guard that keeps an axis armed, and stops and disables it when it is dropped.

use super::{Axis, STOP_RETRY_MAX, stop_with_retry};
use crate::error::Error;
use polepair_core::axis::Verb;
use std::ops::Deref;

/// An armed and enabled axis. Dropping it stops, disables and disarms the axis. Errors are lost then; call
/// [`release`](Self::release) to get them. A stop without a reply is repeated for [`STOP_RETRY_MAX`].
#[derive(Debug)]
#[must_use = "the axis is disabled when this is dropped"]
pub struct Armed {
    axis: Axis,
    released: bool,
}

impl Armed {
    pub(super) fn new(axis: &Axis) -> Result<Self, Error> {
        axis.arm_exclusively()?;
        let armed = Self { axis: axis.clone(), released: false };
        // Where there is nothing to switch on, arming is all there is to do. An error drops the
        // guard, which disarms.
        if axis.profile.plan(Verb::Enable).is_some() {
            axis.enable()?;
        }
        Ok(armed)
    }

    /// Stops, disables and disarms.
    ///
    /// # Errors
    /// [`Error`] by blame; the axis is disarmed in any case, and disabling was tried though
    /// stopping failed.
    pub fn release(mut self) -> Result<(), Error> {
        self.stop_and_disarm()
    }

    /// Disarms and leaves the motor as it is.
    pub fn detach(mut self) {
        self.released = true;
        self.axis.arm(false);
    }

    fn stop_and_disarm(&mut self) -> Result<(), Error> {
        self.released = true;
        let one = std::slice::from_ref(&self.axis);
        let stopped: Result<(), Error> =
            stop_with_retry(one, STOP_RETRY_MAX, |_, _| true).into_iter().collect();
        let has_switch = self.axis.profile.plan(Verb::Disable).is_some();
        let disabled = if has_switch { self.axis.disable() } else { Ok(()) };
        self.axis.arm(false);
        stopped.and(disabled)
    }
}

impl Deref for Armed {
    type Target = Axis;
    fn deref(&self) -> &Axis {
        &self.axis
    }
}

impl Drop for Armed {
    fn drop(&mut self) {
        if !self.released {
            let _ = self.stop_and_disarm();
        }
    }
}
