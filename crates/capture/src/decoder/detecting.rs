//! Detects the protocols of a capture while it is decoded.

use polepair_core::medium::Frame;

use super::CaptureDecoder;
use crate::detection::{DetectedProtocols, LinkDetection, ProtocolSource};
use crate::record::STANDARD_MAX;

/// Identifiers of 11 bits for which the detection holds.
#[derive(Debug)]
pub(super) struct CoveredIds([u64; (STANDARD_MAX as usize + 1) / 64]);

impl Default for CoveredIds {
    fn default() -> Self {
        Self([0; _])
    }
}

impl CoveredIds {
    const fn contains(&self, frame: &Frame) -> bool {
        !frame.extended
            && frame.id <= STANDARD_MAX
            && self.0[frame.id as usize / 64] & 1 << (frame.id % 64) != 0
    }

    const fn insert(&mut self, frame: &Frame) {
        if !frame.extended && frame.id <= STANDARD_MAX {
            self.0[frame.id as usize / 64] |= 1 << (frame.id % 64);
        }
    }
}

impl CaptureDecoder {
    /// A decoder by the protocols found so far, which finds those of new links and identifiers in `source`.
    pub(crate) fn with_protocol_source(
        found: DetectedProtocols,
        source: Box<dyn ProtocolSource>,
    ) -> Self {
        Self {
            protocol_source: Some(source),
            first_detections: found.links.clone(),
            detections: found.links,
            ..Self::from_detection(found.rules, found.echo_links)
        }
    }

    /// Protocols of each link, as far as they were detected by now.
    #[must_use]
    pub fn detections(&self) -> &[LinkDetection] {
        &self.detections
    }

    /// Detections that differ from those before the first frame was decoded.
    pub fn later_detections(&self) -> impl Iterator<Item = &LinkDetection> {
        self.detections.iter().filter(move |later| !self.is_first_detection(later))
    }

    fn is_first_detection(&self, later: &LinkDetection) -> bool {
        self.first_detections.iter().any(|first| first.has_same_protocols(later))
    }

    /// Before a frame is decoded: detects further if its identifier is new.
    #[inline]
    pub(super) fn detect_for_frame(&mut self, at: usize, frame: &Frame) {
        if self.protocol_source.is_none() || self.links[at].covered.contains(frame) {
            return;
        }
        let name = std::sync::Arc::clone(&self.links[at].name);
        self.detect_for(&name, Some(frame));
        // Also when reading ahead failed: the error would come again with every frame.
        self.links[at].covered.insert(frame);
    }

    /// Detects further if a link, or the identifier of a frame on it, is new.
    pub(super) fn detect_for(&mut self, link: &str, frame: Option<&Frame>) {
        let Some(source) = &mut self.protocol_source else { return };
        if source.covers(link, frame) {
            return;
        }
        // An error in reading ahead occurs again in decoding, and is reported there.
        let Ok(found) = source.read(Some((link, frame))) else { return };
        (self.detections, self.echo_links) = (found.links, found.echo_links);
        // Routes are thrown away for new rules alone: they are what makes decoding fast.
        if self.rules == found.rules {
            return;
        }
        self.rules = found.rules;
        for wire in &mut self.links {
            wire.rules = self.rules.for_link(&wire.name);
        }
        self.forget_routes();
    }
}
