//! Pairs replies with their requests, and detects the host's own bytes that an RS-485 adapter echoes.

use std::collections::VecDeque;

use polepair_core::explain::{Dissector, RawFrame};

/// Requests of a link that are remembered: as many as a relay or a CAN bus may have under way.
const REQUESTS_MAX: usize = 32;

/// The latest requests on a link and what followed them.
#[derive(Debug, Default)]
pub(crate) struct Conversation {
    /// The newest is the last.
    requests: VecDeque<RecentRequest>,
    reply_count: u32,
    first_matched: bool,
    has_echo: bool,
}

/// A request as it was on the wire.
#[derive(Debug, Default)]
struct RecentRequest {
    bytes: Vec<u8>,
    id: Option<u32>,
    extended: bool,
}

impl RecentRequest {
    fn raw(&self) -> RawFrame<'_> {
        RawFrame { bytes: &self.bytes, id: self.id, extended: self.extended }
    }
}

impl Conversation {
    pub(crate) fn with_echo(has_echo: bool) -> Self {
        Self { has_echo, ..Self::default() }
    }

    /// True once the host was seen to hear itself.
    pub(crate) fn has_echo(&self) -> bool {
        self.has_echo
    }

    /// The request that `reply` answers: the newest that it repeats, otherwise the last on a serial line, where replies
    /// follow requests.
    pub(crate) fn find_request(
        &self,
        dissector: &dyn Dissector,
        reply: &RawFrame<'_>,
    ) -> Option<RawFrame<'_>> {
        let mut requests = self.requests.iter().rev().map(RecentRequest::raw);
        let raw_frame = requests.find(|request| dissector.is_answer_to(reply, request));
        let in_turns = reply.id.is_none() && !dissector.has_transactions();
        let last = self.requests.back().filter(|_| in_turns).map(RecentRequest::raw);
        raw_frame.or(last)
    }

    /// The last request, while nothing followed it.
    pub(crate) fn open_request(&self) -> Option<RawFrame<'_>> {
        self.requests.back().filter(|_| self.reply_count == 0).map(RecentRequest::raw)
    }

    /// Takes a request.
    pub(crate) fn push_request(&mut self, request: &RawFrame<'_>) {
        let full = self.requests.len() == REQUESTS_MAX;
        let mut recent_request =
            if full { self.requests.pop_front() } else { None }.unwrap_or_default();
        recent_request.bytes.clear();
        recent_request.bytes.extend_from_slice(request.bytes);
        (recent_request.id, recent_request.extended) = (request.id, request.extended);
        self.requests.push_back(recent_request);
        self.reply_count = 0;
    }

    /// Takes a frame towards the host, and returns whether it is the echo of the request. Some replies are
    /// equal to their request (Modbus 06), so an equal frame is an echo only if it is not a valid reply, if
    /// more follows it at once (`glued`), or if this link had an echo before.
    pub(crate) fn detect_echo(
        &mut self,
        dissector: &dyn Dissector,
        frame: &RawFrame<'_>,
        glued: bool,
    ) -> bool {
        let last = self.requests.back().filter(|_| !dissector.has_transactions());
        let last = last.map(RecentRequest::raw).filter(|request| request.bytes == frame.bytes);
        let same = last.is_some();
        let glued = glued || last.is_some_and(|request| !dissector.is_answer_to(frame, &request));
        self.reply_count += 1;
        if self.reply_count > 1 {
            self.has_echo |= self.first_matched;
            return false;
        }
        self.first_matched = same;
        self.has_echo |= same && glued;
        same && self.has_echo
    }
}
