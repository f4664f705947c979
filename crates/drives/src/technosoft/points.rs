//! PVT and PT: points from a host, and the path through them.
//!
//! Sources: TML communication manual, chapter 5, example 3; PVTSTS and the buffer's size from the CANopen
//! manual of the same drives, where object 2072h is PVTSTS. \[I\] SETPVT has the format of object 2074h
//! there: bit 15 clears buffer and counter, bit 14 disables the check of the counter, bit 13 sets it to
//! bits 6 to 0, bit 7 sets the threshold of a low buffer to bits 11 to 8.

use super::addresses;
use super::drive::Drive;
use super::execute::ExecuteError;
use super::motion::MotionMode;
use polepair_core::plant::{Setpoint, TICK_S};
use polepair_core::proto::tml::online::{PtPoint, PvtPoint};

/// Points that fit at most, when the buffer is made as long as it can be: PT; of PVT 222.
const POINTS_MAX: usize = 285;
/// Points of PVT that fit at most.
const PVT_POINTS_MAX: u16 = 222;
/// Points that count as few. \[I\]
const LOW_POINTS: u8 = 4;

mod sts {
    pub const QUICK_STOP: u16 = 1 << 11;
    pub const COUNTER_ERROR: u16 = 1 << 12;
    pub const FULL: u16 = 1 << 13;
    pub const LOW: u16 = 1 << 14;
    pub const EMPTY: u16 = 1 << 15;
}

#[derive(Clone, Copy, PartialEq, Debug)]
struct PathPoint {
    position: i32,
    /// Counts a slow loop period; `None` for a PT point.
    velocity: Option<f32>,
    time: u16,
}

/// The buffer and the segment under way.
#[derive(Clone, Debug)]
pub(super) struct PathBuffer {
    buffer: [PathPoint; POINTS_MAX],
    first: usize,
    len: usize,
    low_threshold: u8,
    /// Counter that the next point must have.
    counter: u8,
    checked: bool,
    /// Bits 12 and 11 of PVTSTS.
    error_bits: u16,
    running: bool,
    linear: bool,
    absolute: bool,
    /// End of the last segment, whole counts of the shaft.
    end: i64,
    segment: Option<PathSegment>,
}

/// A cubic from one point to the next, rad and s.
#[derive(Clone, Copy, Debug)]
struct PathSegment {
    from: f64,
    velocity: f64,
    quadratic: f64,
    cubic: f64,
    duration: f64,
    elapsed: f64,
    ends_at_rest: bool,
}

impl PathSegment {
    fn new(from: Setpoint, to: f64, end_velocity: f64, duration: f64) -> Self {
        let mean = (to - from.position) / duration;
        Self {
            from: from.position,
            velocity: from.velocity,
            quadratic: (3.0 * mean - 2.0 * from.velocity - end_velocity) / duration,
            cubic: (from.velocity + end_velocity - 2.0 * mean) / (duration * duration),
            duration,
            elapsed: 0.0,
            ends_at_rest: end_velocity == 0.0,
        }
    }

    fn linear(from: Setpoint, to: f64, span: f64) -> Self {
        let velocity = (to - from.position) / span;
        let from = Setpoint { velocity, ..from };
        Self {
            ends_at_rest: true,
            quadratic: 0.0,
            cubic: 0.0,
            ..Self::new(from, to, velocity, span)
        }
    }

    fn setpoint(&self, at: f64) -> Setpoint {
        let Self { from, velocity, quadratic, cubic, .. } = *self;
        Setpoint {
            position: from + at * (velocity + at * (quadratic + at * cubic)),
            velocity: velocity + at * (2.0 * quadratic + at * 3.0 * cubic),
            acceleration: 2.0 * quadratic + 6.0 * cubic * at,
        }
    }
}

impl PathBuffer {
    /// Nothing sent yet.
    pub const EMPTY: Self = Self {
        buffer: [PathPoint { position: 0, velocity: None, time: 0 }; POINTS_MAX],
        first: 0,
        len: 0,
        low_threshold: LOW_POINTS,
        counter: 0,
        checked: true,
        error_bits: 0,
        running: false,
        linear: false,
        absolute: false,
        end: 0,
        segment: None,
    };

    fn push(&mut self, point: PathPoint) {
        debug_assert!(self.len < POINTS_MAX, "a point is taken only where there is room");
        self.buffer[(self.first + self.len) % POINTS_MAX] = point;
        self.len += 1;
    }

    fn pop(&mut self) -> Option<PathPoint> {
        if self.len == 0 {
            return None;
        }
        let point = self.buffer[self.first];
        self.first = (self.first + 1) % POINTS_MAX;
        self.len -= 1;
        Some(point)
    }

    /// Returns whether points were sent or a path was started.
    pub const fn is_used(&self) -> bool {
        self.running || self.len > 0 || self.error_bits != 0
    }

    /// PVTSTS for a buffer of `room` points.
    fn status(&self, capacity: usize) -> u16 {
        bit_if(self.len == 0, sts::EMPTY)
            | bit_if(self.len <= usize::from(self.low_threshold), sts::LOW)
            | bit_if(self.len >= capacity, sts::FULL)
            | self.error_bits
            | u16::from(self.counter)
    }

    /// Ticks until the segment under way ends.
    pub fn ticks_left(&self) -> Option<u64> {
        let segment = self.segment.as_ref()?;
        Some(libm::ceil((segment.duration - segment.elapsed) / TICK_S).max(1.0) as u64)
    }
}

fn bit_if(on: bool, bit: u16) -> u16 {
    if on { bit } else { 0 }
}

impl Drive {
    /// PVTP: a point with position, velocity and time.
    pub fn accept_pvt(&mut self, point: &PvtPoint) -> Result<(), ExecuteError> {
        let velocity = Some((f64::from(point.velocity) / 65536.0) as f32);
        let PvtPoint { position, time, counter, .. } = *point;
        self.accept_point(PathPoint { position, velocity, time }, counter)
    }

    /// PTP: a point with position and time.
    pub fn accept_pt(&mut self, point: &PtPoint) -> Result<(), ExecuteError> {
        let PtPoint { position, time, counter } = *point;
        self.accept_point(PathPoint { position, velocity: None, time }, counter)
    }

    /// SETPVT, SETPT.
    pub fn configure_points(&mut self, value: u16) {
        let points = &mut self.points;
        if value & 0x8000 != 0 {
            (points.first, points.len, points.counter, points.error_bits) = (0, 0, 0, 0);
        }
        points.checked = value & 0x4000 == 0;
        if value & 0x2000 != 0 {
            points.counter = (value & 0x7F) as u8;
        }
        if value & 0x0080 != 0 {
            points.low_threshold = (value >> 8 & 0xF) as u8;
        }
        self.memory.set(addresses::PVTMODE, value);
        self.mark_stale();
    }

    /// Value of PVTSTS.
    pub fn points_status(&self) -> u16 {
        self.points.status(self.points_capacity())
    }

    /// When the next point will be taken from the buffer, ticks from now.
    pub fn ticks_to_next_point(&self) -> Option<u64> {
        (self.motion.mode == MotionMode::Points).then(|| self.points.ticks_left()).flatten()
    }

    /// UPD in mode PVT or PT: the path starts where the reference is.
    pub fn begin_points(&mut self, linear: bool, absolute: bool) {
        let start = self.shaft.servo.setpoint();
        let points = &mut self.points;
        (points.linear, points.absolute, points.running) = (linear, absolute, true);
        // A new path may begin after one that ran out of points.
        points.error_bits &= !sts::QUICK_STOP;
        points.end = self.shaft.whole_counts(start.position);
        points.segment = None;
        self.memory.set_long(addresses::PVTPOS0, self.shaft.target());
        // A relative path that is begun twice ends twice as far.
        self.unrepeatable += u64::from(!absolute);
    }

    /// A tick of the path. Out of points it holds where the last one rests; if that one does not
    /// rest, it stops quickly.
    pub fn tick_points(&mut self) {
        let mut at = match &mut self.points.segment {
            Some(segment) => {
                segment.elapsed += TICK_S;
                segment.elapsed
            }
            None if self.points.len == 0 => return self.complete_motion(),
            None => TICK_S,
        };
        // Segments may be shorter than a tick: what is left of the tick belongs to the next one.
        while self.points.segment.is_none_or(|segment| at > segment.duration + 1e-9) {
            at -= self.points.segment.map_or(0.0, |segment| segment.duration);
            if !self.next_segment(at) {
                return self.handle_underrun();
            }
        }
        if let Some(segment) = &self.points.segment {
            self.shaft.servo.follow(segment.setpoint(at));
        }
    }

    fn accept_point(&mut self, point: PathPoint, counter: u8) -> Result<(), ExecuteError> {
        let capacity = self.points_capacity();
        self.mark_stale();
        let points = &mut self.points;
        // The counter is all that shows a lost point; a wrong one is refused and leaves the counter where it
        // was.
        if points.checked && counter != points.counter {
            points.error_bits |= sts::COUNTER_ERROR;
            return Ok(());
        }
        if point.time == 0 {
            return Err(ExecuteError::NotPossible);
        }
        if points.len >= capacity {
            return Ok(()); // the counter stands still: the host sees that it was not taken
        }
        points.error_bits &= !sts::COUNTER_ERROR;
        points.counter = counter.wrapping_add(1) & PvtPoint::COUNTER_MAX;
        points.push(point);
        // A path that had come to its end goes on when a point arrives.
        if points.running && points.segment.is_none() && self.motion.mode == MotionMode::Points {
            self.note_motion_begun();
        }
        Ok(())
    }

    /// Points that fit: PVTBUFLEN, 7 of PVT or 9 of PT from the factory.
    fn points_capacity(&self) -> usize {
        let set = self.memory.word(addresses::PVTBUFLEN);
        let capacity = if !self.points.linear {
            set.min(PVT_POINTS_MAX)
        } else if set == 7 {
            9
        } else {
            set.min(POINTS_MAX as u16)
        };
        usize::from(capacity.max(1))
    }

    /// Takes the next point; the segment to it is `done` s old already.
    fn next_segment(&mut self, done: f64) -> bool {
        let Some(point) = self.points.pop() else { return false };
        let from = match &self.points.segment {
            Some(segment) => segment.setpoint(segment.duration),
            None => self.shaft.servo.setpoint(),
        };
        let by = if self.points.absolute {
            i64::from(point.position.wrapping_sub(self.shaft.count_of(self.points.end)))
        } else {
            point.position.into()
        };
        self.points.end += by;
        let (scale, end) = (&self.shaft.scale, self.points.end);
        // The middle of a count, so that the axis rests where its counter does not flicker.
        let to = (end as f64 + 0.5) / scale.per_rad;
        let span = f64::from(point.time) * scale.slow_s;
        let segment = match point.velocity {
            Some(velocity) => {
                PathSegment::new(from, to, scale.speed_of_counts(velocity.into()), span)
            }
            None => PathSegment::linear(from, to, span),
        };
        debug_assert!(span > 0.0, "a point without time is refused");
        self.points.segment = Some(PathSegment { elapsed: done, ..segment });
        true
    }

    /// The last segment is over and there is no point.
    fn handle_underrun(&mut self) {
        let Some(last) = self.points.segment.take() else { return };
        let end = last.setpoint(last.duration);
        if last.ends_at_rest {
            self.shaft.servo.follow(Setpoint { velocity: 0.0, acceleration: 0.0, ..end });
            self.complete_motion();
        } else {
            self.shaft.servo.follow(end);
            self.points.error_bits |= sts::QUICK_STOP;
            self.points.running = false;
            self.quick_stop();
        }
    }
}
