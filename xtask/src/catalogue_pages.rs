//! The pages of drives that share one: Trinamic's modules by kind, and the table of all drives.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use polepair_core::axis::Verb;
use polepair_core::profile::{Parameter, Profile};
use polepair_core::units::Unit;

const MARK: &str = "<!-- Made from the profiles by `cargo xtask codegen`. Do not edit. -->\n";

/// Name of a page below `docs/drives`, and its text.
pub fn pages() -> [(&'static str, String); 3] {
    let (steppers, brushless) =
        (modules_of_family("tmcm"), modules_of_family("trinamic-brushless"));
    [
        ("all.md", table_of_all(&steppers, &brushless)),
        ("trinamic-steppers.md", modules_page(STEPPERS, &steppers)),
        ("trinamic-brushless.md", modules_page(BRUSHLESS, &brushless)),
    ]
}

fn modules_of_family(family: &str) -> Vec<&'static Profile> {
    let modules = polepair::profile::catalogue().iter().map(|module| module.profile());
    modules.filter(|profile| profile.family == family).collect()
}

const STEPPERS: &str = "\
# Trinamic stepper modules

The [TMCM-1140](tmcm-1140.md) and the [TMCM-6110](tmcm-6110.md) have pages of their own. The modules here are \
known from the maker's Python library: names and numbers of their parameters are certain, all else (units, \
ranges, what is stored) is concluded from those two and from public manuals of related modules.

`polepair scan` recognizes each by its version (`TMCM-1160 V1.20`), and `move`, `spin`, `home` and `stop` work \
with turns and rpm. Each can be simulated: `polepair scan sim:tmcm-1160`.

The TMCM-343, 351, 1180 and 3212 are not in that library: their parameters are taken from the module whose profile \
theirs extends.

Speeds are counted in one of two ways:

- *divided*: 0 to 2047, as the chip TMC429 counts; pulse divisor (AP 154) and ramp divisor (AP 153) scale them.
- *pps*: microsteps per second. Where a module has the parameter unit mode (AP 255), it has to be 1; otherwise \
polepair refuses speeds with a unit and takes raw numbers (`--raw`). Firmware 1.01 and older of the TMCM-1290 turns \
at 0.78 of the speed that is set (the maker's support article KB-20053).
";

const BRUSHLESS: &str = "\
# Trinamic brushless and servo modules

The [TMCM-170](tmcm-170.md) and [TMCM-171](tmcm-171.md) have pages of their own. The modules here are known from \
the maker's Python library: names and numbers of their parameters from its classes, units from its examples. No \
manual was compared. `polepair scan` recognizes each by its version, and `spin`, `move`, `torque` and `stop` work \
with rpm, turns and amperes; [Your first BLDC module](../guides/first-bldc-module.md) has the steps. Each can be \
simulated: `polepair move sim:tmcm-1640 5turn`. None of them has a reference search (RFS), so `home` is not offered.

Positions are counted in one of these ways:

- *position scaler*: its parameter has the counts of a turn, whatever the sensor is.
- *encoder or hall*: with commutation mode 7 a turn has as many counts as encoder steps (AP 250) says; with modes 0 \
and 6 it has three for each pole (AP 253). In other modes polepair refuses positions with a unit.
- *encoder*: absolute encoder steps (AP 250) has the counts of a turn.
- *unknown*: nothing explains the counts. `move` takes raw numbers (`--raw`).
";

/// A page of several modules: which there are, and which parameters each has.
fn modules_page(intro: &str, modules: &[&'static Profile]) -> String {
    let (title, intro) = intro.split_once("\n\n").unwrap_or((intro, ""));
    let mut text = format!("{title}\n\n{MARK}\n{intro}\n## Modules\n\n");
    text.push_str(
        "| module | profile | motors | speeds | positions | source |\n|---|---|---|---|---|---|\n",
    );
    for profile in modules {
        let _ = writeln!(
            text,
            "| {} | `{}` | {} | {} | {} | {} |",
            profile.title,
            profile.name,
            profile.motors,
            speeds(profile),
            positions(profile),
            profile.source
        );
    }
    text.push_str(
        "\n## Axis parameters\n\nModules are named by their number. Global parameters and user variables are those \
         of the modules with a page of their own.\n\n| AP | name | modules |\n|---|---|---|\n",
    );
    let mut rows: BTreeMap<(u16, &str), Vec<&str>> = BTreeMap::new();
    for profile in modules {
        for parameter in profile.parameters.iter().filter(|parameter| parameter.space == 0) {
            let number = profile.name.trim_start_matches("tmcm-");
            rows.entry((parameter.index, parameter.name)).or_default().push(number);
        }
    }
    for ((index, name), which) in rows {
        let which = if which.len() == modules.len() { "all".to_owned() } else { which.join(", ") };
        let _ = writeln!(text, "| {index} | {name} | {which} |");
    }
    text
}

fn parameter_named(profile: &'static Profile, name: &str) -> Option<&'static Parameter> {
    profile.find_parameter(name).and_then(|id| profile.parameter(id))
}

fn speeds(profile: &'static Profile) -> &'static str {
    let speed = parameter_named(profile, "target velocity");
    match speed.and_then(|speed| speed.scale.rule).map(|rule| rule.name) {
        Some("tmcm-velocity") => "divided",
        Some(_) => "pps",
        None if speed.is_some_and(|speed| speed.unit == Unit::Rpm) => "rpm",
        None => "unknown",
    }
}

fn positions(profile: &'static Profile) -> &'static str {
    let Some(position) = parameter_named(profile, "actual position") else { return "unknown" };
    match (position.scale.rule.map(|rule| rule.name), position.scale.over) {
        (Some("tmcm-bldc-position"), _) => "encoder or hall",
        (Some(_), _) => "microsteps",
        (None, Some(id)) => match profile.parameter(id).map_or("", |counts| counts.name) {
            "position scaler" => "position scaler",
            _ => "encoder",
        },
        (None, None) => "unknown",
    }
}

/// Source of a catalogue module's units.
fn source_of_units(profile: &'static Profile) -> &'static str {
    match (speeds(profile), positions(profile)) {
        ("rpm", "unknown") => "examples of the maker's library; positions raw",
        ("rpm", _) => "examples of the maker's library",
        _ if !profile.source.contains("PyTrinamic") => profile.source,
        _ => "manuals of related modules",
    }
}

fn table_of_all(steppers: &[&'static Profile], brushless: &[&'static Profile]) -> String {
    let mut text = format!(
        "# All drives\n\n{MARK}\nWhat polepair knows by name: each is read, stopped and simulated. A drive that is not \
         here is read and stopped by its protocol; `--profile FILE` describes one of your own.\n\n\
         | product | profile | protocol | motors | move | home | source of units |\n|---|---|---|---|---|---|---|\n"
    );
    let mut add = |profile: &'static Profile, page: &str, units: &str| {
        let has = |verb| if profile.plan(verb).is_some() { "yes" } else { "no" };
        let _ = writeln!(
            text,
            "| [{}]({page}.md) | `{}` | {} | {} | {} | {} | {units} |",
            profile.title,
            profile.name,
            profile.protocol,
            profile.motors.max(1),
            has(Verb::MoveTo),
            has(Verb::Home)
        );
    };
    polepair_drives::profiles()
        .iter()
        .for_each(|profile| add(profile, profile.name, profile.source));
    for profile in steppers {
        add(profile, "trinamic-steppers", source_of_units(profile));
    }
    for profile in brushless {
        add(profile, "trinamic-brushless", source_of_units(profile));
    }
    text
}
