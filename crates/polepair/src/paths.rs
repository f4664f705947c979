//! The paths that a SYNTRON TS stores: motions that lead to one another (TS manual V2 §2.6).
//!
//! A [`PathTable`] is read from a drive, or from a file with a line for each path:
//!
//! ```toml
//! version = 1
//! motor_turns = 1
//! travel = "360 deg"
//!
//! [paths]
//! 1 = { kind = "auto", end = "absolute", position = "90 deg", speed = "300 rpm", next = 2, … }
//! 2 = { kind = "single", end = "absolute", position = "0 deg", speed = "300 rpm", … }
//! ```
//!
//! [`PathTable::check`] follows the chains, [`PathTable::preview`] runs them on the motor model, and
//! [`Axis::run_path`] runs them on a drive.
//!
//! The drive counts positions in the unit of its mechanics, mm or degrees, and does not store which of the two. A file
//! states it with the travel.

mod check;
mod file;
mod preview;
mod run;

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use polepair_drives::stored_paths::{PATH_MAX, PathType};
pub use polepair_drives::stored_paths::{PathDefinition, PathEnd};

use crate::axis::{LocalAxis, NamedValue};
use crate::error::{Error, Exit};
use crate::interface::{Axis, WriteValue};
pub use check::{PathChain, PathChainEnd, PathFinding};
pub use preview::{PathPreview, PreviewEnd, PreviewPoint};
pub use run::PathArrival;

/// Parameters of the mechanics, Fn_205 and Fn_206.
const MOTOR_TURNS: &str = "mechanics motor turns";
const TRAVEL: &str = "mechanics travel";
/// Travel of one turn from the factory, degrees.
const FACTORY_TRAVEL: u16 = 360;

/// Words of types of paths. An empty path has no word in a file.
const KINDS: [(&str, PathType); 4] = [
    ("speed", PathType::Speed),
    ("single", PathType::Single),
    ("auto", PathType::Auto),
    ("none", PathType::Unknown(0)),
];
const ENDS: [(&str, PathEnd); 3] = [
    ("absolute", PathEnd::Coordinate),
    ("from-last-end", PathEnd::LastCommand),
    ("from-here", PathEnd::Feedback),
];

/// Motor turns and travel of a drive's mechanics, Fn_205 and Fn_206; `None` for drives without them.
pub(crate) fn mechanics(axis: &LocalAxis) -> Result<Option<[i64; 2]>, Error> {
    let (Ok(turns), Ok(travel)) = (axis.find(MOTOR_TURNS), axis.find(TRAVEL)) else {
        return Ok(None);
    };
    Ok(Some([axis.read(turns)?, axis.read(travel)?]))
}

/// Unit of the mechanics.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PathUnit {
    /// Degrees.
    Degree,
    /// Millimetres.
    Millimetre,
}

impl PathUnit {
    /// Symbol of the unit.
    #[must_use]
    pub const fn symbol(self) -> &'static str {
        match self {
            Self::Degree => "deg",
            Self::Millimetre => "mm",
        }
    }

    /// A coordinate as text: `90 deg`.
    #[must_use]
    pub fn format(self, thousandths: i32) -> String {
        format!("{} {}", f64::from(thousandths) / 1000.0, self.symbol())
    }
}

/// The paths of a drive, and the mechanics that their positions are counted in.
#[derive(Clone, PartialEq, Debug)]
pub struct PathTable {
    /// Turns of the motor, Fn_205.
    pub motor_turns: u16,
    /// Travel of the mechanics in those turns, in [`unit`](Self::unit), Fn_206.
    pub travel: u16,
    /// Unit of positions.
    pub unit: PathUnit,
    /// Positions that the mechanics can reach, thousandths of the unit. The drive does not store them.
    pub range: Option<(i32, i32)>,
    /// Paths by their number, 1 to 32. Empty ones are left out.
    pub paths: BTreeMap<u8, PathDefinition>,
    /// Definition words of the drive whose digits mean nothing.
    defects: Vec<PathFinding>,
}

/// A difference between two tables: of the mechanics, or of a path.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct PathChange {
    /// Number of the path; `None` for the mechanics.
    pub path: Option<u8>,
    /// Name of the field.
    pub field: &'static str,
    /// Value in the first table, in words.
    pub from: String,
    /// Value in the second table.
    pub to: String,
}

impl PathTable {
    /// A table without paths of a drive with its factory's mechanics: a turn is 360 degrees.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            motor_turns: 1,
            travel: FACTORY_TRAVEL,
            unit: PathUnit::Degree,
            range: None,
            paths: BTreeMap::new(),
            defects: Vec::new(),
        }
    }

    /// Reads the paths of a drive. Without a `unit`, a travel of 360 in each turn is taken for degrees, and any other
    /// one for millimetres. `progress` gets the number of paths that were read, of 32.
    ///
    /// # Errors
    /// [`Error::Unsupported`] `E218` for a drive without paths; others by source.
    pub fn read(
        axis: &Axis,
        unit: Option<PathUnit>,
        mut progress: impl FnMut(u8),
    ) -> Result<Self, Error> {
        let names = PathNames::of(axis)?;
        let mut table = Self::new();
        table.motor_turns = read_word(axis, MOTOR_TURNS)?;
        table.travel = read_word(axis, TRAVEL)?;
        let is_rotary =
            u32::from(table.travel) == u32::from(table.motor_turns) * u32::from(FACTORY_TRAVEL);
        let usual = if is_rotary { PathUnit::Degree } else { PathUnit::Millimetre };
        table.unit = unit.unwrap_or(usual);
        for number in 1..=PATH_MAX {
            progress(number - 1);
            let path = names.read(axis, number, &mut table.defects)?;
            if path != PathDefinition::EMPTY {
                table.paths.insert(number, path);
            }
        }
        Ok(table)
    }

    /// The path of that number, 1 to 32.
    #[must_use]
    pub fn path(&self, number: u8) -> PathDefinition {
        self.paths.get(&number).copied().unwrap_or(PathDefinition::EMPTY)
    }

    /// The table of the drive once this one was written to it: paths that this one does not have stay.
    #[must_use]
    pub fn written_over(&self, drive: &Self) -> Self {
        let mut merged = self.clone();
        for (number, path) in &drive.paths {
            merged.paths.entry(*number).or_insert(*path);
        }
        merged
    }

    /// Differences of `other` from this table, field by field. Positions are shown in the units of `other`.
    #[must_use]
    pub fn changes(&self, other: &Self) -> Vec<PathChange> {
        let mut changes = Vec::new();
        let mechanics = [
            ("motor turns", self.motor_turns.to_string(), other.motor_turns.to_string()),
            ("travel", self.travel_text(other.unit), other.travel_text(other.unit)),
        ];
        for (field, from, to) in mechanics {
            if from != to {
                changes.push(PathChange { path: None, field, from, to });
            }
        }
        for number in 1..=PATH_MAX {
            let words = |path| path_words(path, other.unit);
            let (from, to) = (words(&self.path(number)), words(&other.path(number)));
            let fields = from.into_iter().zip(to).filter(|((_, from), (_, to))| from != to);
            changes.extend(fields.map(|((field, from), (_, to))| PathChange {
                path: Some(number),
                field,
                from,
                to,
            }));
        }
        changes
    }

    /// Writes this table to a drive that has `drive` now, and reads it back. `store` also puts it into permanent
    /// memory. Paths that this table does not have stay as they are.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217` with the first finding that is an error: nothing was written. `E111` if the drive did
    /// not keep a value; others by source, after some writes.
    pub fn write(&self, axis: &Axis, drive: &Self, store: bool) -> Result<(), Error> {
        let names = PathNames::of(axis)?;
        let after = self.written_over(drive);
        if let Some(finding) = after.check().iter().find(|finding| finding.is_error) {
            let hint = "correct the file: nothing was written";
            return Err(Error::usage("E217", finding.to_string(), hint));
        }
        for step in self.write_steps(drive, names.has_whole_position) {
            let values: Vec<NamedValue> =
                step.into_iter().map(|(name, raw)| raw_value(name, raw)).collect();
            axis.interface().write_all(&values, store, &mut |_| ControlFlow::Continue(()))?;
        }
        self.read_back(axis, &names)
    }

    /// Raw values by name, in steps that are written one after the other, of a drive that has `drive` now. On CANopen a
    /// coordinate is two objects (`has_whole_position` false).
    #[must_use]
    pub fn write_steps(&self, drive: &Self, has_whole_position: bool) -> Vec<Vec<(String, i64)>> {
        let names = PathNames { has_whole_position };
        let (mut mechanics, mut steps) = (Vec::new(), Vec::new());
        for (name, now, wanted) in [
            (MOTOR_TURNS, drive.motor_turns, self.motor_turns),
            (TRAVEL, drive.travel, self.travel),
        ] {
            if now != wanted {
                mechanics.push((name.to_owned(), wanted.into()));
            }
        }
        steps.push(mechanics);
        for (number, path) in &self.paths {
            let now = drive.path(*number);
            if now == *path {
                continue;
            }
            let s_time = |ms: u16| vec![(PathNames::s_time(*number), ms.into())];
            // The drive refuses an S-time of half an acceleration time or more, whichever is written first. That of an
            // empty path was not read.
            if path.s_ms < now.s_ms || now.is_empty() {
                steps.push(s_time(if now.is_empty() { 0 } else { path.s_ms }));
            }
            steps.push(names.values(*number, path));
            if path.s_ms > now.s_ms {
                steps.push(s_time(path.s_ms));
            }
        }
        steps.retain(|step| !step.is_empty());
        steps
    }

    fn read_back(&self, axis: &Axis, names: &PathNames) -> Result<(), Error> {
        // A ratio that the drive did not keep would scale every position.
        for (field, wanted) in [(MOTOR_TURNS, self.motor_turns), (TRAVEL, self.travel)] {
            let kept = read_word(axis, field)?;
            if kept != wanted {
                return Err(not_kept(axis, &format!("{field} {kept}, not {wanted}")));
            }
        }
        for (number, path) in &self.paths {
            let kept = path_words(&names.read(axis, *number, &mut Vec::new())?, self.unit);
            let wanted = path_words(path, self.unit);
            let differs = kept.into_iter().zip(wanted).find(|(kept, wanted)| kept != wanted);
            if let Some(((field, kept), (_, wanted))) = differs {
                return Err(not_kept(
                    axis,
                    &format!("{field} {kept} of path {number}, not {wanted}"),
                ));
            }
        }
        Ok(())
    }

    fn travel_text(&self, unit: PathUnit) -> String {
        format!("{} {}", self.travel, unit.symbol())
    }
}

impl Default for PathTable {
    fn default() -> Self {
        Self::new()
    }
}

/// A path's fields in words, with their names.
#[must_use]
pub fn path_words(path: &PathDefinition, unit: PathUnit) -> [(&'static str, String); 10] {
    let end = end_word(path.end).replace('-', " ");
    let next = path.next.map_or_else(|| "none".to_owned(), |next| next.to_string());
    let interrupts = if path.interrupts { "yes" } else { "no" };
    [
        ("kind", kind_word(path.kind)),
        ("end", end),
        ("position", unit.format(path.thousandths)),
        ("speed", format!("{} rpm", path.rpm)),
        ("acceleration", format!("{} ms", path.acceleration_ms)),
        ("deceleration", format!("{} ms", path.deceleration_ms)),
        ("s-time", format!("{} ms", path.s_ms)),
        ("delay", format!("{} ms", path.delay_ms)),
        ("next", next),
        ("interrupts", interrupts.to_owned()),
    ]
}

/// Word of a type of path: `speed`, `single`, `auto`; `none` of an empty one.
#[must_use]
pub fn kind_word(kind: PathType) -> String {
    match (KINDS.iter().find(|(_, known)| *known == kind), kind) {
        (Some((word, _)), _) => (*word).to_owned(),
        (None, other) => format!("type {}", other.digit()),
    }
}

/// The type of path with that word.
#[must_use]
pub fn find_kind(word: &str) -> Option<PathType> {
    KINDS.iter().find(|(known, _)| *known == word).map(|(_, kind)| *kind)
}

/// Word of the end of a path: `absolute`, `from-last-end`, `from-here`.
#[must_use]
pub fn end_word(end: PathEnd) -> &'static str {
    ENDS.iter().find(|(_, known)| *known == end).map_or("", |(word, _)| word)
}

/// The end of a path with that word.
#[must_use]
pub fn find_end(word: &str) -> Option<PathEnd> {
    ENDS.iter().find(|(known, _)| *known == word).map(|(_, end)| *end)
}

/// Names of the parameters of paths.
struct PathNames {
    /// A coordinate is one parameter of two registers on Modbus, and two objects on CANopen.
    has_whole_position: bool,
}

impl PathNames {
    fn of(axis: &Axis) -> Result<Self, Error> {
        let has_whole_position = axis.find("path 1 position").is_ok();
        if !has_whole_position && axis.find("path 1 tens").is_err() {
            let what = format!("{}: a drive that stores no paths", axis.label());
            return Err(Error::usage("E218", what, "the SYNTRON TS has paths, with Fn_00 = 14"));
        }
        Ok(Self { has_whole_position })
    }

    fn s_time(number: u8) -> String {
        format!("path {number} s-time")
    }

    /// The names behind the coordinate, in the order of the registers.
    const REST: [&'static str; 4] = ["speed", "acceleration time", "deceleration time", "delay"];

    /// Reads a path. Digits that mean nothing are added to `defects`.
    fn read(
        &self,
        axis: &Axis,
        number: u8,
        defects: &mut Vec<PathFinding>,
    ) -> Result<PathDefinition, Error> {
        let word = |name: &str| read_word(axis, &format!("path {number} {name}"));
        let mut words = [0; 8];
        words[0] = word("definition 1")?;
        // Without a type nothing else counts, and most paths of a drive are never set.
        if words[0] == 0 {
            return Ok(PathDefinition::EMPTY);
        }
        for (slot, name) in words[3..].iter_mut().zip(Self::REST) {
            *slot = word(name)?;
        }
        words[7] = word("definition 2")?;
        for (name, raw) in [("definition 1", words[0]), ("definition 2", words[7])] {
            defects.extend(definition_defect(axis, number, name, raw));
        }
        let mut path = PathDefinition::decode(words, word("s-time")?);
        path.thousandths = if self.has_whole_position {
            let raw = axis.get_raw(&format!("path {number} position"))?;
            i32::try_from(raw).map_err(|_| unexpected_value("position", raw))?
        } else {
            let tens = axis.get_raw(&format!("path {number} tens"))?;
            let rest = axis.get_raw(&format!("path {number} thousandths"))?;
            let whole = i32::try_from(tens * 10_000 + rest);
            whole.map_err(|_| unexpected_value("position", tens))?
        };
        Ok(path)
    }

    /// Values of all parameters but the S-time.
    fn values(&self, number: u8, path: &PathDefinition) -> Vec<(String, i64)> {
        let [first, tens, rest, speed, acceleration, deceleration, delay, second] = path.encode();
        let named = |name: &str, raw| (format!("path {number} {name}"), raw);
        let mut values = vec![named("definition 1", first.into())];
        if self.has_whole_position {
            values.push(named("position", path.thousandths.into()));
        } else {
            values.push(named("tens", i64::from(tens as i16)));
            values.push(named("thousandths", i64::from(rest as i16)));
        }
        let words = [speed, acceleration, deceleration, delay];
        values.extend(Self::REST.iter().zip(words).map(|(name, word)| named(name, word.into())));
        values.push(named("definition 2", second.into()));
        values
    }
}

fn raw_value(name: String, raw: i64) -> NamedValue {
    NamedValue { name, value: WriteValue::Raw(raw) }
}

fn read_word(axis: &Axis, name: &str) -> Result<u16, Error> {
    let raw = axis.get_raw(name)?;
    u16::try_from(raw).map_err(|_| unexpected_value(name, raw))
}

fn unexpected_value(name: &str, raw: i64) -> Error {
    Error::usage("E217", format!("`{name}` is {raw}, which no path has"), "read it with `get`")
}

/// The error for a value that was accepted, and reads otherwise.
fn not_kept(axis: &Axis, what: &str) -> Error {
    Error::MotionEnded {
        code: "E111",
        what: format!("{}: the drive kept {what}", axis.label()),
        why: "It was written and accepted, but another value was read back.".to_owned(),
        hint: "compare the paths again: polepair paths diff URL FILE".to_owned(),
        exit: Exit::Negative,
    }
}

/// The finding for a definition word with a digit that means nothing.
fn definition_defect(axis: &Axis, number: u8, name: &str, raw: u16) -> Option<PathFinding> {
    let profile = crate::profile::find_shipped(&axis.facts().profile)?;
    let id = profile.find_parameter(&format!("path {number} {name}"))?;
    let defect = profile.parameter(id)?.digit_defect(raw.into())?;
    let text = format!("{name} is {raw}: {defect}");
    Some(PathFinding { path: Some(number), is_error: true, text })
}
