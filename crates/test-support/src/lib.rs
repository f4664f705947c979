//! Helpers of tests: programs in C, and waits. Tests wait for a condition, never for a duration. A wait
//! that fails prints its condition, the last observation, and how busy the machine was.
#![forbid(unsafe_code)]

pub mod c_program;

use std::time::{Duration, Instant};

/// Longer than anything takes that works, on a busy machine too.
pub const WAIT_MAX: Duration = Duration::from_secs(120);
/// Between two looks at a condition.
const CHECK_INTERVAL: Duration = Duration::from_millis(5);

/// Waits until something is so.
///
/// # Panics
/// After [`WAIT_MAX`].
pub fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    wait_for(what, || is_so().then_some(()).ok_or_else(|| "it is not so".to_owned()));
}

/// Waits until `check` has a result; until then its error is what was seen instead.
///
/// # Panics
/// After [`WAIT_MAX`].
pub fn wait_for<T>(what: &str, mut check: impl FnMut() -> Result<T, String>) -> T {
    let deadline = Deadline::new(what);
    loop {
        match check() {
            Ok(result) => return result,
            Err(seen) => deadline.check(|| seen),
        }
        std::thread::sleep(CHECK_INTERVAL);
    }
}

/// The end of a wait that reads what comes by itself.
#[derive(Debug)]
pub struct Deadline<'a> {
    what: &'a str,
    began: Instant,
}

impl<'a> Deadline<'a> {
    /// Begins to wait for something.
    #[must_use]
    pub fn new(what: &'a str) -> Self {
        Self { what, began: Instant::now() }
    }

    /// Returns whether the wait has lasted too long.
    #[must_use]
    pub fn has_passed(&self) -> bool {
        self.began.elapsed() >= WAIT_MAX
    }

    /// Goes on waiting.
    ///
    /// # Panics
    /// When the wait has lasted too long, with what was seen until then.
    pub fn check(&self, seen: impl FnOnce() -> String) {
        if self.has_passed() {
            self.fail(&seen());
        }
    }

    /// Ends the wait, which cannot succeed any more.
    ///
    /// # Panics
    /// Always.
    pub fn fail(&self, seen: &str) -> ! {
        let (what, waited) = (self.what, self.began.elapsed().as_secs());
        panic!("waited {waited} s for: {what}; seen: {seen}; {}", machine_load());
    }
}

/// Load of the machine, in words.
#[must_use]
pub fn machine_load() -> String {
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    match std::fs::read_to_string("/proc/loadavg") {
        Ok(load) => format!("load {} on {processors} processors", load.trim()),
        Err(_) => format!("{processors} processors, load unknown"),
    }
}
