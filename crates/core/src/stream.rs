//! Paths point by point, for drives with a buffer: the second kind of job, besides plans.
//!
//! The caller writes points in SI to a ring. The lane keeps the drive's buffer filled, neither empty nor
//! overfull. The time of each point gives its end; the drive's status corrects this, so a difference of the
//! clocks does no harm.

pub mod cyclic;

use core::time::Duration;

use crate::profile::ParameterId;
use crate::time::Instant;

/// Points that wait in a lane at most.
pub const POINTS_MAX: usize = 512;

/// A point of a path.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Point {
    /// Position: rad or m.
    pub position: f64,
    /// Velocity at this point: rad/s or m/s. Not used where the drive interpolates positions alone.
    pub velocity: f64,
    /// Time since the point before, s.
    pub time: f64,
}

/// Interpolation of a drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PathKind {
    /// Position, velocity and time.
    Pvt,
    /// Position and time.
    Pt,
}

/// A point as the drive counts.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct RawPoint {
    /// From the point before.
    pub distance: i64,
    /// Speed in the counts of its parameter.
    pub velocity: i64,
    /// Time since the point before.
    pub time: i64,
    /// Number of the point, from 0.
    pub number: u32,
}

/// A request that a path needs.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum PathStep {
    /// Preparation of a path: buffer cleared, `few` points count as few, points
    /// counted from the end of the one before.
    Prepare {
        /// Number of the preparation, from 0.
        number: u8,
        /// Kind of interpolation.
        kind: PathKind,
        /// Points in the buffer that the drive is to report as few.
        low_mark: u8,
    },
    /// A point into the buffer.
    Point(PathKind, RawPoint),
    /// Off it goes.
    Start,
    /// Come to rest.
    Stop,
}

/// Parameters that a path needs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PathParameters {
    /// Positions have its scale; the path begins where it is.
    pub position: ParameterId,
    /// Velocities have its scale.
    pub velocity: ParameterId,
    /// Times have its scale.
    pub time: ParameterId,
    /// The buffer's status.
    pub status: ParameterId,
    /// Number of points that the buffer holds.
    pub capacity: ParameterId,
}

/// Status of a drive's buffer.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct PathStatus {
    /// No point is left.
    pub empty: bool,
    /// The number of points left is at or below the configured level.
    pub low: bool,
    /// No further point fits.
    pub full: bool,
    /// A point arrived out of order and was refused.
    pub lost: bool,
    /// True if the drive ran out of points while moving, and stopped.
    pub underrun: bool,
    /// Points taken, modulo `counters`.
    pub counter: u32,
    /// The counter's modulus; zero where there is none.
    pub counter_modulus: u32,
}

impl PathStatus {
    /// The drive's counter less `count`.
    #[must_use]
    pub const fn offset(&self, count: u32) -> u32 {
        match count.checked_rem(self.counter_modulus) {
            Some(ours) => (self.counter + self.counter_modulus - ours) % self.counter_modulus,
            None => 0,
        }
    }
}

/// The drive's buffer as the host sees it: points sent, and when each is used up.
#[derive(Clone, Debug)]
pub struct BufferModel {
    /// When each of the last points ends, ns from the start, by its number modulo the size.
    end_times: [u64; WINDOW],
    sent: u32,
    capacity: u32,
    low_mark: u32,
    /// When the path began by the drive's clock, as far as is known.
    started_at: Option<Instant>,
}

/// Points whose ends are remembered: more than any drive's buffer holds.
const WINDOW: usize = 512;

impl BufferModel {
    /// Creates an empty buffer with room for `wanted` points, of which `low_mark` count as few.
    #[must_use]
    pub const fn new(wanted: u32, low_mark: u32) -> Self {
        let capacity = if wanted as usize >= WINDOW { WINDOW as u32 - 1 } else { wanted };
        Self { end_times: [0; WINDOW], sent: 0, capacity, low_mark, started_at: None }
    }

    /// Points sent so far.
    #[must_use]
    pub const fn sent(&self) -> u32 {
        self.sent
    }

    /// A point with this duration was sent.
    pub const fn record_sent(&mut self, time_ns: u64) {
        let end = self.end_of(self.sent) + time_ns;
        self.sent += 1;
        self.end_times[self.sent as usize % WINDOW] = end;
    }

    /// The path begins now.
    pub const fn start(&mut self, now: Instant) {
        self.started_at = Some(now);
    }

    /// When the first `count` points are used up, ns from the start.
    const fn end_of(&self, count: u32) -> u64 {
        if count == 0 { 0 } else { self.end_times[count as usize % WINDOW] }
    }

    /// When the next point may be sent: one place stays free, because clocks differ.
    #[must_use]
    pub fn next_send_at(&self) -> Instant {
        let max = self.capacity.saturating_sub(1).max(1);
        match (self.started_at, self.sent.checked_sub(max)) {
            // A point leaves the buffer when the one before it is used up.
            (Some(started_at), Some(used)) => started_at.plus_ns(self.end_of(used)),
            (None, Some(_)) => Instant::FAR_FUTURE,
            (_, None) => Instant::ZERO,
        }
    }

    /// True while the buffer holds as much as it should before the path begins.
    #[must_use]
    pub const fn is_filled(&self) -> bool {
        self.sent + 1 >= self.capacity
    }

    /// Time at which all points that were sent are used up.
    #[must_use]
    pub fn ends_at(&self) -> Instant {
        self.started_at
            .map_or(Instant::FAR_FUTURE, |started_at| started_at.plus_ns(self.end_of(self.sent)))
    }

    /// Corrects the clock by the drive's buffer status at `now`: more points than computed mean that its
    /// clock is slow, fewer that it is fast.
    pub fn correct_clock(&mut self, now: Instant, status: &PathStatus) {
        let Some(started_at) = self.started_at else { return };
        let late = match (status.full, status.low) {
            (true, _) => time_behind(self.buffer_left_at(self.capacity - 1, started_at), now),
            (_, false) => time_behind(self.buffer_left_at(self.low_mark, started_at), now),
            _ => None,
        };
        let early = if status.low {
            time_ahead(self.buffer_left_at(self.low_mark, started_at), now)
        } else {
            None
        };
        self.started_at = Some(match (late, early) {
            (Some(late), _) => started_at + late,
            (_, Some(early)) => Instant(started_at.0.saturating_sub(early.as_nanos() as u64)),
            _ => started_at,
        });
    }

    fn buffer_left_at(&self, held: u32, started_at: Instant) -> Option<Instant> {
        // The first point leaves at once. With `held` in the buffer, `sent - held` have left.
        self.sent.checked_sub(held + 1).map(|used| started_at.plus_ns(self.end_of(used)))
    }
}

fn time_ahead(at: Option<Instant>, now: Instant) -> Option<Duration> {
    at.filter(|at| now < *at).map(|at| at.since(now))
}

fn time_behind(at: Option<Instant>, now: Instant) -> Option<Duration> {
    at.filter(|at| now > *at).map(|at| now.since(at))
}

#[cfg(test)]
mod tests {
    use super::{BufferModel, PathStatus};
    use crate::time::Instant;

    const STATUS: PathStatus = PathStatus {
        empty: false,
        low: false,
        full: false,
        lost: false,
        underrun: false,
        counter: 0,
        counter_modulus: 128,
    };
    const MS: u64 = 1_000_000;

    fn filled_buffer() -> BufferModel {
        let mut buffer = BufferModel::new(7, 3);
        while !buffer.is_filled() {
            buffer.record_sent(20 * MS);
        }
        buffer
    }

    #[test]
    fn a_place_is_free_when_its_point_has_left() {
        let mut buffer = filled_buffer();
        assert_eq!((buffer.sent(), buffer.next_send_at()), (6, Instant::FAR_FUTURE));
        buffer.start(Instant(MS));
        assert_eq!(buffer.next_send_at(), Instant(MS), "the first point leaves at once");
        buffer.record_sent(20 * MS);
        assert_eq!(buffer.next_send_at(), Instant(21 * MS));
        assert_eq!(buffer.ends_at(), Instant(141 * MS));
    }

    #[test]
    fn the_drives_report_sets_the_clock() {
        let mut buffer = filled_buffer();
        buffer.start(Instant(1000 * MS));
        buffer.record_sent(20 * MS);
        // Full: all seven are there, so the first has not left yet.
        buffer.correct_clock(Instant(1005 * MS), &PathStatus { full: true, ..STATUS });
        assert_eq!(buffer.next_send_at(), Instant(1025 * MS));
        // Few left: four have gone, three segments are over.
        buffer.correct_clock(Instant(1030 * MS), &PathStatus { low: true, ..STATUS });
        assert_eq!(buffer.next_send_at(), Instant(990 * MS));
        // Not few, long after that: fewer have gone than was thought.
        buffer.correct_clock(Instant(1090 * MS), &STATUS);
        assert_eq!(buffer.next_send_at(), Instant(1050 * MS));
    }
}
