//! Captures of simulated drives that work, with one fault planted each, at several places: the
//! summary finds it with its time and axis, and nothing else. Nobody says which protocol it is.

mod run;

use std::collections::BTreeSet;

use polepair_capture::session::Oddity;
use polepair_capture::summary::{Moment, Summary};
use polepair_capture::{Judge, Stamp};
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
        match self.id.is_empty() {
            true => format!("({s}.{us:06}) {} {}\n", self.head, hex.join(" ")),
            false => format!("({s}.{us:06}) {} {}#{}\n", self.head, self.id, hex.concat()),
        }
    }

    fn is_reply(&self, talk: &Talk) -> bool {
        match self.id.is_empty() {
            true => self.head.ends_with('<'),
            false => self.id.starts_with(talk.replies),
        }
    }
}

/// A conversation that is traced.
struct Talk {
    url: &'static str,
    /// Of CAN, the beginning of the identifiers that answers have.
    replies: &'static str,
    axis: u32,
}

impl Talk {
    fn is_service_data(&self) -> bool {
        self.replies.starts_with("58")
    }
}

const TALKS: [Talk; 5] = [
    Talk { url: "sim:tmcl:1?time=virtual", replies: "", axis: 1 },
    Talk { url: "sim:tmcl+can:1?time=virtual", replies: "002", axis: 1 },
    Talk { url: "sim:modbus-rtu:1?time=virtual", replies: "", axis: 1 },
    Talk { url: "sim:modbus-ascii:1?time=virtual", replies: "", axis: 1 },
    Talk { url: "sim:syntron-ts-canopen:2?time=virtual", replies: "582", axis: 2 },
];

/// What is asked at a capture's beginning may have been asked before, us.
const BEGINNING: u64 = 150_000;

/// Reads what a verb's conversation is.
fn traced(talk: &Talk, nth: usize) -> Vec<Line> {
    let name = format!("polepair-planted-{}-{nth}.log", std::process::id());
    let path = std::env::temp_dir().join(name);
    let trace = path.to_str().expect("text");
    let watch = ["watch", talk.url, "position", "velocity", "--for", "2s", "--rate", "100"];
    let ran = polepair(&[&watch[..], &["--trace", trace]].concat());
    let log = std::fs::read_to_string(&path).expect("a trace");
    std::fs::remove_file(&path).expect("removed");
    assert!(log.lines().count() > 20, "{}: {}{log}", talk.url, ran.err);
    log.lines().map(Line::read).collect()
}

/// What the summary of a capture holds.
fn summary(lines: &[Line]) -> Summary {
    let log: String = lines.iter().map(Line::write).collect();
    let mut judge = Judge::new();
    judge.feed(log.as_bytes());
    let (verdicts, mut decoder) = judge.decide();
    assert!(verdicts.iter().all(|verdict| verdict.protocol.is_some()), "{verdicts:?}\n{log}");
    let mut summary = Summary::default();
    decoder.feed(log.as_bytes(), &mut |event| summary.take(event));
    decoder.finish(&mut |event| summary.take(event));
    decoder.ending(&mut |event| summary.ending(event));
    summary
}

fn moments(summary: &Summary) -> Vec<&Moment> {
    summary.moments.oddest(100)
}

/// A fault: how it is planted at a line that is an answer, and what may be told of it.
type Fault = (&'static str, fn(&mut Vec<Line>, usize), &'static [Oddity]);

const FAULTS: [Fault; 8] = [
    ("lost", |lines, at| drop(lines.remove(at)), &[Oddity::Unanswered, Oddity::MissingAck]),
    (
        "doubled",
        |lines, at| {
            let mut again = lines[at].clone();
            again.us += 300;
            lines.insert(at + 1, again);
        },
        &[Oddity::DuplicateReply],
    ),
    (
        "late",
        |lines, at| lines[at..].iter_mut().for_each(|line| line.us += 1_500_000),
        &[Oddity::LateReply, Oddity::Unanswered],
    ),
    (
        "sent again",
        |lines, at| {
            let mut again = lines[at - 1].clone();
            again.us = (again.us + lines[at].us) / 2;
            lines.insert(at, again);
        },
        &[Oddity::Retry],
    ),
    (
        "cut",
        |lines, at| lines[at].bytes.truncate(4),
        &[Oddity::Stray, Oddity::Malformed, Oddity::BadCheck],
    ),
    (
        "flipped",
        |lines, at| {
            let last = lines[at].bytes.len() - 3;
            lines[at].bytes[last] ^= 0x01;
        },
        &[Oddity::BadCheck, Oddity::Stray],
    ),
    (
        "noise",
        |lines, at| {
            let mut noise = lines[at].clone();
            (noise.us, noise.bytes) = (noise.us + 500, vec![0xFF]);
            lines.insert(at + 1, noise);
        },
        &[Oddity::Stray],
    ),
    (
        "foreign",
        |lines, at| {
            let mut foreign = lines[at - 2].clone();
            let room = lines[at + 1].us - lines[at].us;
            foreign.us = lines[at].us + room / 2;
            lines.insert(at + 1, foreign);
        },
        &[Oddity::ForeignReply, Oddity::DuplicateReply, Oddity::DuplicateAddress],
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
        let clean = traced(talk, nth);
        let told = summary(&clean);
        assert!(told.is_clean(), "{}: {:?}", talk.url, moments(&told));
        let late = |at: &usize| clean[*at].us > clean[0].us + BEGINNING;
        let mut answers: Vec<usize> = (4..clean.len() - 4).filter(late).collect();
        answers.retain(|at| clean[*at].is_reply(talk));
        assert!(answers.len() > 20, "{}: {}", talk.url, answers.len());
        for (name, plant, kinds) in FAULTS {
            if !clean[0].id.is_empty() && SERIAL.contains(&name) {
                continue;
            }
            for at in answers.iter().step_by(answers.len() / PLACES) {
                let mut lines = clean.clone();
                let since = lines[*at].us;
                plant(&mut lines, *at);
                let told = summary(&lines);
                let found = moments(&told);
                let right = |moment: &&&Moment| {
                    let at = moment.time.map_or(0, |Stamp(ns)| ns / 1000);
                    let near = (since.saturating_sub(10_000)..since + 1_600_000).contains(&at);
                    let whose = moment.who.axis.is_none_or(|axis| axis == talk.axis);
                    near && whose && kinds.contains(&moment.kind) && moment.count == 1
                };
                let right = found.iter().filter(right).count();
                // A late answer to service data is missed first.
                let times = if talk.is_service_data() && name == "late" { 2 } else { 1 };
                if (right, found.len()) != (times, times) {
                    missed.push(format!("{} {name} at line {at}: {found:#?}", talk.url));
                }
            }
        }
    }
    let which: BTreeSet<&str> =
        missed.iter().map(|text| text.split(" at").next().unwrap()).collect();
    assert!(missed.is_empty(), "{} {which:#?}\n{}", missed.len(), missed[0]);
}
