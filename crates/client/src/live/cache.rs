//! The data that the task has received, for its readers.

use std::collections::{HashMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::task::Waker;
use std::time::Duration;

use polepair_core::time::Instant;
use polepair_link::clock;
use polepair_messages::telemetry::Sample;
use polepair_messages::{
    AxisInfo, AxisState, AxisStopReport, BenchView, FrameItem, LinkState, LinkView, MotionLock,
};

use crate::GatewayError;
use crate::failure::{action_error, query_error, server_lost};

/// Samples that are stored for a reader; the oldest are dropped first, and counted.
const SAMPLES_MAX: usize = 65_536;
/// Frames that wait likewise.
const FRAMES_MAX: usize = 16_384;

/// Last known state of the server, and the leases and channels of this client.
#[derive(Debug)]
pub(crate) struct LiveCache {
    /// Our name there.
    pub session: String,
    state: Mutex<CachedState>,
}

#[derive(Debug)]
struct CachedState {
    /// The server's time, and the time of its arrival.
    server: (f64, Instant),
    /// Each axis that is ours, by the epoch of its lease; or why it is ours no more.
    leases: HashMap<u16, Result<u64, GatewayError>>,
    /// The last state of each axis, with its time.
    states: HashMap<u16, (AxisState, Instant)>,
    /// The newest lease of each axis that a state has named, by its epoch.
    newest_epochs: HashMap<u16, u64>,
    /// Links and axes by the server's last message.
    bench: (Vec<LinkView>, Vec<AxisInfo>),
    /// Axes whose link is lost, and why.
    lost_links: HashMap<u16, String>,
    /// Progress of the last stop of each axis, with its time.
    stops: HashMap<u16, (AxisStopReport, Instant)>,
    /// The lock of motion.
    motion_lock: Option<MotionLock>,
    /// Cause of the lost connection.
    connection_error: Option<GatewayError>,
}

impl LiveCache {
    pub fn new(session: String, server_ms: f64) -> Self {
        let cached = CachedState {
            server: (server_ms, clock::now()),
            leases: HashMap::new(),
            states: HashMap::new(),
            newest_epochs: HashMap::new(),
            bench: Default::default(),
            lost_links: HashMap::new(),
            stops: HashMap::new(),
            motion_lock: None,
            connection_error: None,
        };
        Self { session, state: Mutex::new(cached) }
    }

    /// The server's time now: clocks of two machines differ.
    pub fn now_ms(&self) -> f64 {
        let (server_ms, at) = self.lock_state().server;
        server_ms + clock::now().since(at).as_secs_f64() * 1e3
    }

    pub fn set_time(&self, server_ms: f64) {
        self.lock_state().server = (server_ms, clock::now());
    }

    /// Time since the last message of the server.
    pub fn silence(&self) -> Duration {
        clock::now().since(self.lock_state().server.1)
    }

    pub fn set_lease(&self, axis: u16, lease: Result<u64, GatewayError>) {
        self.lock_state().leases.insert(axis, lease);
    }

    /// Ends a lease, if it is ours; true if it was.
    pub fn end_lease(&self, axis: u16, epoch: u64) -> bool {
        let mut cached = self.lock_state();
        // A newer lease of the same axis is left alone.
        let ours = cached.leases.get(&axis).is_some_and(|lease| *lease == Ok(epoch));
        if ours {
            cached.leases.remove(&axis);
        }
        ours
    }

    pub fn set_state(&self, state: AxisState) {
        let mut cached = self.lock_state();
        if let Some(lease) = &state.lease {
            let newest = cached.newest_epochs.entry(state.id).or_default();
            // Messages may overtake one another on the way through the server.
            *newest = lease.epoch.max(*newest);
        }
        cached.states.insert(state.id, (state, clock::now()));
    }

    /// Returns whether the last state of an axis was sent after this lease began: a state has named it, or a later one.
    pub fn has_state_since(&self, axis: u16, epoch: u64) -> bool {
        self.lock_state().newest_epochs.get(&axis).is_some_and(|newest| *newest >= epoch)
    }

    /// The last state of an axis with the present age of its values; `None` before the first.
    pub fn state(&self, axis: u16) -> Option<AxisState> {
        let (mut state, at) = self.lock_state().states.get(&axis).cloned()?;
        let since_ms = clock::now().since(at).as_secs_f64() * 1e3;
        state.signals.iter_mut().for_each(|signal| signal.age_ms += since_ms);
        Some(state)
    }

    pub fn set_links(&self, bench: &BenchView) {
        let why = bench.axes.iter().filter_map(|axis| {
            let link = lost_link(axis.link, &bench.links)?;
            let reason =
                link.error.as_ref().map_or("the reason is unknown", |error| &error.message);
            Some((axis.id, format!("the link of {} went away: {reason}", axis.label)))
        });
        let mut cached = self.lock_state();
        (cached.lost_links, cached.motion_lock) = (why.collect(), bench.lock.clone());
        cached.bench = (bench.links.clone(), bench.axes.clone());
    }

    pub fn links(&self) -> Vec<LinkView> {
        self.lock_state().bench.0.clone()
    }

    /// Axes from index `first` on.
    pub fn axes_from(&self, first: usize) -> Vec<AxisInfo> {
        self.lock_state().bench.1.iter().skip(first).cloned().collect()
    }

    pub fn set_lock(&self, lock: Option<MotionLock>) {
        self.lock_state().motion_lock = lock;
    }

    pub fn motion_lock(&self) -> Option<MotionLock> {
        self.lock_state().motion_lock.clone()
    }

    pub fn set_stopped(&self, axes: Vec<AxisStopReport>) {
        let now = clock::now();
        let mut cached = self.lock_state();
        cached.stops.extend(axes.into_iter().map(|stopped| (stopped.id, (stopped, now))));
    }

    pub fn last_stop(&self, axis: u16) -> Option<(AxisStopReport, Instant)> {
        self.lock_state().stops.get(&axis).cloned()
    }

    /// Checks that the server is connected and has the link of an axis.
    pub fn check_link(&self, axis: u16) -> Result<(), GatewayError> {
        self.check_connected()?;
        let why = self.lock_state().lost_links.get(&axis).cloned();
        why.map_or(Ok(()), |why| {
            Err(GatewayError::new("E313", why).hint("the server opens it again by itself"))
        })
    }

    /// Every lease that is ours.
    pub fn leases(&self) -> Vec<(u16, u64)> {
        let cached = self.lock_state();
        cached
            .leases
            .iter()
            .filter_map(|(axis, epoch)| Some((*axis, *epoch.as_ref().ok()?)))
            .collect()
    }

    pub fn holds(&self, axis: u16, epoch: u64) -> bool {
        self.lock_state().leases.get(&axis).is_some_and(|lease| *lease == Ok(epoch))
    }

    /// Checks that a lease is still valid.
    pub fn check(&self, axis: u16, epoch: u64) -> Result<(), GatewayError> {
        let cached = self.lock_state();
        if let Some(why) = &cached.connection_error {
            return Err(action_error(why.clone()));
        }
        match cached.leases.get(&axis) {
            Some(Ok(ours)) if *ours == epoch => Ok(()),
            Some(Err(why)) => Err(why.clone()),
            _ => Err(GatewayError::new("gateway.lease", "the lease was released")),
        }
    }

    pub fn set_disconnected(&self, why: GatewayError) {
        self.lock_state().connection_error = Some(why);
    }

    /// Checks that the server is connected.
    pub fn check_connected(&self) -> Result<(), GatewayError> {
        self.lock_state().connection_error.clone().map_or(Ok(()), |why| Err(query_error(why)))
    }

    /// Returns the reason why the connection is lost.
    pub fn disconnect_reason(&self) -> GatewayError {
        self.lock_state()
            .connection_error
            .clone()
            .unwrap_or_else(|| server_lost("the connection has ended"))
    }

    fn lock_state(&self) -> MutexGuard<'_, CachedState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn lost_link(id: u16, bench_links: &[LinkView]) -> Option<&LinkView> {
    bench_links.iter().find(|l| l.id == id && l.state == LinkState::Lost)
}

/// Frames that pass on the server's links.
#[derive(Debug, Default)]
pub(crate) struct FrameBuffer(Mutex<BufferedFrames>);

#[derive(Debug, Default)]
struct BufferedFrames {
    waiting: VecDeque<FrameItem>,
    lost: u64,
    /// Reason why there are none.
    error: Option<GatewayError>,
}

impl FrameBuffer {
    pub fn push(&self, items: Vec<FrameItem>, lost: u64) {
        let mut passed = self.lock();
        passed.lost += lost;
        passed.waiting.extend(items);
        let over = passed.waiting.len().saturating_sub(FRAMES_MAX);
        passed.waiting.drain(..over);
        debug_assert!(passed.waiting.len() <= FRAMES_MAX);
        passed.lost += over as u64;
    }

    pub fn fail(&self, why: GatewayError) {
        self.lock().error = Some(why);
    }

    pub fn drain(&self) -> Result<(Vec<FrameItem>, u64), GatewayError> {
        let mut passed = self.lock();
        match &passed.error {
            Some(why) => Err(why.clone()),
            None => Ok((passed.waiting.drain(..).collect(), passed.lost)),
        }
    }

    fn lock(&self) -> MutexGuard<'_, BufferedFrames> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Samples of one channel.
#[derive(Debug, Default)]
pub(crate) struct SampleBuffer(Mutex<BufferedSamples>);

#[derive(Debug, Default)]
struct BufferedSamples {
    waiting: VecDeque<Sample>,
    /// And when it came.
    last: Option<(Sample, Instant)>,
    /// Samples lost by the server, and samples lost here.
    lost: (u64, u64),
    /// The waiting reader.
    waker: Option<Waker>,
}

impl SampleBuffer {
    pub fn push(&self, lost_total: u64, samples: &[Sample], at: Instant) {
        let mut buffered = self.lock();
        buffered.lost.0 = lost_total;
        for sample in samples {
            if buffered.waiting.len() == SAMPLES_MAX {
                buffered.waiting.pop_front();
                buffered.lost.1 += 1;
            }
            buffered.waiting.push_back(*sample);
            buffered.last = Some((*sample, at));
        }
        // Before the waiter is woken, who takes the same lock.
        drop(buffered);
        self.wake();
    }

    /// True if data are available; otherwise the waker is woken when there are. Only the last waiting
    /// reader is woken.
    pub fn poll_ready(&self, waker: &Waker) -> bool {
        let mut buffered = self.lock();
        let ready = !buffered.waiting.is_empty();
        if !ready {
            buffered.waker = Some(waker.clone());
        }
        ready
    }

    /// Wakes the waiting reader.
    pub fn wake(&self) {
        let waits = self.lock().waker.take();
        waits.into_iter().for_each(Waker::wake);
    }

    /// The last sample, unless it is older than `within`.
    pub fn last(&self, within: Duration) -> Option<Sample> {
        let last = self.lock().last.filter(|(_, at)| clock::now().since(*at) <= within);
        last.map(|(sample, _)| sample)
    }

    pub fn drain(&self) -> (Vec<Sample>, u64) {
        let mut buffered = self.lock();
        (buffered.waiting.drain(..).collect(), buffered.lost.0 + buffered.lost.1)
    }

    fn lock(&self) -> MutexGuard<'_, BufferedSamples> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use polepair_messages::LeaseView;

    use super::*;

    #[test]
    fn viewers_do_not_fill_the_memory() {
        let buffer = SampleBuffer::default();
        let samples = |from: u64| -> Vec<Sample> {
            (from..from + SAMPLES_MAX as u64).map(|t_us| Sample { t_us, value: 0.0 }).collect()
        };
        let now = clock::now();
        buffer.push(0, &samples(0), now);
        buffer.push(5, &samples(SAMPLES_MAX as u64)[..3], now);
        let (stored, lost) = buffer.drain();
        assert_eq!((stored.len(), stored[0].t_us, lost), (SAMPLES_MAX, 3, 8));
        assert_eq!(buffer.last(Duration::MAX).unwrap().t_us, SAMPLES_MAX as u64 + 2);
        assert!(buffer.drain().0.is_empty());
    }

    #[test]
    fn a_sample_is_the_last_for_so_long_only() {
        let buffer = SampleBuffer::default();
        buffer.push(0, &[Sample { t_us: 1, value: 1.0 }], Instant::default());
        clock::sleep_until(clock::now().plus_ms(2));
        assert!(
            buffer.last(Duration::MAX).is_some() && buffer.last(Duration::from_millis(1)).is_none()
        );
    }

    #[test]
    fn a_state_from_before_a_lease_is_not_taken_for_its_end() {
        let known = LiveCache::new("ann 1".into(), 0.0);
        let lease = |epoch| LeaseView { epoch, owner: "ann 1".into(), expires_ms: 0.0 };
        let state = |lease: Option<LeaseView>| AxisState {
            id: 1,
            mode: None,
            enabled: Some(false),
            armed: lease.is_some(),
            moving: Some(false),
            signals: Vec::new(),
            faults: Vec::new(),
            lease,
            pending_stop: None,
            panel: None,
        };
        known.set_state(state(Some(lease(6))));
        known.set_state(state(None));
        assert!(known.has_state_since(1, 6) && !known.has_state_since(1, 7));
        known.set_state(state(Some(lease(7))));
        known.set_state(state(None));
        assert!(known.has_state_since(1, 7) && !known.has_state_since(2, 7));
    }

    #[test]
    fn a_returned_lease_is_not_renewed_and_a_newer_one_stays() {
        let known = LiveCache::new("ann 1".into(), 0.0);
        known.set_lease(1, Ok(7));
        assert!(!known.end_lease(1, 6) && known.leases() == [(1, 7)]);
        assert!(known.end_lease(1, 7) && known.leases().is_empty());
        assert!(known.check(1, 7).is_err());
    }

    #[test]
    fn time_is_the_servers_and_goes_on() {
        let known = LiveCache::new("ann 1".into(), 1e12);
        let now = known.now_ms();
        assert!((1e12..1e12 + 60_000.0).contains(&now), "{now}");
        known.set_time(5e11);
        assert!(known.now_ms() < 6e11, "a clock that was set is followed");
    }
}
