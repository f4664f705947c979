use crate::simulate::rack_of_text;
use crate::{Connector, LocalAxis, LocalLink};
use polepair_core::axis::{Command, Verb};
use polepair_core::profile::Signal;
use polepair_core::stream::{PathKind, Point};
use polepair_core::time::Instant;
use std::time::Duration;

const TMCM: &str = "profile = 'tmcm-171'\n";

/// A rack of one drive, opened.
fn opened(name: &str, drive: &str) -> LocalLink {
    let file = std::env::temp_dir().join(format!("polepair-{}-{name}.toml", std::process::id()));
    std::fs::write(&file, format!("[[link]]\nname = 'l'\n[[link.drive]]\nname = 'x'\n{drive}"))
        .expect("a folder for temporary files");
    let url = format!("rack:{}?time=virtual#x", file.display());
    let link = Connector::default().connect_local(&url);
    std::fs::remove_file(&file).expect("it was written");
    link.unwrap_or_else(|error| panic!("{drive}: {error}"))
}

fn position(axis: &LocalAxis) -> f64 {
    axis.signals(&[Signal::Position]).expect("it tells its position")[0].value
}

/// Travel of the motor itself, rad.
fn turned(link: &LocalLink) -> f64 {
    link.simulation().expect("simulated").truth(0, 0).expect("a drive").position
}

fn refused(error: &crate::Error, text: &str) {
    assert_eq!(error.code(), "E223", "{error}");
    assert!(error.to_string().contains(text), "{error}");
}

#[test]
fn a_lead_and_a_gear_make_turns_of_a_length() {
    let link = opened("lead", &format!("{TMCM}lead = '5 mm'\ngear = 2"));
    let axis = link.axes()[0].armed().expect("it can be enabled");
    axis.move_to("10 mm").expect("a move");
    axis.wait(Duration::from_secs(60)).expect("it arrives");
    // Two turns of the spindle are four of the motor.
    assert!((turned(&link) - 4.0 * core::f64::consts::TAU).abs() < 0.05, "{}", turned(&link));
    assert!((position(&axis) - 0.01).abs() < 1e-4, "{}", position(&axis));
    assert_eq!(axis.get("actual position").expect("read").unit.symbol(), "mm");
    axis.set("max positioning velocity", "20 mm/s").expect("a setting of the motion");
    let speed = axis.get("max positioning velocity").expect("read");
    assert!((speed.value - 20.0).abs() < 0.1 && speed.unit.symbol() == "mm/s", "{speed}");
    // What is no motion's keeps the motor's unit; an angle is no length.
    assert_eq!(axis.get("max current").expect("read").unit.symbol(), "A");
    assert_eq!(axis.move_to("90 deg").expect_err("an angle").code(), "E217");
}

#[test]
fn inverted_turns_the_sign_of_all_that_has_one() {
    let link = opened("inverted", &format!("{TMCM}direction = 'inverted'"));
    let axis = link.axes()[0].armed().expect("it can be enabled");
    axis.velocity("120 rpm").expect("a speed");
    link.sleep(Duration::from_secs(2));
    assert!(turned(&link) < -1.0, "{}", turned(&link));
    let read = axis.signals(&[Signal::Velocity, Signal::TargetVelocity]).expect("it tells");
    assert!(read.iter().all(|reading| reading.value > 0.0), "{read:?}");
    assert!(axis.state().reading(Signal::Velocity).value > 0.0);
    axis.stop().expect("a stop");
    let before = position(&axis);
    axis.move_by("90 deg").expect("a move");
    axis.wait(Duration::from_secs(60)).expect("it arrives");
    assert!((position(&axis) - before - core::f64::consts::FRAC_PI_2).abs() < 0.02);
}

#[test]
fn limits_are_looked_at_before_a_byte_is_sent() {
    let limits = "limits = { position = ['-90 deg', '180 deg'], velocity = '120 rpm' }";
    let link = opened("limits", &format!("{TMCM}{limits}"));
    let axis = link.axes()[0].armed().expect("it can be enabled");
    let frames = || link.counters(&axis).sent;
    let before = frames();
    let error = axis.move_to("200 deg").expect_err("beyond");
    refused(&error, "200 deg is beyond its limits, -90 deg to 180 deg");
    assert!(error.to_string().contains("limits.toml:"), "{error}");
    assert_eq!(frames(), before, "nothing was sent");
    let too_fast = Command { velocity: Some(20.0), ..target(Verb::MoveTo, 1.0) };
    refused(&axis.run(too_fast).expect_err("too fast"), "more than its limit, 120 rpm");
    refused(&axis.velocity("-300 rpm").expect_err("too fast"), "120 rpm");
    // The factory's speed is more than the limit: the limit is sent with the move.
    axis.move_to("170 deg").expect("within");
    axis.wait(Duration::from_secs(60)).expect("it arrives");
    let speed = axis.get("max positioning velocity").expect("read").value;
    assert!((speed - 120.0).abs() < 1.0, "{speed}");
    // From here, so far is too far; the way back is not.
    refused(&axis.move_by("20 deg").expect_err("beyond"), "is beyond its limits");
    axis.move_by("-20 deg").expect("within");
    axis.wait(Duration::from_secs(60)).expect("it arrives");
    assert!(axis.predict_limit_violation(Duration::from_millis(100)).expect("read").is_none());
    refused(&axis.set("target velocity", 10.0).expect_err("who would watch it"), "within limits");
}

fn target(verb: Verb, at: f64) -> Command {
    Command { target: Some(at), ..Command::new(verb) }
}

#[test]
fn a_speed_that_leaves_the_limits_is_reported() {
    let limits = "limits = { position = ['-1 turn', '1 turn'] }";
    let link = opened("spin", &format!("{TMCM}{limits}"));
    let axis = link.axes()[0].armed().expect("it can be enabled");
    axis.velocity("60 rpm").expect("within");
    let end = link.simulation().expect("simulated").now() + Duration::from_secs(3);
    let now = || -> Instant { link.simulation().expect("simulated").now() };
    while axis.predict_limit_violation(Duration::from_millis(300)).expect("read").is_none()
        && now() < end
    {
        link.sleep(Duration::from_millis(25));
    }
    assert!(now() < end, "it was told");
    axis.stop().expect("a stop");
    assert!(turned(&link) < core::f64::consts::TAU, "{}", turned(&link));
}

#[test]
fn a_path_is_looked_at_between_its_points() {
    let drive = "profile = 'technosoft-f514l'\nlimits = { position = ['0 deg', '90 deg'] }";
    let link = opened("path", drive);
    let axis = link.axes()[0].armed().expect("it can be enabled");
    let point = |position, velocity| Point { position, velocity, time: 0.5 };
    // Both points are within; the cubic between them is not.
    let over = [point(1.5, 20.0), point(1.5, 0.0)];
    refused(&axis.stream(PathKind::Pvt, over).expect_err("beyond"), "is beyond its limits");
    let within = [point(0.5, 1.0), point(1.0, 0.0)];
    assert_eq!(axis.stream(PathKind::Pvt, within).expect("a path"), 2);
}

#[test]
fn wrong_files_are_reported_with_line_and_reason() {
    for (drive, output) in [
        ("lead = '5 deg'", "r.toml:4:8: `5 deg`: the axis is linear, but the value is an angle"),
        ("lead = '5'", "r.toml:4:8: `5`: add a unit, such as mm"),
        ("gear = 0", "r.toml:4:8: `gear` is 0; it must be more than 0"),
        ("direction = 'invertd'", "did you mean `inverted`?"),
        ("counts = 100", "reports its position in deg"),
        ("limits = { positon = [] }", "unknown key `positon`; did you mean `position`?"),
        ("limits = { position = ['1 turn'] }", "is two ends"),
        ("limits = { position = ['1 turn', '0 deg'] }", "the first end"),
        (
            "limits = { position = ['1 mm', '2 mm'] }",
            "the axis is rotary, but the value is a \
         length",
        ),
        ("limits = { torque = '1 rpm' }", "a current is wanted, but a velocity was given"),
        ("name = 'g1'", "cannot stand behind `#`"),
    ] {
        let text = format!("[[link]]\n[[link.drive]]\n{TMCM}{drive}");
        let error = rack_of_text("r.toml", &text, 1).expect_err(drive);
        assert!(error.to_string().contains(output), "{drive}: {error}");
    }
}
