//! Captures of simulated drives that work, with one fault planted each, at several places: the
//! summary finds it with its time and axis, and nothing else. The protocol is not stated.

use crate::run;

use polepair_capture::session::AnomalyKind;
use polepair_capture::summary::{AnomalyBurst, Summary};
use polepair_capture::{ProtocolDetector, Timestamp};
use run::polepair;

/// A line of a log: when, on which link and whose it is, the bytes.
#[derive(Clone, Debug)]
struct Line {
    us: u64,
    /// `ttyUSB0 >`, `can0`.
    head: String,
    /// CAN identifier; empty on a serial line.
    id: String,
    bytes: Vec<u8>,
}

impl Line {
    fn read(text: &str) -> Self {
        let (time, rest) = text.strip_prefix('(').and_then(|t| t.split_once(") ")).expect("a time");
        let (seconds, part) = time.split_once('.').expect("a fraction");
        let part: u64 = format!("{part:0<6}")[..6].parse().expect("digits");
        let us = seconds.parse::<u64>().expect("digits") * 1_000_000 + part;
        let hex = |text: &str| -> Vec<u8> {
            let digits: Vec<u8> = text.bytes().filter(u8::is_ascii_hexdigit).collect();
            let pair = |pair: &[u8]| u8::from_str_radix(core::str::from_utf8(pair).unwrap(), 16);
            digits.chunks(2).map(|digits| pair(digits).expect("hexadecimal")).collect()
        };
        match rest.split_once('#') {
            Some((head, data)) => {
                let (head, id) = head.rsplit_once(' ').expect("a link");
                let data = data.split(' ').next().unwrap_or_default();
                Self { us, head: head.to_owned(), id: id.to_owned(), bytes: hex(data) }
            }
            None => {
                let at = rest.find(['<', '>']).expect("a direction") + 1;
                Self { us, head: rest[..at].to_owned(), id: String::new(), bytes: hex(&rest[at..]) }
            }
        }
    }

    fn write(&self) -> String {
        let (s, us) = (self.us / 1_000_000, self.us % 1_000_000);
        let hex: Vec<String> = self.bytes.iter().map(|byte| format!("{byte:02X}")).collect();
        if self.id.is_empty() {
            format!("({s}.{us:06}) {} {}\n", self.head, hex.join(" "))
        } else {
            format!("({s}.{us:06}) {} {}#{}\n", self.head, self.id, hex.concat())
        }
    }

    /// The axis that answers so, if it is an answer.
    fn answers(&self, talk: &Talk) -> Option<u32> {
        let is_reply = |begins: &str| {
            if self.id.is_empty() { self.head.ends_with('<') } else { self.id.starts_with(begins) }
        };
        talk.replies.iter().find(|(begins, _)| is_reply(begins)).map(|(_, axis)| *axis)
    }

    /// Both are answers of one sort.
    fn is_like(&self, other: &Self) -> bool {
        self.head == other.head && self.id == other.id && self.bytes.len() == other.bytes.len()
    }
}

/// A conversation that is traced.
struct Talk {
    url: &'static str,
    signals: [&'static str; 2],
    /// The beginnings of the identifiers that answers have, and whose they are.
    replies: &'static [(&'static str, u32)],
}

const MOTOR: [&str; 2] = ["position", "velocity"];
/// Three axes that share a bus, and speak CANopen, TechnoCAN and TMCL.
const MIXED: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/examples/one-bus.toml#spindle,x,gripper");

/// Current and speed are also sent without a request, so an additional one of them is no anomaly.
const THRUSTER: [&str; 2] = ["voltage", "driver temperature"];

const TALKS: [Talk; 10] = [
    Talk { url: "tmcl:1", signals: MOTOR, replies: &[("", 1)] },
    Talk { url: "tmcl+can:1", signals: MOTOR, replies: &[("002", 1)] },
    Talk { url: "modbus-rtu:1", signals: MOTOR, replies: &[("", 1)] },
    Talk { url: "modbus-ascii:1", signals: MOTOR, replies: &[("", 1)] },
    Talk { url: "syntron-ts-canopen:2", signals: MOTOR, replies: &[("582", 2)] },
    Talk { url: "tml:1", signals: MOTOR, replies: &[("", 1)] },
    Talk { url: "tmlcan:1", signals: MOTOR, replies: &[("169", 1)] },
    Talk { url: "technocan:5", signals: MOTOR, replies: &[("17E", 5)] },
    Talk { url: "thruster-servo:11", signals: THRUSTER, replies: &[("28B", 11)] },
    Talk { url: MIXED, signals: MOTOR, replies: &[("582", 2), ("17E", 5), ("07F", 0x61)] },
];

/// Time at the beginning of a capture in which a reply may belong to a request before it, in us.
const BEGINNING: u64 = 150_000;
/// Number of lines at the end of a capture whose replies may come after it.
const ENDING: usize = 16;

/// Reads what a verb's conversation is.
fn traced(talk: &Talk, nth: usize, seconds: u32) -> Vec<Line> {
    let name = format!("polepair-planted-{}-{nth}.log", std::process::id());
    let path = std::env::temp_dir().join(name);
    let trace = path.to_str().expect("text");
    let (drive, axes) = talk.url.split_once('#').unwrap_or((talk.url, ""));
    let url = format!("sim:{drive}?time=virtual#{axes}");
    let url = url.trim_end_matches('#');
    let [one, other] = talk.signals;
    let span = format!("{seconds}s");
    let watch = ["watch", url, one, other, "--for", &span, "--rate", "100", "--trace", trace];
    let ran = polepair(&watch);
    let log = std::fs::read_to_string(&path).expect("a trace");
    std::fs::remove_file(&path).expect("removed");
    assert!(log.lines().count() > 20, "{}: {}{log}", talk.url, ran.err);
    log.lines().map(Line::read).collect()
}

/// A recording with enough answers, and their places in it. A busy machine reads less often than it is
/// asked to, so it records for longer.
fn recorded(talk: &Talk, nth: usize) -> (Vec<Line>, Vec<usize>) {
    const SECONDS: [u32; 6] = [2, 4, 8, 16, 32, 64];
    let mut counts = Vec::new();
    for seconds in SECONDS {
        let clean = traced(talk, nth, seconds);
        let late = |at: &usize| clean[*at].us > clean[0].us + BEGINNING;
        let end = clean.len().saturating_sub(ENDING);
        let mut answers: Vec<usize> = (4..end).filter(late).collect();
        answers.retain(|at| clean[*at].answers(talk).is_some());
        if answers.len() > 20 {
            return (clean, answers);
        }
        counts.push(answers.len());
    }
    panic!("{}: answers in recordings of {SECONDS:?} s: {counts:?}", talk.url);
}

/// Returns the summary of a capture.
fn summary(lines: &[Line]) -> Summary {
    let log: String = lines.iter().map(Line::write).collect();
    let mut judge = ProtocolDetector::new();
    judge.feed(log.as_bytes());
    let (verdicts, mut decoder) = judge.decide();
    assert!(verdicts.iter().all(|verdict| verdict.protocol.is_some()), "{verdicts:?}\n{log}");
    let mut summary = Summary::default();
    decoder.feed(log.as_bytes(), &mut |event| summary.add_frame(event));
    decoder.finish(&mut |event| summary.add_frame(event));
    decoder.finish_sessions(&mut |event| summary.add_open_notices(event));
    summary
}

fn moments(summary: &Summary) -> Vec<&AnomalyBurst> {
    summary.anomalies.most_notable(100)
}

/// A fault: its name, how it is planted at a line with a reply, and the anomalies that may be reported.
type Fault = (&'static str, fn(&mut Vec<Line>, usize), &'static [AnomalyKind]);

const FAULTS: [Fault; 8] = [
    (
        "lost",
        |lines, at| drop(lines.remove(at)),
        &[AnomalyKind::Unanswered, AnomalyKind::MissingAck],
    ),
    (
        "doubled",
        |lines, at| {
            let mut again = lines[at].clone();
            again.us += 300;
            lines.insert(at + 1, again);
        },
        &[AnomalyKind::DuplicateReply],
    ),
    (
        "late",
        |lines, at| lines[at..].iter_mut().for_each(|line| line.us += 1_500_000),
        &[AnomalyKind::LateReply],
    ),
    (
        "sent again",
        |lines, at| {
            let answers = |line: &Line| line.is_like(&lines[at]) || line.bytes.len() == 1;
            let asked = lines[..at].iter().rfind(|line| !answers(line)).expect("a request");
            let mut again = asked.clone();
            again.us = (lines[at - 1].us + lines[at].us) / 2;
            lines.insert(at, again);
        },
        &[AnomalyKind::Retry],
    ),
    (
        "cut",
        |lines, at| lines[at].bytes.truncate(4),
        &[AnomalyKind::Stray, AnomalyKind::Malformed, AnomalyKind::BadCheck],
    ),
    (
        "flipped",
        |lines, at| {
            let last = lines[at].bytes.len() - 3;
            lines[at].bytes[last] ^= 0x01;
        },
        &[AnomalyKind::BadCheck, AnomalyKind::Stray],
    ),
    (
        "noise",
        |lines, at| {
            let mut noise = lines[at].clone();
            (noise.us, noise.bytes) = (noise.us + 500, vec![0x01]);
            lines.insert(at + 1, noise);
        },
        &[AnomalyKind::Stray],
    ),
    (
        "foreign",
        |lines, at| {
            let before = lines[..at].iter().rfind(|line| line.is_like(&lines[at]));
            let mut foreign = before.expect("an answer").clone();
            let room = lines[at + 1].us - lines[at].us;
            foreign.us = lines[at].us + room / 2;
            lines.insert(at + 1, foreign);
        },
        &[AnomalyKind::ForeignReply, AnomalyKind::DuplicateReply, AnomalyKind::DuplicateAddress],
    ),
];

/// Places where each is planted.
const PLACES: usize = 7;

/// Faults of bytes, which CAN does not have: its controllers check frames.
const SERIAL: [&str; 3] = ["cut", "flipped", "noise"];

#[test]
fn a_planted_fault_is_found_and_nothing_else() {
    let mut missed = Vec::new();
    for (nth, talk) in TALKS.iter().enumerate() {
        let (clean, answers) = recorded(talk, nth);
        let report = summary(&clean);
        assert!(report.is_clean(), "{}: {:?}", talk.url, moments(&report));
        for (name, plant, kinds) in FAULTS {
            if !clean[0].id.is_empty() && SERIAL.contains(&name) {
                continue;
            }
            // An acknowledgement is a byte, which cannot be cut.
            let mut places = answers.clone();
            places.retain(|at| !SERIAL.contains(&name) || clean[*at].bytes.len() > 4);
            for at in places.iter().step_by(places.len() / PLACES) {
                let mut lines = clean.clone();
                let (since, axis) = (lines[*at].us, clean[*at].answers(talk));
                plant(&mut lines, *at);
                let report = summary(&lines);
                let found = moments(&report);
                let right = |moment: &&&AnomalyBurst| {
                    let at = moment.time.map_or(0, |Timestamp(ns)| ns / 1000);
                    let near = (since.saturating_sub(10_000)..since + 1_600_000).contains(&at);
                    let whose = moment.who.axis.is_none() || moment.who.axis == axis;
                    near && whose && kinds.contains(&moment.kind) && moment.count == 1
                };
                let right = found.iter().filter(right).count();
                if (right, found.len()) != (1, 1) {
                    let report_line =
                        |it: &&AnomalyBurst| format!("{}, {}", it.kind.as_str(), it.text);
                    let found: Vec<String> = found.iter().map(report_line).collect();
                    missed.push(format!("{} {name} at line {at}: {found:?}", talk.url));
                }
            }
        }
    }
    assert!(missed.is_empty(), "{}\n{}", missed.len(), missed.join("\n"));
}
