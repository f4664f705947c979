//! A log of requests and answers gives the same in batches as frame by frame: text, lines of JSON and summary.

use std::fmt::Write as _;

use polepair_core::proto::modbus::rtu;

use crate::jsonl::{write_frame, write_notice};
use crate::read::LineScan;
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

/// Numbers of all sizes, which repeat: an answer that is known comes with each.
fn numbers() -> impl Iterator<Item = u32> {
    const EDGES: [u32; 12] =
        [0, 1, 9, 10, 0x7F, 0xEEEE, 0x7FFF, 0x8000, 0xFFFF, 0x7FFF_FFFF, 0x8000_0000, u32::MAX];
    let mut state = 1_u32;
    (0..300_usize).map(move |at| {
        state = state.wrapping_mul(0x915F_77F5).wrapping_add(1);
        EDGES.get(at % 20).copied().unwrap_or(state >> (at % 31))
    })
}

/// TMCL: three parameters, one of which is refused now and then; a version, whose number is text too.
fn tmcl_numbers() -> String {
    let mut log = TestLog::default();
    let mut send = |way: char, bytes: &[u8]| {
        let sum = bytes.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte));
        let digits: Vec<_> = bytes.iter().chain([&sum]).map(|byte| format!("{byte:02X}")).collect();
        log.line(900, &format!("tty0 {way} {}", digits.join(" ")));
    };
    for (round, number) in numbers().enumerate() {
        let [a, b, c, d] = number.to_be_bytes();
        for (opcode, kind) in [(6, 1), (6, 3), (6, 151), (10, 77), (136, 1)] {
            let status = if round % 30 == 29 { 4 } else { 100 };
            send('>', &[1, opcode, kind, 0, 0, 0, 0, 0]);
            send('<', &[2, 1, status, opcode, a, b, c, d]);
        }
    }
    log.text
}

/// Modbus RTU: registers with and without a unit, one whose numbers have names, and one that is half of a number.
fn modbus_numbers() -> String {
    let mut log = TestLog::default();
    let mut send = |way: char, bytes: &[u8]| {
        let [low, high] = rtu::crc16(bytes).to_le_bytes();
        let whole = [bytes, &[low, high]].concat();
        let digits: Vec<_> = whole.iter().map(|byte| format!("{byte:02X}")).collect();
        log.line(900, &format!("tty0 {way} {}", digits.join(" ")));
    };
    for number in numbers() {
        let [a, b, c, d] = number.to_be_bytes();
        for (address, count) in [(0x102E, 2), (0x1000, 1), (0x0002, 1), (0x102F, 1), (0x0033, 2)] {
            let [high, low] = u16::to_be_bytes(address);
            send('>', &[1, 3, high, low, 0, count]);
            send('<', &[&[1, 3, 2 * count], &[a, b, c, d][..2 * usize::from(count)]].concat());
        }
    }
    log.text
}

/// A thruster's answers of all commands that ask; EE EE refuses.
fn thruster_numbers() -> String {
    let mut log = TestLog::default();
    for number in numbers() {
        for command in ["QV", "QC", "QP", "QT", "EF", "QA", "QR", "EQ", "RP", "VM"] {
            let letters = command.bytes().map(|byte| format!("{byte:02X}")).collect::<String>();
            log.line(400, &format!("can0 304#{letters}0000"));
            log.line(400, &format!("can0 284#{letters}0000{number:08X}"));
        }
    }
    log.text
}

/// SDO reads of numbers with and without a sign, a name and words for them, in all sizes; of two nodes, one of which is
/// identified after a while.
fn sdo_numbers() -> String {
    let mut log = TestLog::default();
    let reads: [(u32, u32); 9] = [
        (0x6064_0000, 4),
        (0x606C_0000, 4),
        (0x6077_0000, 2),
        (0x6041_0000, 2),
        (0x6061_0000, 1),
        (0x2030_0100, 2),
        (0x6502_0000, 4),
        (0x1017_0000, 2),
        (0x1800_0200, 1),
    ];
    for (round, number) in numbers().enumerate() {
        for node in [1, 2] {
            for (object, len) in reads {
                let [a, b, sub, _] = object.to_be_bytes();
                let command = 0x43 + 4 * (4 - len);
                let shown = if len == 4 { number } else { number & !(u32::MAX << (8 * len)) };
                let data = shown.swap_bytes();
                log.line(400, &format!("can0 60{node}#40{b:02X}{a:02X}{sub:02X}00000000"));
                if round % 50 == 21 {
                    let toggled = format!("can0 58{node}#80{b:02X}{a:02X}{sub:02X}00000206");
                    log.line(400, &toggled);
                } else {
                    log.line(
                        400,
                        &format!("can0 58{node}#{command:02X}{b:02X}{a:02X}{sub:02X}{data:08X}"),
                    );
                }
            }
        }
        if round == 150 {
            log.line(400, "can0 602#4018100100000000");
            log.line(400, "can0 582#431810019A020000");
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

/// Outputs of the same log in batches, whose usual lines were read before if `is_scanned`.
fn by_batches(log: &str, rules: &str, style: TextStyle, is_scanned: bool) -> Outputs {
    let mut decoder = CaptureDecoder::new(Rules::parse(rules).expect("rules"));
    let (mut writer, mut summary) = (FrameTextWriter::new(style), Summary::default());
    let (mut text, mut json, mut batch) = (Vec::new(), Vec::new(), FrameBatch::default());
    let mut take = |batch: &mut FrameBatch| {
        writer.write_batch(batch, &mut text);
        batch.for_each_frame(&mut |event| write_json(event, &mut json));
        summary.add_batch(batch);
    };
    let mut scan = LineScan::default();
    // The format of the capture is known from its first piece on.
    let half = log[..log.len() / 2].rfind('\n').map_or(0, |at| at + 1);
    for piece in [&log.as_bytes()[..half], &log.as_bytes()[half..]] {
        if is_scanned {
            scan.scan(piece);
            decoder.decode_scanned(piece, &scan, &mut batch, &mut take);
        } else {
            decoder.decode_batch(piece, &mut batch, &mut take);
        }
        take(&mut batch);
    }
    decoder.finish_batch(&mut batch, &mut take);
    take(&mut batch);
    outputs(text, json, &summary)
}

/// Text of the log, decoded without notices of values.
fn text_without_signals(log: &str, rules: &str, style: TextStyle) -> String {
    let decoder = CaptureDecoder::new(Rules::parse(rules).expect("rules"));
    let (mut decoder, mut writer) = (decoder.without_signals(), FrameTextWriter::new(style));
    let (mut text, mut batch) = (Vec::new(), FrameBatch::default());
    let mut take = |batch: &mut FrameBatch| writer.write_batch(batch, &mut text);
    decoder.decode_batch(log.as_bytes(), &mut batch, &mut take);
    take(&mut batch);
    decoder.finish_batch(&mut batch, &mut take);
    take(&mut batch);
    String::from_utf8(text).expect("text")
}

fn outputs(text: Vec<u8>, json: Vec<u8>, summary: &Summary) -> Outputs {
    (
        String::from_utf8(text).expect("text"),
        String::from_utf8(json).expect("text"),
        render_text(summary, &SummaryStyle::default()),
    )
}

#[test]
fn known_frames_read_as_explained_ones() {
    let logs = [
        (tmcl_log(), "tmcl"),
        (tmcl_numbers(), "tmcl"),
        (modbus_log(), "modbus-rtu"),
        (modbus_numbers(), "modbus-rtu"),
        (thruster_log(), "thruster"),
        (thruster_numbers(), "thruster"),
        (sdo_numbers(), "canopen"),
    ];
    for (log, rules) in logs {
        for notices in [NoticeLevel::Events, NoticeLevel::All, NoticeLevel::None] {
            let style = TextStyle { notices, ..TextStyle::default() };
            let frames = by_frames(&log, rules, style);
            if notices != NoticeLevel::All {
                assert!(text_without_signals(&log, rules, style) == frames.0, "{rules}");
            }
            for is_scanned in [false, true] {
                let batches = by_batches(&log, rules, style, is_scanned);
                let differs = frames.0.lines().zip(batches.0.lines()).find(|(one, two)| one != two);
                assert_eq!(differs, None, "{rules}");
                assert!(frames == batches, "{rules}: {} {}", frames.2, batches.2);
            }
        }
    }
}

/// Most frames of a poll are taken so; otherwise the test above compares one way with itself.
#[test]
fn frames_of_a_poll_are_known() {
    let logs = [
        (tmcl_log(), "tmcl", (115, 90)),
        (tmcl_numbers(), "tmcl", (1490, 850)),
        (modbus_numbers(), "modbus-rtu", (1490, 1480)),
        (thruster_log(), "thruster", (770, 700)),
        (thruster_numbers(), "thruster", (2970, 850)),
        (sdo_numbers(), "canopen", (5300, 2500)),
    ];
    for (log, rules, (least_requests, least_answers)) in logs {
        let mut decoder = CaptureDecoder::new(Rules::parse(rules).expect("rules"));
        let mut batch = FrameBatch::default();
        decoder.decode_batch(log.as_bytes(), &mut batch, &mut |_| {});
        let (mut requests, mut answers) = (0, 0);
        for run in batch.runs() {
            match run {
                FrameRun::Compact(frames) => requests += frames.len(),
                FrameRun::Answer(_) => answers += 1,
                FrameRun::Stored(_) => {}
            }
        }
        assert!(requests >= least_requests, "{rules}: {requests} requests");
        assert!(answers >= least_answers, "{rules}: {answers} answers");
    }
}
