//! The library against simulated drives on CAN buses, in virtual time.

use polepair::connect_local;
use polepair::error::Exit;
use polepair::scan::{ScanAddresses, scan};
use polepair::simulate::{Simulation, SimulationPace, rack_of_text, rack_of_words};
use polepair::{AnyTap, Connector, Error, Identification, LocalAxis, LocalLink};
use polepair_core::axis::{Command, Verb};
use polepair_core::medium::{Can, Frame, MediumKind, Stream};
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use polepair_link::{Tap, TapDirection};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Keeps the frames that passed, and counts runs of bytes.
#[derive(Clone, Default)]
struct Watcher(Arc<Mutex<Passed>>);

#[derive(Default)]
struct Passed {
    frames: Vec<(TapDirection, Frame)>,
    runs: usize,
}

impl Tap<Can> for Watcher {
    fn record_unit(&mut self, _: Instant, direction: TapDirection, frame: &Frame) {
        self.0.lock().unwrap().frames.push((direction, *frame));
    }
}

impl Tap<Stream> for Watcher {
    fn record_unit(&mut self, _: Instant, _: TapDirection, _: &[u8]) {
        self.0.lock().unwrap().runs += 1;
    }
}

fn tapped(url: &str, tap: impl AnyTap + 'static) -> Result<LocalLink, Error> {
    Connector::default().with_tap(tap).connect_local(url)
}

#[test]
fn tmcl_modules_on_a_bus_are_found_and_turned() {
    let watcher = Watcher::default();
    let link = tapped("sim:tmcl+can:1,3?time=virtual", watcher.clone()).unwrap();
    assert_eq!(link.axes().iter().map(|axis| axis.number()).collect::<Vec<_>>(), [1, 3]);
    let axis = link.axis(3).unwrap();
    assert_eq!((axis.medium(), axis.profile().name), (MediumKind::Can, "tmcm-171"));
    axis.set("max current", "1.2 A").unwrap();
    assert_eq!(axis.get("max current").unwrap().to_string(), "1.2 A");
    {
        let armed = axis.armed().unwrap();
        armed.velocity("60 rpm").unwrap();
        link.sleep(Duration::from_secs(1));
        let speed = axis.signals(&[Signal::Velocity]).unwrap()[0].value;
        assert!((speed - std::f64::consts::TAU).abs() < 0.3, "{speed}");
    }
    assert!(link.simulation().unwrap().truth(0, 0).unwrap().velocity.abs() < 1e-6);
    let passed = watcher.0.lock().unwrap();
    let to =
        |direction| passed.frames.iter().filter(move |(d, _)| *d == direction).map(|(_, f)| f.id);
    assert!(to(TapDirection::ToDrive).all(|id| id == 1 || id == 3));
    assert!(to(TapDirection::ToHost).all(|id| id == 2) && to(TapDirection::ToHost).count() > 5);
    assert_eq!(passed.runs, 0);
}

#[test]
fn a_rehearsal_on_can_shows_frames_and_sends_none() {
    let link = connect_local("sim:tmcl+can?time=virtual").unwrap();
    let axis = link.axis(1).unwrap();
    let before = link.counters(&axis).sent;
    let steps = axis.rehearse(Command::new(Verb::Stop)).unwrap();
    // MST, in seven bytes: neither address nor checksum.
    let frame = steps[0].frame.expect("a frame");
    assert_eq!(frame.to_string(), "001#03000000000000");
    assert_eq!(link.counters(&axis).sent, before);
}

#[test]
fn one_question_finds_every_drive_where_the_protocol_has_one() {
    for url in ["sim:tmlcan:5,7,31?time=virtual", "sim:technocan:5,7,31?time=virtual"] {
        let watcher = Watcher::default();
        let connector = Connector::default().with_tap(watcher.clone());
        let found =
            scan(&connector, url, ScanAddresses::ALL, &mut |_| std::ops::ControlFlow::Continue(()))
                .unwrap();
        let numbers: Vec<u32> = found.found.iter().map(|found| found.number).collect();
        assert_eq!(numbers, [5, 7, 31], "{url}");
        assert!(found.tried[0].ends_with("all with one request"), "{:?}", found.tried);
        // One to all; the rest asks those three what they are.
        let sent = watcher
            .0
            .lock()
            .unwrap()
            .frames
            .iter()
            .filter(|(d, _)| *d == TapDirection::ToDrive)
            .count();
        assert!(sent < 40, "{sent}");
    }
}

const RELAY: &str = "[[link]]\nname = \"host\"\nprotocol = \"tml\"\n\
    [[link.drive]]\nname = \"relay\"\nprofile = \"technosoft-f514l\"\naddress = 255\n\
    on = [\"host\", \"bus\"]\n\
    [[link]]\nname = \"bus\"\nprotocol = \"tmlcan\"\nbitrate = 500000\n\
    [[link.drive]]\nname = \"x\"\nprofile = \"technosoft-f514l\"\naddress = 1\n\
    [[link.drive]]\nname = \"y\"\nprofile = \"technosoft-f514l\"\naddress = 5\n";

#[test]
fn a_relay_brings_its_host_to_the_axes_behind_it() {
    let file = std::env::temp_dir().join(format!("polepair-relay-{}.toml", std::process::id()));
    std::fs::write(&file, RELAY).unwrap();
    let url = format!("sim:{}?time=virtual", file.display());
    let link = connect_local(&url).unwrap();
    let numbers: Vec<u32> = link.axes().iter().map(|axis| axis.number()).collect();
    assert_eq!(numbers, [255, 1, 5]);
    let far = link.axis_named("y").unwrap();
    let position = far.signals(&[Signal::Position]).unwrap()[0];
    assert!(position.at.is_some() && position.value == 0.0);
    let found =
        scan(&Connector::default(), &url, 1..=6, &mut |_| std::ops::ControlFlow::Continue(()))
            .unwrap();
    assert_eq!(found.found.iter().map(|found| found.number).collect::<Vec<_>>(), [1, 5]);
    std::fs::remove_file(&file).unwrap();
}

/// Address 0 in the set-up: the axis ID is that of the switches, or 255 (TML communication manual,
/// chapter 2).
#[test]
fn an_axis_id_is_left_to_the_switches() {
    let file = std::env::temp_dir().join(format!("polepair-switch-{}.toml", std::process::id()));
    for (options, expected) in [("", 255), ("options = { switches = 9 }\n", 9)] {
        let rack = RELAY.replace("address = 255\n", &format!("address = 0\n{options}"));
        std::fs::write(&file, rack).unwrap();
        let link = connect_local(&format!("sim:{}?time=virtual", file.display())).unwrap();
        let relay = link.axis_named("relay").unwrap();
        assert_eq!(relay.number(), expected);
        assert_eq!(relay.get("AAR").unwrap().raw & 0xFF, i64::from(expected));
        assert_eq!(relay.get("CSR").unwrap().raw & 0x4000, 0x4000, "from hardware");
        assert_eq!(link.axis_named("y").unwrap().get("AAR").unwrap().raw & 0xFF, 5);
    }
    std::fs::remove_file(&file).unwrap();
}

#[test]
fn a_rack_says_what_is_wrong_with_its_links() {
    assert!(rack_of_text("rack.toml", RELAY, 1).is_ok());
    for (from, to, text) in [
        ("\"bus\"]", "\"bsu\"]", "`bsu` is no link of this rack; did you mean `bus`?"),
        ("protocol = \"tmlcan\"", "protocol = \"tml\"", "`bitrate` is not supported on this type"),
        ("bitrate = 500000", "baud = 500000", "`baud` is not supported on this type"),
        ("bitrate = 500000", "kind = \"canbus\"", "neither serial nor can"),
        ("protocol = \"tmlcan\"", "kind = \"can\"\nprotocol = \"tml\"", "`tml` is not used on CAN"),
        ("\"tmlcan\"\nbitrate = 500000", "\"tml\"", "one serial link and one CAN bus at most"),
        ("bitrate = 500000", "faults = { flip = 1 }", "unknown key `flip`"),
    ] {
        assert!(RELAY.contains(from), "{from}");
        let error = rack_of_text("rack.toml", &RELAY.replacen(from, to, 1), 1).unwrap_err();
        assert!(error.to_string().contains(text), "{text}: {error}");
    }
    // A drive without a CAN connector is not put on a bus.
    let wrong = RELAY.replace("protocol = \"tml\"\n", "").replace("technosoft-f514l", "syntron-ts");
    assert!(rack_of_text("rack.toml", &wrong, 1).is_err());
}

#[test]
fn an_address_that_a_request_cannot_hold_is_refused() {
    // Cut to eleven bits, 2049 would be module 1.
    let error = connect_local("tmcl+udp://239.74.163.2:43113#2049").unwrap_err();
    assert_eq!((error.code(), error.exit()), ("E212", Exit::Usage), "{error}");
}

#[test]
fn groups_are_commanded_and_not_queried() {
    let link = connect_local("sim:tmlcan:5,7?time=virtual#5,g1").unwrap();
    let group = &link.axes()[1];
    assert_eq!((group.label().as_str(), group.identified()), ("axes g1", &Identification::Group));
    group.stop().unwrap();
    for (url, text) in [
        ("sim:tmcl?time=virtual#1,g1", "this protocol has no groups"),
        ("sim:technocan:5?time=virtual#g6", "groups are g1 to g5"),
    ] {
        let error = connect_local(url).unwrap_err();
        assert_eq!((error.code(), error.exit()), ("E212", Exit::Usage), "{error}");
        assert!(error.hint().contains(text), "{error:?}");
    }
}

#[test]
fn faults_of_a_bus_are_survived() {
    let text = "[[link]]\nkind = \"can\"\nfaults = { error = 0.1, twice = 0.05 }\n\
                [[link.drive]]\nprofile = \"tmcm-171\"\n";
    let rack = rack_of_text("rack.toml", text, 1).unwrap();
    assert!(Simulation::new(&rack, 1, SimulationPace::Virtual).is_ok());
    let file = std::env::temp_dir().join(format!("polepair-faulty-{}.toml", std::process::id()));
    std::fs::write(&file, text).unwrap();
    let link = connect_local(&format!("sim:{}?time=virtual", file.display())).unwrap();
    let axis = &link.axes()[0];
    for raw in 1..=200 {
        axis.set_raw("max current", raw).unwrap();
        assert_eq!(axis.get_raw("max current").unwrap(), raw);
    }
    let counters = link.counters(axis);
    assert!(counters.late + counters.foreign > 0, "frames that came twice: {counters:?}");
    std::fs::remove_file(&file).unwrap();
}

#[test]
fn words_choose_the_medium() {
    let rack = rack_of_words(&["tmcl:1", "tmcl+can:1", "tmcm-170+can", "technocan:3"], 1).unwrap();
    let media: Vec<_> = rack.rack.links.iter().map(|link| link.wire.medium()).collect();
    let [serial, can] = [MediumKind::Serial, MediumKind::Can];
    assert_eq!(media, [serial, can, can, can]);
    assert_eq!(rack.urls(1, "udp://239.74.163.2:43113"), ["tmcl+udp://239.74.163.2:43113#1"]);
    for word in ["modbus-rtu+can", "tmcl+udp", "technocan+serial"] {
        assert_eq!(rack_of_words(&[word], 1).unwrap_err().code(), "E203", "{word}");
    }
}

/// SR makes a drive send its axis' state without a request, from the next interval on, and ends
/// with none (thruster family, section 2.5).
#[test]
fn reports_bring_signals_without_a_query() {
    let watcher = Watcher::default();
    let link = tapped("sim:thruster:11?time=virtual", watcher.clone()).unwrap();
    let axis = link.axis(11).unwrap();
    let interval = Duration::from_millis(100);
    let source = |axis: &LocalAxis, signal| axis.profile().signal(signal).unwrap().parameter;
    let values = [Signal::Velocity, Signal::Voltage].map(|signal| source(&axis, signal));
    let armed = axis.armed().unwrap();
    armed.velocity("600 rpm").unwrap();
    let reports = axis.start_reports(&values, interval).unwrap();
    let events = axis.events().unwrap();
    let end = axis.connection().now().plus_ms(4_000);
    let before = watcher.0.lock().unwrap().frames.len();
    while events.next(interval * 11).is_some_and(|event| event.at < end) {}
    let heard = watcher.0.lock().unwrap().frames[before..].to_vec();
    assert!(heard.iter().all(|(direction, frame)| {
        *direction == TapDirection::ToHost && frame.bytes()[..2] == [0x41, 0x01]
    }));
    assert!(heard.len() > 30, "{}", heard.len());
    for (signal, expected) in
        [(Signal::Velocity, 20.0 * std::f64::consts::PI), (Signal::Voltage, 48.0)]
    {
        let reading = axis.state().reading(signal);
        let age = axis.connection().now().since(reading.at.expect("a report"));
        assert!(age <= interval && (reading.value - expected).abs() < 2.0, "{reading:?} {age:?}");
    }
    reports.end().unwrap();
    while events.poll().is_some() {}
    assert_eq!(events.next(Duration::from_secs(2)), None);

    let autosend = axis.find("autosend").unwrap();
    let refused = axis.start_reports(&[autosend], interval).map(drop).unwrap_err();
    assert!(refused.code() == "E213" && refused.to_string().contains("autosend"), "{refused}");
    let refused = axis.start_reports(&values, Duration::from_secs(66)).map(drop).unwrap_err();
    assert_eq!(refused.code(), "E216", "{refused}");
    let others = connect_local("sim:tmcl?time=virtual").unwrap();
    let other = &others.axes()[0];
    let refused =
        other.start_reports(&[source(other, Signal::Velocity)], interval).map(drop).unwrap_err();
    assert_eq!(refused.code(), "E213", "{refused}");
}

/// Values of a mapped node come without a query, and its process data are then as they were.
fn check_mapped_reports(url: &str, power: bool) {
    let watcher = Watcher::default();
    let link = tapped(url, watcher.clone()).unwrap();
    let axis = link.axis(5).unwrap();
    let before = process_data(&axis);
    let interval = Duration::from_millis(20);
    let values = ["position actual", "velocity actual", "torque actual", "statusword"];
    let values = values.map(|name| axis.find(name).unwrap());
    axis.arm(true);
    if power {
        axis.enable().unwrap();
    }
    let reports = axis.start_reports(&values, interval).unwrap();
    if !power {
        axis.enable().unwrap();
    }
    let events = axis.events().unwrap();
    axis.velocity("120 rpm").unwrap();
    let (from, end) =
        (watcher.0.lock().unwrap().frames.len(), axis.connection().now().plus_ms(1_000));
    while events.next(interval * 5).is_some_and(|event| event.at < end) {}
    let frames = watcher.0.lock().unwrap().frames[from..].to_vec();
    assert!(frames.iter().all(|(direction, _)| *direction == TapDirection::ToHost), "{url}");
    // Twelve bytes are two objects, each every 20 ms.
    assert!((80..=130).contains(&frames.iter().filter(|(_, f)| f.id > 0x300).count()), "{url}");
    let reading = axis.state().reading(Signal::Velocity);
    assert!((reading.value - 4.0 * std::f64::consts::PI).abs() < 0.5, "{reading:?}");
    assert!(axis.connection().now().since(reading.at.unwrap()) <= interval * 5);
    axis.disable().unwrap();
    reports.end().unwrap();
    assert_eq!(process_data(&axis), before, "{url}");
}

/// Identifiers, types, times and mappings of what a node sends.
fn process_data(axis: &LocalAxis) -> Vec<i64> {
    let objects = (0x1800..0x1804).flat_map(|index| [1, 2, 3, 5].map(|sub| (index, sub)));
    let mappings = (0x1A00..0x1A04).flat_map(|index| [0, 1, 2].map(|sub| (index, sub)));
    let read = |(index, sub)| axis.get_raw(&format!("0x{index:04X}:{sub}")).unwrap();
    objects.chain(mappings).map(read).collect()
}

#[test]
fn reports_of_a_canopen_node_are_mapped_and_restored() {
    check_mapped_reports("sim:cia402:5?time=virtual", false);
    check_mapped_reports("sim:cia402:5?time=virtual", true);
    check_mapped_reports("sim:cia402:5?time=virtual&mapping=pre-operational", false);
}

#[test]
fn reports_that_do_not_fit_change_nothing() {
    let link = connect_local("sim:cia402:5?time=virtual").unwrap();
    let axis = &link.axes()[0];
    let before = process_data(axis);
    let position = axis.find("position actual").unwrap();
    let many = vec![position; 7];
    let refused = axis.start_reports(&many, Duration::from_millis(10)).map(drop).unwrap_err();
    assert_eq!(refused.code(), "E217", "{refused}");
    assert_eq!(process_data(axis), before);
    // An object that cannot be mapped is refused by the node, and what was changed is restored.
    let store = axis.find("store").unwrap();
    let refused =
        axis.start_reports(&[position, store], Duration::from_millis(10)).map(drop).unwrap_err();
    assert_eq!(refused.code(), "E601", "{refused}");
    assert_eq!(process_data(axis), before);
    // An enabled drive that maps when pre-operational alone keeps its power.
    let link = connect_local("sim:cia402:5?time=virtual&mapping=pre-operational").unwrap();
    let axis = &link.axes()[0];
    axis.raw("nmt start").unwrap();
    let _armed = axis.armed().unwrap();
    let refused = axis.start_reports(&[position], Duration::from_millis(10)).map(drop).unwrap_err();
    assert!(
        refused.code() == "E601" && format!("{refused:?}").contains("disable the axis first"),
        "{refused}"
    );
    assert!(axis.state().reading(Signal::Enabled).raw != 0);
}
