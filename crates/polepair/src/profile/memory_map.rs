//! Memory map of a set-up archive: one `TYPE NAME @0xADDR [unit]` a line.
//!
//! The map is complete for its firmware. Known parameters keep their texts and get its addresses and types.
//! Other names get no text. Parameters that the map does not name do not exist.

use super::draft::{Draft, DraftParameter, ENTRIES_MAX};
use super::missing_parameters::remove_missing;
use crate::spelling::fold;
use crate::toml_file::{FileError, FileLocation, Located};
use polepair_core::profile::{Access, Certainty, Encoding, Persistence};
use polepair_core::units::Unit;
use std::collections::{HashMap, HashSet};

/// Variable with which speeds and positions are computed.
const COUNTS_PER_TURN: &str = "ENCRESLONG";

/// Types for which the drive has instructions.
const TYPES: [(&str, Encoding); 5] = [
    ("INT", Encoding::I16),
    ("UINT", Encoding::U16),
    ("LONG", Encoding::I32),
    ("ULONG", Encoding::U32),
    ("FIXED", Encoding::Fixed),
];

/// Types that a map may name and no instruction reaches.
const UNSUPPORTED_TYPES: [&str; 2] = ["FLOAT", "DOUBLE"];

/// One name of a map.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct MapEntry<'a> {
    pub(crate) name: &'a str,
    pub(crate) address: u16,
    pub(crate) encoding: Encoding,
    /// The unit in which the vendor's tools show it: `[rot]`; empty for none.
    pub(crate) unit: &'a str,
}

/// Makes the draft's parameters those of the map.
pub(crate) fn apply_map(draft: &mut Draft, map: &Located<String>) -> Result<(), FileError> {
    let entries = parse_entries(&map.value, true).map_err(|reason| map.location.error(reason))?;
    apply_entries(draft, entries, &map.location);
    Ok(())
}

/// [`apply_map`] with names that are read already.
pub(crate) fn apply_entries(
    draft: &mut Draft,
    entries: Vec<MapEntry<'_>>,
    location: &FileLocation,
) {
    let known = draft.parameters.drain(..).map(|p| (fold(symbol_or_name(&p)), p));
    let mut known: HashMap<String, DraftParameter> = known.collect();
    let mut parameters = Vec::with_capacity(entries.len());
    for entry in entries {
        parameters.push(match known.remove(&fold(entry.name)) {
            Some(parameter) => relocated(parameter, &entry),
            None => undescribed(&entry, location),
        });
    }
    // Before the others are removed, which are found by name.
    rename_clashing(&mut parameters);
    draft.parameters = parameters;
    remove_missing(draft);
}

/// A map may call a variable as a described one is called in words: `Position_Error` beside `POSERR`,
/// which is the position error. At the same address it is that one's second name and left out, else its
/// address makes its name another.
fn rename_clashing(parameters: &mut Vec<DraftParameter>) {
    let described = parameters.iter().filter(|p| is_described_parameter(p));
    let words: HashMap<String, u16> = described.map(|p| (fold(&p.name), p.index)).collect();
    parameters.retain_mut(|p| {
        let clash = words.get(&fold(&p.name)).filter(|_| !is_described_parameter(p));
        let Some(index) = clash else { return true };
        // The same variable under its readable name.
        if *index == p.index {
            return false;
        }
        p.name = format!("{}@0x{:04X}", p.name, p.index);
        p.symbol.clone_from(&p.name);
        true
    });
}

fn is_described_parameter(p: &DraftParameter) -> bool {
    p.name != p.symbol
}

/// The vendor's word for a type.
pub(crate) fn type_word(encoding: Encoding) -> &'static str {
    TYPES.iter().find(|(_, known)| *known == encoding).map_or("INT", |(word, _)| word)
}

fn symbol_or_name(p: &DraftParameter) -> &str {
    if p.symbol.is_empty() { &p.name } else { &p.symbol }
}

/// The names of a map; what lies outside the address space or has a foreign type is left out. Lines
/// that make no sense are errors in a `strict` map, which people write; in a tool's they are left
/// out as well, as is a name's second line.
pub(crate) fn parse_entries(text: &str, strict: bool) -> Result<Vec<MapEntry<'_>>, String> {
    let mut entries: Vec<MapEntry<'_>> = Vec::new();
    let mut names = HashSet::new();
    for (at, line) in text.lines().enumerate() {
        let line = line.split_once('#').map_or(line, |(text, _)| text).trim();
        if line.is_empty() {
            continue;
        }
        match parse_entry(line) {
            Ok(entry) => {
                entries.extend(entry.filter(|entry| strict || names.insert(fold(entry.name))));
            }
            Err(reason) if strict => return Err(format!("map, line {}: {reason}", at + 1)),
            // A firmware of a later year may have types that are unknown here; the rest of its map is good.
            Err(_) => {}
        }
        if entries.len() > ENTRIES_MAX {
            return Err(format!("the map has more than {ENTRIES_MAX} names"));
        }
    }
    Ok(entries)
}

fn parse_entry(line: &str) -> Result<Option<MapEntry<'_>>, String> {
    let mut words = line.split_whitespace();
    let kind = words.next().unwrap_or("");
    let name = words.next().ok_or("a name is missing behind the type")?;
    if !name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        || name.starts_with(|c: char| c.is_ascii_digit())
    {
        return Err(format!("`{name}` is no name"));
    }
    let address = words.next().and_then(|word| word.strip_prefix("@0x"));
    let address = address.and_then(|digits| u32::from_str_radix(digits, 16).ok());
    let address = address.ok_or_else(|| format!("`{name}` needs an address: @0x0228"))?;
    let unit = words.find(|word| word.starts_with('[')).unwrap_or("");
    if UNSUPPORTED_TYPES.contains(&kind) {
        return Ok(None);
    }
    let known = TYPES.iter().find(|(word, _)| *word == kind);
    let (_, encoding) = known.ok_or_else(|| format!("`{kind}` is no type"))?;
    let address = u16::try_from(address).ok();
    Ok(address.map(|address| MapEntry { name, address, encoding: *encoding, unit }))
}

/// A known parameter where this map has it.
fn relocated(mut p: DraftParameter, entry: &MapEntry<'_>) -> DraftParameter {
    p.index = entry.address;
    if p.encoding != entry.encoding {
        p.encoding = entry.encoding;
        (p.min, p.max) = entry.encoding.raw_range();
    }
    p
}

/// A parameter of which only the map's line is known.
fn undescribed(entry: &MapEntry<'_>, position: &FileLocation) -> DraftParameter {
    let (min, max) = entry.encoding.raw_range();
    let (unit, factor, per_turn) = unit_and_factor(entry);
    DraftParameter {
        location: position.clone(),
        name: entry.name.into(),
        symbol: entry.name.into(),
        about: String::new(),
        space: 0,
        index: entry.address,
        encoding: entry.encoding,
        unit,
        factor,
        negative: None,
        times: None,
        over: per_turn
            .then(|| Located { value: COUNTS_PER_TURN.to_owned(), location: position.clone() }),
        rule: None,
        min,
        max,
        default: None,
        access: Access::ReadWrite,
        persistence: Persistence::Volatile,
        certainty: Certainty::Inferred,
        moves: true,
        section: String::new(),
        values: Vec::new(),
        digits: Vec::new(),
        bits: Vec::new(),
    }
}

/// Unit, factor, and whether it is divided by the counts of a turn. Speeds count slow loops of 1 ms,
/// the drives' default; currents and voltages depend on the drive's size, so they stay raw.
fn unit_and_factor(entry: &MapEntry<'_>) -> (Unit, f64, bool) {
    let fixed = entry.encoding == Encoding::Fixed;
    let fraction = if fixed { 1.0 / 65536.0 } else { 1.0 };
    match entry.unit {
        "[rot]" => (Unit::Turn, 1.0, true),
        "[rpm]" => (Unit::Rpm, 60e3 * fraction, true),
        "[rad/s^2]" => (Unit::RpmPerSecond, 60e6 * fraction, true),
        "[s]" => (Unit::Second, 0.001, false),
        _ => (Unit::None, fraction, false),
    }
}
