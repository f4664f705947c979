//! A bench without HTTP: leases, commands and stops on simulated drives in virtual time.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use polepair_serve::bench::{Bench, Journal, Note, Options, Reply, Session};
use polepair_serve::message::{
    Arguments, CommandOrder, Deed, Ended, Given, LeaseAct, Outcome, Refused, StopClass, StopOrder,
    WriteParameters,
};

const MS: Duration = Duration::from_millis(1);

/// A bench of simulated drives in virtual time, and a client.
struct Desk {
    bench: Bench,
    ids: u32,
}

impl Desk {
    fn new(url: &str) -> Self {
        Self { bench: Bench::open(&[url.into()], Options::default()).unwrap(), ids: 0 }
    }

    /// Waits for an answer in virtual time.
    fn hear<T>(&self, mut reply: Reply<T>) -> Result<T, Refused> {
        for _ in 0..30_000 {
            if let Some(answer) = reply.take() {
                return answer;
            }
            self.bench.pass(MS);
        }
        panic!("no answer within thirty seconds of virtual time");
    }

    fn take(&self, who: &Session, axis: u16) -> u64 {
        let lease = self.bench.lease(axis, who, LeaseAct::Take, 0);
        self.hear(lease).unwrap().expect("a lease").epoch
    }

    fn order(&mut self, epoch: u64, verb: &str, velocity: Option<f64>) -> CommandOrder {
        self.ids += 1;
        CommandOrder {
            id: format!("id-{}", self.ids),
            issued_ms: self.bench.now_ms(),
            ttl_ms: 500.0,
            epoch,
            verb: verb.into(),
            arguments: Arguments { velocity, ..Arguments::default() },
        }
    }

    fn tell(&mut self, who: &Session, epoch: u64, verb: &str, velocity: Option<f64>) -> Outcome {
        let order = self.order(epoch, verb, velocity);
        self.hear(self.bench.command(0, who, order)).unwrap()
    }

    /// Arms, powers and turns axis 0.
    fn spin(&mut self, who: &Session) -> u64 {
        let epoch = self.take(who, 0);
        for (verb, velocity) in [("arm", None), ("enable", None), ("velocity", Some(10.0))] {
            if verb == "enable" && !self.can(verb) {
                continue;
            }
            let outcome = self.tell(who, epoch, verb, velocity);
            assert_eq!(outcome.outcome, Ended::Done, "{verb}: {:?}", outcome.error);
            self.keep(who, epoch);
        }
        epoch
    }

    fn keep(&self, who: &Session, epoch: u64) {
        self.hear(self.bench.lease(0, who, LeaseAct::Renew, epoch)).unwrap();
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

fn code(outcome: &Outcome) -> &str {
    outcome.error.as_ref().map_or("", |error| &*error.code)
}

#[test]
fn a_motor_turns_for_as_long_as_its_lease_is_renewed() {
    let ann: Session = "ann".into();
    let mut desk = Desk::new("sim:tmcl?time=virtual");
    let epoch = desk.spin(&ann);
    for _ in 0..10 {
        desk.bench.pass(300 * MS);
        desk.keep(&ann, epoch);
    }
    assert!(desk.speed() > 5.0, "{}", desk.speed());
    desk.bench.pass(3000 * MS);
    assert!(desk.speed() < 0.1, "the lease was its dead man's switch: {}", desk.speed());
    let late = desk.tell(&ann, epoch, "velocity", Some(5.0));
    assert_eq!((late.outcome, code(&late)), (Ended::NotDone, "gateway.lease"));
    let epoch = desk.take(&ann, 0);
    let unarmed = desk.tell(&ann, epoch, "velocity", Some(5.0));
    assert_eq!(code(&unarmed), "E219", "nothing moves again without being armed");
}

#[test]
fn a_command_is_carried_out_once_and_while_it_is_fresh() {
    let ann: Session = "ann".into();
    let mut desk = Desk::new("sim:tmcl?time=virtual");
    let epoch = desk.spin(&ann);
    let order = desk.order(epoch, "velocity", Some(20.0));
    let first = desk.hear(desk.bench.command(0, &ann, order.clone())).unwrap();
    let starts = desk.bench.truth(0).unwrap().starts;
    desk.keep(&ann, epoch);
    let again = desk.hear(desk.bench.command(0, &ann, order)).unwrap();
    assert_eq!(again, Outcome { replayed: true, ..first });
    assert_eq!(desk.bench.truth(0).unwrap().starts, starts, "nothing was sent");
    let old = desk.order(epoch, "velocity", Some(30.0));
    desk.bench.pass(600 * MS);
    let old = desk.hear(desk.bench.command(0, &ann, old)).unwrap();
    assert_eq!((old.outcome, code(&old)), (Ended::NotDone, "gateway.expired"));
    let mut early = desk.order(epoch, "velocity", Some(30.0));
    early.issued_ms += 5000.0;
    let early = desk.hear(desk.bench.command(0, &ann, early)).unwrap();
    assert_eq!(code(&early), "gateway.expired");
    assert_eq!(desk.bench.truth(0).unwrap().starts, starts);
}

#[test]
fn a_stop_of_everything_needs_no_lease_and_locks_motion_until_it_is_released() {
    let (ann, bob): (Session, Session) = ("ann".into(), "bob".into());
    let mut desk = Desk::new("sim:tmcl?time=virtual");
    desk.spin(&ann);
    desk.bench.pass(300 * MS);
    let stopped = desk.hear(desk.bench.stop(&bob, &StopOrder::default())).unwrap();
    assert_eq!(stopped.axes[0].class, StopClass::Standing, "{stopped:?}");
    assert!(desk.speed() < 0.1);
    assert!(desk.bench.axis(0).unwrap().lease.is_none(), "a stop revokes the lease");
    assert_eq!(desk.bench.snapshot().lock.expect("locked").by, "bob");
    let epoch = desk.take(&ann, 0);
    assert_eq!(code(&desk.tell(&ann, epoch, "arm", None)), "gateway.locked");
    assert_eq!(code(&desk.tell(&ann, epoch, "velocity", Some(9.0))), "gateway.locked");
    desk.bench.release(&bob).unwrap();
    assert_eq!(desk.tell(&ann, epoch, "arm", None).outcome, Ended::Done);
    assert_eq!(desk.tell(&ann, epoch, "velocity", Some(9.0)).outcome, Ended::Done);
}

#[test]
fn taking_over_stops_and_disarms_what_the_first_owner_moved() {
    let (ann, bob): (Session, Session) = ("ann".into(), "bob".into());
    let mut desk = Desk::new("sim:tmcl?time=virtual");
    let old = desk.spin(&ann);
    let refused = desk.hear(desk.bench.lease(0, &bob, LeaseAct::Take, 0)).unwrap_err();
    assert_eq!(refused.code, "gateway.lease");
    let taken = desk.hear(desk.bench.lease(0, &bob, LeaseAct::TakeOver, 0)).unwrap().unwrap();
    assert_eq!(taken.epoch, old + 1);
    assert_eq!(code(&desk.tell(&ann, old, "velocity", Some(9.0))), "gateway.lease");
    desk.bench.pass(1000 * MS);
    assert!(desk.speed() < 0.1 && !desk.bench.axis(0).unwrap().armed);
}

#[test]
fn closing_and_a_client_that_goes_stop_what_moves() {
    for how in ["gone", "closing", "given back"] {
        let ann: Session = "ann".into();
        let mut desk = Desk::new("sim:tmcl?time=virtual");
        let epoch = desk.spin(&ann);
        desk.bench.pass(300 * MS);
        assert!(desk.speed() > 5.0);
        match how {
            "gone" => desk.bench.gone(&ann),
            "closing" => desk.bench.shutdown(),
            _ => drop(desk.hear(desk.bench.lease(0, &ann, LeaseAct::Drop, epoch)).unwrap()),
        }
        // Less than a lease lasts: it was not that which ended it.
        desk.bench.pass(800 * MS);
        assert!(desk.speed() < 0.1, "{how}: {}", desk.speed());
    }
}

#[test]
fn parameters_are_planned_written_under_a_lease_and_never_move() {
    let ann: Session = "ann".into();
    let desk = Desk::new("sim:tmcl?time=virtual");
    let one = |name: &str, text: &str| WriteParameters {
        values: [(name.to_owned(), Given::Text(text.into()))].into(),
        keep: false,
        dry_run: true,
        epoch: 0,
    };
    let infos = desk.bench.parameters(0).unwrap();
    let current = infos.iter().find(|info| info.name == "max current").expect("it has one");
    assert!(current.writable && !current.unit.is_empty());
    let before = desk.hear(desk.bench.read_parameter(0, "max current")).unwrap();
    let plan = desk.hear(desk.bench.apply(0, &ann, one("max current", "0.5 A"))).unwrap();
    assert!(plan[0].changed && plan[0].from == before.value, "{plan:?}");
    let unleased = WriteParameters { dry_run: false, ..one("max current", "0.5 A") };
    let refused = desk.hear(desk.bench.apply(0, &ann, unleased)).unwrap_err();
    assert_eq!(refused.code, "gateway.lease");
    let epoch = desk.take(&ann, 0);
    let write = WriteParameters { dry_run: false, epoch, ..one("max current", "0.5 A") };
    desk.hear(desk.bench.apply(0, &ann, write)).unwrap();
    let after = desk.hear(desk.bench.read_parameter(0, "max current")).unwrap();
    assert_eq!(after.value, Some(plan[0].to));
    let too_much = desk.hear(desk.bench.apply(0, &ann, one("max current", "500 A"))).unwrap_err();
    assert_eq!((&*too_much.code, too_much.executed), ("E216", Some(false)));
    let moves = infos.iter().find(|info| info.moves && info.readable).expect("it has one");
    let refused = desk.hear(desk.bench.apply(0, &ann, one(&moves.name, "1"))).unwrap_err();
    assert_eq!(refused.code, "E219");
}

/// Keeps what it is told, or refuses it.
#[derive(Default)]
struct Kept {
    notes: Mutex<Vec<(String, Deed)>>,
    full: Mutex<bool>,
}

impl Journal for Kept {
    fn note(&self, note: Note<'_>) -> Result<(), Refused> {
        self.notes.lock().unwrap().push((note.who.to_owned(), note.deed));
        match *self.full.lock().unwrap() {
            true => Err(Refused::new("gateway.busy", "the disk is full")),
            false => Ok(()),
        }
    }
}

#[test]
fn what_the_journal_cannot_keep_is_not_done_except_a_stop() {
    let ann: Session = "ann".into();
    let kept = Arc::new(Kept::default());
    let options = Options { journal: kept.clone(), ..Options::default() };
    let bench = Bench::open(&["sim:tmcl?time=virtual".into()], options).unwrap();
    let mut desk = Desk { bench, ids: 0 };
    let epoch = desk.spin(&ann);
    desk.keep(&ann, epoch);
    *kept.full.lock().unwrap() = true;
    let starts = desk.bench.truth(0).unwrap().starts;
    let refused = desk.tell(&ann, epoch, "velocity", Some(20.0));
    assert_eq!(refused.outcome, Ended::NotDone);
    assert_eq!(desk.bench.truth(0).unwrap().starts, starts);
    let stopped = desk.hear(desk.bench.stop(&ann, &StopOrder::default())).unwrap();
    assert_eq!(stopped.axes[0].class, StopClass::Standing);
    let notes = kept.notes.lock().unwrap();
    let deeds: Vec<Deed> = notes.iter().map(|(_, deed)| *deed).collect();
    assert_eq!(deeds[..2], [Deed::Lease, Deed::Command]);
    assert!(deeds.contains(&Deed::Stop) && deeds.contains(&Deed::Outcome));
}
