//! Summaries of made captures.

use core::fmt::Write as _;

use super::summary_text::{SummaryStyle, render_text};
use super::{AxisKey, BusLoad, Summary, json};
use crate::fixtures::{BEGIN_NS, FixtureCapture, anomaly, change, exchange, fault, signal};
use crate::session::{AnomalyKind, ExchangeOutcome, SessionNotice};
use crate::{CaptureDecoder, Rules};

const CAN0: AxisKey = AxisKey { link: "can0", protocol: "canopen", axis: Some(2) };

/// A summary of frames of axis 2, each with its time in microseconds and its notices.
fn summary(frames: &[(u64, Vec<SessionNotice>)]) -> Summary {
    let (mut made, mut summary) = (FixtureCapture::default(), Summary::default());
    for (us, notices) in frames {
        made.next_frame(*us, 2, "TPDO1", notices, &mut |event| summary.add_frame(event));
    }
    summary
}

#[test]
fn a_clean_capture_fits_a_screen() {
    let frames: Vec<_> = (0..1000)
        .map(|n| (n * 1000, vec![exchange(2, n * 1000, 700 + n % 50, ExchangeOutcome::Done)]))
        .collect();
    let summary = summary(&frames);
    assert!(summary.is_clean());
    let shown = render_text(&summary, &SummaryStyle::default());
    assert!(shown.lines().count() <= 12, "{shown}");
    assert!(shown.starts_with("1000 frames in 999 ms from 2023-11-14 22:13:20 UTC\n"), "{shown}");
    assert!(shown.ends_with("nothing odd\n"), "{shown}");
    let requests = &summary.requests[&(CAN0, "read")];
    assert_eq!((requests.count(), requests.latency.min()), (1000, 700_000));
    assert_eq!(requests.latency.max(), 749_000);
    let kinds = summary.kinds();
    assert!(kinds[0].is_regular() && kinds[0].gaps.median() == 1_000_000, "{kinds:?}");
}

#[test]
fn a_burst_is_one_moment_and_what_is_rare_comes_first() {
    let mut frames = Vec::new();
    // A hundred retries, one every two seconds; late replies in one burst; a restart.
    frames.extend((0..100).map(|n| (n * 2_000_000, vec![anomaly(AnomalyKind::Retry, 2)])));
    frames.extend(
        (0..30).map(|n| (300_000_000 + n * 1000, vec![anomaly(AnomalyKind::LateReply, 2)])),
    );
    frames.push((400_000_000, vec![anomaly(AnomalyKind::Restart, 2)]));
    let summary = summary(&frames);
    assert!(!summary.is_clean());
    let oddest = summary.anomalies.most_notable(10);
    assert_eq!(oddest.len(), 10);
    let ranked = summary.anomalies.most_notable(2);
    let kinds: Vec<AnomalyKind> = ranked.iter().map(|moment| moment.kind).collect();
    assert_eq!(kinds, [AnomalyKind::LateReply, AnomalyKind::Restart], "in the order of time");
    assert_eq!((ranked[0].count, ranked[0].number), (30, 101));
    let counts: Vec<_> = summary.anomalies.counts().collect();
    assert_eq!(
        counts,
        [(AnomalyKind::Retry, 100), (AnomalyKind::LateReply, 30), (AnomalyKind::Restart, 1)]
    );
    let shown = render_text(&summary, &SummaryStyle::default());
    assert!(shown.contains("(30 times in 29.0 ms)"), "{shown}");
    assert!(shown.ends_with("odd: 100 retry, 30 late-reply, 1 restart\n"), "{shown}");
}

#[test]
fn faults_have_cause_and_remedy_and_states_their_time() {
    let summary = summary(&[
        (0, vec![change(2, "pre-operational")]),
        (500_000, vec![change(2, "operational")]),
        (2_000_000, vec![fault(2, false), anomaly(AnomalyKind::Fault, 2)]),
        (3_000_000, vec![fault(2, false)]),
        (4_500_000, vec![fault(2, true)]),
    ]);
    let shown = render_text(&summary, &SummaryStyle::default());
    assert!(shown.contains("nmt pre-operational 500 ms > operational 4.00 s"), "{shown}");
    let fault = "2.000000 #3          can0 canopen 2 fault 0x3210: over-voltage, 2 times; gone at";
    assert!(shown.contains(fault), "{shown}");
    assert!(shown.contains("cause: braking\n") && shown.contains("try: add a brake resistor\n"));
    assert_eq!(summary.anomalies.counts().collect::<Vec<_>>(), [(AnomalyKind::Fault, 2)]);
    let json = json::to_json(&summary, &SummaryStyle::default(), &crate::ReadStatistics::default());
    assert_eq!(json["faults"][0]["count"], 2);
    assert_eq!(json["axes"][0]["states"]["nmt"]["seconds"]["operational"], 4.0);
    assert_eq!(json["clean"], false);
}

#[test]
fn an_open_transfer_counts() {
    let mut summary = summary(&[(0, vec![signal(2, "Actual/Position", 1.5)])]);
    let open =
        [exchange(2, 0, 0, ExchangeOutcome::Unanswered), anomaly(AnomalyKind::Unanswered, 2)];
    FixtureCapture::default()
        .next_frame(0, 2, "", &open, &mut |event| summary.add_open_notices(event));
    let requests = &summary.requests[&(CAN0, "read")];
    assert_eq!(requests.count_of(ExchangeOutcome::Unanswered), 1);
    assert!(!summary.is_clean());
    assert!(render_text(&summary, &SummaryStyle::default()).contains("at the end  unanswered"));
    assert_eq!(summary.values[&(CAN0, "Actual/Position")].range, Some((1.5, 1.5)));
}

#[test]
fn memory_is_bounded_by_what_differs() {
    let (mut made, mut summary) = (FixtureCapture::default(), Summary::default());
    for n in 0..20_000u32 {
        let notices =
            [signal(n, &format!("value {}", n % 9000), 1.0), anomaly(AnomalyKind::Retry, n)];
        made.next_frame(u64::from(n), n, "TPDO1", &notices, &mut |event| summary.add_frame(event));
    }
    assert_eq!(summary.axes.len(), super::AXES_MAX);
    assert_eq!(summary.kinds().len(), super::KINDS_MAX);
    assert_eq!(summary.values.len(), super::VALUES_MAX);
    assert!(summary.dropped > 0);
    assert_eq!(
        summary.anomalies.counts().next(),
        Some((AnomalyKind::Retry, 20_000)),
        "none is lost"
    );
}

/// Frames back to back at a bit rate: this many of eight bytes, then silence.
fn bus(rate: u64, frames: u64) -> BusLoad {
    let (mut load, mut time, mut capture) = (BusLoad::default(), BEGIN_NS, String::new());
    for n in 0..frames {
        let data = n.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let frame = polepair_core::medium::Frame {
            id: 0x181,
            extended: false,
            remote: false,
            len: 8,
            data: data.to_be_bytes(),
        };
        let bits = u64::from(polepair_core::medium::bits::wire_bits(&frame));
        time += bits * 1_000_000_000 / rate + if n % 4 == 0 { 3_000_000 } else { 0 };
        let (seconds, us) = (time / 1_000_000_000, time % 1_000_000_000 / 1000);
        let _ = writeln!(capture, "({seconds}.{us:06}) can0 181#{data:016X}");
    }
    CaptureDecoder::new(Rules::default()).feed(capture.as_bytes(), &mut |event| {
        load.add_frame(event.time, super::load::frame_bits(event), true);
    });
    load
}

#[test]
fn the_bit_rate_is_derived_from_frame_distances() {
    for rate in [125_000, 250_000, 500_000, 1_000_000] {
        assert_eq!(bus(rate, 400).estimated_bit_rate(), Some(rate as u32), "{rate}");
    }
    assert_eq!(bus(500_000, 4).estimated_bit_rate(), None, "too few");
}

#[test]
fn the_load_has_a_mean_and_a_peak() {
    let mut summary = summary(&[]);
    let (mut made, take) = (FixtureCapture::default(), &mut |event: &crate::DecodedFrame<'_>| {
        summary.add_frame(event)
    });
    // One second: a frame each millisecond, and in the middle a tenth with ten.
    for ms in 0..1000u64 {
        let frames = if (500..600).contains(&ms) { 10 } else { 1 };
        (0..frames).for_each(|n| made.next_frame(ms * 1000 + n * 100, 2, "TPDO1", &[], take));
    }
    let load = &summary.links[&"can0"].load;
    let each = load.bits() as f64 / 1900.0;
    let peak = load.peak_per_s(summary.length_ns());
    assert!((peak - each * 10_000.0).abs() < each * 200.0, "{peak}");
}

/// Two nodes whose mappings stand at the head, process data that change states or nothing, reads of
/// objects, heartbeats, a lost answer, an emergency.
fn canopen_log() -> String {
    let (mut log, mut us) = (String::new(), 1_700_000_000_000_000_u64);
    let mut line = |id: u32, data: &[u8]| {
        us += 130 + u64::from(id % 7) + u64::from(data.iter().fold(0_u8, |sum, byte| sum ^ byte));
        let _ = write!(log, "({}.{:06}) can{} {id:03X}#", us / 1_000_000, us % 1_000_000, id % 2);
        data.iter().for_each(|byte| _ = write!(log, "{byte:02X}"));
        log.push('\n');
    };
    for node in [2, 4, 5] {
        for (index, entries) in [
            (0x1600_u16, &[0x6040_0010_u32, 0x607A_0020][..]),
            (0x1A00, &[0x6041_0010, 0x6064_0020]),
            (0x1A01, &[0x606C_0020, 0x6077_0010]),
        ] {
            let [low, high] = index.to_le_bytes();
            let mut write = |sub: u8, raw: u32, command: u8| {
                let [a, b, c, d] = raw.to_le_bytes();
                line(0x600 + node, &[command, low, high, sub, a, b, c, d]);
                line(0x580 + node, &[0x60, low, high, sub, 0, 0, 0, 0]);
            };
            write(0, 0, 0x2F);
            (1..).zip(entries).for_each(|(sub, entry)| write(sub, *entry, 0x23));
            write(0, entries.len() as u32, 0x2F);
        }
    }
    for cycle in 0..400_u32 {
        line(0x80, &[]);
        for node in [2, 4, 5] {
            let [a, b, c, d] = (cycle * 37 + node).to_le_bytes();
            line(0x200 + node, &[0x0F, 0, a, b, c, d]);
            line(0x180 + node, &[if cycle % 90 == 7 { 0x31 } else { 0x37 }, 0x16, a, b, c, d]);
            line(0x280 + node, &[a, 0, 0, 0, b, 0]);
            if cycle % 50 == node {
                line(0x700 + node, &[5]);
            }
        }
        line(0x602, &[0x40, 0x64, 0x60, 0, 0, 0, 0, 0]);
        if cycle % 100 != 60 {
            line(0x582, &[0x43, 0x64, 0x60, 0, cycle as u8, 2, 3, 4]);
        }
        if cycle == 222 {
            line(0x84, &[0x10, 0x43, 8, 0, 0, 0, 0, 0]);
        }
    }
    log
}

#[test]
fn a_summary_of_batches_is_that_of_their_frames() {
    let examples = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/examples");
    let read = |path: std::path::PathBuf| std::fs::read_to_string(path).unwrap();
    let files = std::fs::read_dir(examples).unwrap().map(|entry| entry.unwrap().path());
    let logs = files.filter(|path| path.extension().is_some_and(|end| end == "log")).map(read);
    let mut compact = 0;
    for log in logs.chain([canopen_log()]) {
        let decoder = || {
            let source = std::io::Cursor::new(log.clone().into_bytes());
            CaptureDecoder::detect(Box::new(source), crate::ReadOptions::default()).unwrap()
        };
        let (mut frames, mut one) = (Summary::default(), decoder());
        let mut add = |event: &crate::DecodedFrame<'_>| frames.add_frame(event);
        one.feed(log.as_bytes(), &mut add);
        one.finish(&mut add);
        let (mut batches, mut other) = (Summary::default(), decoder().without_text());
        let mut batch = crate::FrameBatch::default();
        for piece in log.as_bytes().chunks(30_000) {
            other.decode_batch(piece, &mut batch, &mut |batch| batches.add_batch(batch));
            let runs = batch.runs().filter(|run| matches!(run, crate::FrameRun::Compact(_)));
            compact += runs.count();
            batches.add_batch(&batch);
        }
        other.finish_batch(&mut batch, &mut |batch| batches.add_batch(batch));
        batches.add_batch(&batch);
        let style = SummaryStyle::default();
        let json = |summary| json::to_json(summary, &style, &crate::ReadStatistics::default());
        assert_eq!(json(&batches), json(&frames));
        assert_eq!(render_text(&batches, &style), render_text(&frames, &style));
    }
    assert!(compact > 100, "{compact} runs of frames that change nothing");
}
