//! `polepair stop`: with and without axes, and where it cannot.
#![cfg(unix)]

use crate::run;

use run::{Served, polepair};
use std::collections::BTreeSet;
use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc;

/// Sets a drive up or reads from it. It replies, so time-outs are long.
fn ok(arguments: &[&str]) -> String {
    run::expecting_replies(|| run::ok(arguments))
}

#[test]
fn every_drive_is_reported_as_soon_as_it_is_found() {
    let sim = Served::new("tmcl:1,5");
    ok(&["spin", &sim.url, "300rpm", "--detach"]);
    run::expect_silence();
    let ran = polepair(&["stop", &format!("{}?timeout=150", sim.link())]);
    let lines: Vec<&str> = ran.err.lines().collect();
    let reports = ["axis 1 is being stopped", "axis 5 is being stopped"];
    let rested = ["axis 1 is stopped", "axis 5 is stopped"];
    assert_eq!(
        (&lines[..2], &lines[2..4], ran.code),
        (&reports[..], &rested[..], 0),
        "{}",
        ran.err
    );
    // Whom it may have missed.
    assert!(ran.err.contains("\nasked 32 addresses for 150 ms each; "), "{}", ran.err);
    for velocity in ok(&["get", &sim.url, "actual velocity"]).lines() {
        assert!(velocity.ends_with("= 0 rpm"), "{velocity}");
    }
    sim.end();
}

/// A stop works without its frame file, and warns that there is none.
#[test]
fn a_trace_that_cannot_be_written_keeps_no_motor_turning() {
    let sim = Served::new("tmcl:1");
    let missing = std::env::temp_dir().join(format!("polepair-none-{}/trace", std::process::id()));
    let missing = missing.to_str().expect("a path");
    let full = cfg!(target_os = "linux").then_some(("/dev/full", "frames are missing in the file"));
    for (file, text) in [(missing, "No frame is recorded.")].into_iter().chain(full) {
        ok(&["spin", &sim.url, "300rpm", "--detach"]);
        let ran = polepair(&["stop", &sim.url, "--trace", file]);
        assert_eq!(ran.code, 0, "{}", ran.err);
        assert!(ran.err.contains("axis 1 is stopped\n"), "{}", ran.err);
        let warnings = ran.err.lines().filter(|line| line.starts_with("warning: "));
        assert_eq!(warnings.filter(|line| line.contains(text)).count(), 1, "{}", ran.err);
    }
    // A verb that reads needs its file of frames.
    let ran = polepair(&["get", &sim.url, "actual velocity", "--trace", missing]);
    assert_eq!((ran.code, ran.err.contains("error[E301]")), (3, true), "{}", ran.err);
    sim.end();
}

#[test]
fn all_axes_are_commanded_at_once_where_the_protocol_can() {
    run::expect_silence();
    let sim = Served::new("tml:255");
    let ran = polepair(&["stop", &format!("{}?timeout=300", sim.link()), "-v"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    let (all, first) = (ran.err.find("STOP, to everybody"), ran.err.find("GETVERSION"));
    assert!(all.is_some() && all < first, "{}", ran.err);
    assert!(
        ran.err.contains("a broadcast stop was sent, without confirmation; asked "),
        "{}",
        ran.err
    );
    sim.end();
}

#[test]
fn modbus_registers_are_broadcast_to_known_drives_alone() {
    let sim = Served::new("modbus-rtu:1");
    ok(&["set", &sim.url, "control mode=1"]);
    run::expect_silence();
    for (query, sent) in [("timeout=150", false), ("timeout=150&profile=syntron-ts", true)] {
        ok(&["spin", &sim.url, "300rpm", "--detach"]);
        let url = format!("{}?{query}", sim.link());
        let ran = polepair(&["stop", &url, "-v"]);
        // There is no time for the last addresses at so long a time each.
        assert!(ran.code == 0 || ran.err.contains("error[E703]"), "{}", ran.err);
        assert!(ran.err.contains("axis 1 is stopped\n"), "{}", ran.err);
        assert_eq!(ran.err.contains("00 06 00 33 00 00"), sent, "{}", ran.err);
        assert_eq!(ok(&["get", &sim.url, "internal speed"]), "internal speed = 0 rpm\n");
    }
    sim.end();
}

#[test]
fn propellers_are_found_and_stopped_without_their_numbers() {
    run::expect_silence();
    let group = format!("239.74.163.2:{}", 46_000 + std::process::id() % 4_000);
    let sim = Served::with(&["thruster:11,12", "--udp", &group]);
    let axes = [11, 12].map(|axis| format!("{}#{axis}", sim.link()));
    for axis in &axes {
        ok(&["spin", axis, "300rpm", "--detach"]);
    }
    let ran = polepair(&["stop", sim.link()]);
    // A busy machine has no time for the last addresses, and reports that.
    assert!(ran.code == 0 || ran.err.contains("error[E703]"), "{}", ran.err);
    for text in ["axis 11 is stopped\n", "axis 12 is stopped\n"] {
        assert!(ran.err.contains(text), "{}", ran.err);
    }
    for axis in &axes {
        assert_eq!(ok(&["get", axis, "speed"]), "speed = 0 rpm\n");
    }
    sim.end();
}

#[test]
fn a_silent_drive_keeps_no_other_turning() {
    let sim = Served::new("tmcl:3");
    ok(&["spin", &sim.url, "300rpm", "--detach"]);
    run::expect_silence();
    let ran = polepair(&["stop", &format!("{}#1,3", sim.link())]);
    assert_eq!(ran.code, 7, "{}", ran.err);
    assert!(ran.err.contains("axis 3 is stopped\n"), "{}", ran.err);
    assert!(ran.err.contains("error[E401]: axis 1 does not answer"), "{}", ran.err);
    assert!(ran.err.contains("error[E702]: one stop of 2 is not confirmed."), "{}", ran.err);
    assert_eq!(ok(&["get", &sim.url, "target velocity"]), "target velocity = 0 rpm\n");
    sim.end();
}

/// A TMCL module made from the protocol's manual, nine bytes a datagram: what it answers with to a command
/// and its motor, if it does. Returns where it listens, and the end of its only connection.
pub(crate) fn module(
    mut answer: impl FnMut(u8, u8) -> Option<(u8, i32)> + Send + 'static,
) -> (String, std::thread::JoinHandle<()>) {
    let server = TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("tmcl+tcp://{}#1", server.local_addr().expect("an address"));
    let module = std::thread::spawn(move || {
        let (mut wire, _) = server.accept().expect("a host");
        let mut request = [0; 9];
        while wire.read_exact(&mut request).is_ok() {
            let [address, opcode, _, motor, ..] = request;
            let Some((status, value)) = answer(opcode, motor).filter(|_| address == 1) else {
                continue;
            };
            let mut reply = [2, 1, status, opcode, 0, 0, 0, 0, 0];
            reply[4..8].copy_from_slice(&value.to_be_bytes());
            reply[8] = reply[..8].iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte));
            wire.write_all(&reply).expect("a host");
        }
    });
    (url, module)
}

/// One with two motors: MST with the motor in its third byte, status 4 for a motor that it has not.
#[test]
fn a_module_with_several_motors_has_all_of_them_stopped() {
    let (sender, commands) = mpsc::channel();
    let mut turns = true;
    let (url, module) = module(move |opcode, motor| match (opcode, motor) {
        // No profile describes it, and it reports a position of any motor.
        (136, _) => Some((100, 0x0FA0_0112)),
        (3, 0..2) => {
            turns &= motor != 0;
            sender.send(motor).expect("somebody counts");
            Some((100, 0))
        }
        (3, _) => Some((4, 0)),
        (6, _) => Some((100, i32::from(turns) * 300)),
        _ => Some((2, 0)),
    });
    let ran = polepair(&["stop", &url]);
    module.join().expect("a module");
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(
        ran.err.contains(
            "module 1: motor 1 acknowledged the stop too; their standstill was not \
         checked\n"
        ),
        "{}",
        ran.err
    );
    let order: Vec<u8> = commands.iter().collect();
    assert_eq!(&order[..2], &[0, 1]);
}

/// A module with six motors, one of which does not reply: the others get their stop all the same.
#[test]
fn a_motor_that_is_not_answered_keeps_no_other_from_its_stop() {
    run::expect_silence();
    let (sender, commands) = mpsc::channel();
    let (url, module) = module(move |opcode, motor| match (opcode, motor) {
        (136, _) => Some((100, 0x17DE_0112)),
        (3, 2) => None,
        (3, 0..6) => {
            sender.send(motor).expect("somebody counts");
            Some((100, 0))
        }
        (3, _) => Some((4, 0)),
        _ => Some((100, 0)),
    });
    let ran = polepair(&["stop", &url]);
    module.join().expect("a module");
    let reports: BTreeSet<u8> = commands.iter().collect();
    assert_eq!(reports, [0, 1, 3, 4, 5].into());
    assert_eq!(ran.code, 7, "{}", ran.err);
    for text in [
        "axis 1.1 is stopped\n",
        "axis 1.2 may still turn: cut its supply\n",
        "axis 1.5 is stopped\n",
    ] {
        assert!(ran.err.contains(text), "{text}: {}", ran.err);
    }
}

#[test]
fn a_stop_that_reaches_no_axis_reports_it() {
    run::expect_silence();
    let sim = Served::new("tmcl:40");
    let ran = polepair(&["stop", sim.link()]);
    assert_eq!(ran.code, 4, "{}", ran.err);
    assert!(ran.err.contains("error[E403]: no drive answered.\n"), "{}", ran.err);
    assert!(ran.err.contains("asked 32 addresses for 30 ms each; "), "{}", ran.err);
    assert!(ran.err.contains("No address replied. No stop was sent."), "{}", ran.err);
    sim.end();
}

/// The rules of the protocol forbid it: a request that may not be sent proves nothing about the drive.
#[test]
fn a_stop_that_the_protocol_cannot_send_says_that_nothing_was() {
    let sim = Served::new("technosoft-f514l:255");
    let ran = polepair(&["stop", &format!("{}?host=255#1", sim.link())]);
    assert_eq!(ran.code, 2, "{}", ran.err);
    assert!(
        ran.err.contains("error[E222]: ") && ran.err.contains("Nothing was sent."),
        "{}",
        ran.err
    );
    sim.end();
}

/// A module that replies to another host does not reply to this one, and the line is not silent.
#[test]
fn bytes_received_instead_of_a_reply_are_reported() {
    run::expect_silence();
    let sim = Served::new("tmcl:1");
    let url = format!("{}?host=3&timeout=150", sim.link());
    for verb in ["stop", "scan"] {
        let ran = polepair(&[verb, &url]);
        assert_eq!(ran.code, 4, "{}", ran.err);
        assert!(ran.err.contains("No address replied, but frames were received: "), "{}", ran.err);
        assert!(
            ran.err.contains("it replies to host 2") && !ran.err.contains("silent"),
            "{}",
            ran.err
        );
        let tried = "tried addresses without a reply, although frames arrived (";
        assert_eq!(ran.err.contains(tried), verb == "scan", "{}", ran.err);
    }
    sim.end();
}

#[test]
fn a_silent_drive_leaves_no_other_with_power() {
    let sim = Served::new("tmcl:3");
    ok(&["spin", &sim.url, "300rpm", "--detach"]);
    run::expect_silence();
    let ran = polepair(&["disable", &format!("{}#1,3", sim.link())]);
    assert_eq!(ran.code, 7, "{}", ran.err);
    for text in ["axis 3 ", "error[E401]: axis 1 does not answer", "error[E704]: 1 of 2 axes"] {
        assert!(ran.err.contains(text), "{}", ran.err);
    }
    assert_eq!(ok(&["get", &sim.url, "driver enable"]), "driver enable = off\n");
    sim.end();
}

#[test]
fn an_axis_that_is_named_twice_is_stopped_once() {
    let sim = Served::new("tmcl:1");
    ok(&["spin", &sim.url, "300rpm", "--detach"]);
    let ran = polepair(&["stop", &format!("{},1", sim.url), "-v"]);
    assert_eq!((ran.code, ran.err.matches("axis 1 is stopped").count()), (0, 1), "{}", ran.err);
    assert_eq!(polepair(&["enable", &format!("{},1", sim.url)]).code, 2);
    sim.end();
}

#[test]
fn the_process_that_holds_the_port_is_named_with_its_stop() {
    let sim = Served::new("tmcl:1");
    let holder = run::Held::new(&["spin", &sim.url, "300rpm"], "running; Ctrl-C stops it");
    let ran = polepair(&["stop", sim.link()]);
    assert_eq!(ran.code, 3, "{}", ran.err);
    let pid = holder.id();
    let who = format!("In use by polepair (process {pid}): Ctrl-C there, or `kill -INT {pid}`");
    assert!(ran.err.contains("error[E312]") && ran.err.contains(&who), "{}", ran.err);
    assert_eq!(holder.interrupt().code, 130);
    assert_eq!(polepair(&["stop", &sim.url]).code, 0);
    sim.end();
}

/// A suspended program receives only SIGCONT; both signals are given in the order that works.
#[cfg(target_os = "linux")]
#[test]
fn a_suspended_process_that_holds_the_port_is_named_with_its_wake_up() {
    let sim = Served::new("tmcl:1");
    let holder = run::Held::new(&["spin", &sim.url, "300rpm"], "running; Ctrl-C stops it");
    let pid = holder.id();
    run::signal("STOP", pid);
    let ran = polepair(&["stop", sim.link()]);
    assert_eq!(ran.code, 3, "{}", ran.err);
    let who = format!(
        "In use by polepair (process {pid}), which is suspended: \
         `kill -INT {pid}; kill -CONT {pid}` ends it"
    );
    assert!(ran.err.contains("error[E312]") && ran.err.contains(&who), "{}", ran.err);
    let ended = holder.signalled(&["INT", "CONT"]);
    assert_eq!(ended.code, 130, "{}", ended.err);
    assert!(ended.err.contains("interrupted: the motion was stopped"), "{}", ended.err);
    assert_eq!(polepair(&["stop", &sim.url]).code, 0);
    sim.end();
}

/// A TCP connection to a simulated drive whose answers are all lost, or go back with another's.
fn lossy(url: &str, back: fn(&[u8], &mut Vec<u8>) -> Vec<u8>) -> String {
    let at = url.find("127.0.0.1:").expect("on TCP");
    let (drive, rest) =
        url[at..].split_at(url[at..].find(['#', '?', '/']).unwrap_or(url.len() - at));
    let (drive, server) = (drive.to_owned(), TcpListener::bind("127.0.0.1:0").expect("a port"));
    let port = server.local_addr().expect("an address").port();
    std::thread::spawn(move || {
        for mut near in server.incoming().flatten() {
            let mut far = TcpStream::connect(&drive).expect("the drive");
            let (mut asks, mut stream) = (near.try_clone().unwrap(), far.try_clone().unwrap());
            std::thread::spawn(move || {
                // Ends with the program that asks.
                let _ = std::io::copy(&mut asks, &mut stream);
                let _ = stream.shutdown(std::net::Shutdown::Both);
            });
            std::thread::spawn(move || {
                let (mut received, mut stored) = ([0; 256], Vec::new());
                while let Ok(len @ 1..) = far.read(&mut received) {
                    let _ = near.write_all(&back(&received[..len], &mut stored));
                }
            });
        }
    });
    format!("{}127.0.0.1:{port}{rest}", &url[..at])
}

/// A drive whose replies are lost cannot be identified, so the stops of all possible drives are sent.
#[test]
fn a_drive_that_cannot_be_identified_is_sent_the_stop_that_all_known_ones_share() {
    run::expect_silence();
    for (drive, set, spin, speed) in [
        ("modbus-rtu:1", "control mode=1", "300rpm", "motor speed"),
        ("modbus-ascii:1", "control mode=1", "300rpm", "motor speed"),
        ("canopen:5", "", "100rpm", "velocity actual"),
    ] {
        let sim = Served::with(&[drive, "--tcp", "127.0.0.1:0"]);
        if !set.is_empty() {
            ok(&["set", &sim.url, set]);
        }
        ok(&["spin", &sim.url, spin, "--detach"]);
        let ran = polepair(&["stop", &lossy(&sim.url, |_, _| Vec::new())]);
        assert_eq!(ran.code, 4, "{drive}: {}", ran.err);
        for text in [
            "is being stopped\n",
            "may still turn: cut its supply\n",
            "error[E401]",
            "it was sent the common stop of this protocol's known drives, and its standstill is \
             not confirmed",
            "select the drive by `?profile=`: ",
        ] {
            assert!(ran.err.contains(text), "{drive}: {}", ran.err);
        }
        assert!(!ran.err.contains("othing was sent"), "{}", ran.err);
        assert!(!ran.err.contains("Nothing came back"), "{}", ran.err);
        let read = ok(&["get", &sim.url, speed]);
        assert!(read.contains(" = 0 ") || read.contains(" = -0"), "{drive}: {read}");
        sim.end();
    }
}

/// The check of Modbus RTU (MODBUS over Serial Line V1.02, 6.2.2).
fn crc(bytes: &[u8]) -> [u8; 2] {
    let shift = |crc: u16, _| if crc & 1 == 1 { crc >> 1 ^ 0xA001 } else { crc >> 1 };
    let step = |crc: u16, byte: &u8| (0..8).fold(crc ^ u16::from(*byte), shift);
    bytes.iter().fold(0xFFFF, step).to_le_bytes()
}

/// A device that replies to every query with an exception is no known drive: nothing is written to it.
#[test]
fn a_device_that_refuses_what_identifies_drives_is_written_nothing() {
    let server = TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("modbus-rtu+tcp://{}#1", server.local_addr().expect("an address"));
    let device = std::thread::spawn(move || {
        let (mut wire, _) = server.accept().expect("a host");
        let (mut request, mut functions) = ([0; 8], Vec::new());
        while wire.read_exact(&mut request).is_ok() {
            functions.push(request[1]);
            let reply = [request[0], request[1] | 0x80, 2];
            wire.write_all(&[&reply[..], &crc(&reply)].concat()).expect("a host");
        }
        functions
    });
    let ran = polepair(&["stop", &url]);
    let functions = device.join().expect("a device");
    assert_eq!(ran.code, 4, "{}", ran.err);
    for text in
        ["may still turn: cut its supply\n", "error[E401]", "no stop was sent: ", "?profile="]
    {
        assert!(ran.err.contains(text), "{}", ran.err);
    }
    assert!(functions.iter().all(|function| (1..=4).contains(function)), "{functions:?}");
}

/// The drive's own stop is sent and confirmed as soon as it identifies itself.
#[test]
fn a_drive_that_says_late_what_it_is_is_seen_to_stand() {
    let sim = Served::with(&["modbus-rtu:1", "--tcp", "127.0.0.1:0"]);
    ok(&["set", &sim.url, "control mode=1"]);
    ok(&["spin", &sim.url, "300rpm", "--detach"]);
    run::expect_silence();
    let late = |received: &[u8], lost: &mut Vec<u8>| {
        lost.push(0);
        if lost.len() > 12 { received.to_vec() } else { Vec::new() }
    };
    let ran = polepair(&["stop", &lossy(&sim.url, late)]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(ran.err.contains("axis 1 is stopped\n"), "{}", ran.err);
    sim.end();
}

/// Replies that each belong to the next query do not identify a drive; they do not prove that its kind is
/// unknown either.
#[test]
fn answers_to_other_questions_keep_no_motor_turning() {
    let sim = Served::with(&["modbus-rtu:1", "--tcp", "127.0.0.1:0"]);
    ok(&["set", &sim.url, "control mode=1"]);
    ok(&["spin", &sim.url, "300rpm", "--detach"]);
    run::expect_silence();
    let shifted =
        |received: &[u8], stored: &mut Vec<u8>| std::mem::replace(stored, received.to_vec());
    let ran = polepair(&["stop", &lossy(&sim.url, shifted)]);
    assert!([4, 5].contains(&ran.code), "{}", ran.err);
    assert!(ran.err.contains("may still turn: cut its supply\n"), "{}", ran.err);
    assert_eq!(ok(&["get", &sim.url, "internal speed"]), "internal speed = 0 rpm\n");
    sim.end();
}

#[test]
fn an_unidentified_drive_is_not_reported_without_power() {
    run::expect_silence();
    let sim = Served::with(&["modbus-rtu:1", "--tcp", "127.0.0.1:0"]);
    let ran = polepair(&["disable", &lossy(&sim.url, |_, _| Vec::new())]);
    assert_eq!(ran.code, 4, "{}", ran.err);
    for text in ["error[E401]", "select the drive by `?profile=`: ", "cut the power"] {
        assert!(ran.err.contains(text), "{}", ran.err);
    }
    sim.end();
}

/// Another host loads a program and breaks off: each request is one more instruction, a stop too.
#[test]
fn a_module_in_download_mode_is_stopped_and_identified() {
    for profile in ["", "?profile=tmcm-171"] {
        let sim = Served::new("tmcl");
        let url = sim.url.replace('#', &format!("{profile}#"));
        ok(&["spin", &sim.url, "300rpm", "--detach"]);
        ok(&["send", "--arm", &sim.url, "132, 0, 0, 0"]);
        let ran = polepair(&["stop", &url]);
        assert_eq!(ran.code, 0, "{}", ran.err);
        for text in ["axis 1 is stopped", "was in download mode, which was ended; its program is"] {
            assert!(ran.err.contains(text), "{}", ran.err);
        }
        let speed = ok(&["get", &sim.url, "actual velocity"]);
        assert!(speed.starts_with("actual velocity = 0 "), "{speed}");
        ok(&["send", "--arm", &sim.url, "132, 0, 0, 0"]);
        let ran = polepair(&["info", &sim.url]);
        assert_eq!(ran.code, 0, "{}", ran.err);
        assert!(ran.out.contains("TMCM-171") && ran.err.contains("download mode"), "{}", ran.err);
        // The drive is not identified here; the refusal names the way out.
        ok(&["send", "--arm", &sim.url, "132, 0, 0, 0"]);
        let with_profile = sim.url.replace('#', "?profile=tmcm-171#");
        let ran = polepair(&["get", &with_profile, "actual velocity"]);
        assert!(ran.code == 6 && ran.err.contains("`polepair stop` ends that"), "{}", ran.err);
        ok(&["stop", &url]);
        sim.end();
    }
}
