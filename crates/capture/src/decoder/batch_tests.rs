//! A log of requests and answers gives the same in batches as frame by frame: text, lines of JSON and summary.

use std::fmt::Write as _;

use crate::jsonl::{write_frame, write_notice};
use crate::summary::{Summary, SummaryStyle, render_text};
use crate::text::{FrameTextWriter, NoticeLevel, TextStyle};
use crate::{CaptureDecoder, DecodedFrame, FrameBatch, FrameRun, Rules};

/// A log, written line by line.
#[derive(Default)]
struct TestLog {
    text: String,
    us: u64,
}

impl TestLog {
    fn line(&mut self, after_us: u64, rest: &str) {
        self.us += after_us;
        let (seconds, us) = (self.us / 1_000_000, self.us % 1_000_000);
        let _ = writeln!(self.text, "(17000000{seconds:02}.{us:06}) {rest}");
    }

    /// TMCL: a module whose position is polled.
    fn ask(&mut self) {
        self.line(900, "tty0 > 01 06 01 00 00 00 00 00 08");
    }

    fn answer(&mut self, value: u8) {
        let sum = 2 + 1 + 100 + 6 + u32::from(value);
        self.line(900, &format!("tty0 < 02 01 64 06 00 00 00 {value:02X} {:02X}", sum as u8));
    }
}

/// Polling, with each way in which it may be broken.
fn tmcl_log() -> String {
    let mut log = TestLog::default();
    for round in 0..200_u8 {
        log.ask();
        match round % 20 {
            // A lost answer, and a late one.
            7 => {}
            9 => log.line(1_300_000, ""),
            // An answer in two pieces, an answer that is none, a line of another link.
            11 => {
                log.line(900, "tty0 < 02 01 64 06");
                log.line(200, "tty0 < 00 00 00 05 72");
            }
            13 => log.line(900, "tty0 < 02 01 64 06 00 00 00 05 FF"),
            15 => log.line(10, "tty1 > 01 06 01 00 00 00 00 00 08"),
            _ => log.answer(round),
        }
        match round % 50 {
            // A request in two pieces, two in one, one without its direction, one again at once.
            17 => {
                log.line(900, "tty0 > 01 06 01 00 00");
                log.line(100, "tty0 > 00 00 00 08");
            }
            21 => {
                log.line(900, "tty0 > 01 06 01 00 00 00 00 00 08 01 06 01 00 00 00 00 00 08");
            }
            23 => log.line(900, "tty0 01 06 01 00 00 00 00 00 08"),
            25 => log.ask(),
            27 => log.line(900, "tty0 > 01 06 01 00 00 00"),
            _ => {}
        }
    }
    log.text
}

/// Modbus RTU: reads, a write whose answer repeats it, and a request of more bytes than are remembered.
fn modbus_log() -> String {
    let mut log = TestLog::default();
    for round in 0..100 {
        log.line(900, "tty0 > 01 03 10 2E 00 02 A0 C2");
        log.line(900, "tty0 < 01 03 04 1E F6 00 13 5D E4");
        log.line(900, "tty0 > 01 06 00 38 00 00 08 07");
        if round % 10 != 3 {
            log.line(900, "tty0 < 01 06 00 38 00 00 08 07");
        }
        log.line(900, "tty0 > 01 10 00 33 00 05 0A 00 01 00 02 00 03 00 04 00 05 00 00");
    }
    log.text
}

/// Thrusters that are asked for their speed and their faults, and answer, but for a few.
fn thruster_log() -> String {
    let mut log = TestLog::default();
    for round in 0..200 {
        for node in [1, 4] {
            log.line(400, &format!("can0 30{node}#51560000"));
            if round % 25 != 7 {
                log.line(400, &format!("can0 28{node}#51560000{round:08X}"));
            }
            log.line(400, &format!("can0 30{node}#45460000"));
            log.line(400, &format!("can0 28{node}#45460000{:08X}", round / 90));
            if round % 40 == 11 {
                log.line(400, &format!("can0 30{node}#5156{round:04X}"));
                log.line(400, &format!("can0 30{node}#R"));
                log.line(400, &format!("can0 0000030{node}#51560000"));
            }
        }
    }
    log.text
}

/// Text, lines of JSON, and summary.
type Outputs = (String, String, String);

fn write_json(event: &DecodedFrame<'_>, out: &mut Vec<u8>) {
    write_frame(event, out);
    event.notices.iter().for_each(|notice| write_notice(out, notice));
    out.push(b'\n');
}

/// Outputs of a log that is decoded frame by frame.
fn by_frames(log: &str, rules: &str, style: TextStyle) -> Outputs {
    let mut decoder = CaptureDecoder::new(Rules::parse(rules).expect("rules"));
    let (mut writer, mut summary) = (FrameTextWriter::new(style), Summary::default());
    let (mut text, mut json) = (Vec::new(), Vec::new());
    let mut take = |event: &DecodedFrame<'_>| {
        writer.write(event, &mut text);
        write_json(event, &mut json);
        summary.add_frame(event);
    };
    decoder.feed(log.as_bytes(), &mut take);
    decoder.finish(&mut take);
    outputs(text, json, &summary)
}

/// Outputs of the same log in batches.
fn by_batches(log: &str, rules: &str, style: TextStyle) -> Outputs {
    let mut decoder = CaptureDecoder::new(Rules::parse(rules).expect("rules"));
    let (mut writer, mut summary) = (FrameTextWriter::new(style), Summary::default());
    let (mut text, mut json, mut batch) = (Vec::new(), Vec::new(), FrameBatch::default());
    let mut take = |batch: &mut FrameBatch| {
        writer.write_batch(batch, &mut text);
        batch.for_each_frame(&mut |event| write_json(event, &mut json));
        summary.add_batch(batch);
    };
    decoder.decode_batch(log.as_bytes(), &mut batch, &mut take);
    take(&mut batch);
    decoder.finish_batch(&mut batch, &mut take);
    take(&mut batch);
    outputs(text, json, &summary)
}

fn outputs(text: Vec<u8>, json: Vec<u8>, summary: &Summary) -> Outputs {
    (
        String::from_utf8(text).expect("text"),
        String::from_utf8(json).expect("text"),
        render_text(summary, &SummaryStyle::default()),
    )
}

#[test]
fn repeated_requests_read_as_those_before() {
    let logs = [(tmcl_log(), "tmcl"), (modbus_log(), "modbus-rtu"), (thruster_log(), "thruster")];
    for (log, rules) in logs {
        for notices in [NoticeLevel::Events, NoticeLevel::All, NoticeLevel::None] {
            let style = TextStyle { notices, ..TextStyle::default() };
            let (frames, batches) = (by_frames(&log, rules, style), by_batches(&log, rules, style));
            let differs = frames.0.lines().zip(batches.0.lines()).find(|(one, two)| one != two);
            assert_eq!(differs, None, "{rules}");
            assert!(frames == batches, "{rules}: {} {}", frames.2, batches.2);
        }
    }
}

/// Most requests of a poll are taken so; otherwise the test above compares one way with itself.
#[test]
fn repeated_requests_are_kept_as_templates() {
    let logs = [(tmcl_log(), "tmcl", 120), (thruster_log(), "thruster", 700)];
    for (log, rules, least) in logs {
        let mut decoder = CaptureDecoder::new(Rules::parse(rules).expect("rules"));
        let mut batch = FrameBatch::default();
        decoder.decode_batch(log.as_bytes(), &mut batch, &mut |_| {});
        let compact = batch.runs().map(|run| match run {
            FrameRun::Compact(frames) => frames.len(),
            FrameRun::Stored(_) => 0,
        });
        let count = compact.sum::<usize>();
        assert!(count > least, "{rules}: {count} requests");
    }
}
