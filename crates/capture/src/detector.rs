//! Detects the protocol of a capture. All registered dissectors read it, or a sample of a long one. The
//! protocol that explains most of the bytes is selected. If identifiers and checksums are ambiguous on CAN,
//! replies that match requests decide; otherwise the result is undecided.
//!
//! On CAN a protocol needs evidence: content that could have been wrong and is not. Identifiers alone are
//! none, because every maker uses them.
//!
//! A detector weighs every record until the result is certain, and from then on a sample and the first
//! frames of each new identifier.
//!
//! Why: DEC-15.

mod ahead;
mod evidence;
mod foreign;
mod pairs;
mod sampler;
mod score;
#[cfg(test)]
mod tests;
mod verdict;

use std::collections::BTreeMap;

use polepair_core::explain::Dissector;
use polepair_core::medium::Frame;
use polepair_core::proto;

use crate::decoder::CaptureDecoder;
use crate::detection::LinkDetection;
use crate::read::{CaptureReader, ReadOptions};
use crate::record::Record;
use foreign::ForeignCounts;
use sampler::RecordSampler;
use score::CandidateProtocol;
use verdict::Verdict;

/// Share of bytes that a weak check (an 8-bit sum over nine bytes, tried at every offset) explains
/// by chance: 9 in 256.
const CHANCE_SHARE: f64 = 9.0 / 256.0;
/// Share of a serial line's bytes that must be in frames with a check that agrees. Protocols of others with a sum in
/// each frame come up to 0.15.
const CHECKED_MIN: f64 = 0.2;
/// A frame whose check fails is worth this share of one that is right.
const BROKEN_WEIGHT: f64 = 0.1;
/// Two protocols on CAN whose shares differ by less explain a bus equally well.
const TIE_MARGIN: f64 = 0.02;

/// Share of the checkable CAN frames that must support a protocol.
const SUPPORT_MIN: f64 = 0.75;
/// Share of the bytes below which the confidence falls.
const EXPLAINED_MIN: f64 = 0.5;
/// Bits that a supporting CAN frame is worth: the chance that another one looks like it is 1 in 32.
const EVIDENCE_BITS: u64 = 5;
/// Confidence from which the result can be certain. Chance alone keeps it below 0.97.
const CERTAIN_CONFIDENCE: f64 = 0.9;
/// Bits of evidence that each protocol of a certain result has.
const CERTAIN_BITS: u64 = 40;

/// Axes of a link that are remembered: as many as a CAN bus can have with 11-bit identifiers.
const AXES_MAX: usize = 127;
/// Identifiers of a link that are remembered: as many as there are with 11 bits.
const IDS_MAX: usize = 2048;

/// Detects the protocols of a capture.
#[derive(Debug)]
pub struct ProtocolDetector {
    reader: CaptureReader,
    options: ReadOptions,
    weighing: Weighing,
}

/// The protocols that are weighed, and how far that is.
#[derive(Debug)]
struct Weighing {
    candidates: Vec<CandidateProtocol>,
    sampler: RecordSampler,
    /// Shapes of the records of each link.
    foreign: BTreeMap<String, ForeignCounts>,
}

impl ProtocolDetector {
    /// Nothing weighed yet.
    #[must_use]
    pub fn new() -> Self {
        Self::with_read_options(ReadOptions::default())
    }

    /// A detector that reads the capture with these options.
    #[must_use]
    pub fn with_read_options(options: ReadOptions) -> Self {
        let candidates = proto::dissectors().iter().copied().map(CandidateProtocol::new).collect();
        let (sampler, foreign) = (RecordSampler::default(), BTreeMap::new());
        let weighing = Weighing { candidates, sampler, foreign };
        Self { reader: CaptureReader::new(options), options, weighing }
    }

    /// Takes a piece of the capture, cut anywhere.
    pub fn feed(&mut self, piece: &[u8]) {
        let Self { reader, weighing, .. } = self;
        reader.feed(piece, &mut |record| weighing.weigh(record));
    }

    /// The results, one a link, and a decoder by them.
    #[must_use]
    pub fn decide(mut self) -> (Vec<LinkDetection>, CaptureDecoder) {
        self.finish();
        let found = self.weighing.verdict().found;
        let decoder = CaptureDecoder::from_detection(found.rules, found.echo_links);
        (found.links, decoder.with_read_options(self.options))
    }

    /// The capture ends.
    fn finish(&mut self) {
        let Self { reader, weighing, .. } = self;
        reader.finish(&mut |record| weighing.weigh(record));
        weighing.candidates.iter_mut().for_each(CandidateProtocol::finish);
    }
}

impl Weighing {
    /// Lets every protocol read a record that is weighed.
    fn weigh(&mut self, record: &Record<'_>) {
        if self.sampler.select(record) {
            self.candidates.iter_mut().for_each(|candidate| candidate.score_record(record));
            if let Some(counts) = self.foreign.get_mut(record.link) {
                counts.observe(record);
            } else {
                self.foreign.entry(record.link.to_owned()).or_default().observe(record);
            }
        }
        if self.sampler.is_checkpoint() {
            let certain = self.verdict().is_certain();
            self.sampler.end_window(certain);
        }
    }

    fn verdict(&self) -> Verdict {
        let skipped = &|link: &str| self.sampler.has_skipped(link);
        let mut verdict = verdict::judge(&self.candidates, &self.foreign, skipped);
        verdict.has_unclaimed = verdict.found.links.iter().any(|link| {
            self.sampler.ids_of(&link.link).any(|frame| leaves_to_others(link, &frame))
        });
        verdict
    }
}

impl Default for ProtocolDetector {
    fn default() -> Self {
        Self::new()
    }
}

/// Returns whether none of the link's protocols claims a frame, and another one does.
fn leaves_to_others(link: &LinkDetection, frame: &Frame) -> bool {
    let claims = |dissector: &'static dyn Dissector| score::claims_frame(dissector, frame);
    !link.protocols().any(claims) && proto::dissectors().iter().copied().any(claims)
}
