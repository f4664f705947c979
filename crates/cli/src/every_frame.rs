//! Test of every verb with a line fault at every frame.
//!
//! Each motion verb runs on a drive of each family in virtual time. The wire is cut or silent from the n-th
//! frame on, permanently or for a moment. Output and exit code are compared with the real state of the
//! drive and with the frames that passed.
//!
//! `POLEPAIR_FRAMES=all` tries every n. Otherwise one n of each verb is tried.

mod wire;

use std::cell::RefCell;
use std::time::Duration;

use clap::Parser as _;
use polepair::Connector;
use polepair_core::axis::{Command, Verb};

use crate::cmd::{self, CommandLine};
use crate::problem::Exit;
use crate::terminal::tried;
use wire::{FailureMode, RecordedWire, WireFault, WireObservation};

/// Standstill speed of a motor, rad/s.
const STANDSTILL_SPEED: f64 = 0.5;
/// Time limit of standstill after the end of the verb.
const SETTLE_TIME: Duration = Duration::from_secs(3);
/// Number of places between a verb's first frame and its last that a family's verbs share, where not all frames are
/// tried.
const SAMPLED_PLACES: usize = 4;

/// A family on a medium.
struct DriveFamily {
    /// Simulated drives, in the order of their addresses.
    sim: &'static str,
    /// Protocol by which a second host of the same wire, which prepares it, asks for the axes.
    protocol: &'static str,
    axes: &'static [u32],
    /// Settings before it moves.
    prepare: &'static [(&'static str, i64)],
    verbs: &'static [VerbCase],
}

/// A verb as it is tried.
struct VerbCase {
    words: &'static [&'static str],
    /// True if the motor turns before.
    turning: bool,
    /// Expected end.
    expected: ExpectedEnd,
}

/// Expected end of a verb.
#[derive(Clone, Copy, PartialEq, Debug)]
enum ExpectedEnd {
    /// The motor has turned, and is at standstill without power.
    Turned,
    /// The motor was left turning.
    Turning,
    /// The motor moved by this angle, rad.
    Moved(f64),
    /// The motor has power and is at standstill.
    Powered,
    /// The motor has no power.
    Off,
    /// The motor is at standstill.
    Standing,
}

const fn from_rest(words: &'static [&'static str], done: ExpectedEnd) -> VerbCase {
    VerbCase { words, turning: false, expected: done }
}

const fn from_turning(words: &'static [&'static str], done: ExpectedEnd) -> VerbCase {
    VerbCase { words, turning: true, expected: done }
}

const SPIN: VerbCase = from_rest(&["spin", "60rpm", "--for", "600ms"], ExpectedEnd::Turned);
const JOG: VerbCase = from_rest(&["jog", "30rpm", "--for", "600ms"], ExpectedEnd::Turned);
const SPIN_DETACHED: VerbCase = from_rest(&["spin", "60rpm", "--detach"], ExpectedEnd::Turning);
const MOVE: VerbCase = from_rest(&["move", "1rad", "--timeout", "5s"], ExpectedEnd::Moved(1.0));
const MOVE_BY: VerbCase =
    from_rest(&["move", "1rad", "--rel", "--timeout", "5s"], ExpectedEnd::Moved(1.0));
const ENABLE: VerbCase = from_rest(&["enable"], ExpectedEnd::Powered);
const STOP: VerbCase = from_turning(&["stop"], ExpectedEnd::Standing);
const QUICK_STOP: VerbCase = from_turning(&["stop", "--quick"], ExpectedEnd::Standing);
const DISABLE: VerbCase = from_turning(&["disable"], ExpectedEnd::Off);

const FAMILIES: [DriveFamily; 9] = [
    DriveFamily {
        sim: "tmcl:1",
        protocol: "tmcl",
        axes: &[1],
        prepare: &[],
        verbs: &[
            SPIN,
            JOG,
            SPIN_DETACHED,
            MOVE,
            MOVE_BY,
            ENABLE,
            STOP,
            QUICK_STOP,
            DISABLE,
            from_rest(&["torque", "0.5A", "--for", "600ms"], ExpectedEnd::Turned),
            from_rest(&["home", "--timeout", "20s"], ExpectedEnd::Turned),
        ],
    },
    DriveFamily {
        sim: "tmcl+can:1",
        protocol: "tmcl",
        axes: &[1],
        prepare: &[],
        verbs: &[SPIN, SPIN_DETACHED, MOVE, MOVE_BY, ENABLE, STOP, DISABLE],
    },
    DriveFamily {
        sim: "tmcm-6110:1",
        protocol: "tmcl",
        axes: &[1],
        // It is fast enough, and its power goes at standstill.
        prepare: &[("pulse divisor", 2), ("freewheeling delay", 1)],
        verbs: &[SPIN, SPIN_DETACHED, MOVE, MOVE_BY, STOP],
    },
    DriveFamily {
        sim: "tml:1",
        protocol: "tml",
        axes: &[1],
        prepare: &[],
        verbs: &[SPIN, SPIN_DETACHED, MOVE, MOVE_BY, ENABLE, STOP, QUICK_STOP, DISABLE],
    },
    DriveFamily {
        sim: "tmlcan:1",
        protocol: "tmlcan",
        axes: &[1],
        prepare: &[],
        verbs: &[SPIN, SPIN_DETACHED, MOVE, MOVE_BY, ENABLE, STOP, DISABLE],
    },
    DriveFamily {
        sim: "modbus-rtu:1",
        protocol: "modbus-rtu",
        axes: &[1],
        prepare: &[("control mode", 1)],
        verbs: &[SPIN, JOG, SPIN_DETACHED, ENABLE, STOP, QUICK_STOP, DISABLE],
    },
    DriveFamily {
        sim: "syntron-ts-canopen:1",
        protocol: "canopen",
        axes: &[1],
        prepare: &[("control mode", 20)],
        verbs: &[SPIN, SPIN_DETACHED, MOVE, MOVE_BY, ENABLE, STOP, DISABLE],
    },
    DriveFamily {
        sim: "cia402:1,2",
        protocol: "canopen",
        axes: &[1, 2],
        prepare: &[],
        verbs: &[
            SPIN,
            SPIN_DETACHED,
            MOVE,
            MOVE_BY,
            from_rest(&["move", "1rad", "--sync", "--timeout", "5s"], ExpectedEnd::Moved(1.0)),
            ENABLE,
            STOP,
            QUICK_STOP,
            DISABLE,
        ],
    },
    DriveFamily {
        sim: "thruster:11",
        protocol: "thruster",
        axes: &[11],
        prepare: &[],
        verbs: &[
            from_rest(&["spin", "300rpm", "--for", "600ms"], ExpectedEnd::Turned),
            STOP,
            DISABLE,
        ],
    },
];

thread_local! {
    static WIRE: RefCell<Option<RecordedWire>> = const { RefCell::new(None) };
}

/// Puts the wire of the verb that this thread tries between it and its drives.
pub fn with_faulty_wire(connector: Connector) -> Connector {
    match WIRE.with_borrow(Clone::clone) {
        Some(wire) => connector.with_link_wrapper(move |_, end, simulation| match simulation {
            Some(simulation) => wire.wrap_link(end, simulation),
            None => end,
        }),
        None => connector,
    }
}

/// A run of a verb, with its end.
struct VerbRun {
    exit: Exit,
    output: String,
    observation: WireObservation,
}

/// Carries a verb out in this thread, as the command line does.
fn run_case(family: &'static DriveFamily, tried: &VerbCase, fault: Option<WireFault>) -> VerbRun {
    let wire =
        RecordedWire::new((family.protocol, family.axes), fault, prepare_drives(family, tried));
    WIRE.set(Some(wire.clone()));
    let (verb, rest) = tried.words.split_first().expect("a verb");
    let url = format!("sim:{}?time=virtual&seed=7", family.sim);
    let words = [&["polepair", verb, &url][..], rest].concat();
    let arguments = CommandLine::try_parse_from(words).expect("a command line");
    let exit = match cmd::run(arguments) {
        Ok(exit) => exit,
        Err(problem) => {
            tried::record(&problem.render(false));
            problem.exit
        }
    };
    WIRE.set(None);
    VerbRun { exit, output: tried::take_recorded(), observation: wire.observe(SETTLE_TIME) }
}

/// Prepares the drives before the verb.
fn prepare_drives(
    family: &'static DriveFamily,
    tried: &VerbCase,
) -> impl Fn(&[polepair::LocalAxis]) + Send + Sync + use<> {
    let turning = tried.turning;
    move |axes| {
        for axis in axes {
            for (name, raw) in family.prepare {
                axis.set_raw(name, *raw).expect(name);
            }
            if turning {
                axis.arm(true);
                axis.enable().expect("power");
                let speed = Command { velocity: Some(12.0), ..Command::new(Verb::Velocity) };
                axis.run(speed).expect("a speed");
            }
        }
    }
}

/// Violations at the end of a verb.
fn find_violations(
    family: &DriveFamily,
    tried: &VerbCase,
    fault: Option<WireFault>,
    ran: &VerbRun,
) -> Vec<String> {
    let VerbRun { exit, output, observation } = ran;
    let mut wrong = Vec::new();
    let mut hold = |is_so: bool, what: &str| {
        if !is_so {
            wrong.push(what.to_owned());
        }
    };
    let turns: Vec<bool> = observation
        .drives
        .iter()
        .map(|drive| drive.after.velocity.abs() > STANDSTILL_SPEED)
        .collect();
    let anybody = turns.contains(&true);
    let stands = !anybody;
    let left = output.contains("left running");

    if *exit == Exit::Ok {
        for (n, drive) in observation.drives.iter().enumerate() {
            let far = drive.after.position - drive.before.position;
            // Nothing on that bus answers a start of motion (SWARM-3).
            let lost_unseen = family.protocol == "tmlcan"
                && matches!(
                    tried.expected,
                    ExpectedEnd::Moved(_) | ExpectedEnd::Turned | ExpectedEnd::Turning
                )
                && fault.is_some_and(|fault| fault.is_one_frame_lost());
            let done = match tried.expected {
                _ if lost_unseen => true,
                ExpectedEnd::Turned => {
                    drive.top_speed > STANDSTILL_SPEED && !turns[n] && !drive.after.enabled
                }
                ExpectedEnd::Turning => turns[n] && left,
                ExpectedEnd::Moved(by) => (far.abs() - by).abs() < 0.1 && !turns[n],
                ExpectedEnd::Powered => drive.after.enabled && !turns[n],
                ExpectedEnd::Off => !drive.after.enabled,
                ExpectedEnd::Standing => !turns[n],
            };
            hold(done, &format!("exit 0, and drive {n} has not done it"));
        }
    } else {
        hold(fault.is_some(), "it failed on a wire that is well");
    }
    for (n, axis) in family.axes.iter().enumerate().filter(|(n, _)| turns[*n] && !left) {
        let may = format!("axis {axis} may still turn");
        let off = format!("axis {axis} may still be powered, and may still turn");
        let cut = tried.turning && output.contains("cut the power if a motor turns");
        let reported = output.contains(&may) || output.contains(&off) || cut;
        hold(reported, &format!("drive {n} turns, and no text says so"));
    }
    for quiet in ["the motion was stopped", "is stopped", "is not powered now"] {
        hold(
            stands || !output.contains(quiet) || turns.len() > 1,
            &format!("`{quiet}`, and it turns"),
        );
    }
    if output.to_lowercase().contains("nothing was sent") {
        let started = observation.drives.iter().any(|drive| drive.starts > 0);
        hold(!started, "`Nothing was sent`, and a drive has executed something");
    }
    for (what, happened) in [
        ("velocity", observation.drives.iter().any(|drive| drive.top_speed > STANDSTILL_SPEED)),
        // A stop powers a stepper motor, too, and is no start.
        ("enable", observation.drives.iter().any(|drive| drive.was_enabled && drive.starts > 0)),
    ] {
        let not = output.lines().any(|line| {
            line.contains(&format!(": {what}: ")) && line.contains("it was not executed")
        });
        hold(!(not && happened && turns.len() == 1), &format!("`{what}` is called not executed"));
    }
    if let Some(fault) = fault {
        if fault.recovers_after.is_some()
            && !matches!(tried.expected, ExpectedEnd::Standing | ExpectedEnd::Off)
        {
            hold(stands || left, "the wire came back, and the motor turns on");
        }
        if fault.is_glitch() && tried.expected != ExpectedEnd::Off {
            hold(stands || left, "one frame was lost, and the motor turns on");
        }
        let code = *exit as u8;
        let fits = match fault.mode {
            FailureMode::CutBefore | FailureMode::CutAfter => matches!(code, 0 | 1 | 3 | 4 | 7),
            FailureMode::HostMuted | FailureMode::DrivesMuted => {
                matches!(code, 0 | 1 | 4 | 5 | 6 | 7)
            }
        };
        hold(fits, &format!("exit {code} for that fault"));
    }
    wrong
}

fn sampled_frames(frames: usize, verb_index: usize) -> std::ops::RangeInclusive<usize> {
    if std::env::var("POLEPAIR_FRAMES").is_ok_and(|all| all == "all") {
        return 1..=frames;
    }
    let place = verb_index % SAMPLED_PLACES;
    let frame = 1 + place * frames.saturating_sub(1) / (SAMPLED_PLACES - 1);
    frame..=frame
}

fn try_family(family: &'static DriveFamily) -> (usize, Vec<String>) {
    let (mut count, mut wrong) = (0, Vec::new());
    let only = std::env::var("POLEPAIR_VERB").ok();
    for (verb_index, tried) in family.verbs.iter().enumerate() {
        let name = tried.words.join(" ");
        if only.as_ref().is_some_and(|only| !name.contains(only.as_str())) {
            continue;
        }
        let well = run_case(family, tried, None);
        let mut judge = |fault: Option<WireFault>, ran: &VerbRun| {
            for what in find_violations(family, tried, fault, ran) {
                wrong.push(format!(
                    "{} {name}, {fault:?}, exit {}: {what}\n{}",
                    family.sim, ran.exit as u8, ran.output
                ));
            }
        };
        judge(None, &well);
        for at in sampled_frames(well.observation.frames, verb_index) {
            for fault in WireFault::all_at(at) {
                count += 1;
                judge(Some(fault), &run_case(family, tried, Some(fault)));
            }
        }
    }
    (count, wrong)
}

fn check_family(sim: &str) {
    let family = FAMILIES.iter().find(|family| family.sim == sim).expect("a family");
    let (count, wrong) = try_family(family);
    let shown: Vec<&str> = wrong.iter().take(12).map(String::as_str).collect();
    assert!(wrong.is_empty(), "{} of {count}:\n{}", wrong.len(), shown.join("\n"));
    assert!(count > 0);
}

macro_rules! families {
    ($($test:ident $sim:literal,)+) => {$(
        #[test]
        fn $test() {
            check_family($sim);
        }
    )+};
}

families! {
    tmcl "tmcl:1",
    tmcl_on_can "tmcl+can:1",
    tmcl_steppers "tmcm-6110:1",
    tml "tml:1",
    tml_on_can "tmlcan:1",
    ts_on_modbus "modbus-rtu:1",
    ts_on_canopen "syntron-ts-canopen:1",
    cia402_drives_together "cia402:1,2",
    thrusters "thruster:11",
}
