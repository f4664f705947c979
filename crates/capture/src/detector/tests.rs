//! Captures that are made anew for each seed, of one protocol on CAN or of two that share a bus: the
//! detector names the protocol, or leaves it to a person; it names no other protocol.

use core::fmt::Write as _;
use std::io::{Cursor, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use polepair_core::medium::Frame;
use polepair_core::proto::canopen::sdo;
use polepair_core::proto::thruster::wire::{CommandWord, Reply as Echo, Request as Order};
use polepair_core::proto::tmcl::opcode::{Opcode, Status};
use polepair_core::proto::tmcl::wire::{Reply, Request};
use polepair_core::proto::tml::online::{Cell, OnlineMessage};
use polepair_core::proto::tml::wire::{IdCode, Instruction, Message};
use polepair_core::proto::tml::{technocan, tmlcan};

use super::{LinkDetection, ProtocolDetector};
use crate::decoder::CaptureDecoder;
use crate::read::ReadOptions;

/// Captures that are made.
const SEEDS: u64 = 200;

/// Random numbers, and the capture that is made of them.
struct GeneratedBus {
    seed: u64,
    us: u64,
    log: String,
}

impl GeneratedBus {
    fn random(&mut self, below: u32) -> u32 {
        let seed = self.seed.wrapping_mul(6_364_136_223_846_793_005);
        self.seed = seed.wrapping_add(1_442_695_040_888_963_407);
        ((self.seed >> 33) as u32) % below
    }

    fn frame(&mut self, frame: &Frame, after: u32) {
        self.us += u64::from(after + self.random(after));
        let (s, us) = (self.us / 1_000_000, self.us % 1_000_000);
        let digits = if frame.extended { 8 } else { 3 };
        let _ = write!(self.log, "({s}.{us:06}) can0 {:0digits$X}#", frame.id);
        frame.bytes().iter().for_each(|byte| {
            let _ = write!(self.log, "{byte:02X}");
        });
        self.log.push('\n');
    }

    fn pair(&mut self, request: &Frame, reply: &Frame) {
        self.frame(request, 5000);
        self.frame(reply, 400);
    }
}

/// A protocol's word, and one exchange of it.
type Speaker = (&'static str, fn(&mut GeneratedBus));

const TMCL: Speaker = ("tmcl", |bus| {
    let module = 3 + bus.random(5) as u8;
    parameter(bus, module, 2);
});

/// On identifiers that neither CANopen nor TechnoCAN uses.
const TMCL_BESIDE: Speaker = ("tmcl", |bus| {
    let module = 0x61 + bus.random(5) as u8;
    parameter(bus, module, 0x7F);
});

/// The host asks a module for a parameter.
fn parameter(bus: &mut GeneratedBus, module: u8, host: u8) {
    let (kind, value) = (bus.random(20) as u8, bus.random(100_000).cast_signed());
    let opcode = Opcode::Gap;
    let request = Request { address: module, opcode, kind, motor: 0, value: 0 };
    let reply = Reply { host, module, status: Status::Ok, opcode, value };
    bus.pair(&request.emit_can(module.into(), false), &reply.emit_can(host.into(), false));
}

/// The host at axis 31 asks an axis for a variable.
fn variable(bus: &mut GeneratedBus) -> (Message, Message) {
    let (axis, address) = (1 + bus.random(6) as u8, 0x0200 + bus.random(200) as u16);
    let (cell, host) = (Cell::long(address), IdCode::host_at(31));
    let message = OnlineMessage::GiveMeData { sender: host, cell };
    let value = bus.random(u32::MAX);
    let take = OnlineMessage::TakeData { sender: IdCode::axis(axis), cell, value };
    let request = Message { to: IdCode::axis(axis), instruction: message.emit() };
    (request, Message { to: host, instruction: take.emit() })
}

const TECHNOCAN: Speaker = ("technocan", |bus| {
    let (ask, take) = variable(bus);
    let frame = |message| technocan::encode(message).expect("fits");
    bus.pair(&frame(&ask), &frame(&take));
});

/// A command to a group, on an identifier that a TMCL module may have.
const GROUP: Speaker = ("technocan", |bus| {
    let to = IdCode::groups(1 << bus.random(5));
    let words = [bus.random(9) as u16, bus.random(9) as u16, 0];
    let count = 2 + bus.random(2) as usize;
    let instruction = Instruction::new(0x249E, &words[..count]).expect("fits");
    let frame = technocan::encode(&Message { to, instruction }).expect("fits");
    bus.frame(&frame, 3000);
});

const TMLCAN: Speaker = ("tmlcan", |bus| {
    let (ask, take) = variable(bus);
    bus.pair(&tmlcan::encode(&ask), &tmlcan::encode(&take));
});

const THRUSTER: Speaker = ("thruster", |bus| {
    let (node, data) = (20 + bus.random(3) as u8, bus.random(1000));
    let command = [CommandWord::QP, CommandWord::TC, CommandWord::ST][bus.random(3) as usize];
    let (order, echo) = match command {
        CommandWord::QP => (Order::without_value(command), Echo { command, sub: 0, data }),
        _ => (Order::with_value(command, data as u16), Echo { command, sub: 0, data }),
    };
    bus.pair(&order.frame(node), &echo.frame(node));
});

const CANOPEN: Speaker = ("canopen", |bus| {
    let node = 1 + bus.random(8) as u8;
    let index = [0x6041, 0x6064, 0x1018, 0x606C][bus.random(4) as usize];
    let object = sdo::ObjectIndex::new(index, 0);
    let short = sdo::ExpeditedData { bits: bus.random(60_000), len: 4 };
    bus.pair(
        &sdo::SdoRequest::Read(object).emit(node),
        &sdo::SdoReply::Value(object, short).emit(node),
    );
    bus.frame(&Frame::standard(0x700 | u16::from(node), &[5]), 1000);
});

/// Nodes that send mapped values alone, their states, and what a master sends them.
const PROCESS: Speaker = ("canopen", |bus| {
    let node = 1 + bus.random(8) as u16;
    for id in [0x280 + node, 0x300 + node, 0x180 + node] {
        let bytes: Vec<u8> = (0..8).map(|_| bus.random(256) as u8).collect();
        bus.frame(&Frame::standard(id, &bytes), 500);
    }
    bus.frame(&Frame::standard(0x080, &[]), 500);
    bus.frame(&Frame::standard(0x700 | node, &[5]), 500);
});

const BUSES: [&[Speaker]; 14] = [
    &[TMCL],
    &[TECHNOCAN],
    &[TMLCAN],
    &[THRUSTER],
    &[CANOPEN],
    &[PROCESS],
    &[CANOPEN, THRUSTER],
    &[PROCESS, THRUSTER],
    &[CANOPEN, TMLCAN],
    &[TMCL, TMLCAN],
    &[CANOPEN, PROCESS, TECHNOCAN],
    &[TMCL, THRUSTER],
    &[CANOPEN, TECHNOCAN, TMCL_BESIDE],
    &[CANOPEN, TECHNOCAN, GROUP, TMCL_BESIDE],
];

fn verdict(seed: u64) -> (&'static [Speaker], LinkDetection, String) {
    let seed = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mut bus = GeneratedBus { seed, us: 1_700_000_000_000_000, log: String::new() };
    let speakers = BUSES[bus.random(BUSES.len() as u32) as usize];
    let exchanges = 40 + bus.random(200);
    for _ in 0..exchanges {
        let who = bus.random(speakers.len() as u32) as usize;
        speakers[who].1(&mut bus);
        if bus.random(50) == 0 {
            // A frame is lost.
            let end = bus.log.trim_end().rfind('\n').map_or(0, |at| at + 1);
            bus.log.truncate(end);
        }
    }
    let mut judge = ProtocolDetector::new();
    judge.feed(bus.log.as_bytes());
    let (mut verdicts, _) = judge.decide();
    (speakers, verdicts.remove(0), bus.log)
}

#[test]
fn unseen_captures_are_distinguished_or_left_undecided() {
    let mut undecided = Vec::new();
    for seed in 0..SEEDS {
        let (speakers, verdict, log) = verdict(seed);
        let speaks = |name: &str| speakers.iter().any(|(word, _)| *word == name);
        let named = verdict.protocol.iter().chain(&verdict.secondary).map(|d| d.name());
        let named: Vec<&str> =
            named.chain(verdict.proven_axes.iter().map(|(d, _)| d.name())).collect();
        let right = named.iter().all(|name| speaks(name));
        let log = &log[..log.len().min(2000)];
        assert!(right, "seed {seed}: {verdict} instead of {:?}\n{log}", words(speakers));
        for (word, _) in speakers.iter().filter(|(word, _)| !named.contains(word)) {
            let reported =
                verdict.tied.contains(word) || verdict.shared_axes.iter().any(|(s, _)| s == word);
            assert!(reported, "seed {seed}: {word} is not in {verdict}\n{log}");
            undecided.push((seed, *word));
        }
    }
    assert!(undecided.len() < SEEDS as usize / 20, "too many undecided: {undecided:?}");
}

fn words(speakers: &[Speaker]) -> Vec<&'static str> {
    speakers.iter().map(|(word, _)| *word).collect()
}

/// Counts what is read.
struct CountingReader {
    log: Cursor<Vec<u8>>,
    read: Arc<AtomicUsize>,
}

impl Read for CountingReader {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.log.read(buffer)?;
        self.read.fetch_add(count, Ordering::Relaxed);
        Ok(count)
    }
}

/// The protocol of each frame.
fn protocols(mut decoder: CaptureDecoder, log: &str) -> (Vec<&'static str>, CaptureDecoder) {
    let mut protocols = Vec::new();
    let mut add = |event: &crate::DecodedFrame<'_>| protocols.push(event.protocol.unwrap_or("?"));
    log.as_bytes().chunks(50_000).for_each(|piece| decoder.feed(piece, &mut add));
    decoder.finish(&mut add);
    (protocols, decoder)
}

/// A capture in which the second speaker comes late: the decoder reads ahead once its identifiers come,
/// and explains every frame as one that knew the whole capture.
#[test]
fn a_decoder_that_reads_ahead_explains_what_comes_late() {
    let mut later = 0;
    for (seed, speakers) in BUSES.iter().enumerate() {
        let seed = (seed as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let mut bus = GeneratedBus { seed, us: 1_700_000_000_000_000, log: String::new() };
        (0..4000).for_each(|_| speakers[0].1(&mut bus));
        let before = bus.log.lines().count();
        for exchange in 0..300 {
            speakers[exchange % speakers.len()].1(&mut bus);
        }
        let mut detector = ProtocolDetector::new();
        detector.feed(bus.log.as_bytes());
        let (whole, _) = protocols(detector.decide().1, &bus.log);

        let read = Arc::<AtomicUsize>::default();
        let log = Cursor::new(bus.log.clone().into_bytes());
        let source = CountingReader { log, read: Arc::clone(&read) };
        let decoder = CaptureDecoder::detect(Box::new(source), ReadOptions::default()).unwrap();
        let read_first = read.load(Ordering::Relaxed);
        let first = decoder.detections()[0].clone();
        let (ahead, decoder) = protocols(decoder, &bus.log);
        let place = whole.iter().zip(&ahead).position(|(whole, ahead)| whole != ahead);
        assert_eq!(place, None, "seed {seed}: {first}, {:?}", decoder.detections());
        assert_eq!(whole.len(), ahead.len());
        if first.shared_axes.is_empty() && first.protocol.is_some() {
            assert!(read_first < bus.log.len() / 2, "seed {seed}: {read_first} read for {first}");
            assert!(first.to_string().contains("weighed"), "{first}");
        }
        if decoder.later_detections().next().is_some() {
            later += 1;
            assert!(ahead[before..].iter().any(|name| *name != ahead[0]), "seed {seed}");
        }
    }
    assert!(later > 0);
}

/// Equal bytes in the same order: a drive answers at once, mapped values that look alike do not.
#[test]
fn where_bytes_leave_doubt_the_time_to_answer_decides() {
    let proven = |after: u32| {
        let mut bus = GeneratedBus { seed: 1, us: 1_700_000_000_000_000, log: String::new() };
        for data in 0..5 {
            let echo = Echo { command: CommandWord::QP, sub: 0, data };
            bus.frame(&Order::without_value(CommandWord::QP).frame(20), 1_000_000);
            bus.frame(&echo.frame(20), after);
        }
        let mut judge = ProtocolDetector::new();
        judge.feed(bus.log.as_bytes());
        let (mut verdicts, _) = judge.decide();
        let verdict = verdicts.remove(0);
        assert!(!verdict.shared_axes.is_empty() || verdict.protocol.is_some(), "{verdict}");
        verdict.protocol.map(|dissector| dissector.name())
    };
    assert_eq!(proven(400), Some("thruster"));
    assert_eq!(proven(400_000), None);
}

/// Buses of other makers and other protocols: none of their frames is one of ours.
const FOREIGN: [Speaker; 11] = [
    // A request of eight bytes at 140h + number, its reply at 240h + number.
    ("motors with a command byte", |bus| {
        let motor = 1 + bus.random(6) as u16;
        let command = [0x9A, 0x9C, 0xA2, 0xA4, 0x90, 0x30][bus.random(6) as usize];
        let value = bus.random(u32::MAX).to_le_bytes();
        let mut data = [command, 0, 0, 0, 0, 0, 0, 0];
        data[4..].copy_from_slice(&value);
        let reply = [command, 0x32, data[5], 0, data[4], data[6], 0x10, 0x27];
        bus.pair(&Frame::standard(0x140 + motor, &data), &Frame::standard(0x240 + motor, &reply));
    }),
    // Node-ID and command in the identifier, floating-point numbers as data.
    ("motors with floating-point numbers", |bus| {
        let node = bus.random(4) as u16;
        let state = [0, 0, 0, 0, 8, 0, bus.random(4) as u8, 0];
        bus.frame(&Frame::standard(node << 5 | 1, &state), 2000);
        let (a, b) = (bus.random(5000) as f32 / 7.0, bus.random(5000) as f32 / 9.0);
        let mut data = [0; 8];
        data[..4].copy_from_slice(&a.to_le_bytes());
        data[4..].copy_from_slice(&b.to_le_bytes());
        bus.frame(&Frame::standard(node << 5 | 9, &data), 2000);
        bus.frame(&Frame::standard(node << 5 | 0x0D, &data), 2000);
    }),
    // Packed position, velocity and gains; the reply has six bytes.
    ("motors with packed words", |bus| {
        let motor = 1 + bus.random(8) as u16;
        let data: [u8; 8] = core::array::from_fn(|_| bus.random(256) as u8);
        let reply = [motor as u8, data[0], data[1], data[2], data[3], data[4]];
        bus.pair(&Frame::standard(motor, &data), &Frame::standard(0, &reply));
    }),
    // Extended identifiers of a command and a node, big-endian values.
    ("speed controllers", |bus| {
        let (command, node) = ([0, 1, 3, 9, 14, 16][bus.random(6) as usize], bus.random(4));
        let mut data = [0; 8];
        data[..4].copy_from_slice(&bus.random(100_000).to_be_bytes());
        let len = if command < 9 { 4 } else { 8 };
        let mut frame = Frame::standard(0, &data[..len]);
        (frame.id, frame.extended) = (command << 8 | node, true);
        bus.frame(&frame, 1000);
    }),
    // Periodic messages with a counter and a check sum.
    ("a car", |bus| {
        const IDS: [u16; 12] =
            [0x0A0, 0x0C5, 0x130, 0x1A0, 0x1F5, 0x288, 0x2A0, 0x320, 0x380, 0x420, 0x5A0, 0x7E8];
        let id = IDS[bus.random(12) as usize];
        let mut data: [u8; 8] = core::array::from_fn(|_| bus.random(40) as u8);
        data[0] = ((bus.us / 1000) & 0xF) as u8;
        data[7] = data[..7].iter().fold(id as u8, |sum, byte| sum ^ byte);
        bus.frame(&Frame::standard(id, &data), 800);
    }),
    // Priority, parameter group and source in 29 bits.
    ("J1939", |bus| {
        const GROUPS: [u32; 8] = [0xF004, 0xFEF1, 0xFEEE, 0xFEEF, 0xF003, 0xFECA, 0xFEE5, 0xEA00];
        let (group, source) = (GROUPS[bus.random(8) as usize], bus.random(40));
        let data: [u8; 8] = core::array::from_fn(|_| match bus.random(3) {
            0 => 0xFF,
            _ => bus.random(256) as u8,
        });
        let mut frame = Frame::standard(0, &data);
        (frame.id, frame.extended) = (0x1800_0000 | group << 8 | source, true);
        bus.frame(&frame, 1000);
    }),
    // Groups 1 and 2 of DeviceNet: polls, their replies, and explicit messages.
    ("DeviceNet", |bus| {
        let device = 1 + bus.random(20) as u16;
        let out: [u8; 4] = core::array::from_fn(|_| bus.random(256) as u8);
        bus.pair(
            &Frame::standard(0x400 | device << 3 | 5, &out),
            &Frame::standard(0x3C0 | device, &[out[1], out[0]]),
        );
        if bus.random(8) == 0 {
            let service = [0x00, 0x0E, 0x01, 0x01, bus.random(8) as u8];
            let reply = [0x00, 0x8E, bus.random(256) as u8, bus.random(256) as u8];
            bus.pair(
                &Frame::standard(0x400 | device << 3 | 4, &service),
                &Frame::standard(0x400 | device << 3 | 3, &reply),
            );
        }
    }),
    // Two letters and an index at 300h + id, the same and a value at 280h + id: the identifiers of PDO2.
    ("Elmo's binary interpreter", |bus| {
        let drive = 1 + bus.random(20) as u16;
        let letters =
            [*b"PX", *b"VX", *b"IQ", *b"MO", *b"UM", *b"BG", *b"ST"][bus.random(7) as usize];
        let mut data = [letters[0], letters[1], 0, 0, 0, 0, 0, 0];
        let request = Frame::standard(0x300 + drive, &data[..4]);
        data[4..].copy_from_slice(&bus.random(u32::MAX).to_le_bytes());
        bus.pair(&request, &Frame::standard(0x280 + drive, &data));
    }),
    // Single frames, and a long answer with its flow control (ISO 15765-2), on the identifiers of SDO.
    ("vehicle diagnosis", |bus| {
        let unit = 1 + bus.random(6) as u16;
        let (ask, answer) = (0x600 + unit, 0x580 + unit);
        let text: [u8; 7] = core::array::from_fn(|_| b'0' + bus.random(40) as u8);
        let wake = [2, 0x3E, 0, 0, 0, 0, 0, 0];
        bus.pair(
            &Frame::standard(ask, &wake),
            &Frame::standard(answer, &[2, 0x7E, 0, 0, 0, 0, 0, 0]),
        );
        let first = [0x10, 0x14, 0x62, 0xF1, 0x90, text[0], text[1], text[2]];
        bus.pair(
            &Frame::standard(ask, &[3, 0x22, 0xF1, 0x90, 0, 0, 0, 0]),
            &Frame::standard(answer, &first),
        );
        bus.frame(&Frame::standard(ask, &[0x30, 0, 0, 0, 0, 0, 0, 0]), 500);
        for number in [0x21, 0x22] {
            let mut data = [number; 8];
            data[1..].copy_from_slice(&text);
            bus.frame(&Frame::standard(answer, &data), 500);
        }
    }),
    ("noise with 11 bits", |bus| {
        let id = bus.random(0x800) as u16;
        let data: Vec<u8> = (0..bus.random(9)).map(|_| bus.random(256) as u8).collect();
        bus.frame(&Frame::standard(id, &data), 500);
    }),
    ("noise with 29 bits", |bus| {
        let data: Vec<u8> = (0..bus.random(9)).map(|_| bus.random(256) as u8).collect();
        let mut frame = Frame::standard(0, &data);
        (frame.id, frame.extended) = (bus.random(0x2000_0000), true);
        bus.frame(&frame, 500);
    }),
];

/// The most that a foreign bus may be called one of ours.
const FOREIGN_MAX: f64 = 0.2;

#[test]
fn buses_of_others_are_none_of_ours() {
    let mut wrong = Vec::new();
    for (name, exchange) in FOREIGN {
        for seed in 1..=SEEDS / 4 {
            let seed = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
            let mut bus = GeneratedBus { seed, us: 1_700_000_000_000_000, log: String::new() };
            let exchanges = 5 + bus.random(300);
            (0..exchanges).for_each(|_| exchange(&mut bus));
            let mut judge = ProtocolDetector::new();
            judge.feed(bus.log.as_bytes());
            let (verdicts, _) = judge.decide();
            let called = |verdict: &&LinkDetection| {
                verdict.protocol.is_some() && verdict.confidence > FOREIGN_MAX
            };
            wrong.extend(verdicts.iter().find(called).map(|verdict| format!("{name}: {verdict}")));
            if name.starts_with("Elmo") && exchanges > 20 {
                assert_eq!(verdicts[0].foreign, Some(name), "seed {seed}");
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "{} of them, first {:#?}",
        wrong.len(),
        &wrong[..wrong.len().min(12)]
    );
}

/// A protocol, the name that it gets, and one frame of it.
type ForeignLine = (&'static str, Option<&'static str>, fn(&mut GeneratedBus) -> Vec<u8>);

/// Frames of other protocols on a serial line.
const FOREIGN_LINES: [ForeignLine; 9] = [
    ("Dynamixel 1", Some("Dynamixel"), |bus| {
        let mut body = vec![1 + bus.random(6) as u8, 4, 2, bus.random(60) as u8, 2];
        let sum = body.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte));
        body.push(!sum);
        [vec![0xFF, 0xFF], body].concat()
    }),
    ("Dynamixel 2", Some("Dynamixel"), |bus| {
        let value = bus.random(u32::MAX).to_le_bytes();
        let head = [0xFF, 0xFF, 0xFD, 0, 1 + bus.random(6) as u8, 8, 0, 0x55, 0];
        [&head[..], &value, &value[..2]].concat()
    }),
    ("Pelco-D", Some("Pelco-D"), |bus| {
        let (pan, tilt) = (bus.random(64) as u8, bus.random(64) as u8);
        let body = [1 + bus.random(4) as u8, 0, 1 << bus.random(5), pan, tilt];
        let sum = body.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte));
        [&[0xFF][..], &body, &[sum]].concat()
    }),
    ("Roboteq", Some("lines of text"), |bus| {
        let value = bus.random(2000);
        match bus.random(3) {
            0 => b"?A 1\r".to_vec(),
            1 => format!("A={value}\r").into_bytes(),
            _ => format!("!G 1 {value}\r").into_bytes(),
        }
    }),
    ("a modem", Some("lines of text"), |bus| {
        let level = bus.random(31);
        format!("\r\n+CSQ: {level},0\r\n\r\nOK\r\n").into_bytes()
    }),
    ("VESC", Some("VESC"), |bus| {
        let body: Vec<u8> = (0..59).map(|_| bus.random(256) as u8).collect();
        [&[2, 59][..], &body, &[bus.random(256) as u8, bus.random(256) as u8, 3]].concat()
    }),
    ("a battery with a sum", None, |bus| {
        let mut frame = vec![0xA5, 1, 0x90 + bus.random(8) as u8, 8];
        frame.extend((0..8).map(|_| bus.random(256) as u8));
        frame.push(frame.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte)));
        frame
    }),
    ("a battery with two sums", None, |bus| {
        let mut frame = vec![0xDD, 3, 0, 27];
        frame.extend((0..27).map(|_| bus.random(256) as u8));
        frame.extend([bus.random(256) as u8, bus.random(256) as u8, 0x77]);
        frame
    }),
    ("a remote control", None, |bus| {
        let mut frame = vec![0x0F];
        frame.extend((0..22).map(|_| bus.random(256) as u8));
        frame.extend([0, 0]);
        frame
    }),
];

#[test]
fn serial_lines_of_others_are_none_of_ours() {
    for (name, called, frame) in FOREIGN_LINES {
        for seed in 1..=SEEDS / 8 {
            let mut bus = GeneratedBus { seed, us: 0, log: String::new() };
            // Whole logs, with and without directions.
            for n in 0..100 + bus.random(200) {
                let way = [">", "<", ""][if seed % 2 == 0 { 2 } else { n as usize % 2 }];
                let bytes: String = frame(&mut bus).iter().map(|b| format!(" {b:02X}")).collect();
                let _ = writeln!(bus.log, "({}.{:06}) p {way}{bytes}", n / 100, n % 100 * 10_000);
            }
            let mut judge = ProtocolDetector::new();
            judge.feed(bus.log.as_bytes());
            let (verdicts, _) = judge.decide();
            let verdict = &verdicts[0];
            assert!(verdict.protocol.is_none(), "{name}, seed {seed}: {verdict}");
            assert_eq!(verdict.foreign, called, "{name}, seed {seed}");
        }
    }
}

/// Bytes of a serial line that are no frames.
#[test]
fn noise_on_a_serial_line_is_none_of_ours() {
    for seed in 1..=SEEDS / 4 {
        let mut bus = GeneratedBus { seed, us: 0, log: String::new() };
        for n in 0..40 + bus.random(60) {
            let _ = write!(bus.log, "(1.{n:06}) p {}", if n % 2 == 0 { '>' } else { '<' });
            for _ in 0..3 + bus.random(14) {
                let byte = bus.random(256);
                let _ = write!(bus.log, " {byte:02X}");
            }
            bus.log.push('\n');
        }
        let mut judge = ProtocolDetector::new();
        judge.feed(bus.log.as_bytes());
        let (verdicts, _) = judge.decide();
        let verdict = &verdicts[0];
        let called = verdict.protocol.is_some() && verdict.confidence > FOREIGN_MAX;
        assert!(!called, "seed {seed}: {verdict}");
    }
}
