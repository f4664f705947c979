//! What the task has heard, for those who ask.

use std::collections::{HashMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};

use polepair_core::time::Instant;
use polepair_link::clock;
use polepair_messages::telemetry::Sample;

use crate::Refused;
use crate::rest::lost;

/// Samples that wait for whoever watches; the oldest are lost first, and counted.
const SAMPLES_MAX: usize = 65_536;

/// What is known of the server and of what we hold.
#[derive(Debug)]
pub(crate) struct Known {
    /// Our name there.
    pub session: String,
    told: Mutex<Told>,
}

#[derive(Debug)]
struct Told {
    /// The server's time, and when it said so.
    server: (f64, Instant),
    /// Each axis that is ours, by the epoch of its lease; or why it is ours no more.
    leases: HashMap<u16, Result<u64, Refused>>,
    /// Why the server is gone.
    lost: Option<Refused>,
}

impl Known {
    pub fn new(session: String, server_ms: f64) -> Self {
        let server = (server_ms, clock::now());
        Self { session, told: Mutex::new(Told { server, leases: HashMap::new(), lost: None }) }
    }

    /// The server's time now: clocks of two machines differ.
    pub fn now_ms(&self) -> f64 {
        let (server_ms, at) = self.told().server;
        server_ms + clock::now().since(at).as_secs_f64() * 1e3
    }

    pub fn set_time(&self, server_ms: f64) {
        self.told().server = (server_ms, clock::now());
    }

    pub fn set_lease(&self, axis: u16, lease: Result<u64, Refused>) {
        self.told().leases.insert(axis, lease);
    }

    pub fn end_lease(&self, axis: u16) {
        self.told().leases.remove(&axis);
    }

    /// Every lease that is ours.
    pub fn leases(&self) -> Vec<(u16, u64)> {
        let told = self.told();
        told.leases
            .iter()
            .filter_map(|(axis, epoch)| Some((*axis, *epoch.as_ref().ok()?)))
            .collect()
    }

    pub fn holds(&self, axis: u16, epoch: u64) -> bool {
        self.told().leases.get(&axis).is_some_and(|lease| *lease == Ok(epoch))
    }

    /// Whether a lease is still ours.
    pub fn check(&self, axis: u16, epoch: u64) -> Result<(), Refused> {
        self.here()?;
        match self.told().leases.get(&axis) {
            Some(Ok(ours)) if *ours == epoch => Ok(()),
            Some(Err(why)) => Err(why.clone()),
            _ => Err(Refused::new("gateway.lease", "the lease was given back")),
        }
    }

    pub fn set_lost(&self, why: Refused) {
        self.told().lost = Some(why);
    }

    /// Whether the server is there.
    pub fn here(&self) -> Result<(), Refused> {
        self.told().lost.clone().map_or(Ok(()), Err)
    }

    /// Why it is not.
    pub fn why(&self) -> Refused {
        self.told().lost.clone().unwrap_or_else(|| lost("the connection has ended"))
    }

    fn told(&self) -> MutexGuard<'_, Told> {
        self.told.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Samples of one channel.
#[derive(Debug, Default)]
pub(crate) struct Feed(Mutex<Samples>);

#[derive(Debug, Default)]
struct Samples {
    waiting: VecDeque<Sample>,
    last: Option<Sample>,
    /// What the server lost on the way, and what was lost here.
    lost: (u64, u64),
}

impl Feed {
    pub fn take(&self, lost_total: u64, samples: &[Sample]) {
        let mut feed = self.lock();
        feed.lost.0 = lost_total;
        for sample in samples {
            if feed.waiting.len() == SAMPLES_MAX {
                feed.waiting.pop_front();
                feed.lost.1 += 1;
            }
            feed.waiting.push_back(*sample);
            feed.last = Some(*sample);
        }
    }

    pub fn last(&self) -> Option<Sample> {
        self.lock().last
    }

    pub fn drain(&self) -> (Vec<Sample>, u64) {
        let mut feed = self.lock();
        (feed.waiting.drain(..).collect(), feed.lost.0 + feed.lost.1)
    }

    fn lock(&self) -> MutexGuard<'_, Samples> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_who_watches_fills_the_memory() {
        let feed = Feed::default();
        let samples = |from: u64| -> Vec<Sample> {
            (from..from + SAMPLES_MAX as u64).map(|t_us| Sample { t_us, value: 0.0 }).collect()
        };
        feed.take(0, &samples(0));
        feed.take(5, &samples(SAMPLES_MAX as u64)[..3]);
        let (kept, lost) = feed.drain();
        assert_eq!((kept.len(), kept[0].t_us, lost), (SAMPLES_MAX, 3, 8));
        assert_eq!(feed.last().unwrap().t_us, SAMPLES_MAX as u64 + 2);
        assert!(feed.drain().0.is_empty());
    }

    #[test]
    fn time_is_the_servers_and_goes_on() {
        let known = Known::new("ann 1".into(), 1e12);
        let now = known.now_ms();
        assert!((1e12..1e12 + 60_000.0).contains(&now), "{now}");
        known.set_time(5e11);
        assert!(known.now_ms() < 6e11, "a clock that was set is followed");
    }
}
