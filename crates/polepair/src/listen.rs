//! Listens to a link without sending.
//!
//! ```
//! # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! let connector = polepair::Connector::default(); // `with_taps` gives it taps
//! let listening = connector.listen("sim:tmcl+can")?;
//! assert_eq!(listening.wires()[0].protocols, ["tmcl"]);
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```

use crate::connect::Connector;
use crate::error::Error;
use crate::protocol_line::ProtocolLine;
use crate::url::Url;
use crate::wire::{AnyLink, OpenWire, SharedLink};
use polepair_core::medium::{Can, CanLine, Medium, SerialLine, Stream};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::Instant;
use polepair_link::{LinkError, Losses, ServeThread};

/// Wires with a listening thread each, until this is dropped. Received frames go to the connector's taps as
/// frames of a drive, because their sender is unknown.
#[derive(Debug)]
pub struct WireListener {
    wires: Vec<OpenWire>,
    threads: Vec<ListenerThread>,
}

struct ListenerThread {
    link: SharedLink,
    handle: ServeThread,
}

impl Connector {
    /// Opens the links of a string and listens. No request is sent, so axes are not searched. A CAN
    /// controller still acknowledges frames.
    ///
    /// # Errors
    /// [`Error::Usage`] for an invalid connection string, [`Error::Link`] if it cannot be opened.
    pub fn listen(&self, text: &str) -> Result<WireListener, Error> {
        let (lines, _) = self.open_lines(&self.url(text)?)?;
        let mut listening = WireListener { wires: Vec::new(), threads: Vec::new() };
        for lines in lines.chunk_by(|one, other| one.wire == other.wire) {
            listening.wires.extend(ProtocolLine::open_wire(lines));
            listening
                .threads
                .extend(lines.first().map(|line| ListenerThread::new(line.link.clone())));
        }
        Ok(listening)
    }
}

impl Connector {
    /// Opens what the string names, as it is: for programs that speak for themselves. Of a simulation
    /// the drives are at the other ends.
    ///
    /// # Errors
    /// As [`listen`](Self::listen).
    pub fn open(&self, text: &str) -> Result<Vec<AnyLink>, Error> {
        Ok(self.open_wires(text)?.links())
    }

    /// Opens the wires for programs that also want to [stop](crate::stop::stop_on) their motions.
    ///
    /// # Errors
    /// As [`listen`](Self::listen).
    pub fn open_wires(&self, text: &str) -> Result<RawWires, Error> {
        let url = self.url(text)?;
        let (lines, _) = self.open_lines(&url)?;
        Ok(RawWires { url, lines })
    }
}

/// Open wires without any request sent.
pub struct RawWires {
    pub(crate) url: Url,
    pub(crate) lines: Vec<ProtocolLine>,
}

impl RawWires {
    /// Every wire, in the order in which [taps](Connector::with_taps) count them.
    #[must_use]
    pub fn wires(&self) -> Vec<OpenWire> {
        self.by_wire().filter_map(ProtocolLine::open_wire).collect()
    }

    /// Their links, in that order. They stay open as long as one of them, or this, is there.
    #[must_use]
    pub fn links(&self) -> Vec<AnyLink> {
        let first = self.by_wire().filter_map(<[ProtocolLine]>::first);
        first.map(|line| line.link.clone().into()).collect()
    }

    pub(crate) fn by_wire(&self) -> impl Iterator<Item = &[ProtocolLine]> {
        self.lines.chunk_by(|one, other| one.wire == other.wire)
    }
}

impl std::fmt::Debug for RawWires {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Opened").field(&self.url).finish()
    }
}

impl WireListener {
    /// Every wire, in the order in which [taps](Connector::with_taps) count them.
    #[must_use]
    pub fn wires(&self) -> &[OpenWire] {
        &self.wires
    }

    /// Units on a wire that were received and could not be handed on.
    #[must_use]
    pub fn losses(&self, wire: usize) -> Losses {
        self.threads
            .get(wire)
            .map_or_else(Losses::default, |listener_thread| listener_thread.link.losses())
    }

    /// The error that ended the listening on a wire; returned once.
    pub fn take_error(&mut self) -> Option<LinkError> {
        let at =
            self.threads.iter().position(|listener_thread| listener_thread.handle.is_finished())?;
        self.threads.remove(at).handle.join().err()
    }
}

impl std::fmt::Debug for ListenerThread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Ear").field(&self.link.describe()).finish()
    }
}

impl ListenerThread {
    fn new(link: SharedLink) -> Self {
        let handle = match link.clone() {
            SharedLink::Serial(link) => ServeThread::new(
                Box::new(link),
                Box::new(SilentStation::<Stream>(SerialLine::new_8n1(0))),
            ),
            SharedLink::Can(link) => ServeThread::new(
                Box::new(link),
                Box::new(SilentStation::<Can>(CanLine { bit_rate: 0 })),
            ),
        };
        Self { link, handle }
    }
}

/// A station that never sends. The link's tap receives, and the line keeps its settings.
struct SilentStation<M: Medium>(M::Line);

impl<M: Medium> Timed for SilentStation<M> {
    fn handle_timeout(&mut self, _now: Instant) {}

    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
}

impl<M: Medium> Station<M> for SilentStation<M> {
    fn handle_input(&mut self, _now: Instant, _unit: &M::Unit) {}

    fn handle_line(&mut self, _now: Instant, _event: LineEvent) {}

    fn poll_transmit(&mut self, _now: Instant, _out: &mut M::Out) -> Option<usize> {
        None
    }

    fn line(&self) -> M::Line {
        self.0
    }
}
