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
mod pairs;
mod sampler;
mod score;
#[cfg(test)]
mod tests;
mod verdict;

use core::fmt;

use polepair_core::explain::Dissector;
use polepair_core::medium::Frame;
use polepair_core::proto;

use crate::decoder::CaptureDecoder;
use crate::number_text::plural;
use crate::read::{CaptureReader, ReadOptions};
use crate::record::Record;
pub(crate) use ahead::LookAhead;
use sampler::RecordSampler;
use score::CandidateProtocol;
pub(crate) use verdict::Verdict;

/// Share of bytes that a weak check (an 8-bit sum over nine bytes, tried at every offset) explains
/// by chance: 9 in 256.
const CHANCE_SHARE: f64 = 9.0 / 256.0;
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
}

/// Detected protocol of a capture's link, and its certainty.
#[derive(Clone)]
pub struct LinkDetection {
    /// The link.
    pub link: String,
    /// The protocol; `None` when nothing explains it, or several do equally well.
    pub protocol: Option<&'static dyn Dissector>,
    /// 0 for a guess, 1 for certainty.
    pub confidence: f64,
    /// Whole frames, among those that were weighed.
    pub frames: u64,
    /// Not all of the capture was weighed: it is long.
    pub sampled: bool,
    /// Frames whose check fails.
    pub broken_frames: u64,
    /// Protocols that explain it equally well, if nothing decides between them.
    pub tied: Vec<&'static str>,
    /// Bytes that belong to no frame.
    pub stray_bytes: u64,
    /// Protocols that explain CAN identifiers which the first leaves.
    pub secondary: Vec<&'static dyn Dissector>,
    /// The protocol that explains most beside these, and the share of the bytes it explains.
    pub runner_up: Option<(&'static str, f64)>,
    /// Axes on identifiers that this protocol shares with others and that something else proves
    /// to be its.
    pub proven_axes: Vec<(&'static dyn Dissector, u32)>,
    /// Protocols that may be used too, on identifiers that they share with others, and their axes: no frame proves
    /// them, so a person must decide.
    pub shared_axes: Vec<(&'static str, Vec<u32>)>,
}

impl fmt::Debug for LinkDetection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl fmt::Display for LinkDetection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(protocol) = self.protocol else {
            if let [first, rest @ ..] = &self.tied[..] {
                write!(f, "{}: undecided: {first}", self.link)?;
                rest.iter().try_for_each(|other| write!(f, " or {other}"))?;
                return write!(f, " explain it equally well: say which by --as {first}");
            }
            write!(f, "{}: none of the protocols that polepair knows", self.link)?;
            return self.write_shared(f);
        };
        let (name, percent) = (protocol.name(), self.confidence * 100.0);
        write!(f, "{}: {name}", self.link)?;
        self.secondary.iter().try_for_each(|other| write!(f, " and {}", other.name()))?;
        write!(f, ", {percent:.0} % sure ({}", plural(self.frames, "frame"))?;
        f.write_str(if self.sampled { " weighed" } else { "" })?;
        if self.broken_frames > 0 {
            write!(f, ", {} broken", self.broken_frames)?;
        }
        if self.stray_bytes > 0 {
            write!(f, ", {}", plural(self.stray_bytes, "stray byte"))?;
        }
        match self.runner_up {
            None => f.write_str("; nothing else fits)"),
            Some((name, share)) => {
                write!(f, "; runner-up {name} explains {:.0} %)", share * 100.0)
            }
        }?;
        self.write_shared(f)
    }
}

impl LinkDetection {
    fn write_shared(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let protocols = self.protocol.iter().chain(&self.secondary).map(|protocol| protocol.name());
        let names: Vec<&str> = protocols.collect();
        for (at, (name, axes)) in self.shared_axes.iter().enumerate() {
            let mut rules: Vec<String> = names.iter().map(|word| (*word).to_owned()).collect();
            if !names.contains(name) {
                rules.extend(axes.iter().map(|axis| format!("{name}@{axis}")));
            }
            let rules = rules.join(",");
            match at {
                0 => write!(f, "; some identifiers may be {name}'s: if they are, --as {rules}")?,
                _ => write!(f, "; or {name}'s: --as {rules}")?,
            }
        }
        Ok(())
    }
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
        let weighing = Weighing { candidates, sampler: RecordSampler::default() };
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
        let verdict = self.weighing.verdict();
        let decoder = CaptureDecoder::from_detection(verdict.rules, verdict.echo_links);
        (verdict.links, decoder.with_read_options(self.options))
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
        }
        if self.sampler.is_checkpoint() {
            let certain = self.verdict().is_certain();
            self.sampler.end_window(certain);
        }
    }

    fn verdict(&self) -> Verdict {
        let mut verdict = verdict::judge(&self.candidates, &|link| self.sampler.has_skipped(link));
        verdict.has_unclaimed = verdict
            .links
            .iter()
            .any(|link| self.sampler.ids_of(&link.link).any(|frame| link.leaves_to_others(&frame)));
        verdict
    }
}

impl Default for ProtocolDetector {
    fn default() -> Self {
        Self::new()
    }
}

impl LinkDetection {
    fn unknown(link: &str) -> Self {
        Self {
            link: link.to_owned(),
            protocol: None,
            confidence: 0.0,
            frames: 0,
            sampled: false,
            broken_frames: 0,
            tied: Vec::new(),
            stray_bytes: 0,
            secondary: Vec::new(),
            runner_up: None,
            proven_axes: Vec::new(),
            shared_axes: Vec::new(),
        }
    }
}

impl LinkDetection {
    /// The protocols by which its frames are explained.
    fn protocols(&self) -> impl Iterator<Item = &'static dyn Dissector> {
        let proven = self.proven_axes.iter().map(|(protocol, _)| *protocol);
        self.protocol.into_iter().chain(self.secondary.iter().copied()).chain(proven)
    }

    /// Returns whether both are of one link and find the same protocols and axes on it.
    pub(crate) fn has_same_protocols(&self, other: &Self) -> bool {
        self.link == other.link
            && protocol_names(self) == protocol_names(other)
            && proven_axis_numbers(self) == proven_axis_numbers(other)
            && (&self.tied, &self.shared_axes) == (&other.tied, &other.shared_axes)
    }

    /// Returns whether none of its protocols claims a frame, and another one does.
    fn leaves_to_others(&self, frame: &Frame) -> bool {
        let claims = |dissector: &'static dyn Dissector| score::claims_frame(dissector, frame);
        !self.protocols().any(claims) && proto::dissectors().iter().copied().any(claims)
    }
}

fn proven_axis_numbers(detection: &LinkDetection) -> Vec<u32> {
    detection.proven_axes.iter().map(|(_, axis)| *axis).collect::<Vec<_>>()
}

fn protocol_names(detection: &LinkDetection) -> Vec<&'static str> {
    detection.protocols().map(|each| each.name()).collect::<Vec<_>>()
}
