//! Reads ahead of a decoder to detect the protocols.

use core::fmt;
use std::io::{self, Read};

use polepair_core::medium::Frame;
use polepair_core::proto;

use super::{ProtocolDetector, score};
use crate::decoder::CaptureDecoder;
use crate::detection::{DetectedProtocols, ProtocolSource};
use crate::read::ReadOptions;

/// Bytes that are read at once.
const PIECE_BYTES: u64 = 1 << 16;

/// A detector that reads a capture by itself, as far as it has to.
struct LookAhead {
    /// The capture from its beginning.
    source: Box<dyn Read + Send>,
    detector: ProtocolDetector,
    ended: bool,
}

impl fmt::Debug for LookAhead {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ended: {}, {:?}", self.ended, self.detector)
    }
}

impl LookAhead {
    fn new(source: Box<dyn Read + Send>, detector: ProtocolDetector) -> Self {
        Self { source, detector, ended: false }
    }
}

impl ProtocolSource for LookAhead {
    fn read(&mut self, met: Option<(&str, Option<&Frame>)>) -> io::Result<DetectedProtocols> {
        let mut piece = Vec::with_capacity(PIECE_BYTES as usize);
        while !self.ended {
            let sampler = &self.detector.weighing.sampler;
            let has_met = met.is_none_or(|(link, frame)| sampler.has_seen(link, frame));
            // A frame of an identifier that the look-ahead has not met could be of another protocol.
            if has_met && sampler.is_certain() {
                break;
            }
            piece.clear();
            (&mut self.source).take(PIECE_BYTES).read_to_end(&mut piece)?;
            if piece.is_empty() {
                // Waiting bytes of serial flows are decided at the end of the file.
                self.detector.finish();
                self.ended = true;
            } else {
                self.detector.feed(&piece)
            }
        }
        Ok(self.detector.weighing.verdict().found)
    }

    fn covers(&self, link: &str, frame: Option<&Frame>) -> bool {
        self.ended
            || self.detector.weighing.sampler.has_seen(link, frame)
            || frame.is_some_and(|frame| !is_claimed_frame(frame))
    }
}

impl CaptureDecoder {
    /// A decoder that detects the protocols itself. `source` is the capture from its beginning: it is
    /// read ahead of the decoded part, until the result is certain for the links and identifiers that have
    /// come, and further when a new one comes.
    ///
    /// # Errors
    /// The source cannot be read.
    pub fn detect(source: Box<dyn Read + Send>, options: ReadOptions) -> io::Result<Self> {
        let detector = ProtocolDetector::with_read_options(options);
        let mut look_ahead = LookAhead::new(source, detector);
        let found = look_ahead.read(None)?;
        Ok(Self::with_protocol_source(found, Box::new(look_ahead)).with_read_options(options))
    }
}

fn is_claimed_frame(frame: &Frame) -> bool {
    proto::dissectors().iter().any(|dissector| score::claims_frame(*dissector, frame))
}
