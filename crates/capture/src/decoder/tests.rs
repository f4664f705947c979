//! Frames whose way is known go as they would if it had to be found.

use std::fmt::Write as _;

use polepair_drives::cia402::profile::CIA402;

use crate::text::{FrameTextWriter, NoticeLevel, TextStyle};
use crate::{CaptureDecoder, DecodedFrame, FrameBatch, FrameRun, Rules, jsonl};

/// A bus with nearly every kind of traffic, in an order drawn from `seed`.
struct RandomLog {
    log: String,
    us: u64,
    seed: u64,
}

impl RandomLog {
    fn random(&mut self, below: u64) -> u64 {
        self.seed ^= self.seed << 13;
        self.seed ^= self.seed >> 7;
        self.seed ^= self.seed << 17;
        (self.seed >> 20) % below
    }

    fn line(&mut self, frame: &str) {
        let (seconds, us) = (self.us / 1_000_000, self.us % 1_000_000);
        let _ = writeln!(self.log, "({seconds:010}.{us:06}) can0 {frame}");
        self.us += 100 + self.random(20_000);
    }

    fn frame(&mut self, id: u64, data: &[u8]) {
        let mut frame = format!("{id:03X}#");
        data.iter().for_each(|byte| _ = write!(frame, "{byte:02X}"));
        self.line(&frame);
    }

    fn write(&mut self, node: u64, index: u16, sub: u8, raw: u32) {
        let ([low, high], [a, b, c, d]) = (index.to_le_bytes(), raw.to_le_bytes());
        self.frame(0x600 + node, &[0x23, low, high, sub, a, b, c, d]);
        self.frame(0x580 + node, &[0x60, low, high, sub, 0, 0, 0, 0]);
    }

    fn map(&mut self, node: u64) {
        const ENTRIES: [u32; 9] = [
            0x6040_0010,
            0x6041_0010,
            0x6064_0020,
            0x6061_0008,
            0x603F_0010,
            0x2000_0110,
            0x6077_0010,
            0x0005_0008,
            0x2500_0003,
        ];
        let index = self.pick(&[0x1A00, 0x1A01, 0x1600, 0x1601, 0x1A02]);
        let count = self.random(4);
        self.write(node, index, 0, 0);
        for sub in 1..=count {
            let entry = self.pick(&ENTRIES);
            self.write(node, index, sub as u8, entry);
        }
        self.write(node, index, 0, count as u32);
    }

    fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.random(of.len() as u64) as usize]
    }

    fn step(&mut self) {
        let (node, data) = (1 + self.random(4), self.random(1 << 40));
        let data = data.wrapping_mul(0x9E37_79B9_7F4A_7C15).to_le_bytes();
        let some = &data[..self.random(9) as usize];
        let id = self.random(0x800);
        match self.random(16) {
            0 => self.map(node),
            1 => {
                let index = self.pick(&[0x1800, 0x1801, 0x1400]);
                self.write(node, index, 1, id as u32);
            }
            2 => {
                let command = self.pick(&[1, 2, 128, 129, 130]);
                self.frame(0, &[command, node as u8]);
            }
            3 => self.frame(0x80 + node, &data),
            4 => {
                let state = self.pick(&[0, 4, 5, 127]);
                self.frame(0x700 + node, &[state]);
            }
            5 => self.frame(0x600 + node, &data),
            6 => self.frame(0x580 + node, &data),
            7 => self.line(&format!("{:03X}#R", 0x180 + node)),
            8 => self.line("20000004#0004000000000000"),
            9 => self.line("no frame"),
            10 => self.frame(id, some),
            11 => self.line(&format!("{:08X}#0102", 0x0400_A000 + node)),
            12 => self.frame(0x280 + node, &data),
            13 => self.frame(0x200 + node, &data[2..]),
            _ => self.frame(0x180 + node, some),
        }
    }
}

/// Path of a log through the decoder.
#[derive(Clone, Copy, PartialEq, Debug)]
enum DecodePath {
    /// Frame by frame, with what is known of identifiers kept.
    Cached,
    /// Frame by frame, with that forgotten again and again.
    Uncached,
    /// Batches, each event taken out of them.
    Batched,
}

/// Decodes a log to its text.
fn decode_to_text(log: &str, rules: &str, bare: bool, way: DecodePath) -> String {
    let rules = Rules::parse(rules).unwrap_or_default();
    let mut decoder = CaptureDecoder::new(rules).with_profile(Some(&CIA402));
    if bare {
        decoder = decoder.without_text();
    }
    let mut text = FrameTextWriter::new(TextStyle {
        notices: NoticeLevel::All,
        marks: true,
        ..TextStyle::default()
    });
    let mut out = Vec::new();
    let mut write = |event: &DecodedFrame<'_>| {
        text.write(event, &mut out);
        jsonl::write_frame(event, &mut out);
    };
    let mut batch = FrameBatch::default();
    // A piece need not end where a line does.
    let piece = if way == DecodePath::Batched { 777 } else { 70 };
    for piece in log.as_bytes().chunks(piece) {
        if way == DecodePath::Uncached {
            decoder.set_profile(&CIA402);
        }
        if way == DecodePath::Batched {
            decoder.decode_batch(piece, &mut batch, &mut |batch| batch.for_each_frame(&mut write));
            batch.for_each_frame(&mut write);
        } else {
            decoder.feed(piece, &mut write);
        }
    }
    String::from_utf8(out).expect("text")
}

/// Logs on which nearly everything happens.
fn logs() -> impl Iterator<Item = String> {
    [0x5EED, 0xFACE_FEED].into_iter().map(|seed| {
        let mut bus = RandomLog { log: String::new(), us: 1_700_000_000_000_000, seed };
        (0..1500).for_each(|_| bus.step());
        bus.log
    })
}

#[test]
fn no_way_through_the_decoder_says_anything_else() {
    for log in logs() {
        for rules in ["", "canopen", "tmcl,canopen", "canopen@1,thruster@2"] {
            for bare in [false, true] {
                let stored = decode_to_text(&log, rules, bare, DecodePath::Cached);
                for way in [DecodePath::Uncached, DecodePath::Batched] {
                    let other = decode_to_text(&log, rules, bare, way);
                    let differs = stored.lines().zip(other.lines()).find(|(one, two)| one != two);
                    assert_eq!(differs, None, "{way:?}, {rules}");
                    assert!(stored == other && stored.len() > 100_000);
                }
            }
        }
    }
}

/// The lines of a log, in pieces of this many bytes.
fn lines(log: &str, rules: &str, style: TextStyle, batches: Option<usize>) -> String {
    let mut decoder = CaptureDecoder::new(Rules::parse(rules).unwrap_or_default());
    let (mut text, mut out, mut batch) =
        (FrameTextWriter::new(style), Vec::new(), FrameBatch::default());
    let Some(piece) = batches else {
        decoder.feed(log.as_bytes(), &mut |event| text.write(event, &mut out));
        return String::from_utf8(out).expect("text");
    };
    for piece in log.as_bytes().chunks(piece) {
        // Each batch by a writer of its own, unless marks hang on those before.
        if !style.marks {
            text = FrameTextWriter::new(style);
        }
        decoder.decode_batch(piece, &mut batch, &mut |batch| text.write_batch(batch, &mut out));
        text.write_batch(&batch, &mut out);
    }
    String::from_utf8(out).expect("text")
}

/// A bus on which nothing happens but process data, as long as it is.
fn steady() -> String {
    let mut bus = RandomLog { log: String::new(), us: 1_700_000_000_000_000, seed: 7 };
    for (index, entries) in
        [(0x1A00, [0x6041_0010, 0x6064_0020]), (0x1600, [0x607A_0020, 0x2000_0110])]
    {
        bus.write(3, index, 0, 0);
        bus.write(3, index, 1, entries[0]);
        bus.write(3, index, 2, entries[1]);
        bus.write(3, index, 0, 2);
    }
    for _ in 0..5_000 {
        let data = bus.random(u64::MAX).to_le_bytes();
        bus.frame(0x183, &[0x37, 0x16, data[0], data[1], data[2], data[3] & data[4]]);
        bus.frame(0x203, &data[..6]);
    }
    bus.log
}

/// Process data of a bus whose mappings the capture does not show: of the usual lengths, and of others.
fn unmapped() -> String {
    let mut bus = RandomLog { log: String::new(), us: 1_700_000_000_000_000, seed: 11 };
    for _ in 0..2_000 {
        let data = bus.random(u64::MAX).to_le_bytes();
        let word = bus.pick(&[0x0637_u16, 0x1637, 0x0250, 0x0231]).to_le_bytes();
        bus.frame(0x183, &word);
        bus.frame(0x284, &[word[0], word[1], 8]);
        bus.frame(0x384, &[word[0], word[1], data[0], data[1], data[2], data[3]]);
        bus.frame(0x205, &[0x0F, 0, data[4], data[5]]);
        bus.frame(0x485, &data);
    }
    bus.log
}

#[test]
fn lines_of_batches_are_those_of_events() {
    let styles = [
        TextStyle::default(),
        TextStyle { notices: NoticeLevel::None, ..TextStyle::default() },
        TextStyle { notices: NoticeLevel::All, ..TextStyle::default() },
        TextStyle { marks: true, ..TextStyle::default() },
        TextStyle { colour: true, marks: true, ..TextStyle::default() },
    ];
    for log in logs().chain([steady(), unmapped()]) {
        for style in styles {
            let plain = lines(&log, "canopen", style, None);
            for piece in [100, 5000, 1 << 20] {
                let other = lines(&log, "canopen", style, Some(piece));
                let differs = plain.lines().zip(other.lines()).find(|(one, two)| one != two);
                assert_eq!(differs, None, "{style:?}, {piece}");
                assert!(plain == other);
            }
        }
    }
}

#[test]
fn process_data_that_change_nothing_are_not_explained() {
    for log in [steady(), unmapped()] {
        let mut decoder = CaptureDecoder::new(Rules::parse("canopen").expect("rules"));
        let (mut batch, mut plain, mut reported) = (FrameBatch::default(), 0, 0);
        let count = &mut |batch: &mut FrameBatch| {
            let of = |it: FrameRun<'_>| if let FrameRun::Compact(run) = it { run.len() } else { 0 };
            let here: usize = batch.runs().map(of).sum();
            (plain, reported) = (plain + here, reported + batch.len() - here);
        };
        decoder.decode_batch(log.as_bytes(), &mut batch, count);
        count(&mut batch);
        assert!(reported < 40 && plain > 9_950, "{reported} and {plain}");
    }
}
