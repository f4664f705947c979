//! What a dissector found in one frame, kept in buffers that are used again for the next.

use polepair_core::error::WireError;
use polepair_core::explain::{Field, Reading, Sink, Value, What};
use polepair_core::profile::Parameter;

use crate::session::{Name, name};

/// The kind of a CAN FD frame.
pub const CAN_FD: &str = "can-fd";
/// The kind of what a CAN controller reports.
pub const ERROR_FRAME: &str = "error-frame";
/// What is said of a remote request that no protocol explains.
pub(crate) const REMOTE_REQUEST: &str = "remote request";

/// An explained frame.
#[derive(Debug, Default)]
pub struct Explained {
    /// The protocol's word for the frame; empty if it has none.
    pub kind: String,
    /// The axis, station or module it concerns.
    pub axis: Option<u32>,
    /// The one-line meaning.
    pub text: String,
    /// What the frame breaks first.
    pub error: Option<WireError>,
    items: Vec<Stored>,
    bytes: Vec<u8>,
    readings: Vec<Told>,
    keeps: Keeps,
}

/// What is wanted of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
enum Keeps {
    #[default]
    All,
    /// Kind, axis, error, and the values that it carries.
    Values,
    /// Kind, axis and error.
    Kind,
}

/// A value that the frame carries.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Told {
    pub of: Of,
    /// The integer on the wire.
    pub raw: i64,
    /// The host tells the drive.
    pub written: bool,
    /// Which motor of the axis' address.
    pub part: u8,
}

/// What a value is of.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Of {
    Parameter(&'static Parameter),
    Word(Name),
}

#[derive(Clone, Copy, PartialEq, Debug)]
struct Stored {
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
pub struct Item<'a> {
    /// The protocol's name for it, `snake_case`.
    pub name: &'static str,
    /// First byte in the frame.
    pub start: u16,
    /// Byte after the last.
    pub end: u16,
    /// Its value.
    pub value: ItemValue<'a>,
    /// What the value means; empty if there is no name for it.
    pub meaning: &'static str,
}

/// Value of an [`Item`].
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum ItemValue<'a> {
    /// A number, shown in decimal.
    Int(i64),
    /// A number, shown in hexadecimal with so many digits.
    Hex(u64, u8),
    /// A real number.
    Real(f64),
    /// Text.
    Text(&'a str),
    /// Big-endian 16-bit words.
    Words(&'a [u8]),
}

impl Explained {
    /// One that keeps kinds, axes and errors alone.
    pub(crate) fn brief() -> Self {
        Self { keeps: Keeps::Kind, ..Self::default() }
    }

    /// One that keeps no words and no fields, but what the frame carries.
    pub(crate) fn bare() -> Self {
        Self { keeps: Keeps::Values, ..Self::default() }
    }

    /// What the frame carries is wanted, and no words.
    pub(crate) fn is_bare(&self) -> bool {
        self.keeps == Keeps::Values
    }

    /// Forgets the frame before.
    pub fn clear(&mut self) {
        self.kind.clear();
        self.axis = None;
        self.text.clear();
        self.error = None;
        self.items.clear();
        self.bytes.clear();
        self.readings.clear();
    }

    /// Becomes what another one is, in its own buffers.
    pub(crate) fn copy(&mut self, other: &Self) {
        let Self { kind, axis, text, error, items, bytes, readings, keeps } = other;
        self.kind.clone_from(kind);
        self.text.clone_from(text);
        self.items.clone_from(items);
        self.bytes.clone_from(bytes);
        self.readings.clone_from(readings);
        (self.axis, self.error, self.keeps) = (*axis, *error, *keeps);
    }

    /// Another one that says the same.
    pub(crate) fn copied(&self) -> Self {
        let mut copy = Self::default();
        copy.copy(self);
        copy
    }

    /// Says the same.
    pub(crate) fn is_as(&self, other: &Self) -> bool {
        (self.axis, self.error) == (other.axis, other.error)
            && (&self.kind, &self.text) == (&other.kind, &other.text)
            && (&self.items, &self.bytes) == (&other.items, &other.bytes)
    }

    /// The values that the frame carries.
    pub(crate) fn readings(&self) -> &[Told] {
        &self.readings
    }

    /// Says what belongs to no protocol.
    pub(crate) fn say(&mut self, kind: &str, text: core::fmt::Arguments<'_>) {
        self.clear();
        self.kind.push_str(kind);
        // Writing into a String cannot fail.
        let _ = core::fmt::Write::write_fmt(&mut self.text, format_args!("{kind}: {text}"));
    }

    /// The fields in the order in which they were found.
    pub fn items(&self) -> impl ExactSizeIterator<Item = Item<'_>> {
        self.items.iter().map(|stored| self.item(stored))
    }

    fn item(&self, stored: &Stored) -> Item<'_> {
        let value = match stored.value {
            StoredValue::Int(value) => ItemValue::Int(value),
            StoredValue::Hex(value, digits) => ItemValue::Hex(value, digits),
            StoredValue::Real(value) => ItemValue::Real(value),
            StoredValue::Words(from, to) => ItemValue::Words(&self.bytes[from..to]),
            StoredValue::Text(from, to) => {
                ItemValue::Text(std::str::from_utf8(&self.bytes[from..to]).unwrap_or_default())
            }
        };
        let Stored { name, start, end, meaning, .. } = *stored;
        Item { name, start, end, value, meaning }
    }

    fn keep(&mut self, bytes: &[u8]) -> (usize, usize) {
        let from = self.bytes.len();
        self.bytes.extend_from_slice(bytes);
        (from, self.bytes.len())
    }
}

impl Sink for Explained {
    fn kind(&mut self, kind: &str) {
        self.kind.clear();
        self.kind.push_str(kind);
    }

    fn axis(&mut self, axis: u32) {
        self.axis = Some(axis);
    }

    fn field(&mut self, field: Field<'_>) {
        if self.keeps != Keeps::All {
            return;
        }
        let value = match field.value {
            Value::Int(value) => StoredValue::Int(value),
            Value::Hex(value, digits) => StoredValue::Hex(value, digits),
            Value::Real(value) => StoredValue::Real(value),
            Value::Text(text) => {
                let (from, to) = self.keep(text.as_bytes());
                StoredValue::Text(from, to)
            }
            Value::Words(words) => {
                let (from, to) = self.keep(words);
                StoredValue::Words(from, to)
            }
        };
        let Field { name, start, end, meaning, .. } = field;
        self.items.push(Stored { name, start, end, value, meaning });
    }

    fn text(&mut self, piece: &str) {
        if self.keeps == Keeps::All {
            self.text.push_str(piece);
        }
    }

    fn error(&mut self, error: WireError) {
        self.error.get_or_insert(error);
    }

    fn reading(&mut self, reading: Reading<'_>) {
        if self.keeps == Keeps::Kind {
            return;
        }
        let Reading { what, raw, written, part } = reading;
        let of = match what {
            What::Parameter(parameter) => Of::Parameter(parameter),
            What::Named(word) => Of::Word(name(word)),
        };
        self.readings.push(Told { of, raw, written, part });
    }
}
