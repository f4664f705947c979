//! Judges by the scores of all protocols what the links of a capture speak.

use std::collections::{BTreeMap, BTreeSet};

use polepair_core::explain::Dissector;

use super::foreign::ForeignCounts;
use super::pairs::PROOF_PAIRS;
use super::score::{CandidateProtocol, CandidateScores, LinkScore};
use super::{CERTAIN_BITS, CERTAIN_CONFIDENCE, CHANCE_SHARE, EXPLAINED_MIN, TIE_MARGIN};
use crate::detection::{DetectedProtocols, LinkDetection};
use crate::rules::{Rule, RuleScope, Rules};

/// Detected protocols, by the evaluated records.
pub(super) struct Verdict {
    pub found: DetectedProtocols,
    /// Each protocol of each link has enough evidence, and no other one has any.
    is_proven: bool,
    /// An identifier may belong to a protocol that is none of its link's.
    pub has_unclaimed: bool,
}

impl Verdict {
    /// Returns whether more of the same links and identifiers would not change it.
    pub fn is_certain(&self) -> bool {
        self.is_proven
            && !self.has_unclaimed
            && self.found.links.iter().all(|link| {
                link.protocol.is_some()
                    && link.confidence >= CERTAIN_CONFIDENCE
                    && link.shared_axes.is_empty()
            })
    }
}

/// Decides by the scores so far. `has_skipped` is true if records of a link were not evaluated.
pub(super) fn judge(
    candidates: &[CandidateProtocol],
    foreign: &BTreeMap<String, ForeignCounts>,
    has_skipped: &dyn Fn(&str) -> bool,
) -> Verdict {
    let mut scored: Vec<CandidateScores> =
        candidates.iter().map(CandidateProtocol::snapshot).collect();
    // First the replies that prove an axis: without them two protocols would share the same frames
    // equally.
    assign_proven(&mut scored);
    scored.iter_mut().flat_map(|each| &mut each.scores).for_each(LinkScore::count_shared);
    let names = scored.first().into_iter().flat_map(|each| &each.scores).map(|score| &score.link);
    let mut is_proven = true;
    let links: Vec<LinkDetection> = names
        .map(|link| {
            let name = foreign.get(link).and_then(ForeignCounts::name);
            let (detected, proven) = detect_link(&scored, link, name);
            is_proven &= proven;
            LinkDetection { sampled: has_skipped(link), ..detected }
        })
        .collect();
    let rules = links.iter().flat_map(|link| link_rules(&scored, link)).collect();
    let echo_links = links
        .iter()
        .filter(|link| {
            link.protocol.is_some_and(|protocol| {
                candidates
                    .iter()
                    .find(|it| it.dissector.name() == protocol.name())
                    .is_some_and(|it| it.has_echo(&link.link))
            })
        })
        .map(|link| link.link.clone())
        .collect();
    let found = DetectedProtocols { links, rules: Rules(rules), echo_links };
    Verdict { found, is_proven, has_unclaimed: false }
}

/// Detects the protocols of a link, and whether each of them is proven and no other one is possible.
/// A `foreign` protocol whose shape the records have counts more than one that explains less than half of them.
fn detect_link(
    scored: &[CandidateScores],
    link: &str,
    foreign: Option<&'static str>,
) -> (LinkDetection, bool) {
    let mut ranked: Vec<ScoredCandidate<'_>> =
        scored.iter().filter_map(|each| Some((each.dissector, each.score_of(link)?))).collect();
    let unknown = LinkDetection {
        shared_axes: unresolved_axes(&ranked),
        foreign,
        ..LinkDetection::unknown(link)
    };
    // After the shared axes were noted: they are shown although their protocol is not accepted.
    ranked.retain(|(_, score)| score.has_support());
    // If two protocols find no whole frame, the one with fewer pieces explains more of the bytes.
    ranked.sort_by(|(_, a), (_, b)| {
        b.explained_share()
            .total_cmp(&a.explained_share())
            .then(a.broken_frames.cmp(&b.broken_frames))
    });
    let tied = resolve_tie(&mut ranked);
    if !tied.is_empty() {
        return (LinkDetection { tied, ..unknown }, false);
    }
    let (protocols, mut rivals) = select_protocols(&ranked);
    let Some((first, others)) = protocols.split_first() else { return (unknown, false) };
    rivals.retain(|(_, score)| score.good_bytes > 0);
    let runner_up = rivals
        .iter()
        .map(|(dissector, score)| (dissector.name(), score.good_share()))
        .max_by(|(_, a), (_, b)| a.total_cmp(b));
    let rival = runner_up.map_or(0.0, |(_, share)| share).max(CHANCE_SHARE);
    let sum = |of: &dyn Fn(&LinkScore) -> u64| -> u64 {
        protocols.iter().map(|(_, score)| of(score)).sum()
    };
    let frames = sum(&|score| score.frames);
    let share: f64 = protocols.iter().map(|(_, score)| score.explained_share()).sum();
    debug_assert!(!protocols.is_empty());
    if foreign.is_some() && share < EXPLAINED_MIN {
        return (unknown, false);
    }
    let accident = 0.5f64.powi(sum(&LinkScore::evidence_bits).min(999) as i32);
    // A protocol that explains only a part of a link may match the rest by accident.
    let whole = (share / EXPLAINED_MIN).min(1.0);
    let proven_axes = protocols.iter().flat_map(|(dissector, score)| {
        score.proven_shared_axes().map(|axis| (*dissector, axis)).collect::<Vec<_>>()
    });
    let detected = LinkDetection {
        protocol: Some(first.0),
        secondary: others.iter().map(|(dissector, _)| *dissector).collect(),
        confidence: ((share - rival) / share).max(0.0) * (1.0 - accident) * whole,
        frames,
        broken_frames: sum(&|score| score.broken_frames),
        stray_bytes: others.iter().fold(first.1.stray_bytes, |stray, (_, score)| {
            stray.saturating_sub(score.good_bytes + score.broken_bytes)
        }),
        runner_up,
        foreign: None,
        proven_axes: proven_axes.collect(),
        ..unknown
    };
    let is_proven = protocols.iter().all(|(_, score)| score.evidence_bits() >= CERTAIN_BITS)
        && !rivals.iter().any(|(_, score)| score.is_can);
    (detected, is_proven)
}

/// The winner on its link; on CAN the others too, for identifiers that the winner leaves.
fn link_rules(scored: &[CandidateScores], detected: &LinkDetection) -> Vec<Rule> {
    let link = &detected.link;
    let proven = detected.proven_axes.iter().map(|(dissector, axis)| Rule {
        dissector: *dissector,
        scope: RuleScope::AxisOn(link.clone(), *axis),
    });
    let mut protocols: Vec<_> = detected.protocol.iter().chain(&detected.secondary).collect();
    // An identifier that two claim goes to the one by whose rules fewer frames are broken.
    protocols.sort_by_key(|dissector| count_broken(scored, dissector.name(), link));
    proven
        .chain(
            protocols.into_iter().map(|dissector| Rule {
                dissector: *dissector,
                scope: RuleScope::Link(link.clone()),
            }),
        )
        .collect()
}

/// Frames of a link that a protocol calls broken.
fn count_broken(scored: &[CandidateScores], name: &str, link: &str) -> u64 {
    let candidate = scored.iter().find(|each| each.dissector.name() == name);
    candidate.and_then(|each| each.score_of(link)).map_or(0, |score| score.broken_frames)
}

/// A protocol, and its score on a link.
type ScoredCandidate<'a> = (&'static dyn Dissector, &'a LinkScore);

/// An axis that answers on shared identifiers is its protocol's, and so no other's.
fn assign_proven(candidates: &mut [CandidateScores]) {
    for at in 0..candidates.len() {
        let proofs: Vec<(String, Vec<u32>)> = candidates[at]
            .scores
            .iter()
            .map(|score| {
                let paired =
                    score.pairs.proven_axes().filter(|axis| score.shared_axes.contains_key(axis));
                (score.link.clone(), paired.collect())
            })
            .collect();
        for (other, candidate) in candidates.iter_mut().enumerate() {
            for score in &mut candidate.scores {
                let proven = proofs.iter().filter(|(link, _)| *link == score.link);
                for axis in proven.flat_map(|(_, axes)| axes) {
                    if other == at {
                        score.proven_axes.insert(*axis);
                    } else if let Some((_, bytes)) = score.shared_axes.remove(axis) {
                        score.stray_bytes += bytes;
                    }
                }
            }
        }
    }
}

/// Decides between protocols on CAN that explain equally much: one that finds replies to requests goes first. Returns
/// the names of all if none does, or several.
fn resolve_tie(ranked: &mut [ScoredCandidate<'_>]) -> Vec<&'static str> {
    let Some((_, first)) = ranked.first() else { return Vec::new() };
    let (first, share) = (*first, first.explained_share());
    let equal = |(_, score): &ScoredCandidate<'_>| {
        let meets = score.ids.iter().any(|id| first.ids.contains(id));
        let apart = first.is_proven_alongside(score) && score.is_proven_alongside(first);
        meets && !apart && score.good_bytes > 0 && share - score.explained_share() < TIE_MARGIN
    };
    let tied = ranked.iter().take_while(|read| equal(read)).count();
    // One protocol cannot tie with itself.
    if tied < 2 {
        return Vec::new();
    }
    let pairs = |(_, score): &ScoredCandidate<'_>| score.pairs.found;
    ranked[..tied].sort_by_key(|read| core::cmp::Reverse(pairs(read)));
    let settled = pairs(&ranked[0]) >= PROOF_PAIRS && pairs(&ranked[1]) == 0;
    let names = ranked[..tied].iter().map(|(dissector, _)| dissector.name());
    if settled { Vec::new() } else { names.collect() }
}

/// The winner and those that explain CAN identifiers which it and each other leave; and the rest.
fn select_protocols<'a>(
    ranked: &[ScoredCandidate<'a>],
) -> (Vec<ScoredCandidate<'a>>, Vec<ScoredCandidate<'a>>) {
    let mut protocols: Vec<ScoredCandidate<'a>> = Vec::new();
    let mut rivals = Vec::new();
    for (dissector, score) in ranked {
        let claimed = |(id, extended): &(u32, bool)| {
            protocols.iter().any(|(other, _)| other.claims_id(*id, *extended))
        };
        // Identifiers of no other protocol, and replies on them while others' are among those that it would claim; or
        // axes that replies prove on identifiers that others claim.
        let free = score.ids.iter().filter(|id| !claimed(id)).count();
        let own = free > 0 && (free == score.ids.len() || score.pairs.found >= PROOF_PAIRS);
        let beside = own || score.proven_shared_axes().next().is_some();
        let holds = if protocols.is_empty() {
            rivals.is_empty() && score.is_more_than_chance()
        } else {
            beside && score.good_bytes > score.broken_bytes
        };
        if holds { &mut protocols } else { &mut rivals }.push((*dissector, *score));
    }
    (protocols, rivals)
}

/// The axes that may be each protocol's by identifiers that several use, but those that one of them
/// is proven to have.
fn unresolved_axes(read: &[ScoredCandidate<'_>]) -> Vec<(&'static str, Vec<u32>)> {
    let won: BTreeSet<u32> =
        read.iter().flat_map(|(_, score)| score.proven_shared_axes()).collect();
    let named =
        read.iter().map(|(dissector, score)| (dissector.name(), undecided_axes(score, &won)));
    named.filter(|(_, axes)| !axes.is_empty()).collect()
}

fn undecided_axes(score: &LinkScore, won: &BTreeSet<u32>) -> Vec<u32> {
    score.shared_axes.keys().copied().filter(|axis| !won.contains(axis)).collect()
}
