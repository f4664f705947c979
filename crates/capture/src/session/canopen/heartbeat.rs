//! Heartbeats: their period, missing ones, and two devices with one node-ID.

use crate::timestamp::Timestamp;

/// Intervals that are looked at.
const INTERVALS_MAX: usize = 8;
/// Intervals after which the period counts as known.
const KNOWN_MIN: usize = 3;
/// Tolerance of any period, ns: senders with a period of few milliseconds are not that exact.
const SLACK_NS: u64 = 50_000_000;

/// Longer intervals are as good as this, ns: years, by which sums and products stay in range.
pub(super) const LONGEST_NS: u64 = 1 << 56;

/// The heartbeat of one node.
#[derive(Debug, Default)]
pub(super) struct HeartbeatMonitor {
    last: Option<Timestamp>,
    intervals: [u64; INTERVALS_MAX],
    count: usize,
    /// Period by object 1017h, ns.
    configured: Option<u64>,
    /// Tolerance of its consumer, by object 1016h, ns.
    tolerance_ns: u64,
    /// Measured period while it was regular, ns.
    steady_period: Option<u64>,
    /// Period before it was disabled, ns.
    former_period: Option<u64>,
    seen: bool,
    silent: bool,
}

impl HeartbeatMonitor {
    /// The node has one.
    pub const fn is_seen(&self) -> bool {
        self.seen
    }

    /// Time of the last arrival.
    pub const fn last(&self) -> Option<Timestamp> {
        self.last
    }

    /// Sets the configured period in milliseconds; 0 disables it.
    pub fn configure(&mut self, ms: u64) {
        self.suspend();
        self.configured = (ms > 0).then_some(ms * 1_000_000);
    }

    /// Sets the tolerance of its consumer in milliseconds.
    pub const fn set_tolerance(&mut self, ms: u64) {
        self.tolerance_ns = ms * 1_000_000;
    }

    /// Suspends the check until the next heartbeat.
    pub fn suspend(&mut self) {
        let (allowed, former) = (self.tolerance_ns, self.last_period());
        *self = Self {
            tolerance_ns: allowed,
            former_period: former,
            seen: self.seen,
            ..Self::default()
        };
    }

    /// Present period, or that before it was disabled, ns.
    pub fn last_period(&self) -> Option<u64> {
        self.period().or(self.former_period)
    }

    /// Records a heartbeat. True if its absence had been reported.
    pub fn record(&mut self, now: Option<Timestamp>) -> bool {
        self.seen = true;
        let Some(now) = now else { return false };
        let interval = self.last.replace(now).map(|last| now.since(last).min(LONGEST_NS));
        if core::mem::take(&mut self.silent) {
            self.count = 0;
            return true;
        }
        if let Some(interval) = interval {
            self.intervals[self.count % INTERVALS_MAX] = interval;
            self.count += 1;
            self.learn_period();
        }
        false
    }

    fn intervals(&self) -> &[u64] {
        &self.intervals[..self.count.min(INTERVALS_MAX)]
    }

    fn learn_period(&mut self) {
        let middle = self.median();
        if self.count >= 5
            && self.steady_period.is_none()
            && self.intervals().iter().all(|interval| interval.abs_diff(middle) * 5 <= middle)
        {
            self.steady_period = Some(middle);
        }
    }

    /// The interval in the middle.
    fn median(&self) -> u64 {
        let mut sorted = self.intervals;
        let sorted = &mut sorted[..self.count.min(INTERVALS_MAX)];
        sorted.sort_unstable();
        sorted.get(sorted.len() / 2).copied().unwrap_or(0)
    }

    /// Period, ns; `None` while it is unknown.
    fn period(&self) -> Option<u64> {
        let observed = (self.count >= KNOWN_MIN).then(|| self.median());
        self.configured.max(observed)
    }

    /// Time at which it counts as missing.
    pub fn due(&self) -> Option<Timestamp> {
        let (last, period) = (self.last?, self.period()?);
        let patience = (period * 5 / 2).max(period + SLACK_NS).max(self.tolerance_ns);
        (!self.silent).then(|| Timestamp(last.0.saturating_add(patience)))
    }

    /// A missed heartbeat: its period, and the time since the last. Once.
    pub fn check_missed(&mut self, now: Timestamp) -> Option<(u64, u64)> {
        if self.due()? >= now {
            return None;
        }
        self.silent = true;
        Some((self.period()?, now.since(self.last?)))
    }

    /// Two send it, and why that is thought.
    pub fn two_senders(&self) -> Option<&'static str> {
        let whole = self.count >= INTERVALS_MAX;
        if whole && self.is_denser() {
            return Some("its heartbeat comes twice as often as before");
        }
        (whole && self.is_alternating()).then_some("its heartbeat has two beats that take turns")
    }

    /// Each two intervals are what one was.
    fn is_denser(&self) -> bool {
        let Some(period) = self.steady_period.or(self.configured) else { return false };
        (0..INTERVALS_MAX - 1).all(|at| {
            let (one, other) = (self.interval(at), self.interval(at + 1));
            let both = (one + other).abs_diff(period) * 7 <= period;
            both && one.max(other) * 10 < period * 9 && one.min(other) * 100 > period
        })
    }

    /// A long and a short interval in turn.
    fn is_alternating(&self) -> bool {
        let (even, odd) = (self.interval(0), self.interval(1));
        let (long, short) = (even.max(odd), even.min(odd));
        let apart = (long - short) * 3 > long && short * 100 > long;
        apart
            && (0..INTERVALS_MAX).step_by(2).all(|at| {
                self.is_interval_like(at, even, even, odd)
                    && self.is_interval_like(at + 1, odd, even, odd)
            })
    }

    fn is_interval_like(&self, at: usize, as_: u64, even: u64, odd: u64) -> bool {
        self.interval(at).abs_diff(as_) * 20 <= even + odd
    }

    /// The intervals in order, the oldest first.
    const fn interval(&self, at: usize) -> u64 {
        self.intervals[(self.count + at) % INTERVALS_MAX]
    }
}
