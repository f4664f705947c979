//! Buses as they should be, of which nothing odd is told, and with one thing planted each, which is
//! told once.

mod garbage;
mod lss;
mod nodes;
mod process;
mod transfer;

use polepair_core::medium::Frame;
use polepair_core::proto::canopen::pdo::Entry;
use polepair_core::proto::canopen::sdo::{
    BlockSegment, Object, Reply, Request, Segment, Short, crc,
};

use crate::session::{Change, Exchange, Fault, Notice, Oddity, Signal};
use crate::{Decoder, Rules, Stamp};

const NODE: u8 = 5;
const NAME: Object = Object::new(0x1008, 0);
const WORD: Object = Object::new(0x6041, 0);

/// A capture that is made frame by frame, a millisecond apart.
#[derive(Clone, Default)]
struct Bus {
    frames: Vec<(u64, Frame)>,
    now: u64,
}

/// What was told of it.
#[derive(Debug, Default)]
struct Told {
    notices: Vec<Notice>,
    lines: Vec<String>,
    wrong: usize,
}

impl Bus {
    fn wait(&mut self, ms: u64) -> &mut Self {
        self.now += ms * 1_000_000;
        self
    }

    fn frame(&mut self, frame: Frame) -> &mut Self {
        self.wait(1);
        self.frames.push((self.now, frame));
        self
    }

    fn say(&mut self, id: u16, data: &[u8]) -> &mut Self {
        self.frame(Frame::standard(id, data))
    }

    fn ask(&mut self, request: Request) -> &mut Self {
        self.frame(request.emit(NODE))
    }

    fn answer(&mut self, reply: Reply) -> &mut Self {
        self.frame(reply.emit(NODE))
    }

    fn read(&mut self, object: Object, bits: u32, len: u8) -> &mut Self {
        self.ask(Request::Read(object)).answer(Reply::Value(object, Short { bits, len }))
    }

    fn write(&mut self, object: Object, bits: u32, len: u8) -> &mut Self {
        self.ask(Request::Write(object, Short { bits, len })).answer(Reply::Written(object, 0))
    }

    /// Reads a value in segments.
    fn read_long(&mut self, object: Object, value: &[u8]) -> &mut Self {
        let size = u32::try_from(value.len()).ok();
        self.ask(Request::Read(object)).answer(Reply::ValueLong(object, size));
        for (n, segment) in segments(value).enumerate() {
            self.ask(Request::ReadSegment(n % 2 == 1)).answer(Reply::ValueSegment(segment));
        }
        self
    }

    /// Configures what TPDO1 of the node carries, and its identifier.
    fn map(&mut self, id: u32, entries: &[(u16, u8)]) -> &mut Self {
        let cob = Object::new(0x1800, 1);
        self.write(cob, id | 1 << 31, 4).write(Object::new(0x1A00, 0), 0, 1);
        for ((index, bits), sub) in entries.iter().zip(1..) {
            let entry = Entry { object: Object::new(*index, 0), bits: *bits };
            self.write(Object::new(0x1A00, sub), entry.into(), 4);
        }
        self.write(Object::new(0x1A00, 0), entries.len() as u32, 1).write(cob, id, 4)
    }

    fn heartbeats(&mut self, state: u8, every: u64, count: usize) -> &mut Self {
        for _ in 0..count {
            self.say(0x700 | u16::from(NODE), &[state]).wait(every - 1);
        }
        self
    }

    fn told(&self) -> Told {
        self.told_from(0)
    }

    /// What is told when the capture begins with that frame.
    fn told_from(&self, first: usize) -> Told {
        let (mut told, rules) = (Told::default(), Rules::parse("canopen").expect("a protocol"));
        let mut decoder = Decoder::new(rules);
        for (now, frame) in &self.frames[first..] {
            let time = Some(Stamp(1_700_000_000_000_000_000 + now));
            decoder.frame(time, "can0", None, frame, &mut |event| {
                told.notices.extend_from_slice(event.notices);
                told.lines.push(format!("{}: {}", event.explained.kind, event.explained.text));
                told.wrong += usize::from(event.wrong.is_some());
            });
        }
        decoder.ending(&mut |event| told.notices.extend_from_slice(event.notices));
        told
    }
}

impl Told {
    fn odds(&self) -> Vec<Oddity> {
        let odds = self.notices.iter().filter_map(|notice| match notice {
            Notice::Odd(odd) => Some(odd.kind),
            _ => None,
        });
        odds.collect()
    }

    fn texts(&self) -> Vec<&str> {
        let odds = self.notices.iter().filter_map(|notice| match notice {
            Notice::Odd(odd) => Some(odd.text.as_str()),
            _ => None,
        });
        odds.collect()
    }

    /// Nothing odd, and every frame is understood.
    fn clean(&self) -> &Self {
        assert_eq!(self.texts(), [""; 0], "{:#?}", self.lines);
        assert_eq!(self.wrong, 0, "{:#?}", self.lines);
        self
    }

    /// That alone is odd.
    fn planted(&self, kind: Oddity) -> &Self {
        assert_eq!(self.odds(), [kind], "{:?}\n{:#?}", self.texts(), self.lines);
        self
    }

    fn exchanges(&self) -> Vec<Exchange> {
        let all = self.notices.iter().filter_map(|notice| match notice {
            Notice::Exchange(exchange) => Some(*exchange),
            _ => None,
        });
        all.collect()
    }

    fn signals(&self, name: &str) -> Vec<Signal> {
        let all = self.notices.iter().filter_map(|notice| match notice {
            Notice::Signal(signal) if signal.name == name => Some(*signal),
            _ => None,
        });
        all.collect()
    }

    fn changes(&self, what: &str) -> Vec<(&str, &str)> {
        let all = self.notices.iter().filter_map(|notice| match notice {
            Notice::Change(Change { what: of, from, to, .. }) if *of == what => Some((*from, *to)),
            _ => None,
        });
        all.collect()
    }

    fn faults(&self) -> Vec<Fault> {
        let all = self.notices.iter().filter_map(|notice| match notice {
            Notice::Fault(fault) => Some(*fault),
            _ => None,
        });
        all.collect()
    }
}

/// A value in segments, as an upload or a download has them.
fn segments(value: &[u8]) -> impl Iterator<Item = Segment> + '_ {
    let count = value.len().div_ceil(7);
    value.chunks(7).enumerate().map(move |(n, chunk)| {
        let mut data = [0; 7];
        data[..chunk.len()].copy_from_slice(chunk);
        Segment { toggle: n % 2 == 1, last: n + 1 == count, len: chunk.len() as u8, data }
    })
}

/// The same in segments of blocks, the last of which is marked.
fn block_segments(value: &[u8]) -> Vec<BlockSegment> {
    let parts = segments(value).zip((1..=127).cycle());
    parts.map(|(s, number)| BlockSegment { number, last: s.last, data: s.data }).collect()
}

/// Bytes that no segment has two of alike.
fn noise(len: usize) -> Vec<u8> {
    (0..len).map(|n| (n * 37 + n / 7) as u8).collect()
}
