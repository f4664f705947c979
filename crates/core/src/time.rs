//! Monotonic time as a number, provided by the owner of a clock.

use core::ops::{Add, Sub};
use core::time::Duration;

/// A point in time of one link: nanoseconds since an origin that the link chose.
///
/// The time is monotonic and independent of wall time. The core never reads a clock: every `handle_*` and `poll_*`
/// takes the present `Instant` as an argument, so the same code runs in real and in virtual time.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub struct Instant(pub u64);

impl Instant {
    /// The origin of the link's time.
    pub const ZERO: Self = Self(0);
    /// Later than every instant that a link reports.
    pub const FAR_FUTURE: Self = Self(u64::MAX);

    /// Time since `earlier`, zero when `earlier` is later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }

    /// Adds nanoseconds, saturating.
    #[must_use]
    pub const fn plus_ns(self, ns: u64) -> Self {
        Self(self.0.saturating_add(ns))
    }

    /// Adds milliseconds, saturating.
    #[must_use]
    pub const fn plus_ms(self, ms: u32) -> Self {
        self.plus_ns(ms as u64 * 1_000_000)
    }
}

impl Add<Duration> for Instant {
    type Output = Self;
    fn add(self, span: Duration) -> Self {
        self.plus_ns(u64::try_from(span.as_nanos()).unwrap_or(u64::MAX))
    }
}

impl Sub for Instant {
    type Output = Duration;
    fn sub(self, earlier: Self) -> Duration {
        self.since(earlier)
    }
}

/// The earlier of two optional deadlines.
#[must_use]
pub fn earliest(a: Option<Instant>, b: Option<Instant>) -> Option<Instant> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    }
}
