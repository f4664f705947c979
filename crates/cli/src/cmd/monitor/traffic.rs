//! Recent frames of the monitor: decoded, stored for a while, counted by kind, with the bytes that changed
//! since the last frame of their kind.

use std::collections::{BTreeMap, VecDeque};
use std::fmt::Write as _;
use std::time::Duration;

use polepair::wire::OpenWire;
use polepair_capture::{
    ByteChanges, CaptureDecoder, DecodedFrame, Explanation, Rules, Timestamp, meaning_text,
    visit_frame_key,
};
use polepair_core::explain::Direction as Said;
use polepair_core::profile::Profile;
use polepair_core::time::Instant;
use polepair_link::{clock, tap};

use crate::tap_queue::{QueuedUnit, UnitBuf, short_name};

/// Frames that can be scrolled back to.
pub const FRAMES_MAX: usize = 20_000;
/// Limit of distinguished kinds of frames; further ones have no row of their own.
const KINDS_MAX: usize = 2_000;
/// Bits of a byte on a serial line: start, eight, stop.
const BITS_PER_BYTE: u64 = 10;
/// Over how long rates are taken.
const RATES_EVERY: Duration = Duration::from_secs(1);

/// A frame as it is shown.
#[derive(Clone, Debug)]
pub struct FrameRow {
    /// Number among all frames, from 0.
    pub number: u64,
    /// Time, nanoseconds since 1970.
    pub time: u64,
    /// The number of its wire.
    pub wire: usize,
    /// Sender, if known.
    pub direction: Option<Said>,
    /// The protocol that explains it.
    pub protocol: Option<&'static str>,
    /// The axis that it concerns.
    pub axis: Option<u32>,
    /// CAN identifier, and whether it has 29 bits.
    pub id: Option<(u32, bool)>,
    /// Bytes of the frame.
    pub bytes: Vec<u8>,
    /// A bit for each of the first 64 bytes that changed.
    pub changed: u64,
    /// Meaning of the frame.
    pub text: String,
    /// Fault of the frame; empty for none.
    pub wrong: String,
    /// Everything about it that a filter may name, in small letters.
    pub search_text: String,
}

/// Frames of one kind.
#[derive(Clone, Debug)]
pub struct FrameGroup {
    /// The last of them.
    pub last: FrameRow,
    /// Number of frames.
    pub count: u64,
    /// Nanoseconds from the last but one to the last.
    pub period: Option<u64>,
}

/// Key of a kind of frames: the wire, and the subject on it.
type FrameGroupKey = (usize, Vec<u8>);

/// Log of the frames on all wires.
pub struct TrafficLog {
    wires: Vec<WireTraffic>,
    listening: bool,
    history: FrameHistory,
    /// Time at which rates were last computed.
    rates_at: Instant,
    per_second: f64,
    /// Units that came faster than they were looked at.
    pub lost: u64,
}

/// A wire, and what passed on it since rates were last taken.
struct WireTraffic {
    name: String,
    decoder: CaptureDecoder,
    /// Bits per second, where that is known.
    rate: Option<u32>,
    bits: u64,
    load: Option<f64>,
}

impl WireTraffic {
    /// A link of a server, which decodes its frames and knows its rate.
    fn remote(name: String) -> Self {
        let decoder = CaptureDecoder::new(Rules::default());
        Self { name, decoder, rate: None, bits: 0, load: None }
    }
}

#[derive(Default)]
struct FrameHistory {
    rows: VecDeque<FrameRow>,
    kinds: BTreeMap<FrameGroupKey, FrameGroup>,
    changes: ByteChanges,
    count: u64,
    wrong: u64,
    /// Frames since rates were last taken.
    recent: u64,
}

/// Decoding of the frames of a wire.
#[derive(Default)]
pub struct WireDecoding {
    /// Rules that assign protocols to addresses.
    pub rules: Rules,
    /// The drives at these addresses, whose names are used.
    pub drives: Vec<(u32, &'static Profile)>,
}

impl TrafficLog {
    /// Creates the log of these wires. Without a host here, senders are unknown.
    pub fn new(wires: &[OpenWire], protocols: Vec<WireDecoding>, listening: bool) -> Self {
        Self {
            wires: wires
                .iter()
                .zip(protocols)
                .map(|(wire, wire_decoding)| WireTraffic {
                    name: short_name(&wire.name),
                    decoder: CaptureDecoder::new(wire_decoding.rules)
                        .with_drive_profiles(wire_decoding.drives),
                    rate: wire.rate,
                    bits: 0,
                    load: None,
                })
                .collect(),
            listening,
            history: FrameHistory::default(),
            rates_at: Instant::ZERO,
            per_second: 0.0,
            lost: 0,
        }
    }

    /// Creates the log of links that a server watches and explains.
    pub fn for_remote(links: Vec<String>) -> Self {
        Self {
            wires: links.into_iter().map(WireTraffic::remote).collect(),
            listening: false,
            history: FrameHistory::default(),
            rates_at: Instant::ZERO,
            per_second: 0.0,
            lost: 0,
        }
    }

    /// Adds a link of a server, and returns its number among the wires.
    pub fn add_remote_wire(&mut self, name: String) -> usize {
        self.wires.push(WireTraffic::remote(name));
        self.wires.len() - 1
    }

    /// Adds a frame that a server explained; `about` gives its kind. Returns the frame and the name of its link.
    pub fn add_explained(&mut self, row: FrameRow, about: &str) -> (&FrameRow, &str) {
        let wire = row.wire;
        let key = (wire, about.as_bytes().to_vec());
        let before = self.history.kinds.get(&key).map(|kind| &kind.last.bytes);
        let differs = |(n, byte): (usize, &u8)| before.is_some_and(|b| b.get(n) != Some(byte));
        let marked = row.bytes.iter().enumerate().take(64);
        let bits = marked.filter(|one| differs(*one)).fold(0, |bits, (n, _)| bits | 1 << n);
        let row = self.history.add_row(FrameRow { changed: bits, ..row }, key);
        (row, &self.wires[wire].name)
    }

    /// Explains received frames; `show` gets each frame as the decoder gives it.
    pub fn add_received(
        &mut self,
        queued_unit: &QueuedUnit,
        show: &mut dyn FnMut(&DecodedFrame<'_>),
    ) {
        let QueuedUnit { wire: number, at, direction, unit } = queued_unit;
        let Some(wire) = self.wires.get_mut(*number) else { return };
        let statement = match direction {
            _ if self.listening => None,
            tap::TapDirection::ToDrive => Some(Said::ToDrive),
            tap::TapDirection::ToHost => Some(Said::ToHost),
        };
        let time = Some(Timestamp(clock::wall_ns(*at)));
        let frame_history = &mut self.history;
        let mut take = |event: &DecodedFrame<'_>| {
            frame_history.add_event(*number, event);
            show(event);
        };
        match unit {
            UnitBuf::Bytes(bytes) => {
                wire.decoder.decode_bytes(time, &wire.name, statement, bytes, &mut take);
                wire.bits += bytes.len() as u64 * BITS_PER_BYTE;
            }
            UnitBuf::Frame(frame) => {
                wire.decoder.decode_frame(time, &wire.name, statement, frame, &mut take);
                wire.bits += u64::from(polepair::frame_bits(frame));
            }
        }
    }

    /// Takes the rates, once a second.
    pub fn update_rates(&mut self, now: Instant) {
        if self.rates_at == Instant::ZERO {
            self.rates_at = now;
        }
        let spent = now.since(self.rates_at);
        if spent < RATES_EVERY {
            return;
        }
        let seconds = spent.as_secs_f64();
        self.rates_at = now;
        self.per_second = std::mem::take(&mut self.history.recent) as f64 / seconds;
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

    /// Number of frames, and of those that violate their protocol.
    pub fn counts(&self) -> (u64, u64) {
        (self.history.count, self.history.wrong)
    }

    /// The frames that are still kept.
    pub fn rows(&self) -> &VecDeque<FrameRow> {
        &self.history.rows
    }

    /// The last frame of each kind, in the order of their wires and identifiers.
    pub fn kinds(&self) -> impl Iterator<Item = &FrameGroup> {
        self.history.kinds.values()
    }

    /// Forgets the frames, and counts anew.
    pub fn clear(&mut self) {
        self.history = FrameHistory::default();
        self.lost = 0;
    }
}

impl FrameHistory {
    fn add_event(&mut self, wire: usize, event: &DecodedFrame<'_>) {
        let row = FrameRow {
            number: self.count,
            time: event.time.map_or(0, |time| time.0),
            wire,
            direction: event.direction,
            protocol: event.protocol,
            axis: event.explanation.axis,
            id: event.id.map(|id| (id, event.extended)),
            bytes: event.bytes.to_vec(),
            changed: self.changes.update(event),
            text: event_text(event),
            wrong: event.defect.map_or_else(String::new, |wrong| wrong.to_string()),
            search_text: String::new(),
        };
        self.add_row(row, kind_key(wire, event));
    }

    fn add_row(&mut self, mut row: FrameRow, key: FrameGroupKey) -> &FrameRow {
        row.number = self.count;
        row.search_text = row.build_search_text();
        let known = self.kinds.contains_key(&key);
        self.count += 1;
        self.recent += 1;
        self.wrong += u64::from(!row.wrong.is_empty());
        if known || self.kinds.len() < KINDS_MAX {
            let kind = self.kinds.entry(key).or_insert_with(|| FrameGroup {
                last: row.clone(),
                count: 0,
                period: None,
            });
            kind.period = (kind.count > 0).then(|| row.time.saturating_sub(kind.last.time));
            kind.count += 1;
            kind.last = row.clone();
        }
        if self.rows.len() == FRAMES_MAX {
            self.rows.pop_front();
        }
        self.rows.push_back(row);
        self.rows.back().expect("a row was just added")
    }
}

impl FrameRow {
    /// `602#` or nothing, then the bytes.
    pub fn id_text(&self) -> String {
        match self.id {
            None => String::new(),
            Some((id, true)) => format!("{id:08X}#"),
            Some((id, false)) => format!("{id:03X}#"),
        }
    }

    /// Has the frame shown like one that this program decoded.
    pub fn with_decoded(&self, link: &str, show: impl FnOnce(&DecodedFrame<'_>)) {
        let text = match &*self.wrong {
            "" => self.text.clone(),
            wrong => format!("{}  ! {wrong}", self.text),
        };
        let mut explanation = Explanation::default();
        (explanation.axis, explanation.text) = (self.axis, text);
        show(&DecodedFrame {
            number: self.number + 1,
            time: Some(Timestamp(self.time)),
            link,
            direction: self.direction,
            protocol: self.protocol,
            bytes: &self.bytes,
            id: self.id.map(|(id, _)| id),
            extended: self.id.is_some_and(|(_, extended)| extended),
            remote: false,
            remote_len: 0,
            echo: false,
            stray: false,
            explanation: &explanation,
            defect: None,
            notices: &[],
            offset: 0,
        });
    }

    fn build_search_text(&self) -> String {
        let arrow = match self.direction {
            Some(Said::ToDrive) => '>',
            Some(Said::ToHost) => '<',
            None => ' ',
        };
        let mut text = format!("{arrow} {} {}", self.protocol.unwrap_or("?"), self.id_text());
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

fn kind_key(wire: usize, event: &DecodedFrame<'_>) -> FrameGroupKey {
    let mut key = Vec::new();
    visit_frame_key(event, &mut |piece| key.extend_from_slice(piece));
    (wire, key)
}

fn event_text(event: &DecodedFrame<'_>) -> String {
    let text = meaning_text(event);
    if event.echo { format!("echo: {text}") } else { text.to_owned() }
}
