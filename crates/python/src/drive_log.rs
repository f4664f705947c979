//! Recordings in a drive's memory.

use std::ops::ControlFlow;

use polepair::{DriveLog, DriveLogRequest, DriveLogStage, Error, LocalAxis};
use pyo3::prelude::*;

use crate::axis::PyAxis;

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
    fn request(&self, axis: &LocalAxis) -> Result<DriveLogRequest, Error> {
        let variables =
            self.variables.iter().map(|name| axis.find(name)).collect::<Result<_, _>>()?;
        Ok(DriveLogRequest {
            start_when: self.on.as_ref().map(|text| axis.parse_log_condition(text)).transpose()?,
            memory: self.buffer.map(|(first, last)| first..=last),
            accept_inferred: self.inferred,
            ..DriveLogRequest::at_rate(variables, self.rate, self.seconds)?
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
