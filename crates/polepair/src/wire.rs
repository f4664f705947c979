//! Links of either medium, for the layers above the protocols.

use crate::tap::SharedTap;
use polepair_core::medium::{Can, Medium, MediumKind, Stream};
use polepair_core::time::Instant;
use polepair_link::{LinkError, LinkIo, LinkWaker, Losses, Received, Tap, TappedLink, clock};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// An opened link, whatever it carries.
pub enum AnyLink {
    /// Bytes.
    Serial(Box<dyn LinkIo<Stream>>),
    /// Frames.
    Can(Box<dyn LinkIo<Can>>),
}

impl AnyLink {
    /// Medium of the wire.
    #[must_use]
    pub const fn medium(&self) -> MediumKind {
        match self {
            Self::Serial(_) => MediumKind::Serial,
            Self::Can(_) => MediumKind::Can,
        }
    }

    /// Handle that ends a wait on it.
    #[must_use]
    pub fn waker(&self) -> LinkWaker {
        match self {
            Self::Serial(link) => link.waker(),
            Self::Can(link) => link.waker(),
        }
    }

    /// Name of the link: `/dev/ttyUSB0`, `10.0.0.5:4001`.
    #[must_use]
    pub fn describe(&self) -> String {
        match self {
            Self::Serial(link) => link.describe(),
            Self::Can(link) => link.describe(),
        }
    }
}

impl std::fmt::Debug for AnyLink {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("AnyLink").field(&self.describe()).finish()
    }
}

/// A wire that was opened, for those who watch it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct OpenWire {
    /// Name of the link: `/dev/ttyUSB0`, `can0`, `sim:cell`.
    pub name: String,
    /// Medium of the wire.
    pub medium: MediumKind,
    /// Bits per second, where it has such a rate and it is known.
    pub rate: Option<u32>,
    /// The words of the protocols that are spoken on it.
    pub protocols: Vec<&'static str>,
}

/// Number of frames, or runs of bytes on a serial line, were handed to the wires of a [`Connector`](crate::Connector).
/// Clones count together.
#[derive(Clone, Debug, Default)]
pub struct SentCounter(Arc<AtomicU64>);

impl SentCounter {
    /// Number of sent frames so far.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// A link that outlives the connection it is lent to.
#[derive(Clone)]
pub(crate) enum SharedLink {
    Serial(CountedLink<Stream>),
    Can(CountedLink<Can>),
}

impl SharedLink {
    pub(crate) fn new(link: AnyLink, tap: Option<SharedTap>, sent: &SentCounter) -> Self {
        match link {
            AnyLink::Serial(link) => Self::Serial(CountedLink::new(link, tap, sent.clone())),
            AnyLink::Can(link) => Self::Can(CountedLink::new(link, tap, sent.clone())),
        }
    }

    /// A link that its connection lends; taps see it there.
    pub(crate) fn borrowed_serial(link: Box<dyn LinkIo<Stream>>) -> Self {
        Self::Serial(CountedLink::over(Arc::from(link), SentCounter::default()))
    }

    /// A borrowed link on CAN.
    pub(crate) fn borrowed_can(link: Box<dyn LinkIo<Can>>) -> Self {
        Self::Can(CountedLink::over(Arc::from(link), SentCounter::default()))
    }

    /// The link with a tap on its bytes; frames of a bus are not tapped.
    pub(crate) fn with_tap(&self, tap: impl Tap<Stream> + 'static) -> Self {
        match self {
            Self::Serial(link) => {
                let sent = SentCounter::default();
                Self::Serial(CountedLink::new(Box::new(link.clone()), Some(tap), sent))
            }
            Self::Can(link) => Self::Can(link.clone()),
        }
    }

    pub(crate) fn describe(&self) -> String {
        match self {
            Self::Serial(link) => link.describe(),
            Self::Can(link) => link.describe(),
        }
    }

    /// The present time of the link, which is not the system's where time is virtual.
    pub(crate) fn now(&self) -> Instant {
        match self {
            Self::Serial(link) => link.now(),
            Self::Can(link) => link.now(),
        }
    }

    /// The end of a time-out that begins now; it is scaled in real time.
    pub(crate) fn deadline(&self, timeout: Duration) -> Instant {
        let is_real_time = match self {
            Self::Serial(link) => link.is_real_time(),
            Self::Can(link) => link.is_real_time(),
        };
        self.now() + if is_real_time { clock::scale_timeout(timeout) } else { timeout }
    }

    pub(crate) fn losses(&self) -> Losses {
        match self {
            Self::Serial(link) => link.losses(),
            Self::Can(link) => link.losses(),
        }
    }
}

impl From<SharedLink> for AnyLink {
    fn from(link: SharedLink) -> Self {
        match link {
            SharedLink::Serial(link) => Self::Serial(Box::new(link)),
            SharedLink::Can(link) => Self::Can(Box::new(link)),
        }
    }
}

pub(crate) struct CountedLink<M: Medium> {
    link: Arc<dyn LinkIo<M>>,
    sent_counter: SentCounter,
    /// Times of the last frame sent and received, of any session.
    sent_at: Arc<AtomicU64>,
    received_at: Arc<AtomicU64>,
}

/// Time in which a drive begins its reply, if it sends one, as long as an earlier session is over.
const LATE_REPLY_MAX: Duration = Duration::from_millis(25);

impl<M: Medium> Clone for CountedLink<M> {
    fn clone(&self) -> Self {
        Self {
            link: Arc::clone(&self.link),
            sent_counter: self.sent_counter.clone(),
            sent_at: Arc::clone(&self.sent_at),
            received_at: Arc::clone(&self.received_at),
        }
    }
}

impl<M: Medium> CountedLink<M> {
    fn new(
        link: Box<dyn LinkIo<M>>,
        tap: Option<impl Tap<M> + 'static>,
        sent: SentCounter,
    ) -> Self {
        match tap {
            None => Self::over(Arc::from(link), sent),
            Some(tap) => Self::over(Arc::new(TappedLink::new(link, tap)), sent),
        }
    }

    fn over(link: Arc<dyn LinkIo<M>>, sent_counter: SentCounter) -> Self {
        Self { link, sent_counter, sent_at: Arc::default(), received_at: Arc::default() }
    }

    /// Time until which the sessions so far may use the wire; `None` before the first byte.
    ///
    /// A session that ended before its last request was answered leaves a reply behind.
    pub(crate) fn used_until(&self) -> Option<Instant> {
        let [sent, received] =
            [&self.sent_at, &self.received_at].map(|at| Instant(at.load(Ordering::Relaxed)));
        let until = if sent > received { sent + LATE_REPLY_MAX } else { received };
        (until > Instant::ZERO).then_some(until)
    }
}

impl<M: Medium> LinkIo<M> for CountedLink<M> {
    fn now(&self) -> Instant {
        self.link.now()
    }
    fn send(&self, unit: &M::Unit) -> Result<(), LinkError> {
        self.link.send(unit)?;
        // After the link took it: a frame that was refused has not left.
        self.sent_counter.0.fetch_add(1, Ordering::Relaxed);
        self.sent_at.store(self.link.now().0, Ordering::Relaxed);
        Ok(())
    }
    fn wait_writable(&self, until: Instant) -> Result<bool, LinkError> {
        self.link.wait_writable(until)
    }

    fn receive(&self, buffer: &mut M::Out, until: Instant) -> Result<Received, LinkError> {
        let received = self.link.receive(buffer, until)?;
        if let Received::Bytes { at, .. } = received {
            self.received_at.store(at.0, Ordering::Relaxed);
        }
        Ok(received)
    }
    fn set_line(&self, line: M::Line) -> Result<(), LinkError> {
        self.link.set_line(line)
    }
    fn waker(&self) -> LinkWaker {
        self.link.waker()
    }
    fn is_real_time(&self) -> bool {
        self.link.is_real_time()
    }
    fn describe(&self) -> String {
        self.link.describe()
    }
    fn losses(&self) -> Losses {
        self.link.losses()
    }
    fn reopen(&self) -> Result<Box<dyn LinkIo<M>>, LinkError> {
        let link = Arc::from(self.link.reopen()?);
        Ok(Box::new(Self::over(link, self.sent_counter.clone())))
    }
}
