//! A stop stays pending until the axis was measured at standstill: wires that are refused, dropped,
//! silent or half deaf while a motor turns.

mod proxy;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use polepair::simulate::{self, DriveLine};
use polepair_core::medium::Stream;
use polepair_drives::surroundings::GroundTruth;
use polepair_link::tcp::TcpServer;
use polepair_link::{ServeThread, clock};
use polepair_serve::bench::{
    Bench, BenchEvent, BenchOptions, JournalEntry, JournalSink, PendingReply, SessionName,
};
use polepair_serve::message::{
    AxisState, CommandArguments, CommandOutcome, CommandRequest, DismissReason, DismissStop,
    GatewayError, JournalAction, LeaseAction, LinkState, OutcomeKind, PendingStopView, StopCause,
    StopClass, StopRequest,
};
use polepair_test_support::{WAIT_MAX, wait_for, wait_until};
use proxy::{Mode, Proxy};
use serde_json::Value;

/// A motor below this speed is at standstill, rad/s: the limit that the drives' own stops use.
const STANDS: f64 = 0.6;

/// A journal that keeps its records in memory.
#[derive(Default)]
struct RecordedJournal(Mutex<Vec<(String, JournalAction, Value)>>);

impl JournalSink for RecordedJournal {
    fn write_entry(&self, note: JournalEntry<'_>) -> Result<(), GatewayError> {
        let record = (note.who.to_owned(), note.action, note.detail.clone());
        self.0.lock().unwrap().push(record);
        Ok(())
    }
}

impl RecordedJournal {
    fn of(&self, wanted: JournalAction) -> Vec<Value> {
        let records = self.0.lock().unwrap();
        records.iter().filter(|(_, action, _)| *action == wanted).map(|(.., d)| d.clone()).collect()
    }
}

/// A drive behind a proxy, and a bench of it.
struct Site {
    bench: Bench,
    proxy: Proxy,
    journal: Arc<RecordedJournal>,
    line: DriveLine,
    ids: u32,
    ann: SessionName,
    _served: ServeThread,
}

impl Site {
    fn new(word: &str, scheme: &str) -> Self {
        Self::with_pending_stop((word, scheme, "1"), |url, _, _| {
            // A TS from the factory obeys pulses: mode 1 is speed.
            if scheme == "modbus-rtu" {
                let link = polepair::connect_local(url).unwrap();
                let axis = &link.axes()[0];
                axis.arm(true);
                axis.set("control mode", "1").unwrap();
            }
            Vec::new()
        })
    }

    /// A site with an act on the drive, and a stop pending since then.
    fn with_pending_stop(
        (word, scheme, axes): (&str, &str, &str),
        before: impl FnOnce(&str, &DriveLine, &Proxy) -> Vec<(String, u32)>,
    ) -> Self {
        let end = TcpServer::bind("127.0.0.1:0").unwrap();
        let proxy = Proxy::to(end.address());
        let description = simulate::rack_of_words(&[word], 1).unwrap();
        let line = simulate::drive_lines(&description, 1).unwrap().remove(0);
        let served = line.clone().serve::<Stream>(Box::new(end));
        let url = format!("{scheme}+tcp://{}#{axes}", proxy.address);
        let pending_before = before(&url, &line, &proxy);
        let stored = Arc::new(RecordedJournal::default());
        let options = BenchOptions {
            journal: stored.clone(),
            inherited_stops: pending_before,
            // The lease is not renewed here while something else is waited for.
            lease_duration: WAIT_MAX,
            ..BenchOptions::default()
        };
        let bench = Bench::open(&[url], options).unwrap();
        Self { bench, proxy, journal: stored, line, ids: 0, ann: "ann".into(), _served: served }
    }

    fn truth(&self) -> GroundTruth {
        truth(&self.line)
    }

    fn state(&self) -> AxisState {
        self.bench.axis_state(0).unwrap()
    }

    fn acquire_lease(&self) -> u64 {
        self.bench
            .request_lease(0, &self.ann, LeaseAction::Take, 0)
            .wait()
            .unwrap()
            .expect("a lease")
            .epoch
    }

    fn start(
        &mut self,
        epoch: u64,
        verb: &str,
        velocity: Option<f64>,
    ) -> PendingReply<CommandOutcome> {
        self.ids += 1;
        let request = CommandRequest {
            id: format!("id-{}", self.ids),
            issued_ms: self.bench.now_ms(),
            ttl_ms: 10_000.0,
            epoch,
            verb: verb.into(),
            arguments: CommandArguments { velocity, ..CommandArguments::default() },
        };
        self.bench.command(0, &self.ann, request)
    }

    fn say(&mut self, epoch: u64, verb: &str, velocity: Option<f64>) -> Result<(), GatewayError> {
        let outcome = self.start(epoch, verb, velocity).wait().unwrap();
        match outcome.outcome {
            OutcomeKind::Done => Ok(()),
            _ => Err(outcome.error.expect("why not")),
        }
    }

    /// Turns the motor, and returns the epoch of the lease that it turns under.
    fn spin(&mut self) -> u64 {
        let epoch = self.acquire_lease();
        let mut verbs = vec![("arm", None), ("enable", None), ("velocity", Some(20.0))];
        let info = &self.bench.snapshot().axes[0];
        verbs.retain(|(verb, _)| info.verbs.iter().any(|known| known.verb == *verb));
        for (verb, velocity) in verbs {
            // A busy machine may reply too late, and a command is not repeated by the server.
            wait_for(verb, || self.say(epoch, verb, velocity).map_err(|error| error.to_string()));
        }
        wait_until("it turns", || self.truth().velocity.abs() > 10.0);
        epoch
    }

    /// Waits until it has such a pending stop.
    fn wait_pending_stop(
        &self,
        what: &str,
        is_so: impl Fn(&PendingStopView) -> bool,
    ) -> PendingStopView {
        let mut seen = None;
        wait_until(what, || {
            seen = self.state().pending_stop.filter(&is_so);
            seen.is_some()
        });
        seen.unwrap()
    }

    /// Waits until no stop is pending, and returns whether it was at standstill then: the alarm ends with it.
    fn wait_stop_resolved(&self) {
        wait_until("the stop is no longer pending", || self.state().pending_stop.is_none());
        assert!(self.truth().velocity.abs() < STANDS, "{:?}", self.truth());
    }

    fn is_lost(&self) -> bool {
        self.bench.snapshot().links[0].state == LinkState::Lost
    }

    /// Each debt that was written down was ended, so.
    fn ended(&self, how: &str) {
        wait_until("the journal has it", || {
            self.journal.of(JournalAction::StopEnded).len()
                == self.journal.of(JournalAction::StopPending).len()
        });
        let ended = self.journal.of(JournalAction::StopEnded);
        assert_eq!(ended.last().map(|detail| &detail["how"]), Some(&Value::from(how)), "{ended:?}");
    }
}

fn truth(line: &DriveLine) -> GroundTruth {
    truth_of(line, 0)
}

fn truth_of(line: &DriveLine, drive: usize) -> GroundTruth {
    line.with_bench(drive, |bench| bench.ground_truth(clock::now())).expect("it has a motor")
}

/// Has every motor of a line turn, by a program that then goes.
fn turn_all(url: &str, line: &DriveLine) {
    let link = polepair::connect_local(url).unwrap();
    for (drive, axis) in link.axes().iter().enumerate() {
        axis.arm(true);
        axis.velocity("20 rad/s").unwrap();
        wait_until("it turns", || truth_of(line, drive).velocity.abs() > 10.0);
    }
}

const KINDS: [(&str, &str); 2] = [("tmcl:1", "tmcl"), ("modbus-rtu:1", "modbus-rtu")];

#[test]
fn a_stop_while_the_port_is_refused_is_sent_once_it_is_open() {
    for (word, scheme) in KINDS {
        let mut site = Site::new(word, scheme);
        site.spin();
        site.proxy.set(Mode::Refuse);
        wait_until("the link is lost", || site.is_lost());
        site.wait_pending_stop("its stop is pending", |pending| pending.why == StopCause::LinkLost);
        let stopped = site.bench.stop(&"bob".into(), &StopRequest::default()).wait().unwrap();
        assert_eq!(stopped.axes[0].class, StopClass::Pending, "{stopped:?}");
        assert!(stopped.axes[0].error.is_some(), "why it did not arrive: {stopped:?}");
        assert!(site.state().pending_stop.is_some() && site.truth().velocity.abs() > 10.0);
        site.proxy.set(Mode::Pass);
        site.wait_stop_resolved();
        site.ended("standing");
    }
}

#[test]
fn a_stop_outlives_a_port_that_takes_connections_and_drops_them() {
    for (word, scheme) in KINDS {
        let mut site = Site::new(word, scheme);
        site.spin();
        let before = site.proxy.taken();
        site.proxy.set(Mode::Drop);
        wait_until("it was dropped often", || site.proxy.taken() >= before + 4);
        drop(site.bench.stop(&"bob".into(), &StopRequest::default()));
        wait_until("it was dropped again", || site.proxy.taken() >= before + 8);
        site.wait_pending_stop("its stop is pending", |_| true);
        assert!(site.truth().velocity.abs() > 10.0);
        site.proxy.set(Mode::Pass);
        site.wait_stop_resolved();
        site.ended("standing");
    }
}

#[test]
fn a_stop_into_silence_is_repeated_until_standstill_and_not_confirmed_before() {
    for (word, scheme) in KINDS {
        let mut site = Site::new(word, scheme);
        site.spin();
        let mut events = site.bench.subscribe_events();
        site.proxy.set(Mode::Silent);
        let lost = site.proxy.lost();
        // The client is gone without a stop.
        site.bench.end_session(&site.ann);
        site.wait_pending_stop("it was said again", |pending| {
            pending.attempts >= 3 && pending.error.is_some()
        });
        assert!(site.proxy.lost() > lost && site.truth().velocity.abs() > 10.0);
        while let Ok(event) = events.try_recv() {
            let BenchEvent::Stopped(stopped) = event else { continue };
            assert!(stopped.class <= StopClass::Sent, "{stopped:?}");
        }
        site.proxy.set(Mode::Pass);
        site.wait_stop_resolved();
        site.ended("standing");
    }
}

/// Returns whether a frame writes the speed, which is the last write of a TS' stop.
fn is_first_of_a_stop(frame: &[u8]) -> bool {
    // Fn_33, the speed: Modbus function 06 or 16.
    matches!(frame.get(1), Some(6 | 16)) && frame.get(2..4) == Some(&[0x00, 0x33])
}

#[test]
fn a_stop_with_only_its_last_step_answered_is_pending() {
    let mut site = Site::new("modbus-rtu:1", "modbus-rtu");
    site.spin();
    site.proxy.set(Mode::Lose(is_first_of_a_stop));
    drop(site.bench.stop(&"bob".into(), &StopRequest::default()));
    site.wait_pending_stop("it was said again", |pending| {
        pending.attempts >= 2 && pending.class <= StopClass::Sent
    });
    assert!(site.truth().velocity.abs() > 10.0, "what stops it in speed mode was lost");
    site.proxy.set(Mode::Pass);
    site.wait_stop_resolved();
    site.ended("standing");
}

/// A stop by the holder of the lease on a silent wire is repeated too, and the client is notified when the motor
/// is at standstill.
#[test]
fn a_stop_under_a_lease_is_repeated_until_standstill() {
    for (word, scheme) in KINDS {
        let mut site = Site::new(word, scheme);
        let epoch = site.spin();
        // One that is obeyed at once is no alarm, and what its holder has it do next is done.
        site.say(epoch, "stop", None).unwrap();
        assert!(site.truth().velocity.abs() < STANDS, "{:?}", site.truth());
        site.ended("standing");
        site.say(epoch, "velocity", Some(20.0)).unwrap();
        wait_until("it turns", || site.truth().velocity.abs() > 10.0);
        site.proxy.set(Mode::Silent);
        let stop = site.start(epoch, "stop", None);
        site.wait_pending_stop("it was said again", |pending| {
            pending.attempts >= 2 && pending.error.is_some()
        });
        assert!(site.truth().velocity.abs() > 10.0);
        site.proxy.set(Mode::Pass);
        let outcome = stop.wait().unwrap();
        assert_eq!(outcome.outcome, OutcomeKind::Done, "{outcome:?}");
        site.wait_stop_resolved();
        site.ended("standing");
    }
}

#[test]
fn an_axis_with_a_pending_stop_moves_only_when_its_holder_takes_it_over_knowingly() {
    let mut site = Site::new("tmcl:1", "tmcl");
    site.spin();
    site.proxy.set(Mode::Silent);
    drop(
        site.bench.stop(&site.ann, &StopRequest { axes: Some(vec![0]), ..StopRequest::default() }),
    );
    site.wait_pending_stop("its stop is pending", |pending| pending.error.is_some());
    let epoch = site.acquire_lease();
    assert_eq!(site.say(epoch, "arm", None).unwrap_err().code, "gateway.pending");
    let dismiss = |reason, epoch| DismissStop { reason, epoch, note: "seen".into() };
    let unheld = dismiss(DismissReason::TakenOver, epoch + 1);
    let refused = site.bench.dismiss(0, &site.ann, unheld).wait().unwrap_err();
    assert_eq!(refused.code, "gateway.lease");
    assert!(site.state().pending_stop.is_some());
    site.bench.dismiss(0, &site.ann, dismiss(DismissReason::TakenOver, epoch)).wait().unwrap();
    assert!(site.state().pending_stop.is_none());
    site.say(epoch, "arm", None).unwrap();
    site.ended("dismissed");
    // Anybody may know that the drive is gone.
    drop(
        site.bench.stop(&site.ann, &StopRequest { axes: Some(vec![0]), ..StopRequest::default() }),
    );
    site.wait_pending_stop("its stop is pending", |_| true);
    let gone = dismiss(DismissReason::DriveGone, 0);
    site.bench.dismiss(0, &"bob".into(), gone).wait().unwrap();
    assert!(site.state().pending_stop.is_none());
    let ended = site.journal.of(JournalAction::StopEnded);
    assert_eq!(ended.last().unwrap()["reason"], "drive_gone", "{ended:?}");
}

#[test]
fn a_pending_stop_of_the_previous_server_is_sent_by_the_next() {
    let site = Site::with_pending_stop(("tmcl:1", "tmcl", "1"), |url, line, _| {
        turn_all(url, line);
        vec![(url.to_owned(), 1)]
    });
    site.wait_stop_resolved();
    assert_eq!(site.journal.of(JournalAction::StopPending).len(), 0, "it was written down already");
    wait_until("the journal has it", || site.journal.of(JournalAction::StopEnded).len() == 1);
}

#[test]
fn an_axis_that_was_not_there_is_stopped_when_it_answers_though_the_others_turn() {
    let is_for_3: fn(&[u8]) -> bool = |frame| frame.first() == Some(&3);
    let site = Site::with_pending_stop(("tmcl:1,3", "tmcl", "1,3"), |url, line, proxy| {
        turn_all(url, line);
        proxy.set(Mode::Lose(is_for_3));
        vec![(url.to_owned(), 3)]
    });
    let link = || site.bench.snapshot().links[0].clone();
    assert_eq!((link().absent[0].number, &*link().pending_stops), (3, &[3][..]));
    let lost = site.proxy.lost();
    wait_until("it is asked for again", || site.proxy.lost() > lost);
    site.proxy.set(Mode::Pass);
    wait_until("it joins", || link().absent.is_empty());
    wait_until("its debt ends", || {
        site.bench.axis_state(1).is_ok_and(|state| state.pending_stop.is_none())
    });
    let turns = |drive| truth_of(&site.line, drive).velocity.abs();
    assert!(turns(1) < STANDS, "{}", turns(1));
    assert!(turns(0) > 10.0, "nobody said that this one is to stop: {}", turns(0));
    assert!(link().pending_stops.is_empty());
    assert_eq!(site.journal.of(JournalAction::TakeIn).len(), 1);
    wait_until("the journal has it", || site.journal.of(JournalAction::StopEnded).len() == 1);
}

#[test]
fn an_axis_without_a_pending_stop_joins_once_the_others_are_at_rest() {
    let is_for_3: fn(&[u8]) -> bool = |frame| frame.first() == Some(&3);
    let mut site = Site::with_pending_stop(("tmcl:1,3", "tmcl", "1,3"), |_, _, proxy| {
        proxy.set(Mode::Lose(is_for_3));
        Vec::new()
    });
    let epoch = site.spin();
    site.proxy.set(Mode::Pass);
    std::thread::sleep(Duration::from_secs(5));
    assert_eq!(site.bench.snapshot().axes.len(), 1, "a look would delay who commands axis 1");
    site.bench.stop(&"bob".into(), &StopRequest::default()).wait().expect("it is answered");
    site.wait_stop_resolved();
    // Its holder gives it back.
    let _ = site.bench.request_lease(0, &site.ann, LeaseAction::Drop, epoch).wait();
    wait_until("it joins", || {
        let bench = site.bench.snapshot();
        bench.axes.len() == 2 && bench.links[0].absent.is_empty()
    });
    assert_eq!(site.bench.snapshot().axes[1].number, 3);
}

#[test]
fn a_server_that_ends_names_who_was_not_seen_standing() {
    let mut site = Site::new("tmcl:1", "tmcl");
    site.spin();
    site.proxy.set(Mode::Silent);
    let left = site.bench.shutdown();
    assert!(left.len() == 1 && left[0].contains("tmcl+tcp://"), "{left:?}");
    wait_until("the journal has it", || {
        let outcomes = site.journal.of(JournalAction::Outcome);
        outcomes.iter().any(|detail| detail["class"] == "pending")
    });
    assert_eq!(site.journal.of(JournalAction::StopEnded).len(), 0, "the next server owes it");
}
