//! Stored paths of a SYNTRON TS: docs/guides/paths.md.

use std::time::Duration;

use polepair::paths::{PathChainEnd, PathTable, PathUnit, PreviewEnd};
use polepair::{Axis, LocalLink, connect_local};
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;

/// Two paths that lead to each other's neighbour, and one relative to them.
const FEEDER: &str = r#"
version = 1
motor_turns = 1
travel = "360 deg"

[paths.1]
kind = "auto"
end = "absolute"
position = "90 deg"
speed = "300 rpm"
acceleration = "200 ms"
deceleration = "200 ms"
delay = "100 ms"
next = 2

[paths.2]
kind = "auto"
end = "from-last-end"
position = "-45.5 deg"
speed = "60 rpm"
acceleration = "200 ms"
deceleration = "200 ms"
s_time = "50 ms"
next = 3

[paths.3]
kind = "single"
end = "from-here"
position = "720 deg"
speed = "600 rpm"
acceleration = "100 ms"
deceleration = "100 ms"
interrupts = true
"#;
const LONG: Duration = Duration::from_secs(60);

fn table(text: &str) -> PathTable {
    PathTable::parse("paths.toml", text).expect("a table")
}

fn read(axis: &Axis) -> PathTable {
    PathTable::read(axis, None, |_| {}).expect("read")
}

/// A drive in internal position mode with these paths.
fn loaded(text: &str) -> (LocalLink, Axis) {
    let link = connect_local("sim:syntron-ts?fn00=14&time=virtual").expect("a link");
    let axis = Axis::from(link.axes()[0].clone());
    table(text).write(&axis, &read(&axis), false).expect("written");
    (link, axis)
}

fn run(axis: &Axis, number: u8) {
    axis.arm().expect("armed");
    axis.run(Command::new(Verb::Enable)).expect("powered");
    axis.run_path(number).expect("started");
}

#[test]
fn paths_are_read_as_they_were_written_on_both_wires() {
    let wanted = table(FEEDER);
    for url in ["sim:syntron-ts?time=virtual", "sim:syntron-ts-canopen?time=virtual"] {
        let link = connect_local(url).expect("a link");
        let axis = Axis::from(link.axes()[0].clone());
        let before = read(&axis);
        assert!(before.paths.is_empty() && before.unit == PathUnit::Degree, "{url}");
        wanted.write(&axis, &before, false).expect("written");
        let kept = read(&axis);
        assert_eq!(kept, wanted, "{url}");
        // What is saved is a file of the same paths.
        assert_eq!(table(&kept.to_string()), wanted, "{url}");
        // Shorter ramps than twice the S-time of now, and back: whichever is first is refused by the drive.
        let short = FEEDER
            .replace("\"200 ms\"", "\"20 ms\"")
            .replace("s_time = \"50 ms\"", "s_time = \"5 ms\"");
        table(&short).write(&axis, &kept, false).expect("shorter ramps");
        wanted.write(&axis, &read(&axis), false).expect("longer ramps");
        assert_eq!(read(&axis), wanted, "{url}");
    }
}

#[test]
fn a_run_follows_the_chain_to_its_measured_end() {
    let (_link, axis) = loaded(FEEDER);
    let paths = read(&axis);
    let from = paths.position(&axis).expect("a position");
    run(&axis, 1);
    axis.wait(LONG).expect("ended");
    let arrival = paths.check_arrival(&axis, 1, from).expect("arrived");
    assert_eq!(arrival.expected, Some(90.0 - 45.5 + 720.0));
    // The manual's own recipe, again: only the edge of the trigger starts it.
    axis.run_path(3).expect("started");
    axis.wait(LONG).expect("ended");
    let arrival = paths.check_arrival(&axis, 3, arrival.position).expect("arrived");
    assert!((arrival.position - 764.5 - 720.0).abs() < 1.0, "{arrival:?}");
}

#[test]
fn a_run_that_something_ends_has_not_arrived() {
    for (parameter, raw) in [("path stop", 1), ("internal enable", 0)] {
        let (link, axis) = loaded(FEEDER);
        let paths = read(&axis);
        run(&axis, 1);
        link.sleep(Duration::from_millis(300));
        axis.set_raw(parameter, raw).expect("written");
        let ended = axis.wait(LONG).and_then(|()| paths.check_arrival(&axis, 1, 0.0).map(drop));
        let error = ended.expect_err("it has not arrived");
        assert!(["E102", "E106"].contains(&error.code()), "{parameter}: {error}");
    }
}

#[test]
fn numbers_that_no_path_has_and_axes_without_paths_start_nothing() {
    let (_link, axis) = loaded(FEEDER);
    let error = axis.run_path(1).expect_err("not armed");
    assert_eq!(error.code(), "E219", "{error}");
    axis.arm().expect("armed");
    for number in [0.0, 33.0, 1.5, -1.0] {
        let command = Command { path: Some(number), ..Command::new(Verb::RunPath) };
        let error = axis.run(command).expect_err("no such path");
        assert_eq!(error.code(), "E216", "{number}: {error}");
    }
    for url in ["sim:tmcl?time=virtual", "sim:syntron-ts-canopen?time=virtual"] {
        let link = connect_local(url).expect("a link");
        let axis = Axis::from(link.axes()[0].clone());
        let error = axis.run_path(1).expect_err("no paths, or none that this wire can stop");
        assert_eq!(error.code(), "E218", "{error}");
    }
}

#[test]
fn a_move_overwrites_the_path_that_is_named_and_no_other() {
    let (_link, axis) = loaded(FEEDER);
    axis.arm().expect("armed");
    axis.run(Command::new(Verb::Enable)).expect("powered");
    for (path, kept) in [(Some(5.0), 32), (None, 4)] {
        let before = read(&axis);
        let target = Some(std::f64::consts::PI);
        axis.run(Command { target, path, ..Command::new(Verb::MoveBy) }).expect("moved");
        axis.wait(LONG).expect("arrived");
        let after = read(&axis);
        let own = path.map_or(32, |path| path as u8);
        assert_eq!(after.path(own).thousandths, 180_000);
        assert_eq!(after.path(kept), before.path(kept));
        assert_eq!(after.path(1), before.path(1));
    }
}

#[test]
fn definition_words_without_meaning_are_refused() {
    let (_link, axis) = loaded(FEEDER);
    for (name, raw) in [
        ("path 1 definition 1", 4),
        ("path 1 definition 1", 333),
        ("path 1 definition 1", 2002),
        ("path 1 definition 1", 11_002),
        ("path 7 definition 2", 2),
        ("path 7 definition 2", 3001),
        ("homing way", 50_000),
        ("homing way", 34),
    ] {
        let error = axis.set_raw(name, raw).expect_err("a digit means nothing");
        assert_eq!(error.code(), "E216", "{name} = {raw}: {error}");
    }
    axis.set_raw("path 1 definition 1", 1053).expect("AUTO to path 5, absolute");
}

#[test]
fn chains_are_followed_and_their_faults_found() {
    let paths = table(FEEDER);
    assert_eq!(paths.chain(1).numbers, [1, 2, 3]);
    assert_eq!((paths.first_paths(), paths.check()), (vec![1], Vec::new()));
    for (from, to, wanted) in [
        ("next = 3", "next = 9", "path 2: it leads to path 9, which is empty"),
        ("next = 3", "", "path 2: it is AUTO, and names no next path"),
        ("\"50 ms\"", "\"100 ms\"", "path 2: its S-time of 100 ms must be less than half"),
        ("\"600 rpm\"", "\"0 rpm\"", "path 3: at a speed of 0 it never arrives"),
        ("next = 3", "next = 1", "path 1: it never ends: 1 -> 2 -> 1, again and again"),
        (
            "\n\n[paths.1]",
            "\nrange = [\"0 deg\", \"80 deg\"]\n[paths.1]",
            "path 1: it goes to 90 deg",
        ),
        (
            "\n\n[paths.1]",
            "\nrange = [\"50 deg\", \"90 deg\"]\n[paths.1]",
            "path 2: behind the paths before it",
        ),
    ] {
        let found = table(&FEEDER.replacen(from, to, 1)).check();
        let texts: Vec<String> = found.iter().map(ToString::to_string).collect();
        assert!(texts.iter().any(|text| text.starts_with(wanted)), "{wanted}: {texts:?}");
    }
    let turning =
        table(&FEEDER.replace("kind = \"auto\"\nend = \"from", "kind = \"speed\"\nend = \"from"));
    assert_eq!(turning.chain(1).end, PathChainEnd::TurnsOn);
    // A path with an error is not written.
    let (_link, axis) = loaded(FEEDER);
    let wrong = table(&FEEDER.replace("next = 3", "next = 9"));
    let error = wrong.write(&axis, &read(&axis), false).expect_err("refused");
    assert_eq!((error.code(), read(&axis)), ("E217", paths));
}

#[test]
fn the_preview_ends_where_the_drive_does() {
    let (_link, axis) = loaded(FEEDER);
    let paths = read(&axis);
    let preview = paths.preview(1, 0, LONG).expect("a preview");
    assert_eq!(preview.end, PreviewEnd::Stopped);
    run(&axis, 1);
    axis.wait(LONG).expect("ended");
    let at = paths.position(&axis).expect("a position");
    assert!((preview.end_position() - at).abs() < 0.5, "{} and {at}", preview.end_position());
    // From elsewhere, relative paths end elsewhere, and absolute ones where they did.
    let shifted = paths.preview(3, 90_000, LONG).expect("a preview");
    assert!((shifted.end_position() - 810.0).abs() < 0.5, "{}", shifted.end_position());
    let endless = table(&FEEDER.replace("kind = \"single\"", "kind = \"speed\""));
    let preview = endless.preview(1, 0, Duration::from_secs(5)).expect("a preview");
    assert_eq!((preview.end, preview.duration()), (PreviewEnd::Running, Duration::from_secs(5)));
}

#[test]
fn files_say_where_they_are_wrong() {
    for (from, to, wanted) in [
        ("\"90 deg\"", "\"90 mm\"", "9:12: "),
        ("\"90 deg\"", "\"90\"", "9:12: "),
        ("\"90 deg\"", "\"90.0001 deg\"", "thousandths of a deg"),
        ("\"90 deg\"", "\"400000 deg\"", "counts to 327679.999 deg"),
        ("\"300 rpm\"", "\"300 deg\"", "a speed is that of the motor"),
        ("\"300 rpm\"", "\"-300 rpm\"", "the sign of `position` is the direction"),
        ("\"200 ms\"", "\"200 rpm\"", "a time has a unit"),
        ("\"200 ms\"", "\"70 s\"", "0 to 65535"),
        ("\"auto\"", "\"aut\"", "speed, single, auto"),
        ("\"absolute\"", "\"relative\"", "absolute, from-last-end, from-here"),
        ("paths.1]", "paths.33]", "paths are numbered 1 to 32"),
        ("next = 2", "next = 33", "it must be 1 to 32"),
        ("next = 2", "nxet = 2", "unknown key `nxet`"),
        ("\"360 deg\"", "\"0.5 deg\"", "counts whole deg"),
        ("\"360 deg\"", "\"360\"", "a position has a unit"),
        ("\n\n[paths.1]", "\nrange = [\"0 deg\"]\n[paths.1]", "`range` is two positions"),
    ] {
        let text = FEEDER.replacen(from, to, 1);
        let error = PathTable::parse("paths.toml", &text).expect_err("wrong").to_string();
        assert!(error.contains(wanted), "{wanted}: {error}");
    }
    let linear =
        FEEDER.replace("360 deg", "10 mm").replace(" deg\"", " mm\"").replace("90 mm", "9 cm");
    assert_eq!(table(&linear).path(1).thousandths, 90_000);
}

#[test]
fn an_s_time_that_no_ramp_has_is_refused_before_the_first_write() {
    let (link, axis) = loaded(FEEDER);
    axis.arm().expect("armed");
    axis.run(Command::new(Verb::Enable)).expect("powered");
    let before = link.simulation().and_then(|world| world.truth(0, 0)).expect("its truth");
    for (s_time, acceleration) in [("100 ms", None), ("500 ms", Some(300.0))] {
        let s_time =
            axis.argument(Verb::CurveTo, Argument::JerkTime, &s_time.into()).expect("a time");
        let rad_per_s2 =
            acceleration.map(|rpm_per_s: f64| rpm_per_s / 60.0 * std::f64::consts::TAU);
        let command = Command {
            target: Some(1.0),
            jerk_time: Some(s_time),
            acceleration: rad_per_s2,
            ..Command::new(Verb::CurveTo)
        };
        let error = axis.run(command).expect_err("half a ramp or more");
        assert_eq!(error.code(), "E217", "{error}");
    }
    let after = link.simulation().and_then(|world| world.truth(0, 0)).expect("its truth");
    assert_eq!(after.starts, before.starts);
    let kept = Command { target: Some(1.0), jerk_time: Some(0.09), ..Command::new(Verb::CurveTo) };
    axis.run(kept).expect("within half of 200 ms");
    axis.wait(LONG).expect("arrived");
}

#[test]
fn a_register_that_a_password_locks_is_named_with_what_opens_it() {
    let link = connect_local("sim:syntron-ts?locked=95,9A&time=virtual").expect("a link");
    let axis = Axis::from(link.axes()[0].clone());
    let error = axis.set_raw("max speed in torque mode", 500).expect_err("locked");
    let hint = error.hint();
    assert!(error.code() == "E601" && hint.contains("Fn_3F = 9876 opens"), "{error}: {hint}");
    axis.set_raw("password", 9876).expect("opened");
    axis.set_raw("max speed in torque mode", 500).expect("written");
    let error = connect_local("sim:syntron-ts?locked=95,wrong").expect_err("no register");
    assert!(error.to_string().contains("95,wrong"), "{error}");
}
