//! The explanation of one frame by a dissector, in buffers that are reused.

mod restated;

use polepair_core::error::WireError;
use polepair_core::explain::{
    ExplainSink, Field, FieldValue, FrameValue, NumberPlace, NumberStyle, ValueSource,
};
use polepair_core::profile::Parameter;

use crate::intern::{InternedName, intern};
pub(crate) use restated::RESTATED_MAX;
use restated::{PlacedItem, PlacedNumber};

/// The kind of a CAN FD frame.
pub const CAN_FD: &str = "can-fd";
/// The kind of a frame with errors of a CAN controller.
pub const ERROR_FRAME: &str = "error-frame";
/// Text of a remote request that no protocol explains.
pub(crate) const REMOTE_REQUEST: &str = "remote request";

/// An explained frame.
#[derive(Debug, Default)]
pub struct Explanation {
    /// The protocol's word for the frame; empty if it has none.
    pub kind: String,
    /// The axis, station or module it concerns.
    pub axis: Option<u32>,
    /// The one-line meaning.
    pub text: String,
    /// First violation of the protocol.
    pub error: Option<WireError>,
    fields: Vec<StoredField>,
    bytes: Vec<u8>,
    frame_values: Vec<StoredFrameValue>,
    /// Numbers whose bytes are known, in the order in which they were found.
    numbers: Vec<PlacedNumber>,
    detail: ExplanationDetail,
}

/// Wanted detail of an explanation.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
enum ExplanationDetail {
    #[default]
    Full,
    /// Kind, axis, error, and the values that it carries.
    Values,
    /// Kind, axis and error.
    Kind,
}

/// A value that the frame carries.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StoredFrameValue {
    pub source: StoredValueSource,
    /// The integer on the wire.
    pub raw: i64,
    /// True if the host writes the value.
    pub written: bool,
    /// Motor of the axis' address, from 0.
    pub motor: u8,
}

/// Source of a value.
#[derive(Clone, Copy, Debug)]
pub(crate) enum StoredValueSource {
    Parameter(&'static Parameter),
    Named(InternedName),
}

#[derive(Clone, Copy, PartialEq, Debug)]
struct StoredField {
    name: &'static str,
    start: u16,
    end: u16,
    value: StoredValue,
    meaning: &'static str,
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum StoredValue {
    Int(i64),
    Hex(u64, u8),
    Real(f64),
    Text(usize, usize),
    Words(usize, usize),
}

/// One field of an explained frame.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ExplanationField<'a> {
    /// The protocol's name for it, `snake_case`.
    pub name: &'static str,
    /// First byte in the frame.
    pub start: u16,
    /// Byte after the last.
    pub end: u16,
    /// Value of the field.
    pub value: ExplanationValue<'a>,
    /// Meaning of the value; empty without a name for it.
    pub meaning: &'static str,
}

/// Value of an [`ExplanationField`].
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum ExplanationValue<'a> {
    /// A number, shown in decimal.
    Int(i64),
    /// A number that is shown in hexadecimal with this many digits.
    Hex(u64, u8),
    /// A real number.
    Real(f64),
    /// Text.
    Text(&'a str),
    /// Big-endian 16-bit words.
    Words(&'a [u8]),
}

impl Explanation {
    /// One that keeps kinds, axes and errors alone.
    pub(crate) fn kind_only() -> Self {
        Self { detail: ExplanationDetail::Kind, ..Self::default() }
    }

    /// One that keeps no words and no fields, but what the frame carries.
    pub(crate) fn values_only() -> Self {
        Self { detail: ExplanationDetail::Values, ..Self::default() }
    }

    /// Returns whether only values are wanted, and no words.
    pub(crate) fn is_values_only(&self) -> bool {
        self.detail == ExplanationDetail::Values
    }

    /// Forgets the frame before.
    pub fn clear(&mut self) {
        self.kind.clear();
        self.axis = None;
        self.text.clear();
        self.error = None;
        self.fields.clear();
        self.bytes.clear();
        self.frame_values.clear();
        self.numbers.clear();
    }

    /// Becomes what another one is, in its own buffers.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        let Self { kind, axis, text, error, fields, bytes, frame_values, numbers, detail } = other;
        self.kind.clone_from(kind);
        self.text.clone_from(text);
        self.fields.clone_from(fields);
        self.bytes.clone_from(bytes);
        self.frame_values.clone_from(frame_values);
        self.numbers.clone_from(numbers);
        (self.axis, self.error, self.detail) = (*axis, *error, *detail);
    }

    /// A copy of the explanation.
    pub(crate) fn duplicate(&self) -> Self {
        let mut copy = Self::default();
        copy.copy_from(self);
        copy
    }

    /// Returns whether both have the same content.
    pub(crate) fn is_same_as(&self, other: &Self) -> bool {
        (self.axis, self.error) == (other.axis, other.error)
            && (&self.kind, &self.text) == (&other.kind, &other.text)
            && (&self.fields, &self.bytes) == (&other.fields, &other.bytes)
    }

    /// The values that the frame carries.
    pub(crate) fn frame_values(&self) -> &[StoredFrameValue] {
        &self.frame_values
    }

    /// Sets the text of a frame that belongs to no protocol.
    pub(crate) fn set_text(&mut self, kind: &str, text: core::fmt::Arguments<'_>) {
        self.clear();
        self.kind.push_str(kind);
        // Writing into a String cannot fail.
        let _ = core::fmt::Write::write_fmt(&mut self.text, format_args!("{kind}: {text}"));
    }

    /// The fields in the order in which they were found.
    pub fn fields(&self) -> impl ExactSizeIterator<Item = ExplanationField<'_>> {
        self.fields.iter().map(|stored| self.resolve_field(stored))
    }

    fn resolve_field(&self, stored: &StoredField) -> ExplanationField<'_> {
        let value = match stored.value {
            StoredValue::Int(value) => ExplanationValue::Int(value),
            StoredValue::Hex(value, digits) => ExplanationValue::Hex(value, digits),
            StoredValue::Real(value) => ExplanationValue::Real(value),
            StoredValue::Words(from, to) => ExplanationValue::Words(&self.bytes[from..to]),
            StoredValue::Text(from, to) => ExplanationValue::Text(
                std::str::from_utf8(&self.bytes[from..to]).unwrap_or_default(),
            ),
        };
        let StoredField { name, start, end, meaning, .. } = *stored;
        ExplanationField { name, start, end, value, meaning }
    }

    fn store_bytes(&mut self, bytes: &[u8]) -> (usize, usize) {
        let from = self.bytes.len();
        self.bytes.extend_from_slice(bytes);
        (from, self.bytes.len())
    }
}

impl ExplainSink for Explanation {
    fn kind(&mut self, kind: &str) {
        self.kind.clear();
        self.kind.push_str(kind);
    }

    fn axis(&mut self, axis: u32) {
        self.axis = Some(axis);
    }

    fn field(&mut self, field: Field<'_>) {
        if self.detail != ExplanationDetail::Full {
            return;
        }
        let value = match field.value {
            FieldValue::Int(value) => StoredValue::Int(value),
            FieldValue::Hex(value, digits) => StoredValue::Hex(value, digits),
            FieldValue::Real(value) => StoredValue::Real(value),
            FieldValue::Text(text) => {
                let (from, to) = self.store_bytes(text.as_bytes());
                StoredValue::Text(from, to)
            }
            FieldValue::Words(words) => {
                let (from, to) = self.store_bytes(words);
                StoredValue::Words(from, to)
            }
        };
        let Field { name, start, end, meaning, .. } = field;
        self.fields.push(StoredField { name, start, end, value, meaning });
    }

    fn text(&mut self, piece: &str) {
        if self.detail == ExplanationDetail::Full {
            self.text.push_str(piece);
        }
    }

    fn wants_text(&self) -> bool {
        self.detail == ExplanationDetail::Full
    }

    fn wants_values(&self) -> bool {
        self.detail != ExplanationDetail::Kind
    }

    fn error(&mut self, error: WireError) {
        self.error.get_or_insert(error);
    }

    fn frame_value(&mut self, reading: FrameValue<'_>) {
        if self.detail == ExplanationDetail::Kind {
            return;
        }
        let FrameValue { source, raw, written, motor } = reading;
        let of = match source {
            ValueSource::Parameter(parameter) => StoredValueSource::Parameter(parameter),
            ValueSource::Named(word) => StoredValueSource::Named(intern(word)),
        };
        self.frame_values.push(StoredFrameValue { source: of, raw, written, motor });
    }

    fn number(&mut self, number: i64, style: NumberStyle, place: NumberPlace) {
        if self.detail != ExplanationDetail::Full {
            return self.numbers.push(PlacedNumber { place, item: PlacedItem::Unused });
        }
        let Some(digits) = style.text_of(number) else { return };
        let (at, len) = (self.text.len(), digits.as_str().len());
        self.text.push_str(digits.as_str());
        self.numbers.push(PlacedNumber { place, item: PlacedItem::Text { at, len, style } });
    }

    fn number_field(&mut self, field: Field<'_>, place: NumberPlace) {
        let is_kept = self.detail == ExplanationDetail::Full;
        let at = self.fields.len();
        let item = if is_kept { PlacedItem::Field(at) } else { PlacedItem::Unused };
        self.field(field);
        self.numbers.push(PlacedNumber { place, item });
    }

    fn number_value(&mut self, reading: FrameValue<'_>, place: NumberPlace) {
        if self.detail != ExplanationDetail::Kind {
            let item = PlacedItem::Value(self.frame_values.len());
            self.frame_value(reading);
            self.numbers.push(PlacedNumber { place, item });
        }
    }
}
