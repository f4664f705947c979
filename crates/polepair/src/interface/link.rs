//! A link, on a wire of this program or of a running gateway, and its axes.

use std::fmt;
use std::time::Duration;

use super::{Axis, not_on_gateway};
use crate::connect::{Connector, LocalLink};
use crate::error::Error;
use crate::events::Events;
#[cfg(feature = "remote")]
use crate::interface::remote::{self, RemoteLink};
use crate::simulate::Simulation;

/// Schemes of a gateway's address.
const GATEWAY_SCHEMES: [&str; 4] = ["ws://", "wss://", "http://", "https://"];

/// Opens a link with the configuration that is found from the working folder upward: a wire
/// (`tmcl+serial:///dev/ttyUSB0#1`), simulated drives (`sim:tmcl`), or a running gateway
/// (`ws://127.0.0.1:7365#x,y`, feature `remote`).
///
/// # Errors
/// [`Error::Usage`] for an invalid connection string, [`Error::Link`] if it cannot be opened, [`Error::Failed`]
/// if an axis that it names does not reply, [`Error::Gateway`] if a gateway does not answer.
pub fn connect(url: &str) -> Result<Link, Error> {
    Connector::discover().connect(url)
}

/// Returns whether a connection string is a gateway's address.
#[must_use]
pub fn is_gateway(url: &str) -> bool {
    GATEWAY_SCHEMES.iter().any(|scheme| url.starts_with(scheme))
}

impl Connector {
    /// Opens a link: a wire, simulated drives, or a running gateway.
    ///
    /// # Errors
    /// As [`connect`].
    pub fn connect(&self, text: &str) -> Result<Link, Error> {
        let url = self.config.expand(text)?;
        if !is_gateway(&url) {
            return self.connect_local(text).map(Link::from);
        }
        #[cfg(feature = "remote")]
        return remote::open(&url, Default::default()).map(Link::from);
        #[cfg(not(feature = "remote"))]
        Err(Error::usage(
            "E210",
            format!("{url} is a gateway, and this program was built without its client"),
            "build `polepair` with the feature `remote`",
        ))
    }
}

/// An open link and its axes. Dropping the last handle closes it.
#[derive(Clone)]
pub struct Link {
    backend: LinkBackend,
    axes: Vec<Axis>,
}

#[derive(Clone)]
enum LinkBackend {
    Local(Box<LocalLink>),
    #[cfg(feature = "remote")]
    Remote(RemoteLink),
}

impl fmt::Debug for Link {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Link").field("url", &self.url()).field("axes", &self.axes).finish()
    }
}

impl From<LocalLink> for Link {
    fn from(link: LocalLink) -> Self {
        let axes = link.axes().iter().cloned().map(Axis::from).collect();
        Self { backend: LinkBackend::Local(Box::new(link)), axes }
    }
}

#[cfg(feature = "remote")]
impl From<RemoteLink> for Link {
    fn from(link: RemoteLink) -> Self {
        let axes = link.axes().iter().cloned().map(Axis::from).collect();
        Self { backend: LinkBackend::Remote(link), axes }
    }
}

impl Link {
    /// Connection string, or the gateway's address.
    #[must_use]
    pub fn url(&self) -> String {
        match &self.backend {
            LinkBackend::Local(link) => link.url().to_string(),
            #[cfg(feature = "remote")]
            LinkBackend::Remote(link) => link.gateway().url().to_owned(),
        }
    }

    /// Every axis, in order.
    #[must_use]
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// The axis with that number.
    ///
    /// # Errors
    /// `E212` if there is none, or several links have that number.
    pub fn axis(&self, number: u32) -> Result<Axis, Error> {
        match &self.backend {
            LinkBackend::Local(link) => link.axis(number).map(Axis::from),
            #[cfg(feature = "remote")]
            LinkBackend::Remote(_) => self.axis_named(&crate::url::AxisNumber(number).to_string()),
        }
    }

    /// The axis with that name or number; on a gateway also `LINK#NUMBER`.
    ///
    /// # Errors
    /// `E212` if there is none, or several.
    pub fn axis_named(&self, name: &str) -> Result<Axis, Error> {
        match &self.backend {
            LinkBackend::Local(link) => link.axis_named(name).map(Axis::from),
            #[cfg(feature = "remote")]
            LinkBackend::Remote(link) => {
                let mut found = link.find_axes(name)?;
                match (found.pop(), found.len()) {
                    (Some(axis), 0) => Ok(Axis::from(axis)),
                    _ => {
                        let what = format!("{name:?} is not one axis");
                        Err(Error::usage("E212", what, "give the name or number of one axis"))
                    }
                }
            }
        }
    }

    /// Stops every axis: all stops are sent before the first is waited for. On a gateway this includes axes that other
    /// clients command.
    ///
    /// # Errors
    /// The first error, after every axis was tried.
    pub fn stop_all(&self) -> Result<(), Error> {
        match &self.backend {
            LinkBackend::Local(link) => link.stop_all(),
            #[cfg(feature = "remote")]
            LinkBackend::Remote(link) => link.stop_all(),
        }
    }

    /// Closes it at once, though axes of it are still held elsewhere. No axis on a wire of this program is
    /// stopped by this; a gateway stops what this program set in motion.
    pub fn close(self) {
        match self.backend {
            LinkBackend::Local(link) => link.close(),
            #[cfg(feature = "remote")]
            LinkBackend::Remote(_) => {}
        }
    }

    /// The link with all methods of a wire that this program opened. `None` for a gateway.
    #[must_use]
    pub fn local(&self) -> Option<&LocalLink> {
        match &self.backend {
            LinkBackend::Local(link) => Some(link),
            #[cfg(feature = "remote")]
            LinkBackend::Remote(_) => None,
        }
    }

    /// The local link, or the one error for `what` that a gateway does not offer, with `hint`.
    ///
    /// # Errors
    /// [`Error::Usage`] `E257`.
    pub fn require_local(&self, what: &str, hint: &str) -> Result<&LocalLink, Error> {
        self.local().ok_or_else(|| not_on_gateway(what, hint))
    }

    /// The link of a gateway. `None` for one that this program opened.
    #[cfg(feature = "remote")]
    #[must_use]
    pub fn remote(&self) -> Option<&RemoteLink> {
        match &self.backend {
            LinkBackend::Local(_) => None,
            LinkBackend::Remote(link) => Some(link),
        }
    }

    /// The simulation behind a `sim:` link of this program.
    #[must_use]
    pub fn simulation(&self) -> Option<&Simulation> {
        self.local().and_then(LocalLink::simulation)
    }

    /// Listens to what happens on every wire and axis from now on.
    ///
    /// # Errors
    /// `E257` on a gateway; others by source.
    pub fn events(&self) -> Result<Events, Error> {
        self.require_local("events", "watch signals, or read states and faults")?.events()
    }

    /// Waits on the link's clock; in virtual time it returns at once.
    pub fn sleep(&self, span: Duration) {
        match &self.backend {
            LinkBackend::Local(link) => link.sleep(span),
            #[cfg(feature = "remote")]
            LinkBackend::Remote(_) => {
                polepair_link::clock::sleep_until(polepair_link::clock::now() + span)
            }
        }
    }
}
