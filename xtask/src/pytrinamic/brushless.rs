//! Brushless and servo modules: the units of what their motion needs, from the library's examples.
//!
//! The examples move each of these modules, and so show the units: `rotate(2000)  # 2000 rpm` (TMCM-1690, 2611), a
//! current of 2000 mA, and positions as counts, of which a turn has as many as the position scaler states
//! (`PositionScaler = encoder.resolution`, TMCM-1617 to 1638, 2611), or as encoder or hall sensors have (TMCM-1630,
//! 1633, 1640). Nothing shows the counts of the TMCM-1690, whose positions stay raw.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use polepair_core::profile::Profile;

use super::{GENERIC_NAMES, Module, head, list, plain_row, row, words_of};

/// The hand-written profile of a brushless module.
pub(super) const BASE: &str = "tmcm-170";
/// The parameter that a module of the TMCM-1690's kind has, and no other.
const UNIT_SELECTION: &str = "VelocityUnitSelection";

/// Scale of a parameter's value.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Position,
    Velocity,
    Acceleration,
    Current,
    Voltage,
    Temperature,
}

/// Class of the library: its kind of value, and whether writing it starts a motor.
fn kind_of(name: &str) -> Option<(Kind, bool)> {
    Some(match name {
        "TargetPosition" => (Kind::Position, true),
        "ActualPosition" | "RampPosition" => (Kind::Position, false),
        "TargetVelocity" => (Kind::Velocity, true),
        "ActualVelocity"
        | "RampVelocity"
        | "MaxVelocity"
        | "TargetReachedVelocity"
        | "PositionReachedVelocity"
        | "MotorHaltedVelocity"
        | "HaltedVelocity" => (Kind::Velocity, false),
        "MaxAcceleration" => (Kind::Acceleration, false),
        "TargetTorque" => (Kind::Current, true),
        "ActualTorque" | "MaxCurrent" | "MaxTorque" | "OpenLoopCurrent" => (Kind::Current, false),
        "SupplyVoltage" => (Kind::Voltage, false),
        "DriverTemperature" => (Kind::Temperature, false),
        _ => return None,
    })
}

/// Measured values and states: they are read, and writing them sets at most a counter.
fn is_reading(name: &str) -> bool {
    name.starts_with("Ramp") && !matches!(name, "RampType" | "RampAcceleration")
        || name.starts_with("Actual") && name != "ActualPosition"
        || matches!(
            name,
            "StatusFlags" | "SupplyVoltage" | "DriverTemperature" | "PositionReachedFlag"
        )
}

/// Settings, by their names: no targets, readings or orders.
fn is_storable(name: &str) -> bool {
    let others = ["Target", "Actual", "Measured", "Latched", "Debug", "Clear", "Reinit", "Current"];
    !others.iter().any(|other| name.starts_with(other))
}

/// Settings that scale or limit motion.
fn is_setting(name: &str) -> bool {
    matches!(
        name,
        "PositionScaler"
            | "EncoderSteps"
            | "AbsoluteEncoderSteps"
            | "MotorPoles"
            | "MotorPolePairs"
            | "CommutationMode"
            | "EnableRamp"
            | "TargetReachedDistance"
            | "PositionReachedDistance"
    )
}

/// Profile of a module. Global parameters are those of `base`, whose axis parameters it has none of.
pub(super) fn profile(module: &Module, base: &Profile, source: &str) -> String {
    let has = |name: &str| module.has(name);
    let counts = match () {
        () if has("PositionScaler") => Some("{ factor = 360.0, over = \"position scaler\" }"),
        () if has("AbsoluteEncoderSteps") => {
            Some("{ factor = 360.0, over = \"absolute encoder steps\" }")
        }
        () if has("MotorPoles") => Some("{ rule = \"tmcm-bldc-position\" }"),
        () => None,
    };
    let unit = match counts {
        Some(_) => {
            "units are those of the library's examples: rpm, mA, counts of a turn by its settings"
        }
        None => {
            "speeds are in rpm, as in the library's examples; its positions are counts that nothing explains"
        }
    };
    let mut text = head(module, BASE, "trinamic-brushless", source, unit);
    let names = parameter_names(module);
    let of_base = base.parameters.iter().filter(|parameter| parameter.space == 0);
    let removed: Vec<&str> = of_base.map(|parameter| parameter.name).collect();
    let _ = writeln!(text, "remove = {}", list(&removed));
    text.push_str("replace = [\"signals\", \"plans\", \"faults\"]\n");
    for (at, name) in &module.parameters {
        let words = &names[at];
        let kind = kind_of(name).filter(|(kind, _)| *kind != Kind::Position || counts.is_some());
        let scale = kind.map_or(String::new(), |(kind, _)| unit_line(kind, counts.unwrap_or("")));
        let moves = kind_of(name).is_some_and(|(_, moves)| moves) || name == "EnableDriver";
        let access = match () {
            () if is_reading(name) => "access = \"r\"\n",
            () if moves => "moves = true\n",
            () if name == "ActualPosition" => "",
            () if is_setting(name) || kind.is_some() => "persistence = \"storable\"\n",
            // Of unknown effect; the examples store such settings.
            () if is_storable(name) => "moves = true\npersistence = \"storable\"\n",
            () => {
                plain_row(&mut text, *at, words, name);
                continue;
            }
        };
        let about = format!("{name} in the maker's library.");
        row(&mut text, *at, words, &about, &format!("{scale}{access}"));
    }
    let _ = write!(text, "\n{}", faults(module, &names));
    let _ = write!(text, "{}", motion(module, &names));
    text
}

/// Names by number. A word that the profile of all modules has already gets another one.
fn parameter_names(module: &Module) -> BTreeMap<u16, String> {
    let mut taken = BTreeSet::new();
    let own = |(at, name): (&u16, &String)| {
        let words = match (name.as_str(), words_of(name)) {
            // The TMCM-1690's words for what the other classes have.
            ("MaxTorque", _) if !module.has("MaxCurrent") => "max current".to_owned(),
            ("HaltedVelocity", _) => "motor halted velocity".to_owned(),
            (_, words) if GENERIC_NAMES.contains(&words.as_str()) => format!("motor {words}"),
            (_, words) => words,
        };
        let words = if taken.insert(words.clone()) { words } else { format!("{words} {at}") };
        (*at, words)
    };
    module.parameters.iter().map(own).collect()
}

fn unit_line(kind: Kind, counts: &str) -> String {
    match kind {
        Kind::Position => format!("unit = \"deg\"\nscale = {counts}\n"),
        Kind::Velocity => "unit = \"rpm\"\n".to_owned(),
        Kind::Acceleration => "unit = \"rpm/s\"\n".to_owned(),
        Kind::Current => "unit = \"A\"\nscale = 0.001\n".to_owned(),
        Kind::Voltage => "unit = \"V\"\nscale = 0.1\n".to_owned(),
        Kind::Temperature => "unit = \"degC\"\n".to_owned(),
    }
}

/// Flags of the status word that are faults, with their bits (TMCM1690.py; the other classes name bit 14 alone, which
/// is the same in all).
const FAULTS: [(u32, &str, &str, &str); 7] = [
    (
        0x01,
        "OVERCURRENT",
        "The current was too high.",
        "Look for a short circuit; lower max current.",
    ),
    (0x02, "UNDERVOLTAGE", "The supply voltage is too low.", "Check supply and cables."),
    (
        0x04,
        "OVERVOLTAGE",
        "The supply voltage is too high.",
        "Brake more slowly, or use a brake chopper.",
    ),
    (
        0x08,
        "OVERTEMPERATURE",
        "The power stage is too hot.",
        "Let it cool down; lower max current.",
    ),
    (0x20, "HALLERROR", "The hall signals are impossible.", "Check the hall cable and its supply."),
    (
        0x40,
        "DRIVER_ERROR",
        "The gate driver has reported an error.",
        "Switch the supply off and on.",
    ),
    (
        0x80,
        "INIT_ERROR",
        "The motor's sensor was not initialized.",
        "Check the sensor and its init mode.",
    ),
];

/// Returns whether the status word has the flags of [`FAULTS`]. The TMCM-2611's is not explained anywhere.
fn explains_flags(module: &Module) -> bool {
    module.has("StatusFlags") && !module.has("VelocityMeterCounterLimit")
}

fn faults(module: &Module, names: &BTreeMap<u16, String>) -> String {
    let mut text = String::from("[signals]\n");
    let named = |name: &str| names.values().any(|known| known == name);
    for (signal, name) in [
        ("position", "actual position"),
        ("velocity", "actual velocity"),
        ("current", "actual torque"),
        ("voltage", "supply voltage"),
        ("temperature", "driver temperature"),
        ("target-position", "target position"),
        ("target-velocity", "target velocity"),
    ] {
        if named(name) {
            let _ = writeln!(text, "{signal} = \"{name}\"");
        }
    }
    if named("enable driver") {
        text.push_str("enabled = { parameter = \"enable driver\", equals = 1 }\n");
    }
    if named("position reached flag") {
        text.push_str("reached = { parameter = \"position reached flag\", equals = 1 }\n");
    } else if named("status flags") {
        text.push_str(
            "reached = { parameter = \"status flags\", mask = 0x4000, equals = 0x4000 }\n",
        );
    }
    if !explains_flags(module) {
        return text;
    }
    text.push_str(
        "fault = { parameter = \"status flags\", mask = 0xEF }\n\
         mode = { parameter = \"status flags\", mask = 0xE00, values = { 0 = \"off\", 0x200 = \"velocity\", \
         0x400 = \"positioning\", 0x800 = \"torque\" } }\n\n\
         [motion]\nunpowered = \"status flags & 0xEF != 0\"\n",
    );
    for (code, name, about, remedy) in FAULTS {
        let _ = write!(
            text,
            "\n[[fault]]\ncode = {code:#06x}\nname = \"{name}\"\nseverity = \"fault\"\ntext = \"{about}\"\n\
             remedy = \"{remedy}\"\n"
        );
    }
    text
}

/// Plans of the verbs.
fn motion(module: &Module, names: &BTreeMap<u16, String>) -> String {
    let named = |name: &str| names.values().any(|known| known == name);
    let no_fault = if explains_flags(module) {
        "\"read status flags\", \"no-fault status flags & 0xEF\", "
    } else {
        ""
    };
    let mut text = String::new();
    let mut plan = |verb: &str, source: &str, steps: &str, undo: bool| {
        let undo = if undo { "undo = [\"send 3 0 0\"]\n" } else { "" };
        let _ = write!(text, "\n[plans.{verb}]\nsource = \"{source}\"\nsteps = [{steps}]\n{undo}");
    };
    if named("enable driver") {
        let steps = format!("{no_fault}\"write enable driver = 1\", \"send 1 0 0\"");
        plan("enable", "EnableDriver; ROR 0 holds the motor at rest", &steps, false);
        plan("disable", "EnableDriver", "\"write enable driver = 0\"", false);
    }
    let stop = "\"send 3 0 0\", \"standstill within 10 s\"";
    plan("stop", "TMCL reference, MST", stop, false);
    plan("quick-stop", "TMCL reference, MST; the module has no faster stop", stop, false);
    if explains_flags(module) {
        let steps = "\"read status flags\", \"read status flags\"";
        plan("clear", "StatusFlags: faults go with their cause", steps, false);
    }
    let ramp = "\"write max acceleration = {acceleration?}\", ";
    let steps = format!("{ramp}\"send 1 0 {{velocity}} like target velocity\"");
    plan("velocity", "rotate() of the library: ROR", &steps, true);
    if named("target torque") {
        plan("torque", "TargetTorque, a motor current", "\"write target torque = {torque}\"", true);
    }
    for (verb, kind) in [("move-to", 0), ("move-by", 1)] {
        let source =
            ["move_to() of the library: MVP ABS", "move_by() of the library: MVP REL"][kind];
        let steps = format!(
            "{ramp}\"write max velocity = {{velocity?}}\", \"send 4 {kind} {{target}} like actual position\""
        );
        plan(verb, source, &steps, true);
    }
    let stored = module.parameters.iter().filter(|(at, name)| {
        **at < 256
            && (is_setting(name)
                || matches!(kind_of(name), Some((kind, false)) if kind != Kind::Position))
            && !is_reading(name)
    });
    let stored: Vec<String> = stored.map(|(at, _)| format!("\"send 7 {at} 0\"")).collect();
    plan("store", "STAP, a parameter at a time", &stored.join(", "), false);
    debug_assert!(
        !module.has(UNIT_SELECTION) || module.number == 1690,
        "another module chooses its unit"
    );
    text
}
