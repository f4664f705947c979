//! Tables of paths as TOML files: a line for each path.

use std::collections::BTreeMap;
use std::fmt::{self, Write as _};
use std::path::Path;

use polepair_core::units::Quantity;
use polepair_drives::stored_paths::{COORDINATE_MAX, PATH_MAX, PathDefinition, PathEnd, PathType};

use super::{ENDS, KINDS, PathTable, PathUnit, end_word, kind_word, path_words};
use crate::error::Error;
use crate::profile::read_text;
use crate::quantity::{self, Measure};
use crate::toml_file::{FILE_VERSION, FileError, Located, SourceText, TomlTable};

/// Keys of a path.
const PATH_KEYS: [&str; 10] = [
    "kind",
    "end",
    "position",
    "speed",
    "acceleration",
    "deceleration",
    "s_time",
    "delay",
    "next",
    "interrupts",
];
/// A coordinate is a whole number of thousandths; text of decimal numbers is not more exact than this.
const ROUNDING: f64 = 1e-3;

impl PathTable {
    /// Reads a file.
    ///
    /// # Errors
    /// [`Error::File`] with file, line, column and reason.
    pub fn load(file: &Path) -> Result<Self, Error> {
        Ok(Self::parse(&file.display().to_string(), &read_text(file)?)?)
    }

    /// Reads a text; `file` is its name in errors.
    ///
    /// # Errors
    /// [`FileError`] with line, column and reason.
    pub fn parse(file: &str, text: &str) -> Result<Self, FileError> {
        let known = ["motor_turns", "travel", "range", "paths"];
        SourceText::new(file, text).parse(&known, |node| {
            let mut table = Self::new();
            let turns = node.integer_between("motor_turns", 1, u16::MAX.into())?;
            table.motor_turns = turns.map_or(1, |turns| turns as u16);
            let travel = node.required_text("travel")?;
            (table.travel, table.unit) = travel.try_map(|text| parse_travel(&text))?;
            let range = node.texts("range")?;
            if node.has("range") {
                let [low, high] = &*range else {
                    let reason = r#"`range` is two positions, such as ["0 mm", "400 mm"]"#;
                    return Err(node.location().error(reason));
                };
                let coordinate =
                    |text: &Located<String>| text.clone().try_map(|it| table.coordinate(&it));
                table.range = Some((coordinate(low)?, coordinate(high)?));
            }
            let paths = node.table("paths", &[])?;
            let paths = paths.ok_or_else(|| FileError::for_file(file, "no [paths] in it"))?;
            table.paths = table.read_paths(&paths)?;
            Ok(table)
        })
    }

    /// Parses a position in the unit of the mechanics: thousandths of it.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217`.
    pub fn parse_position(&self, text: &str) -> Result<i32, Error> {
        self.coordinate(text).map_err(|what| Error::usage("E217", what, "such as 90deg or 12.5mm"))
    }

    fn read_paths(
        &self,
        paths: &TomlTable<'_, '_>,
    ) -> Result<BTreeMap<u8, PathDefinition>, FileError> {
        let rows = paths.keys().into_iter().map(|key| {
            let number = key.value.parse().ok().filter(|n| (1..=PATH_MAX).contains(n));
            let number = number.ok_or_else(|| {
                key.location.error(format!("`{}`: paths are numbered 1 to {PATH_MAX}", key.value))
            })?;
            let row = paths.table(key.value, &PATH_KEYS)?;
            let row = row.ok_or_else(|| key.location.error("a path is a table"))?;
            Ok((number, self.read_path(&row)?))
        });
        rows.collect()
    }

    fn read_path(&self, row: &TomlTable<'_, '_>) -> Result<PathDefinition, FileError> {
        let kind = choose(&row.required_text("kind")?, &KINDS[..3])?;
        let end = match row.text("end")? {
            Some(end) => choose(&end, &ENDS)?,
            // The sign of a speed's position is its direction; it has no end.
            None if kind == PathType::Speed => PathEnd::LastCommand,
            None => return Err(row.location().error("`end` is missing")),
        };
        let position = row.required_text("position")?;
        let next = row.integer_between("next", 1, PATH_MAX.into())?;
        Ok(PathDefinition {
            kind,
            next: next.map(|next| next as u8),
            end,
            interrupts: row.boolean("interrupts")?,
            thousandths: position.try_map(|text| self.coordinate(&text))?,
            rpm: row.required_text("speed")?.try_map(|text| parse_speed(&text))?,
            acceleration_ms: row.required_text("acceleration")?.try_map(|text| parse_ms(&text))?,
            deceleration_ms: row.required_text("deceleration")?.try_map(|text| parse_ms(&text))?,
            delay_ms: optional_ms(row, "delay")?,
            s_ms: optional_ms(row, "s_time")?,
        })
    }

    /// Parses a position in the unit of the mechanics, in thousandths.
    fn coordinate(&self, text: &str) -> Result<i32, String> {
        let value = in_unit(text, self.unit)?;
        self.thousandths(value).map_err(|what| format!("{text:?}: {what}"))
    }

    /// Thousandths of a position in the unit of the mechanics, as the drive counts.
    ///
    /// # Errors
    /// The reason why the drive has no such position, in words.
    pub fn thousandths(&self, position: f64) -> Result<i32, String> {
        let value = position * 1000.0;
        let whole = value.round();
        // NaN is in no range.
        if !(0.0..=f64::from(COORDINATE_MAX)).contains(&whole.abs()) {
            return Err(format!("the drive counts to {}", self.unit.format(COORDINATE_MAX)));
        }
        if (value - whole).abs() > ROUNDING {
            return Err(format!("the drive counts thousandths of a {}", self.unit.symbol()));
        }
        Ok(whole as i32)
    }
}

impl fmt::Display for PathTable {
    /// The table as a file.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = self.unit.symbol();
        f.write_str(
            "# `polepair paths check FILE` follows the chains, `polepair paths load URL FILE` \
             writes them.\n",
        )?;
        writeln!(f, "version = {FILE_VERSION}")?;
        writeln!(f, "motor_turns = {}  # Fn_205: in so many turns of the motor", self.motor_turns)?;
        writeln!(f, "travel = \"{} {unit}\"  # Fn_206: the mechanics move so far", self.travel)?;
        if let Some((low, high)) = self.range {
            let (low, high) = (self.unit.format(low), self.unit.format(high));
            writeln!(f, "range = [\"{low}\", \"{high}\"]")?;
        }
        f.write_str("\n[paths]\n")?;
        self.paths.iter().try_for_each(|(number, path)| self.write_row(f, *number, path))
    }
}

impl PathTable {
    fn write_row(
        &self,
        f: &mut fmt::Formatter<'_>,
        number: u8,
        path: &PathDefinition,
    ) -> fmt::Result {
        if matches!(path.kind, PathType::Unknown(_)) {
            let words = path_words(path, self.unit).map(|(name, word)| format!("{name} {word}"));
            return writeln!(f, "# {number} has no type: {}", words.join(", "));
        }
        let (kind, end) = (kind_word(path.kind), end_word(path.end));
        let position = self.unit.format(path.thousandths);
        let mut row = format!(
            "{number} = {{ kind = {kind:?}, end = {end:?}, position = {position:?}, speed = \"{} \
             rpm\", acceleration = \"{} ms\", deceleration = \"{} ms\"",
            path.rpm, path.acceleration_ms, path.deceleration_ms
        );
        for (key, ms) in [("s_time", path.s_ms), ("delay", path.delay_ms)] {
            if ms != 0 {
                write!(row, ", {key} = \"{ms} ms\"")?;
            }
        }
        if let Some(next) = path.next {
            write!(row, ", next = {next}")?;
        }
        if path.interrupts {
            row.push_str(", interrupts = true");
        }
        writeln!(f, "{row} }}")
    }
}

fn choose<T: Copy>(text: &Located<String>, choices: &[(&str, T)]) -> Result<T, FileError> {
    let found = choices.iter().find(|(word, _)| *word == text.value);
    found.map(|(_, value)| *value).ok_or_else(|| {
        let words: Vec<&str> = choices.iter().map(|(word, _)| *word).collect();
        text.location.error(format!("{:?} is none of {}", text.value, words.join(", ")))
    })
}

/// Parses the travel of the mechanics: a whole number of degrees or millimetres.
fn parse_travel(text: &str) -> Result<(u16, PathUnit), String> {
    let measure = quantity::parse(text).map_err(|error| error.sentence())?;
    let unit = if measure.linear { PathUnit::Millimetre } else { PathUnit::Degree };
    let value = value_in(text, measure, unit)?;
    let whole = value.round();
    if (value - whole).abs() > ROUNDING || !(1.0..=f64::from(u16::MAX)).contains(&whole) {
        let word = unit.symbol();
        return Err(format!("{text:?}: the drive counts whole {word}, 1 to 65535"));
    }
    Ok((whole as u16, unit))
}

fn in_unit(text: &str, unit: PathUnit) -> Result<f64, String> {
    let measure = quantity::parse(text).map_err(|error| error.sentence())?;
    value_in(text, measure, unit)
}

fn value_in(text: &str, measure: Measure, unit: PathUnit) -> Result<f64, String> {
    let is_linear = unit == PathUnit::Millimetre;
    if measure.quantity != Some(Quantity::Position) || measure.linear != is_linear {
        let wanted = unit.symbol();
        return Err(format!("{text:?}: a position has a unit, here {wanted}, as the travel has"));
    }
    Ok(match unit {
        PathUnit::Degree => measure.si.to_degrees(),
        PathUnit::Millimetre => measure.si * 1000.0,
    })
}

/// Parses a speed of the motor: whole revolutions per minute.
fn parse_speed(text: &str) -> Result<u16, String> {
    let measure = quantity::parse(text).map_err(|error| error.sentence())?;
    if measure.quantity != Some(Quantity::Velocity) || measure.linear {
        return Err(format!("{text:?}: a speed is that of the motor, such as \"300 rpm\""));
    }
    let rpm = measure.si * 60.0 / std::f64::consts::TAU;
    if rpm < 0.0 {
        return Err(format!("{text:?}: the sign of `position` is the direction"));
    }
    whole_word(text, rpm, "rpm")
}

fn parse_ms(text: &str) -> Result<u16, String> {
    let measure = quantity::parse(text).map_err(|error| error.sentence())?;
    if measure.quantity != Some(Quantity::Time) {
        return Err(format!("{text:?}: a time has a unit, such as \"200 ms\""));
    }
    whole_word(text, measure.si * 1000.0, "ms")
}

fn optional_ms(row: &TomlTable<'_, '_>, key: &str) -> Result<u16, FileError> {
    row.text(key)?.map_or(Ok(0), |text| text.try_map(|text| parse_ms(&text)))
}

fn whole_word(text: &str, value: f64, unit: &str) -> Result<u16, String> {
    let whole = value.round();
    if (value - whole).abs() > ROUNDING || !(0.0..=f64::from(u16::MAX)).contains(&whole) {
        return Err(format!("{text:?}: the drive counts whole {unit}, 0 to 65535"));
    }
    Ok(whole as u16)
}
