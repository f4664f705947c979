//! Looking for drives on links that are open, in virtual time: found, clashing, gone; refused where
//! something may move, broken off by a stop, and taken in while everything else goes on.

use crate::patience;

use std::sync::{Arc, Mutex};
use std::{fs, process};

use patience::{MS, heard, order};
use polepair_serve::bench::{
    Bench, BenchEvent, BenchOptions, JournalEntry, JournalSink, PendingReply, SessionName,
};
use polepair_serve::message::{
    AddDrives, CommandOutcome, DriveAddress, GatewayError, JournalAction, LeaseAction, OutcomeKind,
    ScanRequest, ScanState, ScanView, SimulationAction, StopRequest,
};

const BUS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/examples/one-bus.toml");

/// A bench with one client.
struct TestBench {
    bench: Bench,
    ann: SessionName,
    ids: u32,
}

impl TestBench {
    fn new(urls: &[&str]) -> Self {
        Self::with(urls, BenchOptions::default())
    }

    fn with(urls: &[&str], options: BenchOptions) -> Self {
        let urls: Vec<String> = urls.iter().map(|url| (*url).to_owned()).collect();
        Self { bench: Bench::open(&urls, options).unwrap(), ann: "ann".into(), ids: 0 }
    }

    fn hear<T>(&self, reply: PendingReply<T>) -> Result<T, GatewayError> {
        heard(&self.bench, reply)
    }

    fn begin(&self, link: u16, first: u32, last: u32) -> Result<ScanView, GatewayError> {
        let request = ScanRequest { first: Some(first), last: Some(last) };
        self.hear(self.bench.start_scan(link, &self.ann, request))
    }

    fn ended(&self, link: u16) -> ScanView {
        for _ in 0..60_000 {
            let view = self.bench.scan_view(link).unwrap();
            if view.state != ScanState::UnderWay {
                return view;
            }
            self.bench.advance_time(MS);
        }
        panic!("the look does not end");
    }

    fn run_scan(&self, link: u16, first: u32, last: u32) -> ScanView {
        let view = self.begin(link, first, last).unwrap();
        assert_eq!((view.state, &*view.by), (ScanState::UnderWay, "ann"));
        self.ended(link)
    }

    fn acquire_lease(&self, axis: u16) -> Result<u64, GatewayError> {
        let lease = self.bench.request_lease(axis, &self.ann, LeaseAction::Take, 0);
        self.hear(lease).map(|lease| lease.expect("a lease").epoch)
    }

    fn drop(&self, axis: u16, epoch: u64) {
        self.hear(self.bench.request_lease(axis, &self.ann, LeaseAction::Drop, epoch)).unwrap();
    }

    fn run_command(
        &mut self,
        axis: u16,
        epoch: u64,
        verb: &str,
        velocity: Option<f64>,
    ) -> CommandOutcome {
        self.ids += 1;
        let request = order(&self.bench, self.ids, epoch, verb, velocity);
        self.hear(self.bench.command(axis, &self.ann, request)).unwrap()
    }

    /// Takes, arms, powers and turns an axis, as far as it can be, and gives it back after that.
    fn turn(&mut self, axis: u16) {
        let epoch = self.acquire_lease(axis).unwrap();
        for (verb, velocity) in [("arm", None), ("enable", None), ("velocity", Some(10.0))] {
            let info = &self.bench.snapshot().axes[usize::from(axis)];
            if !info.verbs.iter().any(|known| known.verb == verb) {
                continue;
            }
            let outcome = self.run_command(axis, epoch, verb, velocity);
            assert_eq!(outcome.outcome, OutcomeKind::Done, "{axis} {verb}: {:?}", outcome.error);
            self.hear(self.bench.request_lease(axis, &self.ann, LeaseAction::Renew, epoch))
                .unwrap();
        }
        self.bench.advance_time(800 * MS);
        let speed = self.bench.truth(axis).expect("simulated").velocity.abs();
        assert!(speed > 5.0, "axis {axis}: {speed} rad/s");
        self.hear(self.bench.request_lease(axis, &self.ann, LeaseAction::Renew, epoch)).unwrap();
        for verb in ["stop", "disable"] {
            let info = &self.bench.snapshot().axes[usize::from(axis)];
            if info.verbs.iter().any(|known| known.verb == verb) {
                let outcome = self.run_command(axis, epoch, verb, None);
                assert_eq!(
                    outcome.outcome,
                    OutcomeKind::Done,
                    "{axis} {verb}: {:?}",
                    outcome.error
                );
            }
        }
        self.bench.advance_time(1000 * MS);
        self.drop(axis, epoch);
        self.bench.advance_time(1000 * MS);
        let read = self.bench.read_signals(axis, &["velocity", "enabled"]);
        drop(self.hear(read));
    }

    fn numbers(&self) -> Vec<u32> {
        self.bench.snapshot().axes.iter().map(|axis| axis.number).collect()
    }

    /// Number of samples of an axis in a second.
    fn samples(&self, axis: u16) -> usize {
        let info = &self.bench.snapshot().axes[usize::from(axis)];
        let signal = info.signals[0].signal.clone();
        let mut channel = self.bench.subscribe(axis, Some(&signal), None, 20.0).unwrap();
        self.bench.advance_time(1000 * MS);
        let mut samples = Vec::new();
        assert_eq!(channel.drain_into(&mut samples), None, "no gap");
        samples.len()
    }
}

fn found(view: &ScanView) -> Vec<(&str, u32)> {
    view.found.iter().map(|one| (&*one.protocol, one.number)).collect()
}

#[test]
fn a_serial_drive_is_found_taken_in_and_moved_and_the_old_axis_stays_what_it_was() {
    let mut fixture = TestBench::new(&["sim:tmcl?axes=3&time=virtual#1"]);
    let mut events = fixture.bench.subscribe_events();
    let view = fixture.run_scan(0, 1, 6);
    assert_eq!((view.state, view.unasked), (ScanState::Done, 0), "{view:?}");
    assert_eq!(found(&view), [("tmcl", 3), ("tmcl", 4)], "{view:?}");
    assert!(view.found[0].drive.contains("TMCM-171"), "{view:?}");
    assert!(view.found.iter().all(|one| one.clash.is_none() && one.axis.is_none()), "{view:?}");
    assert_eq!((view.axes.len(), view.axes[0].answers), (1, true));
    assert!(view.tried.iter().any(|text| text.contains("addresses 1 to 6")), "{view:?}");
    let report = std::iter::from_fn(|| events.try_recv().ok());
    let reported = report.filter(|event| matches!(event, BenchEvent::Scan(_))).count();
    assert!(reported >= 3, "beginning, progress and end are told: {reported}");
    assert_eq!(fixture.numbers(), [1], "nothing is taken in unasked");
    let four = AddDrives { drives: vec![DriveAddress { protocol: "tmcl".into(), number: 4 }] };
    assert_eq!(fixture.hear(fixture.bench.add_drives(0, &fixture.ann, &four)).unwrap().axes, [1]);
    let twice = fixture.hear(fixture.bench.add_drives(0, &fixture.ann, &four)).unwrap_err();
    assert_eq!(twice.code, "gateway.look", "{twice}");
    assert_eq!(
        fixture
            .hear(fixture.bench.add_drives(0, &fixture.ann, &AddDrives::default()))
            .unwrap()
            .axes,
        [2]
    );
    assert_eq!(fixture.numbers(), [1, 4, 3]);
    let view = fixture.bench.scan_view(0).unwrap();
    assert_eq!(view.found.iter().map(|one| one.axis).collect::<Vec<_>>(), [Some(2), Some(1)]);
    for axis in [1, 0, 2] {
        fixture.turn(axis);
        assert!(fixture.samples(axis) >= 15, "axis {axis}");
    }
    let again = fixture.run_scan(0, 1, 6);
    assert_eq!((found(&again), again.axes.len()), (vec![], 3), "{again:?}");
}

#[test]
fn modbus_drives_are_found_and_taken_in() {
    let fixture = TestBench::new(&["sim:modbus-rtu?axes=3&time=virtual#2"]);
    let view = fixture.run_scan(0, 1, 4);
    assert_eq!(found(&view), [("modbus-rtu", 1), ("modbus-rtu", 3)], "{view:?}");
    assert_eq!(
        fixture
            .hear(fixture.bench.add_drives(0, &fixture.ann, &AddDrives::default()))
            .unwrap()
            .axes,
        [1, 2]
    );
    for axis in 0..3 {
        assert!(fixture.samples(axis) >= 10, "axis {axis}");
    }
    let epoch = fixture.acquire_lease(2).unwrap();
    fixture.drop(2, epoch);
}

#[test]
fn a_bus_of_several_protocols_gets_axes_of_each() {
    let url = format!("sim:{BUS}?time=virtual#spindle,port");
    let mut fixture = TestBench::new(&[&url]);
    let request = ScanRequest::default();
    fixture.hear(fixture.bench.start_scan(0, &fixture.ann, request)).unwrap();
    let view = fixture.ended(0);
    assert_eq!(view.state, ScanState::Done, "{view:?}");
    let there = [("technocan", 5), ("technocan", 7), ("thruster", 12)];
    assert_eq!(found(&view), there, "{view:?}");
    assert!(view.axes.iter().all(|one| one.answers), "{view:?}");
    assert_eq!(
        fixture
            .hear(fixture.bench.add_drives(0, &fixture.ann, &AddDrives::default()))
            .unwrap()
            .axes,
        [2, 3, 4]
    );
    let names: Vec<String> = fixture.bench.snapshot().axes.into_iter().map(|a| a.name).collect();
    assert_eq!(names, ["spindle", "port", "x", "y", "starboard"], "a rack's names hold");
    fixture.bench.advance_time(2000 * MS);
    for axis in [0, 2, 3] {
        fixture.turn(axis);
    }
    assert!(fixture.samples(0) > 0 && fixture.samples(3) > 0);
}

#[test]
fn a_search_is_refused_during_motion_and_during_another_and_excludes_commands() {
    let other = "sim:tmcl?time=virtual";
    let mut fixture = TestBench::new(&["sim:tmcl?axes=3&time=virtual#1", other]);
    let refused = |fixture: &TestBench| {
        let error = fixture.begin(0, 1, 200).unwrap_err();
        assert_eq!(error.code, "gateway.look", "{error}");
        error.message
    };
    let epoch = fixture.acquire_lease(0).unwrap();
    assert!(refused(&fixture).contains("ann commands"));
    fixture.run_command(0, epoch, "arm", None);
    fixture.run_command(0, epoch, "velocity", Some(10.0));
    fixture.hear(fixture.bench.request_lease(0, &fixture.ann, LeaseAction::Renew, epoch)).unwrap();
    drop(
        fixture
            .bench
            .stop(&fixture.ann, &StopRequest { axes: Some(vec![0]), ..StopRequest::default() }),
    );
    assert!(refused(&fixture).contains("being stopped"));
    fixture.bench.advance_time(12_000 * MS);
    fixture.begin(0, 1, 200).unwrap();
    assert!(fixture.begin(1, 1, 9).unwrap_err().message.contains("already"));
    let commands = fixture.acquire_lease(0).unwrap_err();
    assert_eq!(commands.code, "gateway.look", "{commands}");
    let epoch = fixture.acquire_lease(1).expect("the other link is free");
    fixture.drop(1, epoch);
    assert_eq!(fixture.bench.scan_view(0).unwrap().state, ScanState::UnderWay);
    fixture.bench.cancel_scan(0, &fixture.ann).unwrap();
    let view = fixture.ended(0);
    assert_eq!(view.state, ScanState::BrokenOff);
    assert!(view.unasked > 0 && !view.found.is_empty(), "{view:?}");
    assert_eq!(fixture.bench.cancel_scan(0, &fixture.ann).unwrap_err().code, "gateway.missing");
    fixture.turn(0);
    let wrong = ScanRequest { first: Some(9), last: Some(1) };
    let wrong = fixture.hear(fixture.bench.start_scan(0, &fixture.ann, wrong)).unwrap_err();
    assert_eq!(wrong.code, "gateway.request");
    assert_eq!(fixture.bench.scan_view(7).unwrap_err().code, "gateway.missing");
}

#[test]
fn a_canopen_device_without_node_id_is_reported() {
    let rack = std::env::temp_dir().join(format!("polepair-unconfigured-{}.toml", process::id()));
    let drive = "[[link.drive]]\nprofile = \"canopen\"\n";
    let text = format!("[[link]]\n{drive}address = 3\n{drive}address = 4\n");
    fs::write(&rack, text.clone() + "options = { node = \"none\" }\n").expect("written");
    let mut reports = Vec::new();
    for other_answers in [false, true] {
        if other_answers {
            fs::write(&rack, &text).expect("written");
        }
        let fixture = TestBench::new(&[&format!("sim:{}?time=virtual#3", rack.display())]);
        let scan = ScanRequest::default();
        fixture.hear(fixture.bench.start_scan(0, &fixture.ann, scan)).unwrap();
        let view = fixture.ended(0);
        reports.push((view.has_unconfigured, view.found.len()));
    }
    fs::remove_file(rack).expect("removed");
    assert_eq!(reports, [(true, 0), (false, 1)]);
}

#[test]
fn a_stop_breaks_a_look_off_and_waits_for_one_question_at_most() {
    for url in [
        "sim:tmcl?time=virtual",
        "sim:modbus-rtu?time=virtual",
        "sim:canopen?time=virtual",
        "sim:thruster?time=virtual",
    ] {
        let fixture = TestBench::new(&[url]);
        fixture.begin(0, 1, 120).unwrap();
        let (mut longest, mut last) = (0.0_f64, None);
        for _ in 0..3000 {
            let before = fixture.bench.now_ms();
            fixture.bench.advance_time(MS);
            let view = fixture.bench.scan_view(0).unwrap();
            if view.number != last {
                last = view.number;
                longest = longest.max(fixture.bench.now_ms() - before);
            }
            if view.done > 20 {
                break;
            }
        }
        let state = fixture.bench.scan_view(0).unwrap().state;
        if url.contains("canopen") && state != ScanState::UnderWay {
            continue;
        }
        assert_eq!(state, ScanState::UnderWay, "{url}");
        let started_at = fixture.bench.now_ms();
        let stop = fixture.bench.stop(&fixture.ann, &StopRequest::default());
        let stopped = fixture.hear(stop).unwrap();
        let took = fixture.bench.now_ms() - started_at;
        assert!(stopped.axes[0].error.is_none(), "{url}: {stopped:?}");
        println!("{url}: {took:.0} ms from a stop to its end; an address takes {longest:.0} ms");
        assert!(took <= longest + 200.0, "{url}: {took} ms, an address takes {longest} ms");
        assert_eq!(fixture.ended(0).state, ScanState::BrokenOff, "{url}");
        assert!(fixture.bench.snapshot().lock.is_some());
        let locked = fixture.begin(0, 1, 3).unwrap();
        assert_eq!(locked.state, ScanState::UnderWay, "looking moves nothing");
        assert_eq!(fixture.ended(0).state, ScanState::Done);
    }
}

#[test]
fn a_missing_drive_is_reported_and_a_clashing_one_is_not_adopted() {
    let fixture = TestBench::new(&["sim:tmcl?axes=3&time=virtual#1,3"]);
    let act = SimulationAction { act: "supply".into(), value: Some(0.0) };
    fixture.hear(fixture.bench.apply_action(&fixture.ann, 0, 1, &act)).unwrap();
    fixture.bench.advance_time(100 * MS);
    let view = fixture.run_scan(0, 1, 5);
    let answers: Vec<_> = view.axes.iter().map(|one| (one.axis, one.answers)).collect();
    assert_eq!(answers, [(0, true), (1, false)], "{view:?}");
    assert_eq!(found(&view), [("tmcl", 4)]);
    let file = std::env::temp_dir().join(format!("polepair-look-{}.toml", std::process::id()));
    let drive = |n: u32| format!("[[link.drive]]\nprofile = \"tmcm-171\"\naddress = {n}\n");
    let rack =
        format!("[[link]]\nname = \"l\"\nfaults = {{ duplicate = 1.0 }}\n{}{}", drive(1), drive(3));
    std::fs::write(&file, rack).unwrap();
    let doubled = TestBench::new(&[&format!("sim:{}?time=virtual#1", file.display())]);
    std::fs::remove_file(file).unwrap();
    let view = doubled.run_scan(0, 1, 4);
    assert_eq!(found(&view), [("tmcl", 3)], "{view:?}");
    let clash = view.found[0].clash.as_deref().unwrap_or_default();
    assert!(clash.contains("two drives with this address"), "{view:?}");
    let all =
        doubled.hear(doubled.bench.add_drives(0, &doubled.ann, &AddDrives::default())).unwrap();
    assert!(all.axes.is_empty(), "what is said to it may reach two");
    let three = AddDrives { drives: vec![DriveAddress { protocol: "tmcl".into(), number: 3 }] };
    let error = doubled.hear(doubled.bench.add_drives(0, &doubled.ann, &three)).unwrap_err();
    assert_eq!(error.code, "gateway.look", "{error}");
    let nobody = AddDrives { drives: vec![DriveAddress { protocol: "tmcl".into(), number: 9 }] };
    let error = doubled.hear(doubled.bench.add_drives(0, &doubled.ann, &nobody)).unwrap_err();
    assert_eq!(error.code, "gateway.missing", "{error}");
}

/// A journal that keeps each action with its client.
#[derive(Default)]
struct Notes(Mutex<Vec<(String, JournalAction)>>);

impl JournalSink for Notes {
    fn write_entry(&self, note: JournalEntry<'_>) -> Result<(), GatewayError> {
        self.0.lock().unwrap().push((note.who.to_owned(), note.action));
        Ok(())
    }
}

#[test]
fn searches_and_adoptions_are_journalled_with_their_client() {
    let notes = Arc::new(Notes::default());
    let options = BenchOptions { journal: notes.clone(), ..BenchOptions::default() };
    let fixture = TestBench::with(&["sim:tmcl?axes=2&time=virtual#1"], options);
    fixture.run_scan(0, 1, 4);
    let take = || {
        fixture.hear(fixture.bench.add_drives(0, &fixture.ann, &AddDrives::default())).unwrap().axes
    };
    assert_eq!(take(), [1]);
    assert!(take().is_empty(), "nothing is left, and no action follows");
    fixture.bench.advance_time(5 * MS);
    let ann = |action| ("ann", action);
    let expected = [
        ann(JournalAction::Look),
        ("server", JournalAction::Look),
        ann(JournalAction::TakeIn),
        ann(JournalAction::Outcome),
    ];
    let noted = notes.0.lock().unwrap();
    let noted: Vec<_> = noted.iter().map(|(who, action)| (&**who, *action)).collect();
    assert_eq!(noted, expected);
}

/// A bench in real time, with all threads.
#[test]
fn another_link_is_moved_and_watched_while_somebody_looks() {
    let mut fixture = TestBench::new(&["sim:tmcl?axes=3#1", "sim:tmcl"]);
    fixture.bench.advance_time(300 * MS);
    fixture.begin(0, 1, 250).unwrap();
    let mut channel = fixture.bench.subscribe(1, Some("velocity"), None, 50.0).unwrap();
    let epoch = fixture.acquire_lease(1).unwrap();
    fixture.run_command(1, epoch, "arm", None);
    fixture.run_command(1, epoch, "enable", None);
    let outcome = fixture.run_command(1, epoch, "velocity", Some(10.0));
    assert_eq!(outcome.outcome, OutcomeKind::Done, "{:?}", outcome.error);
    let mut samples = Vec::new();
    for _ in 0..20 {
        fixture
            .hear(fixture.bench.request_lease(1, &fixture.ann, LeaseAction::Renew, epoch))
            .unwrap();
        fixture.bench.advance_time(50 * MS);
        assert_eq!(channel.drain_into(&mut samples), None, "no gap");
    }
    assert!(fixture.bench.truth(1).expect("simulated").velocity > 5.0, "it turns all the time");
    assert!(samples.len() >= 10, "{} samples a second", samples.len());
    let view = fixture.bench.scan_view(0).unwrap();
    assert_eq!(view.state, ScanState::UnderWay, "{view:?}");
    let started_at = std::time::Instant::now();
    fixture.hear(fixture.bench.stop(&fixture.ann, &StopRequest::default())).unwrap();
    assert_eq!(fixture.ended(0).state, ScanState::BrokenOff);
    println!("stop to its end while somebody looks: {:?}", started_at.elapsed());
    let view = fixture.bench.scan_view(0).unwrap();
    assert_eq!(found(&view), [("tmcl", 3), ("tmcl", 4)]);
    assert_eq!(
        fixture
            .hear(fixture.bench.add_drives(0, &fixture.ann, &AddDrives::default()))
            .unwrap()
            .axes,
        [2, 3]
    );
    let mut channel = fixture.bench.subscribe(3, Some("position"), None, 20.0).unwrap();
    samples.clear();
    fixture.bench.advance_time(1000 * MS);
    assert_eq!(channel.drain_into(&mut samples), None);
    assert!(samples.len() >= 5, "{} samples a second", samples.len());
    fixture.bench.shutdown();
}
