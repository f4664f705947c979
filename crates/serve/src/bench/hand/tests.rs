//! Stops that are said while a hand is at work, its link is lost, or something else waits.

use tokio::sync::oneshot;

use super::*;
use crate::bench::Options;
use crate::bench::wire::{Dismiss, StopThese};
use crate::message::{DismissReason, DismissStop};

/// The wire of a link's first axis, with a hand whose thread never looks.
fn wire_of(link: &polepair::Link) -> (Arc<Wire>, Arc<Mutex<Hand>>) {
    let wire = Arc::new(Wire::new(vec![(7, link.axes()[0].clone())]));
    let desk = Arc::new(Desk::new(&wire));
    let clock = Clock::of(link.simulation().into_iter());
    let shared = Arc::new(Shared::new(clock, &Options::default()));
    let url = "sim:".to_owned();
    let hand = Arc::new(Mutex::new(Hand::new(Arc::clone(&wire), desk, shared, url)));
    wire.looked_after_by(std::thread::current(), Arc::downgrade(&hand));
    (wire, hand)
}

fn say_stop(wire: &Wire) {
    let (axes, who, reason) = (vec![(0, 0)], Session::from("ann"), String::new());
    wire.stop(StopThese { axes, who, reason, since: Instant::ZERO, report: None });
    wire.send_stops();
}

#[test]
fn a_stop_is_sent_by_whoever_says_it_unless_the_hand_is_at_work() {
    let link = polepair::connect("sim:tmcl?time=virtual").unwrap();
    let (wire, hand) = wire_of(&link);
    let sent = || link.counters(&link.axes()[0]).sent;
    let before = sent();
    say_stop(&wire);
    assert!(sent() > before && held(&hand).axes[0].owed.is_some());
    let before = sent();
    let at_work = held(&hand);
    say_stop(&wire);
    assert_eq!(sent(), before);
    assert!(at_work.wire.next_stop().is_some(), "the hand finds it");
    drop(at_work);
    held(&hand).brisk = false;
    say_stop(&wire);
    assert_eq!(sent(), before, "it may be long, and others are to be stopped as well");
}

#[test]
fn a_stop_that_is_said_after_a_dismissal_is_not_dismissed() {
    let link = polepair::connect("sim:tmcl?time=virtual").unwrap();
    let (wire, hand) = wire_of(&link);
    let dismiss = || {
        let (tell, mut told) = oneshot::channel();
        let reason = DismissReason::DriveGone;
        let dismiss = DismissStop { reason, epoch: 0, note: String::new() };
        let session = "ann".into();
        wire.order(Order::Dismiss(Dismiss { axis: 0, session, dismiss, tell })).unwrap();
        move || told.try_recv().unwrap().unwrap_err().code
    };
    say_stop(&wire);
    let mut before = dismiss();
    say_stop(&wire);
    held(&hand).turn();
    assert_eq!(before(), "gateway.expired");
    assert!(held(&hand).axes[0].owed.is_some());
}

#[test]
fn a_lost_link_is_opened_again_by_no_one_who_says_a_stop() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let url = format!("tmcl+tcp://{address}?profile=tmcm-171#1");
    let link = polepair::connect(&url).unwrap();
    let (wire, _hand) = wire_of(&link);
    drop(listener.accept().unwrap());
    let connection = link.axes()[0].connection();
    while connection.trouble().is_none() {
        connection.catch_up();
    }
    say_stop(&wire);
    assert!(wire.next_stop().is_some(), "it is its hand's");
}
