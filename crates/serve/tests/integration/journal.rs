//! A journal whose disk stalls: stops leave all the same, motion does not, and nothing is lost unsaid.

use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

use polepair_link::clock;
use polepair_serve::bench::{self, Bench, BenchOptions, JournalEntry, PendingReply, SessionName};
use polepair_serve::journal::{JournalFile, verify};
use polepair_serve::message::{
    CommandArguments, CommandOutcome, CommandRequest, GatewayError, LeaseAction, OutcomeKind,
    StopClass, StopRequest,
};
use polepair_test_support::WAIT_MAX;
use serde_json::Value;

/// A journal file on a disk that stalls on demand.
struct Disk {
    journal: JournalFile,
    stalls: Mutex<bool>,
    called: Condvar,
}

impl Disk {
    fn stall(&self, stalls: bool) {
        *self.stalls.lock().unwrap() = stalls;
        self.called.notify_all();
    }
}

impl bench::JournalSink for Disk {
    fn write_entry(&self, note: JournalEntry<'_>) -> Result<(), GatewayError> {
        drop(self.called.wait_while(self.stalls.lock().unwrap(), |stalls| *stalls).unwrap());
        self.journal.write(note.who, note.action, note.axis, note.detail).map(drop)
    }
}

/// A simulated drive that turns, in real time, under ann's lease.
struct Site {
    bench: Bench,
    disk: Arc<Disk>,
    file: PathBuf,
    ann: SessionName,
    epoch: u64,
    ids: u32,
}

impl Site {
    fn new(name: &str) -> Self {
        let file = format!("polepair-stalls-{name}-{}.jsonl", std::process::id());
        let file = std::env::temp_dir().join(file);
        let _ = std::fs::remove_file(&file);
        let (journal, _) = JournalFile::open(&file).unwrap();
        let disk = Disk { journal, stalls: Mutex::default(), called: Condvar::new() };
        let (disk, ann) = (Arc::new(disk), SessionName::from("ann"));
        // Long enough to outlive what is tried here.
        let lease = Duration::from_secs(60);
        let options = BenchOptions {
            journal: disk.clone(),
            lease_duration: lease,
            ..BenchOptions::default()
        };
        let bench = Bench::open(&["sim:tmcl?baud=115200".into()], options).unwrap();
        let epoch =
            bench.request_lease(0, &ann, LeaseAction::Take, 0).wait().unwrap().unwrap().epoch;
        let mut site = Self { bench, disk, file, ann, epoch, ids: 0 };
        for (verb, velocity) in [("arm", None), ("velocity", Some(10.0))] {
            let outcome = site.start_command(verb, velocity).wait().unwrap();
            assert_eq!(outcome.outcome, OutcomeKind::Done, "{verb}: {:?}", outcome.error);
        }
        site
    }

    fn start_command(&mut self, verb: &str, velocity: Option<f64>) -> PendingReply<CommandOutcome> {
        self.ids += 1;
        let request = CommandRequest {
            id: format!("id-{}", self.ids),
            issued_ms: self.bench.now_ms(),
            ttl_ms: 10_000.0,
            epoch: self.epoch,
            verb: verb.into(),
            arguments: CommandArguments { velocity, ..CommandArguments::default() },
        };
        self.bench.command(0, &self.ann, request)
    }

    fn stop(&self, reason: &str) {
        let request =
            StopRequest { axes: Some(vec![0]), reason: reason.into(), ..StopRequest::default() };
        let stopped = self.bench.stop(&"bob".into(), &request).wait().unwrap();
        assert_eq!(stopped.axes[0].class, StopClass::Standing, "{stopped:?}");
    }

    fn starts(&self) -> u64 {
        self.bench.truth(0).unwrap().starts
    }

    /// Ends it, and returns what was written, if that is whole.
    fn end(self) -> Vec<Value> {
        self.bench.shutdown();
        self.bench.close_journal().unwrap();
        let text = std::fs::read_to_string(&self.file).unwrap();
        let records: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        let verified = verify(&self.file).unwrap().unwrap();
        assert_eq!((verified.records, verified.truncated_bytes), (records.len() as u64, 0));
        std::fs::remove_file(&self.file).unwrap();
        records
    }
}

/// Stops whose notes are more than there is room for.
const MANY: u64 = 120;

fn code(outcome: &CommandOutcome) -> &str {
    outcome.error.as_ref().map_or("", |error| &*error.code)
}

fn pause(ms: u64) {
    clock::sleep_until(clock::now() + Duration::from_millis(ms));
}

#[test]
fn a_stop_waits_for_no_disk_and_what_cannot_be_written_is_counted() {
    let mut site = Site::new("counted");
    let starts = site.starts();
    site.disk.stall(true);
    let mut late = site.start_command("velocity", Some(20.0));
    site.stop("");
    assert!(site.bench.truth(0).unwrap().velocity.abs() < 0.1);
    assert!(late.try_recv().is_none() && site.starts() == starts, "not kept, not done");
    pause(1100);
    // Each is refused at once: a wait for the disk would never end.
    let refused = site.start_command("velocity", Some(20.0)).wait().unwrap();
    assert_eq!((refused.outcome, code(&refused)), (OutcomeKind::NotDone, "gateway.journal"));
    let error = site.bench.request_lease(0, &site.ann, LeaseAction::Take, 0).wait().unwrap_err();
    assert_eq!(error.code, "gateway.journal");
    let released = site.bench.release(&site.ann, site.bench.lock_count()).wait().unwrap_err();
    assert_eq!(released.code, "gateway.journal");
    // Only the beginning of a very long reason is kept.
    let reason = "\u{1F6D1}".repeat(50_000);
    (0..MANY).for_each(|_| site.stop(&reason));
    pause(1000);
    site.disk.stall(false);
    let late = late.wait().unwrap();
    assert_eq!((late.outcome, code(&late)), (OutcomeKind::NotDone, "gateway.journal"));
    assert_eq!(site.starts(), starts, "what was announced long ago is not done");
    // The queued records are written, and motion is allowed again.
    let end = Instant::now() + WAIT_MAX;
    site.epoch = loop {
        match site.bench.request_lease(0, &site.ann, LeaseAction::Take, 0).wait() {
            Ok(lease) => break lease.unwrap().epoch,
            Err(refused) => assert!(Instant::now() < end, "{refused:?}"),
        }
        pause(1);
    };
    assert_eq!(site.start_command("arm", None).wait().unwrap().outcome, OutcomeKind::Done);
    let records = site.end();
    let deeds = |action: &str| records.iter().filter(|r| r["deed"] == action).collect::<Vec<_>>();
    let missing: u64 =
        deeds("missing").iter().map(|r| r["detail"]["count"].as_u64().unwrap()).sum();
    let reported = |r: &&&Value| r["detail"].get("class").is_none();
    let (stops, outcomes) = (deeds("stop").len() as u64, deeds("outcome"));
    let classes = outcomes.iter().filter(|r| r["detail"].get("class").is_some()).count() as u64;
    assert!(missing > 0 && stops < MANY + 1, "{missing} {stops}");
    let longest =
        deeds("stop").iter().map(|r| r["detail"]["reason"].as_str().unwrap().chars().count()).max();
    assert_eq!(longest, Some(10_000));
    // Each stop has a record of its own, and one or more of how far it came.
    assert!(stops + classes + missing >= 2 * MANY + 2, "{stops} {classes} {missing}");
    let of_late = outcomes.iter().filter(reported).any(|r| r["detail"]["id"] == *late.id);
    assert!(of_late, "it was written that it was to be done, so also that it was not");
}

#[test]
fn a_command_that_waits_for_the_disk_is_not_executed_after_a_stop() {
    for how in ["stop", "disarm", "bob"] {
        let mut site = Site::new(how);
        let starts = site.starts();
        site.disk.stall(true);
        let moves = site.start_command("velocity", Some(20.0));
        match how {
            "bob" => site.stop("too fast"),
            verb => {
                let outcome = site.start_command(verb, None).wait().unwrap();
                assert_eq!(outcome.outcome, OutcomeKind::Done, "{verb}: {outcome:?}");
            }
        }
        site.disk.stall(false);
        let outcome = moves.wait().unwrap();
        let report = (outcome.outcome, code(&outcome));
        assert_eq!(report, (OutcomeKind::NotDone, "gateway.expired"), "{how}: {outcome:?}");
        assert_eq!(site.starts(), starts, "{how}");
        let records = site.end();
        let of = |id: &str| records.iter().filter(|r| r["detail"]["id"] == *id).count();
        assert_eq!(of(&outcome.id), 2, "announced, and how it ended");
    }
}
