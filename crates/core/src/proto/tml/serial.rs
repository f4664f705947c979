//! TML on RS-232, RS-485 and Ethernet (TML communication manual, chapter 3).
//!
//! ```text
//! length  ID code  opcode  data words (0 to 4)  sum        each word high byte first
//! ```
//! The length is that of the frame less two: 4, 6, 8, 10 or 12. The sum is that of all bytes before
//! it, modulo 256. Between frames stand single bytes: `4F` acknowledges a frame, `0D` or more
//! synchronises. None of them is a length, so at a frame's boundary they cannot be mistaken.

use super::wire::{DATA_WORDS_MAX, IdCode, Instruction, Message};
use crate::error::WireError;

/// Bytes of the shortest frame: no data words.
pub const FRAME_MIN: usize = 6;
/// Bytes of the longest frame: four data words.
pub const FRAME_MAX: usize = FRAME_MIN + 2 * DATA_WORDS_MAX;
/// Acknowledgement of a valid frame: `O`.
pub const ACK: u8 = 0x4F;
/// Synchronisation byte, and its reply on RS-232.
pub const SYNC: u8 = 0x0D;

/// Writes the frame and returns its length.
#[inline]
pub fn encode(message: &Message, out: &mut [u8; FRAME_MAX]) -> usize {
    let Message { to, instruction } = message;
    let words = instruction.data().len();
    let head = [to.word(), instruction.opcode];
    debug_assert!(words <= DATA_WORDS_MAX);
    out[0] = 4 + 2 * words as u8;
    for (pair, word) in out[1..].chunks_exact_mut(2).zip(head.iter().chain(instruction.data())) {
        pair.copy_from_slice(&word.to_be_bytes());
    }
    let end = FRAME_MIN - 1 + 2 * words;
    out[end] = checksum(&out[..end]);
    end + 1
}

/// Reads one whole frame.
///
/// # Errors
/// [`WireError::Count`] for a length byte that no frame has, [`WireError::Short`] and
/// [`WireError::Long`] against it, [`WireError::Checksum`], and [`WireError::Unexpected`] for an ID
/// code with bits that must be zero.
#[inline]
pub fn decode(frame: &[u8]) -> Result<Message, WireError> {
    let &length = frame.first().ok_or(WireError::Short { need: FRAME_MIN as u16, found: 0 })?;
    let whole = frame_len(length).ok_or(WireError::Count { at: 0, found: length.into() })?;
    let (need, found) = (whole as u16, frame.len() as u16);
    match frame.len() {
        len if len < whole => return Err(WireError::Short { need, found }),
        len if len > whole => return Err(WireError::Long { need, found }),
        _ => {}
    }
    let (body, check) = frame.split_at(whole - 1);
    let (computed, found) = (checksum(body), check[0]);
    if computed != found {
        return Err(WireError::Checksum { computed: computed.into(), found: found.into() });
    }
    decode_body(body)
}

/// Bytes of the frame that begins with this length byte. `None` when none does.
#[must_use]
#[inline]
pub const fn frame_len(length: u8) -> Option<usize> {
    match length {
        4 | 6 | 8 | 10 | 12 => Some(length as usize + 2),
        _ => None,
    }
}

/// Returns whether a byte between frames requests synchronisation: `0D`, and "larger values are accepted too" (manual,
/// chapter 3, RS-232 protocol, step 1).
#[must_use]
pub const fn is_sync(byte: u8) -> bool {
    byte >= SYNC
}

#[inline]
fn checksum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum.wrapping_add(*byte))
}

#[inline]
fn decode_body(body: &[u8]) -> Result<Message, WireError> {
    let mut words = [0; DATA_WORDS_MAX + 2];
    for (word, pair) in words.iter_mut().zip(body[1..].as_chunks::<2>().0) {
        *word = u16::from_be_bytes(*pair);
    }
    let [code, opcode, data @ ..] = words;
    let to = IdCode::from_word(code).ok_or_else(|| id_code_error(code))?;
    let count = body.len() / 2 - 2;
    Ok(Message { to, instruction: Instruction::from_padded(opcode, data, count) })
}

const fn id_code_error(code: u16) -> WireError {
    let [high, low] = code.to_be_bytes();
    if high & 0xE0 != 0 {
        WireError::Unexpected { at: 1, found: high }
    } else {
        WireError::Unexpected { at: 2, found: low }
    }
}

/// The piece at the head of a stream.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SerialPiece {
    /// A whole frame.
    Message(Message),
    /// [`ACK`] between frames.
    Ack,
    /// [`SYNC`] between frames.
    Sync,
    /// Any other byte between frames.
    Stray(u8),
    /// A frame's length and no frame.
    Broken(WireError),
}

/// Handling of bytes without a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RecoveryPolicy {
    /// They are dropped as a whole, as a drive does: the boundary is lost until it is synchronised
    /// (manual, chapter 3).
    Drop,
    /// Looks for the next frame from the second byte on, as a host does: it must not lose a valid reply after
    /// a byte that a serial server inserted.
    Search,
}

/// Splits a stream of bytes into frames and the bytes between them.
///
/// Feed it a byte, then take pieces until there are none.
#[derive(Clone, Copy, Debug)]
pub struct Deframer {
    recovery: RecoveryPolicy,
    len: u8,
    bytes: [u8; FRAME_MAX],
}

impl Deframer {
    /// An empty one.
    #[must_use]
    pub const fn new(recovery: RecoveryPolicy) -> Self {
        Self { recovery, len: 0, bytes: [0; FRAME_MAX] }
    }

    /// Bytes of a frame that is not whole yet.
    #[must_use]
    pub fn pending(&self) -> &[u8] {
        &self.bytes[..usize::from(self.len)]
    }

    /// Forgets a frame that was not ended.
    pub const fn clear(&mut self) {
        self.len = 0;
    }

    /// Takes a byte. Bytes for which no pieces were taken make room, the oldest first.
    #[inline]
    pub fn push(&mut self, byte: u8) {
        if usize::from(self.len) == FRAME_MAX {
            self.consume(1);
        }
        debug_assert!(usize::from(self.len) < FRAME_MAX);
        self.bytes[usize::from(self.len)] = byte;
        self.len += 1;
    }

    /// Takes the next complete piece off the stream.
    #[inline]
    pub fn next_piece(&mut self) -> Option<SerialPiece> {
        let &first = self.pending().first()?;
        // The length is the only mark of a beginning: any other byte belongs to no message.
        let Some(whole) = frame_len(first) else {
            self.consume(1);
            return Some(match first {
                ACK => SerialPiece::Ack,
                SYNC => SerialPiece::Sync,
                other => SerialPiece::Stray(other),
            });
        };
        let read = match self.pending().get(..whole) {
            Some(frame) => decode(frame),
            None => Err(self.impossible_head()?),
        };
        match (read, self.recovery) {
            (Err(_), RecoveryPolicy::Search) => self.consume(1),
            _ => self.consume(whole),
        }
        Some(read.map_or_else(SerialPiece::Broken, SerialPiece::Message))
    }

    /// The error at the start of a frame: its ID code. A host that searches need not wait for the rest after
    /// a byte that only looked like a length.
    fn impossible_head(&self) -> Option<WireError> {
        let code = match (self.recovery, self.pending()) {
            (RecoveryPolicy::Search, [_, high, low, ..]) => u16::from_be_bytes([*high, *low]),
            (RecoveryPolicy::Search, [_, high]) => u16::from_be_bytes([*high, 0]),
            _ => return None,
        };
        IdCode::from_word(code).is_none().then(|| id_code_error(code))
    }

    fn consume(&mut self, count: usize) {
        // Mostly all of it goes, and nothing has to be moved.
        if count < usize::from(self.len) {
            self.bytes.copy_within(count..usize::from(self.len), 0);
        }
        debug_assert!(count <= usize::from(self.len));
        self.len -= count as u8;
    }
}
