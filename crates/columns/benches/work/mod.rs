//! The log, and the work done with it.

use std::fmt::Write as _;

use polepair_capture::parallel::{BatchConsumer, decode};
use polepair_capture::summary::Summary;
use polepair_capture::text::FrameTextWriter;
use polepair_capture::{CaptureDecoder, CaptureReader, FrameBatch, Rules};
use polepair_columns::{BatchBuilder, CaptureOrigin, TableKind, TablesBuilder};

const PIECE: usize = 1 << 18;

/// A log, written line by line.
struct Log {
    text: String,
    us: u64,
    frames: usize,
    seed: u64,
}

impl Log {
    fn random(&mut self) -> u64 {
        self.seed ^= self.seed << 13;
        self.seed ^= self.seed >> 7;
        self.seed ^= self.seed << 17;
        self.seed >> 16
    }

    fn frame(&mut self, id: u32, data: &[u8]) {
        let (seconds, us) = (self.us / 1_000_000, self.us % 1_000_000);
        let _ = write!(self.text, "({seconds:010}.{us:06}) can0 {id:03X}#");
        data.iter().for_each(|byte| _ = write!(self.text, "{byte:02X}"));
        self.text.push('\n');
        self.us += 115 + (self.random() & 15);
        self.frames += 1;
    }

    fn write(&mut self, node: u32, index: u16, sub: u8, raw: u32, len: u8) {
        let ([low, high], [a, b, c, d]) = (index.to_le_bytes(), raw.to_le_bytes());
        self.frame(0x600 + node, &[0x23 | (4 - len) << 2, low, high, sub, a, b, c, d]);
        self.frame(0x580 + node, &[0x60, low, high, sub, 0, 0, 0, 0]);
    }

    fn map(&mut self, node: u32, index: u16, entries: &[u32]) {
        self.write(node, index, 0, 0, 1);
        for (sub, entry) in (1..).zip(entries) {
            self.write(node, index, sub, *entry, 4);
        }
        self.write(node, index, 0, entries.len() as u32, 1);
    }

    fn cycle(&mut self, cycle: u64) {
        self.frame(0x80, &[]);
        for node in 1..=16 {
            let position = (self.random() % 100_000) as u32;
            let [a, b, c, d] = position.to_le_bytes();
            self.frame(0x200 + node, &[0x0F, 0, a, b, c, d]);
            let error = self.random() as u8;
            self.frame(0x180 + node, &[0x37, 0x16, a, b, c, d, error, 0]);
            let [e, f, ..] = (self.random() as u32).to_le_bytes();
            self.frame(0x280 + node, &[e, f, 0, 0, f, 0]);
        }
        if cycle % 100 < 16 {
            self.frame(0x701 + (cycle % 100) as u32, &[5]);
        }
        let node = 1 + (cycle % 16) as u32;
        self.frame(0x600 + node, &[0x40, 0x64, 0x60, 0, 0, 0, 0, 0]);
        self.frame(0x580 + node, &[0x43, 0x64, 0x60, 0, 1, 2, 3, 4]);
    }
}

/// A log of that many frames, nearly.
pub fn log(frames: usize) -> String {
    let mut log = Log {
        text: String::new(),
        us: 1_700_000_000_000_000,
        frames: 0,
        seed: 88_172_645_463_325_252,
    };
    for node in 1..=16 {
        log.map(node, 0x1600, &[0x6040_0010, 0x607A_0020]);
        log.map(node, 0x1A00, &[0x6041_0010, 0x6064_0020, 0x60F4_0010]);
        log.map(node, 0x1A01, &[0x606C_0020, 0x6077_0010]);
    }
    let mut cycle = 0;
    while log.frames < frames {
        log.cycle(cycle);
        cycle += 1;
    }
    log.text
}

/// A decoder with a stated protocol.
pub fn stated() -> CaptureDecoder {
    CaptureDecoder::new(Rules::parse("canopen").unwrap_or_default())
}

/// Reads all lines.
pub fn parse(log: &str) -> u64 {
    let (mut reader, mut bytes) = (CaptureReader::default(), 0);
    let mut count = |record: &polepair_capture::Record<'_>| {
        if let polepair_capture::RecordData::Frame(frame) = record.data {
            bytes += u64::from(frame.len);
        }
    };
    log.as_bytes().chunks(PIECE).for_each(|piece| reader.feed(piece, &mut count));
    reader.finish(&mut count);
    bytes
}

/// Decodes a log as the command line and Python do with a file, and hands on the result.
fn decode_log<M: BatchConsumer>(
    log: &str,
    mut decoder: CaptureDecoder,
    makers: &mut [M],
    put: &mut (dyn FnMut(&mut M) + Send),
) {
    let mut rest = log.as_bytes();
    let fill = &mut |piece: &mut Vec<u8>, max| {
        let (now, later) = rest.split_at(rest.len().min(max));
        piece.extend_from_slice(now);
        rest = later;
        Ok::<(), ()>(())
    };
    let put = &mut |maker: &mut M| {
        put(maker);
        Ok(())
    };
    assert_eq!(decode(&mut decoder, makers, fill, put), Ok(()));
}

/// Builds columns in memory.
pub fn columns(log: &str, decoder: CaptureDecoder, jobs: usize) -> usize {
    let origin = CaptureOrigin { source: "bench".to_owned(), file: "bench.log".to_owned() };
    let builder = |_| BatchBuilder::new(TablesBuilder::new(&TableKind::ALL, &origin));
    let (mut builders, mut rows): (Vec<BatchBuilder>, _) = ((0..jobs).map(builder).collect(), 0);
    decode_log(log, decoder.without_text(), &mut builders, &mut |builder| {
        let built = builder.take_built().expect("rows make a batch");
        rows += built.iter().map(|(_, batch)| batch.num_rows()).sum::<usize>();
    });
    rows
}

/// Lines for others to hand on.
#[derive(Default)]
struct LineMaker {
    text: FrameTextWriter,
    lines: Vec<u8>,
}

impl BatchConsumer for LineMaker {
    fn consume(&mut self, batch: &FrameBatch) {
        self.text.write_batch(batch, &mut self.lines);
    }
}

/// Writes lines into memory.
pub fn text(log: &str, decoder: CaptureDecoder, jobs: usize) -> usize {
    let mut makers: Vec<LineMaker> = (0..jobs).map(|_| LineMaker::default()).collect();
    let mut written = 0;
    decode_log(log, decoder, &mut makers, &mut |maker| {
        written += maker.lines.len();
        maker.lines.clear();
    });
    written
}

/// Takes a summary.
#[derive(Default)]
struct SummaryMaker(Summary);

impl BatchConsumer for SummaryMaker {
    fn consume(&mut self, batch: &FrameBatch) {
        self.0.add_batch(batch);
    }
}

/// Summarises a log.
pub fn summary(log: &str, decoder: CaptureDecoder) -> u64 {
    let mut makers = [SummaryMaker::default()];
    decode_log(log, decoder.without_text(), &mut makers, &mut |_| {});
    makers[0].0.frames
}
