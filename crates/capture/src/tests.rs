//! Readers and writers, with lines as people's tools write them.

use polepair_core::explain::Direction;

use crate::read::parse_log_line;
use crate::{CaptureDecoder, Record, RecordData, Rules, Timestamp, jsonl, nearest_word, text};

fn line<'a>(text: &'a str, scratch: &'a mut Vec<u8>) -> Record<'a> {
    parse_log_line(text.as_bytes(), scratch).expect("readable").expect("not empty")
}

fn reason(text: &str) -> &'static str {
    parse_log_line(text.as_bytes(), &mut Vec::new()).expect_err("damaged").0
}

fn rendered(capture: &str) -> (String, Vec<String>) {
    let (mut out, mut decoder) = (Vec::new(), CaptureDecoder::new(Rules::default()));
    decoder.feed(capture.as_bytes(), &mut |event| jsonl::write_frame(event, &mut out));
    decoder.finish(&mut |event| jsonl::write_frame(event, &mut out));
    let damaged = decoder.statistics().damage.iter().map(ToString::to_string).collect();
    (String::from_utf8(out).expect("text"), damaged)
}

#[test]
fn serial_line() {
    let mut scratch = Vec::new();
    let line = line("(1700000000.000500) ttyUSB0 > 01 01 00 00 00 00 01 5E 61", &mut scratch);
    assert_eq!(line.time, Some(Timestamp(1_700_000_000_000_500_000)));
    assert_eq!((line.link, line.direction), ("ttyUSB0", Some(Direction::ToDrive)));
    assert_eq!(line.data, RecordData::Bytes(&[1, 1, 0, 0, 0, 0, 1, 0x5E, 0x61]));
}

#[test]
fn serial_line_without_spaces_or_arrow_spaces() {
    let mut scratch = Vec::new();
    let line = line("(1.5) COM3 <02C736", &mut scratch);
    assert_eq!(
        (line.direction, line.data),
        (Some(Direction::ToHost), RecordData::Bytes(&[2, 0xC7, 0x36]))
    );
}

#[test]
fn candump_lines() {
    let mut scratch = Vec::new();
    let RecordData::Frame(frame) = line("(1.0) can0 30B#5443000000000005", &mut scratch).data
    else {
        panic!("a frame")
    };
    assert_eq!((frame.id, frame.extended, frame.len), (0x30B, false, 8));
    assert_eq!(frame.bytes(), [0x54, 0x43, 0, 0, 0, 0, 0, 5]);
    let RecordData::Frame(frame) = line("(1.0) can0 0400A05E#3412", &mut scratch).data else {
        panic!("a frame")
    };
    assert_eq!((frame.id, frame.extended, frame.bytes()), (0x0400_A05E, true, &[0x34, 0x12][..]));
    let RecordData::Frame(frame) = line("(1.0) can0 123#R4", &mut scratch).data else {
        panic!("a frame")
    };
    assert_eq!((frame.remote, frame.len), (true, 4));
    assert_eq!(line("(1.0) can0 123#11 T", &mut scratch).direction, Some(Direction::ToDrive));
}

#[test]
fn data_alone_is_a_line_too() {
    let mut scratch = Vec::new();
    let bare = line("01 01 00 00 00 00 01 5E 61", &mut scratch);
    assert_eq!((bare.time, bare.link), (None, "-"));
    assert!(matches!(line("0400A05E#3412", &mut scratch).data, RecordData::Frame(_)));
}

#[test]
fn frames_have_comments_as_manuals_print_them() {
    let mut scratch = Vec::new();
    for text in [
        "602 2F 60 60 00 03 00 00 00//mode",
        "602 2F 60 60 00 03 00 00 00 // 设置6060h为3",
        "(1.0) can0 602#2F60600003000000 // mode",
    ] {
        let RecordData::Frame(frame) = line(text, &mut scratch).data else { panic!("{text}") };
        assert_eq!((frame.id, frame.bytes()[4]), (0x602, 3), "{text}");
    }
    assert!(parse_log_line(b"// a heading", &mut scratch).is_ok_and(|line| line.is_none()));
    assert!(parse_log_line(b"602 2F 6 // half a byte", &mut scratch).is_err());
}

#[test]
fn damage_is_reported_in_words() {
    assert_eq!(reason("(yesterday) can0 123#11"), "the time stamp is not seconds with decimals");
    assert_eq!(reason("(1.0 can0 123#11"), "the time stamp has no end");
    assert_eq!(reason("(1.0) ttyUSB0 > 01 0"), "a byte has only one hexadecimal digit");
    assert_eq!(reason("(1.0) ttyUSB0 >"), "the line has no bytes");
    assert_eq!(reason("(1.0) can0 800#11"), "a CAN identifier of 3 digits is at most 7FF");
    assert_eq!(
        reason("(1.0) can0 123456789#11"),
        "a CAN identifier has 3 digits, or 8 when it is extended"
    );
    assert_eq!(reason("(1.0) can0 123##1123"), "a byte has only one hexadecimal digit");
    assert_eq!(
        reason("(1.0) can0 40000000#11"),
        "a CAN identifier of 8 digits is at most 1FFFFFFF"
    );
    assert_eq!(reason("(1.0) can0 123#112233445566778899"), "a CAN frame has at most 8 bytes");
    assert_eq!(reason("hello"), "a byte has only one hexadecimal digit");
}

#[test]
fn damaged_lines_are_named_by_number_and_the_rest_is_read() {
    let (out, damaged) = rendered("(1.0) can0 123#11\nnonsense\n\n(2.0) can0 124#\n(3.0) can0 12");
    assert_eq!(damaged, ["line 2: expected bytes as hexadecimal digits"]);
    assert_eq!(out.lines().count(), 3, "{out}");
}

#[test]
fn unknown_frames_are_objects_too() {
    let (out, _) = rendered("(1700000000.000500) can0 30B#5443000000000005\n(1.0) COM3 < 01 0A\n");
    let expected = concat!(
        r#"{"time":1700000000.0005,"link":"can0","direction":null,"protocol":null,"#,
        r#""bytes":"5443000000000005","id":779,"extended":false,"kind":null,"axis":null,"#,
        r#""fields":{},"text":"","ok":true,"error":null,"number":1}"#,
        "\n",
        r#"{"time":1.0,"link":"COM3","direction":"rx","protocol":null,"bytes":"010A","id":null,"#,
        r#""extended":null,"kind":null,"axis":null,"fields":{},"text":"","ok":true,"error":null,"#,
        r#""number":2}"#,
        "\n",
    );
    assert_eq!(out, expected);
}

#[test]
fn text_is_aligned_and_plain_unless_coloured() {
    let mut decoder = CaptureDecoder::new(Rules::default());
    let (mut out, mut writer) =
        (Vec::new(), text::FrameTextWriter::new(text::TextStyle::default()));
    let capture = b"(10.5) ttyUSB0 > 01 02\n(10.75) can0 123#R\n";
    decoder.feed(capture, &mut |event| writer.write(event, &mut out));
    let expected = "   0.000000  ttyUSB0 > ?  01 02                       \
                    not a frame of any known protocol\n   \
                    0.250000  can0      ?  123#R                       remote request\n";
    assert_eq!(String::from_utf8(out).expect("text"), expected);
}

#[test]
fn times_keep_their_digits() {
    for (text, shown) in
        [("0.1", "0.1"), ("1700000000.123456789", "1700000000.123456789"), ("7", "7.0")]
    {
        assert_eq!(Timestamp::parse(text.as_bytes()).expect("a time").to_string(), shown);
    }
    assert_eq!(Timestamp::parse(b"-1.0"), None);
    assert_eq!(Timestamp::parse(b""), None);
}

#[test]
fn a_frame_outside_the_protocol_is_reported() {
    let (out, damaged) =
        rendered("(1.0) can0 123##3112233445566778899AA\n(1.0) can0 20000044#0030");
    assert_eq!(damaged, [] as [&str; 0]);
    let lines: Vec<&str> = out.lines().collect();
    assert!(lines[0].contains(r#""kind":"can-fd""#), "{out}");
    assert!(lines[1].contains("error-frame: bus-off, receive passive, transmit passive"), "{out}");
}

#[test]
fn the_nearest_word_is_found_or_none() {
    let words = ["tmcl", "modbus-rtu", "modbus-ascii", "tml"];
    assert_eq!(nearest_word("tmlc", words), Some("tmcl"), "swapped letters are one slip");
    assert_eq!(nearest_word("modbus", words), Some("modbus-rtu"));
    assert_eq!(nearest_word("ethercat", words), None);
    let error = Rules::parse("no-such-protocol@3").expect_err("unknown");
    assert_eq!(error.word, "no-such-protocol");
}

/// However it is cut, a line beyond the limit is named and left out, and what follows is read.
#[test]
fn a_line_that_is_too_long_is_damaged() {
    let long = "00 ".repeat(crate::read::LINE_MAX);
    let at_limit = format!("> {}{}", "00 ".repeat(10), " ".repeat(crate::read::LINE_MAX - 32));
    let capture = format!("> 01\n{long}\n> 02\n{at_limit}\n{long}");
    for size in [1_000, 1 << 16, capture.len()] {
        let (mut frames, mut decoder) = (Vec::new(), CaptureDecoder::new(Rules::default()));
        let mut keep = |event: &crate::DecodedFrame<'_>| frames.push(event.bytes.to_vec());
        capture.as_bytes().chunks(size).for_each(|piece| decoder.feed(piece, &mut keep));
        decoder.finish(&mut keep);
        let damaged: Vec<String> =
            decoder.statistics().damage.iter().map(ToString::to_string).collect();
        let expected = [2, 5].map(|n| format!("line {n}: it is longer than 65536 bytes"));
        assert_eq!(damaged, expected);
        assert_eq!(frames, [vec![1], vec![2], vec![0; 10]]);
    }
}

/// A bus with every kind of message: mappings that change in the middle, identifiers that are moved,
/// service data, states, faults, remote requests, strangers.
fn mixed_bus(mut seed: u64) -> String {
    use std::fmt::Write as _;
    let mut random = |below: u64| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) % below
    };
    let (mut log, mut time) = (String::new(), 1_700_000_000_000_000u64);
    for _ in 0..3000 {
        time += random(2000);
        let _ = write!(log, "({:010}.{:06}) can{} ", time / 1_000_000, time % 1_000_000, random(2));
        let node = 1 + random(3);
        let objects = [0x6041_0010u32, 0x6064_0020, 0x606C_0020, 0x6077_0010, 0x0005_0008];
        let _ = match random(12) {
            0 => {
                let (sub, raw) = (random(3) as u8, objects[random(5) as usize]);
                let raw = if sub == 0 { random(3) as u32 } else { raw }.swap_bytes();
                writeln!(log, "{:03X}#23001A{sub:02X}{raw:08X}", 0x600 + node)
            }
            1 => {
                let id = (0x180 + random(64) as u32).swap_bytes();
                writeln!(log, "{:03X}#2300180{}{id:08X}", 0x600 + node, 1)
            }
            2 => writeln!(log, "{:03X}#6000{:02X}{:02X}00000000", 0x580 + node, 0x1A, random(3)),
            3 => {
                writeln!(log, "{:03X}#{:02X}", 0x700 + node, [0, 4, 5, 0x7F, 9][random(5) as usize])
            }
            4 => writeln!(log, "{:03X}#{:04X}81AABBCCDDEE", 0x80 + node, random(0xFFFF)),
            5 => writeln!(log, "{:03X}#R", 0x180 + node),
            6 => writeln!(log, "{:08X}#01", random(0x1FFF_FFFF)),
            7 => writeln!(log, "{:03X}#0102", random(0x7FF)),
            8 => writeln!(log, "080#"),
            _ => {
                let id = [0x180, 0x200, 0x280, 0x380][random(4) as usize] + node;
                let bytes: String =
                    (0..random(9)).map(|_| format!("{:02X}", random(256))).collect();
                writeln!(log, "{id:03X}#{bytes}")
            }
        };
    }
    log
}

/// Everything but words and fields, cut at random places.
fn decode_to_lines(mut decoder: CaptureDecoder, log: &str, piece: usize) -> Vec<String> {
    let mut all = Vec::new();
    let mut keep = |event: &crate::DecodedFrame<'_>| {
        let explained = (event.explanation.axis, event.explanation.error);
        let crate::DecodedFrame {
            number,
            time,
            link,
            protocol,
            bytes,
            id,
            defect,
            notices,
            offset,
            ..
        } = *event;
        let frame = (number, time, link, protocol, bytes, id, event.remote, offset);
        all.push(format!("{frame:?} {explained:?} {defect:?} {notices:?}"));
    };
    log.as_bytes().chunks(piece).for_each(|piece| decoder.feed(piece, &mut keep));
    decoder.finish(&mut keep);
    decoder.finish_sessions(&mut keep);
    all
}

#[test]
fn without_words_the_rest_stays_the_same() {
    for seed in 0..8 {
        let log = mixed_bus(seed);
        for rules in ["canopen", "canopen@2,tmcl", "thruster@1,canopen@can0"] {
            let decoder = || CaptureDecoder::new(Rules::parse(rules).expect("rules"));
            let whole = decode_to_lines(decoder(), &log, log.len());
            let bare = decode_to_lines(decoder().without_text(), &log, 37 + 1000 * seed as usize);
            assert!(whole.iter().any(|line| line.contains("Signal(")), "nothing is told: {seed}");
            for (whole, bare) in whole.iter().zip(&bare) {
                assert_eq!(whole, bare, "seed {seed}, {rules}");
            }
            assert_eq!(whole.len(), bare.len());
        }
    }
}

/// A program's log with requests alone accuses no drive, until an answer shows that answers are in it.
#[test]
fn a_log_of_requests_alone_accuses_no_drive() {
    let requests = [
        ("modbus-rtu", "Tx: 01 03 00 33 00 01 74 05\n", "Rx: 01 03 02 00 05 78 47\n"),
        ("tmcl", "Tx: 01 06 01 00 00 00 00 00 08\n", "Rx: 02 01 64 06 00 00 02 C7 36\n"),
        (
            "canopen",
            "DEBUG sent 601#4041600000000000\nDEBUG sent 601#4064600000000000\n",
            "DEBUG 581#4364600010000000\n",
        ),
    ];
    let doubts = |protocol: &str, log: &str| {
        let mut decoder = CaptureDecoder::new(Rules::parse(protocol).expect("a protocol"));
        let mut doubts = 0;
        let mut count = |event: &crate::DecodedFrame<'_>| {
            doubts += event
                .notices
                .iter()
                .filter(|notice| matches!(notice, crate::session::SessionNotice::Anomaly(_)))
                .count();
        };
        decoder.feed(log.as_bytes(), &mut count);
        decoder.finish(&mut count);
        decoder.finish_sessions(&mut count);
        (doubts, decoder.has_requests_only())
    };
    for (protocol, sent, received) in requests {
        let alone = sent.repeat(4);
        let (found, only) = doubts(protocol, &alone);
        assert_eq!((found, only), (0, true), "{protocol}");
        // The first answer shows that the earlier ones are missing; a search for nodes is not held against them.
        let (found, only) = doubts(protocol, &format!("{alone}{sent}{received}"));
        assert!(!only && (found > 0 || protocol == "canopen"), "{protocol}: {found}");
    }
}

/// Module 2 has the address of hosts: without directions, its requests are no refusals.
#[test]
fn requests_to_module_2_are_read_without_directions() {
    for (opcode, kind, motor) in
        [(6, 1, 0), (6, 3, 0), (6, 100, 0), (5, 4, 2), (3, 0, 0), (1, 0, 3)]
    {
        let with_sum = |mut bytes: Vec<u8>| {
            bytes.push(bytes.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte)));
            bytes.iter().map(|byte| format!(" {byte:02X}")).collect::<String>()
        };
        let request = with_sum(vec![2, opcode, kind, motor, 0, 0, 1, 0]);
        let reply = with_sum(vec![2, 2, 100, opcode, 0, 0, 1, 0]);
        let log = format!("(1.000000) tty{request}\n(1.004000) tty{reply}\n");
        let mut decoder = CaptureDecoder::new(Rules::parse("tmcl").expect("a protocol"));
        let mut kinds = Vec::new();
        let mut keep = |event: &crate::DecodedFrame<'_>| {
            kinds.push(event.notices.len());
            assert!(!event.explanation.text.contains("refused"), "{}", event.explanation.text);
        };
        decoder.feed(log.as_bytes(), &mut keep);
        decoder.finish(&mut keep);
        assert!(kinds[1] > 0, "the reply settles {opcode} {kind} {motor}");
    }
}
