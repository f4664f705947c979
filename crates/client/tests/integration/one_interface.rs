//! One interface for axes: the same calls give the same results on a wire of this program and on a gateway.

use std::ops::ControlFlow;
use std::time::Duration;

use polepair::interface::AxisSnapshot;
use polepair::{Axis, Link};
use polepair_core::axis::Verb;
use polepair_core::profile::Signal;
use polepair_test_support::{WAIT_MAX, wait_until};

use crate::cut::Cut;
use crate::join::Site;

/// The link of a gateway, by its connection string.
fn served(site: &Site, port: u16, axes: &str) -> Link {
    let tokens = site.options("ws").token_file.unwrap();
    let url = format!("ws://127.0.0.1:{port}?token-file={}{axes}", tokens.display());
    polepair::connect(&url).unwrap()
}

fn velocity(axis: &Axis) -> f64 {
    axis.signals(&[Signal::Velocity]).unwrap()[0].value
}

fn outcome<T: std::fmt::Display>(result: Result<T, polepair::Error>) -> String {
    match result {
        Ok(value) => value.to_string(),
        Err(error) => {
            format!("{} {:?} {}", error.code(), error.executed(), error.exception().name())
        }
    }
}

fn ended(result: Result<(), polepair::Error>) -> String {
    outcome(result.map(|()| "done"))
}

/// Runs the calls of a typical program on an axis, and returns their results.
fn session(link: &Link) -> Vec<String> {
    let axis = &link.axis(3).unwrap();
    let facts = axis.facts();
    let mut log = vec![
        format!("{} {} {} {}", facts.number, facts.label, facts.protocol, facts.profile),
        format!("{} {:?} {:?}", facts.title, facts.kind, facts.watchdog),
        format!("{} {}", facts.caution, facts.watchdog_rule),
        format!("{:?}", facts.signals),
    ];
    let mut keep = |what: String| log.push(what);

    // Parameters.
    let parameters = axis.parameters().unwrap();
    keep(format!("{} parameters, {:?}", parameters.len(), parameters[6].name));
    let described = parameters.iter().find(|known| known.name == "max current").unwrap();
    keep(format!("{} {} {:?}", described.symbol, described.unit, described.raw_range));
    keep(outcome(axis.get("max current")));
    keep(outcome(axis.get("AP 6")));
    keep(ended(axis.set("max current", "1200 mA")));
    keep(outcome(axis.get("max current")));
    keep(outcome(axis.get_raw("max current")));
    keep(ended(axis.set("max current", 1.5)));
    keep(ended(axis.set_raw("max current", 10)));
    keep(outcome(axis.get("max current").map(|read| format!("{} {}", read.value, read.unit))));
    keep(ended(axis.set("max current", "99 A")));
    keep(ended(axis.set("max current", "3 rpm")));
    keep(outcome(axis.get("max curent")));

    // Requests in the protocol's own text, and facts that drives report.
    keep(outcome(axis.raw("GAP 6")));
    keep(outcome(axis.raw("no request")));
    keep(format!("{:?}", axis.device_details().unwrap()));
    keep(format!("{:?}", axis.faults().unwrap()));
    keep(format!("{:?}", axis.watchdog().unwrap()));

    // Motion, first without arming it.
    keep(ended(axis.velocity("60 rpm")));
    keep(ended(axis.stop()));
    {
        let armed = axis.armed().unwrap();
        keep(format!("armed {}", axis.is_armed()));
        keep(ended(axis.arm()));
        keep(ended(armed.velocity("3 A")));
        keep(ended(armed.velocity("120 rpm")));
        wait_until("it turns", || velocity(axis) > 10.0);
        wait_until("its state says so", || moving(&axis.state().unwrap()));
        keep(ended(armed.stop()));
        keep(format!("{:.0}", velocity(axis)));
        let before = axis.signals(&[Signal::Position]).unwrap()[0].value;
        keep(ended(armed.move_by("1 turn")));
        keep(outcome(armed.wait_reached(WAIT_MAX)));
        let turned = axis.signals(&[Signal::Position]).unwrap()[0].value - before;
        keep(format!("{turned:.1}"));
        keep(ended(armed.move_to("0 deg")));
        keep(ended(armed.wait(WAIT_MAX)));
        keep(ended(armed.move_to("1000 turn")));
        keep(outcome(armed.wait_reached(Duration::from_millis(300))));
        let mut shown = 0;
        armed
            .watch(&[Signal::Velocity, Signal::Position], Duration::from_millis(20), |readings| {
                shown += readings.len();
                if shown < 6 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
            })
            .unwrap();
        keep(format!("{shown} readings"));
        keep(ended(armed.release()));
    }
    keep(format!("armed {}", axis.is_armed()));
    keep(format!("{:.0}", velocity(axis)));
    {
        let armed = axis.armed().unwrap();
        armed.velocity("60 rpm").unwrap();
        wait_until("it turns", || velocity(axis) > 5.0);
    }
    wait_until("the end of the guard stopped it", || velocity(axis).abs() < 0.5);
    keep(format!("armed {}", axis.is_armed()));
    keep(outcome(axis.clear().and(axis.get("max current"))));
    keep(outcome(link.axis(9).map(|axis| axis.label().to_owned())));
    log
}

fn moving(state: &AxisSnapshot) -> bool {
    state.moving == Some(true) && state.signal(Signal::Velocity).is_some_and(|v| v.value > 5.0)
}

#[test]
fn the_same_calls_give_the_same_results() {
    let local = session(&polepair::connect("sim:tmcl?axes=2").unwrap());
    let site = Site::with_raw_requests();
    let link = served(&site, site.port(), "");
    assert_eq!(link.axes().len(), 2);
    let remote = session(&link);
    assert_eq!(local, remote);
    assert!(local.iter().any(|line| line == "done"), "{local:?}");
}

#[test]
fn axes_of_a_gateway_are_selected_by_name() {
    let site = Site::new();
    let link = served(&site, site.port(), "#3");
    let labels: Vec<_> = link.axes().iter().map(Axis::label).collect();
    assert_eq!(labels, ["axis 3"]);
    assert!(link.url().starts_with("http://127.0.0.1:"), "{}", link.url());
    let tokens = site.options("ws").token_file.unwrap();
    let url = format!("ws://127.0.0.1:{}?token-file={}#7", site.port(), tokens.display());
    assert_eq!(polepair::connect(&url).unwrap_err().code(), "E212");
}

#[test]
fn calls_that_a_gateway_does_not_offer_have_one_error() {
    let site = Site::new();
    let link = served(&site, site.port(), "");
    let axis = &link.axes()[0];
    assert!(axis.local().is_none() && axis.remote().is_some() && link.local().is_none());
    for error in [
        axis.require_local("streams", "").map(drop).unwrap_err(),
        link.events().map(drop).unwrap_err(),
        axis.interface().write_data(axis.find("max current").unwrap(), b"a").unwrap_err(),
    ] {
        assert_eq!((error.code(), error.executed()), ("E257", Some(false)), "{error}");
    }
}

#[test]
fn a_stop_needs_no_lease_and_a_taken_axis_is_not_moved() {
    let site = Site::new();
    let (one, other) = (served(&site, site.port(), "#1"), served(&site, site.port(), "#1"));
    let armed = one.axes()[0].armed().unwrap();
    armed.velocity("60 rpm").unwrap();
    wait_until("it turns", || velocity(&armed) > 5.0);
    let refused = other.axes()[0].armed().unwrap_err();
    assert_eq!(refused.code(), "gateway.lease", "{refused}");
    assert_eq!(refused.executed(), Some(false));
    other.axes()[0].stop().unwrap();
    assert!(velocity(&other.axes()[0]).abs() < 0.5);
    drop(armed);
    other.axes()[0].armed().unwrap().release().unwrap();
}

#[test]
fn a_lost_gateway_ends_what_waits() {
    let site = Site::new();
    let cut = Cut::before(site.port());
    let link = served(&site, cut.port(), "#1");
    let axis = &link.axes()[0];
    let armed = axis.armed().unwrap();
    armed.velocity("60 rpm").unwrap();
    wait_until("it turns", || velocity(axis) > 5.0);
    cut.pull();
    wait_until("the lease is lost", || !axis.is_armed());
    let lost = armed.velocity("90 rpm").unwrap_err();
    assert_eq!((lost.code(), lost.exit() as u8), ("E313", 3), "{lost}");
    drop(armed);
    let site_link = served(&site, site.port(), "#1");
    wait_until("the gateway stopped it", || velocity(&site_link.axes()[0]).abs() < 0.5);
    assert!(site_link.axes()[0].facts().verbs.contains(&Verb::Stop));
}
