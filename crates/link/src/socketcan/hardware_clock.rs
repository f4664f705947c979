//! Arrival time by the clock of the CAN controller, if it has one. It is free of interrupt latency, but has
//! its own origin and a drift.

use std::time::Duration;

/// The kernel never stamps before the hardware. The least lag seen is therefore the nearest to
/// the true offset of the clocks; it is forgotten this fast, so that drift is followed
/// (100 ppm, twice what crystals have).
const DRIFT_PPM: u64 = 100;
/// A lag that is further off means that one of the clocks was set.
const CLOCK_STEP: Duration = Duration::from_millis(100);

/// Relates a controller's clock to the kernel's.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HardwareClock {
    /// Kernel's less hardware's time, and when that was learnt, both wrapping nanoseconds.
    offset: Option<(u64, u64)>,
}

impl HardwareClock {
    /// The kernel's time at which the hardware saw the frame that it stamped with `hardware_ns`, and the
    /// kernel later with `kernel_ns`.
    pub(super) fn kernel_time(&mut self, hardware_ns: u64, kernel_ns: u64) -> u64 {
        let lag = kernel_ns.wrapping_sub(hardware_ns);
        let step = CLOCK_STEP.as_nanos() as u64;
        let offset = match self.offset {
            None => lag,
            Some((min, since)) => {
                let passed = hardware_ns.wrapping_sub(since);
                let forgotten = passed.saturating_mul(DRIFT_PPM) / 1_000_000;
                let expected = min.wrapping_add(forgotten.min(step));
                // As a signed number: earlier than expected, or far off.
                let late = lag.wrapping_sub(expected);
                if late > step { lag } else { expected }
            }
        };
        self.offset = Some((offset, hardware_ns));
        hardware_ns.wrapping_add(offset).min(kernel_ns)
    }
}
