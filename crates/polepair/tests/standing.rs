//! A stop is over when the motor is seen to stand by what is measured of it, not by what a trajectory
//! or an acknowledgement says.

use std::time::Duration;

use polepair::axis::{OWED_MAX, stop_owed};
use polepair::{Error, Link, connect};
use polepair_core::drives::bench::Act;

/// Drives whose stop waits for nothing that is measured.
const BLIND: [&str; 3] =
    ["sim:technosoft-f514l?time=virtual", "sim:tmlcan?time=virtual", "sim:thruster?time=virtual"];

fn speed(link: &Link) -> f64 {
    link.simulation().unwrap().truth(0, 0).unwrap().velocity.abs()
}

fn load(link: &Link, torque: f64) {
    assert!(link.simulation().unwrap().act(0, 0, Act::Load(torque)));
}

/// A motor without power that its load turns.
fn turned_by_its_load(url: &str) -> Link {
    let link = connect(url).unwrap_or_else(|error| panic!("{url}: {error}"));
    load(&link, 0.2);
    link.sleep(Duration::from_secs(1));
    assert!(speed(&link) > 1.0, "{url}: {}", speed(&link));
    link
}

fn may_turn(url: &str, ended: &Result<(), Error>) {
    let Err(error) = ended else { panic!("{url}: it turns") };
    assert!(error.may_turn(), "{url}: {error}");
    assert!(error.to_string().contains("is not at rest after 5 s"), "{url}: {error}");
}

#[test]
fn a_motor_that_its_load_turns_is_not_told_as_stopped() {
    for url in BLIND {
        let link = turned_by_its_load(url);
        may_turn(url, &link.axes()[0].stop());
        may_turn(url, &link.stop_all());
        may_turn(url, &stop_owed(link.axes(), OWED_MAX, |_, _| true).remove(0));
        load(&link, 0.0);
        link.sleep(Duration::from_secs(20));
        assert!(speed(&link) < 0.01, "{url}: {}", speed(&link));
        link.axes()[0].stop().unwrap_or_else(|error| panic!("{url}: {error}"));
    }
}

/// The mode that a drive has when its motion runs is named, though it tells it with other bits then.
#[test]
fn a_mode_is_named_by_the_signals_words_or_its_parameters() {
    let link = connect("sim:technosoft-f514l?time=virtual").expect("a drive");
    let axis = &link.axes()[0];
    let armed = axis.armed().expect("armed");
    axis.velocity("60 rpm").expect("turns");
    axis.get_raw("motion command").expect("told");
    assert_eq!(axis.mode(&axis.state()).as_deref(), Some("speed profile"));
    armed.release().expect("stands");
}

#[test]
fn a_turning_motor_stands_when_its_stop_returns() {
    for url in BLIND {
        let link = connect(url).unwrap_or_else(|error| panic!("{url}: {error}"));
        let axis = &link.axes()[0];
        let armed = axis.armed().unwrap_or_else(|error| panic!("{url}: {error}"));
        match axis.velocity("300 rpm") {
            Err(Error::Unsupported { .. }) => axis.torque(0.1).expect("a torque"),
            other => other.unwrap_or_else(|error| panic!("{url}: {error}")),
        }
        link.sleep(Duration::from_secs(2));
        assert!(speed(&link) > 1.0, "{url}: {}", speed(&link));
        axis.stop().unwrap_or_else(|error| panic!("{url}: {error}"));
        assert!(speed(&link) < 0.1, "{url}: {}", speed(&link));
        armed.detach();
    }
}
