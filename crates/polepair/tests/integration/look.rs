//! Drives that are looked for on a link that is open, and taken in while it goes on.

use std::cell::Cell;
use std::time::Duration;

use polepair::no_reply::Wiring;
use polepair::scan::{DriveScanner, ScanAddresses, ScanReport};
use polepair::{Connector, LocalAxis, LocalLink};
use polepair_core::profile::Signal;

const RACK: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/examples/one-bus.toml");

fn open(url: &str) -> LocalLink {
    Connector::default().connect_local(url).expect("every drive answers")
}

fn run_scan(link: &LocalLink, numbers: impl Into<ScanAddresses>) -> ScanReport {
    let connector = Connector::default();
    let mut scanner = DriveScanner::on_link(&connector, link, 0, numbers).expect("a wire");
    while scanner.next_address(&|| false).expect("the link is there").is_some() {
        scanner.query_next(&|| false).expect("the link is there");
    }
    scanner.finish()
}

fn numbers(link: &LocalLink) -> Vec<u32> {
    link.axes().iter().map(LocalAxis::number).collect()
}

/// Turns an axis, and checks its motor. A servo amplifier waits for an input first: it is
/// read for its position.
fn turns(link: &LocalLink, axis: &LocalAxis) {
    if axis.protocol() == "modbus-rtu" {
        axis.arm(true);
        return drop(axis.signals(&[Signal::Position]).expect("a position"));
    }
    // Some drives are ready a while after they were switched on.
    link.sleep(Duration::from_secs(2));
    axis.arm(true);
    if axis.profile().plan(polepair_core::axis::Verb::Enable).is_some() {
        axis.enable().unwrap_or_else(|error| panic!("{}: {error}", axis.label()));
    }
    axis.velocity(10.0).unwrap_or_else(|error| panic!("{}: {error}", axis.label()));
    link.sleep(Duration::from_millis(800));
    let speed = axis.signals(&[Signal::Velocity]).expect("a speed")[0].value;
    assert!((speed - 10.0).abs() < 2.0, "{}: {speed} rad/s", axis.label());
}

#[test]
fn serial_drives_are_found_and_taken_in_while_the_others_go_on() {
    for (url, all) in [
        ("sim:tmcl?axes=3&time=virtual#1", [1, 3, 4]),
        ("sim:modbus-rtu?axes=3&time=virtual#1", [1, 2, 3]),
        ("sim:tml?axes=3&wire=rs485&time=virtual#1", [1, 2, 3]),
    ] {
        let link = open(url);
        turns(&link, &link.axes()[0]);
        let scan = run_scan(&link, 1..=6);
        let found: Vec<_> = scan.found.iter().map(|one| one.number).collect();
        assert_eq!(found, all[1..], "{url}: {:?}", scan.tried);
        assert_eq!((scan.axes.len(), scan.axes[0].answers), (1, true), "{url}: {:?}", scan.axes);
        assert_eq!(scan.axes[0].clash, None, "{url}");
        let both = link.add_drives(0, &scan.found).expect("they are new");
        assert_eq!(numbers(&both), all, "{url}");
        assert!(both.axes()[0].state().armed, "{url}: what it was doing goes on");
        turns(&both, &both.axes()[2]);
        let twice = both.add_drives(0, &scan.found).expect_err("they are there");
        assert_eq!(twice.code(), "E212", "{twice}");
    }
}

#[test]
fn a_bus_of_several_protocols_keeps_its_axes_where_they_are() {
    let link = open(&format!("sim:{RACK}?time=virtual#spindle,port"));
    let events = link.events().expect("both tell what they send");
    let names =
        |link: &LocalLink| link.axes().iter().map(|a| a.name().to_owned()).collect::<Vec<_>>();
    assert_eq!(names(&link), ["spindle", "port"]);
    let scan = run_scan(&link, ScanAddresses::ALL);
    let mut found: Vec<_> = scan.found.iter().map(|one| (one.protocol, one.number)).collect();
    found.sort_unstable();
    let there = [("technocan", 5), ("technocan", 7), ("thruster", 12)];
    assert_eq!(found, there, "{:?}", scan.tried);
    assert!(scan.axes.iter().all(|axis| axis.answers), "{:?}", scan.axes);
    let link = link.add_drives(0, &scan.found).expect("they are new");
    assert_eq!(names(&link), ["spindle", "port", "x", "y", "starboard"]);
    turns(&link, &link.axes()[0]);
    turns(&link, &link.axes()[3]);
    // An axis that joined sends events as itself.
    while events.poll().is_some() {}
    let (seen, all) = (link.events().expect("all tell"), [0, 1, 2, 3, 4]);
    for index in all {
        link.axes()[index].arm(!link.axes()[index].state().armed);
    }
    let armed: Vec<_> = std::iter::from_fn(|| seen.poll())
        .filter(|event| event.to_string().ends_with("armed"))
        .map(|event| event.index)
        .collect();
    assert_eq!(armed, all);
}

#[test]
fn a_look_that_is_broken_off_leaves_the_link_as_it_was() {
    let link = open("sim:tmcl?axes=3&time=virtual#1");
    let connector = Connector::default();
    let mut scanner = DriveScanner::on_link(&connector, &link, 0, 1..=200).expect("a wire");
    let now = || link.axes()[0].connection().now();
    let mut one = Duration::ZERO;
    for _ in 0..10 {
        let started_at = now();
        assert!(scanner.next_address(&|| false).expect("the link is there").is_some());
        scanner.query_next(&|| false).expect("the link is there");
        one = now().since(started_at);
    }
    // Asked once more whether it may go on: one question is out by then, and no other follows.
    let (started_at, cell) = (now(), Cell::new(0));
    let broken = || cell.replace(cell.get() + 1) > 0;
    scanner.query_next(&broken).expect("the link is there");
    assert!(now().since(started_at) <= one, "{:?} is more than {one:?}", now().since(started_at));
    assert_eq!(scanner.next_address(&|| false).expect("the link is there"), None);
    let scan = scanner.finish();
    assert_eq!(scan.not_queried, 190);
    assert_eq!(scan.found.iter().map(|one| one.number).collect::<Vec<_>>(), [3, 4]);
    turns(&link, &link.axes()[0]);
}

#[test]
fn a_missing_axis_is_reported() {
    let link = open("sim:tmcl?axes=3&time=virtual#1,3");
    link.simulation().expect("a simulation").act(
        0,
        1,
        polepair_drives::surroundings::Act::Supply(0.0),
    );
    link.sleep(Duration::from_millis(100));
    let scan = run_scan(&link, 1..=4);
    let answers: Vec<_> = scan.axes.iter().map(|axis| (axis.number, axis.answers)).collect();
    assert_eq!(answers, [(1, true), (3, false)]);
    assert_eq!(scan.found.iter().map(|one| one.number).collect::<Vec<_>>(), [4]);
}

#[test]
fn addresses_that_no_drive_can_have_are_not_asked() {
    // A driver takes a byte of an address: 261 would be 5, and 0 of CANopen is everybody.
    for (url, range, asked_range) in [
        ("sim:cia402:1?time=virtual", 0..=300, 1..=127),
        ("sim:tmcl?time=virtual", 200..=u32::MAX, 200..=255),
        ("sim:modbus-rtu?time=virtual", 0..=3, 1..=3),
    ] {
        let link = open(url);
        let (connector, mut all) = (Connector::default(), Vec::new());
        let mut scanner = DriveScanner::on_link(&connector, &link, 0, range).expect("a wire");
        while let Some(at) = scanner.next_address(&|| false).expect("the link is there") {
            all.push(at.number);
            scanner.query_next(&|| false).expect("the link is there");
        }
        assert!(
            !all.is_empty() && all.iter().all(|number| asked_range.contains(number)),
            "{url} {all:?}"
        );
    }
    let link = open("sim:cia402:1?time=virtual");
    let scan = run_scan(&link, 128..=300);
    assert!(scan.tried[0].contains("no drive can have such an address"), "{:?}", scan.tried);
}

#[test]
fn a_wire_without_axes_keeps_its_number() {
    let rack = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/examples/rack.toml");
    let whole = open(&format!("sim:{rack}?time=virtual"));
    let wires = whole.wires().len();
    assert!(wires > 1);
    let last = whole.axes().last().expect("axes");
    let link = open(&format!("sim:{rack}?time=virtual#{}", last.name()));
    let connector = Connector::default();
    let none =
        DriveScanner::on_link(&connector, &link, 0, 1..=1).map(drop).expect_err("nobody is there");
    assert_eq!(none.code(), "E212", "{none}");
    let mut scanner =
        DriveScanner::on_link(&connector, &link, wires - 1, last.number()..=last.number()).unwrap();
    while scanner.next_address(&|| false).unwrap().is_some() {
        scanner.query_next(&|| false).unwrap();
    }
    assert!(scanner.finish().axes[0].answers, "the wire's own axis");
}

#[test]
fn a_drive_joins_once_and_not_with_the_hosts_own_address() {
    let link = open("sim:tmcl?axes=2&time=virtual#1");
    let scan = run_scan(&link, 1..=4);
    link.add_drives(0, &scan.found).expect("it is new");
    let twice = link.add_drives(0, &scan.found).expect_err("another handle took it in");
    assert_eq!(twice.code(), "E220", "{twice}");
    let link = open("sim:tml:1,254?wire=rs485&time=virtual#1");
    let scan = run_scan(&link, 250..=254);
    assert_eq!(scan.found.iter().map(|one| one.number).collect::<Vec<_>>(), [254]);
    let own = link.add_drives(0, &scan.found).expect_err("its answers would be for the host");
    assert_eq!(own.code(), "E220", "{own}");
    let link = open("sim:tml:1,2,254?wire=rs485&time=virtual#1");
    let both = [run_scan(&link, 2..=2).found, run_scan(&link, 254..=254).found].concat();
    assert_eq!(link.add_drives(0, &both).expect_err("one of them cannot").code(), "E220");
    let link = link.add_drives(0, &both[..1]).expect("the other did not join before");
    assert_eq!(numbers(&link), [1, 2]);
}

#[test]
fn a_bus_whose_drives_need_the_hosts_heartbeat_is_not_lent() {
    let link = open("sim:thruster?time=virtual");
    link.axes()[0].set_raw("command timeout", 300).expect("a watchdog");
    let connector = Connector::default();
    let mut scanner =
        DriveScanner::on_link(&connector, &link, 0, ScanAddresses::ALL).expect("a wire");
    let before = link.axes()[0].connection().now();
    let refused = scanner.next_address(&|| false).expect_err("the drive would stop");
    assert_eq!(refused.code(), "E220", "{refused}");
    assert_eq!(link.axes()[0].connection().now(), before, "nobody waited, and nobody was silent");
}

/// Asked one after the other, 127 silent nodes take 51 s.
#[test]
fn all_nodes_of_a_can_bus_are_asked_at_once() {
    let link = open("sim:canopen:1,64,127?time=virtual#1");
    let begin = link.axes()[0].connection().now();
    let scan = run_scan(&link, ScanAddresses::ALL);
    let found: Vec<_> = scan.found.iter().map(|one| one.number).collect();
    assert_eq!(found, [64, 127], "{:?}", scan.tried);
    assert!(scan.axes[0].answers, "{:?}", scan.axes);
    assert!(
        scan.wiring == Wiring::CanBus && scan.tried[0].ends_with("all at once"),
        "{:?}",
        scan.tried
    );
    let took = link.axes()[0].connection().now().since(begin);
    assert!(took < Duration::from_secs(4), "{took:?}");
}
