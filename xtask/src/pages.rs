//! A page for every drive, made from its profile: `docs/drives/NAME.md`.

use std::fmt::Write as _;

use polepair_core::plan::{Argument, Compare, Operand, ParameterTest, Plan, RampSpeed, Step};
use polepair_core::profile::{
    Access, Certainty, Encoding, Fault, Parameter, ParameterId, Persistence, Profile, Severity,
    Watchdog,
};

/// The page of a profile; `part` is written by hand and comes before the verbs.
pub fn drive_page(profile: &Profile, part: &str) -> String {
    let mut out = String::new();
    let mut add = |text: String| {
        out.push_str(&text);
        out.push('\n');
    };
    add(format!("# {}\n", profile.title));
    add("<!-- Made from the profile by `cargo xtask codegen`. Do not edit. -->\n".to_owned());
    add(format!(
        "Profile `{}`, family `{}`, protocol `{}`. Source: {}.\n",
        profile.name, profile.family, profile.protocol, profile.source
    ));
    add(format!("{}\n", profile.caution));
    add(format!("**If the link is lost:** {}.\n", watchdog_text(profile)));
    if !part.is_empty() {
        add(format!("{}\n", part.trim_end()));
    }
    add("## Verbs\n\nSteps of each verb.\n".to_owned());
    profile.plans.iter().for_each(|plan| add(plan_text(profile, plan)));
    add("## Faults and warnings\n".to_owned());
    add("| code | name | fault | usual cause | remedy |\n|---|---|---|---|---|".to_owned());
    profile.faults.iter().for_each(|fault| add(fault_row(fault)));
    add("\n## Parameters\n".to_owned());
    add("Raw limits; `i` marks values inferred from similar products; `*` marks parameters that may move the \
         motor.\n"
        .to_owned());
    add("| symbol | name | unit | raw range | factory | access | kept | |\n\
         |---|---|---|---|---|---|---|---|"
        .to_owned());
    let shown = profile.parameters.iter().filter(|p| is_shown(p));
    shown.for_each(|parameter| add(parameter_row(parameter)));
    add(remainder_text(profile) + &memory_map_text(profile));
    out
}

/// Returns whether a parameter is listed: the first of numbered repetitions is, and undocumented ones are only counted.
fn is_shown(parameter: &Parameter) -> bool {
    let number = parameter.name.split(' ').find_map(|word| word.parse::<u32>().ok());
    parameter.certainty != Certainty::Undocumented
        && !is_mapped(parameter)
        && !(parameter.name.starts_with("path ") && number.is_some_and(|n| n > 1))
}

/// Known by name and address alone, from a memory map.
fn is_mapped(parameter: &Parameter) -> bool {
    parameter.about.is_empty() && parameter.name == parameter.symbol
}

/// Parameters that only a memory map documents, by type.
fn memory_map_text(profile: &Profile) -> String {
    let types = [
        (Encoding::I16, "INT, signed 16 bits"),
        (Encoding::U16, "UINT, unsigned 16 bits"),
        (Encoding::I32, "LONG, signed 32 bits"),
        (Encoding::U32, "ULONG, unsigned 32 bits"),
        (Encoding::Fixed, "FIXED, 16.16"),
    ];
    let mut text = String::new();
    for (encoding, title) in types {
        let these = profile.parameters.iter().filter(|p| is_mapped(p) && p.encoding == encoding);
        let names: Vec<String> = these.map(|p| format!("{} {:04X}", p.symbol, p.index)).collect();
        if !names.is_empty() {
            let _ = write!(text, "\n**{title}:** {}.\n", names.join(", "));
        }
    }
    if text.is_empty() {
        return text;
    }
    format!(
        "\n## The rest of the memory\n\nNames with their addresses; no source says more.\n{text}"
    )
}

fn remainder_text(profile: &Profile) -> String {
    let undocumented =
        profile.parameters.iter().filter(|p| p.certainty == Certainty::Undocumented).count();
    let repeated =
        profile.parameters.iter().filter(|p| !is_shown(p) && !is_mapped(p)).count() - undocumented;
    let mut text = String::new();
    if repeated > 0 {
        let _ = write!(text, "\n{repeated} more of paths 2 and up, alike.");
    }
    if undocumented > 0 {
        let _ = write!(text, "\n{undocumented} more exist and no manual says what they are.");
    }
    text
}

fn watchdog_text(profile: &Profile) -> String {
    match profile.watchdog {
        Watchdog::None => "the drive continues its last command. Prefer moves, which end by \
                           themselves, or wire a stop input"
            .to_owned(),
        Watchdog::Fixed { after_ms } => format!("the drive stops after {after_ms} ms"),
        Watchdog::Configurable { parameter, on_can } => {
            let on_can = on_can.map_or_else(String::new, |on_can| {
                format!(" on a serial line, in {} on CAN", parameter_name(profile, on_can))
            });
            let parameter = parameter_name(profile, parameter);
            format!("the drive stops after the time in {parameter}{on_can}; 0 switches it off")
        }
        Watchdog::LifeGuarding { objects: [period, factor], .. } => format!(
            "the drive reacts if its master does not guard it for {} times {}; this software does \
             not guard",
            parameter_name(profile, period),
            parameter_name(profile, factor)
        ),
        Watchdog::Heartbeat { consumer, reaction: None, .. } => format!(
            "the drive stops if the heartbeat in {} is missing; 0 switches it off",
            parameter_name(profile, consumer)
        ),
        Watchdog::Heartbeat { consumer, reaction: Some(reaction), .. } => format!(
            "the drive reacts as set in {} if the heartbeat in {} is missing; if either is 0, \
             it continues",
            parameter_name(profile, reaction),
            parameter_name(profile, consumer)
        ),
    }
}

fn plan_text(profile: &Profile, plan: &Plan) -> String {
    let mut text = format!("**{}** ({})\n\n", plan.verb.name(), plan.source);
    for step in plan.steps {
        let _ = writeln!(text, "1. {}", step_text(profile, *step));
    }
    if !plan.undo.is_empty() {
        let steps: Vec<String> = plan.undo.iter().map(|s| step_text(profile, *s)).collect();
        let _ = writeln!(text, "\nIf a step fails: {}.", steps.join("; "));
    }
    text
}

fn step_text(profile: &Profile, step: Step) -> String {
    match step {
        Step::Write(id, operand) => {
            format!("write {} = {}", name_of_parameter(id, profile), operand_text(operand))
        }
        Step::Ensure(id, raw) => {
            format!("make sure that {} = {raw}", name_of_parameter(id, profile))
        }
        Step::WriteTogether(writes) => {
            let one = |(id, operand): &(ParameterId, Operand)| {
                format!("{} = {}", name_of_parameter(*id, profile), operand_text(*operand))
            };
            let writes: Vec<String> = writes.iter().map(one).collect();
            format!("write with one request: {}", writes.join(", "))
        }
        Step::WriteBits { id, mask, raw } => format!(
            "write bits {mask:#x} of {} = {raw:#x}, the others as they are",
            name_of_parameter(id, profile)
        ),
        Step::SkipBySign { argument, if_negative, count } => {
            let sign = if if_negative { "is negative" } else { "is not negative" };
            format!("leave out the next {count} if the {} {sign}", argument_word(argument))
        }
        Step::Read(id) => format!("read {}", name_of_parameter(id, profile)),
        Step::Copy { from, to } => format!(
            "write {} = what {} is",
            name_of_parameter(to, profile),
            name_of_parameter(from, profile)
        ),
        Step::Require { read, test, hint } => {
            format!(
                "go on only if {} (else: {hint})",
                test_text(&name_of_parameter(read, profile), test)
            )
        }
        Step::Skip { read, test, count } => {
            format!(
                "leave out the next {count} if {}",
                test_text(&name_of_parameter(read, profile), test)
            )
        }
        Step::SkipIfMissing { read, count } => {
            format!(
                "leave out the next {count} if the drive has no {}",
                name_of_parameter(read, profile)
            )
        }
        Step::NoFault { read, .. } => {
            format!("go on only if {} shows no fault", name_of_parameter(read, profile))
        }
        Step::Until { read, test, within_ms, required } => {
            let after = if required { "" } else { ", then go on" };
            let seconds = seconds(within_ms);
            format!(
                "wait until {}, at most {seconds} s{after}",
                test_text(&name_of_parameter(read, profile), test)
            )
        }
        Step::Send { function, index, operand, .. } => {
            format!("send {function} {index} {}", operand_text(operand))
        }
        Step::Store(id) => format!("have {} kept over power-off", name_of_parameter(id, profile)),
        Step::Wait { ms } => format!("wait {ms} ms"),
        Step::Standstill { within_ms } => {
            format!(
                "wait until the motor is measured at standstill, at most {} s",
                seconds(within_ms)
            )
        }
        Step::Homed { read, test, within_ms } => format!(
            "wait until homing was seen to run and {}, at most {} s",
            test_text(&name_of_parameter(read, profile), test),
            seconds(within_ms)
        ),
        Step::Arrival { flag, within_ms } => {
            let flag = flag.map_or_else(String::new, |(read, test)| {
                format!("{}, and ", test_text(&name_of_parameter(read, profile), test))
            });
            format!(
                "wait until {flag}the measured position is at the target, at most {} s",
                seconds(within_ms)
            )
        }
    }
}

fn name_of_parameter(id: ParameterId, profile: &Profile) -> String {
    parameter_name(profile, id)
}

fn seconds(ms: u32) -> f64 {
    f64::from(ms) / 1000.0
}

fn test_text(name: &str, test: ParameterTest) -> String {
    let masked = match test.mask {
        -1 => name.to_owned(),
        mask => format!("{name} & {mask:#x}"),
    };
    match test.compare {
        Compare::Equal => format!("{masked} is {}", test.value),
        Compare::NotEqual => format!("{masked} is not {}", test.value),
        Compare::Within => format!("{masked} is within ±{}", test.value),
        Compare::Above => format!("{masked} is greater than {}", test.value),
        Compare::Among => {
            let numbers = (0..63).filter(|n| test.value >> n & 1 == 1);
            let words: Vec<String> = numbers.map(|n| n.to_string()).collect();
            format!("{masked} is {}", words.join(" or "))
        }
    }
}

fn operand_text(operand: Operand) -> String {
    match operand {
        Operand::Constant(raw) => raw.to_string(),
        Operand::Argument(argument) => format!("the {}", argument_word(argument)),
        Operand::Magnitude(argument) => format!("the magnitude of the {}", argument_word(argument)),
        Operand::OptionalArgument(argument) => format!("the {}, if given", argument_word(argument)),
        Operand::OptionalRampTime { argument, speed } => {
            let speed = match speed {
                RampSpeed::Fixed(rpm) => format!("{rpm} rpm"),
                RampSpeed::VelocityOr(rpm) => format!("the velocity, else to {rpm} rpm"),
            };
            format!("the time in which the {}, if given, leads to {speed}", argument_word(argument))
        }
    }
}

fn argument_word(argument: Argument) -> &'static str {
    match argument {
        Argument::Target => "target",
        Argument::Velocity => "velocity",
        Argument::Acceleration => "acceleration",
        Argument::Deceleration => "deceleration",
        Argument::Torque => "torque",
        Argument::JerkTime => "time of the jerk",
        Argument::Period => "period",
        Argument::Path => "number of the path",
    }
}

fn parameter_name(profile: &Profile, id: ParameterId) -> String {
    match profile.parameter(id) {
        Some(p) if p.symbol.is_empty() => format!("`{}`", p.name),
        Some(p) => format!("`{}` ({})", p.name, p.symbol),
        None => "?".to_owned(),
    }
}

fn fault_row(fault: &Fault) -> String {
    let what = match fault.severity {
        Severity::Fault => "",
        Severity::Warning => "warning: ",
        Severity::Note => "note: ",
    };
    let Fault { code, name, text, cause, remedy, .. } = fault;
    format!("| {code:#06x} | {name} | {what}{text} | {cause} | {remedy} |")
}

fn parameter_row(p: &Parameter) -> String {
    let factory = p.default.map_or_else(String::new, |raw| raw.to_string());
    let access = match p.access {
        Access::Read => "r",
        Access::Write => "w",
        Access::ReadWrite => "rw",
    };
    let saved = match p.persistence {
        Persistence::Volatile => "",
        Persistence::Storable => "if stored",
        Persistence::Always => "always",
        Persistence::UnlessRam => "unless RAM",
    };
    let inferred = if p.certainty == Certainty::Inferred { "i" } else { "" };
    let moves = if p.moves { "*" } else { "" };
    let range = match p.access {
        Access::Read => String::new(),
        _ => format!("{}…{}", p.min, p.max),
    };
    let unit = p.unit.symbol();
    format!(
        "| {} | {} | {unit} | {range} | {factory} | {access} | {saved} | {inferred}{moves} |",
        p.symbol, p.name
    )
}
