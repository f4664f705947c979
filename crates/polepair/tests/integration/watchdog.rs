//! The drive's own watchdog: which parameter it is, what it is set to, and whether it works.

use polepair::axis::WatchdogState;
use polepair::doctor::{Check, Grade, prove_watchdog};
use polepair::{Axis, Link};
use std::time::Duration;

const HALF: Duration = Duration::from_millis(500);

fn open(url: &str) -> Link {
    polepair::connect(&format!("{url}time=virtual")).unwrap_or_else(|e| panic!("{url}: {e}"))
}

fn name(axis: &Axis) -> &'static str {
    let id = axis.watchdog_parameter();
    id.and_then(|id| axis.profile().parameter(id)).map_or("", |parameter| parameter.name)
}

/// What was proven, and what was said of the setting that was made for that.
fn proven(axis: &Axis, after: Option<Duration>) -> (Check, Option<Check>) {
    let mut checks = Vec::new();
    prove_watchdog(axis, after, &mut |check| checks.push(check)).unwrap();
    assert_eq!(checks.len(), 1 + usize::from(after.is_some()), "{checks:#?}");
    let last = after.and_then(|_| checks.pop());
    (checks.remove(0), last)
}

#[test]
fn a_module_has_one_for_each_medium() {
    for (url, own, other) in [
        ("sim:tmcl?", "serial heartbeat", "can heartbeat"),
        ("sim:tmcl+can:3?", "can heartbeat", "serial heartbeat"),
    ] {
        let link = open(url);
        let axis = &link.axes()[0];
        assert_eq!((name(axis), axis.watchdog().unwrap()), (own, WatchdogState::Off), "{url}");
        axis.set_raw(other, 500).unwrap();
        assert_eq!(axis.watchdog().unwrap(), WatchdogState::Off, "{url}: the other wire's");
        assert_eq!(axis.set_watchdog(Some(HALF)).unwrap(), WatchdogState::On(HALF), "{url}");
        assert_eq!(axis.get_raw(own).unwrap(), 500);
        assert_eq!(axis.set_watchdog(None).unwrap(), WatchdogState::Off, "{url}");
    }
}

#[test]
fn each_that_there_is_stops_the_motor_when_its_host_falls_silent() {
    for url in ["sim:tmcl?", "sim:tmcl+can:3?", "sim:thruster?", "sim:cia402:5?heartbeat=100&"] {
        let link = open(url);
        let axis = &link.axes()[0];
        let before = axis.watchdog().unwrap();
        let (check, last) = proven(axis, Some(HALF));
        assert_eq!(check.grade, Grade::Ok, "{url}: {check:#?}");
        let last = last.unwrap().found;
        match before {
            WatchdogState::Untold => assert!(last.contains("stays set"), "{url}: {last}"),
            _ => {
                assert_eq!(axis.watchdog().unwrap(), before, "{url}");
                assert!(last.contains("is set as before") && last.contains("off"), "{url}: {last}");
            }
        }
        let kept = last.contains("in its permanent memory");
        assert_eq!(kept, url.starts_with("sim:tmcl"), "{url}: {last}");
        assert!(check.found.contains("of silence"), "{url}: {check:#?}");
        let speed = link.simulation().unwrap().truth(0, 0).unwrap().velocity;
        assert!(speed.abs() < 0.1, "{url}: {speed}");
    }
}

#[test]
fn nothing_moves_where_there_is_nothing_to_prove() {
    for (url, said) in [
        ("sim:tmcl?", "off"),
        ("sim:thruster?", "does not tell"),
        ("sim:modbus-rtu?fn00=1&", "none"),
        ("sim:cia402:5?heartbeat=100&", "off"),
    ] {
        let link = open(url);
        let (check, _) = proven(&link.axes()[0], None);
        assert_eq!(check.grade, Grade::Wrong, "{url}: {check:#?}");
        assert!(check.found.contains(said), "{url}: {check:#?}");
        assert!(link.simulation().unwrap().truth(0, 0).unwrap().position.abs() < 0.1, "{url}");
    }
}

#[test]
fn a_drive_is_had_to_watch_the_hosts_heartbeat_unless_it_watches_somebody() {
    use WatchdogState::{NoReaction, Off, On, Other};
    let ms = Duration::from_millis;
    let link = open("sim:cia402:5?heartbeat=100&");
    let axis = &link.axes()[0];
    assert_eq!(axis.watch_host().unwrap(), Some([Off, On(ms(300))]));
    assert_eq!(axis.get_raw("consumer heartbeat").unwrap(), 127 << 16 | 300);
    assert_ne!(axis.get_raw("lost connection option").unwrap(), 0);
    // What watches this host already is left alone, with its own time and reaction.
    axis.set_raw("consumer heartbeat", 127 << 16 | 500).unwrap();
    axis.set_raw("lost connection option", 2).unwrap();
    assert_eq!(axis.watch_host().unwrap(), Some([On(HALF), On(HALF)]));
    assert_eq!(axis.get_raw("lost connection option").unwrap(), 2);
    axis.set_raw("lost connection option", 0).unwrap();
    assert_eq!(axis.watch_host().unwrap(), Some([NoReaction(HALF), On(HALF)]));
    assert_eq!(axis.get_raw("lost connection option").unwrap(), 3, "quick stop");
    axis.set_raw("consumer heartbeat", 3 << 16 | 500).unwrap();
    assert_eq!(axis.watch_host().unwrap(), Some([Other { node: 3 }; 2]));
    // Nothing is set for a host that sends none, nor where none is watched.
    let silent = open("sim:cia402:5?");
    assert_eq!(silent.axes()[0].watch_host().unwrap(), None);
    assert_eq!(silent.axes()[0].watchdog().unwrap(), Off);
    assert_eq!(open("sim:tmcl+can:3?").axes()[0].watch_host().unwrap(), None);
}

#[test]
fn a_heartbeat_that_is_watched_has_to_lead_to_something() {
    let link = open("sim:cia402:5?");
    let axis = &link.axes()[0];
    axis.set_raw("lost connection option", 0).unwrap();
    axis.set_raw("consumer heartbeat", 127 << 16 | 500).unwrap();
    assert_eq!(axis.watchdog().unwrap(), WatchdogState::NoReaction(HALF));
    axis.set_raw("consumer heartbeat", 3 << 16 | 500).unwrap();
    assert_eq!(axis.watchdog().unwrap(), WatchdogState::Other { node: 3 });
    assert_eq!(axis.set_watchdog(Some(HALF)).unwrap(), WatchdogState::On(HALF));
    assert_eq!(axis.get_raw("lost connection option").unwrap(), 3, "quick stop");
    let (check, _) = proven(axis, None);
    assert!(check.found.contains("sends none"), "{check:#?}");
    // What it watches nobody may send: that is said with the state.
    let said = axis.watchdog_in_words(axis.watchdog().unwrap());
    assert!(
        said.contains("watches node 127") && said.contains("this connection sends none"),
        "{said}"
    );
    assert!(axis.watchdog_caution(false).is_some() && axis.watchdog_caution(true).is_none());
    let sends = open("sim:cia402:5?heartbeat=100&");
    let axis = &sends.axes()[0];
    let said = axis.watchdog_in_words(axis.set_watchdog(Some(HALF)).unwrap());
    assert_eq!(said, "on, the drive stops after 500 ms of silence");
}
