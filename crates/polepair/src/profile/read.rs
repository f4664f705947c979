//! Converts TOML to a draft. Unknown keys and values are errors.

use super::digits::read_values;
use super::draft::{
    Draft, DraftFault, DraftIdentity, DraftMotion, DraftParameter, DraftRam, DraftWatchdog,
    ENTRIES_MAX,
};
use super::motors::MotorChoice;
use super::scale::{ScaleParts, read_scale};
use super::watchdog::read_watchdog;
use super::{bits, digits, memory_map, plan_text, signals};
use crate::toml_file::{FileError, Located, SourceText, TomlTable};
use crate::{registry, spelling};
use polepair_core::convert::saturating;
use polepair_core::profile::{Access, AxisKind, Certainty, Encoding, Persistence, Severity};
use polepair_core::units::Unit;
use std::collections::HashSet;

const KEYS: [&str; 27] = [
    "name",
    "extends",
    "replace",
    "remove",
    "shift",
    "family",
    "protocol",
    "title",
    "source",
    "axis",
    "reply_timeout_ms",
    "motors",
    "write",
    "line",
    "caution",
    "watchdog",
    "ram",
    "reach",
    "optional",
    "identify",
    "map",
    "parameter",
    "fault",
    "signals",
    "motion",
    "fragments",
    "plans",
];

const PARAMETER_KEYS: [&str; 21] = [
    "name",
    "symbol",
    "about",
    "space",
    "sub",
    "index",
    "encoding",
    "unit",
    "scale",
    "min",
    "max",
    "default",
    "access",
    "persistence",
    "certainty",
    "moves",
    "section",
    "values",
    "digits",
    "bits",
    "repeat",
];

const FAULT_KEYS: [&str; 6] = ["code", "name", "text", "cause", "remedy", "severity"];

/// Names of a protocol's address spaces, and the default encoding of their values.
struct Dialect {
    protocol: &'static str,
    spaces: &'static [(&'static str, u8)],
    encoding: Encoding,
}

const DIALECTS: [Dialect; 5] = [
    Dialect {
        protocol: "tmcl",
        spaces: &[
            ("axis", 0),
            ("global 0", 1),
            ("global 1", 2),
            ("global 2", 3),
            ("global 3", 4),
            ("digital input", 0x40),
            ("analog input", 0x41),
            ("output", 0x42),
            ("search", 0x60),
        ],
        encoding: Encoding::I32,
    },
    Dialect {
        protocol: "modbus",
        spaces: &[("holding", 0), ("coil", 1), ("discrete", 2), ("input", 3)],
        encoding: Encoding::U16,
    },
    Dialect { protocol: OBJECT_PROTOCOL, spaces: &[("object", 0)], encoding: Encoding::U32 },
    Dialect { protocol: MEMORY_PROTOCOL, spaces: &[("data", 0)], encoding: Encoding::I16 },
    Dialect {
        protocol: "thruster",
        spaces: &[("command", 0), ("internal", 1), ("internal high", 2), ("internal low", 3)],
        encoding: Encoding::I16,
    },
];

/// The protocol whose parameters are objects, whose space is a sub-index; `sub` gives it.
pub(super) const OBJECT_PROTOCOL: &str = "canopen";

/// The protocol whose parameters are a drive's memory: several names may share an address, and a
/// map of the memory gives them all.
pub(crate) const MEMORY_PROTOCOL: &str = "tml";

const AXES: [(&str, AxisKind); 3] =
    [("rotary", AxisKind::Rotary), ("linear", AxisKind::Linear), ("ratio", AxisKind::Ratio)];

const ENCODINGS: [(&str, Encoding); 25] = [
    ("bit", Encoding::Bit),
    ("u8", Encoding::U8),
    ("i8", Encoding::I8),
    ("u16", Encoding::U16),
    ("i16", Encoding::I16),
    ("u32", Encoding::U32),
    ("i32", Encoding::I32),
    ("u48", Encoding::U48),
    ("i48", Encoding::I48),
    ("u64", Encoding::U64),
    ("i64", Encoding::I64),
    ("f32", Encoding::F32),
    ("f64", Encoding::F64),
    ("u32-low-first", Encoding::U32LowFirst),
    ("i32-low-first", Encoding::I32LowFirst),
    ("u48-low-first", Encoding::U48LowFirst),
    ("i48-low-first", Encoding::I48LowFirst),
    ("u64-low-first", Encoding::U64LowFirst),
    ("i64-low-first", Encoding::I64LowFirst),
    ("f32-low-first", Encoding::F32LowFirst),
    ("f64-low-first", Encoding::F64LowFirst),
    ("text", Encoding::Text),
    ("bytes", Encoding::Bytes),
    ("fixed", Encoding::Fixed),
    ("tens-and-thousandths", Encoding::TensAndThousandths),
];

const ACCESSES: [(&str, Access); 3] =
    [("r", Access::Read), ("w", Access::Write), ("rw", Access::ReadWrite)];

const PERSISTENCES: [(&str, Persistence); 4] = [
    ("volatile", Persistence::Volatile),
    ("storable", Persistence::Storable),
    ("always", Persistence::Always),
    ("unless-ram", Persistence::UnlessRam),
];

const CERTAINTIES: [(&str, Certainty); 3] = [
    ("documented", Certainty::Documented),
    ("inferred", Certainty::Inferred),
    ("undocumented", Certainty::Undocumented),
];

const SEVERITIES: [(&str, Severity); 3] =
    [("note", Severity::Note), ("warning", Severity::Warning), ("fault", Severity::Fault)];

/// Reads a profile for one of its motors, counted from 0. `base` gives the draft of the profile that this one extends.
pub(crate) fn read_draft(
    file: &str,
    text: &str,
    number: usize,
    base: &mut dyn FnMut(&Located<String>) -> Result<Draft, FileError>,
) -> Result<Draft, FileError> {
    SourceText::new(file, text).parse(&KEYS, |node| {
        let mut draft = match node.text("extends")? {
            Some(name) => base(&name)?,
            None => new_draft(&node)?,
        };
        // Before anything of this file is read: it clears what was inherited, not what the file adds.
        for table in node.texts("replace")? {
            clear_table(&mut draft, &table)?;
        }
        shift_registers(&mut draft, &node)?;
        read_head(&mut draft, &node)?;
        let motor = MotorChoice { number, count: draft.motors.max(1).into() };
        let file = ProfileReader { dialect: find_dialect(&node, &draft.protocol)?, motor };
        // The map first, because the parameters of the file are laid over it.
        if let Some(map) = node.text("map")? {
            memory_map::apply_map(&mut draft, &map)?;
        }
        remove_parameters(&mut draft, &node.texts("remove")?)?;
        file.read_parameters(&mut draft, &node)?;
        file.read_faults(&mut draft, &node)?;
        signals::read_signals(&mut draft, &node, motor)?;
        signals::read_motion(&mut draft, &node)?;
        plan_text::read_plans(&mut draft, &node, motor)?;
        Ok(draft)
    })
}

fn new_draft(node: &TomlTable<'_, '_>) -> Result<Draft, FileError> {
    let name = node.required_text("name")?.value;
    let protocol = node.required_text("protocol")?.value;
    Ok(Draft {
        location: node.location(),
        title: name.clone(),
        name,
        family: protocol.clone(),
        protocol,
        source: String::new(),
        axis: AxisKind::Rotary,
        motors: 0,
        reply_timeout_ms: 100,
        further_motors: Vec::new(),
        lists_motors: false,
        multiple_writes: false,
        line: None,
        caution: String::new(),
        watchdog: DraftWatchdog::None,
        ram: None,
        reach: Vec::new(),
        optional: Vec::new(),
        identity: None,
        parameters: Vec::new(),
        faults: Vec::new(),
        signals: Vec::new(),
        plans: Vec::new(),
        plan_texts: Vec::new(),
        fragments: Vec::new(),
        motion: DraftMotion::new(),
    })
}

fn read_head(draft: &mut Draft, node: &TomlTable<'_, '_>) -> Result<(), FileError> {
    draft.location = node.location();
    draft.name = node.required_text("name")?.try_map(check_word)?;
    replace_text(&mut draft.title, node.text("title")?);
    replace_text(&mut draft.source, node.text("source")?);
    replace_text(&mut draft.caution, node.text("caution")?);
    if let Some(family) = node.text("family")? {
        draft.family = family.try_map(check_word)?;
    }
    if let Some(protocol) = node.text("protocol")? {
        draft.protocol = protocol.value;
    }
    if let Some(axis) = node.text("axis")? {
        draft.axis = axis.try_map(|word| parse_choice(&word, &AXES))?;
    }
    if let Some(motors) = node.integer_between("motors", 1, 8)? {
        let last = registry::last_sub_axis(&draft.protocol);
        if motors > i64::from(last.max(1)) && last < 2 {
            let location = node.scalar_text("motors")?.map_or(node.location(), |at| at.location);
            let reason = format!("`motors` is {motors}: on {} an address has one", draft.protocol);
            return Err(location.error(reason));
        }
        draft.motors = saturating(motors);
    }
    if let Some(function) = node.text("write")? {
        if draft.protocol != "modbus" {
            return Err(function.location.error("`write` is for drives that speak Modbus"));
        }
        draft.multiple_writes =
            function.try_map(|word| parse_choice(&word, &[("06", false), ("16", true)]))?;
    }
    draft.line = super::serial_line::read(node)?.or(draft.line);
    if let Some(ms) = node.integer_between("reply_timeout_ms", 1, 60_000)? {
        draft.reply_timeout_ms = saturating(ms);
    }
    if let Some(watchdog) = read_watchdog(node)? {
        draft.watchdog = watchdog;
    }
    if let Some(identity) = read_identity(node)? {
        draft.identity = Some(identity);
    }
    if let Some(table) = node.table("ram", &["parameter", "ram", "flash"])? {
        draft.ram = Some(DraftRam {
            parameter: table.required_text("parameter")?,
            ram: table.required_integer("ram")?.value,
            flash: table.required_integer("flash")?.value,
        });
    }
    if node.has("reach") {
        draft.reach = node.texts("reach")?;
    }
    if node.has("optional") {
        draft.optional = node.texts("optional")?;
    }
    Ok(())
}

fn read_identity(node: &TomlTable<'_, '_>) -> Result<Option<DraftIdentity>, FileError> {
    let keys = ["parameter", "ask", "mask", "equals", "firmware"];
    let Some(table) = node.table("identify", &keys)? else { return Ok(None) };
    let (parameter, text) = (table.text("parameter")?, optional_text(&table, "ask")?);
    if parameter.is_some() != text.is_empty() {
        return Err(table.location().error("`identify` needs either `parameter` or `ask`"));
    }
    let (mask, equals, firmware) = (
        number_or_zero("mask", &table)?,
        number_or_zero("equals", &table)?,
        number_or_zero("firmware", &table)?,
    );
    // Such a pattern fits no value: the drive would never be identified, without a sign of why.
    if equals & !mask != 0 {
        return Err(table.location().error("`equals` has bits that `mask` takes away"));
    }
    Ok(Some(DraftIdentity { parameter, text, mask, equals, firmware }))
}

fn number_or_zero(key: &str, table: &TomlTable<'_, '_>) -> Result<i64, FileError> {
    table.integer(key).map(|found| found.map_or(0, |found| found.value))
}

fn replace_text(text: &mut String, with: Option<Located<String>>) {
    if let Some(found) = with {
        *text = found.value;
    }
}

/// Names of profiles and families become file names, constants and words in URLs.
fn check_word(text: String) -> Result<String, String> {
    if text.is_empty() || !text.chars().all(is_name_char) {
        return Err(format!("`{text}` must be of a-z, 0-9, `-`, `_` and `.`"));
    }
    Ok(text)
}

fn is_name_char(c: char) -> bool {
    c.is_ascii_lowercase() || c.is_ascii_digit() || "-_.".contains(c)
}

fn parse_choice<T: Copy>(word: &str, table: &[(&str, T)]) -> Result<T, String> {
    let known = table.iter().find(|(name, _)| *name == word);
    known.map(|(_, value)| *value).ok_or_else(|| {
        let words: Vec<&str> =
            table.iter().map(|(name, _)| *name).filter(|name| !name.is_empty()).collect();
        let hint = spelling::suggestion(word, words.iter().copied());
        format!("`{word}` is none of {}{hint}", words.join(", "))
    })
}

fn find_dialect(node: &TomlTable<'_, '_>, protocol: &str) -> Result<&'static Dialect, FileError> {
    let known = DIALECTS.iter().find(|dialect| dialect.protocol == protocol);
    known.ok_or_else(|| {
        let location = node.text("protocol").ok().flatten().map_or(node.location(), |p| p.location);
        let words = DIALECTS.map(|dialect| dialect.protocol);
        let hint = spelling::suggestion(protocol, words);
        location.error(format!("no profile protocol `{protocol}`: {}{hint}", words.join(" or ")))
    })
}

/// Begins a table anew instead of with what the profile that is extended has.
fn clear_table(draft: &mut Draft, table: &Located<String>) -> Result<(), FileError> {
    match table.value.as_str() {
        "faults" => draft.faults.clear(),
        "signals" => draft.signals.clear(),
        "plans" => draft.plans.clear(),
        "motion" => draft.motion = DraftMotion::new(),
        other => {
            let known = ["faults", "signals", "plans", "motion"];
            let hint = spelling::suggestion(other, known);
            let reason = format!("`{other}` is none of {}{hint}", known.join(", "));
            return Err(table.location.error(reason));
        }
    }
    Ok(())
}

fn remove_parameters(draft: &mut Draft, names: &[Located<String>]) -> Result<(), FileError> {
    let mut remaining: HashSet<String> = draft.parameters.iter().map(folded_name).collect();
    for Located { value, location } in names {
        if !remaining.remove(&spelling::fold(value)) {
            let others = draft.parameters.iter().filter(|p| remaining.contains(&folded_name(p)));
            let hint = spelling::suggestion(value, others.map(|p| p.name.as_str()));
            return Err(location.error(format!("nothing called `{value}` to remove{hint}")));
        }
    }
    draft.parameters.retain(|p| remaining.contains(&folded_name(p)));
    Ok(())
}

fn folded_name(p: &DraftParameter) -> String {
    spelling::fold(&p.name)
}

/// Takes over the names of another protocol's registers, where they lie as objects here: those of one
/// register each, by ranges. All else that concerns registers is left out.
fn shift_registers(draft: &mut Draft, node: &TomlTable<'_, '_>) -> Result<(), FileError> {
    let ranges = node.tables("shift", &["from", "to", "count"])?;
    if ranges.is_empty() {
        return Ok(());
    }
    let mut moves = Vec::new();
    for range in &ranges {
        moves.push((
            required_word("from", range)?,
            required_word("to", range)?,
            required_word("count", range)?,
        ));
    }
    draft.parameters.retain_mut(|p| {
        let at = i64::from(p.index);
        let single = matches!(p.encoding, Encoding::U16 | Encoding::I16) && p.space == 0;
        let range = moves.iter().find(|(from, _, count)| (*from..from + count).contains(&at));
        let to = range.and_then(|(from, to, _)| u16::try_from(at - from + to).ok());
        // A register outside of all ranges is dropped below.
        p.index = to.unwrap_or(p.index);
        single && to.is_some()
    });
    // They name registers by their old places; a plan that writes a shifted one would write another
    // parameter.
    (draft.signals, draft.plans, draft.identity) = (Vec::new(), Vec::new(), None);
    draft.motion = DraftMotion::new();
    draft.optional = Vec::new();
    Ok(())
}

fn required_word(key: &str, range: &TomlTable<'_, '_>) -> Result<i64, FileError> {
    let word = range.integer_between(key, 0, 65_535)?;
    word.ok_or_else(|| range.location().error(format!("`shift` needs `{key}`")))
}

struct ProfileReader {
    dialect: &'static Dialect,
    motor: MotorChoice,
}

/// Name and symbol of an entry as they are compared.
fn folded_names(parameter: &DraftParameter) -> (String, String) {
    (spelling::fold(&parameter.name), spelling::fold(&parameter.symbol))
}

impl ProfileReader {
    fn read_parameters(
        &self,
        draft: &mut Draft,
        node: &TomlTable<'_, '_>,
    ) -> Result<(), FileError> {
        let mut inherited: Vec<_> = draft.parameters.iter().map(folded_names).collect();
        for table in node.tables("parameter", &PARAMETER_KEYS)? {
            for parameter in self.read_repeated(&table)? {
                let names = folded_names(&parameter);
                match inherited.iter().position(|other| self.is_same(&names, other)) {
                    Some(at) => {
                        draft.parameters[at] = parameter;
                        inherited[at] = names;
                    }
                    None => draft.parameters.push(parameter),
                }
            }
            if draft.parameters.len() > ENTRIES_MAX {
                return Err(table.location().error(format!("more than {ENTRIES_MAX} parameters")));
            }
        }
        Ok(())
    }

    /// Returns whether two entries are one: their names are, or in a memory the names that the map gives them.
    fn is_same(&self, one: &(String, String), other: &(String, String)) -> bool {
        // A variable of TML is known by its symbol in the map; its readable name is ours.
        let memory = self.dialect.protocol == MEMORY_PROTOCOL;
        one.0 == other.0 || (memory && !one.1.is_empty() && one.1 == other.1)
    }

    fn read_repeated(&self, table: &TomlTable<'_, '_>) -> Result<Vec<DraftParameter>, FileError> {
        let one = self.read_parameter(table)?;
        let Some(repeat) = table.table("repeat", &["count", "stride"])? else {
            return Ok(vec![one]);
        };
        let count = repeat.integer_between("count", 1, ENTRIES_MAX as i64)?.unwrap_or(1);
        let stride = repeat.integer_between("stride", 0, 65535)?.unwrap_or(1);
        (0..count)
            .map(|n| {
                let index = u16::try_from(i64::from(one.index) + n * stride).map_err(|_| {
                    repeat.location().error(format!("repetition {} is beyond index 65535", n + 1))
                })?;
                Ok(fill_repeated(&one, n + 1, index))
            })
            .collect()
    }

    fn read_parameter(&self, table: &TomlTable<'_, '_>) -> Result<DraftParameter, FileError> {
        let encoding =
            optional_choice(table, "encoding", &ENCODINGS)?.unwrap_or(self.dialect.encoding);
        let (min_value, max_value) = encoding.raw_range();
        let index = self.motor.read_index(table)?;
        let ScaleParts { factor, times, over, rule, negative } = read_scale(table)?;
        Ok(DraftParameter {
            location: table.location(),
            name: table.required_text("name")?.try_map(check_name)?,
            symbol: optional_text(table, "symbol")?,
            about: optional_text(table, "about")?,
            space: self.read_space(table)?,
            index,
            encoding,
            unit: read_unit(table)?,
            factor,
            times,
            over,
            rule,
            negative,
            min: read_raw_limit(table, "min", encoding)?.unwrap_or(min_value),
            max: read_raw_limit(table, "max", encoding)?.unwrap_or(max_value),
            default: read_raw_limit(table, "default", encoding)?,
            access: optional_choice(table, "access", &ACCESSES)?.unwrap_or(Access::ReadWrite),
            persistence: optional_choice(table, "persistence", &PERSISTENCES)?
                .unwrap_or(Persistence::Volatile),
            certainty: optional_choice(table, "certainty", &CERTAINTIES)?
                .unwrap_or(Certainty::Documented),
            moves: table.boolean("moves")?,
            section: optional_text(table, "section")?,
            values: read_values(table)?,
            digits: digits::read(table)?,
            bits: bits::read(table)?,
        })
    }

    fn read_space(&self, table: &TomlTable<'_, '_>) -> Result<u8, FileError> {
        let spaces = self.dialect.spaces;
        let sub = self.motor.read_integer(table, "sub")?;
        if let Some(sub) = sub.filter(|_| self.dialect.protocol == OBJECT_PROTOCOL) {
            return sub.try_map(|n| {
                u8::try_from(n).map_err(|_| format!("`sub` is {n}; it must be 0 to 255"))
            });
        }
        optional_choice(table, "space", spaces).map(|space| space.unwrap_or(spaces[0].1))
    }

    fn read_faults(&self, draft: &mut Draft, node: &TomlTable<'_, '_>) -> Result<(), FileError> {
        // Only inherited faults are replaced: two of one code in the same file are an error.
        let inherited = draft.faults.len();
        for table in node.tables("fault", &FAULT_KEYS)? {
            let fault = read_fault(&table, self.motor)?;
            match draft.faults[..inherited]
                .iter()
                .position(|f| f.code == fault.code || f.name == fault.name)
            {
                Some(at) => draft.faults[at] = fault,
                None => draft.faults.push(fault),
            }
        }
        Ok(())
    }
}

/// A raw limit or default; of floating-point numbers it is the number itself.
fn read_raw_limit(
    table: &TomlTable<'_, '_>,
    key: &str,
    encoding: Encoding,
) -> Result<Option<i64>, FileError> {
    if encoding.is_real() {
        let Some(number) = table.float(key)? else { return Ok(None) };
        let raw = number.try_map(|number| {
            encoding.raw(number).ok_or_else(|| format!("`{key}` does not fit its encoding"))
        });
        return raw.map(Some);
    }
    let (min, max) = match encoding {
        // TOML's own integers reach no further.
        Encoding::U64 | Encoding::U64LowFirst => (0, i64::MAX),
        Encoding::Text | Encoding::Bytes => (0, -1),
        _ => encoding.raw_range(),
    };
    table.integer_between(key, min, max)
}

/// The `n`th of a repeated parameter, `{n}`, `{index}` and `{number}` filled in.
fn fill_repeated(one: &DraftParameter, n: i64, index: u16) -> DraftParameter {
    let fill_name = |name: &Option<Located<String>>| {
        name.as_ref().map(|name| Located {
            value: filled_template(&name.value, n, index),
            location: name.location.clone(),
        })
    };
    DraftParameter {
        name: filled_template(&one.name, n, index),
        symbol: filled_template(&one.symbol, n, index),
        about: filled_template(&one.about, n, index),
        times: fill_name(&one.times),
        over: fill_name(&one.over),
        index,
        ..one.clone()
    }
}

fn filled_template(text: &str, n: i64, index: u16) -> String {
    text.replace("{n}", &n.to_string())
        .replace("{index}", &format!("{index:X}"))
        .replace("{number}", &index.to_string())
}

fn check_name(name: String) -> Result<String, String> {
    if name.trim().is_empty() {
        return Err("a parameter needs a name".into());
    }
    Ok(name)
}

pub(super) fn optional_text(table: &TomlTable<'_, '_>, key: &str) -> Result<String, FileError> {
    Ok(table.text(key)?.map(|found| found.value).unwrap_or_default())
}

pub(super) fn optional_choice<T: Copy>(
    table: &TomlTable<'_, '_>,
    key: &str,
    words: &[(&str, T)],
) -> Result<Option<T>, FileError> {
    table.text(key)?.map(|found| found.try_map(|word| parse_choice(&word, words))).transpose()
}

fn read_unit(table: &TomlTable<'_, '_>) -> Result<Unit, FileError> {
    let Some(found) = table.text("unit")? else { return Ok(Unit::None) };
    found.try_map(|word| parse_choice(&word, &Unit::ALL.map(|unit| (unit.symbol(), unit))))
}

fn read_fault(table: &TomlTable<'_, '_>, motor: MotorChoice) -> Result<DraftFault, FileError> {
    let code = match motor.read_integer(table, "code")? {
        Some(code) => code,
        None => table.required_integer("code")?,
    };
    let code = code
        .try_map(|n| u32::try_from(n).map_err(|_| format!("`code` is {n}; it must fit 32 bits")))?;
    Ok(DraftFault {
        location: table.location(),
        code,
        name: table.required_text("name")?.value,
        text: table.required_text("text")?.value,
        cause: optional_text(table, "cause")?,
        remedy: optional_text(table, "remedy")?,
        severity: optional_choice(table, "severity", &SEVERITIES)?.unwrap_or(Severity::Fault),
    })
}
