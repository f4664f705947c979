//! Requests as text of the protocol.

use super::failure::RequestKind;
use super::{LocalAxis, Rehearsal, RunningRequest};
use crate::error::Error;
use crate::registry;
use crate::url::AxisNumber;
use polepair_core::convert::text_from;
use polepair_core::error::Unsupported;
use polepair_core::explain::{EncodeError, EncodeOptions, Impact};
use polepair_core::medium::STREAM_UNIT_MAX;
use polepair_core::station::LineChange;
use polepair_core::time::Instant;

/// Rehearsal of a request in the protocol's own text: see [`LocalAxis::rehearse_raw`].
#[derive(Clone, PartialEq, Debug)]
pub struct RawRehearsal {
    /// Frames of the request.
    pub frames: Vec<Rehearsal>,
    /// True if it may start or change motion, or has an effect that cannot be undone: it needs an armed axis.
    pub needs_arming: bool,
    /// True if it stops the motor.
    pub is_stop: bool,
    /// Change of the drive's place on its wire.
    pub line_change: Option<LineChange>,
}

impl LocalAxis {
    /// Sends a request in the protocol's own text, such as `GAP 1`, and gives the value answered.
    ///
    /// # Errors
    /// [`Error`] by blame; `E221` for text that is not of that language, with the place; `E219` for
    /// what may start a motor while the axis is not armed.
    pub fn raw(&self, text: &str) -> Result<i64, Error> {
        self.start_raw(text)?.finish()
    }

    /// Begins a request in the protocol's own text, and does not wait for the answer: as
    /// [`raw`](Self::raw).
    ///
    /// # Errors
    /// As [`raw`](Self::raw); nothing was sent.
    pub fn start_raw(&self, text: &str) -> Result<RunningRequest, Error> {
        self.rehearse_raw(text)?;
        let what = format!("`{text}`");
        let submitted = self.connection.submit_in_turn(Instant::FAR_FUTURE, |axes, now, ticket| {
            axes.send_text(now, ticket, self.index, text)
        });
        let started = self.running(what, RequestKind::Command, submitted);
        started.map_err(|error| self.locate_in_text(text, error))
    }

    /// Rehearses a request in the protocol's own text. Nothing is sent.
    ///
    /// # Errors
    /// `E221` for text that is not of that language, with the place.
    pub fn rehearse_raw(&self, text: &str) -> Result<RawRehearsal, Error> {
        let mut frames = Vec::new();
        let rehearsal = self
            .connection
            .with_axes(|axes, _| {
                axes.rehearse_text(self.index, text, &mut |step| {
                    let (bytes, frame) = (step.bytes.to_vec(), step.frame.copied());
                    frames.push(Rehearsal { step: step.action, bytes, frame });
                })
            })
            .map_err(|why| self.unsupported_error(&format!("`{text}`"), why))
            .map_err(|error| self.locate_in_text(text, error))?;
        if rehearsal.moves_bytes {
            let what = format!("{}: `{text}` transfers bytes of any length", self.label());
            let hint = "`get URL ADDRESS:bytes -o FILE` reads them, \
                        `set URL ADDRESS:bytes=@FILE` writes them";
            return Err(Error::usage("E222", what, hint));
        }
        Ok(RawRehearsal {
            frames,
            needs_arming: rehearsal.effect.impact >= Impact::Motion,
            is_stop: rehearsal.is_stop,
            line_change: rehearsal.line_change,
        })
    }

    /// The read of what a request in the protocol's own text wrote; `None` if it writes nothing, and for protocols
    /// whose broadcast has replies or does not exist.
    #[must_use]
    pub fn read_back_text(&self, text: &str) -> Option<String> {
        let protocol = registry::find_protocol(self.protocol, self.medium)?;
        let mut read = String::new();
        (protocol.read_back)(text, self.profile, &mut read).then_some(read)
    }

    /// Returns whether it is all stations of a line, none of which answers.
    #[must_use]
    pub fn is_unanswered_broadcast(&self) -> bool {
        registry::find_protocol(self.protocol, self.medium)
            .is_some_and(|protocol| protocol.is_unanswered(self.number))
    }

    /// Adds the position of an error in a text, if the protocol's language reports it.
    fn locate_in_text(&self, text: &str, error: Error) -> Error {
        if !matches!(error, Error::Unsupported { why: Unsupported::BadText, .. }) {
            return error;
        }
        let number = AxisNumber(self.number);
        let options = EncodeOptions {
            axis: (!number.is_group()).then_some(self.number),
            profile: Some(self.profile),
            ..EncodeOptions::default()
        };
        let mut frame = [0; STREAM_UNIT_MAX];
        let hint = format!("`polepair encode {} TEXT` shows what a text becomes", self.protocol);
        let encoded = self.dissector().map(|known| known.encode(text, &options, &mut frame));
        let what = match encoded {
            Some(Err(EncodeError::Text(wrong))) => {
                let rest = text_from(text, wrong.at).trim();
                let place = match rest {
                    "" => "at its end".to_owned(),
                    rest => format!("at `{rest}`"),
                };
                format!("`{text}`: expected {} {place}", wrong.expected)
            }
            Some(Err(EncodeError::Forbidden(rule))) => format!("`{text}`: {rule}"),
            _ => format!("`{text}` is not a request from a host to one drive"),
        };
        Error::usage("E221", format!("{}: {what}", self.label()), hint)
    }
}
