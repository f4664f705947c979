//! Modbus ASCII: a colon, two hexadecimal characters a byte, LRC, CR LF.
//!
//! Source: MSL 2.5.2; TS manual V2 §2.4 (which uses eight data bits where the standard uses seven).
//! A colon inside a frame starts it anew. Lower-case characters are understood and never sent.

use super::rtu::ADU_MAX;
use crate::error::WireError;

/// Longest frame in characters: colon, 255 bytes in two characters each, CR, LF.
pub const FRAME_MAX: usize = 1 + 2 * (ADU_MAX - 1) + 2;
/// First character.
pub const START: u8 = b':';
/// Bytes of the shortest frame: address, function code, LRC.
const BYTES_MIN: usize = 3;

/// The longitudinal redundancy check: what makes the sum of all bytes zero.
#[must_use]
pub fn lrc(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum: u8, &byte| sum.wrapping_add(byte)).wrapping_neg()
}

/// Writes the frame around a PDU that `pdu` emits, and returns its length in characters.
///
/// `out` must hold [`FRAME_MAX`] bytes, or the emitted frame.
pub fn emit(unit: u8, out: &mut [u8], pdu: impl FnOnce(&mut [u8]) -> usize) -> usize {
    let mut bytes = [0; ADU_MAX];
    bytes[0] = unit;
    let end = 1 + pdu(&mut bytes[1..]);
    bytes[end] = lrc(&bytes[..end]);
    out[0] = START;
    for (pair, &byte) in out[1..].chunks_exact_mut(2).zip(&bytes[..=end]) {
        pair.copy_from_slice(&[hex_digit(byte >> 4), hex_digit(byte & 0xF)]);
    }
    let at = 1 + 2 * (end + 1);
    out[at..at + 2].copy_from_slice(b"\r\n");
    at + 2
}

/// Address and PDU of the bytes between colon and CR.
///
/// # Errors
/// [`WireError::Short`] or [`WireError::Checksum`].
pub fn decode(bytes: &[u8]) -> Result<(u8, &[u8]), WireError> {
    if bytes.len() < BYTES_MIN {
        return Err(WireError::Short { need: BYTES_MIN as u16, found: bytes.len() as u16 });
    }
    let (body, check) = bytes.split_at(bytes.len() - 1);
    let (computed, found) = (u32::from(lrc(body)), u32::from(check[0]));
    if computed == found {
        Ok((body[0], &body[1..]))
    } else {
        Err(WireError::Checksum { computed, found })
    }
}

/// The value of a hexadecimal character of either case.
#[must_use]
pub const fn hex_value(character: u8) -> Option<u8> {
    match character {
        b'0'..=b'9' => Some(character - b'0'),
        b'A'..=b'F' => Some(character - b'A' + 10),
        b'a'..=b'f' => Some(character - b'a' + 10),
        _ => None,
    }
}

/// Result of a character.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FeedResult {
    /// The character belongs to an incomplete frame.
    Incomplete,
    /// The character ended a frame: see [`AsciiDeframer::bytes`].
    Complete,
    /// The character, and with it this many before it, belong to no frame.
    Skipped(usize),
}

/// Gathers characters into the bytes of a frame. Bounded; recovers at the next colon.
#[derive(Clone, Debug)]
pub struct AsciiDeframer {
    bytes: [u8; ADU_MAX],
    len: usize,
    characters: usize,
    high_nibble: Option<u8>,
    state: DeframerState,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum DeframerState {
    Idle,
    InFrame,
    AwaitLineFeed,
}

impl Default for AsciiDeframer {
    fn default() -> Self {
        Self {
            bytes: [0; ADU_MAX],
            len: 0,
            characters: 0,
            high_nibble: None,
            state: DeframerState::Idle,
        }
    }
}

impl AsciiDeframer {
    /// Takes one character.
    pub fn feed(&mut self, character: u8) -> FeedResult {
        match (self.state, character) {
            (_, START) => {
                let skipped = self.pending();
                self.start_frame();
                return if skipped == 0 {
                    FeedResult::Incomplete
                } else {
                    FeedResult::Skipped(skipped)
                };
            }
            (DeframerState::InFrame, b'\r') if self.high_nibble.is_none() => {
                self.state = DeframerState::AwaitLineFeed
            }
            (DeframerState::InFrame, _) => match hex_value(character) {
                Some(nibble) if self.len < ADU_MAX - 1 => self.push_nibble(nibble),
                _ => return self.abandon_frame(),
            },
            (DeframerState::AwaitLineFeed, b'\n') => {
                self.state = DeframerState::Idle;
                return FeedResult::Complete;
            }
            _ => return self.abandon_frame(),
        }
        self.characters += 1;
        FeedResult::Incomplete
    }

    /// The bytes of the frame that just ended, check included.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..self.len]
    }

    /// Characters held of a frame that is not complete.
    #[must_use]
    pub fn pending(&self) -> usize {
        if matches!(self.state, DeframerState::Idle) { 0 } else { self.characters }
    }

    /// Discards the collected characters.
    pub fn clear(&mut self) {
        self.state = DeframerState::Idle;
        self.characters = 0;
    }

    fn start_frame(&mut self) {
        self.state = DeframerState::InFrame;
        self.len = 0;
        self.high_nibble = None;
        self.characters = 1;
    }

    fn push_nibble(&mut self, nibble: u8) {
        match self.high_nibble.take() {
            None => self.high_nibble = Some(nibble),
            Some(high) => {
                self.bytes[self.len] = high << 4 | nibble;
                self.len += 1;
            }
        }
    }

    fn abandon_frame(&mut self) -> FeedResult {
        let skipped = self.pending() + 1;
        self.clear();
        FeedResult::Skipped(skipped)
    }
}

const fn hex_digit(nibble: u8) -> u8 {
    b"0123456789ABCDEF"[nibble as usize]
}
