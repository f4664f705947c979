//! The WebSocket: a task that keeps what we hold, hears what is told, and ends when the server is gone.

mod asked;
mod known;
mod socket;

use std::future::poll_fn;
use std::sync::Arc;
use std::sync::atomic::{AtomicU16, Ordering};
use std::task::{Poll, Waker};
use std::time::Duration;

use polepair_core::time::Instant;
use polepair_messages::telemetry::Sample;
use polepair_messages::{
    AxisInfo, AxisState, AxisStopped, CommandOrder, FrameItem, LeaseAct, LinkView, LockTold, Source,
};
use tokio::sync::{mpsc, oneshot};
use tokio::time::timeout;

use crate::lease::Lease;
use crate::rest::{deed, lost, question};
use crate::wire::Wire;
use crate::{Gateway, Refused};
pub(crate) use known::{Feed, Known, Passing};

/// How long the server may take to say what comes of a lease or of what is watched.
const TOLD_MAX: Duration = Duration::from_secs(15);
/// What waits to be said.
const ASKS_MAX: usize = 256;

/// A connection that stays: for leases and telemetry. Cheap to clone; what was taken through it ends
/// with the last clone.
#[derive(Debug, Clone)]
pub struct Live(Arc<Inside>);

#[derive(Debug)]
struct Inside {
    gateway: Gateway,
    asks: mpsc::Sender<Ask>,
    known: Arc<Known>,
    channels: AtomicU16,
}

/// What the task is asked to say, and who wants to know what comes of it.
#[derive(Debug)]
pub(crate) enum Ask {
    Command { axis: u16, order: CommandOrder, tell: Tell<()> },
    Lease { axis: u16, act: LeaseAct, epoch: u64, tell: Tell<u64> },
    Watch { channel: u16, what: What, feed: Arc<Feed>, tell: Tell<Channel> },
    Frames { filter: Option<String>, passing: Arc<Passing> },
}

impl Ask {
    /// Tells whoever waits that it was not said.
    fn refuse(self, why: Refused) {
        // Who waited may have gone.
        match self {
            Self::Command { tell, .. } => drop(tell.send(Err(why))),
            Self::Lease { tell, .. } => drop(tell.send(Err(why))),
            Self::Watch { tell, .. } => drop(tell.send(Err(why))),
            Self::Frames { passing, .. } => passing.refuse(why),
        }
    }
}

pub(crate) type Tell<T> = oneshot::Sender<Result<T, Refused>>;

/// What is watched, and how often.
#[derive(Debug, Clone)]
pub(crate) struct What {
    pub axis: u16,
    pub signal: Option<String>,
    pub parameter: Option<String>,
    pub hz: f64,
}

/// What the server says of something that is watched.
#[derive(Debug, Clone)]
pub(crate) struct Channel {
    pub hz: f64,
    pub source: Source,
    pub unit: String,
}

impl Live {
    pub(crate) async fn open(gateway: Gateway, wire: Wire) -> Result<Self, Refused> {
        let (asks, asked) = mpsc::channel(ASKS_MAX);
        let known = socket::open(&wire, asked).await?;
        let channels = AtomicU16::new(0);
        Ok(Self(Arc::new(Inside { gateway, asks, known, channels })))
    }

    /// The server.
    #[must_use]
    pub fn gateway(&self) -> &Gateway {
        &self.0.gateway
    }

    /// How leases and the journal name us.
    #[must_use]
    pub fn session(&self) -> &str {
        &self.0.known.session
    }

    /// Whether the server is still there.
    ///
    /// # Errors
    /// Why it is gone.
    pub fn check(&self) -> Result<(), Refused> {
        self.known().here()
    }

    /// For how long the server has said nothing: it is asked twice a second.
    #[must_use]
    pub fn silence(&self) -> Duration {
        self.known().silence()
    }

    /// Takes an axis, if nobody else has it.
    ///
    /// # Errors
    /// `gateway.lease` says who commands it.
    pub fn take(&self, axis: u16) -> Result<Lease, Refused> {
        let epoch = self.lease(axis, LeaseAct::Take, 0)?;
        Ok(Lease::new(self.clone(), axis, epoch))
    }

    /// Watches a signal, or a parameter, so often or as often as can be.
    ///
    /// # Errors
    /// As the server says.
    pub fn watch(
        &self,
        axis: u16,
        signal: Option<&str>,
        parameter: Option<&str>,
        hz: f64,
    ) -> Result<Watched, Refused> {
        let channel = self.0.channels.fetch_add(1, Ordering::Relaxed);
        let (signal, parameter) = (signal.map(str::to_owned), parameter.map(str::to_owned));
        let what = What { axis, signal, parameter, hz };
        let feed = Arc::<Feed>::default();
        let (tell, told) = oneshot::channel();
        self.ask(Ask::Watch { channel, what, feed: Arc::clone(&feed), tell })?;
        let about = self.told(told).map_err(question)?;
        Ok(Watched { live: self.clone(), axis, feed, about })
    }

    /// Hears the frames that pass on the server's links from now on, those that a filter of the
    /// analyser's language wants. Who asks again hears them instead of who asked before.
    ///
    /// # Errors
    /// `E313` where the server is gone.
    pub fn frames(&self, filter: Option<&str>) -> Result<Frames, Refused> {
        let (filter, passing) = (filter.map(str::to_owned), Arc::<Passing>::default());
        self.ask(Ask::Frames { filter, passing: Arc::clone(&passing) })?;
        Ok(Frames { live: self.clone(), passing })
    }

    /// An axis as the server said it last, its values as old as they are by now; `None` before it said
    /// anything. Nothing is asked.
    ///
    /// # Errors
    /// `E313` once the server is gone.
    pub fn state(&self, axis: u16) -> Result<Option<AxisState>, Refused> {
        self.known().here()?;
        Ok(self.known().state(axis))
    }

    /// Whether the server is there, and has the link of an axis.
    ///
    /// # Errors
    /// `E313` with what went away.
    pub fn linked(&self, axis: u16) -> Result<(), Refused> {
        self.known().linked(axis)
    }

    /// The links that the server has, as it told them last.
    #[must_use]
    pub fn links(&self) -> Vec<LinkView> {
        self.known().links()
    }

    /// The axes that the server has behind the first so many: some join later.
    #[must_use]
    pub fn axes_from(&self, first: usize) -> Vec<AxisInfo> {
        self.known().axes_from(first)
    }

    /// Who locked motion, if somebody did.
    #[must_use]
    pub fn lock(&self) -> Option<LockTold> {
        self.known().lock()
    }

    /// How far the last stop of an axis came since we stay, whoever said it, and when we heard so.
    #[must_use]
    pub fn stopped(&self, axis: u16) -> Option<(AxisStopped, Instant)> {
        self.known().stopped(axis)
    }

    pub(crate) fn known(&self) -> &Known {
        &self.0.known
    }

    pub(crate) fn ask(&self, ask: Ask) -> Result<(), Refused> {
        let sent = self.gateway().wait(self.0.asks.send(ask));
        sent.map_err(|_| Refused { executed: Some(false), ..self.known().why() })
    }

    pub(crate) fn lease(&self, axis: u16, act: LeaseAct, epoch: u64) -> Result<u64, Refused> {
        let (tell, told) = oneshot::channel();
        self.ask(Ask::Lease { axis, act, epoch, tell })?;
        self.told(told)
    }

    /// Gives a lease back without waiting. One that was given back already is not ours any more.
    pub(crate) fn forget(&self, axis: u16, epoch: u64) {
        if self.known().end_lease(axis, epoch) {
            let (tell, _) = oneshot::channel();
            // Where it cannot be said, it is renewed no more all the same.
            let _ = self.0.asks.try_send(Ask::Lease { axis, act: LeaseAct::Drop, epoch, tell });
        }
    }

    fn told<T>(&self, told: oneshot::Receiver<Result<T, Refused>>) -> Result<T, Refused> {
        // An answer that comes later finds nobody, and gives nothing.
        let told = self.gateway().wait(async { timeout(TOLD_MAX, told).await });
        told.ok().and_then(Result::ok).unwrap_or_else(|| Err(deed(lost("no answer came"))))
    }
}

/// Frames that are heard, until this is dropped.
#[derive(Debug)]
pub struct Frames {
    live: Live,
    passing: Arc<Passing>,
}

impl Frames {
    /// What passed since it was asked last, and how many frames have been lost so far.
    ///
    /// # Errors
    /// `E313` once the server is gone; `gateway.request` for what is no filter.
    pub fn drain(&self) -> Result<(Vec<FrameItem>, u64), Refused> {
        self.live.known().here()?;
        self.passing.drain()
    }
}

/// Something that is watched, until this is dropped.
#[derive(Debug)]
pub struct Watched {
    live: Live,
    axis: u16,
    feed: Arc<Feed>,
    about: Channel,
}

impl Watched {
    /// How often it comes at most.
    #[must_use]
    pub const fn hz(&self) -> f64 {
        self.about.hz
    }

    /// Whether the drive sends it by itself.
    #[must_use]
    pub const fn source(&self) -> Source {
        self.about.source
    }

    /// Its SI unit; empty without one.
    #[must_use]
    pub fn unit(&self) -> &str {
        &self.about.unit
    }

    /// The last sample, if it came within so long: what is older says nothing of now.
    ///
    /// # Errors
    /// `E313` once the server is gone, or the axis' link.
    pub fn last(&self, within: Duration) -> Result<Option<Sample>, Refused> {
        self.live.known().linked(self.axis)?;
        Ok(self.feed.last(within))
    }

    /// True when there is a sample that was not drained, or the server or the axis' link is gone; else
    /// `waker` is woken once there is.
    pub fn ready_or_wake(&self, waker: &Waker) -> bool {
        self.is_ready(&self.live.gateway().aside(waker))
    }

    fn is_ready(&self, waker: &Waker) -> bool {
        // Whoever is noted first misses nothing that ends meanwhile.
        self.feed.ready_or_wake(waker) || self.live.known().linked(self.axis).is_err()
    }

    /// Waits for a sample, at most so long.
    pub fn wait(&self, within: Duration) {
        let ready = poll_fn(|context| match self.is_ready(context.waker()) {
            true => Poll::Ready(()),
            false => Poll::Pending,
        });
        // Who waited in vain drains nothing.
        let _ = self.live.gateway().wait(async { timeout(within, ready).await });
    }

    /// What came since it was asked last, and how many samples have been lost so far.
    ///
    /// # Errors
    /// `E313` once the server is gone, or the axis' link.
    pub fn drain(&self) -> Result<(Vec<Sample>, u64), Refused> {
        self.live.known().linked(self.axis)?;
        Ok(self.feed.drain())
    }
}
