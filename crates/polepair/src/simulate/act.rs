//! Acts on a simulated drive as text: `jam`, `supply=30 V`, `input-3=1`.

use polepair_drives::surroundings::Act;

use crate::error::Error;
use crate::spelling;

/// One kind of act.
#[derive(Clone, Copy, Debug)]
pub struct ActKind {
    /// Name of the act; `N` at the end is a number.
    pub word: &'static str,
    /// Effect of the act, in a sentence.
    pub about: &'static str,
    /// Kind of its value.
    pub value: ActValue,
    make: fn(u8, f64) -> Act,
}

/// Kind of an act's value.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ActValue {
    /// The act has no value.
    None,
    /// 1 or 0, `on` or `off`; 1 where it is left out.
    Flag,
    /// A number without a unit.
    Number,
    /// A number in this unit, or in one of its others.
    Quantity(&'static str),
    /// A shaft position in rad, or `none`.
    Place,
}

impl ActValue {
    /// The unit of the value; empty where it has none, `None` where there is no value.
    #[must_use]
    pub const fn unit(self) -> Option<&'static str> {
        match self {
            Self::None => None,
            Self::Flag | Self::Number => Some(""),
            Self::Quantity(unit) => Some(unit),
            Self::Place => Some("rad"),
        }
    }
}

const fn kind(
    word: &'static str,
    value: ActValue,
    make: fn(u8, f64) -> Act,
    about: &'static str,
) -> ActKind {
    ActKind { word, about, value, make }
}

const NEWTON_METRE: ActValue = ActValue::Quantity("N·m");
const VOLT: ActValue = ActValue::Quantity("V");
const CELSIUS: ActValue = ActValue::Quantity("°C");

/// All acts. A drive without an act refuses it.
pub const ACTS: &[ActKind] = &[
    kind(
        "load",
        NEWTON_METRE,
        |_, value| Act::Load(value),
        "A constant torque on the shaft; negative brakes forward motion",
    ),
    kind(
        "jam",
        ActValue::Flag,
        |_, value| Act::Jam(value != 0.0),
        "Holds the shaft still (1), or lets it go (0)",
    ),
    kind("supply", VOLT, |_, value| Act::Supply(value), "The supply voltage"),
    kind("ambient", CELSIUS, |_, value| Act::Ambient(value), "The air's temperature"),
    kind(
        "temperature",
        CELSIUS,
        |_, value| Act::Temperature(value),
        "Makes motor and power stage so warm at once",
    ),
    kind(
        "encoder",
        ActValue::Flag,
        |_, value| Act::EncoderBroken(value != 0.0),
        "The encoder stops counting (1), or counts again (0)",
    ),
    kind(
        "hall",
        ActValue::Flag,
        |_, value| Act::HallBroken(value != 0.0),
        "The hall sensors give nonsense (1), or work again (0)",
    ),
    kind(
        "eeprom",
        ActValue::Flag,
        |_, value| Act::EepromDamaged(value != 0.0),
        "Damages the settings in permanent memory (1), or mends them (0)",
    ),
    kind(
        "sto",
        ActValue::Flag,
        |_, value| Act::Sto(value != 0.0),
        "Requests safe torque off (1), or no longer (0)",
    ),
    kind(
        "fault",
        ActValue::Number,
        |_, value| Act::Fault(value as u32),
        "Raises the fault of that code",
    ),
    kind(
        "power-cycle",
        ActValue::None,
        |_, _| Act::PowerCycle,
        "Takes the supply away and brings it back",
    ),
    kind(
        "home",
        ActValue::Place,
        |_, at| Act::Switch { which: 0, at },
        "Where the home switch closes",
    ),
    kind(
        "home-until",
        ActValue::Place,
        |_, at| Act::Switch { which: 3, at },
        "Where the home switch opens again, going forward (CiA 402)",
    ),
    kind(
        "limit-high",
        ActValue::Place,
        |_, at| Act::Switch { which: 1, at },
        "Where the positive limit switch closes",
    ),
    kind(
        "limit-low",
        ActValue::Place,
        |_, at| Act::Switch { which: 2, at },
        "Where the negative limit switch closes",
    ),
    kind(
        "pulses",
        ActValue::Number,
        |_, value| Act::Pulses(value as i32),
        "Pulses on the pulse input; negative ones turn backward",
    ),
    kind(
        "input-N",
        ActValue::Flag,
        |n, value| Act::Input(n, value != 0.0),
        "Digital input N, from 1, goes high (1) or low (0)",
    ),
    kind("analog-N", VOLT, Act::Analog, "The voltage at analogue input N, from 0"),
    kind(
        "key-N",
        ActValue::Flag,
        |n, value| Act::Key(n, value != 0.0),
        "Holds key N of the front panel, from 0 (1), or lets it go (0)",
    ),
];

/// Other spellings that callers of earlier versions use.
const ALIASES: [(&str, &str); 5] = [
    ("encoder-broken", "encoder"),
    ("hall-broken", "hall"),
    ("home-switch", "home"),
    ("positive-switch", "limit-high"),
    ("negative-switch", "limit-low"),
];

/// Units by their text, with the factor to the act's own.
const UNITS: [(&str, &str, f64); 12] = [
    ("N·m", "nm", 1.0),
    ("N·m", "n·m", 1.0),
    ("N·m", "mnm", 0.001),
    ("V", "v", 1.0),
    ("V", "mv", 0.001),
    ("°C", "°c", 1.0),
    ("°C", "degc", 1.0),
    ("°C", "c", 1.0),
    ("rad", "rad", 1.0),
    ("rad", "deg", core::f64::consts::PI / 180.0),
    ("rad", "turn", core::f64::consts::TAU),
    ("rad", "turns", core::f64::consts::TAU),
];

/// Reads an act: `jam`, `supply=30 V`, `home=90 deg`, `input-3=1`, `fault=0x2310`.
///
/// ```
/// use polepair::simulate::parse_act;
/// use polepair_drives::surroundings::Act;
/// assert_eq!(parse_act("supply = 30 V")?, Act::Supply(30.0));
/// assert_eq!(parse_act("jam")?, Act::Jam(true));
/// assert_eq!(parse_act("input-3=off")?, Act::Input(3, false));
/// assert!(parse_act("supply").is_err());
/// # Ok::<(), polepair::Error>(())
/// ```
///
/// # Errors
/// [`Error::Usage`] `E217`: the word, or its value.
pub fn parse_act(text: &str) -> Result<Act, Error> {
    let (word, value) = parse_act_value(text)?;
    act_of_value(&word, Some(value))
}

/// Reads an act as its word and its value in the act's own unit; 0 where it takes none, NaN for a
/// place that is `none`.
///
/// # Errors
/// As [`parse_act`].
pub fn parse_act_value(text: &str) -> Result<(String, f64), Error> {
    let (word, value) = match text.split_once('=') {
        Some((word, value)) => (word.trim(), Some(value.trim())),
        None => (text.trim(), None),
    };
    let (kind, _) = find_act(word)?;
    let value = match (kind.value, value) {
        (ActValue::None, None) => 0.0,
        (ActValue::Flag, None) => 1.0,
        (ActValue::None, Some(_)) => return Err(wrong_value(word, "it takes no value")),
        (_, None) => {
            return Err(wrong_value(word, &format!("write {word}={}", example(kind.value))));
        }
        (wanted, Some(value)) => parse_value(wanted, value).ok_or_else(|| {
            wrong_value(word, &format!("`{value}` is no value of it: write {}", example(wanted)))
        })?,
    };
    Ok((word.to_owned(), value))
}

/// The act of a word with this value; `None` where it is left out.
///
/// # Errors
/// As [`parse_act`].
pub fn act_of_value(word: &str, value: Option<f64>) -> Result<Act, Error> {
    let (kind, number) = find_act(word)?;
    let value = match (kind.value, value) {
        (ActValue::None, _) => 0.0,
        (ActValue::Flag, None) => 1.0,
        (_, None) => return Err(wrong_value(word, "it takes a value")),
        (ActValue::Place, Some(value)) if !value.is_infinite() => value,
        (_, Some(value)) if value.is_finite() => value,
        _ => return Err(wrong_value(word, "a value is a finite number")),
    };
    Ok((kind.make)(number, value))
}

fn find_act(word: &str) -> Result<(&'static ActKind, u8), Error> {
    let plain = word.to_ascii_lowercase().replace(['_', ' '], "-");
    let known = ALIASES.iter().find(|(alias, _)| *alias == plain).map_or(&*plain, |(_, word)| word);
    let found = ACTS.iter().find_map(|kind| match kind.word.strip_suffix('N') {
        None => (kind.word == known).then_some((kind, 0)),
        Some(prefix) => Some((kind, known.strip_prefix(prefix)?.parse().ok()?)),
    });
    found.ok_or_else(|| {
        let words = ACTS.iter().map(|kind| kind.word);
        let near = spelling::suggestion(&plain, words.clone());
        let what = format!("`{word}` is nothing that can be done to a simulated drive{near}");
        let all: Vec<&str> = words.collect();
        Error::usage("E217", what, format!("there is {}", all.join(", ")))
    })
}

fn wrong_value(word: &str, hint: &str) -> Error {
    Error::usage("E217", format!("the value of `{word}` is missing or wrong"), hint.to_owned())
}

const fn example(value: ActValue) -> &'static str {
    match value {
        ActValue::None => "nothing behind it",
        ActValue::Flag => "1 or 0",
        ActValue::Number => "a number",
        ActValue::Quantity(unit) => unit_example(unit),
        ActValue::Place => "\"90 deg\" or none",
    }
}

const fn unit_example(unit: &str) -> &'static str {
    match unit.len() {
        1 => "\"30 V\"",
        3 => "\"90 degC\"",
        _ => "\"0.2 Nm\"",
    }
}

fn parse_value(wanted: ActValue, text: &str) -> Option<f64> {
    match wanted {
        ActValue::None => None,
        ActValue::Flag => match text.to_ascii_lowercase().as_str() {
            "1" | "on" | "true" => Some(1.0),
            "0" | "off" | "false" => Some(0.0),
            _ => None,
        },
        ActValue::Number => parse_number(text),
        ActValue::Place if text.eq_ignore_ascii_case("none") => Some(f64::NAN),
        ActValue::Place => parse_quantity("rad", text),
        ActValue::Quantity(unit) => parse_quantity(unit, text),
    }
}

fn parse_number(text: &str) -> Option<f64> {
    match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) => u32::from_str_radix(digits, 16).ok().map(f64::from),
        None => text.parse().ok().filter(|value: &f64| value.is_finite()),
    }
}

fn parse_quantity(unit: &str, text: &str) -> Option<f64> {
    let split = text.find(|c: char| c.is_alphabetic() || c == '°').unwrap_or(text.len());
    // The exponent of 1e-3 is no unit.
    let (number, suffix) = match parse_number(text) {
        Some(number) => return Some(number),
        None => text.split_at(split),
    };
    let suffix = suffix.trim().to_lowercase();
    let known = UNITS.iter().find(|(of, word, _)| *of == unit && *word == suffix);
    Some(parse_number(number.trim())? * known?.2)
}
