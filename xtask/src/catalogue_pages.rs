//! The pages of drives that share one: Trinamic's modules by kind, and the table of all drives.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use polepair_core::profile::Profile;

const MARK: &str = "<!-- Made from the profiles by `cargo xtask codegen`. Do not edit. -->\n";

/// Name of a page below `docs/drives`, and its text.
pub fn pages() -> [(&'static str, String); 3] {
    let (steppers, brushless) = (modules_of_kind(true), modules_of_kind(false));
    [
        ("all.md", table_of_all(&steppers, &brushless)),
        ("trinamic-steppers.md", modules_page(STEPPERS, &steppers)),
        ("trinamic-brushless.md", modules_page(BRUSHLESS, &brushless)),
    ]
}

fn modules_of_kind(simulated: bool) -> Vec<&'static Profile> {
    let modules = polepair::profile::catalogue().iter();
    modules.filter(|it| it.is_simulated() == simulated).map(|it| it.profile()).collect::<Vec<_>>()
}

const STEPPERS: &str = "\
# Trinamic stepper modules

The [TMCM-1140](tmcm-1140.md) and the [TMCM-6110](tmcm-6110.md) have pages of their own. The modules here are \
known from the maker's Python library: names and numbers of their parameters are certain, all else (units, \
ranges, what is stored) is concluded from those two and from public manuals of related modules.

`polepair scan` recognizes each by its version (`TMCM-1160 V1.20`), and `move`, `spin`, `home` and `stop` work \
with turns and rpm. Each can be simulated: `polepair scan sim:tmcm-1160`.

Speeds are counted in one of three ways:

- *divided*: 0 to 2047, as the chip TMC429 counts; pulse divisor (AP 154) and ramp divisor (AP 153) scale them.
- *pps*: microsteps per second. Where a module has the parameter unit mode (AP 255), it has to be 1; otherwise \
polepair refuses speeds with a unit and takes raw numbers (`--raw`).
- *unknown*: no source tells the unit. Speeds are raw numbers (`--raw`); positions are in turns.
";

const BRUSHLESS: &str = "\
# Trinamic brushless and servo modules

The [TMCM-170](tmcm-170.md) and [TMCM-171](tmcm-171.md) have pages of their own. The modules here are known from \
the maker's Python library, by names and numbers of their parameters alone. `polepair scan` recognizes each by \
its version; `get`, `set`, `watch`, `info` and `stop` work with the module's own numbers. `move` and `spin` are \
not offered, because no source tells their units. They cannot be simulated.
";

/// A page of several modules: which there are, and which parameters each has.
fn modules_page(intro: &str, modules: &[&'static Profile]) -> String {
    let (title, intro) = intro.split_once("\n\n").unwrap_or((intro, ""));
    let mut text = format!("{title}\n\n{MARK}\n{intro}\n## Modules\n\n");
    text.push_str("| module | profile | motors | speeds | source |\n|---|---|---|---|---|\n");
    for profile in modules {
        let _ = writeln!(
            text,
            "| {} | `{}` | {} | {} | {} |",
            profile.title,
            profile.name,
            profile.motors,
            speeds(profile),
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

fn speeds(profile: &Profile) -> &'static str {
    let speed = profile.find_parameter("target velocity").and_then(|id| profile.parameter(id));
    match speed.and_then(|speed| speed.scale.rule).map(|rule| rule.name) {
        Some("tmcm-velocity") => "divided",
        Some(_) => "pps",
        None => "unknown",
    }
}

fn table_of_all(steppers: &[&'static Profile], brushless: &[&'static Profile]) -> String {
    let mut text = format!(
        "# All drives\n\n{MARK}\nWhat polepair knows by name. A drive that is not here is read and stopped by its \
         protocol; `--profile FILE` describes one of your own.\n\n\
         | product | profile | protocol | motors | simulated |\n|---|---|---|---|---|\n"
    );
    let mut add = |profile: &Profile, page: &str, simulated: &str| {
        let _ = writeln!(
            text,
            "| [{}]({page}.md) | `{}` | {} | {} | {simulated} |",
            profile.title,
            profile.name,
            profile.protocol,
            profile.motors.max(1)
        );
    };
    polepair_drives::profiles().iter().for_each(|profile| add(profile, profile.name, "yes"));
    steppers.iter().for_each(|profile| add(profile, "trinamic-steppers", "yes"));
    brushless.iter().for_each(|profile| add(profile, "trinamic-brushless", "no"));
    text
}
