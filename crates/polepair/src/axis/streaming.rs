//! Paths that are sent point by point to a buffer of the drive.

use super::LocalAxis;
use super::failure::RequestKind;
use crate::error::Error;
use crate::interface::AxisReadings;
use polepair_core::error::{Failure, Outcome};
use polepair_core::judge::{EndReason, LimitEnd};
use polepair_core::profile::Signal;
use polepair_core::stream::{PathKind, Point};
use std::time::Duration;

/// Points handed over at a time.
const CHUNK_POINTS: usize = 64;
/// Interval of handing over further points; the lane holds hundreds.
const FEED_INTERVAL: Duration = Duration::from_millis(20);

/// Factor of the path's greatest speed. A first point that needs more belongs to another start.
const FIRST_SPEED_MAX: f64 = 10.0;

/// Time limit of an axis to arrive at its last set-point.
pub(super) const SETTLING_MAX: Duration = Duration::from_secs(5);

impl LocalAxis {
    /// Checks a path before the axis is powered: the limits of a rack file, and the start at the actual
    /// position. Only reads are sent.
    ///
    /// # Errors
    /// [`Error::Usage`] `E223` for a limit of a file, [`Error::Unsupported`] `E222` if the way to the first
    /// point would be over ten times as fast as the path. Others by source.
    pub fn check_path(&self, kind: PathKind, points: &[Point]) -> Result<(), Error> {
        // For its errors: the converted points are made again when the path is sent.
        drop(self.apply_mounting_to_path(kind, points.iter().copied())?);
        let Some((first, rest)) = points.split_first() else { return Ok(()) };
        let lines = rest.iter().chain([first]).map(|point| point.velocity.abs());
        let ways =
            points.windows(2).map(|two| (two[1].position - two[0].position).abs() / two[1].time);
        let fastest = lines.chain(ways).fold(0.0, f64::max);
        debug_assert!(!fastest.is_nan(), "f64::max leaves NaN out");
        // A path at rest has no speed to compare its start with.
        if fastest <= 0.0 {
            return Ok(());
        }
        self.check_start_position(first.position, FIRST_SPEED_MAX * fastest * first.time)
    }

    /// Moves along points, from the present position, and waits until the last one is reached. The axis must be armed
    /// and enabled. Positions are in rad or m, and the last point should be one at rest. Where a file limits the axis,
    /// the whole path is looked at before it begins.
    ///
    /// ```
    /// use polepair_core::stream::{PathKind, Point};
    /// let link = polepair::connect_local("sim:technosoft-f514l?time=virtual")?;
    /// let axis = link.axes()[0].armed()?;
    /// let path = [
    ///     Point { position: 0.5, velocity: 10.0, time: 0.1 },
    ///     Point { position: 1.0, velocity: 0.0, time: 0.1 },
    /// ];
    /// assert_eq!(axis.stream(PathKind::Pvt, path)?, 2);
    /// # Ok::<(), polepair::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error`] by source; `E106` where the axis is elsewhere at the end. When it is interrupted the drive uses
    /// up its buffered points and stops.
    pub fn stream(
        &self,
        kind: PathKind,
        points: impl IntoIterator<Item = Point>,
    ) -> Result<i64, Error> {
        const WHAT: &str = "streaming a path";
        let mut rest = self.apply_mounting_to_path(kind, points.into_iter())?.fuse();
        let submitted = self
            .connection
            .submit(|axes, now, ticket| axes.start_path(now, ticket, self.index, kind));
        let mut running = self.running(WHAT, RequestKind::Command, submitted)?;
        let ticket = running.pending.ticket();
        let mut chunk: Vec<Point> = Vec::with_capacity(CHUNK_POINTS);
        loop {
            chunk.extend(rest.by_ref().take(CHUNK_POINTS - chunk.len()));
            let last = chunk.len() < CHUNK_POINTS;
            let consumed =
                self.connection.with_axes(|axes, _| axes.feed_points(ticket, &chunk, last));
            let fed = match consumed {
                Some(count) => {
                    chunk.drain(..count);
                    debug_assert!(count <= CHUNK_POINTS);
                    last && chunk.is_empty()
                }
                None => true,
            };
            let ended = if fed { running.finish().map(Some) } else { running.wait(FEED_INTERVAL) };
            if let Some(count) = ended.map_err(|error| self.reason_of_end(WHAT, error))? {
                // An empty buffer is no evidence on the motor.
                self.wait(SETTLING_MAX)?;
                return Ok(count);
            }
        }
    }

    /// The error of a path that the drive gave up. Its buffer only shows that it did; a fault or a limit that
    /// it has is why.
    fn reason_of_end(&self, what: &str, error: Error) -> Error {
        let Error::Failed { outcome, .. } = &error else { return error };
        if !matches!(outcome.failure(), Some(Failure::NotReady { .. })) {
            return error;
        }
        let fault = AxisReadings::faults(self).into_iter().flatten().find(|one| !one.is_warning);
        let failure = match fault {
            Some(fault) => Failure::Faulted { code: fault.code },
            None if self.has_active_limit(Signal::PositiveLimit) => {
                Failure::Elsewhere(EndReason::Limit(LimitEnd::Positive))
            }
            None if self.has_active_limit(Signal::NegativeLimit) => {
                Failure::Elsewhere(EndReason::Limit(LimitEnd::Negative))
            }
            None => return error,
        };
        self.outcome_error(what, RequestKind::Command, Outcome::Unknown(failure))
    }

    fn has_active_limit(&self, signal: Signal) -> bool {
        self.provides_signal(signal).unwrap_or(false)
            && self.signals(&[signal]).is_ok_and(|read| read[0].raw != 0)
    }
}
