//! Profiles as Rust constants: `profiles/*.toml` → `crates/drives/src/<family>/profile.rs`.
//!
//! A profile whose family is its protocol's own word, and no folder of drives, is the generic one and
//! lands beside the protocol instead. Generated files are committed and never edited.

mod steps;

use polepair_core::plan::ParameterTest;
use polepair_core::profile::{
    Access, BitName, Certainty, CouplingParameters, DigitField, Fault, IdentityQuery, MotionRules,
    Parameter, ParameterId, Persistence, Profile, Scale, ScaleRule, SignalSource, Watchdog,
};
use polepair_core::units::Unit;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use steps::plan_row;

/// Everything that generation may do wrong, as text for people.
pub type CodegenResult<T> = std::result::Result<T, String>;

/// Writes the generated files; with `check` only reports the stale ones.
pub fn run(root: &Path, check: bool) -> CodegenResult<()> {
    let mut stale = Vec::new();
    for (path, text) in generated_files(root)? {
        if std::fs::read_to_string(&path).is_ok_and(|old| old == text) {
            continue;
        }
        let shown = path.strip_prefix(root).unwrap_or(&path).display().to_string();
        if check {
            stale.push(shown);
            continue;
        }
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        }
        std::fs::write(&path, text).map_err(|e| format!("{shown}: {e}"))?;
        println!("wrote {shown}");
    }
    if stale.is_empty() {
        return Ok(());
    }
    Err(format!("stale, run `cargo xtask codegen`: {}", stale.join(", ")))
}

/// Every generated file with the text it should have.
fn generated_files(root: &Path) -> CodegenResult<BTreeMap<PathBuf, String>> {
    let mut families: BTreeMap<PathBuf, Vec<&'static Profile>> = BTreeMap::new();
    for file in profile_files(&root.join("profiles"))? {
        let profile = polepair::load_profile(&file).map_err(|e| e.to_string())?;
        families.entry(destination(root, profile)).or_default().push(profile);
    }
    let mut files = BTreeMap::new();
    for (path, mut profiles) in families {
        profiles.sort_by_key(|profile| profile.name);
        if let Some(two) = profiles.windows(2).find(|two| two[0].name == two[1].name) {
            return Err(format!("two profiles are called `{}`", two[0].name));
        }
        for profile in &profiles {
            let page = root.join("docs/drives").join(profile.name).with_extension("md");
            let part = root.join("profiles").join(profile.name).with_extension("md");
            // Facts that no table can express are written by hand, beside the profile.
            let part = match std::fs::read_to_string(&part) {
                Ok(text) => text,
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
                Err(error) => return Err(format!("{}: {error}", part.display())),
            };
            files.insert(page, crate::pages::drive_page(profile, &part));
        }
        let in_core = path.starts_with(root.join("crates/core"));
        let core = if in_core { "crate" } else { "polepair_core" };
        files.insert(path, format_source(&rust_source(&profiles, core))?);
    }
    files.insert(root.join("crates/drives/src/plan_texts.rs"), plan_texts(root)?);
    for (name, text) in crate::catalogue_pages::pages() {
        files.insert(root.join("docs/drives").join(name), text);
    }
    for (name, text) in crate::command_pages::pages() {
        files.insert(root.join("docs/reference/command-line").join(name), text);
    }
    files.insert(root.join("docs/reference/connection-keys.md"), crate::key_pages::page());
    files.extend(crate::c_header::file(root)?);
    files.insert(root.join("docs/protocols/tml-language.md"), crate::language::language_page());
    Ok(files)
}

/// The fragments and plans of the profiles that have fragments, as text.
fn plan_texts(root: &Path) -> CodegenResult<String> {
    let mut text = "//! Generated from profiles/*.toml by `cargo xtask codegen`; do not edit.\n\n\
         /// Fragments and plans by the profile's name.\n\
         pub static PLAN_TEXTS: &[(&str, &str)] = &["
        .to_owned();
    for file in profile_files(&root.join("profiles"))? {
        let source = std::fs::read_to_string(&file)
            .map_err(|error| format!("{}: {error}", file.display()))?;
        let plans = plan_sections(&source);
        if !plans.contains("[fragments]") {
            continue;
        }
        let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let _ = write!(text, "({name:?}, r##\"{plans}\"##),");
    }
    text += "];\n";
    format_source(&text)
}

/// The sections of fragments and plans in a profile's file, without comments.
fn plan_sections(source: &str) -> String {
    let mut is_plan = false;
    let mut sections = String::new();
    for line in source.lines() {
        if line.starts_with('[') {
            is_plan = line == "[fragments]" || line.starts_with("[plans.");
        }
        if is_plan && !line.is_empty() && !line.starts_with('#') {
            sections.push_str(line.trim());
            sections.push('\n');
        }
    }
    sections
}

fn profile_files(folder: &Path) -> CodegenResult<Vec<PathBuf>> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Ok(Vec::new()) };
    let paths = entries.map(|entry| entry.map(|e| e.path()).map_err(|e| e.to_string()));
    let mut paths = paths.collect::<CodegenResult<Vec<_>>>()?;
    paths.retain(|path| path.extension().is_some_and(|e| e == "toml"));
    paths.sort();
    Ok(paths)
}

fn destination(root: &Path, profile: &Profile) -> PathBuf {
    let folder = profile.family.replace(['-', '.'], "_");
    let drives = root.join("crates/drives/src").join(&folder);
    let generic = profile.family == profile.protocol && !drives.is_dir();
    let folder = if generic { root.join("crates/core/src/proto").join(folder) } else { drives };
    folder.join("profile.rs")
}

/// The text as formatted by `rustfmt` with the workspace's settings.
fn format_source(text: &str) -> CodegenResult<String> {
    let mut child = Command::new("rustfmt")
        .args(["--edition", "2024", "--config-path"])
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .map_err(rustfmt_error)?;
    let mut input = child.stdin.take().ok_or("rustfmt takes no input")?;
    let text = text.to_owned();
    let writer = std::thread::spawn(move || input.write_all(text.as_bytes()));
    let output = child.wait_with_output().map_err(rustfmt_error)?;
    writer.join().map_err(|_| "rustfmt: its input broke".to_owned())?.map_err(rustfmt_error)?;
    if !output.status.success() {
        return Err("rustfmt did not take the generated text".into());
    }
    String::from_utf8(output.stdout).map_err(|e| e.to_string())
}

fn rustfmt_error(e: std::io::Error) -> String {
    format!("rustfmt: {e}")
}

/// The profiles of one family as one Rust file, which names the core crate by this word.
fn rust_source(profiles: &[&'static Profile], core: &str) -> String {
    let mut file =
        Emitter { text: HEAD.to_owned(), tables: BTreeMap::new(), last_tables: BTreeMap::new() };
    let mut names = Vec::new();
    for profile in profiles {
        let constant = constant_name(profile.name);
        file.emit_profile(&constant, profile);
        names.push(format!("&{constant}"));
    }
    let (count, list) = (names.len(), names.join(", "));
    let _ = write!(
        file.text,
        "/// Every profile of this file, by name.\n\
         pub static PROFILES: [&Profile; {count}] = [{list}];\n"
    );
    if file.text.contains("mapped(\"") {
        file.text = file.text.replacen("\n};\n\n", &format!("\n}};\n\n{MAPPED}"), 1);
    }
    let body = file.text.split_once("\n\n").map_or("", |(_, body)| body);
    let imports = import_lines(body, core);
    file.text.replacen("IMPORTS", &imports, 1)
}

const HEAD: &str = "\
//! Generated from `profiles/*.toml` by `cargo xtask codegen`. Do not edit.
#![allow(clippy::approx_constant, clippy::excessive_precision, reason = \"the manuals' numbers\")]
#![allow(clippy::large_const_arrays, reason = \"rows that tables share, read while compiling\")]

IMPORTS

#[rustfmt::skip]
const P: Parameter = Parameter {
    name: \"\", symbol: \"\", about: \"\", space: 0, index: 0, encoding: Encoding::I32,
    unit: Unit::None, scale: Scale::ONE, min: 0, max: 0, default: None,
    access: Access::ReadWrite, persistence: Persistence::Volatile,
    certainty: Certainty::Documented, moves: false, section: \"\", values: &[], digits: &[], bits: &[],
};

";

/// Form of a variable that only a memory map documents: one line.
const MAPPED: &str = "\
/// A variable that is known from the memory map alone.
const fn mapped(name: &'static str, index: u16, encoding: Encoding) -> Parameter {
    let (min, max) = match encoding {
        Encoding::I16 => (i16::MIN as i64, i16::MAX as i64),
        Encoding::U16 => (0, u16::MAX as i64),
        Encoding::U32 => (0, u32::MAX as i64),
        _ => (i32::MIN as i64, i32::MAX as i64),
    };
    let certainty = Certainty::Inferred;
    let symbol = name;
    Parameter { name, symbol, index, encoding, min, max, certainty, moves: true, ..P }
}

/// [`mapped`] with a unit.
const fn scaled(mut mapped: Parameter, unit: Unit, scale: Scale) -> Parameter {
    (mapped.unit, mapped.scale) = (unit, scale);
    mapped
}

";

/// Only what the text uses: an unused import would be a warning.
fn import_lines(body: &str, core: &str) -> String {
    let modules: [(&str, &[&str]); 4] = [
        ("axis", &["Verb"]),
        ("plan", &["Argument", "Compare", "Operand", "ParameterTest", "Plan", "RampSpeed", "Step"]),
        (
            "profile",
            &[
                "Access",
                "AxisKind",
                "BitName",
                "Certainty",
                "DigitField",
                "Encoding",
                "Fault",
                "Identity",
                "IdentityQuery",
                "CouplingParameters",
                "MotionRules",
                "Parameter",
                "ParameterId",
                "Persistence",
                "Profile",
                "RamMode",
                "RelativeBase",
                "Scale",
                "Severity",
                "Signal",
                "SignalSource",
                "Watchdog",
            ],
        ),
        ("units", &["Unit"]),
    ];
    let mut lines = String::new();
    for (module, names) in modules {
        let used: Vec<&str> = names.iter().copied().filter(|name| uses_name(body, name)).collect();
        if !used.is_empty() {
            let _ = writeln!(lines, "use {core}::{module}::{{{}}};", used.join(", "));
        }
    }
    lines.trim_end().to_owned()
}

/// Returns whether a name occurs in the code as a word, outside texts.
fn uses_name(body: &str, name: &str) -> bool {
    let code: String = body.split('"').step_by(2).collect();
    code.split(|c: char| !c.is_alphanumeric() && c != '_').any(|word| word == name)
}

fn constant_name(name: &str) -> String {
    let upper = name.to_uppercase().replace(['-', '.'], "_");
    if upper.starts_with(|c: char| c.is_ascii_digit()) { format!("P_{upper}") } else { upper }
}

struct Emitter {
    text: String,
    /// Existing tables by content: products of a family share them.
    tables: BTreeMap<String, String>,
    /// The last table of each kind that was written row by row, which the next is compared with.
    last_tables: BTreeMap<String, (String, Vec<String>)>,
}

impl Emitter {
    fn emit_profile(&mut self, constant: &str, p: &'static Profile) {
        let rows: Vec<String> = p.parameters.iter().map(|it| parameter_row(p, it)).collect();
        let parameters = self.table(constant, "PARAMETERS", "Parameter", &rows);
        let rows: Vec<String> = p.faults.iter().map(fault_row).collect();
        let faults = self.table(constant, "FAULTS", "Fault", &rows);
        let rows: Vec<String> = p.signals.iter().map(signal_row).collect();
        let signals = self.table(constant, "SIGNALS", "SignalSource", &rows);
        let rows: Vec<String> = p.plans.iter().map(plan_row).collect();
        let plans = self.table(constant, "PLANS", "Plan", &rows);
        let watchdog = match p.watchdog {
            Watchdog::None => "Watchdog::None".to_owned(),
            Watchdog::Fixed { after_ms } => format!("Watchdog::Fixed {{ after_ms: {after_ms} }}"),
            Watchdog::Configurable { parameter, on_can } => {
                let on_can =
                    on_can.map_or("None".to_owned(), |it| format!("Some({})", parameter_id(it)));
                let parameter = parameter_id(parameter);
                format!("Watchdog::Configurable {{ parameter: {parameter}, on_can: {on_can} }}")
            }
            Watchdog::LifeGuarding { objects, reaction } => {
                let [period, factor] = objects.map(parameter_id);
                let reaction = optional_id(reaction);
                format!(
                    "Watchdog::LifeGuarding {{ objects: [{period}, {factor}], reaction: {reaction} }}"
                )
            }
            Watchdog::Heartbeat { consumer, reaction, life_guarding } => {
                let (consumer, reaction) = (parameter_id(consumer), optional_id(reaction));
                let life_guarding = life_guarding.map_or("None".to_owned(), |ids| {
                    let [period, factor] = ids.map(parameter_id);
                    format!("Some([{period}, {factor}])")
                });
                format!(
                    "Watchdog::Heartbeat {{ consumer: {consumer}, reaction: {reaction}, \
                     life_guarding: {life_guarding} }}"
                )
            }
        };
        let identity = p.identity.map_or("None".to_owned(), |it| {
            let query = match it.query {
                IdentityQuery::Parameter(parameter) => {
                    format!("IdentityQuery::Parameter({})", parameter_id(parameter))
                }
                IdentityQuery::Text(text) => format!("IdentityQuery::Text({text:?})"),
            };
            let (bits, equals, firmware) =
                (mask_literal(it.mask), mask_literal(it.equals), mask_literal(it.firmware));
            format!(
                "Some(Identity {{ query: {query}, mask: {bits}, equals: {equals}, \
                 firmware: {firmware} }})"
            )
        });
        let motion = motion_expr(&p.motion);
        assert!(p.line.is_none(), "{}: a built-in drive has the line of its protocol", p.name);
        let (link_settings, optional) = (id_list(p.link_settings), id_list(p.optional));
        let ram = p.ram.map_or("None".to_owned(), |mode| {
            let (parameter, ram, flash) = (parameter_id(mode.parameter), mode.ram, mode.flash);
            format!("Some(RamMode {{ parameter: {parameter}, ram: {ram}, flash: {flash} }})")
        });
        let _ = write!(
            self.text,
            "/// {title}.\n#[rustfmt::skip]\npub static {constant}: Profile = Profile {{ name: {:?}, family: {:?}, \
             protocol: {:?}, title: {:?}, source: {:?}, axis: AxisKind::{:?}, motors: {}, further_motors: &[], \
             lists_motors: false, \
             parameters: {parameters}, faults: {faults}, signals: {signals}, plans: {plans}, \
             motion: {motion}, identity: {identity}, ram: {ram}, link_settings: &[{link_settings}], \
             optional: &[{optional}], \
             watchdog: {watchdog}, reply_timeout_ms: {}, multiple_writes: {}, line: None, caution: {:?} }};\n\n",
            p.name,
            p.family,
            p.protocol,
            p.title,
            p.source,
            p.axis,
            p.motors,
            p.reply_timeout_ms,
            p.multiple_writes,
            p.caution,
            title = p.title.trim_end_matches('.'),
        );
    }

    /// Writes a table once and gives the expression that borrows it.
    fn table(&mut self, constant: &str, what: &str, kind: &str, rows: &[String]) -> String {
        if rows.is_empty() {
            return "&[]".to_owned();
        }
        let body = rows.join(",\n    ");
        let key = format!("{what} {body}");
        if let Some(name) = self.tables.get(&key) {
            return format!("&{name}");
        }
        let name = format!("{constant}_{what}");
        let count = rows.len();
        let head = format!("static {name}: [{kind}; {count}] = ");
        let patched = self.last_tables.get(what).and_then(|(base, old)| {
            let rows = patch_table(base, old, rows)?;
            Some((base.clone(), rows))
        });
        if let Some((base, rows)) = patched {
            self.lend(&base, kind, count);
            let _ = write!(self.text, "#[rustfmt::skip]\n{head}{rows};\n\n");
        } else {
            let _ = write!(self.text, "#[rustfmt::skip]\n{head}[\n    {body},\n];\n\n");
            self.last_tables.insert(what.to_owned(), (name.clone(), rows.to_vec()));
        }
        self.tables.insert(key, name.clone());
        format!("&{name}")
    }

    /// Makes a table's rows a constant, which others can begin with.
    fn lend(&mut self, table: &str, kind: &str, count: usize) {
        let head = format!("static {table}: [{kind}; {count}] = ");
        let both = format!(
            "{head}{table}_ROWS;\n\n#[rustfmt::skip]\nconst {table}_ROWS: [{kind}; {count}] = "
        );
        if !self.text.contains(&both) {
            self.text = self.text.replacen(&head, &both, 1);
        }
    }
}

fn id_list(ids: &[ParameterId]) -> String {
    ids.iter().map(|it| parameter_id(*it)).collect::<Vec<String>>().join(", ")
}

/// A table as another one with some rows replaced; `None` when that would not be shorter.
fn patch_table(base: &str, old: &[String], new: &[String]) -> Option<String> {
    let other: Vec<usize> = (0..new.len()).filter(|n| old.get(*n) != Some(&new[*n])).collect();
    if old.len() != new.len() || other.len() * 2 > new.len() {
        return None;
    }
    let rows = other.iter().map(|n| format!("rows[{n}] = {};\n", new[*n])).collect::<String>();
    Some(format!("{{\nlet mut rows = {base}_ROWS;\n{rows}rows\n}}"))
}

fn parameter_id(parameter: ParameterId) -> String {
    format!("ParameterId({})", parameter.0)
}

/// One parameter; what is as in `P` is left out.
fn parameter_row(profile: &Profile, p: &Parameter) -> String {
    if is_mapped(p) {
        return mapped_row(p);
    }
    let mut row = format!("Parameter {{ name: {:?}, ", p.name);
    for (key, text) in [("symbol", p.symbol), ("about", p.about), ("section", p.section)] {
        if !text.is_empty() {
            let _ = write!(row, "{key}: {text:?}, ");
        }
    }
    if p.space != 0 {
        let _ = write!(row, "space: {}, ", p.space);
    }
    // Registers and memory are known by their hexadecimal numbers, everything else by decimal ones.
    let index = match profile.protocol {
        "modbus" | "tml" | "thruster" | "canopen" => format!("{:#06x}", p.index),
        _ => p.index.to_string(),
    };
    let _ = write!(row, "index: {index}, encoding: Encoding::{:?}, ", p.encoding);
    let _ = write!(row, "unit: Unit::{:?}, min: {}, max: {}, ", p.unit, p.min, p.max);
    if p.scale != Scale::ONE {
        let _ = write!(row, "scale: {}, ", scale_expr(p.scale));
    }
    if let Some(default) = p.default {
        let _ = write!(row, "default: Some({default}), ");
    }
    let _ = write!(row, "access: Access::{:?}, ", p.access);
    let _ = write!(row, "persistence: Persistence::{:?}, ", p.persistence);
    let _ = write!(row, "certainty: Certainty::{:?}, ", p.certainty);
    if p.moves {
        row.push_str("moves: true, ");
    }
    if !p.values.is_empty() {
        let _ = write!(row, "values: &{:?}, ", p.values);
    }
    if !p.digits.is_empty() {
        let fields: Vec<String> = p.digits.iter().map(digit_field).collect();
        let _ = write!(row, "digits: &[{}], ", fields.join(", "));
    }
    if !p.bits.is_empty() {
        let names: Vec<String> = p.bits.iter().map(bit_name).collect();
        let _ = write!(row, "bits: &[{}], ", names.join(", "));
    }
    row.push_str("..P }");
    row
}

fn bit_name(known: &BitName) -> String {
    let BitName { mask, value, name } = known;
    format!("BitName {{ mask: {mask:#x}, value: {value:#x}, name: {name:?} }}")
}

fn digit_field(field: &DigitField) -> String {
    let DigitField { name, places, max, values } = field;
    format!("DigitField {{ name: {name:?}, places: {places}, max: {max}, values: &{values:?} }}")
}

/// Returns whether a row has no more than a line of a memory map.
fn is_mapped(p: &Parameter) -> bool {
    let plain = p.about.is_empty() && p.section.is_empty() && p.values.is_empty();
    let (access, persistence) = (p.access, p.persistence);
    plain
        && p.name == p.symbol
        && p.certainty == Certainty::Inferred
        && p.moves
        && (access, persistence) == (Access::ReadWrite, Persistence::Volatile)
        && (p.space, p.default) == (0, None)
}

fn mapped_row(p: &Parameter) -> String {
    let row = format!("mapped({:?}, {:#06x}, Encoding::{:?})", p.name, p.index, p.encoding);
    if p.scale == Scale::ONE && p.unit == Unit::None {
        return row;
    }
    format!("scaled({row}, Unit::{:?}, {})", p.unit, scale_expr(p.scale))
}

fn scale_expr(scale: Scale) -> String {
    // No shipped profile has a magnitude with its direction beside it.
    let Scale { factor, times, over, rule, negative: _ } = scale;
    let (times, over) = (optional_id(times), optional_id(over));
    let rule = rule.map_or_else(|| "None".to_owned(), |rule| format!("Some({})", rule_path(rule)));
    format!(
        "Scale {{ factor: {factor:?}, times: {times}, over: {over}, rule: {rule}, negative: None }}"
    )
}

fn optional_id(it: Option<ParameterId>) -> String {
    match it {
        Some(it) => format!("Some({})", parameter_id(it)),
        None => "None".to_owned(),
    }
}

/// Path of a rule: `tmcm-velocity-pps` is `VELOCITY_PPS` of that family's units.
fn rule_path(rule: &ScaleRule) -> String {
    let (family, name) = rule.name.split_once('-').unwrap_or((rule.name, ""));
    format!("&crate::{family}::units::{}", name.to_uppercase().replace('-', "_"))
}

fn fault_row(f: &Fault) -> String {
    format!(
        "Fault {{ code: {:#x}, name: {:?}, text: {:?}, cause: {:?}, remedy: {:?}, \
         severity: Severity::{:?} }}",
        f.code, f.name, f.text, f.cause, f.remedy, f.severity
    )
}

fn signal_row(s: &SignalSource) -> String {
    format!(
        "SignalSource {{ signal: Signal::{:?}, parameter: {}, mask: {}, equals: {:?}, \
         values: &{:?} }}",
        s.signal,
        parameter_id(s.parameter),
        mask_literal(s.mask),
        s.equals,
        s.values
    )
}

fn mask_literal(mask: i64) -> String {
    if mask < 0 { mask.to_string() } else { format!("{mask:#x}") }
}

fn condition_expr(condition: Option<(ParameterId, ParameterTest)>) -> String {
    condition.map_or("None".to_owned(), |(id, test)| {
        format!("Some(({}, {}))", parameter_id(id), test_expr(test))
    })
}

fn motion_expr(rules: &MotionRules) -> String {
    if *rules == MotionRules::NONE {
        return "MotionRules::NONE".to_owned();
    }
    let window = rules.window.map_or("None".to_owned(), |id| format!("Some({})", parameter_id(id)));
    format!(
        "MotionRules {{ window: {window}, relative_from: RelativeBase::{:?}, halted: {}, stalled: {}, \
         unpowered: {}, coupling: {} }}",
        rules.relative_from,
        condition_expr(rules.halted),
        condition_expr(rules.stalled),
        condition_expr(rules.unpowered),
        rules.coupling.map_or_else(|| "None".to_owned(), coupling_expr)
    )
}

fn coupling_expr(coupling: CouplingParameters) -> String {
    format!(
        "Some(CouplingParameters {{ follower: {}, master_position: {}, ratio: {}, numerator: {}, \
         denominator: {}, cam: {} }})",
        parameter_id(coupling.follower),
        parameter_id(coupling.master_position),
        parameter_id(coupling.ratio),
        parameter_id(coupling.numerator),
        parameter_id(coupling.denominator),
        parameter_id(coupling.cam)
    )
}

fn test_expr(t: ParameterTest) -> String {
    let (compare, value) = (t.compare, t.value);
    format!(
        "ParameterTest {{ mask: {}, compare: Compare::{compare:?}, value: {value} }}",
        mask_literal(t.mask)
    )
}

#[cfg(test)]
mod tests {
    use super::{patch_table, run, rust_source};
    use std::path::Path;

    #[test]
    fn committed_profiles_are_fresh() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        run(root, true).unwrap();
    }

    #[test]
    fn a_changed_profile_makes_its_file_stale() {
        let root = std::env::temp_dir().join(format!("polepair-codegen-{}", std::process::id()));
        std::fs::create_dir_all(root.join("profiles")).unwrap();
        let file = root.join("profiles/some-drive.toml");
        let text = "name = \"some-drive\"\nfamily = \"some\"\nprotocol = \"tmcl\"\n";
        std::fs::write(&file, text).unwrap();
        assert!(run(&root, true).unwrap_err().contains("drives/src/some/profile.rs"));
        run(&root, false).unwrap();
        run(&root, true).unwrap();
        std::fs::write(&file, format!("{text}title = \"Other\"\n")).unwrap();
        assert!(run(&root, true).unwrap_err().contains("cargo xtask codegen"));
        std::fs::remove_dir_all(&root).unwrap();
    }

    #[test]
    fn every_kind_of_entry_is_printed() {
        let text = include_str!("../tests/every_kind.toml");
        let profile = polepair::profile::parse("every_kind.toml", text).unwrap();
        let rust = rust_source(&[profile], "crate");
        syn::parse_file(&rust).unwrap();
        for piece in [
            "pub static EVERY_KIND: Profile",
            "scale: Scale { factor: 0.5, times: Some(ParameterId(1)), over: None, rule: None, negative: None }",
            "values: &[(0, \"off\"), (1, \"on\")]",
            "Step::Write(ParameterId(0), Operand::OptionalArgument(Argument::Velocity))",
            "ParameterTest { mask: 0x80, compare: Compare::Equal, value: 128 }, within_ms: 60000",
            "Step::Send { function: 0x1, index: 0x2, operand: Operand::Constant(-3), like: Some(",
            "Watchdog::Configurable { parameter: ParameterId(1), on_can: None }",
            "link_settings: &[ParameterId(1)]",
            "optional: &[ParameterId(0)]",
        ] {
            assert!(rust.contains(piece), "{piece}\n{rust}");
        }
    }

    #[test]
    fn a_table_like_another_tells_only_the_rows_that_differ() {
        let rows = |words: &str| words.split(' ').map(str::to_owned).collect::<Vec<_>>();
        let patched = patch_table("BASE", &rows("a b c"), &rows("a x c"));
        let text = "{\nlet mut rows = BASE_ROWS;\nrows[1] = x;\nrows\n}";
        assert_eq!(patched.as_deref(), Some(text));
        assert_eq!(patch_table("BASE", &rows("a b c"), &rows("x y c")), None, "mostly different");
        assert_eq!(patch_table("BASE", &rows("a b c"), &rows("a b")), None, "of another length");
    }
}
