//! Recordings in a drive's memory.

use std::ops::ControlFlow;
use std::time::Duration;

use polepair::{DriveLog, DriveLogRequest, DriveLogStage, Error, LocalAxis};
use pyo3::prelude::*;

use crate::axis::PyAxis;
use crate::errors::usage_error;

const HINT: &str = "open the drive's link in this program";

/// Interval in seconds, and for each variable its name, SI unit and values.
pub type DriveLogTuple = (f64, Vec<(String, &'static str, Vec<f64>)>);

/// A recording, as Python describes it.
#[derive(FromPyObject, Debug)]
#[pyo3(from_item_all)]
pub struct PyLogRequest {
    variables: Vec<String>,
    rate: f64,
    seconds: f64,
    on: Option<String>,
    buffer: Option<(u16, u16)>,
    inferred: bool,
}

/// Records in the drive of an axis, and calls `start` when the recording runs.
pub fn record(
    py: Python<'_>,
    axis: &PyAxis,
    request: &PyLogRequest,
    start: Option<&Py<PyAny>>,
) -> PyResult<DriveLogTuple> {
    request.check(py)?;
    let mut raised = None;
    let recorded = axis.detach(py, |axis| {
        request.record(axis.require_local("recording in the drive", HINT)?, start, &mut raised)
    });
    match raised {
        Some(error) => Err(error),
        None => recorded.map(|log| log_tuple(&log)),
    }
}

impl PyLogRequest {
    /// Checks the numbers, which are no times yet.
    fn check(&self, py: Python<'_>) -> PyResult<()> {
        let is_time =
            |seconds: f64| Duration::try_from_secs_f64(seconds).is_ok_and(|it| !it.is_zero());
        if !is_time(1.0 / self.rate) || !is_time(self.seconds) {
            let what = format!("rate={} seconds={}: no recording", self.rate, self.seconds);
            return Err(usage_error(py, "E216", &what, "both are more than 0"));
        }
        Ok(())
    }

    fn request(&self, axis: &LocalAxis) -> Result<DriveLogRequest, Error> {
        let variables =
            self.variables.iter().map(|name| axis.find(name)).collect::<Result<_, _>>()?;
        Ok(DriveLogRequest {
            variables,
            interval: Duration::from_nanos((1e9 / self.rate).round() as u64),
            span: Duration::from_secs_f64(self.seconds),
            start_when: self.on.as_ref().map(|text| axis.parse_log_condition(text)).transpose()?,
            memory: self.buffer.map(|(first, last)| first..=last),
            accept_inferred: self.inferred,
        })
    }

    /// Records, and calls `start` once the recording runs or its condition is waited for. An exception of `start`, and
    /// Ctrl-C, end the recording and come in `raised`.
    fn record(
        &self,
        axis: &LocalAxis,
        start: Option<&Py<PyAny>>,
        raised: &mut Option<PyErr>,
    ) -> Result<DriveLog, Error> {
        let plan = axis.plan_drive_log(&self.request(axis)?)?;
        let mut start = start;
        axis.record_in_drive(&plan, |progress| {
            if progress.stage == DriveLogStage::Reading || raised.is_some() {
                return ControlFlow::Continue(());
            }
            let went = Python::attach(|py| {
                py.check_signals()?;
                start.take().map_or(Ok(()), |start| start.call0(py).map(drop))
            });
            match went {
                Ok(()) => ControlFlow::Continue(()),
                Err(error) => {
                    *raised = Some(error);
                    ControlFlow::Break(())
                }
            }
        })
    }
}

/// The recording in SI.
fn log_tuple(log: &DriveLog) -> DriveLogTuple {
    let variables = log.variables.iter().map(|variable| {
        (variable.name.to_owned(), variable.si_symbol(), variable.si_values().collect())
    });
    (log.interval.as_secs_f64(), variables.collect())
}
