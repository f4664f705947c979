//! Events on an idle link, from simulated drives in virtual time.

use polepair::connect_local;
use polepair::events::{EVENTS_MAX, Event, EventKind, Events};
use polepair::{AnyLink, LocalAxis, LocalLink};
use polepair_core::axis::Presence;
use polepair_core::medium::Frame;
use polepair_core::profile::{Severity, Signal};
use polepair_core::time::Instant;
use polepair_drives::surroundings::Act;
use std::sync::{Arc, mpsc};
use std::task::Wake;
use std::time::Duration;

const SECOND: Duration = Duration::from_secs(1);

/// A node that sends its statusword and position every millisecond by itself.
fn sending(url: &str) -> (LocalLink, LocalAxis) {
    let link = connect_local(url).unwrap();
    let axis = link.axes()[0].clone();
    axis.raw("nmt pre-operational").unwrap();
    let identifier = axis.get_raw("tpdo 1 identifier").unwrap();
    let settings = [
        ("identifier", identifier | 1 << 31),
        ("transmission", 255),
        ("inhibit time", 0),
        ("event time", 1),
        ("entries", 0),
        ("entry 1", 0x6041_0010),
        ("entry 2", 0x6064_0020),
        ("entries", 2),
        ("identifier", identifier & !(1 << 31)),
    ];
    for (name, raw) in settings {
        axis.set_raw(&format!("tpdo 1 {name}"), raw).unwrap();
    }
    (link, axis)
}

fn is_position(event: &Event) -> bool {
    matches!(event.kind, EventKind::Signal { signal: Signal::Position, .. })
}

/// The first event of that sort within ten seconds of the link's time.
fn first(events: &Events, mut wanted: impl FnMut(&EventKind) -> bool) -> Event {
    for _ in 0..100_000 {
        let event = events.next(10 * SECOND).expect("an event");
        if wanted(&event.kind) {
            return event;
        }
    }
    panic!("none in a hundred thousand");
}

#[test]
fn process_data_of_an_idle_link_are_all_reported() {
    let (link, axis) = sending("sim:cia402:2?time=virtual");
    let events = link.events().unwrap();
    axis.raw("nmt start").unwrap();
    // No request is sent: the link is idle.
    let mut stamps: Vec<Instant> = Vec::new();
    while stamps.len() < 5_000 {
        let event = events.next(SECOND).expect("the next one");
        if is_position(&event) {
            assert_eq!((event.axis, event.index), (Some(2), 0));
            stamps.push(event.at);
        }
    }
    for pair in stamps.windows(2) {
        assert_eq!(pair[1].since(pair[0]), Duration::from_millis(1));
    }
    assert_eq!(events.lost(), 0);
}

#[test]
fn a_mapping_by_another_master_is_learnt() {
    let link = connect_local("sim:cia402:2?time=virtual").unwrap();
    let axis = &link.axes()[0];
    let events = axis.events().unwrap();
    // After a restart the mapping is the drive's own, and unknown until it is read.
    assert!(link.simulation().unwrap().act(0, 0, Act::PowerCycle));
    let restarted = first(&events, |kind| matches!(kind, EventKind::Presence(_)));
    assert_eq!(restarted.kind, EventKind::Presence(Presence::Restarted));
    axis.read_event_layout().unwrap();
    for (name, raw) in [("transmission", 255), ("event time", 10)] {
        axis.set_raw(&format!("tpdo 1 {name}"), raw).unwrap();
    }
    axis.raw("nmt start").unwrap();
    let word = axis.find("statusword").unwrap();
    let of_status = |kind: &EventKind| matches!(kind, EventKind::Parameter { parameter, .. } if *parameter == word);
    let report = first(&events, of_status);
    let EventKind::Parameter { raw, value, .. } = report.kind else { unreachable!() };
    assert_eq!(raw as f64, value);
}

#[test]
fn a_fault_is_reported_with_its_cause_and_remedy_and_when_it_is_over() {
    let link = connect_local("sim:cia402:2?time=virtual").unwrap();
    let events = link.events().unwrap();
    let known = link.axes()[0].profile().faults;
    let short = known.iter().find(|f| f.severity == Severity::Fault && f.code < 1 << 16).unwrap();
    assert!(link.simulation().unwrap().act(0, 0, Act::Fault(short.code)));
    let appeared = first(&events, |kind| matches!(kind, EventKind::FaultAppeared { .. }));
    let EventKind::FaultAppeared { code, fault: Some(fault) } = appeared.kind else { panic!() };
    assert_eq!((code, fault.name), (short.code, short.name));
    assert!(!fault.remedy.is_empty());
    link.axes()[0].clear().unwrap();
    let cleared = first(&events, |kind| matches!(kind, EventKind::FaultCleared { .. }));
    assert!(matches!(cleared.kind, EventKind::FaultCleared { code, .. } if code == short.code));
    assert!(cleared.at > appeared.at);
}

#[test]
fn a_heartbeat_that_fails_to_come_disarms() {
    let link = connect_local("sim:cia402:2?time=virtual").unwrap();
    let axis = &link.axes()[0];
    axis.set_raw("heartbeat time", 100).unwrap();
    let events = link.events().unwrap();
    axis.arm(true);
    assert_eq!(first(&events, |_| true).kind, EventKind::Armed);
    first(&events, |kind| matches!(kind, EventKind::Presence(_)));
    // Another master on the bus takes the node's heartbeat away.
    let AnyLink::Can(stranger) = link.simulation().unwrap().open(0).unwrap() else { panic!() };
    let none = Frame::standard(0x602, &[0x2B, 0x17, 0x10, 0, 0, 0, 0, 0]);
    stranger.send(&none).unwrap();
    let gone = first(&events, |kind| matches!(kind, EventKind::Presence(_)));
    assert_eq!(gone.kind, EventKind::Presence(Presence::Gone));
    assert_eq!(first(&events, |_| true).kind, EventKind::Disarmed);
    assert!(!axis.state().armed);
}

#[test]
fn two_listeners_hear_the_same() {
    let (link, axis) = sending("sim:cia402:2?time=virtual");
    let (one, other) = (link.events().unwrap(), link.events().unwrap());
    axis.raw("nmt start").unwrap();
    let received: Vec<Event> = (0..500).map(|_| one.next(SECOND).unwrap()).collect();
    let also: Vec<Event> = (0..500).map(|_| other.next(SECOND).unwrap()).collect();
    assert_eq!(received, also);
    drop(one);
    assert!(other.next(SECOND).is_some());
}

#[test]
fn a_slow_listener_gets_the_number_of_its_losses() {
    let (link, axis) = sending("sim:cia402:2?time=virtual");
    let events = link.events().unwrap();
    axis.raw("nmt start").unwrap();
    link.sleep(10 * SECOND);
    // The newest are there, the oldest are not, and none is unaccounted for.
    let mut left = 0;
    let mut last = Instant::ZERO;
    while let Some(event) = events.poll() {
        left += 1;
        last = event.at;
    }
    assert_eq!(left, EVENTS_MAX as u64);
    let lost = events.lost();
    // Statusword and position of each millisecond, and a few words at the start.
    assert!((19_900..=20_100).contains(&(left + lost)), "{left} and {lost}");
    assert!(link.simulation().unwrap().now().since(last) <= Duration::from_millis(2));
}

#[test]
fn listeners_of_one_axis_do_not_hear_of_others() {
    let link = connect_local("sim:cia402:2,3?time=virtual#2,3").unwrap();
    let events = link.axes()[1].events().unwrap();
    link.axes()[0].arm(true);
    link.axes()[1].arm(true);
    let event = first(&events, |_| true);
    assert_eq!((event.axis, event.kind), (Some(3), EventKind::Armed));
    assert_eq!(events.next(Duration::from_millis(10)), None);
}

#[test]
fn a_serial_drive_tells_its_errors_unasked() {
    // TML communication manual, chapter 3: messages of type C.
    let link = connect_local("sim:tml?time=virtual").unwrap();
    let axis = &link.axes()[0];
    axis.set_raw("motion error mask", 1 << 12).unwrap();
    let events = link.events().unwrap();
    assert!(link.simulation().unwrap().act(0, 0, Act::Supply(70.0)));
    let appeared = first(&events, |kind| matches!(kind, EventKind::FaultAppeared { .. }));
    let EventKind::FaultAppeared { code, fault: Some(fault) } = appeared.kind else { panic!() };
    assert_eq!((code, appeared.axis), (1 << 12, Some(axis.number())));
    assert!(!fault.cause.is_empty() && !fault.remedy.is_empty());
}

#[test]
fn a_wait_ends_when_somebody_interrupts() {
    let link = connect_local("sim:tmcl").unwrap();
    let events = link.events().unwrap();
    link.interrupters().iter().for_each(polepair_link::Interrupter::interrupt);
    assert_eq!(Iterator::next(&mut &events), None);
    assert_eq!(events.next(Duration::from_millis(1)), None);
}

struct Bell(mpsc::Sender<()>);

impl Wake for Bell {
    fn wake(self: Arc<Self>) {
        self.0.send(()).unwrap();
    }
}

#[test]
fn a_waker_is_woken_by_the_thread_that_reads() {
    let (link, axis) = sending("sim:cia402:2");
    let events = link.events().unwrap();
    while events.poll().is_some() {}
    let (sender, rings) = mpsc::channel();
    if !events.ready_or_wake(&Arc::new(Bell(sender)).into()) {
        axis.raw("nmt start").unwrap();
        rings.recv_timeout(60 * SECOND).expect("the waker is woken");
    }
    assert!(events.poll().is_some());
}

/// A drive may send any variable unasked (`SEND`, TML communication manual, chapter 3, messages of type
/// C): one that the profile does not name is an event as well.
#[test]
fn a_value_at_an_address_of_the_users_own_is_an_event() {
    let link = connect_local("sim:technosoft-f514l:1?time=virtual").unwrap();
    let axis = &link.axes()[0];
    let events = axis.events().unwrap();
    axis.arm(true);
    for (text, name, value) in
        [("@0x03B4 = 1234", "@0x03B4:i16", 1234), ("@0x03B6L = -100000L", "@0x03B6:i32", -100_000)]
    {
        axis.raw(text).unwrap();
        let address = text.split(' ').next().unwrap();
        axis.raw(&format!("SEND {address}")).unwrap();
        let event = first(&events, |kind| matches!(kind, EventKind::Parameter { .. }));
        let EventKind::Parameter { parameter, raw, .. } = event.kind else { unreachable!() };
        assert_eq!((axis.parameter(parameter).unwrap().name, raw), (name, value));
    }
}
