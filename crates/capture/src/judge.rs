//! Which protocol a capture speaks, when nobody says: every registered dissector reads the whole
//! capture, and what explains most of its bytes wins.

use core::fmt;

use polepair_core::explain::Dissector;
use polepair_core::proto;

use crate::decoder::{Decoder, Event};
use crate::rules::{Rule, Rules, Scope};

/// Share of bytes that a weak check (an 8-bit sum over nine bytes, tried at every offset) explains
/// by chance: 9 in 256.
const CHANCE: f64 = 9.0 / 256.0;
/// A frame whose check fails is worth this share of one that is right.
const BROKEN_WORTH: f64 = 0.1;

/// Axes of a link that are remembered: as many as a CAN bus can have with 11-bit identifiers.
const AXES_MAX: usize = 127;

/// Weighs a capture.
#[derive(Debug)]
pub struct Judge {
    readers: Vec<Reader>,
}

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
    /// Axes with whole frames.
    axes: Vec<u32>,
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
    /// The protocol; `None` when nothing explains it.
    pub protocol: Option<&'static dyn Dissector>,
    /// 0 for a guess, 1 for certainty.
    pub sure: f64,
    /// Whole frames.
    pub frames: u64,
    /// Frames whose check fails.
    pub broken: u64,
    /// Bytes that belong to no frame.
    pub stray_bytes: u64,
    /// The protocol that explains most after the first, and the share of the bytes it explains.
    pub runner_up: Option<(&'static str, f64)>,
    /// A protocol that may be spoken too, on identifiers that it shares with others, and the axes
    /// that would: no frame proves it, so it is for a person to say.
    pub shared: Option<(&'static str, Vec<u32>)>,
}

impl fmt::Debug for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(protocol) = self.protocol else {
            write!(f, "{}: no known protocol explains it", self.link)?;
            return self.show_shared(f);
        };
        let (name, percent) = (protocol.name(), self.sure * 100.0);
        write!(f, "{}: {name}, {percent:.0} % sure ({}", self.link, many(self.frames, "frame"))?;
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
        let Some((name, axes)) = &self.shared else { return Ok(()) };
        let first = self.protocol.map_or(String::new(), |first| format!("{},", first.name()));
        let rules: Vec<String> = axes.iter().map(|axis| format!("{name}@{axis}")).collect();
        let rules = rules.join(",");
        write!(f, "; some identifiers may be {name}'s: if they are, --as {first}{rules}")
    }
}

fn many(count: u64, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

impl Judge {
    /// Nothing weighed yet.
    #[must_use]
    pub fn new() -> Self {
        Self { readers: proto::dissectors().iter().copied().map(Reader::new).collect() }
    }

    /// Takes a piece of the capture, cut anywhere.
    pub fn feed(&mut self, piece: &[u8]) {
        for reader in &mut self.readers {
            let Reader { decoder, tallies, .. } = reader;
            decoder.feed(piece, &mut |event| weigh(tallies, event));
        }
    }

    /// The verdicts, one a link, and a decoder that holds to them.
    #[must_use]
    pub fn decide(mut self) -> (Vec<Verdict>, Decoder) {
        for reader in &mut self.readers {
            let Reader { decoder, tallies, .. } = reader;
            decoder.finish(&mut |event| weigh(tallies, event));
        }
        let links = self.readers.first().map_or_else(Vec::new, |reader| {
            reader.tallies.iter().map(|tally| tally.link.clone()).collect()
        });
        let verdicts: Vec<Verdict> = links.iter().map(|link| self.verdict(link)).collect();
        let rules = verdicts.iter().flat_map(|verdict| self.rules(verdict)).collect();
        let echoing = verdicts.iter().filter(|verdict| self.echoes(verdict));
        let echoing = echoing.map(|verdict| verdict.link.clone()).collect();
        (verdicts, Decoder::judged(Rules(rules), echoing))
    }

    fn verdict(&self, link: &str) -> Verdict {
        let read = self.readers.iter().filter_map(|reader| Some((reader, reader.tally(link)?)));
        let shares = |(reader, _): &(&Reader, &Tally)| reader.dissector.shares_identifiers();
        let (shared, mut ranked): (Vec<_>, Vec<_>) = read.partition(shares);
        let shared = shared.into_iter().find(|(_, tally)| !tally.axes.is_empty());
        let shared = shared.map(|(reader, tally)| (reader.dissector.name(), tally.axes.clone()));
        // Of two that find no whole frame, the one with fewer pieces reads more into the bytes.
        ranked.sort_by(|(_, a), (_, b)| {
            b.share().total_cmp(&a.share()).then(a.broken.cmp(&b.broken))
        });
        let rivals = ranked.iter().skip(1).filter(|(_, tally)| tally.good_bytes > 0);
        let runner_up = rivals
            .map(|(reader, tally)| (reader.dissector.name(), tally.good_share()))
            .max_by(|(_, a), (_, b)| a.total_cmp(b));
        let best = ranked.first().filter(|(_, tally)| tally.is_more_than_chance());
        let Some((reader, best)) = best else {
            return Verdict { shared, ..Verdict::unknown(link) };
        };
        let rival = runner_up.map_or(0.0, |(_, share)| share).max(CHANCE);
        let accident = 0.5f64.powi(8 * i32::try_from(best.frames).unwrap_or(i32::MAX / 8).min(99));
        Verdict {
            link: link.to_owned(),
            protocol: Some(reader.dissector),
            sure: ((best.share() - rival) / best.share()).max(0.0) * (1.0 - accident),
            frames: best.frames,
            broken: best.broken,
            stray_bytes: best.stray_bytes,
            runner_up,
            shared,
        }
    }

    /// The winner on its link; on CAN the others too, for identifiers that the winner leaves.
    fn rules(&self, verdict: &Verdict) -> Vec<Rule> {
        let scope = Scope::Link(verdict.link.clone());
        let rule = |dissector| Rule { dissector, scope: scope.clone() };
        verdict.protocol.map(rule).into_iter().collect()
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
            broken: 0,
            stray_bytes: 0,
            runner_up: None,
            shared: None,
        }
    }
}

impl Reader {
    fn new(dissector: &'static dyn Dissector) -> Self {
        let rules = Rules(vec![Rule { dissector, scope: Scope::Anywhere }]);
        Self { dissector, decoder: Decoder::judged(rules, Vec::new()), tallies: Vec::new() }
    }

    fn tally(&self, link: &str) -> Option<&Tally> {
        self.tallies.iter().find(|tally| tally.link == link)
    }
}

impl Tally {
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

fn weigh(tallies: &mut Vec<Tally>, event: &Event<'_>) {
    let at = tallies.iter().position(|tally| tally.link == event.link).unwrap_or_else(|| {
        tallies.push(Tally { link: event.link.to_owned(), ..Tally::default() });
        tallies.len() - 1
    });
    let tally = &mut tallies[at];
    let bytes = event.bytes.len().max(1) as u64;
    if event.protocol.is_none() || event.stray {
        tally.stray_bytes += bytes;
    } else if event.wrong.is_some() {
        tally.broken += 1;
        tally.broken_bytes += bytes;
    } else {
        tally.frames += 1;
        tally.good_bytes += bytes;
        let axis = event.explained.axis.filter(|axis| !tally.axes.contains(axis));
        tally.axes.extend(axis.filter(|_| tally.axes.len() < AXES_MAX));
    }
}
