//! Motions that last, on simulated drives behind real pseudo-terminals.
#![cfg(unix)]

use crate::run;

use run::{Held, Ran, Served, ok, polepair};

/// A drive that motions are tried on.
struct Kind {
    name: &'static str,
    /// Parameters that are set before the motion.
    prepare: &'static [&'static str],
    motions: &'static [&'static [&'static str]],
    power: &'static str,
    target: &'static str,
}

const KINDS: [Kind; 2] = [
    Kind {
        name: "tmcl:1",
        prepare: &[],
        motions: &[&["torque", "0.5A"], &["jog", "-30rpm"], &["spin", "5rad/s"]],
        power: "driver enable",
        target: "target velocity",
    },
    Kind {
        name: "modbus-rtu:1",
        prepare: &["control mode=1"],
        motions: &[&["jog", "-30rpm"], &["jog"], &["spin", "0.5turn/s"]],
        power: "internal enable",
        target: "internal speed",
    },
];

fn served(kind: &Kind) -> Served {
    let sim = Served::new(kind.name);
    kind.prepare.iter().for_each(|set| drop(ok(&["set", &sim.url, set])));
    sim
}

/// Arguments of a motion verb, with more options.
fn motion<'a>(sim: &'a Served, motion: &[&'a str], more: &[&'a str]) -> Vec<&'a str> {
    let (verb, value) = motion.split_first().expect("a verb");
    [&[*verb, sim.url.as_str()], value, more].concat()
}

fn raw(sim: &Served, name: &str) -> i64 {
    let shown = ok(&["get", &sim.url, "--raw", name]);
    shown.trim().rsplit(' ').next().expect("a number").parse().expect("a number")
}

fn stopped(sim: &Served, kind: &Kind) {
    assert_eq!((raw(sim, kind.power), raw(sim, kind.target)), (0, 0), "{}", kind.name);
}

fn refused(ran: &Ran, code: i32, error: &str) {
    assert_eq!(ran.code, code, "{}", ran.err);
    assert!(ran.err.contains(&format!("error[{error}]: ")), "{}", ran.err);
}

#[test]
fn ctrl_c_stops_what_is_held() {
    for kind in &KINDS {
        let sim = served(kind);
        for how in kind.motions {
            let held = Held::new(&motion(&sim, how, &[]), "running; Ctrl-C stops it");
            std::thread::sleep(std::time::Duration::from_millis(300));
            let ran = held.interrupt();
            assert_eq!(ran.code, 130, "{how:?}: {}", ran.err);
            assert!(ran.err.ends_with("interrupted: the motion was stopped\n"), "{}", ran.err);
            stopped(&sim, kind);
        }
        sim.end();
    }
}

#[test]
fn every_signal_that_ends_a_process_stops_the_motor_first() {
    let sim = served(&KINDS[0]);
    let each = ["QUIT", "TERM", "HUP", "TSTP", "USR1", "USR2", "ALRM", "VTALRM", "PROF", "XCPU"];
    // A terminal that closes sends several, and so does who ends a service.
    let several: [&[&str]; 3] = [&["HUP", "HUP", "CONT"], &["TERM", "HUP"], &["INT", "INT"]];
    let each = each.iter().map(std::slice::from_ref).chain(several);
    for signals in each {
        let held = Held::new(&["spin", &sim.url, "300rpm"], "running; Ctrl-C stops it");
        let ran = held.signalled(signals);
        assert_eq!(ran.code, 130, "{signals:?}: {}", ran.err);
        assert!(ran.err.ends_with("interrupted: the motion was stopped\n"), "{}", ran.err);
        stopped(&sim, &KINDS[0]);
    }
    sim.end();
}

/// Drawn on by a motion that lasts; nothing can be drawn any more once it is gone.
#[test]
fn a_terminal_that_is_gone_leaves_no_motor_turning() {
    use polepair_link::LinkIo as _;
    let sim = served(&KINDS[0]);
    let pty = polepair_link::pty::Pty::open(None).expect("a pseudo-terminal");
    let end = || {
        let file = std::fs::File::options().read(true).write(true).open(pty.path());
        std::process::Stdio::from(file.expect("its end"))
    };
    let mut child = run::command(&["spin", &sim.url, "300rpm", "--for", "3s"])
        .env_remove("NO_COLOR")
        .env("TERM", "xterm")
        .stdout(end())
        .stderr(end())
        .spawn()
        .expect("starts");
    let (mut text, mut buffer) = (String::new(), [0; 256]);
    while !text.contains("velocity") {
        let until = polepair_link::clock::now().plus_ms(60_000);
        match pty.receive(&mut buffer, until).expect("a terminal") {
            polepair_link::Received::Bytes { len, .. } => {
                text.push_str(&String::from_utf8_lossy(&buffer[..len]));
            }
            other => panic!("{other:?}: {text}"),
        }
    }
    drop(pty);
    // The motor was stopped, and the speed that it reached could not be printed.
    assert_eq!(child.wait().expect("ends").code(), Some(3));
    stopped(&sim, &KINDS[0]);
    sim.end();
}

#[test]
fn a_motion_for_a_time_stops_by_itself() {
    for kind in &KINDS {
        let sim = served(kind);
        for how in kind.motions {
            let began = std::time::Instant::now();
            ok(&motion(&sim, how, &["--for", "400ms"]));
            assert!(began.elapsed().as_millis() >= 400);
            stopped(&sim, kind);
        }
        sim.end();
    }
}

#[test]
fn a_detached_motion_goes_on_and_says_what_stops_it() {
    for kind in &KINDS {
        let sim = served(kind);
        for how in kind.motions {
            let ran = polepair(&motion(&sim, how, &["--detach"]));
            let last = ran.err.lines().last().expect("a line");
            let stop = last.strip_prefix("left running; to stop it: polepair ").expect(last);
            assert_eq!(ran.code, 0);
            std::thread::sleep(std::time::Duration::from_millis(300));
            assert_eq!(raw(&sim, kind.power), 1, "{how:?}");
            // The very words that were printed.
            ok(&stop.split(' ').collect::<Vec<_>>());
            ok(&["disable", &sim.url]);
            stopped(&sim, kind);
        }
        sim.end();
    }
}

#[test]
fn a_profile_of_ones_own_is_among_the_words_that_stop() {
    let sim = served(&KINDS[1]);
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/examples/feeder.toml");
    let ran = polepair(&["spin", &sim.url, "30rpm", "--detach", "--profile", file]);
    let last = ran.err.lines().last().expect("a line");
    let stop = last.strip_prefix("left running; to stop it: polepair ").expect(last);
    assert_eq!(stop, format!("stop {} --profile {file}", sim.url));
    ok(&stop.split(' ').collect::<Vec<_>>());
}

#[test]
fn limits_and_units_are_checked_before_anything_is_sent() {
    let sim = served(&KINDS[0]);
    for (torque, code) in [
        ("99A", "E216"),
        ("-21A", "E216"),
        ("1Nm", "E217"),
        ("50%", "E217"),
        ("30rpm", "E217"),
        ("A", "E217"),
        ("nan", "E217"),
    ] {
        refused(&polepair(&["torque", &sim.url, torque, "--for", "1s"]), 2, code);
    }
    assert_eq!(polepair(&["jog", &sim.url, "--for", "1s", "--detach"]).code, 2);
    // A module of this kind has its driver enabled from power-on; the test did not enable it.
    assert_eq!((raw(&sim, KINDS[0].power), raw(&sim, KINDS[0].target)), (1, 0));
    sim.end();
    let sim = served(&KINDS[1]);
    let trace = std::env::temp_dir().join(format!("polepair-limit-{}.log", std::process::id()));
    let trace = trace.to_str().expect("text");
    let far = ["jog", &sim.url, "99999rpm", "--for", "1s", "--trace", trace];
    refused(&polepair(&far), 2, "E216");
    // Not even the motor's power was put on.
    let frames = ok(&["decode", trace, "--as", "modbus-rtu"]);
    std::fs::remove_file(trace).expect("removed");
    assert!(frames.contains("read") && !frames.contains("write"), "{frames}");
    refused(&polepair(&["jog", &sim.url, "1A", "--for", "1s"]), 2, "E217");
    refused(&polepair(&["torque", &sim.url, "10%", "--for", "1s"]), 2, "E218");
    stopped(&sim, &KINDS[1]);
    sim.end();
}

#[test]
fn a_drive_that_refuses_is_exit_code_6() {
    let sim = Served::new("modbus-rtu:1");
    let ran = polepair(&["jog", &sim.url, "--for", "1s"]);
    refused(&ran, 6, "E602");
    assert!(ran.err.contains("set Fn_00 = 1 for speed"), "{}", ran.err);
    sim.end();
}

/// A supply that is too low, before and during the motion.
#[test]
fn a_drive_that_faults_is_exit_code_8() {
    let rack = std::env::temp_dir().join(format!("polepair-weak-{}.toml", std::process::id()));
    let path = rack.to_str().expect("text");
    let drive = "[[link]]\n[[link.drive]]\nprofile = \"syntron-ts\"\n";
    std::fs::write(&rack, format!("{drive}supply = 10.0\n")).expect("a rack");
    let sim = Served::new(path);
    ok(&["set", &sim.url, "control mode=1"]);
    let ran = polepair(&["jog", &sim.url, "--for", "2s"]);
    assert_eq!(ran.code, 8, "{}", ran.err);
    assert!(ran.err.contains("ERR_"), "{}", ran.err);
    stopped(&sim, &KINDS[1]);
    sim.end();
    std::fs::remove_file(&rack).expect("a rack");
}
