//! Lines as a person sees them.

use super::{DurationText, FrameTextWriter, NoticeLevel, TextStyle};
use crate::session::{
    AnomalyKind, AnomalyNotice, ChangeNotice, FaultNotice, SessionNotice, intern,
};
use crate::{CaptureDecoder, DecodedFrame, Rules};

const CAPTURE: &[u8] = b"(10.5) ttyUSB0 > 01 02\n(10.75) can0 123#1122\n(10.85) can0 123#1123\n";

fn shown(style: TextStyle, notices: &[SessionNotice]) -> Vec<String> {
    let (mut out, mut text) = (Vec::new(), FrameTextWriter::new(style));
    let mut decoder = CaptureDecoder::new(Rules::default());
    decoder.feed(CAPTURE, &mut |event| text.write(&DecodedFrame { notices, ..*event }, &mut out));
    String::from_utf8(out).expect("text").lines().map(str::to_owned).collect()
}

#[test]
fn changed_bytes_are_marked_in_colour_or_when_asked() {
    let lines = shown(TextStyle { marks: true, ..TextStyle::default() }, &[]);
    assert!(lines[1].contains("123#11 22  ") && lines[2].contains("123#11 23' "), "{lines:?}");
    let plain = shown(TextStyle::default(), &[]);
    assert!(plain[2].contains("123#11 23  "), "{plain:?}");
    let colour = shown(TextStyle { colour: true, ..TextStyle::default() }, &[]);
    assert!(colour[2].contains("123#11 \x1b[4m23\x1b[0m  "), "{colour:?}");
}

#[test]
fn notices_stand_below_the_meaning() {
    let text = "answered 310 ms after frame 12".to_owned();
    let notices = [
        SessionNotice::Anomaly(AnomalyNotice {
            kind: AnomalyKind::LateReply,
            axis: Some(2),
            time: None,
            text,
        }),
        SessionNotice::Fault(FaultNotice {
            axis: 2,
            code: 0x3210,
            text: intern("over-voltage"),
            cause: intern(""),
            remedy: intern("add a brake resistor"),
            gone: false,
        }),
        SessionNotice::Change(ChangeNotice {
            axis: Some(2),
            what: "power",
            from: "ready",
            to: "on",
        }),
    ];
    for colour in [false, true] {
        let lines = shown(TextStyle { colour, ..TextStyle::default() }, &notices);
        let plain = |line: &str| -> String {
            let parts = line.split('\x1b').enumerate();
            let cut = parts.map(|(n, p)| if n == 0 { p } else { p.split_once('m').expect("m").1 });
            cut.collect()
        };
        let column = plain(&lines[8]).find("not a frame").expect("its meaning");
        let below = plain(&lines[9]);
        assert_eq!(below.find('!'), Some(column), "{lines:?}");
        assert_eq!(below.trim(), "! late-reply axis 2: answered 310 ms after frame 12");
        assert_eq!(
            plain(&lines[10]).trim(),
            "! axis 2 fault 0x3210: over-voltage; try: add a brake resistor"
        );
        assert_eq!(plain(&lines[11]).trim(), "- axis 2 power: ready -> on");
    }
    assert_eq!(
        shown(TextStyle { notices: NoticeLevel::None, ..TextStyle::default() }, &notices).len(),
        3
    );
}

#[test]
fn spans_have_three_digits() {
    let spans = [999, 1234, 45_678, 812_000, 2_100_000, 18_768_000, 310_000_000, 1_500_000_000];
    let shown: Vec<String> = spans.iter().map(|ns| DurationText(*ns).to_string()).collect();
    let expected =
        ["999 ns", "1.23 us", "45.7 us", "812 us", "2.10 ms", "18.8 ms", "310 ms", "1.50 s"];
    assert_eq!(shown, expected);
}

/// Durations are put together from integers, and read as the standard library rounds their quotient.
#[test]
fn durations_are_rounded_as_real_numbers_are() {
    let powers = (0..14).map(|n| 10_u64.pow(n));
    let near =
        powers.flat_map(|n| [n - 1, n, n + 1, 5 * n, 5 * n / 2, 125 * n / 10, n * 2135 / 100]);
    for ns in near.chain((0..20_000).map(|n| n * 499)).chain((0..20_000).map(|n| n * 4_999_995)) {
        let (size, unit) = match ns {
            0..1000 => (1, "ns"),
            1000..1_000_000 => (1_000, "us"),
            1_000_000..1_000_000_000 => (1_000_000, "ms"),
            _ => (1_000_000_000, "s"),
        };
        let value = ns as f64 / size as f64;
        let decimals = match value {
            _ if size == 1 => 0,
            ..10.0 => 2,
            ..100.0 => 1,
            _ => 0,
        };
        assert_eq!(DurationText(ns).to_string(), format!("{value:.decimals$} {unit}"), "{ns}");
    }
}
