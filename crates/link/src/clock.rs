//! The clock. Only this module reads the time and scales time-outs.

use std::sync::OnceLock;
use std::time::{Duration, SystemTime};

use polepair_core::convert::saturating;
use polepair_core::time::Instant;

/// A stamp older than this is not believed.
#[cfg(target_os = "linux")]
const STAMP_AGE_MAX_NS: u64 = 10_000_000_000;

/// Nanoseconds of the monotonic clock since the first call in this process. Steps of the wall clock do
/// not change it.
#[must_use]
pub fn now() -> Instant {
    to_instant(origin().monotonic.elapsed())
}

/// Wall time of `at` as nanoseconds since 1970. The offset is read once, at the first call, so traces
/// stay in order when the wall clock is set.
#[must_use]
pub fn wall_ns(at: Instant) -> u64 {
    origin().wall_ns.saturating_add(at.0)
}

/// The instant of a kernel time stamp. The wall clock may have been set since: a stamp that is not recent counts as
/// now.
#[cfg(target_os = "linux")]
pub(crate) fn instant_of_stamp(wall_ns: u64) -> Instant {
    let wall = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let age = to_instant(wall).0.saturating_sub(wall_ns);
    let now = now();
    if age > STAMP_AGE_MAX_NS { now } else { Instant(now.0.saturating_sub(age)) }
}

/// Sleeps until `at`; returns at once when it has passed.
pub fn sleep_until(at: Instant) {
    std::thread::sleep(at.since(now()));
}

/// The factor on all time-outs: 1, unless `POLEPAIR_TIMEOUT_SCALE` has another whole number up to 100.
///
/// For tests only: on a busy machine a process may be paused for longer than a reply may take. The
/// variable is read once. The factor applies to times after which something counts as failed (replies,
/// leases, silence, standstill; the `timeout` of a connection string too), not to durations or periods.
#[must_use]
pub fn timeout_scale() -> u32 {
    static TIMEOUT_SCALE: OnceLock<u32> = OnceLock::new();
    *TIMEOUT_SCALE.get_or_init(|| {
        let given = std::env::var(TIMEOUT_SCALE_VARIABLE).ok();
        let scale = given.and_then(|text| text.parse().ok()).unwrap_or(1);
        if (1..=TIMEOUT_SCALE_MAX).contains(&scale) { scale } else { 1 }
    })
}

/// A time-out, scaled. Beyond thirty seconds it does not grow: that is long enough for any machine.
#[must_use]
pub fn scale_timeout(timeout: Duration) -> Duration {
    (timeout * timeout_scale()).min(SCALED_TIMEOUT_MAX).max(timeout)
}

/// [`scale_timeout`] in milliseconds.
#[must_use]
pub fn scaled_ms(timeout_ms: u32) -> u32 {
    let scaled = scale_timeout(Duration::from_millis(timeout_ms.into()));
    saturating(scaled.as_millis())
}

/// The environment variable that scales time-outs.
pub const TIMEOUT_SCALE_VARIABLE: &str = "POLEPAIR_TIMEOUT_SCALE";
const TIMEOUT_SCALE_MAX: u32 = 100;
const SCALED_TIMEOUT_MAX: Duration = Duration::from_secs(30);

/// One moment on the monotonic and on the wall clock.
struct ClockOrigin {
    monotonic: std::time::Instant,
    wall_ns: u64,
}

fn origin() -> &'static ClockOrigin {
    static ORIGIN: OnceLock<ClockOrigin> = OnceLock::new();
    ORIGIN.get_or_init(|| {
        let wall = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        ClockOrigin {
            monotonic: std::time::Instant::now(),
            wall_ns: to_instant(wall.unwrap_or_default()).0,
        }
    })
}

fn to_instant(span: Duration) -> Instant {
    Instant::ZERO + span
}
