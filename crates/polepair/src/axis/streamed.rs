//! Paths streamed point by point.

use super::{Axis, Running};
use crate::error::Error;
use polepair_core::stream::{PathKind, Point};
use std::time::Duration;

/// Points handed over at a time.
const CHUNK: usize = 64;
/// How often more are handed over; the lane holds hundreds.
const PAUSE: Duration = Duration::from_millis(20);

impl Axis {
    /// Moves along points, from where the axis stands, and waits until the last one is reached. The
    /// axis must be armed and enabled. Positions are in rad or m, and the last point should be one at
    /// rest. Where a file limits the axis, the whole path is looked at before it begins.
    ///
    /// ```
    /// use polepair_core::stream::{PathKind, Point};
    /// let link = polepair::connect("sim:technosoft-f514l?time=virtual")?;
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
        let mut rest = self.fitted_path(kind, points.into_iter())?.fuse();
        let pending =
            self.connection.submit(|axes, now, ticket| axes.stream(now, ticket, self.index, kind));
        let pending = pending.map_err(|why| self.refuse(WHAT, why))?;
        let ticket = pending.ticket();
        let mut running = Running { axis: self.clone(), pending, what: WHAT.to_owned() };
        let mut chunk: Vec<Point> = Vec::with_capacity(CHUNK);
        loop {
            chunk.extend(rest.by_ref().take(CHUNK - chunk.len()));
            let last = chunk.len() < CHUNK;
            let taken = self.connection.with(|axes, _| axes.feed(ticket, &chunk, last));
            match taken {
                Some(count) => drop(chunk.drain(..count)),
                None => return running.finish(),
            }
            if last && chunk.is_empty() {
                return running.finish();
            }
            if let Some(count) = running.wait(PAUSE)? {
                return Ok(count);
            }
        }
    }
}
