//! Links of either medium, as the layers above the protocols hold them.

use crate::connect::SharedTap;
use polepair_core::medium::{Can, Medium, MediumKind, Stream};
use polepair_core::time::Instant;
use polepair_link::{Link, LinkError, Losses, Received, Tap, Tapped, Waker};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// An opened link, whatever it carries.
pub enum AnyLink {
    /// Bytes.
    Serial(Box<dyn Link<Stream>>),
    /// Frames.
    Can(Box<dyn Link<Can>>),
}

impl AnyLink {
    /// What it carries.
    #[must_use]
    pub const fn medium(&self) -> MediumKind {
        match self {
            Self::Serial(_) => MediumKind::Serial,
            Self::Can(_) => MediumKind::Can,
        }
    }

    /// What ends a wait on it.
    #[must_use]
    pub fn waker(&self) -> Waker {
        match self {
            Self::Serial(link) => link.waker(),
            Self::Can(link) => link.waker(),
        }
    }

    /// What it is called: `/dev/ttyUSB0`, `10.0.0.5:4001`.
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
    /// What it is called: `/dev/ttyUSB0`, `can0`, `sim:cell`.
    pub name: String,
    /// What it carries.
    pub medium: MediumKind,
    /// Bits per second, where it has such a rate and it is known.
    pub rate: Option<u32>,
    /// The words of the protocols that are spoken on it.
    pub protocols: Vec<&'static str>,
}

/// How many frames, or runs of bytes on a serial line, were handed to the wires of a
/// [`Connector`](crate::Connector). Clones count together.
#[derive(Clone, Debug, Default)]
pub struct Sent(Arc<AtomicU64>);

impl Sent {
    /// So many left so far.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// A link that outlives the connection it is lent to.
#[derive(Clone)]
pub(crate) enum SharedLink {
    Serial(Shared<Stream>),
    Can(Shared<Can>),
}

impl SharedLink {
    pub(crate) fn new(link: AnyLink, tap: Option<SharedTap>, sent: &Sent) -> Self {
        match link {
            AnyLink::Serial(link) => Self::Serial(Shared::new(link, tap, sent.clone())),
            AnyLink::Can(link) => Self::Can(Shared::new(link, tap, sent.clone())),
        }
    }

    /// A link that its connection lends; taps see it there.
    pub(crate) fn lent_serial(link: Box<dyn Link<Stream>>) -> Self {
        Self::Serial(Shared { link: Arc::from(link), sent: Sent::default() })
    }

    /// The same on CAN.
    pub(crate) fn lent_can(link: Box<dyn Link<Can>>) -> Self {
        Self::Can(Shared { link: Arc::from(link), sent: Sent::default() })
    }

    /// The same link with a tap on its bytes; frames of a bus are not tapped.
    pub(crate) fn watched(&self, tap: impl Tap<Stream> + 'static) -> Self {
        match self {
            Self::Serial(link) => {
                let sent = Sent::default();
                Self::Serial(Shared::new(Box::new(link.clone()), Some(tap), sent))
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

pub(crate) struct Shared<M: Medium> {
    link: Arc<dyn Link<M>>,
    sent: Sent,
}

impl<M: Medium> Clone for Shared<M> {
    fn clone(&self) -> Self {
        Self { link: Arc::clone(&self.link), sent: self.sent.clone() }
    }
}

impl<M: Medium> Shared<M> {
    fn new(link: Box<dyn Link<M>>, tap: Option<impl Tap<M> + 'static>, sent: Sent) -> Self {
        match tap {
            None => Self { link: Arc::from(link), sent },
            Some(tap) => Self { link: Arc::new(Tapped::new(link, tap)), sent },
        }
    }
}

impl<M: Medium> Link<M> for Shared<M> {
    fn now(&self) -> Instant {
        self.link.now()
    }
    fn send(&self, unit: &M::Unit) -> Result<(), LinkError> {
        self.link.send(unit)?;
        self.sent.0.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }
    fn ready(&self, until: Instant) -> Result<bool, LinkError> {
        self.link.ready(until)
    }

    fn receive(&self, buffer: &mut M::Out, until: Instant) -> Result<Received, LinkError> {
        self.link.receive(buffer, until)
    }
    fn set_line(&self, line: M::Line) -> Result<(), LinkError> {
        self.link.set_line(line)
    }
    fn waker(&self) -> Waker {
        self.link.waker()
    }
    fn runs_by_itself(&self) -> bool {
        self.link.runs_by_itself()
    }
    fn describe(&self) -> String {
        self.link.describe()
    }
    fn losses(&self) -> Losses {
        self.link.losses()
    }
    fn reopen(&self) -> Result<Box<dyn Link<M>>, LinkError> {
        let link = Arc::from(self.link.reopen()?);
        Ok(Box::new(Self { link, sent: self.sent.clone() }))
    }
}
