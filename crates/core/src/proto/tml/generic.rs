//! Common functions of all TML drives, for firmware without a profile. Only facts that several sources
//! confirm; only the stop affects a motor.

use crate::axis::Verb;
use crate::plan::{Operand, Plan, Step};
use crate::profile::{
    Access, AxisKind, Certainty, Encoding, MotionRules, Parameter, ParameterId, Persistence,
    Profile, Scale, Signal, SignalSource, Watchdog,
};
use crate::units::Unit;

/// Any TML drive.
pub static GENERIC: Profile = Profile {
    name: "tml",
    family: "tml",
    protocol: "tml",
    title: "TML drive",
    source: "TML communication manual, the vendor's help pages and library",
    axis: AxisKind::Rotary,
    motors: 1,
    further_motors: &[],
    lists_motors: false,
    parameters: PARAMETERS,
    faults: &[],
    signals: &[
        number(Signal::Position, 0),
        number(Signal::TargetPosition, 2),
        number(Signal::Fault, 5),
        flag(Signal::Enabled, 0x8000, 0x8000),
        flag(Signal::Moving, 0x0400, 0),
        flag(Signal::Reached, 0x0400, 0x0400),
    ],
    plans: &[
        Plan { verb: Verb::Stop, source: "STOP", steps: &[send(0x01C4)], undo: &[] },
        Plan { verb: Verb::Disable, source: "AXISOFF", steps: &[send(0x0002)], undo: &[] },
    ],
    ram: None,
    link_settings: &[],
    optional: &[],
    motion: MotionRules::NONE,
    watchdog: Watchdog::None,
    reply_timeout_ms: 500,
    multiple_writes: false,
    line: None,
    identity: None,
    caution: "This drive's firmware is not known, and addresses and units depend on it. Only what \
              all have in common is offered: reading and stopping. Give its profile with \
              profile=NAME.",
};

/// Parameters in the order of addresses, as in every memory.
const PARAMETERS: &[Parameter] = &[
    variable(0x0228, "APOS", "actual position", "Where the load is, in counts.", Encoding::I32),
    variable(0x022A, "POSERR", "position error", "In counts.", Encoding::I16),
    variable(
        0x02B2,
        "TPOS",
        "target position",
        "Where the trajectory is, in counts.",
        Encoding::I32,
    ),
    variable(0x0309, "MCR", "motion command", "Mode of motion.", Encoding::U16),
    variable(0x030C, "AAR", "axis address", "Groups in the high byte, axis ID.", Encoding::U16),
    variable(0x08FC, "MER", "motion error", "Errors, one bit each.", Encoding::U16),
    variable(0x090E, "SRL", "status low", "State of the axis.", Encoding::U16),
    variable(0x090F, "SRH", "status high", "State of the drive.", Encoding::U16),
];

const fn number(signal: Signal, at: u16) -> SignalSource {
    SignalSource { signal, parameter: ParameterId(at), mask: -1, equals: None, values: &[] }
}

const fn flag(signal: Signal, mask: i64, equals: i64) -> SignalSource {
    SignalSource { signal, parameter: ParameterId(6), mask, equals: Some(equals), values: &[] }
}

const fn variable(
    index: u16,
    symbol: &'static str,
    name: &'static str,
    about: &'static str,
    encoding: Encoding,
) -> Parameter {
    Parameter {
        name,
        symbol,
        about,
        space: 0,
        index,
        encoding,
        unit: Unit::None,
        scale: Scale::ONE,
        min: i32::MIN as i64,
        max: i32::MAX as i64,
        default: None,
        access: Access::Read,
        persistence: Persistence::Volatile,
        certainty: Certainty::Inferred,
        moves: false,
        section: "TML communication manual; vendor library TML_LIB_light",
        values: &[],
        digits: &[],
        bits: &[],
    }
}

const fn send(opcode: u16) -> Step {
    Step::Send { function: 0, index: opcode, operand: Operand::Constant(0), like: None }
}
