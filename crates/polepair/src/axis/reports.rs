//! Periodic reports that a drive sends by itself: switched on and off.

use super::LocalAxis;
use crate::error::Error;
use polepair_core::profile::{ParameterId, Signal};
use std::time::Duration;

impl LocalAxis {
    /// Sets the signals that the drive sends by itself, with their interval: 1 ms to 65.535 s, not shorter than the
    /// drive permits. Without signals, it stops sending. One write, which replaces the earlier setting; drives store it
    /// if the parameter is stored (thruster family: SR, manual section 2.5). The values are in [`state`](Self::state),
    /// and in [`events`](Self::events) while a stream is open.
    ///
    /// # Errors
    /// [`Error::Usage`] `E213` for a signal that the drive does not send by itself, `E216` for another
    /// interval; others by source.
    pub fn set_reports(&self, signals: &[Signal], interval: Duration) -> Result<(), Error> {
        let ms = u16::try_from(interval.as_millis()).ok();
        let ms = ms.filter(|ms| *ms > 0 || signals.is_empty()).ok_or_else(|| {
            let what = format!("{}: reports every {interval:?} cannot be asked for", self.label());
            Error::usage("E216", what, "the interval is 1 ms to 65.535 s")
        })?;
        let setting = |ids: &[ParameterId]| {
            self.connection.with_axes(|axes, _| axes.report_setting(self.index, ids, ms))
        };
        let mut parameters = Vec::new();
        for signal in signals {
            let source = self.profile.signal(*signal).map(|source| source.parameter);
            let source = source.filter(|id| setting(&[*id]).is_some());
            parameters
                .push(source.ok_or_else(|| self.not_reported(*signal, setting(&[]).is_some()))?);
        }
        let (parameter, raw) = setting(&parameters)
            .ok_or_else(|| Error::usage("E213", self.sends_nothing(), ASK_INSTEAD))?;
        self.write(parameter, raw, false)
    }

    fn not_reported(&self, signal: Signal, sends_others: bool) -> Error {
        let what = if sends_others {
            format!("{} does not send its {} by itself", self.label(), signal.name())
        } else {
            self.sends_nothing()
        };
        Error::usage("E213", what, ASK_INSTEAD)
    }

    fn sends_nothing(&self) -> String {
        let protocol = self.protocol;
        format!(
            "{}: drives of {protocol} have no setting that makes them send signals",
            self.label()
        )
    }
}

const ASK_INSTEAD: &str = "without reports the drive is polled";
