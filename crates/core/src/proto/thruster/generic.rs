//! Common functions of all drives of this protocol, for drives without a profile: reading, and removing the
//! signal.

use super::wire::CommandWord;
use crate::axis::Verb;
use crate::plan::{Operand, Plan, Step};
use crate::profile::{
    Access, AxisKind, Certainty, Encoding, MotionRules, Parameter, ParameterId, Persistence,
    Profile, Scale, Signal, SignalSource, Watchdog,
};
use crate::units::Unit;

/// Profile of any drive of this protocol.
pub static GENERIC: Profile = Profile {
    name: "thruster-node",
    family: "thruster",
    protocol: "thruster",
    title: "Drive with the thruster protocol",
    source: "thruster protocol manual",
    axis: AxisKind::Rotary,
    motors: 1,
    further_motors: &[],
    lists_motors: false,
    parameters: PARAMETERS,
    faults: &[],
    signals: &[
        signal(Signal::Voltage, 0),
        signal(Signal::Velocity, 1),
        signal(Signal::Current, 2),
        signal(Signal::Temperature, 4),
        signal(Signal::Fault, 5),
    ],
    plans: &[Plan {
        verb: Verb::Stop,
        source: "thruster protocol manual 2.1, TC 0",
        steps: &[Step::Send {
            function: 0,
            index: CommandWord::TC.0,
            operand: Operand::Constant(0),
            like: None,
        }],
        undo: &[],
    }],
    ram: None,
    link_settings: &[],
    optional: &[],
    motion: MotionRules::NONE,
    watchdog: Watchdog::None,
    reply_timeout_ms: super::host::REPLY_TIMEOUT_MS,
    multiple_writes: false,
    line: None,
    identity: None,
    caution: "This drive is not known; only reading and stopping are offered. Give its profile \
              with profile=NAME.",
};

const PARAMETERS: &[Parameter] = &[
    reading(CommandWord::QP, "voltage", "QP", Unit::Volt, 0.1, Encoding::U16),
    reading(CommandWord::QV, "speed", "QV", Unit::Rpm, 1.0, Encoding::I16),
    reading(CommandWord::QC, "current", "QC", Unit::Ampere, 0.1, Encoding::I16),
    reading(CommandWord::QT, "motor temperature", "QT", Unit::Celsius, 1.0, Encoding::I16),
    reading(CommandWord::EQ, "driver temperature", "EQ", Unit::Celsius, 1.0, Encoding::I16),
    reading(CommandWord::EF, "faults", "EF", Unit::None, 1.0, Encoding::U16),
    reading(CommandWord::FR, "faults since start", "FR", Unit::None, 1.0, Encoding::U16),
];

const fn signal(signal: Signal, at: u16) -> SignalSource {
    SignalSource { signal, parameter: ParameterId(at), mask: -1, equals: None, values: &[] }
}

const fn reading(
    command: CommandWord,
    name: &'static str,
    symbol: &'static str,
    unit: Unit,
    factor: f64,
    encoding: Encoding,
) -> Parameter {
    Parameter {
        name,
        symbol,
        about: "",
        space: 0,
        index: command.0,
        encoding,
        unit,
        scale: Scale { factor, ..Scale::ONE },
        min: 0,
        max: 0,
        default: None,
        access: Access::Read,
        persistence: Persistence::Volatile,
        certainty: Certainty::Documented,
        moves: false,
        section: "2.1",
        values: &[],
        digits: &[],
        bits: &[],
    }
}
