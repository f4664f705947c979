//! Detects the protocol of a capture. All registered dissectors read it, or a sample of a long one. The
//! protocol that explains most of the bytes is selected. If identifiers and checksums are ambiguous on CAN,
//! replies that match requests decide; otherwise the result is undecided.
//!
//! On CAN a protocol needs evidence: content that could have been wrong and is not. Identifiers alone are
//! none, because every maker uses them.

mod evidence;
mod pairs;
mod sampler;
#[cfg(test)]
mod tests;

use core::fmt;
use std::collections::{BTreeMap, BTreeSet};

use polepair_core::explain::{Dissector, RawFrame};
use polepair_core::proto;

use crate::decoder::{CaptureDecoder, DecodedFrame};
use crate::read::{CaptureReader as Source, ReadOptions};
use crate::record::Record;
use crate::rules::{Rule, RuleScope, Rules};
use evidence::Evidence;
use pairs::{PROOF_PAIRS, Pairs};
use sampler::RecordSampler;

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

/// Axes of a link that are remembered: as many as a CAN bus can have with 11-bit identifiers.
const AXES_MAX: usize = 127;
/// Identifiers of a link that are remembered: as many as there are with 11 bits.
const IDS_MAX: usize = 2048;

/// Weighs a capture.
#[derive(Debug)]
pub struct ProtocolDetector {
    reader: Source,
    options: ReadOptions,
    candidates: Vec<CandidateProtocol>,
    sampler: RecordSampler,
}

/// What one dissector makes of a capture.
struct CandidateProtocol {
    dissector: &'static dyn Dissector,
    decoder: CaptureDecoder,
    scores: Vec<LinkScore>,
}

impl fmt::Debug for CandidateProtocol {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {:?}", self.dissector.name(), self.scores)
    }
}

/// What one dissector made of one link.
#[derive(Clone, Debug, Default)]
struct LinkScore {
    link: String,
    /// CAN identifiers of whole frames, and true for those of 29 bits.
    ids: BTreeSet<(u32, bool)>,
    /// Axes with whole frames on identifiers that no other protocol uses.
    proven_axes: BTreeSet<u32>,
    /// Axes with whole frames on identifiers that others use too: frames and bytes.
    shared_axes: BTreeMap<u32, (u64, u64)>,
    /// Requests and answers on CAN.
    pairs: Pairs,
    /// Distinct CAN frames whose content supports the protocol, and those whose content it does not define.
    evidence: Evidence,
    is_can: bool,
    frames: u64,
    broken_frames: u64,
    good_bytes: u64,
    broken_bytes: u64,
    stray_bytes: u64,
}

/// What a capture's link speaks, and how sure that is.
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
    /// Protocols that explain it equally well, where nothing tells which it is.
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
    /// Protocols that may be spoken too, on identifiers that they share with others, and the axes
    /// that would: no frame proves it, so it is for a person to say.
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

fn plural(count: u64, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
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
        Self {
            reader: Source::new(options),
            options,
            candidates,
            sampler: RecordSampler::default(),
        }
    }

    /// Takes a piece of the capture, cut anywhere.
    pub fn feed(&mut self, piece: &[u8]) {
        let Self { reader, candidates, sampler, .. } = self;
        reader.feed(piece, &mut |record| score_sampled(candidates, sampler, record));
    }

    /// The verdicts, one a link, and a decoder that holds to them.
    #[must_use]
    pub fn decide(mut self) -> (Vec<LinkDetection>, CaptureDecoder) {
        let Self { reader: source, candidates, sampler, .. } = &mut self;
        source.finish(&mut |record| score_sampled(candidates, sampler, record));
        for reader in candidates.iter_mut() {
            let CandidateProtocol { decoder, scores, dissector } = reader;
            decoder.finish(&mut |event| score_frame(*dissector, scores, event));
        }
        assign_proven(candidates);
        candidates
            .iter_mut()
            .flat_map(|reader| &mut reader.scores)
            .for_each(LinkScore::count_shared);
        let links = self.candidates.first().map_or_else(Vec::new, |reader| {
            reader.scores.iter().map(|tally| tally.link.clone()).collect()
        });
        let verdicts: Vec<LinkDetection> =
            links.iter().map(|link| self.detect_link(link)).collect();
        let rules = verdicts.iter().flat_map(|verdict| self.link_rules(verdict)).collect();
        let echoing = verdicts.iter().filter(|verdict| self.has_echo(verdict));
        let echoing = echoing.map(|verdict| verdict.link.clone()).collect();
        (
            verdicts,
            CaptureDecoder::from_detection(Rules(rules), echoing).with_read_options(self.options),
        )
    }

    fn detect_link(&self, link: &str) -> LinkDetection {
        let read =
            self.candidates.iter().filter_map(|reader| Some((reader, reader.score_of(link)?)));
        let mut ranked: Vec<(&CandidateProtocol, &LinkScore)> = read.collect();
        let sampled = self.sampler.has_skipped(link);
        let unknown = LinkDetection {
            shared_axes: unresolved_axes(&ranked),
            sampled,
            ..LinkDetection::unknown(link)
        };
        ranked.retain(|(_, tally)| tally.has_support());
        // Of two that find no whole frame, the one with fewer pieces reads more into the bytes.
        ranked.sort_by(|(_, a), (_, b)| {
            b.explained_share()
                .total_cmp(&a.explained_share())
                .then(a.broken_frames.cmp(&b.broken_frames))
        });
        let tied = resolve_tie(&mut ranked);
        if !tied.is_empty() {
            return LinkDetection { tied, ..unknown };
        }
        let (protocols, rivals) = select_protocols(&ranked);
        let Some((first, others)) = protocols.split_first() else { return unknown };
        let rivals = rivals.iter().filter(|(_, tally)| tally.good_bytes > 0);
        let runner_up = rivals
            .map(|(reader, tally)| (reader.dissector.name(), tally.good_share()))
            .max_by(|(_, a), (_, b)| a.total_cmp(b));
        let rival = runner_up.map_or(0.0, |(_, share)| share).max(CHANCE_SHARE);
        let sum =
            |of: &dyn Fn(&LinkScore) -> u64| protocols.iter().map(|(_, tally)| of(tally)).sum();
        let frames = sum(&|tally| tally.frames);
        let share: f64 = protocols.iter().map(|(_, tally)| tally.explained_share()).sum();
        let bits: u64 = protocols.iter().map(|(_, tally)| tally.evidence_bits()).sum();
        let accident = 0.5f64.powi(bits.min(999) as i32);
        // What explains only a part of a link may be an accident of the rest.
        let whole = (share / EXPLAINED_MIN).min(1.0);
        let won = protocols.iter().flat_map(|(reader, tally)| {
            tally.proven_shared_axes().map(|axis| (reader.dissector, axis)).collect::<Vec<_>>()
        });
        LinkDetection {
            protocol: Some(first.0.dissector),
            secondary: others.iter().map(|(reader, _)| reader.dissector).collect(),
            confidence: ((share - rival) / share).max(0.0) * (1.0 - accident) * whole,
            frames,
            broken_frames: sum(&|tally| tally.broken_frames),
            stray_bytes: others.iter().fold(first.1.stray_bytes, |stray, (_, tally)| {
                stray.saturating_sub(tally.good_bytes + tally.broken_bytes)
            }),
            runner_up,
            proven_axes: won.collect(),
            ..unknown
        }
    }

    /// The winner on its link; on CAN the others too, for identifiers that the winner leaves.
    fn link_rules(&self, verdict: &LinkDetection) -> Vec<Rule> {
        let link = &verdict.link;
        let proven = verdict.proven_axes.iter().map(|(dissector, axis)| Rule {
            dissector: *dissector,
            scope: RuleScope::AxisOn(link.clone(), *axis),
        });
        let mut protocols: Vec<_> = verdict.protocol.iter().chain(&verdict.secondary).collect();
        // An identifier that two claim goes to the one by whose rules fewer frames are broken.
        protocols.sort_by_key(|dissector| self.count_broken(dissector.name(), link));
        let rule = |dissector: &&'static dyn Dissector| Rule {
            dissector: *dissector,
            scope: RuleScope::Link(link.clone()),
        };
        proven.chain(protocols.into_iter().map(rule)).collect()
    }

    /// Frames of a link that a protocol calls broken.
    fn count_broken(&self, name: &str, link: &str) -> u64 {
        let reader = self.candidates.iter().find(|reader| reader.dissector.name() == name);
        reader.and_then(|reader| reader.score_of(link)).map_or(0, |tally| tally.broken_frames)
    }

    fn has_echo(&self, verdict: &LinkDetection) -> bool {
        let Some(protocol) = verdict.protocol else { return false };
        let reader = self.candidates.iter().find(|r| r.dissector.name() == protocol.name());
        reader.is_some_and(|reader| reader.decoder.echo_links().any(|link| link == verdict.link))
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

impl CandidateProtocol {
    fn new(dissector: &'static dyn Dissector) -> Self {
        let rules = Rules(vec![Rule { dissector, scope: RuleScope::Anywhere }]);
        Self { dissector, decoder: CaptureDecoder::for_detection(rules), scores: Vec::new() }
    }

    fn score_record(&mut self, record: &Record<'_>) {
        let Self { decoder, scores, dissector } = self;
        decoder.decode_record(record, &mut |event| score_frame(*dissector, scores, event));
    }

    fn score_of(&self, link: &str) -> Option<&LinkScore> {
        self.scores.iter().find(|tally| tally.link == link)
    }
}

/// Lets every protocol read a record that is weighed.
fn score_sampled(
    readers: &mut [CandidateProtocol],
    sample: &mut RecordSampler,
    record: &Record<'_>,
) {
    if sample.select(record) {
        readers.iter_mut().for_each(|reader| reader.score_record(record));
    }
}

/// An axis that answers on shared identifiers is its protocol's, and so no other's.
fn assign_proven(readers: &mut [CandidateProtocol]) {
    for at in 0..readers.len() {
        let proofs: Vec<(String, Vec<u32>)> = readers[at]
            .scores
            .iter()
            .map(|tally| {
                let paired =
                    tally.pairs.proven_axes().filter(|axis| tally.shared_axes.contains_key(axis));
                (tally.link.clone(), paired.collect())
            })
            .collect();
        for (other, reader) in readers.iter_mut().enumerate() {
            for tally in &mut reader.scores {
                let proven = proofs.iter().filter(|(link, _)| *link == tally.link);
                for axis in proven.flat_map(|(_, axes)| axes) {
                    if other == at {
                        tally.proven_axes.insert(*axis);
                    } else if let Some((_, bytes)) = tally.shared_axes.remove(axis) {
                        tally.stray_bytes += bytes;
                    }
                }
            }
        }
    }
}

/// Of those on CAN that explain equally much, the one that finds answers to requests goes first. The
/// names of all where none does, or several.
fn resolve_tie(ranked: &mut [ScoredCandidate<'_>]) -> Vec<&'static str> {
    let Some((_, first)) = ranked.first() else { return Vec::new() };
    let (first, share) = (*first, first.explained_share());
    let equal = |(_, tally): &ScoredCandidate<'_>| {
        let meets = tally.ids.iter().any(|id| first.ids.contains(id));
        let apart = first.is_proven_alongside(tally) && tally.is_proven_alongside(first);
        meets && !apart && tally.good_bytes > 0 && share - tally.explained_share() < TIE_MARGIN
    };
    let tied = ranked.iter().take_while(|read| equal(read)).count();
    if tied < 2 {
        return Vec::new();
    }
    let pairs = |(_, tally): &ScoredCandidate<'_>| tally.pairs.found;
    ranked[..tied].sort_by_key(|read| core::cmp::Reverse(pairs(read)));
    let settled = pairs(&ranked[0]) >= PROOF_PAIRS && pairs(&ranked[1]) == 0;
    let names = ranked[..tied].iter().map(|(reader, _)| reader.dissector.name());
    if settled { Vec::new() } else { names.collect() }
}

/// The winner and those that explain CAN identifiers which it and each other leave; and the rest.
fn select_protocols<'a>(
    ranked: &[(&'a CandidateProtocol, &'a LinkScore)],
) -> (Vec<ScoredCandidate<'a>>, Vec<ScoredCandidate<'a>>) {
    let mut protocols: Vec<ScoredCandidate<'a>> = Vec::new();
    let mut rivals = Vec::new();
    for (reader, tally) in ranked {
        let claimed = |(id, extended): &(u32, bool)| {
            protocols.iter().any(|(other, _)| other.dissector.claims_id(*id, *extended))
        };
        // Identifiers that nobody else claims, and answers on them where others' are among those that
        // it would claim; or axes that answers prove on identifiers that others claim.
        let free = tally.ids.iter().filter(|id| !claimed(id)).count();
        let own = free > 0 && (free == tally.ids.len() || tally.pairs.found >= PROOF_PAIRS);
        let beside = own || tally.proven_shared_axes().next().is_some();
        let holds = match protocols.is_empty() {
            true => rivals.is_empty() && tally.is_more_than_chance(),
            false => beside && tally.good_bytes > tally.broken_bytes,
        };
        if holds { &mut protocols } else { &mut rivals }.push((*reader, *tally));
    }
    (protocols, rivals)
}

/// What a reader made of a link.
type ScoredCandidate<'a> = (&'a CandidateProtocol, &'a LinkScore);

/// The axes that may be each protocol's by identifiers that several use, but those that one of them
/// is proven to have.
fn unresolved_axes(read: &[ScoredCandidate<'_>]) -> Vec<(&'static str, Vec<u32>)> {
    let won: BTreeSet<u32> =
        read.iter().flat_map(|(_, tally)| tally.proven_shared_axes()).collect();
    let open = |tally: &LinkScore| -> Vec<u32> {
        tally.shared_axes.keys().copied().filter(|axis| !won.contains(axis)).collect()
    };
    let named = read.iter().map(|(reader, tally)| (reader.dissector.name(), open(tally)));
    named.filter(|(_, axes)| !axes.is_empty()).collect()
}

impl LinkScore {
    /// Axes that share identifiers with other protocols and are this one's all the same.
    fn proven_shared_axes(&self) -> impl Iterator<Item = u32> + '_ {
        self.shared_axes.keys().copied().filter(|axis| self.proven_axes.contains(axis))
    }

    /// Answers prove it, and it has identifiers that the other has not.
    fn is_proven_alongside(&self, other: &Self) -> bool {
        self.pairs.found >= PROOF_PAIRS && !self.ids.is_subset(&other.ids)
    }

    /// Frames on shared identifiers are whole where their axis is proven, else nobody's.
    fn count_shared(&mut self) {
        for (axis, (frames, bytes)) in &self.shared_axes {
            if self.proven_axes.contains(axis) {
                self.frames += frames;
                self.good_bytes += bytes;
            } else {
                self.stray_bytes += bytes;
            }
        }
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

    /// Whether frames that could have been wrong support the protocol. On serial lines all valid frames do.
    fn has_support(&self) -> bool {
        if !self.is_can || self.pairs.found >= PROOF_PAIRS {
            return true;
        }
        let supporting = (self.evidence.supporting + self.pairs.found) as f64;
        let against = (self.evidence.contradicting + self.broken_frames) as f64;
        supporting > 0.0 && supporting >= SUPPORT_MIN * (supporting + against)
    }

    /// Bits of evidence for the protocol.
    fn evidence_bits(&self) -> u64 {
        match self.is_can {
            false => 8 * self.frames,
            true => EVIDENCE_BITS * (self.evidence.supporting + self.pairs.found),
        }
    }

    /// Share of the bytes that are in frames whose check agrees.
    fn good_share(&self) -> f64 {
        self.good_bytes as f64 / self.total_bytes().max(1) as f64
    }

    /// Share of the bytes that are explained.
    fn explained_share(&self) -> f64 {
        let good = self.good_bytes as f64 + BROKEN_WEIGHT * self.broken_bytes as f64;
        good / (self.total_bytes().max(1)) as f64
    }

    fn is_more_than_chance(&self) -> bool {
        let enough_to_doubt = self.total_bytes() > 256;
        self.explained_share() > if enough_to_doubt { CHANCE_SHARE } else { 0.0 }
    }
}

fn score_frame(dissector: &dyn Dissector, tallies: &mut Vec<LinkScore>, event: &DecodedFrame<'_>) {
    let at = tallies.iter().position(|tally| tally.link == event.link).unwrap_or_else(|| {
        tallies.push(LinkScore { link: event.link.to_owned(), ..LinkScore::default() });
        tallies.len() - 1
    });
    let tally = &mut tallies[at];
    let bytes = event.bytes.len().max(1) as u64;
    let id = event.id.map(|id| (id, event.extended));
    tally.is_can |= id.is_some();
    let shares = id.is_some_and(|(id, extended)| dissector.shares_id(id, extended));
    if id.is_some() && event.protocol.is_some() && event.defect.is_none() {
        tally.pairs.observe(dissector, event);
        let raw = RawFrame { bytes: event.bytes, id: event.id, extended: event.extended };
        tally.evidence.observe(dissector, &raw);
    }
    if event.protocol.is_none() || event.stray || (shares && event.defect.is_some()) {
        tally.stray_bytes += bytes;
    } else if event.defect.is_some() {
        tally.broken_frames += 1;
        tally.broken_bytes += bytes;
    } else if shares {
        tally.add_shared_frame(event.explanation.axis, bytes);
    } else {
        tally.frames += 1;
        tally.good_bytes += bytes;
        if tally.proven_axes.len() < AXES_MAX {
            tally.proven_axes.extend(event.explanation.axis);
        }
        if tally.ids.len() < IDS_MAX {
            tally.ids.extend(id);
        }
    }
}
