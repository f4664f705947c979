//! Requests as bytes of the protocol.

use super::failure::RequestKind;
use super::{LocalAxis, RunningRequest};
use crate::error::Error;
use polepair_core::error::{Unsupported, WireError};
use polepair_core::explain::{Context, Direction, ExplainSink, Field, RawFrame};
use polepair_core::proto;
use polepair_core::time::Instant;

/// The greatest CAN identifier of 11 bits.
const STANDARD_MAX: u32 = 0x7FF;

impl LocalAxis {
    /// Sends a request in the protocol's own bytes, a whole frame with its check, and gives the value
    /// answered; as [`raw`](Self::raw). On CAN `id` is the frame's identifier.
    ///
    /// # Errors
    /// `E221` for bytes that are no request of the protocol to this axis; nothing was sent. Others by blame.
    pub fn raw_bytes(&self, bytes: &[u8], id: Option<u32>) -> Result<i64, Error> {
        self.start_raw_bytes(bytes, id)?.finish()
    }

    /// Begins a request in the protocol's own bytes, and does not wait for the answer: as
    /// [`raw_bytes`](Self::raw_bytes).
    ///
    /// # Errors
    /// As [`raw_bytes`](Self::raw_bytes); nothing was sent.
    pub fn start_raw_bytes(&self, bytes: &[u8], id: Option<u32>) -> Result<RunningRequest, Error> {
        let extended = id.is_some_and(|id| id > STANDARD_MAX);
        self.check_bytes(bytes, id, extended)?;
        let frame = RawFrame { bytes, id, extended };
        let digits: Vec<String> = bytes.iter().map(|byte| format!("{byte:02X}")).collect();
        let submitted = self.connection.submit_in_turn(Instant::FAR_FUTURE, |axes, now, ticket| {
            axes.send_frame(now, ticket, self.index, &frame)
        });
        let what = format!("`{}`", digits.join(" "));
        let started = self.running(what, RequestKind::Command, submitted);
        started.map_err(|error| match error {
            Error::Unsupported { why: Unsupported::BadBytes, .. } => {
                self.bad_request_error("these bytes are not a request to this axis")
            }
            other => other,
        })
    }

    fn bad_request_error(&self, what: &str) -> Error {
        let what = format!("{}: {what}", self.label());
        Error::usage("E221", what, "`polepair explain` explains bytes")
    }

    /// Refuses what breaks the protocol, or is another axis', with the reason.
    fn check_bytes(&self, bytes: &[u8], id: Option<u32>, extended: bool) -> Result<(), Error> {
        let dissector = proto::find_dissector(self.protocol)
            .ok_or_else(|| self.bad_request_error("its protocol has no requests as bytes"))?;
        let direction = Some(Direction::ToDrive);
        let profile = Some(self.profile);
        let context = Context { direction, profile, id, extended, ..Context::default() };
        let mut frame_inspector = FrameInspector::default();
        dissector.explain(bytes, &context, &mut frame_inspector);
        match frame_inspector {
            FrameInspector { error: Some(wrong), .. } => {
                Err(self
                    .bad_request_error(&format!("these bytes break {}: {wrong}", self.protocol)))
            }
            FrameInspector { axis: Some(axis), .. } if axis != self.number => {
                Err(self.bad_request_error(&format!("these bytes are for axis {axis}")))
            }
            FrameInspector { .. } => Ok(()),
        }
    }
}

/// Reads the axis of a frame, and its faults.
#[derive(Default)]
struct FrameInspector {
    axis: Option<u32>,
    error: Option<WireError>,
}

impl ExplainSink for FrameInspector {
    fn kind(&mut self, _kind: &str) {}

    fn axis(&mut self, axis: u32) {
        self.axis = Some(axis);
    }

    fn field(&mut self, _field: Field<'_>) {}

    fn text(&mut self, _piece: &str) {}

    fn wants_text(&self) -> bool {
        false
    }

    fn wants_values(&self) -> bool {
        false
    }

    fn error(&mut self, error: WireError) {
        self.error.get_or_insert(error);
    }
}
