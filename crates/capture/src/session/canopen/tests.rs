//! Healthy buses, on which no anomaly is reported, and buses with one planted anomaly each, which is
//! reported once.

mod garbage;
mod lss;
mod nodes;
mod process;
mod transfer;

use polepair_core::medium::Frame;
use polepair_core::proto::canopen::pdo::MappingEntry;
use polepair_core::proto::canopen::sdo::{
    BlockSegment, ExpeditedData, ObjectIndex, SdoReply, SdoRequest, Segment, crc,
};

use crate::session::{
    AnomalyKind, ChangeNotice, ExchangeNotice, FaultNotice, SessionNotice, SignalNotice,
};
use crate::{CaptureDecoder, Rules, Timestamp};

const NODE: u8 = 5;
const NAME: ObjectIndex = ObjectIndex::new(0x1008, 0);
const WORD: ObjectIndex = ObjectIndex::new(0x6041, 0);

/// A capture that is made frame by frame, a millisecond apart.
#[derive(Clone, Default)]
struct CanopenLog {
    frames: Vec<(u64, Frame)>,
    now: u64,
}

/// Reports of the tracker.
#[derive(Debug, Default)]
struct TrackerReport {
    notices: Vec<SessionNotice>,
    lines: Vec<String>,
    wrong: usize,
}

impl CanopenLog {
    fn wait(&mut self, ms: u64) -> &mut Self {
        self.now += ms * 1_000_000;
        self
    }

    fn frame(&mut self, frame: Frame) -> &mut Self {
        self.wait(1);
        self.frames.push((self.now, frame));
        self
    }

    fn send(&mut self, id: u16, data: &[u8]) -> &mut Self {
        self.frame(Frame::standard(id, data))
    }

    fn request(&mut self, request: SdoRequest) -> &mut Self {
        self.frame(request.emit(NODE))
    }

    fn reply(&mut self, reply: SdoReply) -> &mut Self {
        self.frame(reply.emit(NODE))
    }

    fn read(&mut self, object: ObjectIndex, bits: u32, len: u8) -> &mut Self {
        self.request(SdoRequest::Read(object))
            .reply(SdoReply::Value(object, ExpeditedData { bits, len }))
    }

    fn write(&mut self, object: ObjectIndex, bits: u32, len: u8) -> &mut Self {
        self.request(SdoRequest::Write(object, ExpeditedData { bits, len }))
            .reply(SdoReply::Written(object, 0))
    }

    /// Reads a value in segments.
    fn read_long(&mut self, object: ObjectIndex, value: &[u8]) -> &mut Self {
        let size = u32::try_from(value.len()).ok();
        self.request(SdoRequest::Read(object)).reply(SdoReply::ValueLong(object, size));
        for (n, segment) in segments(value).enumerate() {
            self.request(SdoRequest::ReadSegment(n % 2 == 1))
                .reply(SdoReply::ValueSegment(segment));
        }
        self
    }

    /// Configures what TPDO1 of the node carries, and its identifier.
    fn map(&mut self, id: u32, entries: &[(u16, u8)]) -> &mut Self {
        let cob = ObjectIndex::new(0x1800, 1);
        self.write(cob, id | 1 << 31, 4).write(ObjectIndex::new(0x1A00, 0), 0, 1);
        for ((index, bits), sub) in entries.iter().zip(1..) {
            let entry = MappingEntry { object: ObjectIndex::new(*index, 0), bits: *bits };
            self.write(ObjectIndex::new(0x1A00, sub), entry.into(), 4);
        }
        self.write(ObjectIndex::new(0x1A00, 0), entries.len() as u32, 1).write(cob, id, 4)
    }

    fn heartbeats(&mut self, state: u8, every: u64, count: usize) -> &mut Self {
        for _ in 0..count {
            self.send(0x700 | u16::from(NODE), &[state]).wait(every - 1);
        }
        self
    }

    fn report(&self) -> TrackerReport {
        self.report_from(0)
    }

    /// Reports of a capture that begins with this frame.
    fn report_from(&self, first: usize) -> TrackerReport {
        let (mut report, rules) =
            (TrackerReport::default(), Rules::parse("canopen").expect("a protocol"));
        let mut decoder = CaptureDecoder::new(rules);
        for (now, frame) in &self.frames[first..] {
            let time = Some(Timestamp(1_700_000_000_000_000_000 + now));
            decoder.decode_frame(time, "can0", None, frame, &mut |event| {
                report.notices.extend_from_slice(event.notices);
                report
                    .lines
                    .push(format!("{}: {}", event.explanation.kind, event.explanation.text));
                report.wrong += usize::from(event.defect.is_some());
            });
        }
        decoder.finish_sessions(&mut |event| report.notices.extend_from_slice(event.notices));
        report
    }
}

impl TrackerReport {
    fn anomalies(&self) -> Vec<AnomalyKind> {
        let odds = self.notices.iter().filter_map(|notice| match notice {
            SessionNotice::Anomaly(anomaly) => Some(anomaly.kind),
            _ => None,
        });
        odds.collect()
    }

    fn texts(&self) -> Vec<&str> {
        let odds = self.notices.iter().filter_map(|notice| match notice {
            SessionNotice::Anomaly(anomaly) => Some(anomaly.text.as_str()),
            _ => None,
        });
        odds.collect()
    }

    /// Nothing odd, and every frame is understood.
    fn assert_clean(&self) -> &Self {
        assert_eq!(self.texts(), [""; 0], "{:#?}", self.lines);
        assert_eq!(self.wrong, 0, "{:#?}", self.lines);
        self
    }

    /// Checks that this is the only anomaly.
    fn assert_only(&self, kind: AnomalyKind) -> &Self {
        assert_eq!(self.anomalies(), [kind], "{:?}\n{:#?}", self.texts(), self.lines);
        self
    }

    fn exchanges(&self) -> Vec<ExchangeNotice> {
        let all = self.notices.iter().filter_map(|notice| match notice {
            SessionNotice::Exchange(exchange) => Some(*exchange),
            _ => None,
        });
        all.collect()
    }

    fn signals(&self, name: &str) -> Vec<SignalNotice> {
        let all = self.notices.iter().filter_map(|notice| match notice {
            SessionNotice::Signal(signal) if signal.name == name => Some(*signal),
            _ => None,
        });
        all.collect()
    }

    fn changes(&self, what: &str) -> Vec<(&str, &str)> {
        let all = self.notices.iter().filter_map(|notice| match notice {
            SessionNotice::Change(ChangeNotice { what: of, from, to, .. }) if *of == what => {
                Some((*from, *to))
            }
            _ => None,
        });
        all.collect()
    }

    fn faults(&self) -> Vec<FaultNotice> {
        let all = self.notices.iter().filter_map(|notice| match notice {
            SessionNotice::Fault(fault) => Some(*fault),
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

/// Segments of a block with this value; the last one is marked.
fn block_segments(value: &[u8]) -> Vec<BlockSegment> {
    let parts = segments(value).zip((1..=127).cycle());
    parts.map(|(s, number)| BlockSegment { number, last: s.last, data: s.data }).collect()
}

/// Bytes that no segment has two of alike.
fn noise(len: usize) -> Vec<u8> {
    (0..len).map(|n| (n * 37 + n / 7) as u8).collect()
}
