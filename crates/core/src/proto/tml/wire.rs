//! The common content of all encapsulations: an instruction of one to five words, and its destination.
//!
//! Source: TML communication manual, chapter 2 (message contents, axis/group ID code) and the help page on
//! instruction coding.

/// Data words that an instruction has at most, beside its opcode.
pub const DATA_WORDS_MAX: usize = 4;

/// The axis/group ID code: the addressee or the sender of a message.
///
/// Bit 12 is G, bits 11 to 4 the axis or group ID, bit 0 H; the rest are zero.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct IdCode {
    /// The ID names groups (one bit each) instead of an axis. Group ID 0 is everybody.
    pub group: bool,
    /// Axis ID 1 to 255, or a mask of groups 1 (bit 0) to 8 (bit 7). Axis ID 0 is obeyed by every
    /// axis.
    pub id: u8,
    /// The host bit: the message is for (or from) the host that is connected to this drive's
    /// RS-232 port, and not for the drive itself.
    pub host: bool,
}

impl IdCode {
    /// Everybody: group ID 0.
    pub const BROADCAST: Self = Self::groups(0);

    /// One axis.
    #[must_use]
    pub const fn axis(id: u8) -> Self {
        Self { group: false, id, host: false }
    }

    /// The groups in `mask`: bit 0 is group 1.
    #[must_use]
    pub const fn groups(mask: u8) -> Self {
        Self { group: true, id: mask, host: false }
    }

    /// The host on the RS-232 port of axis `id`.
    #[must_use]
    pub const fn host_at(id: u8) -> Self {
        Self { group: false, id, host: true }
    }

    /// True for group ID 0.
    #[must_use]
    pub const fn is_broadcast(self) -> bool {
        self.group && self.id == 0
    }

    /// The word on the wire.
    #[must_use]
    pub const fn word(self) -> u16 {
        (self.group as u16) << 12 | (self.id as u16) << 4 | self.host as u16
    }

    /// Read from the wire. `None` when a bit that must be zero is not.
    #[must_use]
    pub const fn from_word(word: u16) -> Option<Self> {
        if word & 0xE00E != 0 {
            return None;
        }
        Some(Self { group: word & 0x1000 != 0, id: (word >> 4) as u8, host: word & 1 != 0 })
    }

    /// Returns whether a drive with this axis ID and these groups accepts a message with this address (manual, chapter
    /// 2: at least one common group; ID 0 is everybody).
    #[must_use]
    pub const fn concerns(self, axis: u8, groups: u8) -> bool {
        if self.group {
            self.id == 0 || self.id & groups != 0
        } else {
            self.id == 0 || self.id == axis
        }
    }
}

/// An opcode with its data words.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Instruction {
    /// Operation category in bits 15 to 9, operand ID in bits 8 to 0.
    pub opcode: u16,
    len: u8,
    data: [u16; DATA_WORDS_MAX],
}

impl Instruction {
    /// An instruction of that opcode with these data words.
    ///
    /// `None` for more than four.
    #[must_use]
    pub const fn new(opcode: u16, words: &[u16]) -> Option<Self> {
        if words.len() > DATA_WORDS_MAX {
            return None;
        }
        let mut data = [0; DATA_WORDS_MAX];
        let mut n = 0;
        while n < words.len() {
            data[n] = words[n];
            n += 1;
        }
        Some(Self { opcode, len: words.len() as u8, data })
    }

    /// An instruction with exactly `N` data words; more than four do not compile.
    #[must_use]
    pub const fn of<const N: usize>(opcode: u16, words: [u16; N]) -> Self {
        const { assert!(N <= DATA_WORDS_MAX) };
        let mut data = [0; DATA_WORDS_MAX];
        let mut n = 0;
        while n < N {
            data[n] = words[n];
            n += 1;
        }
        Self { opcode, len: N as u8, data }
    }

    /// Number of data words.
    #[must_use]
    #[inline]
    pub const fn word_count(&self) -> usize {
        self.len as usize
    }

    /// [`new`](Self::new) with words that are zero from `count` on.
    #[inline]
    pub(super) const fn from_padded(
        opcode: u16,
        data: [u16; DATA_WORDS_MAX],
        count: usize,
    ) -> Self {
        debug_assert!(count <= DATA_WORDS_MAX);
        Self { opcode, len: count as u8, data }
    }

    /// Four data words, zero beyond the last.
    #[must_use]
    #[inline]
    pub const fn padded(&self) -> [u16; DATA_WORDS_MAX] {
        self.data
    }

    /// [`new`](Self::new) with words packed in a number as on CAN: the first lowest.
    #[inline]
    pub(super) const fn from_packed(opcode: u16, words: u64, count: usize) -> Self {
        // Bytes behind the length are remains of the driver's buffer, no data.
        let stored =
            if count < DATA_WORDS_MAX { words & !(u64::MAX << (16 * count)) } else { words };
        let data =
            [stored as u16, (stored >> 16) as u16, (stored >> 32) as u16, (stored >> 48) as u16];
        Self::from_padded(opcode, data, count)
    }

    /// The data words in a number as they lie on CAN: the first lowest, each low byte first.
    #[inline]
    pub(super) const fn packed(&self) -> u64 {
        let [a, b, c, d] = self.data;
        a as u64 | (b as u64) << 16 | (c as u64) << 32 | (d as u64) << 48
    }

    /// The data words.
    #[must_use]
    #[inline]
    pub const fn data(&self) -> &[u16] {
        self.data.split_at(self.len as usize).0
    }

    /// A data word, zero beyond the last.
    #[must_use]
    pub const fn word(&self, n: usize) -> u16 {
        if n < DATA_WORDS_MAX { self.data[n] } else { 0 }
    }

    /// Two data words as 32 bits: the low one comes first.
    #[must_use]
    pub const fn long(&self, n: usize) -> u32 {
        self.word(n) as u32 | (self.word(n + 1) as u32) << 16
    }
}

impl core::fmt::Debug for Instruction {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:04X}", self.opcode)?;
        self.data().iter().try_for_each(|word| write!(f, " {word:04X}"))
    }
}

/// The two data words of a 32-bit value, low word first.
#[must_use]
pub const fn low_first(value: u32) -> [u16; 2] {
    [value as u16, (value >> 16) as u16]
}

/// An instruction and its addressee.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct Message {
    /// Receiver.
    pub to: IdCode,
    /// The instruction.
    pub instruction: Instruction,
}

/// The variable that an opcode's operand names: bits 8 to 0 of its address, and bit 9 for the page
/// (0x0200 to 0x03FF, or 0x0800 to 0x09FF).
#[must_use]
pub const fn operand_address(opcode: u16) -> u16 {
    let page = if opcode & 0x200 == 0 { 0x0200 } else { 0x0800 };
    page | opcode & 0x1FF
}

/// The operand that names a variable in an opcode. `None` outside both pages: such variables need
/// instructions that carry the whole address.
#[must_use]
pub const fn short_operand(address: u16) -> Option<u16> {
    match address & 0xFE00 {
        0x0200 => Some(address & 0x1FF),
        0x0800 => Some(0x200 | address & 0x1FF),
        _ => None,
    }
}
