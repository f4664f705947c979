//! Who answers whom on a half-duplex line: the request that a reply belongs to, and the host's own
//! bytes heard back through an RS-485 adapter.

/// The last request on a link and what followed it.
#[derive(Debug, Default)]
pub(crate) struct Conversation {
    request: Vec<u8>,
    asked: bool,
    replies: u32,
    first_was_same: bool,
    echoes: bool,
}

impl Conversation {
    pub(crate) fn with_echo(echoes: bool) -> Self {
        Self { echoes, ..Self::default() }
    }

    /// True once the host was seen to hear itself.
    pub(crate) fn echoes(&self) -> bool {
        self.echoes
    }

    /// The request that the next reply answers.
    pub(crate) fn request(&self) -> Option<&[u8]> {
        self.asked.then_some(&self.request)
    }

    /// Takes a frame from the host.
    pub(crate) fn ask(&mut self, frame: &[u8]) {
        self.request.clear();
        self.request.extend_from_slice(frame);
        self.asked = true;
        self.replies = 0;
    }

    /// Takes a frame towards the host, and tells whether it is the request heard back. A reply may
    /// equal its request (Modbus 06), so an equal frame alone proves nothing: it is an echo when
    /// more follows it at once (`glued`), or when this link was seen to echo before.
    pub(crate) fn is_echo(&mut self, frame: &[u8], glued: bool) -> bool {
        let same = self.asked && frame == self.request;
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
