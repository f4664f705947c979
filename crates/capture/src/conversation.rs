//! Who answers whom: the request that a reply belongs to, and the host's own bytes heard back
//! through an RS-485 adapter.

use std::collections::VecDeque;

use polepair_core::explain::{Dissector, Raw};

/// Requests of a link that are remembered: as many as a relay or a CAN bus may have under way.
const REQUESTS_MAX: usize = 32;

/// The latest requests on a link and what followed them.
#[derive(Debug, Default)]
pub(crate) struct Conversation {
    /// The newest is the last.
    requests: VecDeque<Asked>,
    replies: u32,
    first_was_same: bool,
    echoes: bool,
}

/// A request as it stood on the wire.
#[derive(Debug, Default)]
struct Asked {
    bytes: Vec<u8>,
    id: Option<u32>,
    extended: bool,
}

impl Asked {
    fn raw(&self) -> Raw<'_> {
        Raw { bytes: &self.bytes, id: self.id, extended: self.extended }
    }
}

impl Conversation {
    pub(crate) fn with_echo(echoes: bool) -> Self {
        Self { echoes, ..Self::default() }
    }

    /// True once the host was seen to hear itself.
    pub(crate) fn echoes(&self) -> bool {
        self.echoes
    }

    /// The request that `reply` answers: the newest of which it says so, else the last on a serial
    /// line, where one follows the other.
    pub(crate) fn request(&self, dissector: &dyn Dissector, reply: &Raw<'_>) -> Option<Raw<'_>> {
        let mut requests = self.requests.iter().rev().map(Asked::raw);
        let said = requests.find(|request| dissector.answers(reply, request));
        let last = self.requests.back().filter(|_| reply.id.is_none()).map(Asked::raw);
        said.or(last)
    }

    /// The last request, while nothing followed it.
    pub(crate) fn open(&self) -> Option<Raw<'_>> {
        self.requests.back().filter(|_| self.replies == 0).map(Asked::raw)
    }

    /// Takes a request.
    pub(crate) fn ask(&mut self, request: &Raw<'_>) {
        let full = self.requests.len() == REQUESTS_MAX;
        let mut asked = if full { self.requests.pop_front() } else { None }.unwrap_or_default();
        asked.bytes.clear();
        asked.bytes.extend_from_slice(request.bytes);
        (asked.id, asked.extended) = (request.id, request.extended);
        self.requests.push_back(asked);
        self.replies = 0;
    }

    /// Takes a frame towards the host, and tells whether it is the request heard back. A reply may
    /// equal its request (Modbus 06), so an equal frame alone proves nothing: it is an echo when
    /// more follows it at once (`glued`), or when this link was seen to echo before.
    pub(crate) fn is_echo(&mut self, frame: &[u8], glued: bool) -> bool {
        let same = self.requests.back().is_some_and(|asked| asked.bytes == frame);
        self.replies += 1;
        if self.replies > 1 {
            self.echoes |= self.first_was_same;
            return false;
        }
        self.first_was_same = same;
        self.echoes |= same && glued;
        same && self.echoes
    }
}
