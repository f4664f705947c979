//! Paths that are sent point by point to a buffer of the drive.

use super::failure::RequestKind;
use super::{LocalAxis, RunningRequest};
use crate::error::Error;
use polepair_core::stream::{PathKind, Point};
use std::time::Duration;

/// Points handed over at a time.
const CHUNK_POINTS: usize = 64;
/// How often more are handed over; the lane holds hundreds.
const FEED_INTERVAL: Duration = Duration::from_millis(20);

/// A path whose first point asks for more than so many times the greatest speed of all that follows
/// begins somewhere else.
const FIRST_SPEED_MAX: f64 = 10.0;

impl LocalAxis {
    /// Checks a path before the axis is powered: the limits of a rack file, and the start at the actual
    /// position. Only reads are sent.
    ///
    /// # Errors
    /// [`Error::Usage`] `E223` for a limit of a file, [`Error::Unsupported`] `E222` if the way to the first
    /// point would be over ten times as fast as the path. Others by source.
    pub fn check_path(&self, kind: PathKind, points: &[Point]) -> Result<(), Error> {
        drop(self.apply_mounting_to_path(kind, points.iter().copied())?);
        let Some((first, rest)) = points.split_first() else { return Ok(()) };
        let lines = rest.iter().chain([first]).map(|point| point.velocity.abs());
        let ways =
            points.windows(2).map(|two| (two[1].position - two[0].position).abs() / two[1].time);
        let fastest = lines.chain(ways).fold(0.0, f64::max);
        if fastest <= 0.0 {
            return Ok(());
        }
        self.check_start_position(first.position, FIRST_SPEED_MAX * fastest * first.time)
    }

    /// Moves along points, from where the axis stands, and waits until the last one is reached. The
    /// axis must be armed and enabled. Positions are in rad or m, and the last point should be one at
    /// rest. Where a file limits the axis, the whole path is looked at before it begins.
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
    /// [`Error`] by blame. When it is interrupted the drive uses up what it has and stops.
    pub fn stream(
        &self,
        kind: PathKind,
        points: impl IntoIterator<Item = Point>,
    ) -> Result<i64, Error> {
        const WHAT: &str = "streaming a path";
        let mut rest = self.apply_mounting_to_path(kind, points.into_iter())?.fuse();
        let pending = self
            .connection
            .submit(|axes, now, ticket| axes.start_path(now, ticket, self.index, kind));
        let pending = pending.map_err(|why| self.unsupported_error(WHAT, why))?;
        let ticket = pending.ticket();
        let mut running = RunningRequest {
            axis: self.clone(),
            pending,
            what: WHAT.to_owned(),
            kind: RequestKind::Command,
        };
        let mut chunk: Vec<Point> = Vec::with_capacity(CHUNK_POINTS);
        loop {
            chunk.extend(rest.by_ref().take(CHUNK_POINTS - chunk.len()));
            let last = chunk.len() < CHUNK_POINTS;
            let consumed =
                self.connection.with_axes(|axes, _| axes.feed_points(ticket, &chunk, last));
            match consumed {
                Some(count) => drop(chunk.drain(..count)),
                None => return running.finish(),
            }
            if last && chunk.is_empty() {
                return running.finish();
            }
            if let Some(count) = running.wait(FEED_INTERVAL)? {
                return Ok(count);
            }
        }
    }
}
