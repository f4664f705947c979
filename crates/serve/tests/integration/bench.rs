//! A bench without HTTP: leases, commands and stops on simulated drives in virtual time.

use crate::patience;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use patience::{MS, heard, order};
use polepair_link::clock;
use polepair_serve::bench::{
    Bench, BenchOptions, JournalEntry, JournalSink, PendingReply, SessionName,
};
use polepair_serve::message::{
    CommandOutcome, CommandRequest, GatewayError, JournalAction, LeaseAction, OutcomeKind,
    ParameterInput, RecordDriveLog, SetWatchdog, StopClass, StopRequest, WatchdogMode,
    WriteParameters,
};
use polepair_test_support::WAIT_MAX;

/// A bench of simulated drives in virtual time, and a client.
struct TestBench {
    bench: Bench,
    ids: u32,
}

impl TestBench {
    fn new(url: &str) -> Self {
        Self { bench: Bench::open(&[url.into()], BenchOptions::default()).unwrap(), ids: 0 }
    }

    /// Waits for an answer in virtual time.
    fn hear<T>(&self, reply: PendingReply<T>) -> Result<T, GatewayError> {
        heard(&self.bench, reply)
    }

    fn acquire_lease(&self, who: &SessionName, axis: u16) -> u64 {
        let lease = self.bench.request_lease(axis, who, LeaseAction::Take, 0);
        self.hear(lease).unwrap().expect("a lease").epoch
    }

    fn order(&mut self, epoch: u64, verb: &str, velocity: Option<f64>) -> CommandRequest {
        self.ids += 1;
        order(&self.bench, self.ids, epoch, verb, velocity)
    }

    fn run_command(
        &mut self,
        who: &SessionName,
        epoch: u64,
        verb: &str,
        velocity: Option<f64>,
    ) -> CommandOutcome {
        let request = self.order(epoch, verb, velocity);
        self.hear(self.bench.command(0, who, request)).unwrap()
    }

    /// Arms, powers and turns axis 0.
    fn spin(&mut self, who: &SessionName) -> u64 {
        let epoch = self.acquire_lease(who, 0);
        for (verb, velocity) in [("arm", None), ("enable", None), ("velocity", Some(10.0))] {
            if verb == "enable" && !self.can(verb) {
                continue;
            }
            let outcome = self.run_command(who, epoch, verb, velocity);
            assert_eq!(outcome.outcome, OutcomeKind::Done, "{verb}: {:?}", outcome.error);
            self.renew_lease(who, epoch);
        }
        epoch
    }

    fn renew_lease(&self, who: &SessionName, epoch: u64) {
        self.hear(self.bench.request_lease(0, who, LeaseAction::Renew, epoch)).unwrap();
    }

    fn can(&self, verb: &str) -> bool {
        let info = &self.bench.snapshot().axes[0];
        info.verbs.iter().any(|known| known.verb == verb)
    }

    /// The motor's true speed, whatever its drive reports.
    fn speed(&self) -> f64 {
        let truth = self.bench.truth(0).expect("a simulated drive");
        truth.velocity.abs()
    }
}

fn code(outcome: &CommandOutcome) -> &str {
    outcome.error.as_ref().map_or("", |error| &*error.code)
}

#[test]
fn a_motor_turns_for_as_long_as_its_lease_is_renewed() {
    let ann: SessionName = "ann".into();
    let mut fixture = TestBench::new("sim:tmcl?time=virtual");
    let epoch = fixture.spin(&ann);
    for _ in 0..10 {
        fixture.bench.advance_time(300 * MS);
        fixture.renew_lease(&ann, epoch);
    }
    assert!(fixture.speed() > 5.0, "{}", fixture.speed());
    fixture.bench.advance_time(3000 * MS);
    assert!(fixture.speed() < 0.1, "the lease was its dead man's switch: {}", fixture.speed());
    let late = fixture.run_command(&ann, epoch, "velocity", Some(5.0));
    assert_eq!((late.outcome, code(&late)), (OutcomeKind::NotDone, "gateway.lease"));
    let epoch = fixture.acquire_lease(&ann, 0);
    let unarmed = fixture.run_command(&ann, epoch, "velocity", Some(5.0));
    assert_eq!(code(&unarmed), "E219", "nothing moves again without being armed");
}

#[test]
fn a_command_is_carried_out_once_and_while_it_is_fresh() {
    let ann: SessionName = "ann".into();
    let mut fixture = TestBench::new("sim:tmcl?time=virtual");
    let epoch = fixture.spin(&ann);
    let request = fixture.order(epoch, "velocity", Some(20.0));
    let first = fixture.hear(fixture.bench.command(0, &ann, request.clone())).unwrap();
    let starts = fixture.bench.truth(0).unwrap().starts;
    fixture.renew_lease(&ann, epoch);
    let again = fixture.hear(fixture.bench.command(0, &ann, request)).unwrap();
    assert_eq!(again, CommandOutcome { replayed: true, ..first });
    assert_eq!(fixture.bench.truth(0).unwrap().starts, starts, "nothing was sent");
    let old = fixture.order(epoch, "velocity", Some(30.0));
    for _ in 0..2 * clock::timeout_scale() {
        fixture.bench.advance_time(300 * MS);
        fixture.renew_lease(&ann, epoch);
    }
    let old = fixture.hear(fixture.bench.command(0, &ann, old)).unwrap();
    assert_eq!((old.outcome, code(&old)), (OutcomeKind::NotDone, "gateway.expired"));
    let error = old.error.as_ref().expect("an error");
    assert!(error.hint.starts_with("if the client's clock is behind"), "{error:?}");
    let now = fixture.bench.snapshot().server_ms;
    assert!(
        error.server_ms.is_some_and(|server_ms| server_ms > 0.0 && server_ms <= now),
        "{error:?}"
    );
    let mut early = fixture.order(epoch, "velocity", Some(30.0));
    early.issued_ms += 5000.0;
    let early = fixture.hear(fixture.bench.command(0, &ann, early)).unwrap();
    assert_eq!(code(&early), "gateway.expired");
    assert_eq!(fixture.bench.truth(0).unwrap().starts, starts);
}

#[test]
fn a_stop_of_everything_needs_no_lease_and_locks_motion_until_it_is_released() {
    let (ann, bob): (SessionName, SessionName) = ("ann".into(), "bob".into());
    let mut fixture = TestBench::new("sim:tmcl?time=virtual");
    fixture.spin(&ann);
    fixture.bench.advance_time(300 * MS);
    let stopped = fixture.hear(fixture.bench.stop(&bob, &StopRequest::default())).unwrap();
    assert_eq!(stopped.axes[0].class, StopClass::Standing, "{stopped:?}");
    assert!(fixture.speed() < 0.1);
    assert!(fixture.bench.axis_state(0).unwrap().lease.is_none(), "a stop revokes the lease");
    assert_eq!(fixture.bench.snapshot().lock.expect("locked").by, "bob");
    let epoch = fixture.acquire_lease(&ann, 0);
    assert_eq!(code(&fixture.run_command(&ann, epoch, "arm", None)), "gateway.locked");
    assert_eq!(code(&fixture.run_command(&ann, epoch, "velocity", Some(9.0))), "gateway.locked");
    let before = fixture.bench.lock_count();
    fixture.hear(fixture.bench.stop(&bob, &StopRequest::default())).unwrap();
    let late = fixture.hear(fixture.bench.release(&ann, before)).unwrap_err();
    assert_eq!(late.code, "gateway.expired", "ann knows nothing of the second stop");
    assert!(fixture.bench.snapshot().lock.is_some());
    fixture.hear(fixture.bench.release(&bob, fixture.bench.lock_count())).unwrap();
    let epoch = fixture.acquire_lease(&ann, 0);
    assert_eq!(fixture.run_command(&ann, epoch, "arm", None).outcome, OutcomeKind::Done);
    assert_eq!(fixture.run_command(&ann, epoch, "velocity", Some(9.0)).outcome, OutcomeKind::Done);
}

#[test]
fn taking_over_stops_and_disarms_what_the_first_owner_moved() {
    let (ann, bob): (SessionName, SessionName) = ("ann".into(), "bob".into());
    let mut fixture = TestBench::new("sim:tmcl?time=virtual");
    let old = fixture.spin(&ann);
    let refused =
        fixture.hear(fixture.bench.request_lease(0, &bob, LeaseAction::Take, 0)).unwrap_err();
    assert_eq!(refused.code, "gateway.lease");
    let grant = fixture
        .hear(fixture.bench.request_lease(0, &bob, LeaseAction::TakeOver, 0))
        .unwrap()
        .unwrap();
    assert_eq!(grant.epoch, old + 1);
    assert_eq!(code(&fixture.run_command(&ann, old, "velocity", Some(9.0))), "gateway.lease");
    fixture.bench.advance_time(1000 * MS);
    assert!(fixture.speed() < 0.1 && !fixture.bench.axis_state(0).unwrap().armed);
}

#[test]
fn closing_and_a_client_that_goes_stop_what_moves() {
    for how in ["gone", "closing", "given back"] {
        let ann: SessionName = "ann".into();
        let mut fixture = TestBench::new("sim:tmcl?time=virtual");
        let epoch = fixture.spin(&ann);
        fixture.bench.advance_time(300 * MS);
        assert!(fixture.speed() > 5.0);
        match how {
            "gone" => fixture.bench.end_session(&ann),
            "closing" => assert!(fixture.bench.shutdown().is_empty()),
            _ => drop(
                fixture
                    .hear(fixture.bench.request_lease(0, &ann, LeaseAction::Drop, epoch))
                    .unwrap(),
            ),
        }
        // Less than a lease lasts: it was not that which ended it.
        fixture.bench.advance_time(800 * MS);
        assert!(fixture.speed() < 0.1, "{how}: {}", fixture.speed());
    }
}

#[test]
fn parameters_are_planned_written_under_a_lease_and_never_move() {
    let ann: SessionName = "ann".into();
    let fixture = TestBench::new("sim:tmcl?time=virtual");
    let one = |name: &str, text: &str| WriteParameters {
        values: [(name.to_owned(), ParameterInput::Text(text.into()))].into(),
        keep: false,
        dry_run: true,
        raw: false,
        epoch: 0,
    };
    let infos = fixture.bench.parameters(0).unwrap();
    let current = infos.iter().find(|info| info.name == "max current").expect("it has one");
    assert!(current.writable && !current.unit.is_empty());
    let before = fixture.hear(fixture.bench.read_parameter(0, "max current")).unwrap();
    let plan =
        fixture.hear(fixture.bench.write_parameters(0, &ann, one("max current", "0.5 A"))).unwrap();
    assert!(plan[0].changed && plan[0].from == before.value, "{plan:?}");
    let unleased = WriteParameters { dry_run: false, ..one("max current", "0.5 A") };
    let refused = fixture.hear(fixture.bench.write_parameters(0, &ann, unleased)).unwrap_err();
    assert_eq!(refused.code, "gateway.lease");
    let epoch = fixture.acquire_lease(&ann, 0);
    let write = WriteParameters { dry_run: false, epoch, ..one("max current", "0.5 A") };
    fixture.hear(fixture.bench.write_parameters(0, &ann, write)).unwrap();
    let after = fixture.hear(fixture.bench.read_parameter(0, "max current")).unwrap();
    assert_eq!(after.value, Some(plan[0].to));
    let too_much = fixture
        .hear(fixture.bench.write_parameters(0, &ann, one("max current", "500 A")))
        .unwrap_err();
    assert_eq!((&*too_much.code, too_much.executed), ("E216", Some(false)));
    let moves = infos.iter().find(|info| info.moves && info.readable).expect("it has one");
    let refused =
        fixture.hear(fixture.bench.write_parameters(0, &ann, one(&moves.name, "1"))).unwrap_err();
    assert_eq!(refused.code, "E219");
}

#[test]
fn a_drives_own_watchdog_is_set_under_a_lease_and_kept_by_the_journal() {
    let ann: SessionName = "ann".into();
    for (url, parameter) in [
        ("sim:tmcl?time=virtual", "serial heartbeat"),
        ("sim:cia402:5?heartbeat=100&time=virtual", "consumer heartbeat"),
    ] {
        let stored = Arc::new(Kept::default());
        let options = BenchOptions { journal: stored.clone(), ..BenchOptions::default() };
        let fixture = TestBench { bench: Bench::open(&[url.into()], options).unwrap(), ids: 0 };
        let half = |epoch| SetWatchdog { after_ms: Some(500.0), epoch };
        let watchdog = fixture.hear(fixture.bench.watchdog(0)).unwrap();
        assert_eq!((watchdog.set, watchdog.after_ms), (WatchdogMode::Off, None), "{watchdog:?}");
        assert_eq!(watchdog.parameter.as_deref(), Some(parameter));
        assert!(!watchdog.caution.is_empty() && !watchdog.rule.is_empty(), "{watchdog:?}");
        let refused = fixture.hear(fixture.bench.set_watchdog(0, &ann, half(0))).unwrap_err();
        assert_eq!(refused.code, "gateway.lease", "{url}");
        let epoch = fixture.acquire_lease(&ann, 0);
        let never = SetWatchdog { after_ms: Some(-1.0), epoch };
        assert_eq!(
            fixture.hear(fixture.bench.set_watchdog(0, &ann, never)).unwrap_err().code,
            "E217"
        );
        *stored.full.lock().unwrap() = true;
        let refused = fixture.hear(fixture.bench.set_watchdog(0, &ann, half(epoch))).unwrap_err();
        assert_eq!(refused.executed, Some(false), "{url}: {refused:?}");
        *stored.full.lock().unwrap() = false;
        let watchdog = fixture.hear(fixture.bench.watchdog(0)).unwrap();
        assert_eq!(
            watchdog.set,
            WatchdogMode::Off,
            "{url}: what the journal does not keep is not done"
        );
        let watchdog = fixture.hear(fixture.bench.set_watchdog(0, &ann, half(epoch))).unwrap();
        assert_eq!(
            (watchdog.set, watchdog.after_ms),
            (WatchdogMode::On, Some(500.0)),
            "{url}: {watchdog:?}"
        );
        let written = ("ann".to_owned(), JournalAction::Parameters);
        assert!(stored.notes.lock().unwrap().contains(&written), "{url}");
        assert_eq!(fixture.hear(fixture.bench.watchdog(0)).unwrap(), watchdog);
        let off = SetWatchdog { after_ms: None, epoch };
        let watchdog = fixture.hear(fixture.bench.set_watchdog(0, &ann, off)).unwrap();
        assert_eq!(watchdog.set, WatchdogMode::Off, "{url}: {watchdog:?}");
    }
    let fixture = TestBench::new("sim:modbus-rtu?time=virtual");
    let epoch = fixture.acquire_lease(&ann, 0);
    assert_eq!(fixture.hear(fixture.bench.watchdog(0)).unwrap().set, WatchdogMode::None);
    let half = SetWatchdog { after_ms: Some(500.0), epoch };
    let refused = fixture.hear(fixture.bench.set_watchdog(0, &ann, half)).unwrap_err();
    assert_eq!((&*refused.code, refused.executed), ("E218", Some(false)));
}

#[test]
fn a_drive_records_in_its_own_loop_under_a_lease() {
    let ann: SessionName = "ann".into();
    let fixture = TestBench::new("sim:tmlcan?time=virtual");
    let axes = &fixture.bench.snapshot().axes;
    let recorder = axes[0].drive_log.clone().expect("a recorder");
    assert_eq!(recorder.rates, [10_000.0, 5000.0, 2000.0, 1000.0, 500.0, 200.0, 100.0]);
    assert!(recorder.inferred && recorder.points > 300, "{recorder:?}");
    let wanted = |epoch| RecordDriveLog {
        variables: ["position", "target position", "POSERR"].map(str::to_owned).into(),
        rate: 1000.0,
        seconds: 0.05,
        inferred: true,
        command: None,
        afterwards: None,
        epoch,
    };
    let record = |wanted| {
        fixture
            .hear(fixture.bench.record_in_drive(0, &ann, wanted))
            .map_err(|e| e.code.into_owned())
    };
    assert_eq!(record(wanted(0)), Err("gateway.lease".to_owned()));
    let epoch = fixture.acquire_lease(&ann, 0);
    for (wrong, code) in [
        (RecordDriveLog { inferred: false, ..wanted(epoch) }, "E222"),
        (RecordDriveLog { rate: 0.0, ..wanted(epoch) }, "E216"),
        (RecordDriveLog { seconds: 60.0, ..wanted(epoch) }, "E216"),
        (RecordDriveLog { variables: vec!["no such".to_owned()], ..wanted(epoch) }, "E213"),
    ] {
        assert_eq!(record(wrong), Err(code.to_owned()));
    }
    let recorded = record(wanted(epoch)).unwrap();
    let names: Vec<&str> = recorded.variables.iter().map(|it| &*it.name).collect();
    assert_eq!(names, ["actual position", "target position", "position error"]);
    assert!(recorded.variables.iter().all(|it| it.values.len() == 50 && it.unit == "rad"));
    assert!((recorded.interval_s - 1e-3).abs() < 1e-9 && recorded.outcome.is_none());
    assert_eq!(TestBench::new("sim:tmcl?time=virtual").bench.snapshot().axes[0].drive_log, None);
}

/// A journal that keeps its records, or refuses them.
#[derive(Default)]
struct Kept {
    notes: Mutex<Vec<(String, JournalAction)>>,
    full: Mutex<bool>,
}

impl JournalSink for Kept {
    fn write_entry(&self, note: JournalEntry<'_>) -> Result<(), GatewayError> {
        self.notes.lock().unwrap().push((note.who.to_owned(), note.action));
        if *self.full.lock().unwrap() {
            Err(GatewayError::new("gateway.busy", "the disk is full"))
        } else {
            Ok(())
        }
    }
}

#[test]
fn a_command_without_a_journal_record_is_not_executed_except_a_stop() {
    let ann: SessionName = "ann".into();
    let stored = Arc::new(Kept::default());
    let options = BenchOptions { journal: stored.clone(), ..BenchOptions::default() };
    let bench = Bench::open(&["sim:tmcl?time=virtual".into()], options).unwrap();
    let mut fixture = TestBench { bench, ids: 0 };
    let epoch = fixture.spin(&ann);
    fixture.renew_lease(&ann, epoch);
    *stored.full.lock().unwrap() = true;
    let starts = fixture.bench.truth(0).unwrap().starts;
    let refused = fixture.run_command(&ann, epoch, "velocity", Some(20.0));
    assert_eq!(refused.outcome, OutcomeKind::NotDone);
    assert_eq!(fixture.bench.truth(0).unwrap().starts, starts);
    let stopped = fixture.hear(fixture.bench.stop(&ann, &StopRequest::default())).unwrap();
    assert_eq!(stopped.axes[0].class, StopClass::Standing);
    let error =
        fixture.hear(fixture.bench.request_lease(0, &ann, LeaseAction::Take, 0)).unwrap_err();
    assert_eq!((&*error.code, fixture.bench.axis_state(0).unwrap().lease), ("gateway.busy", None));
    *stored.full.lock().unwrap() = false;
    fixture.bench.advance_time(2000 * MS);
    let notes = stored.notes.lock().unwrap();
    let deeds: Vec<JournalAction> = notes.iter().map(|(_, action)| *action).collect();
    assert_eq!(deeds[..2], [JournalAction::Lease, JournalAction::Command]);
    assert_eq!(
        deeds.last(),
        Some(&JournalAction::Missing),
        "what it refused was done, and is told of"
    );
}

/// Clients that hold leases, lose touch, forget to renew, take over, stop and release, by seed.
struct Crowd {
    fixture: TestBench,
    random: u64,
    clients: Vec<Client>,
    /// Commands under way: who, under which epoch, when it was too old.
    replies: Vec<PendingReply<CommandOutcome>>,
    locked: bool,
}

struct Client {
    name: SessionName,
    epoch: u64,
    /// End of the client's silence, ms.
    away_until: f64,
    last: Option<CommandRequest>,
}

impl Crowd {
    fn new(seed: u64) -> Self {
        let fixture = TestBench::new(&format!("sim:tmcl?time=virtual&baud=0&seed={}", seed + 1));
        let count = 2 + seed % 7;
        let client = |n| Client {
            name: format!("client-{n}").into(),
            epoch: 0,
            away_until: 0.0,
            last: None,
        };
        let clients = (0..count).map(client).collect();
        let random = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        Self { fixture, random, clients, replies: Vec::new(), locked: false }
    }

    fn below(&mut self, max: u64) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random % max
    }

    /// One client does something.
    fn step(&mut self) {
        let (n, what) = (self.below(self.clients.len() as u64) as usize, self.below(100));
        let now = self.fixture.bench.now_ms();
        if self.clients[n].away_until > now {
            return;
        }
        let (who, epoch) = (self.clients[n].name.clone(), self.clients[n].epoch);
        match what {
            0..20 => self.lease(n, LeaseAction::Take),
            20..24 => self.lease(n, LeaseAction::TakeOver),
            24..50 => self.lease(n, LeaseAction::Renew),
            50..53 => self.lease(n, LeaseAction::Drop),
            53..63 => self.say(n, "arm", None, 0.0),
            63..84 => {
                let (speed, late) = (self.below(20) as f64, self.below(2000) as f64);
                self.say(n, "velocity", Some(speed), if late < 1400.0 { 0.0 } else { late });
            }
            84..89 => self.again(n),
            89..93 => self.clients[n].away_until = now + self.below(4000) as f64,
            93..95 => self.stop_all(&who),
            95..99 if self.locked => {
                let released = self.fixture.bench.release(&who, self.fixture.bench.lock_count());
                self.fixture.hear(released).unwrap();
                self.locked = false;
            }
            _ => drop(self.fixture.bench.request_lease(
                0,
                &who,
                LeaseAction::Renew,
                epoch.wrapping_sub(1),
            )),
        }
    }

    fn lease(&mut self, n: usize, act: LeaseAction) {
        let Client { name, epoch, .. } = &self.clients[n];
        let reply = self.fixture.bench.request_lease(0, name, act, *epoch);
        if let Ok(Some(lease)) = self.fixture.hear(reply) {
            self.clients[n].epoch = lease.epoch;
        }
    }

    /// Sends a command, perhaps one that was long on its way.
    fn say(&mut self, n: usize, verb: &str, velocity: Option<f64>, late_ms: f64) {
        let (who, epoch) = (self.clients[n].name.clone(), self.clients[n].epoch);
        let mut request = self.fixture.order(epoch, verb, velocity);
        request.issued_ms -= late_ms;
        self.clients[n].last = Some(request.clone());
        self.send(&who, request);
    }

    /// Sends the last command once more.
    fn again(&mut self, n: usize) {
        let Some(request) = self.clients[n].last.clone() else { return };
        let who = self.clients[n].name.clone();
        let starts = self.starts();
        let mut reply = self.fixture.bench.command(0, &who, request);
        if let Some(Ok(outcome)) = reply.try_recv() {
            assert!(outcome.replayed);
            assert_eq!(self.starts(), starts, "a command was carried out twice");
        }
    }

    fn send(&mut self, who: &SessionName, request: CommandRequest) {
        let now = self.fixture.bench.now_ms();
        let held = self.fixture.bench.axis_state(0).unwrap().lease;
        let its = held.is_some_and(|l| l.owner == **who && l.epoch == request.epoch);
        let ttl_ms = request.ttl_ms * f64::from(clock::timeout_scale());
        let fresh = now - request.issued_ms <= ttl_ms;
        let moves = request.verb == "velocity";
        let starts = self.starts();
        let reply = self.fixture.bench.command(0, who, request);
        if its && fresh && !self.locked {
            self.replies.push(reply);
            return;
        }
        let outcome = self.fixture.hear(reply).unwrap();
        assert_eq!(outcome.outcome, OutcomeKind::NotDone, "{outcome:?}");
        // Others' commands may be under way; without them nothing is sent.
        if moves && self.replies.is_empty() {
            assert_eq!(self.starts(), starts, "what was refused was sent");
        }
    }

    fn stop_all(&mut self, who: &SessionName) {
        let stopped =
            self.fixture.hear(self.fixture.bench.stop(who, &StopRequest::default())).unwrap();
        assert_eq!(stopped.axes[0].class, StopClass::Standing, "a stop lands: {stopped:?}");
        self.locked = true;
    }

    fn starts(&self) -> u64 {
        self.fixture.bench.truth(0).unwrap().starts
    }

    /// Checks the invariants that hold at any time.
    fn check(&mut self) {
        self.replies.retain_mut(|reply| reply.try_recv().is_none());
        if self.locked {
            assert!(self.fixture.speed() < 0.1, "it moves though everything was stopped");
        }
        let idle = self.clients.iter().all(|c| c.away_until > self.fixture.bench.now_ms() + 3500.0);
        if idle || self.fixture.bench.axis_state(0).unwrap().lease.is_none() {
            assert!(!self.fixture.bench.axis_state(0).unwrap().armed, "armed by nobody");
        }
    }
}

#[test]
fn whoever_loses_touch_nothing_moves_but_under_its_lease() {
    let seeds = std::env::var("POLEPAIR_SEEDS").ok().and_then(|n| n.parse().ok()).unwrap_or(300);
    for seed in 0..seeds {
        let mut crowd = Crowd::new(seed);
        for _ in 0..150 {
            crowd.step();
            let span = crowd.below(40) as u32;
            crowd.fixture.bench.advance_time(span * MS);
            crowd.check();
        }
        // All clients disconnect: after a lease and a ramp the motor is at standstill.
        crowd.fixture.bench.advance_time(5000 * MS);
        assert!(crowd.fixture.speed() < 0.1, "seed {seed}: {}", crowd.fixture.speed());
        assert!(!crowd.fixture.bench.axis_state(0).unwrap().armed, "seed {seed}");
    }
}

#[test]
fn frames_are_filtered_explained_and_counted_from_when_somebody_watches() {
    let fixture = TestBench::new("sim:tmcl?time=virtual");
    fixture.hear(fixture.bench.read_parameter(0, "max current")).unwrap();
    let mut all = fixture.bench.subscribe_frames(None).unwrap();
    let mut none = fixture.bench.subscribe_frames(Some("not ok")).unwrap();
    assert_eq!(fixture.bench.subscribe_frames(Some("axis =")).unwrap_err().code, "gateway.request");
    fixture.hear(fixture.bench.read_parameter(0, "max current")).unwrap();
    fixture.bench.advance_time(MS);
    let (items, lost) = all.drain(100);
    assert!(items.len() == 2 && lost == 0, "a question and its answer: {items:?}");
    assert!(items.iter().all(|item| item.ok && !item.text.is_empty() && item.axis == Some(1)));
    assert!(items[0].t_us <= items[1].t_us && items[0].n + 1 == items[1].n);
    let fields = fixture.bench.explain_frame(items[0].n).unwrap();
    assert!(fields.iter().any(|field| field.to > field.from && !field.name.is_empty()));
    assert_eq!(fixture.bench.explain_frame(99).unwrap_err().code, "gateway.missing");
    assert_eq!(none.drain(100), (vec![], 0));
}

#[test]
fn a_capture_is_summed_up_and_shown_page_by_page() {
    let fixture = TestBench::new("sim:tmcl?time=virtual");
    let mut log = String::new();
    for n in 0..3000 {
        log.push_str(&format!("(17000000{:02}.{:06}) can0 123#{n:04X}\n", n / 1000, n % 1000));
    }
    let opened = fixture.bench.open_capture("bus.log", log.into_bytes()).unwrap();
    assert_eq!((opened.page.total, opened.page.items.len()), (3000, 1000));
    assert!(opened.links == ["can0"] && opened.summary.contains("3000"), "{}", opened.summary);
    let page = |from, filter| fixture.bench.capture_page(&opened.id, from, 1000, filter).unwrap();
    let second = page(1000, None);
    assert_eq!((second.items[0].n, second.next), (1000, Some(2000)));
    assert_eq!(page(2000, None).next, None);
    assert_eq!(page(500, None).items[0].raw, "123#01F4");
    let found = page(0, Some("bytes ~ \"07 FF\""));
    assert_eq!(found.items.iter().map(|item| item.n).collect::<Vec<_>>(), [0x7FF]);
    let nothing = fixture.bench.open_capture("x", b"\0\0nonsense".to_vec()).unwrap_err();
    assert_eq!(nothing.code, "E510");
    assert_eq!(
        fixture.bench.capture_page("capture-9", 0, 1, None).unwrap_err().code,
        "gateway.missing"
    );
}

#[test]
fn a_drive_that_answers_twice_looks_like_two_with_one_address_and_is_reported() {
    let file = std::env::temp_dir().join(format!("polepair-clash-{}.toml", std::process::id()));
    let open = |faults: &str| {
        let drive = "[[link.drive]]\nprofile = \"tmcm-171\"\n";
        std::fs::write(&file, format!("[[link]]\nname = \"l\"\n{faults}\n{drive}")).unwrap();
        Bench::open(&[format!("sim:{}", file.display())], BenchOptions::default()).unwrap()
    };
    let alone = open("");
    let doubled = open("faults = { duplicate = 1.0 }");
    let end = std::time::Instant::now() + WAIT_MAX;
    let clashes = loop {
        let clashes = doubled.snapshot().clashes;
        if !clashes.is_empty() || std::time::Instant::now() > end {
            break clashes;
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    let output = clashes.first().map_or("", |clash| &clash.message);
    assert!(output.contains("two drives have one address"), "{:?}", doubled.snapshot().links);
    assert_eq!(alone.snapshot().clashes, []);
    std::fs::remove_file(file).unwrap();
}

#[test]
fn parameters_are_read_and_written_by_address() {
    let ann: SessionName = "ann".into();
    let fixture = TestBench::new("sim:canopen?time=virtual");
    let read = |name: &str| fixture.hear(fixture.bench.read_parameter(0, name));
    let vendor = read("0x1018:1").unwrap();
    assert_eq!((&*vendor.kind, vendor.raw, &*vendor.symbol), ("number", Some(65_535), "1018h:1"));
    let name = read("1008h").unwrap();
    assert_eq!((&*name.kind, name.raw, name.value), ("text", None, None));
    assert_eq!(name.text, "Polepair CiA 402 drive");
    assert_eq!(read("0x1018:300").unwrap_err().code, "E213");
    let one = |name: &str, epoch| WriteParameters {
        values: [(name.to_owned(), ParameterInput::Number(250.0))].into(),
        keep: false,
        dry_run: epoch == 0,
        raw: false,
        epoch,
    };
    let refused = fixture.bench.write_parameters(0, &ann, one("0x2F01:1:u32", 0));
    assert_eq!(fixture.hear(refused).unwrap_err().code, "E219");
    let epoch = fixture.acquire_lease(&ann, 0);
    let written = fixture.bench.write_parameters(0, &ann, one("0x1017:0:u16", epoch));
    assert!(fixture.hear(written).unwrap()[0].changed);
    assert_eq!(read("1017h").unwrap().raw, Some(250));
    let details = fixture.hear(fixture.bench.read_device(0)).unwrap();
    assert!(details.iter().any(|detail| detail.name == "software version"), "{details:?}");
}
