//! Which protocol a capture speaks, when nobody says: every registered dissector reads it, of a long
//! one enough, and what explains most of its bytes wins. Where identifiers and checksums leave doubt
//! on a CAN bus, answers that belong to requests settle it; where they do not either, nobody wins.

mod pairs;
mod sample;
#[cfg(test)]
mod tests;

use core::fmt;
use std::collections::{BTreeMap, BTreeSet};

use polepair_core::explain::Dissector;
use polepair_core::proto;

use crate::decoder::{Decoder, Event};
use crate::format::Format;
use crate::read::Reader as Source;
use crate::record::Record;
use crate::rules::{Rule, Rules, Scope};
use pairs::{PROOF, Pairs};
use sample::Sample;

/// Share of bytes that a weak check (an 8-bit sum over nine bytes, tried at every offset) explains
/// by chance: 9 in 256.
const CHANCE: f64 = 9.0 / 256.0;
/// A frame whose check fails is worth this share of one that is right.
const BROKEN_WORTH: f64 = 0.1;
/// Two protocols on CAN whose shares differ by less explain a bus equally well.
const TIE: f64 = 0.02;

/// Axes of a link that are remembered: as many as a CAN bus can have with 11-bit identifiers.
const AXES_MAX: usize = 127;
/// Identifiers of a link that are remembered: as many as there are with 11 bits.
const IDS_MAX: usize = 2048;

/// Weighs a capture.
#[derive(Debug)]
pub struct Judge {
    source: Source,
    stated: Option<Format>,
    readers: Vec<Reader>,
    sample: Sample,
}

/// What one dissector makes of a capture.
struct Reader {
    dissector: &'static dyn Dissector,
    decoder: Decoder,
    tallies: Vec<Tally>,
}

impl fmt::Debug for Reader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {:?}", self.dissector.name(), self.tallies)
    }
}

/// What one dissector made of one link.
#[derive(Clone, Debug, Default)]
struct Tally {
    link: String,
    /// CAN identifiers of whole frames, and true for those of 29 bits.
    ids: BTreeSet<(u32, bool)>,
    /// Axes with whole frames on identifiers that no other protocol uses.
    proven: BTreeSet<u32>,
    /// Axes with whole frames on identifiers that others use too: frames and bytes.
    shared: BTreeMap<u32, (u64, u64)>,
    /// Requests and answers on CAN.
    pairs: Pairs,
    frames: u64,
    broken: u64,
    good_bytes: u64,
    broken_bytes: u64,
    stray_bytes: u64,
}

/// What a capture's link speaks, and how sure that is.
#[derive(Clone)]
pub struct Verdict {
    /// The link.
    pub link: String,
    /// The protocol; `None` when nothing explains it, or several do equally well.
    pub protocol: Option<&'static dyn Dissector>,
    /// 0 for a guess, 1 for certainty.
    pub sure: f64,
    /// Whole frames, among those that were weighed.
    pub frames: u64,
    /// Not all of the capture was weighed: it is long.
    pub sampled: bool,
    /// Frames whose check fails.
    pub broken: u64,
    /// Protocols that explain it equally well, where nothing tells which it is.
    pub tied: Vec<&'static str>,
    /// Bytes that belong to no frame.
    pub stray_bytes: u64,
    /// Protocols that explain CAN identifiers which the first leaves.
    pub others: Vec<&'static dyn Dissector>,
    /// The protocol that explains most beside these, and the share of the bytes it explains.
    pub runner_up: Option<(&'static str, f64)>,
    /// Axes on identifiers that this protocol shares with others and that something else proves
    /// to be its.
    pub proven: Vec<(&'static dyn Dissector, u32)>,
    /// Protocols that may be spoken too, on identifiers that they share with others, and the axes
    /// that would: no frame proves it, so it is for a person to say.
    pub shared: Vec<(&'static str, Vec<u32>)>,
}

impl fmt::Debug for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(protocol) = self.protocol else {
            if let [first, rest @ ..] = &self.tied[..] {
                write!(f, "{}: undecided: {first}", self.link)?;
                rest.iter().try_for_each(|other| write!(f, " or {other}"))?;
                return write!(f, " explain it equally well: say which by --as {first}");
            }
            write!(f, "{}: no known protocol explains it", self.link)?;
            return self.show_shared(f);
        };
        let (name, percent) = (protocol.name(), self.sure * 100.0);
        write!(f, "{}: {name}", self.link)?;
        self.others.iter().try_for_each(|other| write!(f, " and {}", other.name()))?;
        write!(f, ", {percent:.0} % sure ({}", many(self.frames, "frame"))?;
        f.write_str(if self.sampled { " weighed" } else { "" })?;
        if self.broken > 0 {
            write!(f, ", {} broken", self.broken)?;
        }
        if self.stray_bytes > 0 {
            write!(f, ", {}", many(self.stray_bytes, "stray byte"))?;
        }
        match self.runner_up {
            None => f.write_str("; nothing else fits)"),
            Some((name, share)) => {
                write!(f, "; runner-up {name} explains {:.0} %)", share * 100.0)
            }
        }?;
        self.show_shared(f)
    }
}

impl Verdict {
    fn show_shared(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let spoken = self.protocol.iter().chain(&self.others).map(|spoken| spoken.name());
        let spoken: Vec<&str> = spoken.collect();
        for (at, (name, axes)) in self.shared.iter().enumerate() {
            let mut rules: Vec<String> = spoken.iter().map(|word| (*word).to_owned()).collect();
            if !spoken.contains(name) {
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

fn many(count: u64, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

impl Judge {
    /// Nothing weighed yet.
    #[must_use]
    pub fn new() -> Self {
        Self::of_format(None)
    }

    /// The same of a capture in that format.
    #[must_use]
    pub fn of_format(stated: Option<Format>) -> Self {
        let readers = proto::dissectors().iter().copied().map(Reader::new).collect();
        Self { source: Source::new(stated), stated, readers, sample: Sample::default() }
    }

    /// Takes a piece of the capture, cut anywhere.
    pub fn feed(&mut self, piece: &[u8]) {
        let Self { source, readers, sample, .. } = self;
        source.feed(piece, &mut |record| read(readers, sample, record));
    }

    /// The verdicts, one a link, and a decoder that holds to them.
    #[must_use]
    pub fn decide(mut self) -> (Vec<Verdict>, Decoder) {
        let Self { source, readers, sample, .. } = &mut self;
        source.finish(&mut |record| read(readers, sample, record));
        for reader in readers.iter_mut() {
            let Reader { decoder, tallies, dissector } = reader;
            decoder.finish(&mut |event| weigh(*dissector, tallies, event));
        }
        prove(readers);
        readers.iter_mut().flat_map(|reader| &mut reader.tallies).for_each(Tally::settle);
        let links = self.readers.first().map_or_else(Vec::new, |reader| {
            reader.tallies.iter().map(|tally| tally.link.clone()).collect()
        });
        let verdicts: Vec<Verdict> = links.iter().map(|link| self.verdict(link)).collect();
        let rules = verdicts.iter().flat_map(|verdict| self.rules(verdict)).collect();
        let echoing = verdicts.iter().filter(|verdict| self.echoes(verdict));
        let echoing = echoing.map(|verdict| verdict.link.clone()).collect();
        (verdicts, Decoder::judged(Rules(rules), echoing).with_format(self.stated))
    }

    fn verdict(&self, link: &str) -> Verdict {
        let read = self.readers.iter().filter_map(|reader| Some((reader, reader.tally(link)?)));
        let mut ranked: Vec<(&Reader, &Tally)> = read.collect();
        let sampled = self.sample.left_out(link);
        let unknown = Verdict { shared: shared(&ranked), sampled, ..Verdict::unknown(link) };
        // Of two that find no whole frame, the one with fewer pieces reads more into the bytes.
        ranked.sort_by(|(_, a), (_, b)| {
            b.share().total_cmp(&a.share()).then(a.broken.cmp(&b.broken))
        });
        let tied = settle_tie(&mut ranked);
        if !tied.is_empty() {
            return Verdict { tied, ..unknown };
        }
        let (spoken, rivals) = spoken(&ranked);
        let Some((first, others)) = spoken.split_first() else { return unknown };
        let rivals = rivals.iter().filter(|(_, tally)| tally.good_bytes > 0);
        let runner_up = rivals
            .map(|(reader, tally)| (reader.dissector.name(), tally.good_share()))
            .max_by(|(_, a), (_, b)| a.total_cmp(b));
        let rival = runner_up.map_or(0.0, |(_, share)| share).max(CHANCE);
        let sum = |of: &dyn Fn(&Tally) -> u64| spoken.iter().map(|(_, tally)| of(tally)).sum();
        let frames = sum(&|tally| tally.frames);
        let share: f64 = spoken.iter().map(|(_, tally)| tally.share()).sum();
        let accident = 0.5f64.powi(8 * i32::try_from(frames).unwrap_or(i32::MAX / 8).min(99));
        let won = spoken.iter().flat_map(|(reader, tally)| {
            tally.won().map(|axis| (reader.dissector, axis)).collect::<Vec<_>>()
        });
        Verdict {
            protocol: Some(first.0.dissector),
            others: others.iter().map(|(reader, _)| reader.dissector).collect(),
            sure: ((share - rival) / share).max(0.0) * (1.0 - accident),
            frames,
            broken: sum(&|tally| tally.broken),
            stray_bytes: others.iter().fold(first.1.stray_bytes, |stray, (_, tally)| {
                stray.saturating_sub(tally.good_bytes + tally.broken_bytes)
            }),
            runner_up,
            proven: won.collect(),
            ..unknown
        }
    }

    /// The winner on its link; on CAN the others too, for identifiers that the winner leaves.
    fn rules(&self, verdict: &Verdict) -> Vec<Rule> {
        let link = &verdict.link;
        let proven = verdict.proven.iter().map(|(dissector, axis)| Rule {
            dissector: *dissector,
            scope: Scope::AxisOn(link.clone(), *axis),
        });
        let mut spoken: Vec<_> = verdict.protocol.iter().chain(&verdict.others).collect();
        // An identifier that two claim goes to the one in whose eyes fewer frames are broken.
        spoken.sort_by_key(|dissector| self.broken(dissector.name(), link));
        let rule = |dissector: &&'static dyn Dissector| Rule {
            dissector: *dissector,
            scope: Scope::Link(link.clone()),
        };
        proven.chain(spoken.into_iter().map(rule)).collect()
    }

    /// Frames of a link that a protocol calls broken.
    fn broken(&self, name: &str, link: &str) -> u64 {
        let reader = self.readers.iter().find(|reader| reader.dissector.name() == name);
        reader.and_then(|reader| reader.tally(link)).map_or(0, |tally| tally.broken)
    }

    fn echoes(&self, verdict: &Verdict) -> bool {
        let Some(protocol) = verdict.protocol else { return false };
        let reader = self.readers.iter().find(|r| r.dissector.name() == protocol.name());
        reader.is_some_and(|reader| reader.decoder.echoing().any(|link| link == verdict.link))
    }
}

impl Default for Judge {
    fn default() -> Self {
        Self::new()
    }
}

impl Verdict {
    fn unknown(link: &str) -> Self {
        Self {
            link: link.to_owned(),
            protocol: None,
            sure: 0.0,
            frames: 0,
            sampled: false,
            broken: 0,
            tied: Vec::new(),
            stray_bytes: 0,
            others: Vec::new(),
            runner_up: None,
            proven: Vec::new(),
            shared: Vec::new(),
        }
    }
}

impl Reader {
    fn new(dissector: &'static dyn Dissector) -> Self {
        let rules = Rules(vec![Rule { dissector, scope: Scope::Anywhere }]);
        Self { dissector, decoder: Decoder::weighing(rules), tallies: Vec::new() }
    }

    fn read(&mut self, record: &Record<'_>) {
        let Self { decoder, tallies, dissector } = self;
        decoder.record(record, &mut |event| weigh(*dissector, tallies, event));
    }

    fn tally(&self, link: &str) -> Option<&Tally> {
        self.tallies.iter().find(|tally| tally.link == link)
    }
}

/// Lets every protocol read a record that is weighed.
fn read(readers: &mut [Reader], sample: &mut Sample, record: &Record<'_>) {
    if sample.takes(record) {
        readers.iter_mut().for_each(|reader| reader.read(record));
    }
}

/// An axis that answers on shared identifiers is its protocol's, and so no other's.
fn prove(readers: &mut [Reader]) {
    for at in 0..readers.len() {
        let proofs: Vec<(String, Vec<u32>)> = readers[at]
            .tallies
            .iter()
            .map(|tally| {
                let paired = tally.pairs.proven().filter(|axis| tally.shared.contains_key(axis));
                (tally.link.clone(), paired.collect())
            })
            .collect();
        for (other, reader) in readers.iter_mut().enumerate() {
            for tally in &mut reader.tallies {
                let proven = proofs.iter().filter(|(link, _)| *link == tally.link);
                for axis in proven.flat_map(|(_, axes)| axes) {
                    if other == at {
                        tally.proven.insert(*axis);
                    } else if let Some((_, bytes)) = tally.shared.remove(axis) {
                        tally.stray_bytes += bytes;
                    }
                }
            }
        }
    }
}

/// Of those on CAN that explain equally much, the one that finds answers to requests goes first. The
/// names of all where none does, or several.
fn settle_tie(ranked: &mut [Read<'_>]) -> Vec<&'static str> {
    let Some((_, first)) = ranked.first() else { return Vec::new() };
    let (first, share) = (*first, first.share());
    let equal = |(_, tally): &Read<'_>| {
        let meets = tally.ids.iter().any(|id| first.ids.contains(id));
        let apart = first.is_proven_beside(tally) && tally.is_proven_beside(first);
        meets && !apart && tally.good_bytes > 0 && share - tally.share() < TIE
    };
    let tied = ranked.iter().take_while(|read| equal(read)).count();
    if tied < 2 {
        return Vec::new();
    }
    let pairs = |(_, tally): &Read<'_>| tally.pairs.found;
    ranked[..tied].sort_by_key(|read| core::cmp::Reverse(pairs(read)));
    let settled = pairs(&ranked[0]) >= PROOF && pairs(&ranked[1]) == 0;
    let names = ranked[..tied].iter().map(|(reader, _)| reader.dissector.name());
    if settled { Vec::new() } else { names.collect() }
}

/// The winner and those that explain CAN identifiers which it and each other leave; and the rest.
fn spoken<'a>(ranked: &[(&'a Reader, &'a Tally)]) -> (Vec<Read<'a>>, Vec<Read<'a>>) {
    let mut spoken: Vec<Read<'a>> = Vec::new();
    let mut rivals = Vec::new();
    for (reader, tally) in ranked {
        let claimed = |(id, extended): &(u32, bool)| {
            spoken.iter().any(|(other, _)| other.dissector.claims(*id, *extended))
        };
        // Identifiers that nobody else claims, and answers on them where others' are among those that
        // it would claim; or axes that answers prove on identifiers that others claim.
        let free = tally.ids.iter().filter(|id| !claimed(id)).count();
        let own = free > 0 && (free == tally.ids.len() || tally.pairs.found >= PROOF);
        let beside = own || tally.won().next().is_some();
        let holds = match spoken.is_empty() {
            true => rivals.is_empty() && tally.is_more_than_chance(),
            false => beside && tally.good_bytes > tally.broken_bytes,
        };
        if holds { &mut spoken } else { &mut rivals }.push((*reader, *tally));
    }
    (spoken, rivals)
}

/// What a reader made of a link.
type Read<'a> = (&'a Reader, &'a Tally);

/// The axes that may be each protocol's by identifiers that several use, but those that one of them
/// is proven to have.
fn shared(read: &[Read<'_>]) -> Vec<(&'static str, Vec<u32>)> {
    let won: BTreeSet<u32> = read.iter().flat_map(|(_, tally)| tally.won()).collect();
    let open = |tally: &Tally| -> Vec<u32> {
        tally.shared.keys().copied().filter(|axis| !won.contains(axis)).collect()
    };
    let named = read.iter().map(|(reader, tally)| (reader.dissector.name(), open(tally)));
    named.filter(|(_, axes)| !axes.is_empty()).collect()
}

impl Tally {
    /// Axes that share identifiers with other protocols and are this one's all the same.
    fn won(&self) -> impl Iterator<Item = u32> + '_ {
        self.shared.keys().copied().filter(|axis| self.proven.contains(axis))
    }

    /// Answers prove it, and it has identifiers that the other has not.
    fn is_proven_beside(&self, other: &Self) -> bool {
        self.pairs.found >= PROOF && !self.ids.is_subset(&other.ids)
    }

    /// Frames on shared identifiers are whole where their axis is proven, else nobody's.
    fn settle(&mut self) {
        for (axis, (frames, bytes)) in &self.shared {
            if self.proven.contains(axis) {
                self.frames += frames;
                self.good_bytes += bytes;
            } else {
                self.stray_bytes += bytes;
            }
        }
    }

    /// Takes a frame that may be another protocol's.
    fn share_frame(&mut self, axis: Option<u32>, bytes: u64) {
        let room = self.shared.len() < AXES_MAX;
        match axis.filter(|axis| room || self.shared.contains_key(axis)) {
            None => self.stray_bytes += bytes,
            Some(axis) => {
                let (frames, sum) = self.shared.entry(axis).or_default();
                (*frames, *sum) = (*frames + 1, *sum + bytes);
            }
        }
    }

    fn bytes(&self) -> u64 {
        self.good_bytes + self.broken_bytes + self.stray_bytes
    }

    /// Share of the bytes that are in frames whose check agrees.
    fn good_share(&self) -> f64 {
        self.good_bytes as f64 / self.bytes().max(1) as f64
    }

    /// Share of the bytes that are explained.
    fn share(&self) -> f64 {
        let good = self.good_bytes as f64 + BROKEN_WORTH * self.broken_bytes as f64;
        good / (self.bytes().max(1)) as f64
    }

    fn is_more_than_chance(&self) -> bool {
        let enough_to_doubt = self.bytes() > 256;
        self.share() > if enough_to_doubt { CHANCE } else { 0.0 }
    }
}

fn weigh(dissector: &dyn Dissector, tallies: &mut Vec<Tally>, event: &Event<'_>) {
    let at = tallies.iter().position(|tally| tally.link == event.link).unwrap_or_else(|| {
        tallies.push(Tally { link: event.link.to_owned(), ..Tally::default() });
        tallies.len() - 1
    });
    let tally = &mut tallies[at];
    let bytes = event.bytes.len().max(1) as u64;
    let id = event.id.map(|id| (id, event.extended));
    let shares = id.is_some_and(|(id, extended)| dissector.shares(id, extended));
    if id.is_some() && event.protocol.is_some() && event.wrong.is_none() {
        tally.pairs.take(dissector, event);
    }
    if event.protocol.is_none() || event.stray || (shares && event.wrong.is_some()) {
        tally.stray_bytes += bytes;
    } else if event.wrong.is_some() {
        tally.broken += 1;
        tally.broken_bytes += bytes;
    } else if shares {
        tally.share_frame(event.explained.axis, bytes);
    } else {
        tally.frames += 1;
        tally.good_bytes += bytes;
        if tally.proven.len() < AXES_MAX {
            tally.proven.extend(event.explained.axis);
        }
        if tally.ids.len() < IDS_MAX {
            tally.ids.extend(id);
        }
    }
}
