//! Layer setting, and the identity that a node reports.

use polepair_core::proto::canopen::lss::{self, IdentityNumber};

use super::*;
use crate::session::ExchangeOutcome;

fn select(bus: &mut CanopenLog) -> &mut CanopenLog {
    let numbers = IdentityNumber::ALL.into_iter().zip([0x319, 7, 0x10002, 4711]);
    for (number, value) in numbers {
        bus.frame(lss::LssRequest::SwitchSelective(number, value).emit());
    }
    bus.frame(lss::LssReply::Selected.emit())
}

fn setting(bus: &mut CanopenLog) -> &mut CanopenLog {
    bus.frame(lss::LssRequest::SetNode(5).emit()).frame(lss::LssReply::SetNode(0, 0).emit());
    bus.frame(lss::LssRequest::Store.emit()).frame(lss::LssReply::Store(0, 0).emit());
    bus.frame(lss::LssRequest::SwitchGlobal(false).emit())
}

fn ended(report: &TrackerReport) -> Vec<(&'static str, ExchangeOutcome, bool)> {
    let exchange = |notice: &SessionNotice| match notice {
        SessionNotice::Exchange(it) => Some((it.op, it.outcome, it.answered.is_some())),
        _ => None,
    };
    report.notices.iter().filter_map(exchange).collect()
}

#[test]
fn four_numbers_select_one_device_and_silence_says_that_there_is_none() {
    let mut bus = CanopenLog::default();
    setting(select(&mut bus));
    bus.frame(lss::LssRequest::IdentifyUnconfigured.emit()).wait(2000).send(0x80, &[]);
    let report = bus.report();
    report.assert_clean();
    let (done, answered) = (ExchangeOutcome::Done, true);
    let expected = [
        ("LSS select", done, answered),
        ("LSS set node-ID", done, answered),
        ("LSS store", done, answered),
        ("LSS switch all", done, false),
        ("LSS identify unconfigured", done, false),
    ];
    assert_eq!(ended(&report), expected);
    for first in 0..bus.frames.len() {
        bus.report_from(first).assert_clean();
    }
}

#[test]
fn a_setting_that_is_not_answered_or_refused_or_answered_twice_is_reported() {
    let set = || lss::LssRequest::SetNode(5).emit();
    let mut bus = CanopenLog::default();
    select(&mut bus).frame(set()).wait(3000).send(0x80, &[]);
    bus.report().assert_only(AnomalyKind::Unanswered);
    bus.frame(lss::LssReply::SetNode(0, 0).emit());
    assert_eq!(bus.report().anomalies(), [AnomalyKind::Unanswered, AnomalyKind::LateReply]);
    let mut bus = CanopenLog::default();
    select(&mut bus).frame(set()).frame(lss::LssReply::SetNode(1, 0).emit());
    bus.report().assert_only(AnomalyKind::Refused);
    let mut bus = CanopenLog::default();
    setting(select(&mut bus).frame(set()));
    bus.report().assert_only(AnomalyKind::Retry);
    let mut bus = CanopenLog::default();
    setting(select(&mut bus)).frame(lss::LssReply::Selected.emit());
    bus.report().assert_only(AnomalyKind::ForeignReply);
    let mut bus = CanopenLog::default();
    bus.frame(lss::LssRequest::Inquire(IdentityNumber::Serial).emit());
    bus.frame(lss::LssReply::Number(IdentityNumber::Serial, 4711).emit());
    bus.frame(lss::LssReply::Number(IdentityNumber::Serial, 4712).emit());
    bus.report().assert_only(AnomalyKind::DuplicateAddress);
}

#[test]
fn a_node_that_says_which_drive_it_is_has_its_names() {
    let find = |name| polepair_drives::profiles().iter().find(|profile| profile.name == name);
    let title = find("syntron-ts-canopen").expect("built in").title;
    let mut bus = CanopenLog::default();
    bus.read(ObjectIndex::new(0x203F, 0), 9870, 2).read(ObjectIndex::new(0x2000, 0), 20, 2);
    let report = bus.report();
    report.assert_clean();
    assert_eq!(report.changes("product"), [("", title)]);
    assert!(report.lines[3].contains("control mode"), "{:?}", report.lines);
    // Any drive may have 1 there.
    let mut bus = CanopenLog::default();
    bus.read(ObjectIndex::new(0x203F, 0), 1, 2).read(ObjectIndex::new(0x2000, 0), 20, 2);
    let report = bus.report();
    assert_eq!(report.changes("product"), []);
    assert!(!report.lines[3].contains("control mode"), "{:?}", report.lines);
}
