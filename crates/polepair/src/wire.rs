//! Links of either medium, as the layers above the protocols hold them.

use crate::connect::SharedTap;
use polepair_core::medium::{Can, Medium, MediumKind, Stream};
use polepair_core::time::Instant;
use polepair_link::{Link, LinkError, Losses, Received, Tap, Tapped, Waker};
use std::sync::Arc;

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

/// A link that outlives the connection it is lent to.
#[derive(Clone)]
pub(crate) enum SharedLink {
    Serial(Shared<Stream>),
    Can(Shared<Can>),
}

impl SharedLink {
    pub(crate) fn new(link: AnyLink, tap: Option<SharedTap>) -> Self {
        match link {
            AnyLink::Serial(link) => Self::Serial(Shared::new(link, tap)),
            AnyLink::Can(link) => Self::Can(Shared::new(link, tap)),
        }
    }

    /// A link that its connection lends; taps see it there.
    pub(crate) fn lent_serial(link: Box<dyn Link<Stream>>) -> Self {
        Self::Serial(Shared(Arc::from(link)))
    }

    /// The same on CAN.
    pub(crate) fn lent_can(link: Box<dyn Link<Can>>) -> Self {
        Self::Can(Shared(Arc::from(link)))
    }

    /// The same link with a tap on its bytes; frames of a bus are not tapped.
    pub(crate) fn watched(&self, tap: impl Tap<Stream> + 'static) -> Self {
        match self {
            Self::Serial(link) => Self::Serial(Shared::new(Box::new(link.clone()), Some(tap))),
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

pub(crate) struct Shared<M: Medium>(Arc<dyn Link<M>>);

impl<M: Medium> Clone for Shared<M> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<M: Medium> Shared<M> {
    fn new(link: Box<dyn Link<M>>, tap: Option<impl Tap<M> + 'static>) -> Self {
        match tap {
            None => Self(Arc::from(link)),
            Some(tap) => Self(Arc::new(Tapped::new(link, tap))),
        }
    }
}

impl<M: Medium> Link<M> for Shared<M> {
    fn now(&self) -> Instant {
        self.0.now()
    }
    fn send(&self, unit: &M::Unit) -> Result<(), LinkError> {
        self.0.send(unit)
    }
    fn ready(&self, until: Instant) -> Result<bool, LinkError> {
        self.0.ready(until)
    }

    fn receive(&self, buffer: &mut M::Out, until: Instant) -> Result<Received, LinkError> {
        self.0.receive(buffer, until)
    }
    fn set_line(&self, line: M::Line) -> Result<(), LinkError> {
        self.0.set_line(line)
    }
    fn waker(&self) -> Waker {
        self.0.waker()
    }
    fn runs_by_itself(&self) -> bool {
        self.0.runs_by_itself()
    }
    fn describe(&self) -> String {
        self.0.describe()
    }
    fn losses(&self) -> Losses {
        self.0.losses()
    }
    fn reopen(&self) -> Result<Box<dyn Link<M>>, LinkError> {
        self.0.reopen()
    }
}
