//! The only place that reads the clock.

use std::sync::OnceLock;
use std::time::{Duration, SystemTime};

use polepair_core::time::Instant;

/// A stamp older than this is not believed.
#[cfg(target_os = "linux")]
const STAMP_AGE_MAX_NS: u64 = 10_000_000_000;

/// Nanoseconds of the monotonic clock since this process first asked. A stepped wall clock does
/// not move it.
#[must_use]
pub fn now() -> Instant {
    to_instant(origin().monotonic.elapsed())
}

/// Wall time of `at` as nanoseconds since 1970, by the offset taken once when the process first
/// asked: traces stay in order though somebody sets the clock meanwhile.
#[must_use]
pub fn wall_ns(at: Instant) -> u64 {
    origin().wall_ns.saturating_add(at.0)
}

/// The instant of a wall time that the kernel has just stamped. Somebody may have set the clock
/// since: what does not look fresh counts as of now.
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

/// Where the monotonic and the wall clock stood together.
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
