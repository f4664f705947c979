//! Types of the object dictionary: object type, data type, access.

/// Type of an object (CiA 301, table 42).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ObjectType {
    /// No data.
    Null,
    /// A file or program, of any length.
    Domain,
    /// Defines a simple type.
    DefType,
    /// Defines a structure.
    DefStruct,
    /// One value.
    Variable,
    /// Values of one type.
    Array,
    /// Values of several types.
    Record,
}

impl ObjectType {
    const ALL: [(u32, Self); 7] = [
        (0, Self::Null),
        (2, Self::Domain),
        (5, Self::DefType),
        (6, Self::DefStruct),
        (7, Self::Variable),
        (8, Self::Array),
        (9, Self::Record),
    ];

    /// The kind of that code.
    #[must_use]
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.iter().find(|(known, _)| *known == code).map(|(_, kind)| *kind)
    }

    /// Code of the type.
    #[must_use]
    pub fn code(self) -> u32 {
        Self::ALL.iter().find(|(_, kind)| *kind == self).map_or(0, |(code, _)| *code)
    }

    /// Returns whether it has sub-indices.
    #[must_use]
    pub const fn has_subs(self) -> bool {
        matches!(self, Self::Array | Self::Record | Self::DefStruct)
    }
}

/// A data type by its index in the dictionary (CiA 301, table 44).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DataType(pub u16);

/// Code, name, bits on the wire (0 for those of any length), signed.
const TYPES: [(u16, &str, u8, bool); 25] = [
    (0x01, "bool", 8, false),
    (0x02, "i8", 8, true),
    (0x03, "i16", 16, true),
    (0x04, "i32", 32, true),
    (0x05, "u8", 8, false),
    (0x06, "u16", 16, false),
    (0x07, "u32", 32, false),
    (0x08, "f32", 32, true),
    (0x09, "string", 0, false),
    (0x0A, "bytes", 0, false),
    (0x0B, "unicode", 0, false),
    (0x0C, "time of day", 48, false),
    (0x0D, "time difference", 48, false),
    (0x0F, "domain", 0, false),
    (0x10, "i24", 24, true),
    (0x11, "f64", 64, true),
    (0x12, "i40", 40, true),
    (0x13, "i48", 48, true),
    (0x14, "i56", 56, true),
    (0x15, "i64", 64, true),
    (0x16, "u24", 24, false),
    (0x18, "u40", 40, false),
    (0x19, "u48", 48, false),
    (0x1A, "u56", 56, false),
    (0x1B, "u64", 64, false),
];

impl DataType {
    /// Eight bits, unsigned: what sub-index 0 of arrays and records is.
    pub const U8: Self = Self(0x05);
    /// IEEE 754, 32 bits.
    pub const F32: Self = Self(0x08);
    /// Bytes.
    pub const BYTES: Self = Self(0x0A);
    /// Text of 16-bit characters.
    pub const UNICODE: Self = Self(0x0B);
    /// Content of a domain.
    pub const DOMAIN: Self = Self(0x0F);
    /// IEEE 754, 64 bits.
    pub const F64: Self = Self(0x11);

    fn table_row(self) -> Option<&'static (u16, &'static str, u8, bool)> {
        TYPES.iter().find(|(code, ..)| *code == self.0)
    }

    /// Name of the type; `None` for types that the file defines itself.
    #[must_use]
    pub fn name(self) -> Option<&'static str> {
        self.table_row().map(|(_, name, ..)| *name)
    }

    /// Length on the wire, bits; `None` for any length, or an unknown one.
    #[must_use]
    pub fn bits(self) -> Option<u8> {
        self.table_row().map(|(_, _, bits, _)| *bits).filter(|bits| *bits > 0)
    }

    /// Returns whether it is a whole number.
    #[must_use]
    pub const fn is_integer(self) -> bool {
        matches!(self.0, 0x01..=0x07 | 0x10 | 0x12..=0x16 | 0x18..=0x1B)
    }

    /// Returns whether it has a sign.
    #[must_use]
    pub fn is_signed(self) -> bool {
        self.table_row().is_some_and(|(.., signed)| *signed)
    }

    /// The least and greatest whole number that it holds; those of 64 bits as far as `i64` reaches.
    #[must_use]
    pub fn range(self) -> Option<(i64, i64)> {
        let bits = u32::from(self.bits().filter(|_| self.is_integer())?);
        Some(match (self.0, self.is_signed()) {
            (0x01, _) => (0, 1),
            (_, true) => (i64::MIN >> (64 - bits), i64::MAX >> (64 - bits)),
            (_, false) if bits == 64 => (0, i64::MAX),
            (_, false) => (0, (1 << bits) - 1),
        })
    }
}

/// Access to a value (CiA 306-1, `AccessType`).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ObjectAccess {
    /// Never changes.
    Const,
    /// Read only.
    Ro,
    /// Write only.
    Wo,
    /// Read and write.
    Rw,
    /// Read and write; a TPDO may carry it.
    Rwr,
    /// Read and write; an RPDO may carry it.
    Rww,
}

impl ObjectAccess {
    const ALL: [(&'static str, Self); 6] = [
        ("const", Self::Const),
        ("ro", Self::Ro),
        ("wo", Self::Wo),
        ("rw", Self::Rw),
        ("rwr", Self::Rwr),
        ("rww", Self::Rww),
    ];

    /// The access of that word, letter case ignored.
    #[must_use]
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL
            .iter()
            .find(|(known, _)| known.eq_ignore_ascii_case(word))
            .map(|(_, access)| *access)
    }

    /// Word of the access.
    #[must_use]
    pub fn word(self) -> &'static str {
        Self::ALL.iter().find(|(_, access)| *access == self).map_or("", |(word, _)| word)
    }

    /// Returns whether an SDO may write it.
    #[must_use]
    pub const fn is_writable(self) -> bool {
        !matches!(self, Self::Const | Self::Ro)
    }

    /// Returns whether TPDOs and RPDOs may carry it, if it is mappable at all.
    #[must_use]
    pub const fn pdo_directions(self) -> (bool, bool) {
        match self {
            Self::Const | Self::Ro | Self::Rwr => (true, false),
            Self::Wo | Self::Rww => (false, true),
            Self::Rw => (true, true),
        }
    }

    /// Returns whether an SDO may read it.
    #[must_use]
    pub const fn is_readable(self) -> bool {
        !matches!(self, Self::Wo)
    }
}
