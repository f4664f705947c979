//! Common functions of all TMCL modules, for modules without a profile. Only the stop affects a motor.

use crate::axis::Verb;
use crate::plan::{Operand, Plan, Step};
use crate::profile::{
    Access, AxisKind, Certainty, Encoding, MotionRules, Parameter, ParameterId, Persistence,
    Profile, Scale, Signal, SignalSource, Watchdog,
};
use crate::units::Unit;

/// Any TMCL module.
pub static GENERIC: Profile = Profile {
    name: "tmcl",
    family: "tmcl",
    protocol: "tmcl",
    title: "TMCL module",
    source: "TMCL reference manuals",
    axis: AxisKind::Rotary,
    motors: 0,
    further_motors: &[],
    lists_motors: false,
    parameters: PARAMETERS,
    faults: &[],
    signals: &[
        signal(Signal::Position, 1),
        signal(Signal::Velocity, 3),
        signal(Signal::TargetPosition, 0),
        signal(Signal::TargetVelocity, 2),
    ],
    plans: &[Plan {
        verb: Verb::Stop,
        source: "TMCL reference, MST",
        steps: &[Step::Send { function: 3, index: 0, operand: Operand::Constant(0), like: None }],
        undo: &[],
    }],
    ram: None,
    link_settings: &[],
    optional: &[],
    motion: MotionRules::NONE,
    watchdog: Watchdog::None,
    reply_timeout_ms: 100,
    multiple_writes: false,
    line: None,
    identity: None,
    caution: "This module is not known. Units and limits are the module's own numbers; only \
              reading and stopping are offered. Give its profile with profile=NAME.",
};

const PARAMETERS: &[Parameter] = &[
    axis(0, "target position", "AP 0"),
    axis(1, "actual position", "AP 1"),
    axis(2, "target velocity", "AP 2"),
    axis(3, "actual velocity", "AP 3"),
    global(65, "baud rate code", "GP 65", "0 = 9600 … 7 = 115200; holds from its reply on.", 11),
    global(66, "module address", "GP 66", "Serial address.", 255),
    global(69, "can bit rate code", "GP 69", "1 = 10k … 6 = 250k … 8 = 1M.", 8),
    global(70, "can reply id", "GP 70", "CAN identifier of replies.", 0x7FF),
    global(71, "can id", "GP 71", "CAN identifier of requests.", 0x7FF),
    global(73, "eeprom lock", "GP 73", "1234 locks, 4321 unlocks; reads 1 or 0.", 4321),
    global(75, "telegram pause time", "GP 75", "Pause before a serial reply.", 255),
    global(76, "host address", "GP 76", "Address in serial replies.", 255),
    global(128, "application status", "GP 128", "0 stop, 1 run, 2 step, 3 reset.", 0),
    global(132, "tick timer", "GP 132", "Milliseconds since start.", i32::MAX as i64),
];

const fn signal(signal: Signal, at: u16) -> SignalSource {
    SignalSource { signal, parameter: ParameterId(at), mask: -1, equals: None, values: &[] }
}

const fn axis(index: u16, name: &'static str, symbol: &'static str) -> Parameter {
    Parameter {
        name,
        symbol,
        about: "",
        space: 0,
        index,
        encoding: Encoding::I32,
        unit: Unit::None,
        scale: Scale::ONE,
        min: i32::MIN as i64,
        max: i32::MAX as i64,
        default: None,
        access: Access::Read,
        persistence: Persistence::Volatile,
        certainty: Certainty::Inferred,
        moves: false,
        section: "TMCL reference, axis parameters",
        values: &[],
        digits: &[],
        bits: &[],
    }
}

const fn global(
    index: u16,
    name: &'static str,
    symbol: &'static str,
    about: &'static str,
    max: i64,
) -> Parameter {
    Parameter {
        about,
        space: 1,
        min: 0,
        max,
        unit: if index == 75 { Unit::Millisecond } else { Unit::None },
        access: if index == 128 { Access::Read } else { Access::ReadWrite },
        persistence: if index < 128 { Persistence::Always } else { Persistence::Volatile },
        section: "TMCL reference, global parameters, bank 0",
        ..axis(index, name, symbol)
    }
}
