//! A row of the table: an instruction's opcode, words and text, part by part.

/// One instruction as it is written and coded.
#[derive(Clone, Copy, Debug)]
pub struct Form {
    /// Effect, in a few words.
    pub about: &'static str,
    /// Group of the instruction.
    pub category: Category,
    /// The opcode, operand bits clear.
    pub opcode: u16,
    /// Opcode bits that identify it; the others are an operand.
    pub mask: u16,
    /// Data words.
    pub word_count: u8,
    /// Values of the first data words that are part of the instruction.
    pub fixed_words: &'static [u16],
    /// The text.
    pub pieces: &'static [FormPiece],
    /// A second way to write another form: read, never written.
    pub alias: bool,
    /// Certainty of the coding.
    pub certainty: CodingCertainty,
    /// Source of the coding.
    pub source: CodingSource,
}

/// Groups of instructions, as the manual orders them.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Category {
    /// Power, start and stop, configuration.
    Control,
    /// Jumps, calls, interrupts.
    Flow,
    /// Assignments and arithmetic.
    Arithmetic,
    /// Memory by address or pointer.
    Memory,
    /// Motion modes and their settings.
    Mode,
    /// Event that `UPD!`, `STOP!` and `WAIT!` wait for.
    Event,
    /// Digital lines.
    InputOutput,
    /// From drive to drive.
    Axes,
    /// Requests and answers on the line; no program holds them.
    Online,
}

impl Category {
    /// Every group, in order.
    pub const ALL: [Self; 9] = [
        Self::Control,
        Self::Flow,
        Self::Arithmetic,
        Self::Memory,
        Self::Mode,
        Self::Event,
        Self::InputOutput,
        Self::Axes,
        Self::Online,
    ];

    /// For headings.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Control => "control",
            Self::Flow => "program flow",
            Self::Arithmetic => "assignment and arithmetic",
            Self::Memory => "memory",
            Self::Mode => "motion modes",
            Self::Event => "events",
            Self::InputOutput => "inputs and outputs",
            Self::Axes => "between axes",
            Self::Online => "on-line",
        }
    }
}

/// Certainty of a coding.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum CodingCertainty {
    /// Official, or seen on drives, or in two independent sources.
    Verified,
    /// One source that may be wrong, or the pattern of its neighbours.
    Inferred,
    /// The instruction exists and no source gives its opcode: it is refused.
    Unknown,
}

impl CodingCertainty {
    /// The word.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Verified => "verified",
            Self::Inferred => "inferred",
            Self::Unknown => "unknown",
        }
    }
}

/// Source of a coding.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum CodingSource {
    /// The vendor's "TML communication" chapters.
    Manual,
    /// The vendor's library TML_LIB_light.
    Library,
    /// Frames with their text from drives with firmware F514L and FA00G, collected by CanDecoderWeb.
    Labels,
    /// A public decompiler of TML programs.
    Decompiler,
    /// Public drivers that move hardware.
    Drivers,
    /// The pattern of neighbours alone.
    Pattern,
    /// The instruction is named somewhere, its opcode nowhere.
    Nowhere,
}

impl CodingSource {
    /// For tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Manual => "manual",
            Self::Library => "TML_LIB_light",
            Self::Labels => "labelled frames",
            Self::Decompiler => "decompiler",
            Self::Drivers => "drivers",
            Self::Pattern => "pattern",
            Self::Nowhere => "none",
        }
    }
}

/// One piece of an instruction's text. A number is the data word in which an operand begins; operands without
/// one are in the opcode.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FormPiece {
    /// A word of the language, in any case.
    Word(&'static str),
    /// Signs, with the spaces that look well; when read, spaces do not matter.
    Sign(&'static str),
    /// A variable of 16 bits on one of the two short pages.
    Near16,
    /// A variable of 32 bits on one of the two short pages.
    Near32,
    /// A variable of 16 bits anywhere.
    Var16(u8),
    /// A variable of 32 bits anywhere.
    Var32(u8),
    /// A variable of 16 bits that is on no short page.
    Far16(u8),
    /// A variable of 32 bits that is on no short page.
    Far32(u8),
    /// A 16-bit variable that points to memory.
    Pointer(u8),
    /// `+` when the pointer is moved on: bit 7 clear.
    Step,
    /// `pm`, `dm` or `spi`: bits 3 and 2.
    Memory,
    /// `pm`, `dm` or `spi`: bits 6 and 5.
    MemoryHigh,
    /// A 16-bit number, shown as the variable before it is.
    Number(u8),
    /// A 32-bit number, read and shown as the variable before it: a fixed one may have a fraction.
    Long(u8),
    /// A 32-bit fixed number: a decimal one counts units, a hexadecimal one is raw.
    Fixed(u8),
    /// A 32-bit torque reference, whose 16 bits are the upper word.
    High(u8),
    /// A 16-bit number in hexadecimal.
    Hex(u8),
    /// An address in a program: a number, or a label.
    Target(u8),
    /// A 16-bit number that cannot be taken for one of 32.
    Narrow(u8),
    /// A 32-bit number, marked by its size, its digits or an `L`.
    Wide(u8),
    /// A number in this many low bits of the opcode, with a maximum.
    Count(u8, u8),
    /// The integrity counter of a path: seven bits of the opcode.
    Counter,
    /// A comparison with zero: bits 6 to 1.
    Condition,
    /// Position, velocity and time of a PVT point, packed.
    Point,
    /// Lines of a port, as bits.
    Lines(u8),
    /// One line of a port, as a bit.
    Line(u8),
    /// Groups 1 to 8, as bits.
    Groups(u8),
    /// An axis or groups, as an ID code.
    Axis(u8),
    /// `FROM` and an ID code; left out, the scope's sender.
    From(u8),
    /// `FROM` and an axis ID in the low byte of the opcode; left out, that of the scope's sender.
    FromAxis,
    /// An axis ID in the low byte of the opcode.
    AxisNumber,
    /// Four characters of a version.
    Version(u8),
    /// Another instruction, its opcode in this word.
    Inner(u8),
}

impl Form {
    /// Returns whether an opcode and its data words have this form.
    #[must_use]
    pub fn matches(&self, opcode: u16, data: &[u16]) -> bool {
        opcode & self.mask == self.opcode
            && data.len() == usize::from(self.words_for(opcode))
            && data.starts_with(self.fixed_words)
    }

    /// Data words behind this opcode: one that carries another instruction has that one's as well.
    #[must_use]
    pub const fn words_for(&self, opcode: u16) -> u8 {
        match self.pieces {
            [.., FormPiece::Inner(_), FormPiece::Sign(_)] => self.word_count + (opcode & 3) as u8,
            _ => self.word_count,
        }
    }
}

/// Short for tables: a verified form.
pub(super) const fn form(
    category: Category,
    coding: (u16, u16, u8),
    pieces: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    let (opcode, mask, words) = coding;

    let certainty = match source {
        CodingSource::Manual | CodingSource::Library | CodingSource::Labels => {
            CodingCertainty::Verified
        }
        CodingSource::Decompiler | CodingSource::Drivers | CodingSource::Pattern => {
            CodingCertainty::Inferred
        }
        CodingSource::Nowhere => CodingCertainty::Unknown,
    };
    let (fixed, alias): (&[u16], _) = (&[], false);
    Form {
        about,
        category,
        opcode,
        mask,
        word_count: words,
        fixed_words: fixed,
        pieces,
        alias,
        certainty,
        source,
    }
}

impl Form {
    /// Another spelling.
    pub(super) const fn alias(mut self) -> Self {
        self.alias = true;
        self
    }

    /// Sets the first data words.
    pub(super) const fn with(mut self, fixed: &'static [u16]) -> Self {
        self.fixed_words = fixed;
        self
    }
}
