//! Layer setting, and which drive a node says that it is.

use polepair_core::drives;
use polepair_core::proto::canopen::lss::{self, Number};

use super::*;
use crate::session::Outcome;

fn select(bus: &mut Bus) -> &mut Bus {
    let numbers = Number::ALL.into_iter().zip([0x319, 7, 0x10002, 4711]);
    for (number, value) in numbers {
        bus.frame(lss::Request::SwitchSelective(number, value).emit());
    }
    bus.frame(lss::Reply::Selected.emit())
}

fn setting(bus: &mut Bus) -> &mut Bus {
    bus.frame(lss::Request::SetNode(5).emit()).frame(lss::Reply::SetNode(0, 0).emit());
    bus.frame(lss::Request::Store.emit()).frame(lss::Reply::Store(0, 0).emit());
    bus.frame(lss::Request::SwitchGlobal(false).emit())
}

fn ended(told: &Told) -> Vec<(&'static str, Outcome, bool)> {
    let exchange = |notice: &Notice| match notice {
        Notice::Exchange(it) => Some((it.op, it.outcome, it.answered.is_some())),
        _ => None,
    };
    told.notices.iter().filter_map(exchange).collect()
}

#[test]
fn four_numbers_select_one_device_and_silence_says_that_there_is_none() {
    let mut bus = Bus::default();
    setting(select(&mut bus));
    bus.frame(lss::Request::IdentifyUnconfigured.emit()).wait(2000).say(0x80, &[]);
    let told = bus.told();
    told.clean();
    let (done, answered) = (Outcome::Done, true);
    let expected = [
        ("LSS select", done, answered),
        ("LSS set node-ID", done, answered),
        ("LSS store", done, answered),
        ("LSS switch all", done, false),
        ("LSS identify unconfigured", done, false),
    ];
    assert_eq!(ended(&told), expected);
    for first in 0..bus.frames.len() {
        bus.told_from(first).clean();
    }
}

#[test]
fn a_setting_that_is_not_answered_or_refused_or_answered_twice_is_told() {
    let set = || lss::Request::SetNode(5).emit();
    let mut bus = Bus::default();
    select(&mut bus).frame(set()).wait(3000).say(0x80, &[]);
    bus.told().planted(Oddity::Unanswered);
    bus.frame(lss::Reply::SetNode(0, 0).emit());
    assert_eq!(bus.told().odds(), [Oddity::Unanswered, Oddity::LateReply]);
    let mut bus = Bus::default();
    select(&mut bus).frame(set()).frame(lss::Reply::SetNode(1, 0).emit());
    bus.told().planted(Oddity::Refused);
    let mut bus = Bus::default();
    setting(select(&mut bus).frame(set()));
    bus.told().planted(Oddity::Retry);
    let mut bus = Bus::default();
    setting(select(&mut bus)).frame(lss::Reply::Selected.emit());
    bus.told().planted(Oddity::ForeignReply);
    let mut bus = Bus::default();
    bus.frame(lss::Request::Inquire(Number::Serial).emit());
    bus.frame(lss::Reply::Number(Number::Serial, 4711).emit());
    bus.frame(lss::Reply::Number(Number::Serial, 4712).emit());
    bus.told().planted(Oddity::DuplicateAddress);
}

#[test]
fn a_node_that_says_which_drive_it_is_has_its_names() {
    let find = |name| drives::profiles().iter().find(|profile| profile.name == name);
    let title = find("syntron-ts-canopen").expect("built in").title;
    let mut bus = Bus::default();
    bus.read(Object::new(0x203F, 0), 9870, 2).read(Object::new(0x2000, 0), 20, 2);
    let told = bus.told();
    told.clean();
    assert_eq!(told.changes("product"), [("", title)]);
    assert!(told.lines[3].contains("control mode"), "{:?}", told.lines);
    // Any drive may have 1 there.
    let mut bus = Bus::default();
    bus.read(Object::new(0x203F, 0), 1, 2).read(Object::new(0x2000, 0), 20, 2);
    let told = bus.told();
    assert_eq!(told.changes("product"), []);
    assert!(!told.lines[3].contains("control mode"), "{:?}", told.lines);
}
