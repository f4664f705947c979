//! Stops that are requested while a command worker runs, its link is lost, or something else waits.

use tokio::sync::oneshot;

use super::*;
use crate::bench::BenchOptions;
use crate::bench::wire::{DismissRequest, StopBatch};
use crate::message::{DismissReason, DismissStop};

/// The wire of a link's first axis, with a command worker whose thread never runs.
fn test_wire(link: &polepair::LocalLink) -> (Arc<BenchWire>, Arc<Mutex<CommandWorker>>) {
    let wire = Arc::new(BenchWire::new(vec![(7, link.axes()[0].clone())]));
    let worker = Arc::new(RequestWorker::new(&wire));
    let clock = BenchClock::from_simulations(link.simulation().into_iter());
    let shared = Arc::new(BenchContext::new(clock, &BenchOptions::default()));
    let url = "sim:".to_owned();
    let command_worker =
        Arc::new(Mutex::new(CommandWorker::new(Arc::clone(&wire), worker, shared, url)));
    wire.set_worker(std::thread::current(), CommandWorker::stop_sender(&command_worker));
    (wire, command_worker)
}

fn submit_stop(wire: &BenchWire) {
    let (axes, who, reason) = (vec![(0, 0)], SessionName::from("ann"), String::new());
    wire.submit_stop(StopBatch {
        axes,
        session: who,
        reason,
        requested_at: Instant::ZERO,
        collector: None,
    });
    wire.send_stops();
}

#[test]
fn a_stop_is_sent_by_whoever_says_it_unless_the_hand_is_at_work() {
    let link = polepair::connect_local("sim:tmcl?time=virtual").unwrap();
    let (wire, worker) = test_wire(&link);
    let sent = || link.counters(&link.axes()[0]).sent;
    let before = sent();
    submit_stop(&wire);
    assert!(sent() > before && lock_unpoisoned(&worker).axes[0].pending_stop.is_some());
    let before = sent();
    let at_work = lock_unpoisoned(&worker);
    submit_stop(&wire);
    assert_eq!(sent(), before);
    assert!(at_work.wire.next_stop().is_some(), "the hand finds it");
    drop(at_work);
    lock_unpoisoned(&worker).fast_send = false;
    submit_stop(&wire);
    assert_eq!(sent(), before, "it may be long, and others are to be stopped as well");
}

#[test]
fn a_stop_after_a_dismissal_is_not_dismissed() {
    let link = polepair::connect_local("sim:tmcl?time=virtual").unwrap();
    let (wire, worker) = test_wire(&link);
    let dismiss = || {
        let (reply_sender, mut receiver) = oneshot::channel();
        let reason = DismissReason::DriveGone;
        let dismiss = DismissStop { reason, epoch: 0, note: String::new() };
        let session = "ann".into();
        wire.submit(WireRequest::Dismiss(DismissRequest {
            axis: 0,
            session,
            dismiss,
            reply: reply_sender,
        }))
        .unwrap();
        move || receiver.try_recv().unwrap().unwrap_err().code
    };
    submit_stop(&wire);
    let mut before = dismiss();
    submit_stop(&wire);
    lock_unpoisoned(&worker).run_once();
    assert_eq!(before(), "gateway.expired");
    assert!(lock_unpoisoned(&worker).axes[0].pending_stop.is_some());
}

#[test]
fn a_lost_link_is_opened_again_by_no_one_who_says_a_stop() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let url = format!("tmcl+tcp://{address}?profile=tmcm-171#1");
    let link = polepair::connect_local(&url).unwrap();
    let (wire, _hand) = test_wire(&link);
    drop(listener.accept().unwrap());
    let connection = link.axes()[0].connection();
    while connection.link_error().is_none() {
        connection.catch_up();
    }
    submit_stop(&wire);
    assert!(wire.next_stop().is_some(), "it is its hand's");
}
