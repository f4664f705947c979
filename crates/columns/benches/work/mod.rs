//! The log, and the work done with it.

mod logs;

use polepair_capture::parallel::{BatchConsumer, decode};
use polepair_capture::summary::Summary;
use polepair_capture::text::FrameTextWriter;
use polepair_capture::{CaptureDecoder, CaptureReader, FrameBatch, Rules};
use polepair_columns::{BatchBuilder, CaptureOrigin, TableKind, TablesBuilder};

pub use logs::{KINDS, LogKind};

const PIECE: usize = 1 << 18;

/// A decoder of a log whose protocol is stated.
pub fn stated(kind: LogKind) -> CaptureDecoder {
    CaptureDecoder::new(Rules::parse(kind.protocol).expect("a protocol"))
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
    decode_log(log, decoder.without_signals(), &mut makers, &mut |maker| {
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
