//! Builds lines from existing pieces and numbers. It copies in steps of a fixed size, which is much faster
//! than copies of variable size.

use crate::number_text;

/// Bytes of a page: a power of two.
const BUFFER_BYTES: usize = 1 << 13;
/// Bytes of a piece that are copied at once.
const COPY_BYTES: usize = 32;
const ZEROS: u64 = 0x3030_3030_3030_3030;
/// Eight spaces.
const SPACES: u64 = 0x2020_2020_2020_2020;
/// Columns of eight bytes.
const HEX_COLUMNS: usize = 24;

/// Words that stand in many lines.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub(crate) struct TextPiece {
    head: [u8; COPY_BYTES],
    len: u8,
    /// Bytes beyond the head.
    rest: Box<[u8]>,
}

impl TextPiece {
    /// A piece of text.
    pub fn new(text: &[u8]) -> Self {
        let mut piece = Self { len: text.len().min(COPY_BYTES) as u8, ..Self::default() };
        let (head, rest) = text.split_at(piece.len.into());
        piece.head[..head.len()].copy_from_slice(head);
        piece.rest = rest.into();
        piece
    }

    /// This piece and one behind it.
    pub fn joined(&self, next: &Self) -> Self {
        let mut text = Vec::new();
        self.append_to(&mut text);
        next.append_to(&mut text);
        Self::new(&text)
    }

    /// Length in bytes.
    pub fn len(&self) -> usize {
        usize::from(self.len) + self.rest.len()
    }

    /// Appends it.
    pub fn append_to(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.head[..self.len.into()]);
        out.extend_from_slice(&self.rest);
    }
}

/// Bytes as digits with a space behind each: `01 0A FF `.
#[derive(Clone, Copy)]
pub(crate) struct HexColumns {
    digits: [u64; 3],
    /// Number of columns count.
    columns: usize,
}

impl HexColumns {
    /// Creates a piece of eight bytes, the first lowest, of which `len` are valid.
    #[inline]
    pub fn new(data: u64, len: u8) -> Self {
        let bytes = data.to_le_bytes();
        let [a, b, c, d, e, f, g, h] = bytes.map(|byte| u64::from(DIGITS[usize::from(byte)]));
        let digits = [
            a | b << 24 | c << 48,
            c >> 16 | d << 8 | e << 32 | f << 56,
            f >> 8 | g << 16 | h << 40,
        ];
        Self { digits, columns: HEX_COLUMNS.min(3 * usize::from(len)) }
    }

    /// Columns without the last space.
    pub const fn width(self) -> usize {
        self.columns.saturating_sub(1)
    }
}

/// Two digits and a space for each byte.
static DIGITS: [u32; 256] = {
    let mut all = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let [high, low] = number_text::hex_digits(byte as u8);
        all[byte] = high as u32 | (low as u32) << 8 | (b' ' as u32) << 16;
        byte += 1;
    }
    all
};

/// Lines that are not yet where they belong.
pub(crate) struct LineBuffer {
    /// A page, and room for the longest copy beyond its end.
    bytes: Box<[u8; BUFFER_BYTES + COPY_BYTES]>,
    position: usize,
    /// The second that was written last: when it begins, and its digits.
    last_second: (u64, u32),
}

impl core::fmt::Debug for LineBuffer {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} of {BUFFER_BYTES}", self.position)
    }
}

impl Clone for LineBuffer {
    /// An empty one: what waits is of that page alone.
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Default for LineBuffer {
    fn default() -> Self {
        Self {
            bytes: Box::new([0; BUFFER_BYTES + COPY_BYTES]),
            position: 0,
            last_second: (0, u32::from_le_bytes(*b"   0")),
        }
    }
}

impl LineBuffer {
    /// Bytes that a line may need at most.
    pub const LINE_MAX: usize = BUFFER_BYTES / 4;
    /// Seconds that a time may have at most.
    pub const SECONDS_MAX: u64 = 9999;
    /// Bytes that a number may take, and what its steps write beyond.
    pub const NUMBER_MAX: usize = 32;

    /// Reserves memory for a line, and returns its start.
    #[inline]
    pub fn begin_line(&mut self, out: &mut Vec<u8>) -> usize {
        if self.position > BUFFER_BYTES - Self::LINE_MAX {
            self.flush(out);
        }
        self.position
    }

    /// Removes everything that was put since `to`.
    pub const fn rewind(&mut self, to: usize) {
        self.position = to;
    }

    /// Puts all lines where they belong.
    pub fn flush(&mut self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.bytes[..self.position]);
        self.position = 0;
    }

    #[inline]
    fn push_fixed<const N: usize>(&mut self, bytes: &[u8; N], len: usize) {
        const { assert!(N <= COPY_BYTES) };
        // A position is within the page: the mask saves the check.
        let at = self.position & (BUFFER_BYTES - 1);
        debug_assert!(len <= N);
        self.bytes[at..at + N].copy_from_slice(bytes);
        self.position += len;
    }

    /// Appends up to eight characters.
    #[inline]
    pub fn push_word(&mut self, word: u64, len: usize) {
        self.push_fixed(&word.to_le_bytes(), len);
    }

    /// Appends a piece.
    #[inline]
    pub fn push_piece(&mut self, piece: &TextPiece) {
        self.push_fixed(&piece.head, piece.len.into());
        if !piece.rest.is_empty() {
            self.push_bytes(&piece.rest);
        }
    }

    /// Appends bytes, of any number.
    pub fn push_bytes(&mut self, rest: &[u8]) {
        if let Some(buffer) = self.bytes.get_mut(self.position..self.position + rest.len()) {
            buffer.copy_from_slice(rest);
        }
        self.position += rest.len();
    }

    /// Appends bytes, and spaces up to a width of 32 at most.
    #[inline]
    pub fn push_hex(&mut self, HexColumns { digits, columns }: HexColumns, width: usize) {
        let at = self.position;
        digits.iter().for_each(|word| self.push_word(*word, 8));
        self.position = at + columns;
        // The bytes after the digits are cleared, and overwritten by what comes next.
        self.push_fixed(&[b' '; COPY_BYTES], 0);
        self.position = at + width;
    }

    /// Appends `  12.034567  `.
    #[inline]
    pub fn push_time(&mut self, ns: u64) {
        const SECOND: u64 = 1_000_000_000;
        // The digits of the second are kept: most frames are within the same one.
        if ns.wrapping_sub(self.last_second.0) >= SECOND {
            let second = ns / SECOND;
            let digits = eight_digits(second as u32) | ZEROS;
            let zeros = (eight_digits(second as u32).trailing_zeros() / 8).clamp(4, 7) - 4;
            let blank = (1_u64 << (8 * zeros)) - 1;
            let digits = (digits >> 32 & !blank) | (SPACES & blank);
            self.last_second = (second * SECOND, digits as u32);
        }
        let us = (ns - self.last_second.0) as u32 / 1000;
        self.push_word(u64::from(self.last_second.1) | u64::from(b'.') << 32, 5);
        self.push_word((eight_digits(us) | ZEROS) >> 16 | 0x2020 << 48, 8);
    }

    /// Appends a number.
    #[inline]
    pub fn push_signed(&mut self, value: i64) {
        const SHORT: u64 = 100_000_000;
        let size = value.unsigned_abs();
        self.push_word(b'-'.into(), usize::from(value < 0));
        if size >= SHORT {
            return self.push_large(size);
        }
        let digits = eight_digits(size as u32);
        let zeros = (digits.trailing_zeros() / 8).min(7);
        self.push_word((digits | ZEROS) >> (8 * zeros), 8 - zeros as usize);
    }

    fn push_large(&mut self, size: u64) {
        let mut text = Vec::with_capacity(Self::NUMBER_MAX);
        number_text::append_unsigned(size, &mut text);
        self.push_bytes(&text);
    }
}

/// The eight digits of a number below a hundred million, the first lowest, as numbers.
#[inline]
const fn eight_digits(value: u32) -> u64 {
    // Fours, then pairs, then digits, each divided side by side.
    let fours = (value / 10_000) as u64 | ((value % 10_000) as u64) << 32;
    let hundreds = (fours * 10_486) >> 20 & 0x0000_007F_0000_007F;
    let pairs = hundreds | (fours - 100 * hundreds) << 16;
    let tens = (pairs * 103) >> 10 & 0x000F_000F_000F_000F;
    tens | (pairs - 10 * tens) << 8
}

#[cfg(test)]
mod tests {
    use super::{HexColumns, LineBuffer, TextPiece};
    use crate::number_text;

    fn shown(write: impl FnOnce(&mut LineBuffer)) -> String {
        let (mut page, mut out) = (LineBuffer::default(), Vec::new());
        write(&mut page);
        page.flush(&mut out);
        String::from_utf8(out).expect("text")
    }

    #[test]
    fn numbers_are_those_of_the_standard_library() {
        let powers = (0..19).map(|n| 10_i64.pow(n));
        let near = powers.flat_map(|n| [n - 1, n, n + 1, -n, 1 - n, n / 3, n / 7 * 5]);
        for number in near.chain((0..20_000).map(|n| n * 5003)).chain([i64::MIN, i64::MAX]) {
            assert_eq!(shown(|page| page.push_signed(number)), number.to_string());
        }
    }

    #[test]
    fn times_are_aligned() {
        for (second, us) in [(0, 0), (7, 1), (10, 999_999), (999, 20_304), (9999, 500_000), (0, 9)]
        {
            let text = shown(|page| page.push_time((second * 1_000_000 + us) * 1000 + 999));
            assert_eq!(text, format!("{second:4}.{us:06}  "));
        }
    }

    #[test]
    fn bytes_and_pieces() {
        let bytes = [0x01, 0x2A, 0xFF, 0x80, 0x7F, 0x00, 0xC3, 0x9E];
        for len in 0..=8 {
            let mut plain = Vec::new();
            bytes[..len].iter().for_each(|byte| {
                plain.extend_from_slice(&number_text::hex_digits(*byte));
                plain.push(b' ');
            });
            plain.resize(25, b' ');
            let hex = HexColumns::new(u64::from_le_bytes(bytes), len as u8);
            assert_eq!(shown(|page| page.push_hex(hex, 25)).into_bytes(), plain);
        }
        for len in [0, 1, 31, 32, 33, 100] {
            let text = "abcdefghij".repeat(10)[..len].to_owned();
            let piece = TextPiece::new(text.as_bytes());
            let mut put = Vec::new();
            piece.append_to(&mut put);
            assert_eq!((shown(|page| page.push_piece(&piece)), piece.len()), (text.clone(), len));
            assert_eq!(put, text.into_bytes());
        }
    }
}
