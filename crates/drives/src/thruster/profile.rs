//! Generated from `profiles/*.toml` by `cargo xtask codegen`. Do not edit.
#![allow(clippy::approx_constant, clippy::excessive_precision, reason = "the manuals' numbers")]
#![allow(clippy::large_const_arrays, reason = "rows that tables share, read while compiling")]

use polepair_core::axis::Verb;
use polepair_core::plan::{Argument, Operand, Plan, Step};
use polepair_core::profile::{
    Access, AxisKind, Certainty, Encoding, Fault, Identity, IdentityQuery, MotionRules, Parameter,
    ParameterId, Persistence, Profile, Scale, Severity, Signal, SignalSource, Watchdog,
};
use polepair_core::units::Unit;

#[rustfmt::skip]
const P: Parameter = Parameter {
    name: "", symbol: "", about: "", space: 0, index: 0, encoding: Encoding::I32,
    unit: Unit::None, scale: Scale::ONE, min: 0, max: 0, default: None,
    access: Access::ReadWrite, persistence: Persistence::Volatile,
    certainty: Certainty::Documented, moves: false, section: "", values: &[], digits: &[], bits: &[],
};

#[rustfmt::skip]
static THRUSTER_PARAMETERS: [Parameter; 15] = [
    Parameter { name: "voltage", symbol: "QP", about: "Supply.", section: "2.1", index: 0x5150, encoding: Encoding::U16, unit: Unit::Volt, min: 0, max: 65535, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "signal", symbol: "TC", about: "Control signal, open loop. The manual calls TC torque control once; it is a share of the output.", section: "2.1", index: 0x5443, encoding: Encoding::I16, unit: Unit::Percent, min: -100, max: 100, access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Documented, moves: true, ..P },
    Parameter { name: "target speed", symbol: "VC", about: "Speed asked for; 0 stops, 1 to 29 rpm are refused.", section: "2.1", index: 0x5643, encoding: Encoding::I16, unit: Unit::Rpm, min: -4000, max: 4000, access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Inferred, moves: true, ..P },
    Parameter { name: "speed", symbol: "QV", about: "Speed.", section: "2.1", index: 0x5156, encoding: Encoding::I16, unit: Unit::Rpm, min: -32768, max: 32767, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "current", symbol: "QC", about: "Current.", section: "2.1", index: 0x5143, encoding: Encoding::I16, unit: Unit::Ampere, min: -32768, max: 32767, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "motor temperature", symbol: "QT", about: "Temperature of the motor.", section: "2.1", index: 0x5154, encoding: Encoding::I16, unit: Unit::Celsius, min: -32768, max: 32767, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "driver temperature", symbol: "EQ", about: "Temperature of the driver. The letters are reversed against QT: so printed.", section: "2.1", index: 0x4551, encoding: Encoding::I16, unit: Unit::Celsius, min: -32768, max: 32767, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "faults", symbol: "EF", about: "Faults there are now. Communication timeout can be read once.", section: "2.1, 3", index: 0x4546, encoding: Encoding::U16, unit: Unit::None, min: 0, max: 65535, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "faults since start", symbol: "FR", about: "Every fault since the start.", section: "2.6", index: 0x4652, encoding: Encoding::U16, unit: Unit::None, min: 0, max: 65535, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "command timeout", symbol: "ST", about: "Without any command for so long the output is closed; 0 is never, else 100 to 60000 ms. Polepair feeds it for a second behind a program's last request.", section: "2.3", index: 0x5354, encoding: Encoding::U16, unit: Unit::Millisecond, min: 0, max: 60000, default: Some(0), access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "reply form", symbol: "VM", about: "What TC and VC are answered with: flags in the high byte, reports 1 to 3 in the low one. Holds until the next restart [inferred].", section: "2.4", index: 0x564d, encoding: Encoding::U16, unit: Unit::None, min: 0, max: 1023, default: Some(0), access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Documented, values: &[(0, "echo"), (1, "report 1"), (2, "report 2"), (3, "reports 1 and 2"), (4, "report 3"), (5, "reports 1 and 3"), (6, "reports 2 and 3"), (7, "reports 1 to 3"), (256, "headerless"), (512, "silent")], ..P },
    Parameter { name: "autosend", symbol: "SR", about: "What is reported by itself from power-up on: reports 1 to 3 as bits 16 to 18, interval in ms below; 0 is off. Holds at once and is kept.", section: "2.5", index: 0x5352, encoding: Encoding::U32, unit: Unit::None, min: 0, max: 524287, default: Some(0), access: Access::Write, persistence: Persistence::Always, certainty: Certainty::Documented, ..P },
    Parameter { name: "value report", symbol: "MQ", about: "Current and speed reported by themselves: every second (ML), every 100 ms (MM), or not (MQ, which also pauses autosend). Not kept over power-off.", section: "2.1", index: 0x4d51, encoding: Encoding::U16, unit: Unit::None, min: 0, max: 2, default: Some(0), access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Documented, values: &[(0, "off"), (1, "1 s"), (2, "100 ms")], ..P },
    Parameter { name: "node id", symbol: "CI", about: "The id from the next start on.", section: "2.2", index: 0x4349, encoding: Encoding::U16, unit: Unit::None, min: 1, max: 127, access: Access::Write, persistence: Persistence::Always, certainty: Certainty::Documented, ..P },
    Parameter { name: "bit rate", symbol: "CB", about: "The bit rate in kbit/s from the next start on. The factory's is not stated; 500 is what public drivers use.", section: "2.2", index: 0x4342, encoding: Encoding::U16, unit: Unit::None, min: 10, max: 1000, default: Some(500), access: Access::Write, persistence: Persistence::Always, certainty: Certainty::Documented, values: &[(10, "10k"), (20, "20k"), (33, "33.33k"), (40, "40k"), (50, "50k"), (66, "66.66k"), (80, "80k"), (83, "83.33k"), (100, "100k"), (125, "125k"), (150, "150k"), (200, "200k"), (250, "250k"), (333, "333.33k"), (400, "400k"), (500, "500k"), (666, "666.66k"), (800, "800k"), (1000, "1M")], ..P },
];

#[rustfmt::skip]
static THRUSTER_FAULTS: [Fault; 14] = [
    Fault { code: 0x4000, name: "motor temperature", text: "motor temperature, as the example of section 2.6 calls a bit that the table reserves", cause: "Not documented.", remedy: "Read the motor's temperature.", severity: Severity::Warning },
    Fault { code: 0x2000, name: "motor sensor", text: "motor temperature sensor", cause: "The sensor or its wire is broken.", remedy: "Have the drive serviced; the motor's protection against heat is missing.", severity: Severity::Warning },
    Fault { code: 0x1000, name: "driver sensor", text: "driver temperature sensor", cause: "The sensor is broken.", remedy: "Have the drive serviced; the driver's protection against heat is missing.", severity: Severity::Warning },
    Fault { code: 0x800, name: "communication timeout", text: "no command came within the command timeout: output off", cause: "The program or the line stopped.", remedy: "Send the next command; it clears this.", severity: Severity::Fault },
    Fault { code: 0x400, name: "zero-point protection", text: "the signal has not been zero yet: output forbidden", cause: "The first signal after power-up or a fault was not zero.", remedy: "Enable the axis: that sends a zero signal first.", severity: Severity::Fault },
    Fault { code: 0x200, name: "motor over-temperature", text: "motor above 120 degC: output limited until 100 degC", cause: "Overload, or run dry.", remedy: "Lower the signal; under water it cools.", severity: Severity::Warning },
    Fault { code: 0x100, name: "driver over-temperature", text: "driver above 120 degC: output limited until 100 degC", cause: "Overload, or run dry.", remedy: "Lower the signal; under water it cools.", severity: Severity::Warning },
    Fault { code: 0x80, name: "encoder", text: "encoder fault: position commands are void", cause: "Encoder or its wire.", remedy: "Clear faults or restart; if it comes back have the drive serviced.", severity: Severity::Fault },
    Fault { code: 0x40, name: "stall protection", text: "the motor does not turn: output off", cause: "Something is in the propeller, or the axis is at its end.", remedy: "Take the power off, free it, clear faults, enable.", severity: Severity::Fault },
    Fault { code: 0x10, name: "under-voltage", text: "supply too low", cause: "Empty battery, thin cable.", remedy: "Check the supply under load.", severity: Severity::Warning },
    Fault { code: 0x8, name: "over-voltage", text: "supply too high", cause: "Wrong supply, or a braking motor on a supply that takes nothing back.", remedy: "Check the supply.", severity: Severity::Warning },
    Fault { code: 0x4, name: "over-current", text: "too much current: output off", cause: "Blocked propeller, winding fault.", remedy: "Free it, clear faults, enable; if it comes back have the drive serviced.", severity: Severity::Fault },
    Fault { code: 0x2, name: "EEPROM data", text: "stored settings are wrong: output off", cause: "A power cut while settings were written.", remedy: "Write id, bit rate and autosend again, clear faults, restart.", severity: Severity::Fault },
    Fault { code: 0x1, name: "EEPROM access", text: "stored settings cannot be read or written: output off", cause: "The memory is broken.", remedy: "Have the drive serviced.", severity: Severity::Fault },
];

#[rustfmt::skip]
static THRUSTER_SIGNALS: [SignalSource; 5] = [
    SignalSource { signal: Signal::Velocity, parameter: ParameterId(3), mask: -1, equals: None, values: &[] },
    SignalSource { signal: Signal::Current, parameter: ParameterId(4), mask: -1, equals: None, values: &[] },
    SignalSource { signal: Signal::Voltage, parameter: ParameterId(0), mask: -1, equals: None, values: &[] },
    SignalSource { signal: Signal::Temperature, parameter: ParameterId(6), mask: -1, equals: None, values: &[] },
    SignalSource { signal: Signal::Fault, parameter: ParameterId(7), mask: -1, equals: None, values: &[] },
];

#[rustfmt::skip]
static THRUSTER_PLANS: [Plan; 7] = [
    Plan { verb: Verb::Enable, source: "manual section 3, zero-point protection: TC 0 first", steps: &[
        Step::Send { function: 0x0, index: 0x5443, operand: Operand::Constant(0), like: None },
        Step::NoFault { read: ParameterId(7), mask: 0xcc7 },
    ], undo: &[] },
    Plan { verb: Verb::Disable, source: "manual section 2.1: TC 0", steps: &[
        Step::Send { function: 0x0, index: 0x5443, operand: Operand::Constant(0), like: None },
    ], undo: &[] },
    Plan { verb: Verb::Stop, source: "manual section 2.1: TC 0", steps: &[
        Step::Send { function: 0x0, index: 0x5443, operand: Operand::Constant(0), like: None },
        Step::Standstill { within_ms: 10000 },
    ], undo: &[] },
    Plan { verb: Verb::QuickStop, source: "manual section 2.1: TC 0; LS is for drives with positions", steps: &[
        Step::Send { function: 0x0, index: 0x5443, operand: Operand::Constant(0), like: None },
        Step::Standstill { within_ms: 10000 },
    ], undo: &[] },
    Plan { verb: Verb::Clear, source: "manual section 2.1: CF", steps: &[
        Step::Send { function: 0x1, index: 0x4346, operand: Operand::Constant(0), like: None },
        Step::NoFault { read: ParameterId(7), mask: 0xcc7 },
    ], undo: &[] },
    Plan { verb: Verb::Velocity, source: "manual section 2.1: VC", steps: &[
        Step::Send { function: 0x0, index: 0x5643, operand: Operand::Argument(Argument::Velocity), like: Some(ParameterId(2)) },
    ], undo: &[
        Step::Send { function: 0x0, index: 0x5443, operand: Operand::Constant(0), like: None },
    ] },
    Plan { verb: Verb::Torque, source: "manual section 2.1: TC, a share of the output", steps: &[
        Step::Send { function: 0x0, index: 0x5443, operand: Operand::Argument(Argument::Torque), like: Some(ParameterId(1)) },
    ], undo: &[
        Step::Send { function: 0x0, index: 0x5443, operand: Operand::Constant(0), like: None },
    ] },
];

/// Underwater thruster.
#[rustfmt::skip]
pub static THRUSTER: Profile = Profile { name: "thruster", family: "thruster", protocol: "thruster", title: "Underwater thruster", source: "thruster protocol manual", axis: AxisKind::Rotary, motors: 1, further_motors: &[], lists_motors: false, parameters: &THRUSTER_PARAMETERS, faults: &THRUSTER_FAULTS, signals: &THRUSTER_SIGNALS, plans: &THRUSTER_PLANS, motion: MotionRules::NONE, identity: Some(Identity { query: IdentityQuery::Text("QP"), mask: 0x7f00000000000000, equals: 0x5100000000000000, firmware: 0x0 }), ram: None, link_settings: &[ParameterId(13), ParameterId(14)], optional: &[], watchdog: Watchdog::Configurable { parameter: ParameterId(9), on_can: None }, reply_timeout_ms: 50, multiple_writes: false, line: None, caution: "The propeller turns at once: keep hands and lines away, and run it under water, where it is cooled. It continues to turn if the line is lost, unless command timeout (ST) is set, which is kept until the next restart. After power-up, and after a fault that closed the output, it runs only after a zero signal, which enable sends." };

#[rustfmt::skip]
static THRUSTER_ACTUATOR_PARAMETERS: [Parameter; 25] = THRUSTER_ACTUATOR_PARAMETERS_ROWS;

#[rustfmt::skip]
const THRUSTER_ACTUATOR_PARAMETERS_ROWS: [Parameter; 25] = [
    Parameter { name: "voltage", symbol: "QP", about: "Supply.", section: "2.1", index: 0x5150, encoding: Encoding::U16, unit: Unit::Volt, min: 0, max: 65535, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "signal", symbol: "TC", about: "Control signal, open loop. The manual calls TC torque control once; it is a share of the output.", section: "2.1", index: 0x5443, encoding: Encoding::I16, unit: Unit::Percent, min: -100, max: 100, access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Documented, moves: true, ..P },
    Parameter { name: "target speed", symbol: "VC", about: "Speed asked for; 0 brakes to rest, 1 to 29 rpm are refused.", section: "2.1", index: 0x5643, encoding: Encoding::I16, unit: Unit::Rpm, min: -200, max: 200, access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Inferred, moves: true, ..P },
    Parameter { name: "speed", symbol: "QV", about: "Speed.", section: "2.1", index: 0x5156, encoding: Encoding::I16, unit: Unit::Rpm, min: -32768, max: 32767, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "current", symbol: "QC", about: "Current.", section: "2.1", index: 0x5143, encoding: Encoding::I16, unit: Unit::Ampere, min: -32768, max: 32767, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "motor temperature", symbol: "QT", about: "Temperature of the motor.", section: "2.1", index: 0x5154, encoding: Encoding::I16, unit: Unit::Celsius, min: -32768, max: 32767, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "driver temperature", symbol: "EQ", about: "Temperature of the driver. The letters are reversed against QT: so printed.", section: "2.1", index: 0x4551, encoding: Encoding::I16, unit: Unit::Celsius, min: -32768, max: 32767, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "faults", symbol: "EF", about: "Faults there are now. Communication timeout can be read once.", section: "2.1, 3", index: 0x4546, encoding: Encoding::U16, unit: Unit::None, min: 0, max: 65535, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "faults since start", symbol: "FR", about: "Every fault since the start.", section: "2.6", index: 0x4652, encoding: Encoding::U16, unit: Unit::None, min: 0, max: 65535, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "command timeout", symbol: "ST", about: "Without any command for so long the output is closed; 0 is never, else 100 to 60000 ms. Polepair feeds it for a second behind a program's last request.", section: "2.3", index: 0x5354, encoding: Encoding::U16, unit: Unit::Millisecond, min: 0, max: 60000, default: Some(0), access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P },
    Parameter { name: "reply form", symbol: "VM", about: "What TC and VC are answered with: flags in the high byte, reports 1 to 3 in the low one. Holds until the next restart [inferred].", section: "2.4", index: 0x564d, encoding: Encoding::U16, unit: Unit::None, min: 0, max: 1023, default: Some(0), access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Documented, values: &[(0, "echo"), (1, "report 1"), (2, "report 2"), (3, "reports 1 and 2"), (4, "report 3"), (5, "reports 1 and 3"), (6, "reports 2 and 3"), (7, "reports 1 to 3"), (256, "headerless"), (512, "silent")], ..P },
    Parameter { name: "autosend", symbol: "SR", about: "What is reported by itself from power-up on: reports 1 to 3 as bits 16 to 18, interval in ms below; 0 is off. Holds at once and is kept.", section: "2.5", index: 0x5352, encoding: Encoding::U32, unit: Unit::None, min: 0, max: 524287, default: Some(0), access: Access::Write, persistence: Persistence::Always, certainty: Certainty::Documented, ..P },
    Parameter { name: "value report", symbol: "MQ", about: "Current and speed reported by themselves: every second (ML), every 100 ms (MM), or not (MQ, which also pauses autosend). Not kept over power-off.", section: "2.1", index: 0x4d51, encoding: Encoding::U16, unit: Unit::None, min: 0, max: 2, default: Some(0), access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Documented, values: &[(0, "off"), (1, "1 s"), (2, "100 ms")], ..P },
    Parameter { name: "node id", symbol: "CI", about: "The id from the next start on.", section: "2.2", index: 0x4349, encoding: Encoding::U16, unit: Unit::None, min: 1, max: 127, access: Access::Write, persistence: Persistence::Always, certainty: Certainty::Documented, ..P },
    Parameter { name: "bit rate", symbol: "CB", about: "The bit rate in kbit/s from the next start on. The factory's is not stated; 500 is what public drivers use.", section: "2.2", index: 0x4342, encoding: Encoding::U16, unit: Unit::None, min: 10, max: 1000, default: Some(500), access: Access::Write, persistence: Persistence::Always, certainty: Certainty::Documented, values: &[(10, "10k"), (20, "20k"), (33, "33.33k"), (40, "40k"), (50, "50k"), (66, "66.66k"), (80, "80k"), (83, "83.33k"), (100, "100k"), (125, "125k"), (150, "150k"), (200, "200k"), (250, "250k"), (333, "333.33k"), (400, "400k"), (500, "500k"), (666, "666.66k"), (800, "800k"), (1000, "1M")], ..P },
    Parameter { name: "absolute position", symbol: "QA", about: "Stroke from the absolute zero (AZ).", section: "4.1", index: 0x5141, encoding: Encoding::I16, unit: Unit::Millimetre, min: -32768, max: 32767, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Inferred, ..P },
    Parameter { name: "target position", symbol: "LA", about: "Target of moves. Written by itself it starts nothing, for its speed is zero then.", section: "4.1", index: 0x4c41, encoding: Encoding::I32, unit: Unit::Millimetre, min: -1799, max: 1799, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Inferred, moves: true, ..P },
    Parameter { name: "relative position", symbol: "QR", about: "Stroke from the relative zero (RZ).", section: "4.2", index: 0x5152, encoding: Encoding::I32, unit: Unit::Millimetre, min: -2147483648, max: 2147483647, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Inferred, ..P },
    Parameter { name: "relative way", symbol: "LR", about: "Way of relative moves: each one that is sent adds. Written by itself it starts nothing, for its speed is zero then.", section: "4.2", index: 0x4c52, encoding: Encoding::I32, unit: Unit::Millimetre, min: -1000000, max: 1000000, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Inferred, moves: true, ..P },
    Parameter { name: "safe range", symbol: "SPLA", about: "Both ends in one word: reverse end in the upper 16 bits, forward end in the lower, in tenths of a degree [inferred]. Written by `reverse end` and `forward end`.", section: "4.1", space: 1, index: 0x4c41, encoding: Encoding::U32, unit: Unit::None, min: 0, max: 4294967295, access: Access::Read, persistence: Persistence::Always, certainty: Certainty::Documented, ..P },
    Parameter { name: "reverse end", symbol: "RPLA reverse", about: "Reverse end of the safe range, beyond which absolute moves are refused. It is written with the other end, which is read first.", section: "4.1", space: 2, index: 0x4c41, encoding: Encoding::I16, unit: Unit::Millimetre, min: -1799, max: 0, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::ReadWrite, persistence: Persistence::Always, certainty: Certainty::Inferred, ..P },
    Parameter { name: "forward end", symbol: "RPLA forward", about: "Forward end of the safe range, beyond which absolute moves are refused. It is written with the other end, which is read first.", section: "4.1", space: 3, index: 0x4c41, encoding: Encoding::I16, unit: Unit::Millimetre, min: 0, max: 1799, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::ReadWrite, persistence: Persistence::Always, certainty: Certainty::Inferred, ..P },
    Parameter { name: "absolute zero", symbol: "AZ", about: "Makes the present position the absolute zero. It is kept over power-off.", section: "4.1", index: 0x415a, encoding: Encoding::U16, unit: Unit::None, min: 1, max: 1, access: Access::Write, persistence: Persistence::Always, certainty: Certainty::Documented, values: &[(1, "here")], ..P },
    Parameter { name: "relative zero", symbol: "RZ", about: "Makes the present position the relative zero. It is kept over power-off [inferred].", section: "4.2", index: 0x525a, encoding: Encoding::U16, unit: Unit::None, min: 1, max: 1, access: Access::Write, persistence: Persistence::Always, certainty: Certainty::Documented, values: &[(1, "here")], ..P },
    Parameter { name: "relative counter", symbol: "RC", about: "Clears the relative position, and what is left of a relative move.", section: "4.2", index: 0x5243, encoding: Encoding::U16, unit: Unit::None, min: 1, max: 1, access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Documented, moves: true, values: &[(1, "clear")], ..P },
];

#[rustfmt::skip]
static THRUSTER_ACTUATOR_SIGNALS: [SignalSource; 7] = [
    SignalSource { signal: Signal::Position, parameter: ParameterId(15), mask: -1, equals: None, values: &[] },
    SignalSource { signal: Signal::Velocity, parameter: ParameterId(3), mask: -1, equals: None, values: &[] },
    SignalSource { signal: Signal::Current, parameter: ParameterId(4), mask: -1, equals: None, values: &[] },
    SignalSource { signal: Signal::Voltage, parameter: ParameterId(0), mask: -1, equals: None, values: &[] },
    SignalSource { signal: Signal::Temperature, parameter: ParameterId(6), mask: -1, equals: None, values: &[] },
    SignalSource { signal: Signal::Fault, parameter: ParameterId(7), mask: -1, equals: None, values: &[] },
    SignalSource { signal: Signal::Enabled, parameter: ParameterId(7), mask: 0x847, equals: Some(0), values: &[] },
];

#[rustfmt::skip]
static THRUSTER_ACTUATOR_PLANS: [Plan; 9] = [
    Plan { verb: Verb::Enable, source: "manual section 4: position commands need no zero signal", steps: &[
        Step::NoFault { read: ParameterId(7), mask: 0x8c7 },
    ], undo: &[] },
    Plan { verb: Verb::Disable, source: "manual section 4.3: LS", steps: &[
        Step::Send { function: 0x0, index: 0x4c53, operand: Operand::Constant(0), like: None },
    ], undo: &[] },
    Plan { verb: Verb::Stop, source: "manual section 4.3: LS", steps: &[
        Step::Send { function: 0x0, index: 0x4c53, operand: Operand::Constant(0), like: None },
        Step::Standstill { within_ms: 10000 },
    ], undo: &[] },
    Plan { verb: Verb::QuickStop, source: "manual section 4.3: LS", steps: &[
        Step::Send { function: 0x0, index: 0x4c53, operand: Operand::Constant(0), like: None },
        Step::Standstill { within_ms: 10000 },
    ], undo: &[] },
    Plan { verb: Verb::Clear, source: "manual section 2.1: CF", steps: &[
        Step::Send { function: 0x1, index: 0x4346, operand: Operand::Constant(0), like: None },
        Step::NoFault { read: ParameterId(7), mask: 0xcc7 },
    ], undo: &[] },
    Plan { verb: Verb::Velocity, source: "manual sections 2.1 and 3: VC 0 for zero-point protection, VC", steps: &[
        Step::Send { function: 0x0, index: 0x5643, operand: Operand::Constant(0), like: None },
        Step::Send { function: 0x0, index: 0x5643, operand: Operand::Argument(Argument::Velocity), like: Some(ParameterId(2)) },
    ], undo: &[
        Step::Send { function: 0x0, index: 0x4c53, operand: Operand::Constant(0), like: None },
    ] },
    Plan { verb: Verb::Torque, source: "manual sections 2.1 and 3: TC 0 for zero-point protection, TC, a share of the output", steps: &[
        Step::Send { function: 0x0, index: 0x5443, operand: Operand::Constant(0), like: None },
        Step::Send { function: 0x0, index: 0x5443, operand: Operand::Argument(Argument::Torque), like: Some(ParameterId(1)) },
    ], undo: &[
        Step::Send { function: 0x0, index: 0x4c53, operand: Operand::Constant(0), like: None },
    ] },
    Plan { verb: Verb::MoveTo, source: "manual section 4.1: LA, at 30 rpm unless a speed is given", steps: &[
        Step::NoFault { read: ParameterId(7), mask: 0x8c7 },
        Step::Send { function: 0x4, index: 0x5141, operand: Operand::OptionalArgument(Argument::Velocity), like: Some(ParameterId(2)) },
        Step::Send { function: 0x2, index: 0x1e, operand: Operand::Argument(Argument::Target), like: Some(ParameterId(16)) },
    ], undo: &[
        Step::Send { function: 0x0, index: 0x4c53, operand: Operand::Constant(0), like: None },
    ] },
    Plan { verb: Verb::MoveBy, source: "manual section 4.2: LR, at 30 rpm unless a speed is given; never sent again, for each one adds", steps: &[
        Step::NoFault { read: ParameterId(7), mask: 0x8c7 },
        Step::Send { function: 0x4, index: 0x5141, operand: Operand::OptionalArgument(Argument::Velocity), like: Some(ParameterId(2)) },
        Step::Send { function: 0x3, index: 0x1e, operand: Operand::Argument(Argument::Target), like: Some(ParameterId(18)) },
    ], undo: &[
        Step::Send { function: 0x0, index: 0x4c53, operand: Operand::Constant(0), like: None },
    ] },
];

/// Underwater linear actuator.
#[rustfmt::skip]
pub static THRUSTER_ACTUATOR: Profile = Profile { name: "thruster-actuator", family: "thruster", protocol: "thruster", title: "Underwater linear actuator", source: "thruster protocol manual", axis: AxisKind::Linear, motors: 1, further_motors: &[], lists_motors: false, parameters: &THRUSTER_ACTUATOR_PARAMETERS, faults: &THRUSTER_FAULTS, signals: &THRUSTER_ACTUATOR_SIGNALS, plans: &THRUSTER_ACTUATOR_PLANS, motion: MotionRules::NONE, identity: Some(Identity { query: IdentityQuery::Text("QA"), mask: 0x7fff000000000000, equals: 0x5141000000000000, firmware: 0x0 }), ram: None, link_settings: &[ParameterId(13), ParameterId(14)], optional: &[], watchdog: Watchdog::Configurable { parameter: ParameterId(9), on_can: None }, reply_timeout_ms: 50, multiple_writes: false, line: None, caution: "The rod moves at once, within its safe range. Its output is off after a stop, so a load may fall. One count of position is assumed to be 0.1 mm: try a short move first. It continues to move if the line is lost, unless command timeout (ST) is set, which is kept until the next restart. Default speed of a move: 30 rpm of its motor." };

#[rustfmt::skip]
static THRUSTER_SERVO_PARAMETERS: [Parameter; 25] = {
let mut rows = THRUSTER_ACTUATOR_PARAMETERS_ROWS;
rows[15] = Parameter { name: "absolute position", symbol: "QA", about: "Position from the absolute zero (AZ).", section: "4.1", index: 0x5141, encoding: Encoding::I16, unit: Unit::Degree, min: -32768, max: 32767, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Documented, ..P };
rows[16] = Parameter { name: "target position", symbol: "LA", about: "Target of moves. Written by itself it starts nothing, for its speed is zero then.", section: "4.1", index: 0x4c41, encoding: Encoding::I32, unit: Unit::Degree, min: -1799, max: 1799, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Documented, moves: true, ..P };
rows[17] = Parameter { name: "relative position", symbol: "QR", about: "Position from the relative zero (RZ). The manual gives no unit; taken for LA's.", section: "4.2", index: 0x5152, encoding: Encoding::I32, unit: Unit::Degree, min: -2147483648, max: 2147483647, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::Read, persistence: Persistence::Volatile, certainty: Certainty::Inferred, ..P };
rows[18] = Parameter { name: "relative way", symbol: "LR", about: "Way of relative moves: each one that is sent adds. Written by itself it starts nothing, for its speed is zero then.", section: "4.2", index: 0x4c52, encoding: Encoding::I32, unit: Unit::Degree, min: -1000000, max: 1000000, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::Write, persistence: Persistence::Volatile, certainty: Certainty::Documented, moves: true, ..P };
rows[20] = Parameter { name: "reverse end", symbol: "RPLA reverse", about: "Reverse end of the safe range, beyond which absolute moves are refused. It is written with the other end, which is read first.", section: "4.1", space: 2, index: 0x4c41, encoding: Encoding::I16, unit: Unit::Degree, min: -1799, max: 0, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::ReadWrite, persistence: Persistence::Always, certainty: Certainty::Inferred, ..P };
rows[21] = Parameter { name: "forward end", symbol: "RPLA forward", about: "Forward end of the safe range, beyond which absolute moves are refused. It is written with the other end, which is read first.", section: "4.1", space: 3, index: 0x4c41, encoding: Encoding::I16, unit: Unit::Degree, min: 0, max: 1799, scale: Scale { factor: 0.1, times: None, over: None, rule: None, negative: None }, access: Access::ReadWrite, persistence: Persistence::Always, certainty: Certainty::Inferred, ..P };
rows
};

/// Underwater servo.
#[rustfmt::skip]
pub static THRUSTER_SERVO: Profile = Profile { name: "thruster-servo", family: "thruster", protocol: "thruster", title: "Underwater servo", source: "thruster protocol manual", axis: AxisKind::Rotary, motors: 1, further_motors: &[], lists_motors: false, parameters: &THRUSTER_SERVO_PARAMETERS, faults: &THRUSTER_FAULTS, signals: &THRUSTER_ACTUATOR_SIGNALS, plans: &THRUSTER_ACTUATOR_PLANS, motion: MotionRules::NONE, identity: Some(Identity { query: IdentityQuery::Text("QA"), mask: 0x7fff000000000000, equals: 0x5141000000000000, firmware: 0x0 }), ram: None, link_settings: &[ParameterId(13), ParameterId(14)], optional: &[], watchdog: Watchdog::Configurable { parameter: ParameterId(9), on_can: None }, reply_timeout_ms: 50, multiple_writes: false, line: None, caution: "The servo moves at once, within its safe range. Its output is off after a stop, so a load may fall. It continues to move if the line is lost, unless command timeout (ST) is set, which is kept until the next restart. Default speed of a move: 30 rpm. An actuator replies like a servo: use profile=thruster-actuator for it." };

/// Every profile of this file, by name.
pub static PROFILES: [&Profile; 3] = [&THRUSTER, &THRUSTER_ACTUATOR, &THRUSTER_SERVO];
