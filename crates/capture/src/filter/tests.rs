//! Filters on frames with notices of the tests' own.

use polepair_core::explain::{Direction, ExplainSink as _, Field, FieldValue};

use super::FrameFilter;
use crate::session::{
    AnomalyKind, AnomalyNotice, ChangeNotice, ExchangeNotice, ExchangeOutcome, FaultNotice,
    Quality, SessionNotice, SignalNotice, intern,
};
use crate::{DecodedFrame, Explanation, FrameDefect, Timestamp};

/// Applies a filter to one frame.
fn filter_matches(filter: &str, notices: &[SessionNotice], wrong: Option<FrameDefect>) -> bool {
    let mut explained = Explanation::default();
    explained.kind("SDO write");
    explained.axis(2);
    explained.text("write controlword = 0x000F");
    let mut field = |name, value, meaning| {
        explained.field(Field { name, start: 0, end: 1, value, meaning });
    };
    field("index", FieldValue::Hex(0x6040, 4), "controlword");
    field("sub", FieldValue::Int(0), "");
    field("volt", FieldValue::Real(23.5), "");
    let event = DecodedFrame {
        number: 7,
        time: Some(Timestamp(1_700_000_002_500_000_000)),
        link: "can0",
        direction: Some(Direction::ToDrive),
        protocol: Some("canopen"),
        bytes: &[0x2B, 0x40, 0x60, 0, 0x0F, 0, 0, 0],
        id: Some(0x602),
        extended: false,
        remote: false,
        remote_len: 0,
        echo: false,
        stray: false,
        explanation: &explained,
        defect: wrong,
        notices,
        offset: 0,
    };
    let mut filter = FrameFilter::parse(filter).expect("a filter");
    let before = DecodedFrame { time: Some(Timestamp(1_700_000_000_000_000_000)), ..event };
    filter.matches(&before);
    filter.matches(&event)
}

fn plain(filter: &str) -> bool {
    filter_matches(filter, &[], None)
}

#[test]
fn common_fields() {
    for yes in [
        "axis = 2",
        "axis == 2 and protocol = canopen",
        "axis in 1..3",
        "axis in (7, 2)",
        "axis in ..2",
        "axis in 2.. and ok",
        "id = 0x602 and not extended",
        "id in 0x600..0x67F",
        "direction = tx",
        "kind = \"SDO write\"",
        "kind = sdo*",
        "kind ~ write",
        "link in (can0, can1)",
        "number < 8 and number >= 7",
        "length = 8",
        "bytes ~ \"40 60\"",
        "bytes ~ 2B40",
        "\"controlword\"",
        "text ~ 0x000f",
        "not (axis = 1 or axis = 3)",
        "axis != 1 && !stray",
    ] {
        assert!(plain(yes), "{yes}");
    }
    for no in ["axis = 3", "axis > 2", "not ok", "kind = SDO", "bytes ~ 4061", "protocol ~ tm"] {
        assert!(!plain(no), "{no}");
    }
}

#[test]
fn or_binds_less_than_and() {
    assert!(plain("axis = 2 or axis = 3 and axis = 4"));
    assert!(!plain("(axis = 2 or axis = 3) and axis = 4"));
    assert!(plain("not axis = 3 and ok"));
}

#[test]
fn fields_by_value_and_by_meaning() {
    assert!(plain("index = 0x6040 and sub = 0"));
    assert!(plain("index = controlword"));
    assert!(plain("volt > 23.4 and volt <= 23.5"));
    assert!(plain("field.volt in (1, 23..24)"));
    assert!(!plain("index = statusword"));
    assert!(!plain("value = 1"), "the frame has no such field");
    assert!(plain("value != 1"), "as not value = 1");
}

#[test]
fn times_relative_and_absolute() {
    assert!(plain("time > 2 and time < 2501ms"));
    assert!(plain("time in 2.5..3"));
    assert!(!plain("time < 2.5"));
    assert!(plain("clock = 1700000002.5"));
    assert!(plain("clock in \"2023-11-14 22:13:22\"..\"2023-11-14 22:13:23\""));
    assert!(!plain("clock < \"2023-11-14\""));
}

#[test]
fn what_conversations_tell() {
    let anomaly = AnomalyNotice {
        kind: AnomalyKind::LateReply,
        axis: Some(2),
        time: None,
        text: String::new(),
    };
    let signal = SignalNotice {
        axis: 2,
        name: intern("Actual/Position"),
        value: 5.5,
        exact: Some(5500),
        unit: intern("mm"),
        quality: Quality::Good,
        request: None,
    };
    let time = |ms: u64| Some(Timestamp(1_000_000 * ms));
    let exchange = ExchangeNotice {
        axis: Some(2),
        op: intern("SDO read"),
        requested: (1, time(10)),
        answered: Some((2, time(13))),
        outcome: ExchangeOutcome::Late,
        retries: 1,
    };
    let fault = FaultNotice {
        axis: 2,
        code: 0x3210,
        text: intern("DC link over-voltage"),
        cause: intern(""),
        remedy: intern(""),
        gone: false,
    };
    let to = intern("stopped");
    let change =
        ChangeNotice { axis: Some(2), what: intern("nmt"), from: intern("operational"), to };
    let notices = [
        SessionNotice::Anomaly(anomaly),
        SessionNotice::Signal(signal),
        SessionNotice::Exchange(exchange),
        SessionNotice::Fault(fault),
        SessionNotice::Change(change),
    ];
    let reported = |filter| filter_matches(filter, &notices, None);
    for yes in [
        "odd",
        "odd late-reply",
        "odd in (retry, late-reply) and axis = 2",
        "fault",
        "fault = 0x3210",
        "fault ~ over-voltage",
        "signal Actual/Position > 5",
        "signal */Position in 5..6",
        "signal 2/Actual/* and odd",
        "change",
        "change nmt",
        "change nmt = stopped",
        "exchange stale",
        "op = \"SDO read\" and latency > 2ms",
        "latency in 3ms..4ms",
        "retries > 0",
    ] {
        assert!(reported(yes), "{yes}");
        assert!(!plain(yes), "{yes}");
    }
    for no in [
        "odd retry",
        "fault = 5",
        "signal Actual/Position > 6",
        "signal 3/*",
        "change power",
        "change nmt = operational",
        "exchange timeout",
        "latency > 4ms",
    ] {
        assert!(!reported(no), "{no}");
    }
}

#[test]
fn what_is_wrong() {
    let stray = Some(FrameDefect::Stray(3));
    assert!(filter_matches("not ok and error ~ stray", &[], stray));
    assert!(filter_matches("\"belongs\" or \"belong\"", &[], stray));
    assert!(!filter_matches("ok", &[], stray));
}

fn error(text: &str) -> (usize, usize, String, Option<String>) {
    let error = FrameFilter::parse(text).expect_err("no filter");
    (error.position, error.len, error.message, error.nearest)
}

#[test]
fn errors_point_at_the_place() {
    let (at, len, what, nearest) = error("kind = TC and axs = 2");
    assert_eq!((at, len, nearest.as_deref()), (14, 3, Some("axis")), "{what}");
    assert_eq!(error("odd late-replay").3.as_deref(), Some("late-reply"));
    assert_eq!(error("exchange timeot").3.as_deref(), Some("timeout"));
    assert_eq!(error("axis = 30B").2, "expected a number; hexadecimal ones begin with 0x");
    assert_eq!(error("axis = 30ms").2, "this number has no unit of time");
    assert_eq!(error("axis 2").2, "expected =, !=, <, <=, >, >=, ~ or in");
    assert_eq!(error("axis ~ 2").2, "numbers are compared with =, !=, <, <=, >, >= or in");
    assert_eq!(error("kind > TC").2, "words are compared with =, !=, ~ or in");
    assert_eq!(error("(axis = 2").2, "expected and, or, or )");
    assert_eq!(error("axis = 2 axis = 3"), (9, 4, "expected and, or, or the end".into(), None));
    assert_eq!(error("\"open").2, "this quote has no end");
    assert_eq!(error("bytes ~ 123").2, "expected two hexadecimal digits a byte");
    assert_eq!(error("direction = tz").3.as_deref(), Some("tx"));
    assert_eq!(error("").0, 0);
    assert!(error(&"(".repeat(100)).2.contains("nested"));
    assert!(error(&" ".repeat(5000)).2.contains("4096"));
    let shown = FrameFilter::parse("ok and axs = 2").expect_err("no filter").to_string();
    assert!(shown.starts_with("ok and axs = 2\n       ^^^ no such word"), "{shown}");
}

/// Fields need no `field.` before them: the list knows what dissectors find.
#[test]
fn fields_of_the_protocols_are_known() {
    let capture = "(1.0) t > 01 06 01 00 00 00 00 00 08\n(1.1) t < 02 01 64 06 00 00 02 c7 36\n\
        (1.2) m > 01 03 00 21 00 01 D4 00\n(1.3) m < 01 03 02 00 05 78 47\n\
        (1.4) c 602#2B4060000F000000\n(1.5) c 702#05\n(1.6) c 082#1032010000000000\n\
        (1.7) h 30B#5443000000000005\n";
    let rules = crate::Rules::parse("tmcl@t,modbus-rtu@m,canopen@c,thruster@h").expect("rules");
    let mut decoder = crate::CaptureDecoder::new(rules);
    let mut found = 0;
    decoder.feed(capture.as_bytes(), &mut |event| {
        for item in event.explanation.fields() {
            found += 1;
            let result = FrameFilter::parse(&format!("{} = 0", item.name));
            let unknown = result.is_err_and(|error| error.message.contains("no such word"));
            assert!(!unknown, "{}", item.name);
        }
    });
    assert!(found > 10, "only {found} fields");
}
