//! Telemetry of an axis as rows: a sample of each signal with the same time.

use std::collections::VecDeque;
use std::task::Waker;
use std::time::Duration;

use polepair_client::SampleStream;
use polepair_client::message::SampleSource;
use polepair_client::message::telemetry::Sample;

use super::GatewayError;

/// Periods without a sample after which a drive counts as silent, and the shortest and longest such time in
/// seconds: a gateway leaves a drive that does not reply alone for a second.
const SILENT_PERIODS: f64 = 5.0;
const SILENT_MIN: f64 = 3.0;
const SILENT_MAX: f64 = 1e6;

/// Subscribed signals. Dropping it ends the subscriptions.
#[derive(Debug)]
pub struct SampleRows {
    subscriptions: Vec<(SampleStream, VecDeque<Sample>)>,
    /// Samples of each signal that were lost on the way.
    lost: Vec<u64>,
}

/// Seconds since the gateway's start, and a value of each signal.
pub type SampleRow = (f64, Vec<f64>);

impl SampleRows {
    pub(super) fn new(streams: Vec<SampleStream>) -> Self {
        let lost = vec![0; streams.len()];
        let subscriptions = streams.into_iter().map(|stream| (stream, VecDeque::new())).collect();
        Self { subscriptions, lost }
    }

    /// Waits for the next row, at most for this time.
    ///
    /// # Errors
    /// `E313` without a gateway.
    pub fn wait(&mut self, at_most: Duration) -> Result<Option<SampleRow>, GatewayError> {
        let row = self.next_row()?;
        if row.is_some() || at_most.is_zero() {
            return Ok(row);
        }
        if let Some(missing) = self.first_missing() {
            missing.wait(at_most);
        }
        self.next_row()
    }

    /// The next row, if a sample of each signal arrived: of each signal the last sample that is no later than
    /// the latest of the first ones. Nothing is interpolated.
    fn next_row(&mut self) -> Result<Option<SampleRow>, GatewayError> {
        for ((stream, pending), lost) in self.subscriptions.iter_mut().zip(&mut self.lost) {
            if pending.is_empty() {
                let (samples, lost_so_far) = stream.drain()?;
                pending.extend(samples);
                *lost = lost_so_far;
            }
        }
        let firsts = self.subscriptions.iter().map(|(_, pending)| pending.front().map(|s| s.t_us));
        let Some(at) = firsts.collect::<Option<Vec<_>>>().and_then(|all| all.into_iter().max())
        else {
            return Ok(None);
        };
        let values = self.subscriptions.iter_mut().map(|(_, pending)| {
            while pending.get(1).is_some_and(|sample| sample.t_us <= at) {
                pending.pop_front();
            }
            pending.pop_front().map_or(f64::NAN, |sample| sample.value)
        });
        Ok(Some((at as f64 / 1e6, values.collect())))
    }

    /// The first signal without a pending sample.
    fn first_missing(&self) -> Option<&SampleStream> {
        let missing = self.subscriptions.iter().find(|(_, pending)| pending.is_empty());
        missing.map(|(stream, _)| stream)
    }

    /// True if there may be a row already; else `waker` is woken once there may be one.
    pub fn poll_ready(&self, waker: &Waker) -> bool {
        self.first_missing().is_none_or(|missing| missing.poll_ready(waker))
    }

    /// Time without a row after which the drive counts as silent: the gateway continues to read it, and reports
    /// nothing. `None` for a drive that sends by itself, which may have nothing to send.
    #[must_use]
    pub fn silence_limit(&self) -> Option<f64> {
        let periods = self.subscriptions.iter().map(|(stream, _)| 1.0 / stream.hz());
        let longest = periods.fold(SILENT_MIN, |max, period| max.max(SILENT_PERIODS * period));
        let all_polled = self.subscriptions.iter().all(|(stream, _)| is_polled_stream(stream));
        all_polled.then_some(longest.min(SILENT_MAX))
    }

    /// Samples that were lost on the way so far, of the signal that lost most.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost.iter().copied().fold(0, u64::max)
    }
}

fn is_polled_stream(stream: &SampleStream) -> bool {
    stream.source() == SampleSource::Polled
}
