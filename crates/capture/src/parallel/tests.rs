//! Any number of threads decodes a capture to the same result, and no thread waits for ever.

use std::fmt::Write as _;
use std::sync::atomic::{AtomicBool, Ordering};

use polepair_core::medium::Frame;

use super::{BatchConsumer, JOBS_MAX, decode};
use crate::text::{FrameTextWriter, TextStyle};
use crate::{CaptureDecoder, FrameBatch, Rules};

/// Lines of text.
#[derive(Default)]
struct TextLines {
    text: FrameTextWriter,
    out: Vec<u8>,
}

impl BatchConsumer for TextLines {
    fn consume(&mut self, batch: &FrameBatch) {
        self.text.write_batch(batch, &mut self.out);
    }
}

/// A log of several pieces: process data, and other lines between; `extra` follows each hundredth.
fn log(extra: &str) -> String {
    let mut log = String::new();
    for n in 0..24_000_u64 {
        let (at, data) = (1_700_000_000_000_000 + n * 250, n.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let _ = write!(log, "({}.{:06}) ", at / 1_000_000, at % 1_000_000);
        let _ = match n % 100 {
            17 => writeln!(log, "can1 70{}#05", 1 + n / 100 % 4),
            33 => writeln!(log, "can0 601#4041600000000000"),
            34 => writeln!(log, "can0 581#4B41600037160000\n{extra}"),
            n => writeln!(log, "can{} 18{}#{data:016X}", n % 2, 1 + n % 4),
        };
    }
    log
}

/// Decodes a log with several threads.
fn decode_log(log: &str, jobs: usize) -> (String, Vec<String>, u64) {
    let mut decoder = CaptureDecoder::new(Rules::parse("canopen").expect("rules"));
    let mut makers: Vec<TextLines> = (0..jobs).map(|_| TextLines::default()).collect();
    let (mut bytes, mut out) = (log.as_bytes(), Vec::new());
    let decoded: Result<(), ()> = decode(
        &mut decoder,
        &mut makers,
        &mut |piece, max| {
            // As much as a pipe gives.
            let (now, rest) = bytes.split_at(bytes.len().min(max).min(70_000));
            piece.extend_from_slice(now);
            bytes = rest;
            Ok(())
        },
        &mut |maker| {
            out.append(&mut maker.out);
            Ok(())
        },
    );
    assert_eq!(decoded, Ok(()));
    let damage = decoder.statistics().damage.iter().map(ToString::to_string).collect();
    (String::from_utf8(out).expect("text"), damage, decoder.statistics().records)
}

#[test]
fn any_number_of_threads_makes_the_same() {
    let long = format!("{}\n", "x".repeat(70_000));
    for extra in ["", "no frame\n", "(1700000000.5) can0 123#01 T\n# remark\n", &long] {
        let log = log(extra);
        let mut decoder = CaptureDecoder::new(Rules::parse("canopen").expect("rules"));
        let (mut text, mut out) = (FrameTextWriter::new(TextStyle::default()), Vec::new());
        decoder.feed(log.as_bytes(), &mut |event| text.write(event, &mut out));
        decoder.finish(&mut |event| text.write(event, &mut out));
        let damage: Vec<String> =
            decoder.statistics().damage.iter().map(ToString::to_string).collect();
        let plain = String::from_utf8(out).expect("text");
        for jobs in [1, 2, 3, JOBS_MAX] {
            let (text, reports, records) = decode_log(&log, jobs);
            let differs = plain.lines().zip(text.lines()).find(|(one, two)| one != two);
            assert_eq!(differs, None, "{jobs} threads");
            assert!(text == plain, "{jobs} threads");
            assert_eq!((reports, records), (damage.clone(), decoder.statistics().records));
        }
    }
}

#[test]
fn a_failing_worker_stops_all() {
    let log = log("");
    for jobs in [1, 4] {
        for broken in [0, 3, 12] {
            let mut decoder = CaptureDecoder::new(Rules::parse("canopen").expect("rules"));
            let mut makers: Vec<TextLines> = (0..jobs).map(|_| TextLines::default()).collect();
            let (mut bytes, mut reads, mut puts) = (log.as_bytes(), 0, 0);
            let failed = decode(
                &mut decoder,
                &mut makers,
                &mut |piece, max| {
                    let (now, rest) = bytes.split_at(bytes.len().min(max).min(70_000));
                    piece.extend_from_slice(now);
                    (bytes, reads) = (rest, reads + 1);
                    if reads > broken { Err("reading") } else { Ok(()) }
                },
                &mut |_| {
                    puts += 1;
                    if puts > broken / 8 { Err("writing") } else { Ok(()) }
                },
            );
            assert!(failed.is_err(), "{jobs} threads, {broken}");
            assert!(puts <= broken / 8 + 1, "{puts} of {broken}");
        }
    }
}

/// After a failed write no more of a piece is decoded that is much longer unpacked.
#[test]
fn a_failing_worker_decodes_no_more() {
    use std::io::Write as _;

    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    let line = "(1700000000.000500) can0 181#0011223344556677\n";
    packed.write_all(line.repeat(120_000).as_bytes()).expect("packed");
    let packed = packed.finish().expect("packed");
    let mut decoder = CaptureDecoder::new(Rules::parse("canopen").expect("rules"));
    let (mut bytes, mut puts) = (&packed[..], 0);
    let failed = decode(
        &mut decoder,
        &mut [TextLines::default()],
        &mut |piece, max| {
            let (now, rest) = bytes.split_at(bytes.len().min(max));
            piece.extend_from_slice(now);
            bytes = rest;
            Ok(())
        },
        &mut |_| {
            puts += 1;
            Err("writing")
        },
    );
    assert_eq!((failed, puts), (Err("writing"), 1));
    let (read, mut next) = (decoder.statistics().records, 0);
    decoder.decode_frame(None, "can0", None, &Frame::standard(1, &[]), &mut |event| {
        next = event.number
    });
    assert!(next < read / 2, "{next} of {read} frames");
}

/// A writer that gives up in the middle takes the others with it.
#[test]
#[should_panic(expected = "a scoped thread panicked")]
fn a_panicking_worker_leaves_no_other_waiting() {
    /// Falls, or waits until another one does. It may wait because no batch fills within a piece:
    /// one that is made there is made in the decoder's turn, without which no other consumer panics.
    struct PanickingConsumer<'a>(bool, &'a AtomicBool);
    impl BatchConsumer for PanickingConsumer<'_> {
        fn consume(&mut self, _: &FrameBatch) {
            self.1.fetch_or(self.0, Ordering::SeqCst);
            assert!(!self.0, "enough");
            while !self.1.load(Ordering::SeqCst) {
                std::thread::yield_now();
            }
        }
    }
    let (log, mut decoder) = (log(""), CaptureDecoder::new(Rules::default()));
    let fell = AtomicBool::new(false);
    // The thread that waits here is none of those that fall.
    let mut makers = [
        PanickingConsumer(false, &fell),
        PanickingConsumer(true, &fell),
        PanickingConsumer(true, &fell),
    ];
    let mut bytes = log.as_bytes();
    let _: Result<(), ()> = decode(
        &mut decoder,
        &mut makers,
        &mut |piece, max| {
            let (now, rest) = bytes.split_at(bytes.len().min(max));
            piece.extend_from_slice(now);
            bytes = rest;
            Ok(())
        },
        &mut |_| Ok(()),
    );
}
