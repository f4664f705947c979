//! Cyclic set-points for many axes: orders, the limits of each set-point, and statistics of the timing.

use core::time::Duration;

use crate::station::AxisIndex;

/// Axes that follow one beat at most.
pub const AXES_MAX: usize = 127;
/// Cycles that wait in a lane at most.
pub const CYCLES_MAX: usize = 512;
/// Largest planned load of the wire, in percent. The rest is for other requests and for repeated frames.
pub const LOAD_MAX_PERCENT: u64 = 80;
/// Greatest distance of the start position from the axis at standstill: rad or m.
const START_OFFSET_MAX: f64 = 0.01;

/// Quantity commanded cycle by cycle.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum SetpointKind {
    /// Position: rad or m.
    Position,
    /// Velocity: rad/s or m/s.
    Velocity,
    /// Torque: N·m, or the value used for it.
    Torque,
}

/// Data sent with a set-point.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SetpointCommand {
    /// Obey it.
    Follow,
    /// Come to rest as quickly as the drive can.
    Stop,
}

/// Several axes that follow one beat.
#[derive(Clone, Copy, Debug)]
pub struct CyclicConfig<'a> {
    /// Axes, each once; set-points come in this order.
    pub axes: &'a [AxisIndex],
    /// Bounds of each set-point, in the same order; none for those without bounds here.
    pub bounds: &'a [SetpointBounds],
    /// The commanded quantity.
    pub setpoint: SetpointKind,
    /// From one beat to the next.
    pub period: Duration,
    /// Factor of the time that a drive may be silent, or the host may pause; 1 outside tests.
    pub timeout_scale: u32,
}

/// Bounds of an axis' set-points, in SI. None is unlimited.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct SetpointBounds {
    /// Least and greatest position.
    pub position: Option<(f64, f64)>,
    /// Speed at most.
    pub velocity: Option<f64>,
    /// Gain or loss of speed at most.
    pub acceleration: Option<f64>,
    /// Torque at most.
    pub torque: Option<f64>,
}

impl SetpointBounds {
    /// Largest distance between an axis at rest and the start of its path, rad or m: at most the distance of
    /// one cycle of `period` seconds, and never a visible one. A drive covers it within that cycle.
    #[must_use]
    pub fn max_start_offset(&self, period: f64) -> f64 {
        self.velocity.map_or(START_OFFSET_MAX, |max| (max * period).min(START_OFFSET_MAX))
    }
}

/// The bound that a set-point exceeds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum BoundsViolation {
    /// The value is not a number.
    NotANumber,
    /// The position limits.
    Position,
    /// The speed.
    Velocity,
    /// The acceleration.
    Acceleration,
    /// The torque.
    Torque,
}

impl BoundsViolation {
    /// The remedy.
    #[must_use]
    pub const fn hint(self) -> &'static str {
        match self {
            Self::NotANumber => "a set-point is not a number",
            Self::Position => "a set-point lies beyond the drive's position limits",
            Self::Velocity => {
                "the way from one set-point to the next is faster than the drive may be: give it \
                 more time, or smaller steps"
            }
            Self::Acceleration => {
                "the speed changes more from one cycle to the next than the drive can do: begin and \
                 end at rest, and smooth the path"
            }
            Self::Torque => "a set-point is more than the drive's greatest torque",
        }
    }
}

/// Last set-points of one axis, by which the next one is checked.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct SetpointTracker {
    /// The last one.
    pub last: f64,
    /// Speed of a position, from the one before.
    speed: f64,
}

impl SetpointTracker {
    /// At rest at that set-point.
    #[must_use]
    pub const fn at_rest(last: f64) -> Self {
        Self { last, speed: 0.0 }
    }

    /// Takes the next set-point, `period` seconds behind the last.
    ///
    /// # Errors
    /// [`BoundsViolation`], and nothing is taken.
    pub fn accept(
        &mut self,
        bounds: &SetpointBounds,
        setpoint: SetpointKind,
        next: f64,
        period: f64,
    ) -> Result<(), BoundsViolation> {
        debug_assert!(period > 0.0);
        let rate = (next - self.last) / period;
        if !rate.is_finite() {
            return Err(BoundsViolation::NotANumber);
        }
        match setpoint {
            SetpointKind::Position
                if bounds.position.is_some_and(|(min, max)| !(min..=max).contains(&next)) =>
            {
                Err(BoundsViolation::Position)
            }
            SetpointKind::Position if is_beyond(rate, bounds.velocity) => {
                Err(BoundsViolation::Velocity)
            }
            SetpointKind::Position
                if is_beyond((rate - self.speed) / period, bounds.acceleration) =>
            {
                Err(BoundsViolation::Acceleration)
            }
            SetpointKind::Velocity if is_beyond(next, bounds.velocity) => {
                Err(BoundsViolation::Velocity)
            }
            SetpointKind::Velocity if is_beyond(rate, bounds.acceleration) => {
                Err(BoundsViolation::Acceleration)
            }
            SetpointKind::Torque if is_beyond(next, bounds.torque) => Err(BoundsViolation::Torque),
            _ => {
                *self = Self { last: next, speed: rate };
                Ok(())
            }
        }
    }

    /// Returns whether a motion may end here: the commanded speed or torque is zero. A position always may.
    #[must_use]
    pub fn may_end(&self, setpoint: SetpointKind) -> bool {
        // A held position is rest; a speed or torque that is not zero would go on after the last cycle.
        setpoint == SetpointKind::Position || self.last == 0.0
    }
}

fn is_beyond(value: f64, max: Option<f64>) -> bool {
    max.is_some_and(|max| value.abs() > max)
}

/// Timing and following error of a cyclic motion.
#[derive(Clone, Debug)]
pub struct CycleStatistics {
    /// Beats that went out.
    pub syncs: u64,
    /// Set-points of the motion that went out, for each axis.
    pub cycles: u64,
    /// Beats that were left out because the host was late; the motion took longer by these.
    pub missed_cycles: u64,
    /// Number of times a drive had not reported its state before the next beat.
    pub late_reports: u64,
    /// The greatest distance of a drive from the set-point before, SI.
    pub max_following_error: f64,
    /// Lateness of beats.
    pub lateness: DurationHistogram,
}

impl CycleStatistics {
    /// Nothing happened yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            syncs: 0,
            cycles: 0,
            missed_cycles: 0,
            late_reports: 0,
            max_following_error: 0.0,
            lateness: DurationHistogram::new(),
        }
    }
}

impl Default for CycleStatistics {
    fn default() -> Self {
        Self::new()
    }
}

/// Times, counted by size: eight classes to each doubling.
#[derive(Clone, Debug)]
pub struct DurationHistogram {
    min_ns: u64,
    max_ns: u64,
    count: u64,
    buckets: [u32; BUCKETS],
}

/// Classes of a doubling, as a power of two.
const SUB_BUCKET_BITS: u32 = 3;
/// Up to 2^40 ns, eighteen minutes.
const BUCKETS: usize = 40 << SUB_BUCKET_BITS;

impl Default for DurationHistogram {
    fn default() -> Self {
        Self::new()
    }
}

impl DurationHistogram {
    /// None yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { min_ns: u64::MAX, max_ns: 0, count: 0, buckets: [0; BUCKETS] }
    }

    /// Notes one.
    pub fn record(&mut self, ns: u64) {
        self.min_ns = self.min_ns.min(ns);
        self.max_ns = self.max_ns.max(ns);
        debug_assert!(self.min_ns <= self.max_ns);
        self.count += 1;
        let class = &mut self.buckets[Self::bucket_of(ns)];
        *class = class.saturating_add(1);
    }

    const fn bucket_of(ns: u64) -> usize {
        let above = if ns == 0 { 0 } else { ns.ilog2() };
        let class = if above < SUB_BUCKET_BITS {
            ns as usize
        } else {
            let fine = ns >> (above - SUB_BUCKET_BITS) & ((1 << SUB_BUCKET_BITS) - 1);
            (((above - SUB_BUCKET_BITS + 1) << SUB_BUCKET_BITS) as u64 + fine) as usize
        };
        if class < BUCKETS { class } else { BUCKETS - 1 }
    }

    /// Least, middle and greatest; `None` before the first. The middle one is known to an eighth.
    #[must_use]
    pub fn summary(&self) -> Option<(Duration, Duration, Duration)> {
        // The middle one of an odd number, the lower of two middle ones otherwise.
        let mut left = self.count.div_ceil(2);
        let middle = self.buckets.iter().position(|class| {
            left = left.saturating_sub((*class).into());
            left == 0
        });
        let middle = Self::bucket_floor(middle.filter(|_| self.count > 0)?);
        let middle = middle.clamp(self.min_ns, self.max_ns);
        let [min, middle, max] = [self.min_ns, middle, self.max_ns].map(Duration::from_nanos);
        Some((min, middle, max))
    }

    const fn bucket_floor(class: usize) -> u64 {
        let (above, fine) = (class >> SUB_BUCKET_BITS, class as u64 & ((1 << SUB_BUCKET_BITS) - 1));
        if above == 0 { fine } else { ((1 << SUB_BUCKET_BITS) + fine) << (above - 1) }
    }
}

#[cfg(test)]
mod tests;
