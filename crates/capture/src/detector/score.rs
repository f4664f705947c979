//! Score of each protocol on the links of a capture.

use core::fmt;
use std::collections::{BTreeMap, BTreeSet};

use polepair_core::explain::{Dissector, RawFrame};
use polepair_core::medium::Frame;

use super::evidence::Evidence;
use super::pairs::{PROOF_PAIRS, Pairs};
use super::{
    AXES_MAX, BROKEN_WEIGHT, CHANCE_SHARE, CHECKED_MIN, EVIDENCE_BITS, IDS_MAX, SUPPORT_MIN,
};
use crate::decoder::{CaptureDecoder, DecodedFrame};
use crate::record::{Record, RecordData};
use crate::rules::{Rule, RuleScope, Rules};

/// Result of one dissector for a capture.
pub(super) struct CandidateProtocol {
    pub dissector: &'static dyn Dissector,
    decoder: CaptureDecoder,
    scores: Vec<LinkScore>,
}

impl fmt::Debug for CandidateProtocol {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {:?}", self.dissector.name(), self.scores)
    }
}

impl CandidateProtocol {
    pub fn new(dissector: &'static dyn Dissector) -> Self {
        let rules = Rules(vec![Rule { dissector, scope: RuleScope::Anywhere }]);
        Self { dissector, decoder: CaptureDecoder::for_detection(rules), scores: Vec::new() }
    }

    pub fn score_record(&mut self, record: &Record<'_>) {
        let Self { decoder, scores, dissector } = self;
        if let RecordData::Frame(frame) = &record.data
            && !claims_frame(*dissector, frame)
        {
            // Not decoded at all: most frames of a mixed bus are not of this protocol.
            return score_of_link(scores, record.link).add_unclaimed_frame(frame);
        }
        decoder.decode_record(record, &mut |event| score_frame(*dissector, scores, event));
    }

    /// The capture ends.
    pub fn finish(&mut self) {
        let Self { decoder, scores, dissector } = self;
        decoder.finish(&mut |event| score_frame(*dissector, scores, event));
    }

    /// The scores by now.
    pub fn snapshot(&self) -> CandidateScores {
        let scores = self.scores.iter().map(LinkScore::without_seen_frames).collect();
        CandidateScores { dissector: self.dissector, scores }
    }

    /// Returns whether the host receives its own requests on a link.
    pub fn has_echo(&self, link: &str) -> bool {
        self.decoder.echo_links().any(|name| name == link)
    }
}

/// The scores of one dissector.
pub(super) struct CandidateScores {
    pub dissector: &'static dyn Dissector,
    pub scores: Vec<LinkScore>,
}

impl CandidateScores {
    pub fn score_of(&self, link: &str) -> Option<&LinkScore> {
        self.scores.iter().find(|score| score.link == link)
    }
}

/// Result of one dissector for one link.
#[derive(Clone, Debug, Default)]
pub(super) struct LinkScore {
    pub link: String,
    /// CAN identifiers of whole frames, and true for those of 29 bits.
    pub ids: BTreeSet<(u32, bool)>,
    /// Axes with whole frames on identifiers that no other protocol uses.
    pub proven_axes: BTreeSet<u32>,
    /// Axes with whole frames on identifiers that others use too: frames and bytes.
    pub shared_axes: BTreeMap<u32, (u64, u64)>,
    /// Requests and answers on CAN.
    pub pairs: Pairs,
    /// Distinct CAN frames whose content supports the protocol, and those whose content it does not define.
    evidence: Evidence,
    pub is_can: bool,
    pub frames: u64,
    pub broken_frames: u64,
    pub good_bytes: u64,
    /// Frames of one byte on a serial line, which any bytes contain.
    single_bytes: u64,
    pub broken_bytes: u64,
    pub stray_bytes: u64,
}

impl LinkScore {
    fn without_seen_frames(&self) -> Self {
        Self {
            link: self.link.clone(),
            ids: self.ids.clone(),
            proven_axes: self.proven_axes.clone(),
            shared_axes: self.shared_axes.clone(),
            pairs: self.pairs.clone(),
            evidence: self.evidence.counts(),
            ..*self
        }
    }

    /// Axes that share identifiers with other protocols and are this one's all the same.
    pub fn proven_shared_axes(&self) -> impl Iterator<Item = u32> + '_ {
        self.shared_axes.keys().copied().filter(|axis| self.proven_axes.contains(axis))
    }

    /// Answers prove it, and it has identifiers that the other has not.
    pub fn is_proven_alongside(&self, other: &Self) -> bool {
        self.pairs.found >= PROOF_PAIRS && !self.ids.is_subset(&other.ids)
    }

    /// Counts frames on shared identifiers as valid if their axis is proven, otherwise for no protocol.
    pub fn count_shared(&mut self) {
        for (axis, (frames, bytes)) in &self.shared_axes {
            if self.proven_axes.contains(axis) {
                self.frames += frames;
                self.good_bytes += bytes;
            } else {
                self.stray_bytes += bytes;
            }
        }
    }

    fn add_unclaimed_frame(&mut self, frame: &Frame) {
        let bytes = if frame.remote { 0 } else { frame.len };
        self.is_can = true;
        // A frame without data is evidence as well.
        self.stray_bytes += u64::from(bytes.max(1));
    }

    /// Takes a frame that may be another protocol's.
    fn add_shared_frame(&mut self, axis: Option<u32>, bytes: u64) {
        let has_room = self.shared_axes.len() < AXES_MAX;
        match axis.filter(|axis| has_room || self.shared_axes.contains_key(axis)) {
            None => self.stray_bytes += bytes,
            Some(axis) => {
                let (frames, sum) = self.shared_axes.entry(axis).or_default();
                (*frames, *sum) = (*frames + 1, *sum + bytes);
            }
        }
    }

    fn total_bytes(&self) -> u64 {
        self.good_bytes + self.broken_bytes + self.stray_bytes
    }

    /// Returns whether frames that could have been wrong support the protocol. On serial lines all valid frames do.
    pub fn has_support(&self) -> bool {
        if !self.is_can {
            return true;
        }
        // Answers prove more than contents, but not against many that the protocol does not define.
        if self.pairs.found >= PROOF_PAIRS && self.pairs.found >= self.evidence.contradicting {
            return true;
        }
        let supporting = (self.evidence.supporting + self.pairs.found) as f64;
        let against = (self.evidence.contradicting + self.broken_frames) as f64;
        debug_assert!(supporting >= 0.0 && against >= 0.0);
        supporting > 0.0 && supporting >= SUPPORT_MIN * (supporting + against)
    }

    /// Bits of evidence for the protocol.
    pub fn evidence_bits(&self) -> u64 {
        if self.is_can {
            EVIDENCE_BITS * (self.evidence.supporting + self.pairs.found)
        } else {
            8 * (self.frames - self.single_bytes)
        }
    }

    /// Share of the bytes that are in frames whose check agrees.
    pub fn good_share(&self) -> f64 {
        self.good_bytes as f64 / self.total_bytes().max(1) as f64
    }

    /// Share of the bytes that are explained.
    pub fn explained_share(&self) -> f64 {
        let good = self.good_bytes as f64 + BROKEN_WEIGHT * self.broken_bytes as f64;
        good / (self.total_bytes().max(1)) as f64
    }

    pub fn is_more_than_chance(&self) -> bool {
        // A single short frame by chance fits some protocol; a person who captured it wants it explained all
        // the same.
        let enough_to_doubt = self.total_bytes() > 256;
        if self.is_can {
            return self.explained_share() > if enough_to_doubt { CHANCE_SHARE } else { 0.0 };
        }
        let checked = self.good_bytes - self.single_bytes;
        if enough_to_doubt {
            let share = checked as f64 / (self.total_bytes() - self.single_bytes).max(1) as f64;
            return share > CHECKED_MIN;
        }
        checked + self.broken_bytes > 0
    }
}

/// Returns whether a frame's identifier can belong to a protocol.
pub(super) fn claims_frame(dissector: &dyn Dissector, frame: &Frame) -> bool {
    if frame.remote {
        dissector.claims_remote(frame.id, frame.extended)
    } else {
        dissector.claims_id(frame.id, frame.extended)
    }
}

fn score_of_link<'a>(scores: &'a mut Vec<LinkScore>, link: &str) -> &'a mut LinkScore {
    let at = scores.iter().position(|score| score.link == link).unwrap_or_else(|| {
        scores.push(LinkScore { link: link.to_owned(), ..LinkScore::default() });
        scores.len() - 1
    });
    &mut scores[at]
}

fn score_frame(dissector: &dyn Dissector, scores: &mut Vec<LinkScore>, event: &DecodedFrame<'_>) {
    let score = score_of_link(scores, event.link);
    let bytes = event.bytes.len().max(1) as u64;
    let id = event.id.map(|id| (id, event.extended));
    score.is_can |= id.is_some();
    let shares = id.is_some_and(|(id, extended)| dissector.shares_id(id, extended));
    if id.is_some() && event.protocol.is_some() {
        let raw = RawFrame { bytes: event.bytes, id: event.id, extended: event.extended };
        if event.defect.is_none() {
            score.pairs.observe(dissector, event);
        }
        if event.defect.is_none() || shares {
            score.evidence.observe(dissector, &raw);
        }
    }
    if event.protocol.is_none() || event.stray || (shares && event.defect.is_some()) {
        score.stray_bytes += bytes;
    } else if event.defect.is_some() {
        score.broken_frames += 1;
        score.broken_bytes += bytes;
    } else if shares {
        score.add_shared_frame(event.explanation.axis, bytes);
    } else {
        score.frames += 1;
        score.good_bytes += bytes;
        score.single_bytes += u64::from(id.is_none() && bytes == 1);
        if score.proven_axes.len() < AXES_MAX {
            score.proven_axes.extend(event.explanation.axis);
        }
        if score.ids.len() < IDS_MAX {
            score.ids.extend(id);
        }
    }
}
