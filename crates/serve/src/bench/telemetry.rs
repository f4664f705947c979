//! Telemetry: each signal or parameter is read once for all viewers. Each viewer has a position in the
//! stored samples; a viewer that is too slow loses the oldest, and is informed. Nothing is interpolated.
//!
//! Why: GW-13.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, Weak};
use std::time::Duration;

use polepair_core::profile::{ParameterId, Signal};
use polepair_core::time::Instant;

use super::AXES_MAX;
use super::Bench;
use super::lock::lock_unpoisoned;
use crate::message::telemetry::Sample;
use crate::message::{GatewayError, SampleSource as From};

/// Samples that are kept of each thing that is watched: eight seconds at 1 kHz.
const SAMPLES_MAX: usize = 8192;
/// Things that are watched at once.
const SOURCES_MAX: usize = 256;
/// Gaps of one thing that are remembered.
const GAPS_MAX: usize = 64;
/// The fastest that anything is asked for.
const HZ_MAX: f64 = 1000.0;
/// Silence of a signal after which it is polled, µs.
const SILENCE_US: u64 = 1_000_000;
/// Samples from which a rate is computed.
const RATE_SAMPLES: usize = 256;

/// Subscribed value of an axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum WatchTarget {
    Signal(Signal),
    Parameter(ParameterId),
}

/// Something that is watched.
#[derive(Debug)]
pub(super) struct TelemetrySource {
    pub target: WatchTarget,
    unit: &'static str,
    ring: Mutex<SampleRing>,
    /// The drive sends it by itself.
    pushed: AtomicBool,
    /// Time at which the drive last did, µs.
    pushed_us: AtomicU64,
    schedule: Mutex<PollSchedule>,
}

/// Requested rates of a value, and the time of its next poll.
#[derive(Debug, Default)]
struct PollSchedule {
    /// Rate of each subscriber, Hz.
    rates: Vec<f64>,
    next: Instant,
}

#[derive(Debug, Default)]
struct SampleRing {
    samples: VecDeque<Sample>,
    /// The number of the first that is kept.
    first: u64,
    gaps: VecDeque<SampleGap>,
    /// Gaps that are forgotten.
    gaps_before: u64,
}

/// Samples that are not there.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SampleGap {
    /// After this time, µs.
    pub from_us: u64,
    /// Before this time, µs.
    pub to_us: u64,
    /// Number of lost samples, at most.
    pub lost: u64,
}

/// Everything that is watched on a bench.
#[derive(Debug)]
pub(super) struct Telemetry {
    /// Subscribed values of each axis.
    by_axis: Mutex<Vec<Vec<Weak<TelemetrySource>>>>,
    /// Signals that the drive of each axis was seen to send, one bit each.
    pushed_signals: Vec<AtomicU32>,
}

/// Something that can be watched.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ChannelRequest {
    axis: u16,
    target: WatchTarget,
    unit: &'static str,
    hz: f64,
}

/// A subscription. Dropping it ends it.
#[derive(Debug)]
pub struct TelemetryChannel {
    source: Arc<TelemetrySource>,
    /// Requested rate, Hz.
    requested_hz: f64,
    /// The number of the next sample.
    next: u64,
    /// The number of the next gap.
    next_gap: u64,
    seen_us: u64,
    lost: u64,
}

impl Bench {
    /// Watches a signal of an axis, by its word, or a parameter, by its name.
    ///
    /// # Errors
    /// `E212` and `E213` for an unknown axis or signal, `gateway.request` for an invalid rate,
    /// `gateway.limit` when too much is watched.
    pub fn subscribe(
        &self,
        axis: u16,
        signal: Option<&str>,
        parameter: Option<&str>,
        hz: f64,
    ) -> Result<TelemetryChannel, GatewayError> {
        self.open_channel(self.resolve_channel(axis, signal, parameter, hz)?)
    }

    /// Checks that a channel exists; shares no lock with the subscribers.
    pub(crate) fn resolve_channel(
        &self,
        axis: u16,
        signal: Option<&str>,
        parameter: Option<&str>,
        hz: f64,
    ) -> Result<ChannelRequest, GatewayError> {
        let (link, index) = self.find_axis(axis)?;
        let its = &link.wire.axes[index].1;
        if !(hz > 0.0 && hz <= HZ_MAX) {
            let what = format!("{hz} Hz is not more than 0 and at most {HZ_MAX}");
            return Err(GatewayError::new("gateway.request", what));
        }
        let (what, unit) = match (signal, parameter) {
            (Some(word), None) => {
                let source = its.profile().signals.iter().find(|s| s.signal.name() == word);
                let source = source.ok_or_else(|| {
                    GatewayError::new("E213", format!("{} does not report `{word}`", its.label()))
                        .hint("the list of axes has the signals of each")
                })?;
                (WatchTarget::Signal(source.signal), its.signal_unit(source.signal))
            }
            (None, Some(name)) => {
                let id = its.find(name)?;
                (WatchTarget::Parameter(id), its.unit(id).symbol())
            }
            _ => return Err(GatewayError::new("gateway.request", "name a signal, or a parameter")),
        };
        Ok(ChannelRequest { axis, target: what, unit, hz })
    }

    /// Watches it.
    pub(crate) fn open_channel(
        &self,
        request: ChannelRequest,
    ) -> Result<TelemetryChannel, GatewayError> {
        self.0.telemetry.open_channel(request)
    }
}

impl Telemetry {
    pub fn new(axes: usize) -> Self {
        let by_axis = Mutex::new(vec![Vec::new(); axes]);
        Self { by_axis, pushed_signals: (0..AXES_MAX).map(|_| AtomicU32::new(0)).collect() }
    }

    /// One more axis.
    pub fn add_axis(&self) {
        lock_unpoisoned(&self.by_axis).push(Vec::new());
    }

    /// Takes a sample that a drive sent.
    pub fn push(&self, axis: u16, what: WatchTarget, sample: Sample) {
        let Some(sends) = self.pushed_signals.get(usize::from(axis)) else { return };
        if let WatchTarget::Signal(signal) = what {
            sends.fetch_or(1 << signal as u32, Ordering::Relaxed);
        }
        let by_axis = lock_unpoisoned(&self.by_axis);
        let its = by_axis.get(usize::from(axis)).into_iter().flatten();
        let mut sources = its.filter_map(Weak::upgrade);
        if let Some(source) = sources.find(|source| source.target == what) {
            source.push(sample);
        }
    }

    /// Notes that a drive sent more than could be taken.
    pub fn record_loss(&self, axis: u16, lost: u64) {
        self.sources_of(axis).iter().for_each(|source| source.record_loss(lost));
    }

    /// Returns whether a drive was seen to send a signal.
    pub fn is_pushed(&self, axis: u16, signal: Signal) -> bool {
        let sends = self.pushed_signals.get(usize::from(axis));
        sends.is_some_and(|sends| sends.load(Ordering::Relaxed) & (1 << signal as u32) != 0)
    }

    fn open_channel(&self, request: ChannelRequest) -> Result<TelemetryChannel, GatewayError> {
        let ChannelRequest { axis, target, unit, hz } = request;
        let mut by_axis = lock_unpoisoned(&self.by_axis);
        by_axis.iter_mut().for_each(|sources| sources.retain(|s| s.strong_count() > 0));
        let count: usize = by_axis.iter().map(Vec::len).sum();
        let sources = &mut by_axis[usize::from(axis)];
        let known = sources.iter().filter_map(Weak::upgrade).find(|source| source.target == target);
        let source = match known {
            Some(source) => source,
            None if count >= SOURCES_MAX => {
                let what = format!("{SOURCES_MAX} signals are already watched");
                return Err(GatewayError::new("gateway.limit", what).hint("close a scope"));
            }
            None => {
                let source = Arc::new(TelemetrySource::new(target, unit));
                sources.push(Arc::downgrade(&source));
                source
            }
        };
        Ok(source.open_channel(hz))
    }

    /// Subscribed values of an axis.
    pub fn sources_of(&self, axis: u16) -> Vec<Arc<TelemetrySource>> {
        let by_axis = lock_unpoisoned(&self.by_axis);
        let sources = by_axis.get(usize::from(axis)).into_iter().flatten();
        sources.filter_map(Weak::upgrade).collect()
    }
}

impl TelemetrySource {
    fn new(target: WatchTarget, unit: &'static str) -> Self {
        Self {
            target,
            unit,
            ring: Mutex::default(),
            pushed: AtomicBool::new(false),
            pushed_us: AtomicU64::new(0),
            schedule: Mutex::default(),
        }
    }

    /// Opens a subscription with this rate.
    fn open_channel(self: Arc<Self>, hz: f64) -> TelemetryChannel {
        lock_unpoisoned(&self.schedule).rates.push(hz);
        TelemetryChannel::new(self, hz)
    }

    /// Takes a sample that the drive sent.
    fn push(&self, sample: Sample) {
        self.pushed.store(true, Ordering::Relaxed);
        self.pushed_us.store(sample.t_us, Ordering::Relaxed);
        lock_unpoisoned(&self.ring).push(sample);
    }

    /// Takes a sample that was asked for.
    pub fn push_polled(&self, sample: Sample) {
        self.pushed.store(false, Ordering::Relaxed);
        lock_unpoisoned(&self.ring).push(sample);
    }

    /// Notes that the drive sent more than could be taken.
    fn record_loss(&self, lost: u64) {
        if self.pushed.load(Ordering::Relaxed) {
            lock_unpoisoned(&self.ring).push_gap(lost);
        }
    }

    /// When it is next to be asked for: never, while the drive sends it.
    pub fn poll_due(&self, now_us: u64) -> Option<Instant> {
        let sent = self.pushed.load(Ordering::Relaxed)
            && now_us.saturating_sub(self.pushed_us.load(Ordering::Relaxed)) < SILENCE_US;
        (!sent).then(|| lock_unpoisoned(&self.schedule).next)
    }

    /// Records that it is polled now. Missed polls are not caught up with.
    pub fn mark_polled(&self, now: Instant) {
        let mut wanted = lock_unpoisoned(&self.schedule);
        let period = Duration::from_secs_f64(1.0 / wanted.hz().max(1e-3));
        let on_time = wanted.next + period;
        wanted.next = if on_time > now { on_time } else { now + period };
    }
}

impl PollSchedule {
    /// The highest requested rate, Hz.
    fn hz(&self) -> f64 {
        self.rates.iter().copied().fold(0.0, f64::max)
    }
}

impl SampleRing {
    fn push(&mut self, sample: Sample) {
        if self.samples.len() == SAMPLES_MAX {
            self.samples.pop_front();
            self.first += 1;
        }
        self.samples.push_back(sample);
    }

    fn push_gap(&mut self, lost: u64) {
        if self.gaps.len() == GAPS_MAX {
            self.gaps.pop_front();
            self.gaps_before += 1;
        }
        // Those that were kept came after those that were thrown away.
        let to_us = self.samples.back().map_or(0, |sample| sample.t_us);
        let from_us = self.samples.len().checked_sub(2).map_or(0, |n| self.samples[n].t_us);
        self.gaps.push_back(SampleGap { from_us, to_us, lost });
    }
}

impl TelemetryChannel {
    fn new(source: Arc<TelemetrySource>, requested_hz: f64) -> Self {
        let (next, next_gap) = {
            let ring = lock_unpoisoned(&source.ring);
            let next = ring.first + ring.samples.len() as u64;
            (next, ring.gaps_before + ring.gaps.len() as u64)
        };
        Self { source, requested_hz, next, next_gap, seen_us: 0, lost: 0 }
    }

    /// Appends the samples since the last call to `out`, and returns the gap before them.
    pub fn drain_into(&mut self, out: &mut Vec<Sample>) -> Option<SampleGap> {
        let ring = lock_unpoisoned(&self.source.ring);
        let fell_behind = ring.first.saturating_sub(self.next);
        let from = self.next.max(ring.first) - ring.first;
        let new = ring.samples.iter().skip(from as usize);
        let before = out.len();
        out.extend(new);
        self.next = ring.first + ring.samples.len() as u64;
        let mut gap = (fell_behind > 0).then(|| {
            let to_us = out.get(before).map_or(self.seen_us, |sample| sample.t_us);
            SampleGap { from_us: self.seen_us, to_us, lost: fell_behind }
        });
        let missed = self.next_gap.saturating_sub(ring.gaps_before) as usize;
        for missed in ring.gaps.iter().skip(missed) {
            gap = Some(gap.map_or(*missed, |gap| gap.merge(missed)));
        }
        self.next_gap = ring.gaps_before + ring.gaps.len() as u64;
        self.seen_us = out.last().map_or(self.seen_us, |sample| sample.t_us);
        self.lost += gap.map_or(0, |gap| gap.lost);
        gap
    }

    /// Samples that were lost so far.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    /// Source of the samples.
    #[must_use]
    pub fn source(&self) -> From {
        if self.source.pushed.load(Ordering::Relaxed) { From::Pushed } else { From::Polled }
    }

    /// The SI unit of a signal, the shown one of a parameter; empty without one.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        self.source.unit
    }

    /// Rate of the last samples, Hz; the requested rate while there are too few.
    #[must_use]
    pub fn hz(&self) -> f64 {
        let ring = lock_unpoisoned(&self.source.ring);
        let rated = ring.samples.len().min(RATE_SAMPLES);
        match held_span(&ring, rated) {
            Some(us) if rated > 1 && us > 0 => (rated - 1) as f64 * 1e6 / us as f64,
            _ => lock_unpoisoned(&self.source.schedule).hz(),
        }
    }
}

fn held_span(ring: &MutexGuard<'_, SampleRing>, rated: usize) -> Option<u64> {
    let last = ring.samples.back()?.t_us;
    Some(last.saturating_sub(ring.samples.get(ring.samples.len() - rated)?.t_us))
}

impl Drop for TelemetryChannel {
    fn drop(&mut self) {
        let mut wanted = lock_unpoisoned(&self.source.schedule);
        if let Some(own) =
            wanted.rates.iter().position(|hz| hz.total_cmp(&self.requested_hz).is_eq())
        {
            wanted.rates.swap_remove(own);
        }
    }
}

impl SampleGap {
    /// Both together.
    fn merge(self, other: &Self) -> Self {
        Self {
            from_us: self.from_us.min(other.from_us),
            to_us: self.to_us.max(other.to_us),
            lost: self.lost + other.lost,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(n: u64) -> Sample {
        Sample { t_us: n * 1000, value: n as f64 }
    }

    #[test]
    fn a_slow_reader_loses_the_oldest_and_gets_their_number() {
        let source = Arc::new(TelemetrySource::new(WatchTarget::Signal(Signal::Velocity), "rad/s"));
        let (mut slow, mut quick) =
            (source.clone().open_channel(20.0), source.clone().open_channel(50.0));
        let (mut seen, mut all) = (Vec::new(), Vec::new());
        for n in 0..3 * SAMPLES_MAX as u64 {
            source.push(sample(n));
            if n % 100 == 99 {
                assert_eq!(quick.drain_into(&mut all), None);
            }
        }
        quick.drain_into(&mut all);
        assert_eq!(all.len(), 3 * SAMPLES_MAX);
        let gap = slow.drain_into(&mut seen).expect("it lost some");
        assert_eq!((gap.lost, slow.lost()), (2 * SAMPLES_MAX as u64, 2 * SAMPLES_MAX as u64));
        assert_eq!(seen.len(), SAMPLES_MAX);
        assert_eq!(gap.to_us, seen[0].t_us);
        assert!((quick.hz() - 1000.0).abs() < 0.1);
        assert_eq!(quick.source(), From::Pushed);
        assert_eq!(lock_unpoisoned(&source.schedule).hz(), 50.0);
        drop(quick);
        assert_eq!(
            lock_unpoisoned(&source.schedule).hz(),
            20.0,
            "nobody wants it quicker any more"
        );
    }

    #[test]
    fn a_loss_on_the_way_here_is_reported_once_to_each() {
        let source = Arc::new(TelemetrySource::new(WatchTarget::Signal(Signal::Velocity), ""));
        let mut channel = source.clone().open_channel(20.0);
        let mut out = Vec::new();
        source.push(sample(1));
        source.push(sample(9));
        source.record_loss(5);
        let gap = channel.drain_into(&mut out);
        assert_eq!(gap, Some(SampleGap { from_us: 1000, to_us: 9000, lost: 5 }));
        assert_eq!((channel.drain_into(&mut out), out.len(), channel.lost()), (None, 2, 5));
    }
}
