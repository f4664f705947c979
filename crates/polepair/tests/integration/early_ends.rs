//! A motion that something ends early is no arrival, in any family: docs/concepts/outcomes.md#motion.

use std::time::Duration;

use polepair::{CyclicAxes, Error, LocalAxis, LocalLink, connect_local};
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::stream::cyclic::SetpointKind;
use polepair_core::stream::{PathKind, Point};
use polepair_drives::surroundings::Act;

/// A drive, and what another master writes to it to stop its motor and to switch it off.
struct Family {
    url: &'static str,
    prepare: &'static [(&'static str, i64)],
    way: &'static str,
    speed: &'static str,
    stop: Option<(&'static str, i64)>,
    off: Option<(&'static str, i64)>,
    /// A fault code that stops the motor, where its profile knows one.
    fault: Option<u32>,
    /// True if the position is measured: a stepper module without an encoder counts its own steps.
    measured: bool,
}

const CIA402: Family = Family {
    url: "sim:cia402",
    prepare: &[],
    way: "20turn",
    speed: "300rpm",
    stop: Some(("controlword", 0x010F)),
    off: Some(("controlword", 0)),
    fault: Some(0x2310),
    measured: true,
};
const TML: Family = Family {
    url: "sim:technosoft-f514l",
    prepare: &[],
    way: "20turn",
    speed: "300rpm",
    stop: None,
    off: None,
    fault: Some(0x0100),
    measured: true,
};
const STEPPER: Family = Family {
    url: "sim:tmcm-1140",
    prepare: &[],
    way: "19turn",
    speed: "60rpm",
    stop: Some(("target velocity", 0)),
    off: None,
    fault: Some(0x02),
    measured: false,
};
const SERVO: Family = Family {
    url: "sim:thruster-servo",
    prepare: &[],
    way: "170deg",
    speed: "5rpm",
    stop: None,
    off: None,
    fault: Some(0x40),
    measured: true,
};

const FAMILIES: [Family; 11] = [
    Family {
        url: "sim:modbus-rtu",
        prepare: &[("write target", 1), ("control mode", 14)],
        stop: Some(("path stop", 1)),
        off: Some(("internal enable", 0)),
        fault: Some(0x1614),
        ..CIA402
    },
    Family {
        url: "sim:syntron-ts-canopen",
        prepare: &[("control mode", 20)],
        fault: Some(0x1614),
        ..CIA402
    },
    CIA402,
    TML,
    Family { url: "sim:technosoft-fa00g", ..TML },
    Family { url: "sim:tmlcan", ..TML },
    Family {
        url: "sim:tmcl",
        stop: Some(("target velocity", 0)),
        off: Some(("driver enable", 0)),
        fault: Some(0x01),
        ..CIA402
    },
    STEPPER,
    Family { url: "sim:tmcm-1260", fault: None, ..STEPPER },
    SERVO,
    Family {
        url: "sim:thruster-actuator?profile=thruster-actuator",
        way: "170mm",
        speed: "20rpm",
        ..SERVO
    },
];

/// An event that ends the motion.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Event {
    Fault,
    Jam,
    Supply,
    PowerCycle,
    Stop,
    Off,
    Limit,
}

const EVENTS: [Event; 7] = [
    Event::Fault,
    Event::Jam,
    Event::Supply,
    Event::PowerCycle,
    Event::Stop,
    Event::Off,
    Event::Limit,
];

fn open(family: &Family) -> LocalLink {
    let more = if family.url.contains('?') { '&' } else { '?' };
    let url = format!("{}{more}time=virtual", family.url);
    let link = connect_local(&url).unwrap_or_else(|error| panic!("{url}: {error}"));
    for (name, raw) in family.prepare {
        link.axes()[0].set_raw(name, *raw).unwrap_or_else(|error| panic!("{url}: {error}"));
    }
    link
}

/// Starts a command to move by that way, or to turn at that speed.
fn command(axis: &LocalAxis, family: &Family, verb: Verb) -> polepair::axis::RunningRequest {
    let argument =
        |which, text: &str| axis.argument(verb, which, &text.into()).expect("an argument");
    let command = Command {
        target: (verb == Verb::MoveBy).then(|| argument(Argument::Target, family.way)),
        velocity: Some(argument(Argument::Velocity, family.speed)),
        ..Command::new(verb)
    };
    axis.start(command).unwrap_or_else(|error| panic!("{}: {error}", family.url))
}

/// Starts a move by that way, and the wait for its arrival.
fn start(axis: &LocalAxis, family: &Family) -> polepair::axis::RunningRequest {
    let commanded = command(axis, family, Verb::MoveBy).wait(Duration::from_secs(10));
    assert!(matches!(commanded, Ok(Some(_))), "{}: {commanded:?}", family.url);
    axis.start(Command::new(Verb::Reached).limited(Duration::from_secs(60))).expect("a wait")
}

/// Makes it happen. False if this drive has no such thing.
fn happens(link: &LocalLink, family: &Family, event: Event) -> bool {
    let axis = &link.axes()[0];
    let act = |act| link.simulation().expect("a simulation").act(0, 0, act);
    let write = |write: Option<(&str, i64)>| {
        write.is_some_and(|(name, raw)| {
            axis.set_raw(name, raw).unwrap_or_else(|e| panic!("{}: {name}: {e}", family.url));
            true
        })
    };
    match event {
        Event::Fault => family.fault.is_some_and(|code| act(Act::Fault(code))),
        Event::Jam => family.measured && act(Act::Jam(true)),
        Event::Supply => act(Act::Supply(5.0)),
        Event::PowerCycle => act(Act::PowerCycle),
        Event::Stop => write(family.stop),
        Event::Off => write(family.off),
        Event::Limit => act(Act::Switch { which: 1, at: 0.0 }),
    }
}

#[test]
fn a_motion_that_ends_early_is_no_arrival() {
    let mut tried = 0;
    for family in &FAMILIES {
        for event in EVENTS {
            let about = format!("{} {event:?}", family.url);
            let link = open(family);
            let axis = &link.axes()[0];
            let armed = axis.armed().unwrap_or_else(|error| panic!("{about}: {error}"));
            let before = event == Event::Limit;
            if before && !happens(&link, family, event) {
                continue;
            }
            let mut waiting = start(axis, family);
            if !before {
                let waited = waiting.wait(Duration::from_millis(700));
                assert!(matches!(waited, Ok(None)), "{about}: it goes on: {waited:?}");
                if !happens(&link, family, event) {
                    continue;
                }
            }
            tried += 1;
            let ended = waiting.wait(Duration::from_secs(8));
            let Err(error) = ended else { panic!("{about}: {ended:?}") };
            let expected = match event {
                Event::Off => &["E102"][..],
                // Without a supply for its logic a module is silent.
                Event::Supply => &["E102", "E801", "E401"],
                _ => &["E106", "E102", "E801"],
            };
            assert!(!error.to_string().contains("not executed"), "{about}: {error}");
            assert!(expected.contains(&error.code()), "{about}: {} {error}", error.code());
            assert!(matches!(error, Error::Failed { .. }), "{about}: {error:?}");
            let _ = armed.release();
        }
    }
    assert!(tried >= 50, "{tried} of the table");
}

/// The motions of the table without an event, which proves its entries.
#[test]
fn the_same_motions_arrive_when_nothing_happens() {
    for family in &FAMILIES {
        let link = open(family);
        let armed = link.axes()[0].armed().expect("armed");
        let mut waiting = start(&link.axes()[0], family);
        let ended = waiting.wait(Duration::from_secs(60));
        assert!(matches!(ended, Ok(Some(_))), "{}: {ended:?}", family.url);
        armed.release().expect("it stands");
    }
}

/// The power of a drive goes off and on after this many steps of a command. Some drives move then, which have their
/// motor powered from the start; false if one does not, and the command claims to be done. The last reply may have
/// left it just before that. `None` if the command was over.
fn is_true_after_power_cycle(family: &Family, verb: Verb, steps: u32) -> Option<bool> {
    const STEP: Duration = Duration::from_millis(3);
    const LAST_REPLY: Duration = Duration::from_millis(30);
    let link = open(family);
    let axis = &link.axes()[0];
    let armed = axis.armed().unwrap_or_else(|error| panic!("{}: {error}", family.url));
    let simulation = link.simulation().expect("a simulation");
    let position = || simulation.truth(0, 0).expect("a drive").position;
    let mut commanded = command(axis, family, verb);
    if !matches!(commanded.wait(STEP * steps), Ok(None)) {
        return None;
    }
    assert!(simulation.act(0, 0, Act::PowerCycle));
    let (at, before) = (simulation.now(), position());
    let ended = commanded.wait(Duration::from_secs(10));
    let is_claimed = matches!(ended, Ok(Some(_))) && simulation.now().since(at) > LAST_REPLY;
    simulation.advance(Duration::from_secs(1));
    let has_moved = (position() - before).abs() > 0.1;
    let _ = armed.release();
    Some(has_moved || !is_claimed)
}

#[test]
fn a_command_is_not_done_when_the_drive_lost_its_supply_before_it_moved() {
    const SPEED_MODE: Family = Family {
        url: "sim:modbus-rtu",
        prepare: &[("write target", 1), ("control mode", 1)],
        ..CIA402
    };
    let moves = FAMILIES.iter().map(|family| (family, Verb::MoveBy));
    let speeds = [&SPEED_MODE, &CIA402, &TML, &FAMILIES[5], &FAMILIES[6], &STEPPER];
    let mut false_claims = Vec::new();
    for (family, verb) in moves.chain(speeds.map(|family| (family, Verb::Velocity))) {
        for steps in 1.. {
            match is_true_after_power_cycle(family, verb, steps) {
                Some(true) => {}
                Some(false) => false_claims.push(format!("{} {verb:?} {steps}", family.url)),
                None => break,
            }
        }
    }
    assert_eq!(false_claims, [""; 0]);
}

/// Three turns in two seconds, there at rest.
fn course(share: f64) -> f64 {
    3.0 * core::f64::consts::TAU * (3.0 - 2.0 * share) * share * share
}

/// Along a drive's own buffer, in twenty points.
fn stream_buffered(link: &LocalLink) -> Result<(), Error> {
    let axis = link.axes()[0].armed()?;
    axis.enable()?;
    let point = |n: u32| {
        let share = f64::from(n) / 20.0;
        let velocity = 3.0 * core::f64::consts::TAU * 6.0 * (1.0 - share) * share / 2.0;
        Point { position: course(share), velocity, time: 0.1 }
    };
    axis.stream(PathKind::Pvt, (1..=20).map(point)).map(drop)
}

/// Along cyclic positions.
fn stream_cyclic(link: &LocalLink) -> Result<(), Error> {
    let period = Duration::from_millis(10);
    let setpoints: Vec<f64> = (0..=200).map(|n| course(f64::from(n) / 200.0)).collect();
    let following =
        CyclicAxes::begin_with_path(link.axes(), SetpointKind::Position, period, &setpoints)?;
    let streamed = following.stream(setpoints, |_| {}).map(drop);
    following.release()?;
    streamed
}

/// A buffer that is empty, or a last cycle, is no arrival.
#[test]
fn a_stream_that_ends_early_says_where_and_why() {
    type Stream = fn(&LocalLink) -> Result<(), Error>;
    let streams: [(&str, Stream); 2] = [
        ("sim:technosoft-f514l?time=virtual", stream_buffered),
        ("sim:cia402?time=virtual", stream_cyclic),
    ];
    for (url, stream) in streams {
        let open = || connect_local(url).unwrap_or_else(|error| panic!("{url}: {error}"));
        stream(&open()).unwrap_or_else(|error| panic!("{url}: {error}"));
        for (act, code, words) in [
            (Act::Switch { which: 1, at: core::f64::consts::TAU }, "E106", "limit"),
            (Act::Jam(true), "E801", "error"),
        ] {
            let link = open();
            assert!(link.simulation().expect("a simulation").act(0, 0, act), "{url} {act:?}");
            let error = stream(&link).expect_err(url);
            assert_eq!(error.code(), code, "{url} {act:?}: {error}");
            assert!(error.to_string().contains(words), "{url} {act:?}: {error}");
            assert!(!error.to_string().contains("not executed"), "{url} {act:?}: {error}");
        }
    }
}
