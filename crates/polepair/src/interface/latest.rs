//! The latest value of a signal or parameter, for a caller that shows it periodically.

use std::fmt;

use crate::error::Error;

/// The latest value of a signal or parameter of an axis. A drive on a wire of this program is read at each call; a
/// gateway sends the values by itself.
pub struct LatestValue {
    unit: String,
    read: Box<dyn Fn() -> Result<f64, Error> + Send>,
}

impl fmt::Debug for LatestValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LatestValue").field("unit", &self.unit).finish_non_exhaustive()
    }
}

impl LatestValue {
    pub(crate) fn new(
        unit: impl Into<String>,
        read: impl Fn() -> Result<f64, Error> + Send + 'static,
    ) -> Self {
        Self { unit: unit.into(), read: Box::new(read) }
    }

    /// The unit's symbol; empty for flags and for values without a unit.
    #[must_use]
    pub fn unit(&self) -> &str {
        &self.unit
    }

    /// The value in [`unit`](Self::unit), or the drive's own number if its scale is unknown. NaN if the drive does not
    /// report it, or if the gateway received none lately.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn read(&self) -> Result<f64, Error> {
        (self.read)()
    }
}
