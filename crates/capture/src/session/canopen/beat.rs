//! A heartbeat: how often it comes, when it stays out, and whether it is that of two.

use crate::stamp::Stamp;

/// Intervals that are looked at.
const RECENT: usize = 8;
/// Intervals after which the period counts as known.
const KNOWN: usize = 3;
/// What any period may be exceeded by, ns: who sends every few milliseconds is not that exact.
const SLACK_NS: u64 = 50_000_000;

/// Longer intervals are as good as this, ns: years, by which sums and products stay in range.
pub(super) const LONGEST_NS: u64 = 1 << 56;

/// The heartbeat of one node.
#[derive(Debug, Default)]
pub(super) struct Beat {
    last: Option<Stamp>,
    recent: [u64; RECENT],
    count: usize,
    /// By object 1017h, ns.
    configured: Option<u64>,
    /// What its consumer allows, by object 1016h, ns.
    allowed: u64,
    /// What it was while it was regular, ns.
    steady: Option<u64>,
    /// What its period was before it was off, ns.
    former: Option<u64>,
    heard: bool,
    silent: bool,
}

impl Beat {
    /// The node has one.
    pub const fn is_heard(&self) -> bool {
        self.heard
    }

    /// When it came last.
    pub const fn last(&self) -> Option<Stamp> {
        self.last
    }

    /// It was set to so many milliseconds; 0 is none.
    pub fn configure(&mut self, ms: u64) {
        self.off();
        self.configured = (ms > 0).then_some(ms * 1_000_000);
    }

    /// Its consumer allows so many milliseconds.
    pub const fn allow(&mut self, ms: u64) {
        self.allowed = ms * 1_000_000;
    }

    /// It may stay out from now on, until it comes again.
    pub fn off(&mut self) {
        let (allowed, former) = (self.allowed, self.former());
        *self = Self { allowed, former, heard: self.heard, ..Self::default() };
    }

    /// How often it comes, or came before it was off, ns.
    pub fn former(&self) -> Option<u64> {
        self.period().or(self.former)
    }

    /// It came. True if that it stayed out had been told.
    pub fn take(&mut self, now: Option<Stamp>) -> bool {
        self.heard = true;
        let Some(now) = now else { return false };
        let interval = self.last.replace(now).map(|last| now.since(last).min(LONGEST_NS));
        if core::mem::take(&mut self.silent) {
            self.count = 0;
            return true;
        }
        if let Some(interval) = interval {
            self.recent[self.count % RECENT] = interval;
            self.count += 1;
            self.learn();
        }
        false
    }

    fn recent(&self) -> &[u64] {
        &self.recent[..self.count.min(RECENT)]
    }

    fn learn(&mut self) {
        let middle = self.middle();
        let near = |interval: &u64| interval.abs_diff(middle) * 5 <= middle;
        if self.count >= 5 && self.steady.is_none() && self.recent().iter().all(near) {
            self.steady = Some(middle);
        }
    }

    /// The interval in the middle.
    fn middle(&self) -> u64 {
        let mut sorted = self.recent;
        let sorted = &mut sorted[..self.count.min(RECENT)];
        sorted.sort_unstable();
        sorted.get(sorted.len() / 2).copied().unwrap_or(0)
    }

    /// How often it comes, ns; `None` while nobody knows.
    fn period(&self) -> Option<u64> {
        let observed = (self.count >= KNOWN).then(|| self.middle());
        self.configured.max(observed)
    }

    /// When it is missed.
    pub fn due(&self) -> Option<Stamp> {
        let (last, period) = (self.last?, self.period()?);
        let patience = (period * 5 / 2).max(period + SLACK_NS).max(self.allowed);
        (!self.silent).then(|| Stamp(last.0.saturating_add(patience)))
    }

    /// It is missed: its period, and for how long. Once.
    pub fn stays_out(&mut self, now: Stamp) -> Option<(u64, u64)> {
        if self.due()? >= now {
            return None;
        }
        self.silent = true;
        Some((self.period()?, now.since(self.last?)))
    }

    /// Two send it, and why that is thought.
    pub fn is_two(&self) -> Option<&'static str> {
        let whole = self.count >= RECENT;
        if whole && self.is_denser() {
            return Some("its heartbeat comes twice as often as before");
        }
        (whole && self.alternates()).then_some("its heartbeat has two beats that take turns")
    }

    /// Each two intervals are what one was.
    fn is_denser(&self) -> bool {
        let Some(period) = self.steady.or(self.configured) else { return false };
        let pair = |at: usize| {
            let (one, other) = (self.at(at), self.at(at + 1));
            let both = (one + other).abs_diff(period) * 7 <= period;
            both && one.max(other) * 10 < period * 9 && one.min(other) * 100 > period
        };
        (0..RECENT - 1).all(pair)
    }

    /// A long and a short interval in turn.
    fn alternates(&self) -> bool {
        let (even, odd) = (self.at(0), self.at(1));
        let same = |at: usize, as_: u64| self.at(at).abs_diff(as_) * 20 <= even + odd;
        let (long, short) = (even.max(odd), even.min(odd));
        let apart = (long - short) * 3 > long && short * 100 > long;
        apart && (0..RECENT).step_by(2).all(|at| same(at, even) && same(at + 1, odd))
    }

    /// The intervals in order, the oldest first.
    const fn at(&self, at: usize) -> u64 {
        self.recent[(self.count + at) % RECENT]
    }
}
