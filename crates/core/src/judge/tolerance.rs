//! Allowed differences of readings of an axis, and the time for which they have to agree.

use core::time::Duration;

use super::REST_MIN;
use crate::profile::Encoding;

/// Longest rest that is waited for because a commanded speed is slow, or positions are coarse.
const SLOW_REST_MAX: Duration = Duration::from_secs(20);

/// Tolerances of positions and speeds of an axis. All values are in the drive's raw numbers.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Tolerance {
    /// Encoding of the position, whose counter wraps around.
    pub encoding: Encoding,
    /// Greatest distance from the target of an axis that has arrived.
    pub window: f64,
    /// Greatest difference of positions of an axis at standstill.
    pub noise: f64,
    /// Greatest speed that means standstill; `None` if the drive reports no speed.
    pub standstill: Option<f64>,
    /// Standstill speed in counts of the position per second; zero if unknown.
    pub drift: f64,
    /// Commanded speed in counts per second, if it is known.
    pub speed: Option<f64>,
}

impl Tolerance {
    /// The signed distance between two positions. Counters wrap around, floating-point numbers do not.
    #[must_use]
    pub fn distance(&self, from: i64, to: i64) -> f64 {
        let bits = 8 * u32::from(self.encoding.size());
        if self.encoding.is_real() || !(8..64).contains(&bits) {
            return self.encoding.number(to) - self.encoding.number(from);
        }
        let shift = 64 - bits;
        ((to.wrapping_sub(from) << shift) >> shift) as f64
    }

    /// Time between two equal positions that proves standstill.
    pub(super) fn coarse_span(&self, at_least: Duration) -> Duration {
        let seconds = if self.drift > 0.0 { self.noise / self.drift } else { 0.0 };
        at_least.max(span(seconds)).min(SLOW_REST_MAX)
    }

    /// The rest after which a motion at the commanded speed counts as ended.
    pub(super) fn motion_rest(&self) -> Duration {
        match self.speed {
            // The slowest motion passes several times the noise in that time.
            Some(speed) if speed > 0.0 => {
                REST_MIN.max(span(4.0 * self.noise / speed)).min(SLOW_REST_MAX)
            }
            _ => REST_MIN,
        }
    }
}

fn span(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or(SLOW_REST_MAX)
}
