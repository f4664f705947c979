//! The frames that pass: explained, kept for a while, counted by kind, and which of their bytes
//! changed since the last of their kind.

use std::collections::{BTreeMap, VecDeque};
use std::fmt::Write as _;
use std::time::Duration;

use polepair::wire::OpenWire;
use polepair_capture::{Changes, Decoder, Event, Rules, Stamp, about, meaning};
use polepair_core::explain::Direction as Said;
use polepair_core::profile::Profile;
use polepair_core::time::Instant;
use polepair_link::{clock, tap};

use crate::ears::{Heard, Unit, short};

/// Frames that can be scrolled back to.
pub const FRAMES_MAX: usize = 20_000;
/// Kinds of frames that are told apart; frames of further ones have no row of their own.
const KINDS_MAX: usize = 2_000;
/// Bits of a byte on a serial line: start, eight, stop.
const BITS_PER_BYTE: u64 = 10;
/// Over how long rates are taken.
const RATES_EVERY: Duration = Duration::from_secs(1);

/// A frame as it is shown.
#[derive(Clone, Debug)]
pub struct Row {
    /// Its number among all frames, from 0.
    pub number: u64,
    /// When, in nanoseconds since 1970.
    pub time: u64,
    /// The number of its wire.
    pub wire: usize,
    /// Who sent it, where that is known.
    pub direction: Option<Said>,
    /// The protocol that explains it.
    pub protocol: Option<&'static str>,
    /// Its CAN identifier, and whether that has 29 bits.
    pub id: Option<(u32, bool)>,
    /// Its bytes.
    pub bytes: Vec<u8>,
    /// A bit for each of the first 64 bytes that changed.
    pub changed: u64,
    /// What it says.
    pub text: String,
    /// What is wrong with it; empty for nothing.
    pub wrong: String,
    /// Everything about it that a filter may name, in small letters.
    pub haystack: String,
}

/// Frames of one kind.
#[derive(Clone, Debug)]
pub struct Kind {
    /// The last of them.
    pub last: Row,
    /// How many there were.
    pub count: u64,
    /// Nanoseconds from the last but one to the last.
    pub period: Option<u64>,
}

/// What makes frames one kind: the wire, and what they are about there.
type Key = (usize, Vec<u8>);

/// What passes on all wires.
pub struct Traffic {
    wires: Vec<Wire>,
    listening: bool,
    kept: Kept,
    /// When rates were last taken.
    paced: Instant,
    per_second: f64,
    /// Units that came faster than they were looked at.
    pub lost: u64,
}

/// A wire, and what passed on it since rates were last taken.
struct Wire {
    name: String,
    decoder: Decoder,
    /// Bits per second, where that is known.
    rate: Option<u32>,
    bits: u64,
    load: Option<f64>,
}

#[derive(Default)]
struct Kept {
    rows: VecDeque<Row>,
    kinds: BTreeMap<Key, Kind>,
    changes: Changes,
    count: u64,
    wrong: u64,
    /// Frames since rates were last taken.
    recent: u64,
}

/// How the frames of a wire are explained.
#[derive(Default)]
pub struct Spoken {
    /// Which protocol is whose.
    pub rules: Rules,
    /// The drive whose names are used.
    pub profile: Option<&'static Profile>,
}

impl Traffic {
    /// For these wires. Where nobody commands, who speaks is not known.
    pub fn new(wires: &[OpenWire], spoken: Vec<Spoken>, listening: bool) -> Self {
        let wire = |(wire, spoken): (&OpenWire, Spoken)| Wire {
            name: short(&wire.name),
            decoder: Decoder::new(spoken.rules).with_profile(spoken.profile),
            rate: wire.rate,
            bits: 0,
            load: None,
        };
        Self {
            wires: wires.iter().zip(spoken).map(wire).collect(),
            listening,
            kept: Kept::default(),
            paced: Instant::ZERO,
            per_second: 0.0,
            lost: 0,
        }
    }

    /// For links that somebody else watches and explains.
    pub fn told_of(links: Vec<String>) -> Self {
        let wire = |name| Wire {
            name,
            decoder: Decoder::new(Rules::default()),
            rate: None,
            bits: 0,
            load: None,
        };
        Self {
            wires: links.into_iter().map(wire).collect(),
            listening: false,
            kept: Kept::default(),
            paced: Instant::ZERO,
            per_second: 0.0,
            lost: 0,
        }
    }

    /// Takes a frame that was explained elsewhere; what its kind is, is told by `about`.
    pub fn told(&mut self, row: Row, about: &str) {
        let key = (row.wire, about.as_bytes().to_vec());
        let before = self.kept.kinds.get(&key).map(|kind| &kind.last.bytes);
        let differs = |(n, byte): (usize, &u8)| before.is_some_and(|b| b.get(n) != Some(byte));
        let marked = row.bytes.iter().enumerate().take(64);
        let bits = marked.filter(|one| differs(*one)).fold(0, |bits, (n, _)| bits | 1 << n);
        self.kept.put(Row { changed: bits, ..row }, key);
    }

    /// Explains what was heard; `show` sees each frame as the decoder gives it.
    pub fn take(&mut self, heard: &Heard, show: &mut dyn FnMut(&Event<'_>)) {
        let Heard { wire: number, at, direction, unit } = heard;
        let Some(wire) = self.wires.get_mut(*number) else { return };
        let said = match direction {
            _ if self.listening => None,
            tap::Direction::ToDrive => Some(Said::ToDrive),
            tap::Direction::ToHost => Some(Said::ToHost),
        };
        let time = Some(Stamp(clock::wall_ns(*at)));
        let kept = &mut self.kept;
        let mut take = |event: &Event<'_>| {
            kept.keep(*number, event);
            show(event);
        };
        match unit {
            Unit::Bytes(bytes) => {
                wire.decoder.chunk(time, &wire.name, said, bytes, &mut take);
                wire.bits += bytes.len() as u64 * BITS_PER_BYTE;
            }
            Unit::Frame(frame) => {
                wire.decoder.frame(time, &wire.name, said, frame, &mut take);
                wire.bits += u64::from(polepair::frame_bits(frame));
            }
        }
    }

    /// Takes the rates, once a second.
    pub fn pace(&mut self, now: Instant) {
        if self.paced == Instant::ZERO {
            self.paced = now;
        }
        let spent = now.since(self.paced);
        if spent < RATES_EVERY {
            return;
        }
        let seconds = spent.as_secs_f64();
        self.paced = now;
        self.per_second = std::mem::take(&mut self.kept.recent) as f64 / seconds;
        for wire in &mut self.wires {
            let bits = std::mem::take(&mut wire.bits) as f64;
            wire.load = wire.rate.map(|rate| bits / seconds / f64::from(rate));
        }
    }

    /// Frames a second, all wires together.
    pub fn per_second(&self) -> f64 {
        self.per_second
    }

    /// The names of the wires, each with the share of its time that it was busy, where its rate is
    /// known.
    pub fn wires(&self) -> impl ExactSizeIterator<Item = (&str, Option<f64>)> {
        self.wires.iter().map(|wire| (wire.name.as_str(), wire.load))
    }

    /// How many frames there were, and how many of them break their protocol.
    pub fn counts(&self) -> (u64, u64) {
        (self.kept.count, self.kept.wrong)
    }

    /// The frames that are still kept.
    pub fn rows(&self) -> &VecDeque<Row> {
        &self.kept.rows
    }

    /// The last frame of each kind, in the order of their wires and identifiers.
    pub fn kinds(&self) -> impl Iterator<Item = &Kind> {
        self.kept.kinds.values()
    }

    /// Forgets the frames, and counts anew.
    pub fn clear(&mut self) {
        self.kept = Kept::default();
        self.lost = 0;
    }
}

impl Kept {
    fn keep(&mut self, wire: usize, event: &Event<'_>) {
        let row = Row {
            number: self.count,
            time: event.time.map_or(0, |time| time.0),
            wire,
            direction: event.direction,
            protocol: event.protocol,
            id: event.id.map(|id| (id, event.extended)),
            bytes: event.bytes.to_vec(),
            changed: self.changes.take(event),
            text: said(event),
            wrong: event.wrong.map_or_else(String::new, |wrong| wrong.to_string()),
            haystack: String::new(),
        };
        self.put(row, key(wire, event));
    }

    fn put(&mut self, mut row: Row, key: Key) {
        row.number = self.count;
        row.haystack = row.searched();
        let known = self.kinds.contains_key(&key);
        self.count += 1;
        self.recent += 1;
        self.wrong += u64::from(!row.wrong.is_empty());
        if known || self.kinds.len() < KINDS_MAX {
            let first = || Kind { last: row.clone(), count: 0, period: None };
            let kind = self.kinds.entry(key).or_insert_with(first);
            kind.period = (kind.count > 0).then(|| row.time.saturating_sub(kind.last.time));
            kind.count += 1;
            kind.last = row.clone();
        }
        if self.rows.len() == FRAMES_MAX {
            self.rows.pop_front();
        }
        self.rows.push_back(row);
    }
}

impl Row {
    /// `602#` or nothing, then the bytes.
    pub fn head(&self) -> String {
        match self.id {
            None => String::new(),
            Some((id, true)) => format!("{id:08X}#"),
            Some((id, false)) => format!("{id:03X}#"),
        }
    }

    fn searched(&self) -> String {
        let arrow = match self.direction {
            Some(Said::ToDrive) => '>',
            Some(Said::ToHost) => '<',
            None => ' ',
        };
        let mut text = format!("{arrow} {} {}", self.protocol.unwrap_or("?"), self.head());
        for byte in &self.bytes {
            // Writing into a String cannot fail.
            let _ = write!(text, "{byte:02X} ");
        }
        text.push_str(&self.text);
        if !self.wrong.is_empty() {
            let _ = write!(text, " ! {}", self.wrong);
        }
        text.to_lowercase()
    }
}

fn key(wire: usize, event: &Event<'_>) -> Key {
    let mut key = Vec::new();
    about(event, &mut |piece| key.extend_from_slice(piece));
    (wire, key)
}

fn said(event: &Event<'_>) -> String {
    let said = meaning(event);
    if event.echo { format!("echo: {said}") } else { said.to_owned() }
}
