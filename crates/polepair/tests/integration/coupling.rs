//! Axes that follow each other: gears and cams, from drive to drive.

use polepair::{Cam, CamPoint, Error, GearRatio, LocalAxis, LocalLink};
use polepair_core::axis::{Command, Verb};
use polepair_core::profile::Signal;
use polepair_drives::surroundings::Act;
use std::f64::consts::TAU;
use std::time::Duration;

const LIMIT: Duration = Duration::from_secs(60);

fn open(url: &str) -> LocalLink {
    polepair::connect_local(url).unwrap_or_else(|error| panic!("{url}: {error}"))
}

fn turns(axis: &LocalAxis) -> f64 {
    axis.get("actual position").unwrap().value
}

fn move_to(axis: &LocalAxis, turns: f64) {
    axis.run(Command { target: Some(turns * TAU), ..Command::new(Verb::MoveTo) }).unwrap();
    axis.wait(LIMIT).unwrap();
    // The follower's loop settles behind the master's.
    axis.sleep(Duration::from_millis(300));
}

fn is_following(axis: &LocalAxis) -> bool {
    let high = axis.read(axis.find("status high").unwrap()).unwrap();
    high & 0x5000 != 0
}

#[test]
fn a_gear_follows_in_both_directions_until_it_is_uncoupled() {
    for url in ["sim:tmlcan:3,7?time=virtual", "sim:technocan:3,7?time=virtual"] {
        let link = open(url);
        let [master, follower] = link.axes() else { panic!("two axes") };
        let (_leading, _following) = (master.armed().unwrap(), follower.armed().unwrap());
        follower.follow_gear(master, GearRatio { follower: 1, master: 3 }).unwrap();
        assert!(is_following(follower), "{url}");
        for place in [3.0, -1.5] {
            move_to(master, place);
            assert!((turns(follower) - place / 3.0).abs() < 0.01, "{url}: {}", turns(follower));
        }
        // Another ratio, from where both are, and the other way.
        follower.follow_gear(master, GearRatio { follower: -2, master: 1 }).unwrap();
        let before = turns(follower);
        move_to(master, -0.5);
        assert!((turns(follower) - (before - 2.0)).abs() < 0.01, "{url}: {}", turns(follower));
        follower.uncouple(master).unwrap();
        assert!(!is_following(follower), "{url}");
        let before = turns(follower);
        move_to(master, 1.0);
        assert!((turns(follower) - before).abs() < 0.005, "{url}: it follows no more");
    }
}

#[test]
fn a_ratio_that_no_binary_fraction_has_does_not_drift() {
    let link = open("sim:tmlcan:1,2?time=virtual");
    let [master, follower] = link.axes() else { panic!("two axes") };
    let (_leading, _following) = (master.armed().unwrap(), follower.armed().unwrap());
    follower.follow_gear(master, GearRatio { follower: 1, master: 3 }).unwrap();
    for _ in 0..4 {
        move_to(master, 600.0);
        move_to(master, 0.0);
    }
    move_to(master, 600.0);
    // Rounded to 16 bits, a third would be 0.003 turns off after 600.
    assert!((turns(follower) - 200.0).abs() < 0.002, "{}", turns(follower));
}

#[test]
fn the_ratio_is_of_turns_whatever_the_encoders_are() {
    let link = open("sim:tmlcan:1,2?time=virtual&counts=8000");
    let master = &link.axes()[0];
    assert_eq!(master.get("ENCRESLONG").map(|value| value.raw).unwrap(), 8000);
    let follower = &link.axes()[1];
    follower.write(follower.find("ENCRESLONG").unwrap(), 4000, false).unwrap();
    let refused = follower.follow_gear(master, GearRatio { follower: 32_767, master: 32_766 });
    assert_eq!(refused.unwrap_err().code(), "E217");
}

#[test]
fn a_cam_follows_its_table() {
    let link = open("sim:tmlcan:1,2?time=virtual");
    let [master, follower] = link.axes() else { panic!("two axes") };
    let (_leading, _following) = (master.armed().unwrap(), follower.armed().unwrap());
    let points =
        CamPoint::parse_table("master [deg];follower [turn]\n0;0\n180;0.5\n\n360;0.1 # back")
            .unwrap();
    let mut cam = Cam { points, memory: None, accept_inferred: false };
    assert_eq!(follower.plan_cam(master, &cam).unwrap_err().code(), "E222");
    cam.accept_inferred = true;
    let plan = follower.plan_cam(master, &cam).unwrap();
    follower.follow_cam(master, &plan).unwrap();
    assert!(is_following(follower));
    for (place, expected) in [(0.25, 0.25), (0.5, 0.5), (0.75, 0.3), (1.0, 0.1), (2.0, 0.1)] {
        move_to(master, place);
        assert!((turns(follower) - expected).abs() < 0.01, "{place}: {}", turns(follower));
    }
    follower.uncouple(master).unwrap();
    // Where the factors of an earlier cam are left, the next one still has its own size.
    follower.write(follower.find("CAMY").unwrap(), 3 << 16, false).unwrap();
    follower.follow_cam(master, &plan).unwrap();
    move_to(master, 0.5);
    assert!((turns(follower) - 0.5).abs() < 0.01, "{}", turns(follower));
}

#[test]
fn what_does_not_fit_is_refused_before_anything_moves() {
    let link = open("sim:tmlcan:1,2?time=virtual");
    let [master, follower] = link.axes() else { panic!("two axes") };
    let code = |result: Result<(), Error>| result.unwrap_err().code().to_owned();
    for (own, other) in [(0, 1), (1, 0), (1, -1)] {
        let ratio = GearRatio { follower: own, master: other };
        assert_eq!(code(follower.follow_gear(master, ratio)), "E217", "{own}:{other}");
    }
    let half = GearRatio { follower: 1, master: 2 };
    assert_eq!(code(follower.follow_gear(follower, half)), "E245");
    let _following = follower.armed().unwrap();
    let _leading = master.armed().unwrap();
    let point = |master, follower| CamPoint { master, follower };
    for points in [vec![point(0.0, 0.0)], vec![point(1.0, 0.0), point(0.5, 1.0)]] {
        let cam = Cam { points, memory: None, accept_inferred: true };
        assert_eq!(follower.plan_cam(master, &cam).unwrap_err().code(), "E217");
    }
    let far = vec![point(0.0, 0.0), point(1000.0, 1.0)];
    let cam = Cam { points: far, memory: None, accept_inferred: true };
    let refused = follower.plan_cam(master, &cam).unwrap_err();
    assert!(refused.to_string().contains("does not fit"), "{refused}");
    for table in ["0,0\n1,1", "master,follower\n0,0", "a [deg],b [mm]\n0,0", "a [deg],b [deg]\n0;x"]
    {
        assert_eq!(CamPoint::parse_table(table).unwrap_err().code(), "E217", "{table}");
    }
}

#[test]
fn a_follower_that_receives_nothing_is_not_coupled() {
    // Both at zero, where an older value would look like one that was received.
    let link = open("sim:tml:1,2?time=virtual");
    let [master, follower] = link.axes() else { panic!("two axes") };
    let (_leading, _following) = (master.armed().unwrap(), follower.armed().unwrap());
    let refused = follower.follow_gear(master, GearRatio { follower: 1, master: 1 }).unwrap_err();
    assert_eq!(refused.code(), "E101", "{refused}");
    assert!(refused.to_string().contains("received nothing"), "{refused}");
    move_to(master, 1.0);
    assert!(turns(follower).abs() < 0.005);
}

#[test]
fn a_follower_of_two_masters_is_not_coupled() {
    let link = open("sim:tmlcan:1,2,3?time=virtual");
    let [first, second, follower] = link.axes() else { panic!("three axes") };
    let _armed = [first.armed().unwrap(), second.armed().unwrap(), follower.armed().unwrap()];
    let ratio = GearRatio { follower: 1, master: 1 };
    move_to(first, 1.0);
    follower.follow_gear(first, ratio).unwrap();
    // The first one sends still, with the same identifier: on a real bus both would disturb each other.
    let refused = follower.follow_gear(second, ratio).unwrap_err();
    assert_eq!(refused.code(), "E602", "{refused}");
    assert!(refused.hint().contains("uncouple"), "{}", refused.hint());
    follower.uncouple(first).unwrap();
    follower.follow_gear(second, ratio).unwrap();
    assert!(turns(follower).abs() < 0.01, "{}", turns(follower));
}

#[test]
fn a_master_that_moved_by_a_distance_does_not_move_again() {
    let link = open("sim:tmlcan:1,2?time=virtual");
    let [master, follower] = link.axes() else { panic!("two axes") };
    let (_leading, _following) = (master.armed().unwrap(), follower.armed().unwrap());
    master.run(Command { target: Some(TAU), ..Command::new(Verb::MoveBy) }).unwrap();
    master.wait(LIMIT).unwrap();
    follower.follow_gear(master, GearRatio { follower: 1, master: 1 }).unwrap();
    master.sleep(Duration::from_millis(500));
    assert!((turns(master) - 1.0).abs() < 0.01, "{}", turns(master));
    master.run(Command { target: Some(TAU), ..Command::new(Verb::MoveBy) }).unwrap();
    master.wait(LIMIT).unwrap();
    master.sleep(Duration::from_millis(300));
    follower.uncouple(master).unwrap();
    master.sleep(Duration::from_millis(500));
    assert!((turns(master) - 2.0).abs() < 0.01, "{}", turns(master));
    assert!((turns(follower) - 1.0).abs() < 0.01, "{}", turns(follower));
}

#[test]
fn a_turning_master_is_not_coupled_and_goes_on() {
    let link = open("sim:tmlcan:1,2?time=virtual");
    let [master, follower] = link.axes() else { panic!("two axes") };
    let (_leading, _following) = (master.armed().unwrap(), follower.armed().unwrap());
    master.run(Command { velocity: Some(TAU), ..Command::new(Verb::Velocity) }).unwrap();
    master.sleep(Duration::from_millis(500));
    let refused = follower.follow_gear(master, GearRatio { follower: 1, master: 1 }).unwrap_err();
    assert!(refused.to_string().contains("axis 1"), "{refused}");
    let speed = master.signal_value(Signal::Velocity).unwrap().unwrap();
    assert!((speed.value - 60.0).abs() < 5.0, "{speed:?}");
    assert!(turns(follower).abs() < 0.005);
}

#[test]
fn pulses_of_an_encoder_turn_a_follower() {
    let link = open("sim:tmlcan:1?time=virtual");
    let axis = &link.axes()[0];
    let _armed = axis.armed().unwrap();
    for text in ["GEAR = 0.5", "EXTREF 2", "MODE GS", "TUM1", "UPD"] {
        axis.raw(text).unwrap();
    }
    let simulation = link.simulation().unwrap();
    for _ in 0..100 {
        assert!(simulation.act(0, 0, Act::Pulses(20)));
        axis.sleep(Duration::from_millis(1));
    }
    axis.sleep(Duration::from_millis(300));
    assert!((turns(axis) - 0.5).abs() < 0.01, "{}", turns(axis));
}
