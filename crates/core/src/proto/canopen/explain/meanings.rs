//! Meanings of numbers, as comments after the text of a frame.

use core::fmt::{self, Write};

use super::names;
use crate::explain::{ByteOrder, ExplainSink, NumberPlace};
use crate::profile::{Encoding, Parameter, Profile};
use crate::proto::canopen::cia402::{ControlCommand, DriveState, OperationMode};
use crate::proto::canopen::emcy::class_text;
use crate::proto::canopen::pdo::{CobId, MappingEntry, Transmission};
use crate::proto::canopen::sdo::{AbortCode, ExpeditedData, ObjectIndex};

/// Formats into a sink's text.
pub(super) struct SinkWriter<'a>(pub &'a mut dyn ExplainSink);

impl Write for SinkWriter<'_> {
    fn write_str(&mut self, piece: &str) -> fmt::Result {
        self.0.text(piece);
        Ok(())
    }
}

/// The profile, if it is one of this protocol's.
#[must_use]
pub fn canopen_profile(profile: Option<&'static Profile>) -> Option<&'static Profile> {
    profile.filter(|profile| profile.protocol == "canopen")
}

/// The profile's parameter that an object is.
#[must_use]
pub fn find_parameter(
    object: ObjectIndex,
    profile: Option<&'static Profile>,
) -> Option<&'static Parameter> {
    canopen_profile(profile)?
        .parameters
        .iter()
        .find(|p| (p.index, p.space) == (object.index, object.sub))
}

/// Name of an object; empty if it has none.
#[must_use]
pub fn object_name(object: ObjectIndex, profile: Option<&'static Profile>) -> &'static str {
    let named = find_parameter(object, profile).map(|parameter| parameter.name);
    named.or_else(|| names::standard_name(object).map(|(name, _)| name)).unwrap_or("")
}

/// Returns whether an object's values are signed.
#[must_use]
pub fn is_signed(object: ObjectIndex, profile: Option<&'static Profile>) -> bool {
    match find_parameter(object, profile) {
        Some(parameter) => parameter.encoding.is_signed(),
        None => names::standard_name(object).is_some_and(|(_, signed)| signed),
    }
}

/// Number of bytes of the value, where the command states `len` (0: not stated). The command's size decides,
/// except for a command of a drive that is known to have more (TS manual, chapter 3: printed sizes are too
/// small).
#[must_use]
pub fn value_len(object: ObjectIndex, bits: u32, len: u8, profile: Option<&'static Profile>) -> u8 {
    if !matches!(len, 1..=3) {
        return 4;
    }
    let width = match find_parameter(object, profile).map(|parameter| parameter.encoding) {
        Some(Encoding::Bit | Encoding::U8 | Encoding::I8) => 1,
        Some(Encoding::U16 | Encoding::I16) => 2,
        Some(_) => 4,
        None => standard_width(object),
    };
    if bits >> (8 * len) != 0 { len.max(width) } else { len }
}

/// Bytes of objects whose width the standards give (CiA 301, 7.5.2; CiA 402-2); 0 of others.
const fn standard_width(object: ObjectIndex) -> u8 {
    match (object.index, object.sub) {
        (0x1400..=0x15FF | 0x1800..=0x19FF, 3 | 5) | (0x6040 | 0x6041 | 0x6071..=0x6074, 0) => 2,
        (0x1400..=0x15FF | 0x1800..=0x19FF, 1)
        | (0x6062..=0x6065 | 0x6067 | 0x607A | 0x607C | 0x6081..=0x6085 | 0x6087 | 0x60FF, 0)
        | (0x608F..=0x6097 | 0x6099, 1 | 2) => 4,
        _ => 0,
    }
}

/// Returns whether a value of `len` bytes is only a part of the controlword or the statusword, which shows no state: a
/// device that answers so has another object there.
#[must_use]
pub const fn is_part_of_word(object: ObjectIndex, len: u8) -> bool {
    matches!((object.index, object.sub), (0x6040 | 0x6041, 0)) && len == 1
}

/// `bits` as the object's value.
#[must_use]
pub fn decode_number(
    object: ObjectIndex,
    bits: u32,
    len: u8,
    profile: Option<&'static Profile>,
) -> i64 {
    let rest = 32 - 8 * u32::from(value_len(object, bits, len, profile));
    if is_signed(object, profile) {
        ((bits << rest).cast_signed() >> rest).into()
    } else {
        ((bits << rest) >> rest).into()
    }
}

/// The place of an expedited value in its frame, where the value is a number that has the same words around it whatever
/// it is.
#[must_use]
pub(super) fn number_place(
    object: ObjectIndex,
    short: ExpeditedData,
    profile: Option<&'static Profile>,
) -> Option<NumberPlace> {
    let is_wide = short.len < 4 && short.bits >> (8 * short.len) != 0;
    let parameter = find_parameter(object, profile);
    let is_real = parameter.is_some_and(|parameter| parameter.encoding.is_real());
    let is_number = matches!(short.len, 1..=4) && !is_wide && !is_real;
    (is_number && has_constant_meaning(object, profile)).then(|| NumberPlace {
        order: ByteOrder::LowFirst,
        is_signed: is_signed(object, profile),
        ..NumberPlace::unsigned(4, short.len)
    })
}

/// An object's name and value.
///
/// # Errors
/// Those of `out`.
pub fn write_value(
    object: ObjectIndex,
    raw: i64,
    profile: Option<&'static Profile>,
    out: &mut dyn Write,
) -> fmt::Result {
    write_label(object, profile, out)?;
    match find_parameter(object, profile).map(|parameter| parameter.encoding) {
        Some(Encoding::F32) => write!(out, "{}", f32::from_bits(raw as u32))?,
        Some(encoding) if encoding.is_real() => write!(out, "{}", encoding.number(raw))?,
        _ => write!(out, "{raw}")?,
    }
    write_meaning(object, raw, profile, out)
}

/// Writes the label before an object's value.
///
/// # Errors
/// Those of `out`.
pub fn write_label(
    object: ObjectIndex,
    profile: Option<&'static Profile>,
    out: &mut dyn Write,
) -> fmt::Result {
    let symbol = find_parameter(object, profile).map_or("", |parameter| parameter.symbol);
    if symbol.starts_with(|c: char| c.is_ascii_alphabetic()) {
        write!(out, "{symbol} ")?;
    }
    match object_name(object, profile) {
        "" => Ok(()),
        name => write!(out, "{name} = "),
    }
}

/// Writes the meaning after an object's value.
///
/// # Errors
/// Those of `out`.
pub fn write_meaning(
    object: ObjectIndex,
    raw: i64,
    profile: Option<&'static Profile>,
    out: &mut dyn Write,
) -> fmt::Result {
    let known = find_parameter(object, profile);
    if let Some((_, word)) = known.and_then(|p| p.values.iter().find(|(value, _)| *value == raw)) {
        return write!(out, ", {word}");
    }
    if let Some(parameter) = known {
        write_scaled(parameter, raw, out)?;
    }
    write_standard_meaning(object, raw, profile, out)
}

/// Returns whether an object's values all have the same meaning.
#[must_use]
pub fn has_constant_meaning(object: ObjectIndex, profile: Option<&'static Profile>) -> bool {
    let steady =
        |p: &Parameter| p.values.is_empty() && (p.scale.factor == 1.0 || !has_fixed_scale(p));
    meaning_kind(object).is_none() && find_parameter(object, profile).is_none_or(steady)
}

/// Returns whether a value can be shown in its unit: not where that depends on other parameters.
fn has_fixed_scale(parameter: &Parameter) -> bool {
    !parameter.unit.symbol().is_empty() && parameter.scale.is_constant()
}

/// The value in its unit, where that is not the number itself.
fn write_scaled(parameter: &Parameter, raw: i64, out: &mut dyn Write) -> fmt::Result {
    let (scale, unit) = (&parameter.scale, parameter.unit.symbol());
    if !has_fixed_scale(parameter) {
        return Ok(());
    }
    if scale.factor == 1.0 {
        return write!(out, " {unit}");
    }
    let value = libm::round(parameter.encoding.number(raw) * scale.factor * 1000.0) / 1000.0;
    write!(out, ", {value} {unit}")
}

/// Objects whose numbers the standards have words for.
enum MeaningKind {
    Controlword,
    Statusword,
    Mode,
    Fault,
    Save,
    Load,
    Identifier,
    Transmission,
    Mapping,
}

const fn meaning_kind(object: ObjectIndex) -> Option<MeaningKind> {
    Some(match (object.index, object.sub) {
        (0x6040, 0) => MeaningKind::Controlword,
        (0x6041, 0) => MeaningKind::Statusword,
        (0x6060 | 0x6061, 0) => MeaningKind::Mode,
        (0x603F, 0) => MeaningKind::Fault,
        (0x1010, 1..) => MeaningKind::Save,
        (0x1011, 1..) => MeaningKind::Load,
        (0x1005 | 0x1012 | 0x1014, 0) | (0x1400..=0x15FF | 0x1800..=0x19FF, 1) => {
            MeaningKind::Identifier
        }
        (0x1400..=0x15FF | 0x1800..=0x19FF, 2) => MeaningKind::Transmission,
        (0x1600..=0x17FF | 0x1A00..=0x1BFF, 1..) => MeaningKind::Mapping,
        _ => return None,
    })
}

/// Writes the standards' meaning of a value.
fn write_standard_meaning(
    object: ObjectIndex,
    raw: i64,
    profile: Option<&'static Profile>,
    out: &mut dyn Write,
) -> fmt::Result {
    let Some(sort) = meaning_kind(object) else { return Ok(()) };
    match sort {
        MeaningKind::Controlword => {
            write!(out, ", ").and_then(|()| write_controlword(raw as u16, out))
        }
        MeaningKind::Statusword => {
            write!(out, ", ").and_then(|()| write_statusword(raw as u16, out))
        }
        MeaningKind::Mode => write!(out, ", {}", mode_name(OperationMode::from(raw as i8))),
        MeaningKind::Fault => write!(out, ", {}", fault_text(raw as u16, profile)),
        MeaningKind::Save if raw == 0x6576_6173 => out.write_str(", the word save"),
        MeaningKind::Load if raw == 0x6461_6F6C => out.write_str(", the word load"),
        MeaningKind::Save | MeaningKind::Load => Ok(()),
        MeaningKind::Identifier => {
            let cob = CobId(raw as u32);
            let off = if cob.is_valid() { "" } else { ", switched off" };
            write!(out, ", identifier {:03X}{off}", cob.id())
        }
        MeaningKind::Transmission => {
            out.write_str(", ")?;
            write_transmission(Transmission::from(raw as u8), out)
        }
        MeaningKind::Mapping => write_mapping(MappingEntry::from(raw as u32), profile, out),
    }
}

fn write_mapping(
    entry: MappingEntry,
    profile: Option<&'static Profile>,
    out: &mut dyn Write,
) -> fmt::Result {
    let MappingEntry { object, bits } = entry;
    write!(out, ", maps 0x{:04X}:{} in {bits} bits", object.index, object.sub)?;
    match object_name(object, profile) {
        "" => Ok(()),
        name => write!(out, ", {name}"),
    }
}

fn write_transmission(transmission: Transmission, out: &mut dyn Write) -> fmt::Result {
    match transmission {
        Transmission::OnChange => out.write_str("with SYNC after a change"),
        Transmission::Cyclic(1) => out.write_str("with every SYNC"),
        Transmission::Cyclic(count) => write!(out, "with every {count}th SYNC"),
        Transmission::SampledOnRequest => out.write_str("sampled at SYNC, sent on request"),
        Transmission::OnRequest => out.write_str("on request"),
        Transmission::Manufacturer => out.write_str("by the maker's events and by time"),
        Transmission::Profile => out.write_str("by the profile's events"),
        Transmission::Reserved(_) => out.write_str("reserved"),
    }
}

/// Command of a controlword in bits 0 to 3 and 7, and its other set bits.
pub(super) fn write_controlword(word: u16, out: &mut dyn Write) -> fmt::Result {
    out.write_str(ControlCommand::of(word).name())?;
    write_other_bits(word, &CONTROL_BITS, out)
}

/// State of a statusword, and its other set bits.
pub(super) fn write_statusword(word: u16, out: &mut dyn Write) -> fmt::Result {
    out.write_str(DriveState::of(word).name())?;
    write_other_bits(word, &STATUS_BITS, out)
}

/// Bits of the controlword that are no part of the order; 4 to 6 by the mode.
pub(super) const CONTROL_BITS: [(u8, &str); 5] = [
    (4, "bit 4 (new set-point, start of homing)"),
    (5, "bit 5 (at once)"),
    (6, "bit 6 (relative)"),
    (8, "halt"),
    (9, "bit 9 (on set-point)"),
];

/// Bits of the statusword that are no part of the state; 12 and 13 by the mode.
pub(super) const STATUS_BITS: [(u8, &str); 5] =
    [(7, "warning"), (10, "target reached"), (11, "internal limit"), (12, BIT_12), (13, BIT_13)];
const BIT_12: &str = "bit 12 (set-point taken, homing attained, speed zero)";
const BIT_13: &str = "bit 13 (following error, homing error)";

/// Names of the statusword's bits 12 and 13 in a remark, where no mode is known, and in this mode (CiA 402-2: the
/// statusword of each mode).
#[must_use]
pub const fn status_bits_by_mode(mode: OperationMode) -> [(&'static str, &'static str); 2] {
    let (twelve, thirteen) = match mode {
        OperationMode::ProfilePosition => ("set-point taken", "following error"),
        OperationMode::ProfileVelocity => ("speed zero", "greatest slippage reached"),
        OperationMode::Homing => ("homing attained", "homing error"),
        OperationMode::Interpolated => ("interpolation active", "bit 13"),
        OperationMode::CyclicPosition => ("drive follows the command value", "following error"),
        OperationMode::CyclicVelocity | OperationMode::CyclicTorque => {
            ("drive follows the command value", "bit 13")
        }
        OperationMode::Velocity | OperationMode::ProfileTorque => ("bit 12", "bit 13"),
        OperationMode::None | OperationMode::Other(_) => (REMARK_12, REMARK_13),
    };
    [(REMARK_12, twelve), (REMARK_13, thirteen)]
}

/// The names as remarks have them, without parentheses.
const REMARK_12: &str = "bit 12 set-point taken, homing attained, speed zero";
const REMARK_13: &str = "bit 13 following error, homing error";

fn write_other_bits(word: u16, bits: &[(u8, &str)], out: &mut dyn Write) -> fmt::Result {
    let mut set = bits.iter().filter(|(bit, _)| word >> bit & 1 == 1);
    set.try_for_each(|(_, name)| write!(out, ", {}", WithoutParentheses(name)))
}

/// A name without parentheses, which would end a remark.
struct WithoutParentheses<'a>(&'a str);

impl fmt::Display for WithoutParentheses<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.chars().filter(|c| !matches!(c, '(' | ')')).try_for_each(|c| f.write_char(c))
    }
}

/// The standard's word for a mode.
#[must_use]
pub const fn mode_name(mode: OperationMode) -> &'static str {
    match mode {
        OperationMode::None => "none",
        OperationMode::ProfilePosition => "profile position",
        OperationMode::Velocity => "velocity",
        OperationMode::ProfileVelocity => "profile velocity",
        OperationMode::ProfileTorque => "profile torque",
        OperationMode::Homing => "homing",
        OperationMode::Interpolated => "interpolated position",
        OperationMode::CyclicPosition => "cyclic synchronous position",
        OperationMode::CyclicVelocity => "cyclic synchronous velocity",
        OperationMode::CyclicTorque => "cyclic synchronous torque",
        OperationMode::Other(_) => "the maker's own or reserved",
    }
}

/// Meaning of an emergency code: the drive's own text, otherwise the standard's for its class.
#[must_use]
pub fn fault_text(code: u16, profile: Option<&'static Profile>) -> &'static str {
    let known =
        canopen_profile(profile).and_then(|p| p.faults.iter().find(|f| f.code == u32::from(code)));
    known.map_or(class_text(code), |fault| fault.text)
}

/// Meaning of an abort code.
#[must_use]
pub fn abort_text(abort: AbortCode) -> &'static str {
    abort.text().unwrap_or("a code that the standard does not have")
}

/// The two characters that a TS drive shows: its codes are the numbers of two glyphs of its
/// seven-segment display \[I\], as all codes of its manual's table agree (3.5.2).
#[must_use]
pub fn panel_characters(code: u16) -> Option<[char; 2]> {
    const GLYPHS: [char; 29] = [
        '0', '1', '2', '3', '4', '5', '6', '7', '8', '9', 'A', 'b', 'c', 'd', 'E', 'F', 'G', 'H',
        'I', 'J', 'L', 'n', 'o', 'P', 'q', 'r', 'S', 't', 'U',
    ];
    let [high, low] = code.to_be_bytes();
    Some([*GLYPHS.get(usize::from(high))?, *GLYPHS.get(usize::from(low))?])
}
