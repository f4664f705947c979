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
        Self::Serial(CountedLink { link: Arc::from(link), sent_counter: SentCounter::default() })
    }

    /// A borrowed link on CAN.
    pub(crate) fn borrowed_can(link: Box<dyn LinkIo<Can>>) -> Self {
        Self::Can(CountedLink { link: Arc::from(link), sent_counter: SentCounter::default() })
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
}

impl<M: Medium> Clone for CountedLink<M> {
    fn clone(&self) -> Self {
        Self { link: Arc::clone(&self.link), sent_counter: self.sent_counter.clone() }
    }
}

impl<M: Medium> CountedLink<M> {
    fn new(
        link: Box<dyn LinkIo<M>>,
        tap: Option<impl Tap<M> + 'static>,
        sent: SentCounter,
    ) -> Self {
        match tap {
            None => Self { link: Arc::from(link), sent_counter: sent },
            Some(tap) => Self { link: Arc::new(TappedLink::new(link, tap)), sent_counter: sent },
        }
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
        Ok(())
    }
    fn wait_writable(&self, until: Instant) -> Result<bool, LinkError> {
        self.link.wait_writable(until)
    }

    fn receive(&self, buffer: &mut M::Out, until: Instant) -> Result<Received, LinkError> {
        self.link.receive(buffer, until)
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
        Ok(Box::new(Self { link, sent_counter: self.sent_counter.clone() }))
    }
}
