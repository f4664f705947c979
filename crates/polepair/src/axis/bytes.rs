//! Requests in the protocol's own bytes.

use super::{Axis, Running};
use crate::error::Error;
use polepair_core::error::WireError;
use polepair_core::explain::{
    Addressing, Context, Direction, Dissector, Encoded, Field, Sink, Via,
};
use polepair_core::medium::STREAM_UNIT_MAX;
use polepair_core::proto;

/// The greatest CAN identifier of 11 bits.
const STANDARD_MAX: u32 = 0x7FF;

impl Axis {
    /// Sends a request in the protocol's own bytes, a whole frame with its check, and gives the value
    /// answered; as [`raw`](Self::raw). On CAN `id` is the frame's identifier.
    ///
    /// # Errors
    /// `E221` for bytes that are no request to this axis which the protocol's own text could say; nothing
    /// was sent. Others by blame.
    pub fn raw_bytes(&self, bytes: &[u8], id: Option<u32>) -> Result<i64, Error> {
        self.start_raw_bytes(bytes, id)?.finish()
    }

    /// Begins a request in the protocol's own bytes, and does not wait for the answer: as
    /// [`raw_bytes`](Self::raw_bytes).
    ///
    /// # Errors
    /// As [`raw_bytes`](Self::raw_bytes); nothing was sent.
    pub fn start_raw_bytes(&self, bytes: &[u8], id: Option<u32>) -> Result<Running, Error> {
        let (dissector, text) = self.text_of(bytes, id)?;
        // Behind a colon, and in parentheses, is prose, where explaining puts some.
        let command = [" (", ":"].map(|mark| text.split(mark).next().unwrap_or(&text));
        let mut known = [&*text, command[0], command[1]].into_iter();
        let says = |text: &&str| self.says(dissector, text, (bytes, id));
        let started = known.by_ref().filter(says).map(|text| self.start_raw(text));
        let mut read = started.filter(|started| !matches!(started, Err(e) if e.code() == "E221"));
        let no = || self.no_request(&format!("these bytes are no request to it: {text}"));
        read.next().unwrap_or_else(|| Err(no()))
    }

    fn no_request(&self, what: &str) -> Error {
        let what = format!("{}: {what}", self.label());
        Error::usage("E221", what, "nothing was sent; `explain` tells what bytes mean")
    }

    /// What the bytes say. Whatever may move a motor, or write its flash, is known by its words: so
    /// only what has words is sent, and only when those give the very bytes back.
    fn text_of(
        &self,
        bytes: &[u8],
        id: Option<u32>,
    ) -> Result<(&'static dyn Dissector, String), Error> {
        let dissector = proto::dissector(self.protocol)
            .ok_or_else(|| self.no_request("its protocol has no words for bytes"))?;
        let context = Context {
            direction: Some(Direction::ToDrive),
            profile: Some(self.profile),
            id,
            extended: id.is_some_and(|id| id > STANDARD_MAX),
            ..Context::default()
        };
        let mut said = Said::default();
        dissector.explain(bytes, &context, &mut said);
        match said {
            Said { wrong: Some(wrong), .. } => {
                Err(self.no_request(&format!("these bytes break {}: {wrong}", self.protocol)))
            }
            Said { axis: Some(axis), .. } if axis != self.number => {
                Err(self.no_request(&format!("these bytes are for axis {axis}")))
            }
            Said { text, .. } => Ok((dissector, text)),
        }
    }

    /// Whether a text is encoded as these bytes, on whichever wire.
    fn says(&self, dissector: &dyn Dissector, text: &str, frame: (&[u8], Option<u32>)) -> bool {
        let mut out = [0; STREAM_UNIT_MAX];
        [Via::Usual, Via::Serial, Via::Rs485, Via::Can].into_iter().any(|via| {
            let (axis, profile) = (Some(self.number), Some(self.profile));
            let addressing = Addressing { axis, groups: false, host: None, profile, via };
            let encoded = dissector.encode(text, &addressing, &mut out);
            encoded.is_ok_and(|Encoded { len, id, .. }| (&out[..len], id) == frame)
        })
    }
}

/// Takes the words of a frame.
#[derive(Default)]
struct Said {
    text: String,
    axis: Option<u32>,
    wrong: Option<WireError>,
}

impl Sink for Said {
    fn kind(&mut self, _kind: &str) {}

    fn axis(&mut self, axis: u32) {
        self.axis = Some(axis);
    }

    fn field(&mut self, _field: Field<'_>) {}

    fn text(&mut self, piece: &str) {
        self.text.push_str(piece);
    }

    fn error(&mut self, error: WireError) {
        self.wrong.get_or_insert(error);
    }
}
