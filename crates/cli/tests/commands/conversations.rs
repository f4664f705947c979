//! Conversations with simulated drives, traced and read back: clean ones report no anomaly, and on a line
//! that loses bytes each loss is found.

use crate::run;

use std::collections::BTreeMap;

use polepair_capture::session::{ExchangeOutcome, SessionNotice};
use polepair_capture::{CaptureDecoder, Rules};
use run::polepair;

/// Number of notices in a trace, by kind.
#[derive(Default, Debug)]
struct NoticeCounts {
    odd: BTreeMap<&'static str, Vec<String>>,
    done: usize,
    others: Vec<ExchangeOutcome>,
    signals: BTreeMap<&'static str, usize>,
}

impl NoticeCounts {
    fn add_notices(&mut self, notices: &[SessionNotice]) {
        for notice in notices {
            match notice {
                SessionNotice::Anomaly(anomaly) => {
                    self.odd.entry(anomaly.kind.as_str()).or_default().push(anomaly.text.clone());
                }
                SessionNotice::Exchange(exchange) if exchange.outcome == ExchangeOutcome::Done => {
                    self.done += 1
                }
                SessionNotice::Exchange(exchange) => self.others.push(exchange.outcome),
                SessionNotice::Signal(signal) => *self.signals.entry(signal.name).or_default() += 1,
                SessionNotice::Change(_) | SessionNotice::Fault(_) => {}
            }
        }
    }
}

/// Runs a verb, and reads what went over the wire.
fn traced(name: &str, arguments: &[&str], protocol: &str) -> NoticeCounts {
    let path = std::env::temp_dir().join(format!("polepair-{name}-{}.log", std::process::id()));
    let trace = path.to_str().expect("text");
    let ran = polepair(&[arguments, &["--trace", trace]].concat());
    let capture = std::fs::read(&path).expect("a trace");
    std::fs::remove_file(&path).expect("removed");
    let mut report = NoticeCounts::default();
    let mut decoder = CaptureDecoder::new(Rules::parse(protocol).expect("a protocol"));
    decoder.feed(&capture, &mut |event| report.add_notices(event.notices));
    decoder.finish(&mut |event| report.add_notices(event.notices));
    decoder.finish_sessions(&mut |event| report.add_notices(event.notices));
    assert!(report.done > 0, "{arguments:?}: {}\n{report:?}", ran.err);
    report
}

#[test]
fn clean_conversations_have_no_anomaly() {
    let clean = [
        ("sim:tmcl:1?time=virtual", "tmcl", "90deg"),
        ("sim:tmcl+can:1?time=virtual", "tmcl", "90deg"),
        ("sim:modbus-rtu:1?time=virtual", "modbus-rtu", "90deg"),
        ("sim:modbus-ascii:1?time=virtual", "modbus-ascii", "90deg"),
        ("sim:tml:1?time=virtual", "tml", "90deg"),
        ("sim:tmlcan:1?time=virtual", "tmlcan", "90deg"),
    ];
    for (at, (url, protocol, far)) in clean.into_iter().enumerate() {
        let verbs = [vec!["info", url], vec!["move", url, far]];
        for (nth, verb) in verbs.iter().enumerate() {
            let report = traced(&format!("clean-{at}-{nth}"), verb, protocol);
            assert!(report.odd.is_empty() && report.others.is_empty(), "{verb:?}: {report:?}");
            assert!(nth == 0 || !report.signals.is_empty(), "{verb:?}: {report:?}");
        }
    }
}

#[test]
fn losses_of_a_line_are_found() {
    run::expect_silence();
    let rack = std::env::temp_dir().join(format!("polepair-lossy-{}.toml", std::process::id()));
    for (profile, protocol) in [("tmcm-171", "tmcl"), ("syntron-ts", "modbus-rtu")] {
        let text = format!(
            "[[link]]\nname = \"left\"\nfaults = {{ lose = 5e-3 }}\n\n\
             [[link.drive]]\nname = \"x\"\nprofile = \"{profile}\"\n"
        );
        std::fs::write(&rack, text).expect("written");
        let url = format!("sim:{}?time=virtual&seed=3#x", rack.display());
        let watch = ["watch", &url, "position", "velocity", "--for", "5s"];
        let report = traced(&format!("lossy-{protocol}"), &watch, protocol);
        let lost = report.odd.keys().any(|kind| ["retry", "unanswered"].contains(kind));
        assert!(lost, "{profile}: {report:?}");
        let innocent = ["duplicate-address", "restart", "refused", "foreign-reply"];
        assert!(!report.odd.keys().any(|kind| innocent.contains(kind)), "{profile}: {report:?}");
    }
    std::fs::remove_file(&rack).expect("removed");
}
