//! Values that a drive sends by itself.

mod process_data;

use std::time::Duration;

use super::LocalAxis;
use crate::error::Error;
use crate::lss::PROTOCOL as CANOPEN;
use polepair_core::profile::ParameterId;

/// Values that a drive was set to send by itself. [`end`](Self::end) restores what was there before; dropping it does
/// so too, but its errors are lost.
#[derive(Debug)]
#[must_use = "the drive is set back when this is dropped"]
pub struct RunningReports {
    axis: LocalAxis,
    /// Writes that end the sending, in order.
    undo: Vec<(ParameterId, i64)>,
}

impl LocalAxis {
    /// Sets the values that the drive sends by itself, with their interval: 1 ms to 65.535 s, not shorter than the
    /// drive permits. The values of signals are in [`state`](Self::state); those of all parameters in
    /// [`events`](Self::events) while a stream is open.
    ///
    /// - Thruster family: one write (SR, manual section 2.5), which replaces an earlier setting and is stored.
    /// - CANopen: TPDOs that are switched off are mapped, with the interval as their event time and inhibit time
    ///   (CiA 301, 7.5.2.37), and the node is started. Nothing of it is stored.
    ///
    /// # Errors
    /// [`Error::Usage`] `E213` for a parameter that the drive does not send by itself, `E216` for another interval,
    /// `E217` for more values than fit; others by source. What was changed before an error is restored.
    pub fn start_reports(
        &self,
        parameters: &[ParameterId],
        interval: Duration,
    ) -> Result<RunningReports, Error> {
        let ms =
            u16::try_from(interval.as_millis()).ok().filter(|ms| *ms > 0).ok_or_else(|| {
                let what =
                    format!("{}: reports every {interval:?} cannot be asked for", self.label());
                Error::usage("E216", what, "the interval is 1 ms to 65.535 s")
            })?;
        if self.protocol == CANOPEN {
            return process_data::start(self, parameters, ms);
        }
        let setting = |ids: &[ParameterId]| {
            self.connection.with_axes(|axes, _| axes.report_setting(self.index, ids, ms))
        };
        let (off, zero) = setting(&[]).ok_or_else(|| self.sends_nothing())?;
        if let Some(id) = parameters.iter().find(|id| setting(&[**id]).is_none()) {
            return Err(self.does_not_send(*id));
        }
        let (parameter, raw) = setting(parameters).ok_or_else(|| self.sends_nothing())?;
        let running = RunningReports { axis: self.clone(), undo: vec![(off, zero)] };
        self.write(parameter, raw, false)?;
        Ok(running)
    }

    fn does_not_send(&self, id: ParameterId) -> Error {
        let name = self.parameter(id).map_or("this", |parameter| parameter.name);
        let what = format!("{} does not send {name} by itself", self.label());
        Error::usage("E213", what, ASK_INSTEAD)
    }

    fn sends_nothing(&self) -> Error {
        let protocol = self.protocol;
        let what = format!(
            "{}: drives of {protocol} have no setting that makes them send signals",
            self.label()
        );
        Error::usage("E213", what, ASK_INSTEAD)
    }
}

impl RunningReports {
    /// Sets the drive back.
    ///
    /// # Errors
    /// [`Error`] by source; the drive may then continue to send.
    pub fn end(mut self) -> Result<(), Error> {
        self.restore()
    }

    fn restore(&mut self) -> Result<(), Error> {
        let undo = std::mem::take(&mut self.undo);
        if self.axis.protocol == CANOPEN {
            process_data::restore(&self.axis, &undo)
        } else {
            undo.iter().try_for_each(|(id, raw)| self.axis.write(*id, *raw, false))
        }
    }
}

impl Drop for RunningReports {
    fn drop(&mut self) {
        // `end` returns the error; there is no one to give it to here.
        let _ = self.restore();
    }
}

const ASK_INSTEAD: &str = "without reports the drive is polled";
