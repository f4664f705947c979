//! From TOML to a draft: every key known, every word of a choice known, every number in its place.

use super::draft::{
    Draft, DraftFault, DraftIdentity, DraftParameter, DraftPlan, DraftRam, DraftSignal,
    DraftWatchdog,
};
use super::{map, step};
use crate::file::{FileError, Found, Node, Text, number};
use crate::words;
use polepair_core::axis::Verb;
use polepair_core::profile::{
    Access, AxisKind, Certainty, Encoding, Persistence, Severity, Signal,
};
use polepair_core::units::Unit;

/// Parameters, faults, or repetitions of one, that a profile may have at most.
pub(crate) const ENTRIES_MAX: usize = 4096;

const KEYS: [&str; 21] = [
    "name",
    "extends",
    "remove",
    "shift",
    "family",
    "protocol",
    "title",
    "source",
    "axis",
    "reply_timeout_ms",
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
    "plans",
];

const PARAMETER_KEYS: [&str; 19] = [
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
    "repeat",
];

const FAULT_KEYS: [&str; 6] = ["code", "name", "text", "cause", "remedy", "severity"];

/// What a protocol calls its address spaces, and how a value lies there when nothing is said.
struct Dialect {
    protocol: &'static str,
    spaces: &'static [(&'static str, u8)],
    encoding: Encoding,
}

const DIALECTS: [Dialect; 5] = [
    Dialect {
        protocol: "tmcl",
        spaces: &[("axis", 0), ("global 0", 1), ("global 1", 2), ("global 2", 3), ("global 3", 4)],
        encoding: Encoding::I32,
    },
    Dialect {
        protocol: "modbus",
        spaces: &[("holding", 0), ("coil", 1), ("discrete", 2), ("input", 3)],
        encoding: Encoding::U16,
    },
    Dialect { protocol: OBJECTS, spaces: &[("object", 0)], encoding: Encoding::U32 },
    Dialect { protocol: MEMORY, spaces: &[("data", 0)], encoding: Encoding::I16 },
    Dialect {
        protocol: "thruster",
        spaces: &[("command", 0), ("internal", 1), ("internal high", 2), ("internal low", 3)],
        encoding: Encoding::I16,
    },
];

/// The protocol whose parameters are objects, whose space is a sub-index; `sub` gives it.
const OBJECTS: &str = "canopen";

/// The protocol whose parameters are a drive's memory: several names may share an address, and a
/// map of the memory gives them all.
pub(crate) const MEMORY: &str = "tml";

const AXES: [(&str, AxisKind); 3] =
    [("rotary", AxisKind::Rotary), ("linear", AxisKind::Linear), ("ratio", AxisKind::Ratio)];

const ENCODINGS: [(&str, Encoding); 10] = [
    ("bit", Encoding::Bit),
    ("u8", Encoding::U8),
    ("i8", Encoding::I8),
    ("u16", Encoding::U16),
    ("i16", Encoding::I16),
    ("u32", Encoding::U32),
    ("i32", Encoding::I32),
    ("i32-low-first", Encoding::I32LowFirst),
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

/// Raw values that an encoding can carry.
pub(crate) const fn encoding_range(encoding: Encoding) -> (i64, i64) {
    match encoding {
        Encoding::Bit => (0, 1),
        Encoding::U8 => (0, u8::MAX as i64),
        Encoding::I8 => (i8::MIN as i64, i8::MAX as i64),
        Encoding::U16 => (0, u16::MAX as i64),
        Encoding::I16 => (i16::MIN as i64, i16::MAX as i64),
        Encoding::U32 => (0, u32::MAX as i64),
        Encoding::I32 | Encoding::I32LowFirst | Encoding::Fixed => {
            (i32::MIN as i64, i32::MAX as i64)
        }
        // 32767 tens and less than ten more, in thousandths.
        Encoding::TensAndThousandths => (-327_679_999, 327_679_999),
    }
}

/// Reads a profile. `base` gives the draft of the profile that this one extends.
pub(crate) fn draft(
    file: &str,
    text: &str,
    base: &mut dyn FnMut(&Found<String>) -> Result<Draft, FileError>,
) -> Result<Draft, FileError> {
    Text::new(file, text).read(&KEYS, |node| {
        let mut draft = match node.text("extends")? {
            Some(name) => base(&name)?,
            None => blank(&node)?,
        };
        shift(&mut draft, &node)?;
        head(&mut draft, &node)?;
        let file = Reader { dialect: dialect_of(&node, &draft.protocol)? };
        if let Some(map) = node.text("map")? {
            map::apply(&mut draft, &map)?;
        }
        for name in node.texts("remove")? {
            remove(&mut draft, &name)?;
        }
        file.parameters(&mut draft, &node)?;
        file.faults(&mut draft, &node)?;
        signals(&mut draft, &node)?;
        plans(&mut draft, &node)?;
        Ok(draft)
    })
}

fn blank(node: &Node<'_, '_>) -> Result<Draft, FileError> {
    let name = node.needed_text("name")?.value;
    let protocol = node.needed_text("protocol")?.value;
    Ok(Draft {
        place: node.place(),
        title: name.clone(),
        name,
        family: protocol.clone(),
        protocol,
        source: String::new(),
        axis: AxisKind::Rotary,
        reply_timeout_ms: 100,
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
    })
}

fn head(draft: &mut Draft, node: &Node<'_, '_>) -> Result<(), FileError> {
    draft.place = node.place();
    draft.name = node.needed_text("name")?.check(word)?;
    replace(&mut draft.title, node.text("title")?);
    replace(&mut draft.source, node.text("source")?);
    replace(&mut draft.caution, node.text("caution")?);
    if let Some(family) = node.text("family")? {
        draft.family = family.check(word)?;
    }
    if let Some(protocol) = node.text("protocol")? {
        draft.protocol = protocol.value;
    }
    if let Some(axis) = node.text("axis")? {
        draft.axis = axis.check(|word| choice(&word, &AXES))?;
    }
    if let Some(ms) = node.between("reply_timeout_ms", 1, 60_000)? {
        draft.reply_timeout_ms = u32::try_from(ms).unwrap_or(u32::MAX);
    }
    if let Some(watchdog) = watchdog(node)? {
        draft.watchdog = watchdog;
    }
    if let Some(identity) = identity(node)? {
        draft.identity = Some(identity);
    }
    if let Some(table) = node.table("ram", &["parameter", "ram", "flash"])? {
        draft.ram = Some(DraftRam {
            parameter: table.needed_text("parameter")?,
            ram: table.needed_integer("ram")?.value,
            flash: table.needed_integer("flash")?.value,
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

fn identity(node: &Node<'_, '_>) -> Result<Option<DraftIdentity>, FileError> {
    let keys = ["parameter", "ask", "mask", "equals", "firmware"];
    let Some(table) = node.table("identify", &keys)? else { return Ok(None) };
    let (parameter, text) = (table.text("parameter")?, plain(&table, "ask")?);
    if parameter.is_some() != text.is_empty() {
        return Err(table.place().error("`identify` needs either `parameter` or `ask`"));
    }
    let number = |key| table.integer(key).map(|found| found.map_or(0, |found| found.value));
    let (mask, equals, firmware) = (number("mask")?, number("equals")?, number("firmware")?);
    if equals & !mask != 0 {
        return Err(table.place().error("`equals` has bits that `mask` takes away"));
    }
    Ok(Some(DraftIdentity { parameter, text, mask, equals, firmware }))
}

fn replace(text: &mut String, with: Option<Found<String>>) {
    if let Some(found) = with {
        *text = found.value;
    }
}

/// Names of profiles and families become file names, constants and words in URLs.
fn word(text: String) -> Result<String, String> {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "-_.".contains(c);
    if text.is_empty() || !text.chars().all(plain) {
        return Err(format!("`{text}` must be of a-z, 0-9, `-`, `_` and `.`"));
    }
    Ok(text)
}

fn choice<T: Copy>(word: &str, table: &[(&str, T)]) -> Result<T, String> {
    let known = table.iter().find(|(name, _)| *name == word);
    known.map(|(_, value)| *value).ok_or_else(|| {
        let words: Vec<&str> =
            table.iter().map(|(name, _)| *name).filter(|name| !name.is_empty()).collect();
        let hint = words::hint(word, words.iter().copied());
        format!("`{word}` is none of {}{hint}", words.join(", "))
    })
}

fn dialect_of(node: &Node<'_, '_>, protocol: &str) -> Result<&'static Dialect, FileError> {
    let known = DIALECTS.iter().find(|dialect| dialect.protocol == protocol);
    known.ok_or_else(|| {
        let place = node.text("protocol").ok().flatten().map_or(node.place(), |p| p.place);
        let words = DIALECTS.map(|dialect| dialect.protocol);
        let hint = words::hint(protocol, words);
        place.error(format!("no profile protocol `{protocol}`: {}{hint}", words.join(" or ")))
    })
}

fn watchdog(node: &Node<'_, '_>) -> Result<Option<DraftWatchdog>, FileError> {
    let keys = ["kind", "after_ms", "parameter", "on_can", "reaction"];
    let Some(table) = node.table("watchdog", &keys)? else { return Ok(None) };
    let kind = table.needed_text("kind")?;
    Ok(Some(match kind.value.as_str() {
        "none" => DraftWatchdog::None,
        "fixed" => {
            let ms = table.between("after_ms", 1, i64::from(u32::MAX))?;
            let ms = ms.ok_or_else(|| kind.place.error("`fixed` needs `after_ms`"))?;
            DraftWatchdog::Fixed(u32::try_from(ms).unwrap_or(u32::MAX))
        }
        "configurable" => DraftWatchdog::Configurable {
            parameter: table.needed_text("parameter")?,
            on_can: table.text("on_can")?,
        },
        "heartbeat" => DraftWatchdog::Heartbeat {
            consumer: table.needed_text("parameter")?,
            reaction: table.needed_text("reaction")?,
        },
        other => {
            let known = ["none", "fixed", "configurable", "heartbeat"];
            let hint = words::hint(other, known);
            return Err(kind
                .place
                .error(format!("`{other}` is none of {}{hint}", known.join(", "))));
        }
    }))
}

fn remove(draft: &mut Draft, name: &Found<String>) -> Result<(), FileError> {
    let wanted = words::folded(&name.value);
    let before = draft.parameters.len();
    draft.parameters.retain(|p| words::folded(&p.name) != wanted);
    if draft.parameters.len() == before {
        let hint = words::hint(&name.value, draft.parameters.iter().map(|p| p.name.as_str()));
        return Err(name.place.error(format!("nothing called `{}` to remove{hint}", name.value)));
    }
    Ok(())
}

/// Takes over the names of another protocol's registers, where they lie as objects here: those of one
/// register each, by ranges. All else that concerns registers is left out.
fn shift(draft: &mut Draft, node: &Node<'_, '_>) -> Result<(), FileError> {
    let ranges = node.tables("shift", &["from", "to", "count"])?;
    if ranges.is_empty() {
        return Ok(());
    }
    let mut moves = Vec::new();
    for range in &ranges {
        let number = |key| range.between(key, 0, 65_535).map(|n| n.unwrap_or(0));
        moves.push((number("from")?, number("to")?, number("count")?));
    }
    draft.parameters.retain_mut(|p| {
        let at = i64::from(p.index);
        let single = matches!(p.encoding, Encoding::U16 | Encoding::I16) && p.space == 0;
        let range = moves.iter().find(|(from, _, count)| (*from..from + count).contains(&at));
        let to = range.and_then(|(from, to, _)| u16::try_from(at - from + to).ok());
        p.index = to.unwrap_or(p.index);
        single && to.is_some()
    });
    (draft.signals, draft.plans, draft.identity) = (Vec::new(), Vec::new(), None);
    draft.optional = Vec::new();
    Ok(())
}

struct Reader {
    dialect: &'static Dialect,
}

impl Reader {
    fn parameters(&self, draft: &mut Draft, node: &Node<'_, '_>) -> Result<(), FileError> {
        let inherited = draft.parameters.len();
        for table in node.tables("parameter", &PARAMETER_KEYS)? {
            for parameter in self.repeated(&table)? {
                let same = self.same(&parameter);
                match draft.parameters[..inherited].iter().position(same) {
                    Some(at) => draft.parameters[at] = parameter,
                    None => draft.parameters.push(parameter),
                }
            }
            if draft.parameters.len() > ENTRIES_MAX {
                return Err(table.place().error(format!("more than {ENTRIES_MAX} parameters")));
            }
        }
        Ok(())
    }

    /// Whether another entry is this one: its name is, or in a memory the name that the map gives it.
    fn same(&self, parameter: &DraftParameter) -> impl Fn(&DraftParameter) -> bool + use<> {
        let (name, symbol) = (words::folded(&parameter.name), words::folded(&parameter.symbol));
        let memory = self.dialect.protocol == MEMORY;
        move |p| {
            words::folded(&p.name) == name
                || (memory && !symbol.is_empty() && words::folded(&p.symbol) == symbol)
        }
    }

    fn repeated(&self, table: &Node<'_, '_>) -> Result<Vec<DraftParameter>, FileError> {
        let one = self.parameter(table)?;
        let Some(repeat) = table.table("repeat", &["count", "stride"])? else {
            return Ok(vec![one]);
        };
        let count = repeat.between("count", 1, ENTRIES_MAX as i64)?.unwrap_or(1);
        let stride = repeat.between("stride", 0, 65535)?.unwrap_or(1);
        let nth = |n: i64| {
            let index = u16::try_from(i64::from(one.index) + n * stride).map_err(|_| {
                repeat.place().error(format!("repetition {} is beyond index 65535", n + 1))
            })?;
            Ok(filled(&one, n + 1, index))
        };
        (0..count).map(nth).collect()
    }

    fn parameter(&self, table: &Node<'_, '_>) -> Result<DraftParameter, FileError> {
        let encoding = optional(table, "encoding", &ENCODINGS)?.unwrap_or(self.dialect.encoding);
        let (least, most) = encoding_range(encoding);
        let index = table.needed_integer("index")?.check(|n| {
            u16::try_from(n).map_err(|_| format!("`index` is {n}; it must be 0 to 65535"))
        })?;
        let (factor, times, over) = scale(table)?;
        Ok(DraftParameter {
            place: table.place(),
            name: table.needed_text("name")?.check(filled_in)?,
            symbol: plain(table, "symbol")?,
            about: plain(table, "about")?,
            space: self.space(table)?,
            index,
            encoding,
            unit: unit(table)?,
            factor,
            times,
            over,
            min: table.between("min", least, most)?.unwrap_or(least),
            max: table.between("max", least, most)?.unwrap_or(most),
            default: table.between("default", least, most)?,
            access: optional(table, "access", &ACCESSES)?.unwrap_or(Access::ReadWrite),
            persistence: optional(table, "persistence", &PERSISTENCES)?
                .unwrap_or(Persistence::Volatile),
            certainty: optional(table, "certainty", &CERTAINTIES)?.unwrap_or(Certainty::Documented),
            moves: table.flag("moves")?,
            section: plain(table, "section")?,
            values: values(table)?,
        })
    }

    fn space(&self, table: &Node<'_, '_>) -> Result<u8, FileError> {
        let spaces = self.dialect.spaces;
        let sub = table.integer("sub")?;
        if let Some(sub) = sub.filter(|_| self.dialect.protocol == OBJECTS) {
            return sub.check(|n| {
                u8::try_from(n).map_err(|_| format!("`sub` is {n}; it must be 0 to 255"))
            });
        }
        optional(table, "space", spaces).map(|space| space.unwrap_or(spaces[0].1))
    }

    fn faults(&self, draft: &mut Draft, node: &Node<'_, '_>) -> Result<(), FileError> {
        let inherited = draft.faults.len();
        for table in node.tables("fault", &FAULT_KEYS)? {
            let fault = fault(&table)?;
            let same = |f: &DraftFault| f.code == fault.code || f.name == fault.name;
            match draft.faults[..inherited].iter().position(same) {
                Some(at) => draft.faults[at] = fault,
                None => draft.faults.push(fault),
            }
        }
        Ok(())
    }
}

/// The `n`th of a repeated parameter, `{n}` and `{index}` filled in.
fn filled(one: &DraftParameter, n: i64, index: u16) -> DraftParameter {
    let fill = |text: &String| {
        text.replace("{n}", &n.to_string()).replace("{index}", &format!("{index:X}"))
    };
    let fill_name = |name: &Option<Found<String>>| {
        name.as_ref().map(|name| Found { value: fill(&name.value), place: name.place.clone() })
    };
    DraftParameter {
        name: fill(&one.name),
        symbol: fill(&one.symbol),
        about: fill(&one.about),
        times: fill_name(&one.times),
        over: fill_name(&one.over),
        index,
        ..one.clone()
    }
}

fn filled_in(name: String) -> Result<String, String> {
    if name.trim().is_empty() {
        return Err("a parameter needs a name".into());
    }
    Ok(name)
}

fn plain(table: &Node<'_, '_>, key: &str) -> Result<String, FileError> {
    Ok(table.text(key)?.map(|found| found.value).unwrap_or_default())
}

fn optional<T: Copy>(
    table: &Node<'_, '_>,
    key: &str,
    words: &[(&str, T)],
) -> Result<Option<T>, FileError> {
    table.text(key)?.map(|found| found.check(|word| choice(&word, words))).transpose()
}

fn unit(table: &Node<'_, '_>) -> Result<Unit, FileError> {
    let Some(found) = table.text("unit")? else { return Ok(Unit::None) };
    found.check(|word| choice(&word, &Unit::ALL.map(|unit| (unit.symbol(), unit))))
}

type ScaleParts = (f64, Option<Found<String>>, Option<Found<String>>);

fn scale(table: &Node<'_, '_>) -> Result<ScaleParts, FileError> {
    let (factor, times, over) = if table.is_table("scale") {
        match table.table("scale", &["factor", "times", "over"])? {
            Some(node) => (node.real("factor")?, node.text("times")?, node.text("over")?),
            None => (None, None, None),
        }
    } else {
        (table.real("scale")?, None, None)
    };
    let factor = factor.map(|found| {
        found.check(|f| if f == 0.0 { Err("a scale cannot be 0".into()) } else { Ok(f) })
    });
    Ok((factor.transpose()?.unwrap_or(1.0), times, over))
}

fn values(table: &Node<'_, '_>) -> Result<Vec<(i64, String)>, FileError> {
    let Some(node) = table.table("values", &[])? else { return Ok(Vec::new()) };
    let mut values = Vec::new();
    for key in node.keys() {
        let word = node.needed_text(key.value)?.value;
        let raw = key.check(|key| {
            number(key).ok_or_else(|| format!("`{key}` is not a whole number, decimal or 0x"))
        })?;
        values.push((raw, word));
    }
    values.sort();
    Ok(values)
}

fn fault(table: &Node<'_, '_>) -> Result<DraftFault, FileError> {
    let code = table
        .needed_integer("code")?
        .check(|n| u32::try_from(n).map_err(|_| format!("`code` is {n}; it must fit 32 bits")))?;
    Ok(DraftFault {
        place: table.place(),
        code,
        name: table.needed_text("name")?.value,
        text: table.needed_text("text")?.value,
        cause: plain(table, "cause")?,
        remedy: plain(table, "remedy")?,
        severity: optional(table, "severity", &SEVERITIES)?.unwrap_or(Severity::Fault),
    })
}

fn signals(draft: &mut Draft, node: &Node<'_, '_>) -> Result<(), FileError> {
    // A bare TOML key holds no space: `target-velocity` is as good as `"target velocity"`.
    let bare = Signal::ALL.map(|signal| signal.name().replace(' ', "-"));
    let names: Vec<&str> =
        bare.iter().map(String::as_str).chain(Signal::ALL.map(Signal::name)).collect();
    let Some(table) = node.table("signals", &names)? else { return Ok(()) };
    for (signal, bare) in Signal::ALL.into_iter().zip(&bare) {
        let key = if table.has(bare) { bare } else { signal.name() };
        if !table.has(key) {
            continue;
        }
        let source = source(&table, key, signal)?;
        match draft.signals.iter_mut().find(|s| s.signal == signal) {
            Some(old) => *old = source,
            None => draft.signals.push(source),
        }
    }
    Ok(())
}

fn source(table: &Node<'_, '_>, key: &str, signal: Signal) -> Result<DraftSignal, FileError> {
    if !table.is_table(key) {
        let parameter = table.needed_text(key)?;
        return Ok(DraftSignal { signal, parameter, mask: -1, equals: None, values: Vec::new() });
    }
    let keys = ["parameter", "mask", "equals", "values"];
    let node = table.table(key, &keys)?.ok_or_else(|| table.place().error("not a table"))?;
    Ok(DraftSignal {
        signal,
        parameter: node.needed_text("parameter")?,
        mask: node.integer("mask")?.map_or(-1, |found| found.value),
        equals: node.integer("equals")?.map(|found| found.value),
        values: values(&node)?,
    })
}

fn plans(draft: &mut Draft, node: &Node<'_, '_>) -> Result<(), FileError> {
    let names = Verb::ALL.map(Verb::name);
    let Some(table) = node.table("plans", &names)? else { return Ok(()) };
    for verb in Verb::ALL.into_iter().filter(|verb| table.has(verb.name())) {
        let keys = ["source", "steps", "undo"];
        let Some(node) = table.table(verb.name(), &keys)? else { continue };
        let steps = node.texts("steps")?;
        if steps.is_empty() {
            return Err(node.place().error("a plan needs `steps`"));
        }
        let plan = DraftPlan {
            place: node.place(),
            verb,
            source: plain(&node, "source")?,
            steps: steps.iter().map(step::parse).collect::<Result<_, _>>()?,
            undo: node.texts("undo")?.iter().map(step::parse).collect::<Result<_, _>>()?,
        };
        match draft.plans.iter_mut().find(|p| p.verb == verb) {
            Some(old) => *old = plan,
            None => draft.plans.push(plan),
        }
    }
    Ok(())
}
