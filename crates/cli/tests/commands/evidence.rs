//! A verb that ends with exit code 0 prints a measurement; any other end prints the axis' position, and why.
//! On simulated drives behind real sockets, and the same through a gateway.
#![cfg(unix)]

use std::io::Write as _;
use std::path::PathBuf;
use std::process::Child;
use std::time::Duration;

use polepair_test_support::Deadline;

use crate::gateway::site::{Folder, Site, speed};
use crate::run::{self, Ran, Served, ok, polepair};

/// An event that ends a motion early.
#[derive(Clone, Copy)]
enum Event {
    /// Something that happens to the simulated drive, before the motion or during it.
    Before(&'static str),
    During(&'static str),
    /// Another master sends this request during the motion.
    Sent(&'static str),
}

struct Case {
    sim: &'static [&'static str],
    /// Set before the motion.
    prepare: &'static [&'static str],
    motion: &'static [&'static str],
    event: Event,
    code: i32,
    says: &'static [&'static str],
}

const TCP: &[&str] = &["--tcp", "127.0.0.1:0"];
const CAN: &[&str] = &["--socketcand", "127.0.0.1:0"];
const FAR: &[&str] = &["move", "500turn", "--rel", "--vel", "300rpm"];
const TS_POSITION: &[&str] = &["Fn_99=1", "Fn_00=14"];

/// Motions that end early, with the reason that the drive gives.
const CASES: &[Case] = &[
    Case {
        sim: &["cia402:3"],
        prepare: &[],
        motion: FAR,
        event: Event::Sent("write 0x6040:0 u16 0x010F"),
        code: 1,
        says: &["E102", "another master halted it at", "the target is 500 turn"],
    },
    Case {
        sim: &["syntron-ts-canopen:3"],
        prepare: &["Fn_00=20"],
        motion: FAR,
        event: Event::Sent("write 0x6040:0 u16 0x010F"),
        code: 1,
        says: &["E102", "another master halted it at", "the target is 180000 deg"],
    },
    Case {
        sim: &["modbus-rtu:1"],
        prepare: TS_POSITION,
        motion: FAR,
        event: Event::During("fault=0x1614"),
        code: 8,
        says: &["E801", "ERR_oL", "the target is 180000 deg"],
    },
    Case {
        sim: &["modbus-rtu:1"],
        prepare: TS_POSITION,
        motion: FAR,
        event: Event::During("jam"),
        code: 8,
        says: &["E801", "ERR_PE", "the target is 180000 deg"],
    },
    Case {
        sim: &["modbus-rtu:1"],
        prepare: TS_POSITION,
        motion: FAR,
        event: Event::During("supply=5 V"),
        code: 8,
        says: &["E801", "ERR_LU", "the target is 180000 deg"],
    },
    Case {
        sim: &["modbus-rtu:1"],
        prepare: TS_POSITION,
        motion: FAR,
        event: Event::During("power-cycle"),
        code: 1,
        says: &["E102", "the motor has lost its power", "the target is 180000 deg"],
    },
    Case {
        sim: &["modbus-rtu:1"],
        prepare: TS_POSITION,
        motion: FAR,
        event: Event::Before("limit-high=0 deg"),
        code: 1,
        says: &["E106", "reached at 0 deg", "the target is 180000 deg"],
    },
    Case {
        sim: &["thruster-servo:12"],
        prepare: &[],
        motion: &["move", "170deg", "--vel", "1rpm"],
        event: Event::Sent("LS"),
        code: 1,
        says: &["E106", "it stopped at", "the target is 170 deg"],
    },
    Case {
        sim: &["technosoft-f514l:1"],
        prepare: &[],
        motion: &["move", "10turn", "--vel", "120rpm"],
        event: Event::Before("limit-high=20"),
        code: 1,
        says: &["E106", "3.1", "the target is 10 turn", "the positive limit switch"],
    },
    Case {
        sim: &["technosoft-fa00g:1"],
        prepare: &[],
        motion: &["move", "10turn", "--vel", "120rpm"],
        event: Event::Before("limit-high=20"),
        code: 1,
        says: &["E106", "3.1", "the target is 10 turn", "the positive limit switch"],
    },
    Case {
        sim: &["tmcm-6110:1"],
        prepare: &["stop on stall velocity=10rpm"],
        motion: &["move", "90turn", "--vel", "30rpm"],
        event: Event::During("jam"),
        code: 1,
        says: &["E106", "it stalled at", "the target is 90 turn"],
    },
    Case {
        sim: &["tmcm-1140:1"],
        prepare: &[],
        motion: &["move", "15turn", "--vel", "30rpm"],
        event: Event::Sent("MST 0"),
        code: 1,
        says: &["E102", "another master set mode 2 (velocity): it stopped at", "15 turn"],
    },
    Case {
        sim: &["cia402:1"],
        prepare: &[],
        motion: &["spin", "300rpm", "--for", "1s"],
        event: Event::Before("limit-high=0 deg"),
        code: 1,
        says: &["E106", "never came near 300 rpm", "limit", "holds it."],
    },
    Case {
        sim: &["technosoft-f514l:1"],
        prepare: &[],
        motion: &["spin", "300rpm", "--for", "1s"],
        event: Event::Before("limit-high=0 deg"),
        code: 1,
        says: &["E106", "never came near 300 rpm", "limit", "holds it."],
    },
    Case {
        sim: &["modbus-rtu:1"],
        prepare: &["Fn_99=1", "Fn_00=1"],
        motion: &["spin", "300rpm", "--for", "1s"],
        event: Event::Before("limit-high=0 deg"),
        code: 1,
        says: &["E106", "never came near 300 rpm"],
    },
];

impl Case {
    fn served(&self) -> (Served, String) {
        let name = self.sim[0];
        let on_can =
            ["cia402", "canopen", "thruster", "1140"].iter().any(|part| name.contains(part));
        let sim = Served::with(&[self.sim, if on_can { CAN } else { TCP }].concat());
        let url = sim.url.clone();
        for set in self.prepare {
            ok(&["set", &url, set, "--raw", "--arm"][..if set.contains("rpm") { 3 } else { 5 }]);
        }
        (sim, url)
    }

    fn happen(&self, url: &str) {
        match self.event {
            Event::Before(act) | Event::During(act) => drop(ok(&["act", url, act])),
            Event::Sent(text) => drop(ok(&["send", url, text, "--arm"])),
        }
    }

    fn judge(&self, how: &str, ran: &Ran) {
        let name = format!("{} {:?} {how}", self.sim[0], self.motion);
        assert_eq!(ran.code, self.code, "{name}: {}{}", ran.out, ran.err);
        for part in self.says {
            assert!(ran.err.contains(part), "{name}: no {part:?} in {}", ran.err);
        }
    }
}

/// The lines that a motion's trace has when its motor certainly turns.
const TURNING_LINES: usize = 300;

fn turning(trace: &PathBuf, least: usize) {
    let deadline = Deadline::new("the motor turns");
    let lines = || std::fs::read_to_string(trace).unwrap_or_default().lines().count();
    while lines() < least {
        deadline.check(|| format!("{} lines", lines()));
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_motion_that_ends_early_says_where_and_why() {
    for (n, case) in CASES.iter().enumerate() {
        let (sim, url) = case.served();
        let trace =
            std::env::temp_dir().join(format!("polepair-early-{}-{n}.log", std::process::id()));
        let shown = trace.display().to_string();
        let words = [&case.motion[..1], &[&url], &case.motion[1..], &["--trace", &shown]].concat();
        let ran = if let Event::Before(_) = case.event {
            case.happen(&url);
            polepair(&words)
        } else {
            let child: Child = run::command(&words).spawn().expect("starts");
            turning(&trace, TURNING_LINES);
            case.happen(&url);
            run::ended(child, &words)
        };
        let _ = std::fs::remove_file(&trace);
        case.judge("on its wire", &ran);
        sim.end();
    }
}

#[test]
fn a_gateway_says_the_same_of_a_motion_that_ends_early() {
    for case in CASES {
        let (sim, url) = case.served();
        let folder = Folder::new();
        let site = Site::new(&folder, &[&url]);
        let words = [&case.motion[..1], &["all"], &case.motion[1..]].concat();
        let ran = if let Event::Before(_) = case.event {
            case.happen(&url);
            site.run(&words)
        } else {
            let mut live = site.live();
            std::thread::scope(|scope| {
                let motion = scope.spawn(|| site.run(&words));
                live.until("axis", |axis| speed(axis).is_some_and(|speed| speed.abs() > 0.05));
                case.happen(&url);
                motion.join().expect("the motion")
            })
        };
        case.judge("through a gateway", &ran);
        drop(site);
        sim.end();
    }
}

/// A number of the drive that means 0.5 rpm nowhere: 46 rpm is no standstill, whatever its unit.
#[test]
fn a_motor_is_stopped_when_it_is_slower_than_half_a_turn_a_minute() {
    let sim = Served::with(&["cia402:5", "--socketcand", "127.0.0.1:0"]);
    ok(&["set", &sim.url, "si unit velocity=0x00B44700", "--raw", "--arm"]);
    ok(&["spin", &sim.url, "100rpm", "--acc", "1000000", "--dec", "5000", "--detach"]);
    let ran = polepair(&["stop", &sim.url]);
    assert!(ran.code == 0 && ran.err.contains("axis 5 is stopped"), "{}", ran.err);
    let velocity = ok(&["get", &sim.url, "--raw", "velocity actual"]);
    let velocity: f64 = velocity.trim().rsplit(' ').next().unwrap().parse().expect("a number");
    assert!(velocity.abs() <= 1.0, "{velocity}");
    sim.end();
}

#[test]
fn no_drive_is_moved_at_speed_zero() {
    for drive in ["modbus-rtu", "tmcl", "tml", "cia402", "thruster-servo", "tmcm-1140"] {
        let ran = polepair(&["move", &format!("sim:{drive}"), "1turn", "--vel", "0rpm"]);
        assert_eq!(ran.code, 2, "{drive}: {}", ran.err);
        assert!(ran.err.contains("E222") && ran.err.contains("It was not sent"), "{}", ran.err);
    }
}

#[test]
fn homing_that_homes_nothing_is_refused() {
    let sim = Served::new("modbus-rtu:1");
    ok(&["set", &sim.url, "Fn_99=1", "Fn_00=14", "Fn_200=5", "--raw", "--arm"]);
    let ran = polepair(&["home", &sim.url]);
    assert_eq!(ran.code, 6, "{}", ran.err);
    assert!(ran.err.contains("E602") && ran.err.contains("Fn_200"), "{}", ran.err);
    sim.end();
}

#[test]
fn a_group_commands_each_axis_and_an_unconfirmed_stop_is_reported_as_such() {
    let sim = Served::with(&["tmlcan:5,7", "--socketcand", "127.0.0.1:0"]);
    let link = sim.link().to_owned();
    ok(&["move", &format!("{link}#7"), "0.3turn"]);
    let moved = ok(&["move", &format!("{link}?profile=technosoft-f514l#g1"), "1turn", "--rel"]);
    for (axis, end) in [("#5", 1.0), ("#7", 1.3)] {
        let line = moved.lines().find(|line| line.starts_with(axis)).expect(axis);
        let position: f64 = line.rsplit(' ').nth(1).unwrap().parse().expect("a number");
        assert!((position - end).abs() < 0.01, "{moved}");
    }
    sim.end();

    let sim = Served::with(&["tml:1,2", "--tcp", "127.0.0.1:0"]);
    let group = format!("{}?wire=rs485#1,g1", sim.link());
    let ran = polepair(&["set", &group, "KPP=7", "--raw"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(ran.out.contains("written, not read back"), "{}", ran.out);
    let both = ok(&["get", &format!("{}?wire=rs485#1,2", sim.link()), "KPP", "--raw"]);
    assert_eq!(both.matches("= 7").count(), 2, "{both}");
    let group = format!("{}?wire=rs485#g1", sim.link());
    for verb in ["stop", "disable"] {
        let ran = polepair(&[verb, &group]);
        assert_eq!(ran.code, 9, "{verb}: {}", ran.err);
        assert!(ran.err.contains("nothing confirms it on this wire"), "{verb}: {}", ran.err);
    }
    sim.end();
}

/// The server of a socketcand URL.
fn address_of(url: &str) -> &str {
    let after = url.split("://").nth(1).expect("a URL");
    after.split('/').next().expect("its server")
}

/// Starts a motion of a drive of its own, and sends frames on its bus while it turns.
fn run_with_frames(n: usize, motion: &[&str], frames: &str) -> run::Ran {
    let sim = Served::with(&["cia402:3", "--socketcand", "127.0.0.1:0"]);
    let trace = std::env::temp_dir().join(format!("polepair-emcy-{}-{n}.log", std::process::id()));
    let shown = trace.display().to_string();
    let words = [&motion[..1], &[&sim.url], &motion[1..], &["--trace", &shown]].concat();
    let child = run::command(&words).spawn().expect("starts");
    // A held motion is read four times a second.
    turning(&trace, 150);
    let mut bus = std::net::TcpStream::connect(address_of(&sim.url)).expect("the bus");
    let message = format!("< open can0 >< rawmode >{frames}");
    bus.write_all(message.as_bytes()).expect("frames");
    let ran = run::ended(child, &words);
    let _ = std::fs::remove_file(&trace);
    sim.end();
    ran
}

/// CAN frames were lost: of the drive, as any node of the bus may send it.
const FRAMES_LOST: &str = "< send 83 8 10 81 11 0 0 0 0 0 >";
const SPIN: &[&str] = &["spin", "100rpm", "--for", "4s"];
const MOVE: &[&str] = &["move", "10turn", "--rel", "--vel", "300rpm"];

/// An emergency that does not stop the drive is a note: at once while the motion is held, and at the end of a way.
#[test]
fn an_emergency_that_stops_nothing_is_noted() {
    let motions = [(SPIN, "; its speed is 100 rpm"), (MOVE, ", and arrived")];
    for (n, (motion, end)) in motions.into_iter().enumerate() {
        let ran = run_with_frames(n, motion, FRAMES_LOST);
        assert_eq!(ran.code, 0, "{motion:?}: {}", ran.err);
        let note = format!("sent emergency 8110h (CAN frames were lost){end}");
        assert_eq!(ran.err.matches(&note).count(), 1, "{motion:?}: {}", ran.err);
    }
}

/// Another master halts or disables the drive directly after its emergency.
#[test]
fn an_early_end_names_the_emergency_before_it() {
    const HALT: &str = "< send 603 8 2B 40 60 0 0F 1 0 0 >";
    const DISABLE: &str = "< send 603 8 2B 40 60 0 0 0 0 0 >";
    let cases = [(SPIN, HALT), (SPIN, DISABLE), (MOVE, HALT), (MOVE, DISABLE)];
    for (n, (motion, end)) in cases.into_iter().enumerate() {
        let ran = run_with_frames(10 + n, motion, &format!("{FRAMES_LOST}{end}"));
        let about = format!("{motion:?} {end}: {}", ran.err);
        assert!(ran.code == 1 && ran.err.contains("error[E102]"), "{about}");
        let error = ran.err.split_once("error[").expect("an error").1;
        assert!(error.contains("t sent emergency 8110h (CAN frames were lost)"), "{about}");
    }
}
