//! Telemetry of a server's axis: rows of samples with the same time.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Waker;

use polepair_client::message::SampleSource;
use polepair_client::message::telemetry::Sample;
use polepair_client::{GatewayError, SampleStream};
use pyo3::prelude::*;

use super::request::wait_sliced;
use crate::process_local::ProcessLocal;
use crate::request::WakeCallback;

/// For how many periods a drive may say nothing, and for how many seconds at least: its server leaves
/// one that does not answer alone for a second, and has others to ask.
const QUIET_PERIODS: f64 = 5.0;
const QUIET_MIN: f64 = 3.0;
const QUIET_MAX: f64 = 1e6;

/// Signals that are watched, until this goes.
#[pyclass(frozen, name = "ServedWatch", module = "polepair._polepair")]
#[derive(Debug)]
pub struct ServedWatch(ProcessLocal<Mutex<SampleRows>>);

/// Samples of each signal that wait for those of the others.
#[derive(Debug)]
struct SampleRows {
    subscriptions: Vec<(Arc<SampleStream>, VecDeque<Sample>)>,
    /// Samples of each that were lost on the way.
    lost: Vec<u64>,
}

/// Seconds since the server's start, and a value of each signal.
type SampleRow = (f64, Vec<f64>);

impl ServedWatch {
    pub(super) fn new(watched: Vec<Arc<SampleStream>>) -> Self {
        let lost = vec![0; watched.len()];
        let watched = watched.into_iter().map(|watched| (watched, VecDeque::new())).collect();
        Self(Mutex::new(SampleRows { subscriptions: watched, lost }).into())
    }

    fn lock(&self) -> MutexGuard<'_, SampleRows> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl SampleRows {
    /// The next row, if all of it is there: of each signal the last sample that is no later than the
    /// latest of the first ones. Nothing is interpolated.
    fn next_row(&mut self) -> Result<Option<SampleRow>, GatewayError> {
        for ((watched, waiting), lost) in self.subscriptions.iter_mut().zip(&mut self.lost) {
            if waiting.is_empty() {
                let (samples, lost_so_far) = watched.drain()?;
                waiting.extend(samples);
                *lost = lost_so_far;
            }
        }
        let firsts = self.subscriptions.iter().map(|(_, waiting)| waiting.front().map(|s| s.t_us));
        let Some(at) = firsts.collect::<Option<Vec<_>>>().and_then(|all| all.into_iter().max())
        else {
            return Ok(None);
        };
        let values = self.subscriptions.iter_mut().map(|(_, waiting)| {
            while waiting.get(1).is_some_and(|sample| sample.t_us <= at) {
                waiting.pop_front();
            }
            waiting.pop_front().map_or(f64::NAN, |sample| sample.value)
        });
        Ok(Some((at as f64 / 1e6, values.collect())))
    }

    /// What is waited for: the first signal that has nothing.
    fn first_missing(&self) -> Option<&SampleStream> {
        self.subscriptions
            .iter()
            .find(|(_, waiting)| waiting.is_empty())
            .map(|(watched, _)| &**watched)
    }
}

#[pymethods]
impl ServedWatch {
    /// Waits for the next row, at most `timeout` seconds.
    #[pyo3(signature = (timeout=None))]
    fn result(&self, py: Python<'_>, timeout: Option<f64>) -> PyResult<Option<SampleRow>> {
        self.0.in_own_process(py)?;
        wait_sliced(py, timeout, |slice| {
            let mut rows = self.lock();
            let row = rows.next_row()?;
            if row.is_some() || slice.is_zero() {
                return Ok(row);
            }
            if let Some(missing) = rows.first_missing() {
                missing.wait(slice);
            }
            rows.next_row()
        })
    }

    /// Calls `wake` from some thread once there may be a row; true when there may be one already.
    #[pyo3(name = "tell")]
    fn wake_when_ready(&self, py: Python<'_>, wake: Py<PyAny>) -> PyResult<bool> {
        self.0.in_own_process(py)?;
        let waker = Waker::from(Arc::new(WakeCallback(wake)));
        Ok(py.detach(|| {
            let rows = self.lock();
            rows.first_missing().is_none_or(|missing| missing.poll_ready(&waker))
        }))
    }

    /// Seconds without a row after which the drive does not answer: its server goes on asking, and says
    /// nothing. `None` where a drive sends by itself, and may have nothing to say.
    #[getter]
    fn patience(&self, py: Python<'_>) -> PyResult<Option<f64>> {
        self.0.in_own_process(py)?;
        Ok(py.detach(|| {
            let rows = self.lock();
            let asks = rows
                .subscriptions
                .iter()
                .all(|(watched, _)| watched.source() == SampleSource::Polled);
            let periods = rows.subscriptions.iter().map(|(watched, _)| 1.0 / watched.hz());
            let longest = periods.fold(QUIET_MIN, |max, period| max.max(QUIET_PERIODS * period));
            asks.then_some(longest.min(QUIET_MAX))
        }))
    }

    /// Samples that were lost on the way so far, of the signal that lost most.
    #[getter]
    fn lost(&self, py: Python<'_>) -> PyResult<u64> {
        self.0.in_own_process(py)?;
        Ok(py.detach(|| self.lock().lost.iter().copied().max().unwrap_or_default()))
    }
}
