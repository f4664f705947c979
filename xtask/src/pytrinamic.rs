//! Profiles of Trinamic's modules from the maker's Python library: numbers and names of parameters.
//!
//! `cargo xtask pytrinamic FOLDER` reads `FOLDER/modules/TMC*.py` of an installed PyTrinamic and writes
//! `crates/polepair/profiles/trinamic/*.toml`. It is run once for a release of the library; the files are
//! kept. Modules that have a hand-written profile (`profiles/*.toml`) are left out.

mod brushless;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;

use polepair_core::profile::{Parameter, Profile};

const STEPPER_CAUTION: &str = "A stepper motor loses steps without a word where the load is too much for \
     its current: set max current (AP 6) first. It continues to turn if the line is lost unless a heartbeat is set \
     (GP 68 serial, GP 82 CAN).";

/// Target folder of the files, below the root.
pub const FOLDER: &str = "crates/polepair/profiles/trinamic";
/// The module that the others with speeds in microsteps per second extend.
const PPS_BASE: &str = "tmcm-1241";
/// Hand-written profiles of modules with a TMC429.
const DIVIDED_BASE: (&str, &str) = ("tmcm-6110", "tmcm-1140");
/// Speeds and accelerations among the axis parameters of steppers.
const SPEEDS: [u16; 6] = [2, 3, 4, 181, 182, 194];
const SWITCH_SPEED: u16 = 195;
const ACCELERATION: u16 = 5;
/// Microstep resolution, full steps of the motor, unit mode.
const SCALING: [u16; 3] = [140, 202, 255];
/// Position of the reference in the old count, after a search.
const LAST_REFERENCE: u16 = 197;
/// Currents, whose full scale differs between modules.
const CURRENTS: [u16; 4] = [6, 7, 183, 200];
/// Axis parameters that mean the same in all stepper modules that have them, however they are spelled.
const COMMON: [std::ops::RangeInclusive<u16>; 8] =
    [0..=13, 140..=140, 160..=162, 165..=174, 180..=182, 193..=195, 197..=197, 206..=208];

/// Files whose class is that of several modules, by what follows `TMCM` in their names.
const SHARED_FILES: [(&str, &[u32]); 1] = [("123x_0_1", &[1230, 1231])];
/// Modules that the library lacks: number, motors, the profile that theirs extends, and the source for that.
const ALIKE: [(u32, usize, &str, &str); 4] = [
    (343, 3, "tmcm-6110", "TMCL reference for modules with a TMC428"),
    (351, 3, "tmcm-6110", "TMCL reference for modules with a TMC428"),
    (1180, 1, "tmcm-1140", "TMCM-1180 hardware manual, velocity and acceleration"),
    (3212, 3, "tmcm-3216", "TMCM-3212 TMCL firmware manual V1.07, chapter 6.5"),
];

/// A class of the library.
struct Module {
    number: u32,
    /// File of the library.
    file: String,
    name: String,
    motors: usize,
    parameters: BTreeMap<u16, String>,
}

/// Writes the profiles, and prints their names.
pub fn run(root: &Path, package: &Path) -> Result<(), String> {
    let version = package_version(package)?;
    let modules = read_modules(&package.join("modules"))?;
    let (many, single) = (load_profile(DIVIDED_BASE.0, root)?, load_profile(DIVIDED_BASE.1, root)?);
    let first = modules.iter().find(|module| module.name == PPS_BASE);
    let first = first.ok_or_else(|| format!("PyTrinamic has no {PPS_BASE}"))?;
    let source = format!("PyTrinamic {version}");
    for module in modules.iter().filter(|module| !is_written_by_hand(&module.name, root)) {
        let text = if !module.has("MicrostepResolution") {
            brushless::profile(module, load_profile(brushless::BASE, root)?, &source)
        } else if module.has("PulseDivisor") {
            let base = if module.has("EncoderPosition") { single } else { many };
            stepper(module, base, None, &source)
        } else {
            stepper(module, many, Some(first), &source)
        };
        let file = root.join(FOLDER).join(&module.name).with_extension("toml");
        write_profile(&file, &text)?;
    }
    for (number, motors, base, source) in ALIKE {
        let name = format!("tmcm-{number}");
        let parameters = BTreeMap::new();
        let module = Module { number, file: String::new(), name, motors, parameters };
        let unit =
            format!("units by {source}, and parameters those of the {}", base.to_uppercase());
        let text = head(&module, base, "tmcm", source, &unit);
        write_profile(&root.join(FOLDER).join(&module.name).with_extension("toml"), &text)?;
    }
    Ok(())
}

fn write_profile(file: &Path, text: &str) -> Result<(), String> {
    std::fs::write(file, text).map_err(|error| format!("{}: {error}", file.display()))?;
    println!("wrote {}", file.display());
    Ok(())
}

fn load_profile(name: &str, root: &Path) -> Result<&'static Profile, String> {
    let file = root.join(format!("profiles/{name}.toml"));
    polepair::load_profile(&file).map_err(|error| error.to_string())
}

fn is_written_by_hand(name: &str, root: &Path) -> bool {
    root.join(format!("profiles/{name}.toml")).is_file()
}

impl Module {
    fn has(&self, name: &str) -> bool {
        self.parameters.values().any(|known| known == name)
    }
}

/// The version of an installed package, from the metadata beside it.
fn package_version(package: &Path) -> Result<String, String> {
    let site = package.parent().ok_or("the package lies in no folder")?;
    let entries =
        std::fs::read_dir(site).map_err(|error| format!("{}: {error}", site.display()))?;
    let names = entries.flatten().filter_map(|entry| entry.file_name().into_string().ok());
    names
        .into_iter()
        .find_map(dist_info_version)
        .or_else(|| dist_info_version(site.file_name()?.to_string_lossy().into_owned()))
        .ok_or_else(|| {
            format!("no pytrinamic-*.dist-info in {}: which version is it?", site.display())
        })
}

fn dist_info_version(name: String) -> Option<String> {
    let rest = name.strip_prefix("pytrinamic-")?;
    Some(rest.strip_suffix(".dist-info").unwrap_or(rest).to_owned())
}

fn read_modules(folder: &Path) -> Result<Vec<Module>, String> {
    let entries = std::fs::read_dir(folder);
    let entries = entries.map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut modules = Vec::new();
    for path in entries.flatten().map(|entry| entry.path()) {
        let Some(stem) = path.file_stem().and_then(|stem| stem.to_str()) else { continue };
        let Some(digits) = stem.strip_prefix("TMCM") else { continue };
        let numbers: Vec<u32> = match SHARED_FILES.iter().find(|(shared, _)| *shared == digits) {
            Some((_, numbers)) => numbers.to_vec(),
            // Others are chips, boards, and modules that were not sold.
            None => digits.parse().into_iter().collect(),
        };
        let text = std::fs::read_to_string(&path);
        let text = text.map_err(|error| format!("{}: {error}", path.display()))?;
        let motors: BTreeSet<&str> = text
            .match_indices("(self, ")
            .filter_map(|(at, _)| motor_of(&text[..at], &text[at..]))
            .collect();
        let mut parameters = read_class(&text);
        // The classes of closed-loop steppers name the values of that parameter, and their examples write it.
        if parameters.values().any(|known| known == "FullstepResolution") {
            parameters.entry(SCALING[0]).or_insert_with(|| "MicrostepResolution".to_owned());
        }
        let mut parameters = read_class(&text);
        // The classes of closed-loop steppers name the values of that parameter, and their examples write it.
        if parameters.values().any(|known| known == "FullstepResolution") {
            parameters.entry(SCALING[0]).or_insert_with(|| "MicrostepResolution".to_owned());
        }
        // Every class of a stepper lacks some of what a reference search leaves; pylablib reads it from a TMCM-1110.
        if parameters.values().any(|known| known == "MicrostepResolution") {
            parameters.entry(LAST_REFERENCE).or_insert_with(|| "LastReferencePosition".to_owned());
        }
        for number in numbers {
            let mut parameters = parameters.clone();
            // Its class lacks what its example reads (TMCM2611/print_settings.py).
            if number == 2611 {
                parameters.entry(6).or_insert_with(|| "PWMFrequency".to_owned());
            }
            let (name, file) = (format!("tmcm-{number}"), format!("{stem}.py"));
            modules.push(Module { number, file, name, motors: motors.len().max(1), parameters });
        }
    }
    modules.sort_by_key(|module| module.number);
    if modules.is_empty() {
        return Err(format!("no TMCM*.py in {}", folder.display()));
    }
    Ok(modules)
}

/// The motor's number in `self._MotorTypeA(self, 0)`.
fn motor_of<'a>(before: &str, from: &'a str) -> Option<&'a str> {
    let class = before.rsplit(|c: char| !c.is_alphanumeric() && c != '_').next()?;
    let number = from["(self, ".len()..].split(')').next()?;
    (class.starts_with("_Motor") && number.parse::<u8>().is_ok()).then_some(number)
}

/// The constants of `class AP`.
fn read_class(text: &str) -> BTreeMap<u16, String> {
    let mut parameters = BTreeMap::new();
    let mut inside: Option<usize> = None;
    for line in text.lines().filter(|line| !line.trim().is_empty()) {
        if inside.is_some_and(|class| indent_width(line) <= class) {
            inside = None;
        }
        let words = line.trim();
        if words.strip_prefix("class AP").is_some_and(|rest| rest.starts_with([':', '(', '_'])) {
            inside = Some(indent_width(line));
        } else if inside.is_some()
            && let Some((name, number)) = words.split_once('=')
            && let Ok(number) =
                number.split_once('#').map_or(number, |(number, _)| number).trim().parse::<u16>()
        {
            parameters.entry(number).or_insert_with(|| name.trim().to_owned());
        }
    }
    parameters
}

fn indent_width(line: &str) -> usize {
    line.len() - line.trim_start().len()
}

/// `SmartEnergyHysteresis` in words.
fn words_of(name: &str) -> String {
    // `CLgammaVmin`, `CLInitFlag` and `CLinitflag`: closed loop, which has no word break behind it.
    if let Some(rest) = name.strip_prefix("CL").filter(|rest| rest.len() > 1) {
        return format!("closed loop {}", words_of(rest.trim_start_matches('_')));
    }
    let letters: Vec<char> = name.replace('_', "").chars().collect();
    let mut text = String::new();
    for (n, letter) in letters.iter().enumerate() {
        let before = n.checked_sub(1).map(|n| letters[n]);
        let after = letters.get(n + 1);
        let begins = letter.is_uppercase()
            && (before.is_some_and(|c| c.is_lowercase() || c.is_ascii_digit())
                || (before.is_some_and(|c| c.is_uppercase())
                    && after.is_some_and(|c| c.is_lowercase())));
        let digit = letter.is_ascii_digit() && before.is_some_and(|c| c.is_lowercase());
        if begins || (digit && !text.ends_with("guard")) {
            text.push(' ');
        }
        text.extend(letter.to_lowercase());
    }
    let spelled = [
        ("dc step", "dcstep"),
        ("stall guard", "stallguard"),
        ("smart energy", "coolstep"),
        ("sg2 filter enable", "stallguard filter"),
        ("theshold", "threshold"),
        ("minium", "minimum"),
        ("maximim", "maximum"),
        ("diable", "disable"),
        ("standtstill", "standstill"),
        ("i it", "iit "),
        ("iit  ", "iit "),
        ("initflag", "init flag"),
        ("vmin", "v min"),
        ("vmax", "v max"),
        ("enc ", "encoder "),
        ("intpol", "step interpolation"),
    ];
    for (from, to) in spelled {
        text = text.replace(from, to);
    }
    text
}

/// A stepper module, as `base` or as the module that all with microsteps per second extend.
fn stepper(module: &Module, base: &Profile, pps: Option<&Module>, source: &str) -> String {
    let is_first = module.name == PPS_BASE;
    let of_base: BTreeMap<u16, &Parameter> =
        base.parameters.iter().filter(|p| p.space == 0).map(|p| (p.index, p)).collect();
    let spelled: BTreeMap<u16, String> = match pps.filter(|_| !is_first) {
        // The parameters of the first module, with its words.
        Some(first) => {
            first.parameters.iter().map(|(at, name)| (*at, own_name(*at, name, &of_base))).collect()
        }
        None => of_base.iter().map(|(at, p)| (*at, p.name.to_owned())).collect(),
    };
    let wanted: BTreeMap<u16, String> =
        module.parameters.iter().map(|(at, name)| (*at, own_name(*at, name, &of_base))).collect();
    let removed: Vec<&str> = spelled
        .iter()
        .filter(|(at, name)| wanted.get(at) != Some(name))
        .map(|(_, name)| name.as_str())
        .collect();
    let extends = if pps.is_some() && !is_first { PPS_BASE } else { base.name };
    let unit = match (pps.is_some(), module.number) {
        // Support article KB-20053 of the maker: it counts with a clock of 16 MHz and has one of 12.5 MHz.
        (_, 1290) => {
            "speeds in microsteps per second; firmware up to 1.01 turns at 0.78 of the speed that is set"
        }
        (true, _) => "speeds in microsteps per second",
        (false, _) => "speeds of the TMC429, from 0 to 2047",
    };
    let mut text = head(module, extends, "tmcm", source, unit);
    let _ = writeln!(text, "remove = {}", list(&removed));
    // The scales of positions and speeds: other firmware may lack them.
    let scaling = wanted.iter().filter(|(at, _)| SCALING.contains(at));
    let scaling: Vec<&str> = scaling.map(|(_, name)| name.as_str()).collect();
    let _ = writeln!(text, "optional = {}", list(&scaling));
    if is_first {
        text.push_str("replace = [\"faults\", \"signals\", \"plans\"]\n");
    }
    for (at, name) in &wanted {
        let inherited = spelled.get(at) == Some(name);
        let pps_unit = match at {
            _ if pps.is_none() => None,
            &ACCELERATION => Some(("rpm/s", "acceleration")),
            at if SPEEDS.contains(at) || *at == SWITCH_SPEED => Some(("rpm", "velocity")),
            _ => None,
        };
        let about = of_base.get(at).filter(|p| p.name == name).map(|p| p.about);
        match pps_unit {
            Some((unit, rule)) if is_first => {
                let scale =
                    format!("unit = \"{unit}\"\nscale = {{ rule = \"tmcm-{rule}-pps\" }}\n");
                let about = about
                    .unwrap_or_default()
                    .trim_end_matches(", 0 to 2047.")
                    .trim_end_matches('.');
                speed_row(&mut text, *at, name, about, &scale);
            }
            _ if CURRENTS.contains(at) && (is_first || pps.is_none() || !inherited) => {
                current_row(&mut text, *at, name);
            }
            _ if inherited => {}
            _ => plain_row(&mut text, *at, name, &module.parameters[at]),
        }
    }
    if is_first {
        text.push_str(PPS_TAIL);
    }
    text
}

/// The word for an axis parameter of a stepper module: the hand-written profile's where it is that.
fn own_name(at: u16, name: &str, base: &BTreeMap<u16, &Parameter>) -> String {
    let common = COMMON.iter().any(|range| range.contains(&at));
    if let Some(known) = base.get(&at).filter(|p| {
        let (own, known) = (words_of(name), p.name);
        common || own == known || alike(at, name)
    }) {
        return known.name.to_owned();
    }
    let words = words_of(name);
    // The base may have the word for something else: an input's, another number's.
    let taken = ["supply voltage", "temperature", "module address"].contains(&words.as_str());
    if taken { format!("motor {words}") } else { words }
}

/// Spellings of the library for what the hand-written profile has at the number.
fn alike(at: u16, name: &str) -> bool {
    let name = name.replace('_', "").to_lowercase();
    matches!(
        (at, name.as_str()),
        (130, "minimumspeed")
            | (135, "actualacceleration")
            | (138, "ramptype" | "rampmode")
            | (141, "referenceswitchtolerance" | "refswitchtolerance")
            | (149, "softstopflag")
            | (150, "endswitchpowerdown")
            | (163, "constanttoffmode")
            | (164, "disablefastdecaycomparator")
            | (175, "slopecontrolhighside")
            | (176, "slopecontrollowside")
            | (177, "shorttogroundprotection")
            | (178, "shortdetectiontime")
            | (179, "vsense")
            | (183, "smartenergyslowruncurrent")
            | (184, "randomtoffmode")
            | (196, "referenceswitchdistance")
            | (200, "boostcurrent")
            | (204, "freewheelingdelay")
            | (209, "encoderposition")
            | (210, "encoderprescaler")
            | (212, "maxencoderdeviation")
            | (213, "groupindex")
            | (214, "powerdowndelay")
            | (217, "externalencoderprescaler")
            | (218, "externalencodermaxdeviation")
    )
}

/// Names that the profile of all TMCL modules has for global parameters.
const GENERIC_NAMES: [&str; 4] =
    ["host address", "module address", "application status", "tick timer"];

fn head(module: &Module, extends: &str, family: &str, source: &str, unit: &str) -> String {
    let Module { number, name, motors, file, .. } = module;
    let (source, known) = if file.is_empty() {
        (
            source.to_owned(),
            "The module is not in the maker's library and was not compared with its manual",
        )
    } else {
        let known = "The parameters are those of the maker's library and were not compared with this module's manual";
        (format!("{source}, {file}"), known)
    };
    let danger = match family {
        "tmcm" => STEPPER_CAUTION,
        _ => {
            "The motor continues to turn if the line is lost unless a heartbeat is set (GP 68 serial, GP 82 CAN). \
             Motion commands switch the power stage on by themselves."
        }
    };
    let (title, equals) = (format!("Trinamic TMCM-{number}"), number << 16);
    format!(
        "# The {title}: {unit}.\n\
         # Made by `cargo xtask pytrinamic`. Do not edit.\n\n\
         name = \"{name}\"\n\
         extends = \"{extends}\"\n\
         family = \"{family}\"\n\
         protocol = \"tmcl\"\n\
         title = \"{title}\"\n\
         source = \"{source}\"\n\
         motors = {motors}\n\
         identify = {{ ask = \"GET VERSION 1, 0, 0\", mask = 0xFFFF0000, equals = {equals:#010x}, \
         firmware = 0xFFFF }}\n\
         caution = \"{known}: {unit}. Ranges are not known; the module refuses what it cannot do. {danger}\"\n"
    )
}

fn list(names: &[&str]) -> String {
    let names: Vec<String> = names.iter().map(|name| format!("    \"{name}\",\n")).collect();
    if names.is_empty() { "[]".to_owned() } else { format!("[\n{}]", names.concat()) }
}

fn row(text: &mut String, at: u16, name: &str, about: &str, rest: &str) {
    let _ = write!(
        text,
        "\n[[parameter]]\nname = \"{name}\"\nsymbol = \"AP {at}\"\nabout = \"{about}\"\n\
         space = \"axis\"\nindex = {at}\n{rest}certainty = \"inferred\"\n"
    );
}

fn plain_row(text: &mut String, at: u16, name: &str, spelled: &str) {
    let default = match spelled {
        "FullstepResolution" | "MotorFullStepResolution" => "default = 200\n",
        "UnitMode" => "default = 1\n",
        _ => "",
    };
    let read_only = ["Actual", "Measured", "Latched"].iter().any(|word| spelled.starts_with(word))
        && !spelled.contains("Position");
    let access = if read_only { "access = \"r\"\n" } else { "moves = true\n" };
    row(
        text,
        at,
        name,
        &format!("{spelled} in the maker's library."),
        &format!("{default}{access}"),
    );
}

fn speed_row(text: &mut String, at: u16, name: &str, about: &str, scale: &str) {
    let (default, access) = match at {
        2 => ("default = 0\n", "moves = true\n"),
        3 => ("", "access = \"r\"\n"),
        181 | 182 => ("default = 0\nmin = 0\n", "persistence = \"storable\"\n"),
        SWITCH_SPEED => ("default = 25600\nmin = 0\n", "persistence = \"storable\"\n"),
        _ => ("default = 51200\nmin = 0\n", "persistence = \"storable\"\n"),
    };
    row(text, at, name, &format!("{about}."), &format!("{scale}{default}{access}"));
}

fn current_row(text: &mut String, at: u16, name: &str) {
    let default = match at {
        6 => 128,
        7 => 8,
        _ => 0,
    };
    let about = "255 is the module's full current; its data sheet says how much that is.";
    let rest = format!("min = 0\nmax = 255\ndefault = {default}\npersistence = \"storable\"\n");
    row(text, at, name, about, &rest);
}

/// Differences of a module with speeds in microsteps per second from one with a TMC429: the flags of its driver are not
/// documented alike, so none of them counts as a fault.
const PPS_TAIL: &str = r#"
[signals]
position = "actual position"
velocity = "actual velocity"
voltage = "supply voltage"
temperature = "temperature"
target-position = "target position"
target-velocity = "target velocity"
reached = { parameter = "position reached", equals = 1 }
positive-limit = { parameter = "right stop switch", equals = 1, values = { 1 = "right end switch" } }
negative-limit = { parameter = "left stop switch", equals = 1, values = { 1 = "left end switch" } }

[motion]
stalled = "extended error flags & 0x3 != 0"

# The driver is always on. Reading the error flags (AP 207) clears them.

[plans.enable]
source = "the driver is always on"
steps = ["read extended error flags"]

[plans.disable]
source = "MST; the driver stays on"
steps = ["send 3 0 0", "standstill within 10 s"]

[plans.stop]
source = "TMCL reference, MST"
steps = ["send 3 0 0", "standstill within 10 s"]

[plans.quick-stop]
source = "TMCL reference, MST; the module has no faster stop"
steps = ["send 3 0 0", "standstill within 10 s"]

[plans.clear]
source = "axis parameter 207: reading clears it"
steps = ["read extended error flags"]

[plans.velocity]
source = "TMCL reference, ROR"
steps = ["write max acceleration = {acceleration?}", "send 1 0 {velocity} like target velocity"]
undo = ["send 3 0 0"]

[plans.move-to]
source = "TMCL reference, MVP ABS"
steps = [
    "write max acceleration = {acceleration?}",
    "write max positioning velocity = {velocity?}",
    "send 4 0 {target} like actual position",
]
undo = ["send 3 0 0"]

[plans.move-by]
source = "TMCL reference, MVP REL"
steps = [
    "write max acceleration = {acceleration?}",
    "write max positioning velocity = {velocity?}",
    "send 4 1 {target} like actual position",
]
undo = ["send 3 0 0"]

[plans.home]
source = "TMCL reference, RFS"
steps = [
    "write reference search velocity = {velocity?}",
    "send 13 0 0",
    "homed reference search == 0 within 300 s",
]
undo = ["send 13 1 0", "send 3 0 0"]

[plans.store]
source = "STAP, a parameter at a time"
steps = [
    "send 7 4 0",
    "send 7 5 0",
    "send 7 6 0",
    "send 7 7 0",
    "send 7 12 0",
    "send 7 13 0",
    "send 7 140 0",
    "send 7 193 0",
    "send 7 194 0",
    "send 7 195 0",
    "send 7 214 0",
]
"#;

#[cfg(test)]
mod tests {
    use super::{motor_of, read_class, words_of};

    #[test]
    fn names_become_words() {
        for (name, words) in [
            ("MaxPositioningSpeed", "max positioning speed"),
            ("SG2Threshold", "sg2 threshold"),
            ("CLGammaVMin", "closed loop gamma v min"),
            ("CLgammaVmin", "closed loop gamma v min"),
            ("CLinitflag", "closed loop init flag"),
            ("IItSum1", "iit sum 1"),
            ("ClearIItExceededFlag", "clear iit exceeded flag"),
            ("DcStepStallGuard", "dcstep stallguard"),
            ("RightLimitSwitchDiable", "right limit switch disable"),
            ("max_EncoderDeviation", "max encoder deviation"),
        ] {
            assert_eq!(words_of(name), words);
        }
    }

    #[test]
    fn classes_and_motors_are_read() {
        let text = "class A:\n    def f(self):\n        m = [self._MotorTypeA(self, 2)]\n\n    class AP:\n        \
                    One = 1\n        Two = 2  # twice\n\n        Other = \"x\"\n    class ENUM:\n        Three = 3\n";
        assert_eq!(
            read_class(text).into_iter().collect::<Vec<_>>(),
            [(1, "One".into()), (2, "Two".into())]
        );
        let at = text.find("(self, ").unwrap();
        assert_eq!(motor_of(&text[..at], &text[at..]), Some("2"));
    }
}
