//! A guard that keeps an axis armed, and stops and disables it when it is dropped.

use std::ops::Deref;

use polepair_core::axis::{Command, Verb};

use super::{Axis, AxisInterface};
use crate::axis::LocalAxis;
use crate::error::Error;

/// An axis that can be armed for a scope.
pub trait ArmableAxis: Clone {
    /// The axis interface.
    fn interface(&self) -> &dyn AxisInterface;
}

impl ArmableAxis for Axis {
    fn interface(&self) -> &dyn AxisInterface {
        Self::interface(self)
    }
}

impl ArmableAxis for LocalAxis {
    fn interface(&self) -> &dyn AxisInterface {
        self
    }
}

/// An armed and enabled axis. Dropping it stops, disables and disarms the axis. Errors are lost then; call
/// [`release`](Self::release) to get them. A stop without a reply is repeated for
/// [`STOP_RETRY_MAX`](crate::axis::STOP_RETRY_MAX).
#[derive(Debug)]
#[must_use = "the axis is disabled when this is dropped"]
pub struct Armed<A: ArmableAxis = Axis> {
    axis: A,
    released: bool,
}

impl Axis {
    /// Arms and enables the axis until the guard is dropped, which stops and disables it.
    ///
    /// # Errors
    /// [`Error`] by source; the axis is then disarmed again. `E220` if it is armed already: it then stays so.
    pub fn armed(&self) -> Result<Armed, Error> {
        Armed::new(self)
    }
}

impl LocalAxis {
    /// Arms and enables the axis until the guard is dropped, which stops and disables it.
    ///
    /// # Errors
    /// [`Error`] by blame; the axis is then disarmed again. `E220` when it is armed already: it then
    /// stays so.
    pub fn armed(&self) -> Result<Armed<Self>, Error> {
        Armed::new(self)
    }
}

impl<A: ArmableAxis> Armed<A> {
    pub(crate) fn new(axis: &A) -> Result<Self, Error> {
        axis.interface().arm()?;
        let armed = Self { axis: axis.clone(), released: false };
        // A drive that cannot be enabled is only armed. An error drops the guard, which disarms.
        if axis.interface().facts().verbs.contains(&Verb::Enable) {
            axis.interface().start(Command::new(Verb::Enable))?.finish()?;
        }
        Ok(armed)
    }

    /// Stops, disables and disarms.
    ///
    /// # Errors
    /// [`Error`] by source; the axis is disarmed in any case, and disabling was tried though stopping failed.
    pub fn release(mut self) -> Result<(), Error> {
        self.released = true;
        self.axis.interface().release()
    }

    /// Disarms and leaves the motor as it is. A gateway stops a motion when its lease ends.
    ///
    /// # Errors
    /// [`Error::Gateway`] if a gateway does not answer.
    pub fn detach(mut self) -> Result<(), Error> {
        self.released = true;
        self.axis.interface().disarm()
    }
}

impl<A: ArmableAxis> Deref for Armed<A> {
    type Target = A;
    fn deref(&self) -> &A {
        &self.axis
    }
}

impl<A: ArmableAxis> Drop for Armed<A> {
    fn drop(&mut self) {
        if !self.released {
            let _ = self.axis.interface().release();
        }
    }
}
