//! The data of a wire: bytes on a serial line, frames on a CAN bus.

pub mod bits;

use core::borrow::BorrowMut;

/// A kind of wire, with the types that a [`Station`](crate::station::Station) receives and sends.
pub trait Medium: 'static {
    /// Kind of this medium.
    const KIND: MediumKind;
    /// Type of received data: a run of bytes, or one frame.
    type Unit: ?Sized;
    /// Type of a station's output: a byte buffer, or one frame.
    type Out: ?Sized;
    /// Room for one [`Out`](Self::Out), on the stack.
    type Buffer: BorrowMut<Self::Out> + Send;
    /// Settings of the wire: baud and parity, or bit rate.
    type Line: Copy + PartialEq + core::fmt::Debug + Send;
    /// Baud or bit rate of the wire; 0 where it has none, or the link does not know it.
    fn rate(line: &Self::Line) -> u32;
    /// An empty buffer.
    fn buffer() -> Self::Buffer;
    /// The unit in `out` after something of that length was written there.
    fn unit(out: &Self::Out, len: usize) -> &Self::Unit;
    /// Calls `emit` to write into a buffer, then `show` with the result: the bytes, and their frame if the
    /// medium has frames.
    fn render(
        emit: &mut dyn FnMut(&mut Self::Out) -> usize,
        show: &mut dyn FnMut(Option<&Frame>, &[u8]),
    );
}

/// A medium by name, where the type has been erased.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum MediumKind {
    /// [`Stream`].
    Serial,
    /// [`Can`].
    Can,
}

/// RS-232, RS-485, a pseudo-terminal or TCP: a stream of bytes without frame boundaries.
#[derive(Debug)]
pub enum Stream {}

/// CAN 2.0A and 2.0B.
#[derive(Debug)]
pub enum Can {}

impl Medium for Stream {
    const KIND: MediumKind = MediumKind::Serial;
    type Unit = [u8];
    type Out = [u8];
    type Buffer = [u8; STREAM_UNIT_MAX];
    type Line = SerialLine;
    fn rate(line: &SerialLine) -> u32 {
        line.baud
    }
    fn buffer() -> Self::Buffer {
        [0; STREAM_UNIT_MAX]
    }
    fn unit(out: &[u8], len: usize) -> &[u8] {
        &out[..len.min(out.len())]
    }
    fn render(
        emit: &mut dyn FnMut(&mut [u8]) -> usize,
        show: &mut dyn FnMut(Option<&Frame>, &[u8]),
    ) {
        let mut buffer = Self::buffer();
        let len = emit(&mut buffer);
        show(None, Self::unit(&buffer, len));
    }
}

impl Medium for Can {
    const KIND: MediumKind = MediumKind::Can;
    type Unit = Frame;
    type Out = Frame;
    type Buffer = Frame;
    type Line = CanLine;
    fn rate(line: &CanLine) -> u32 {
        line.bit_rate
    }
    fn buffer() -> Frame {
        Frame::default()
    }
    fn unit(out: &Frame, _len: usize) -> &Frame {
        out
    }
    fn render(
        emit: &mut dyn FnMut(&mut Frame) -> usize,
        show: &mut dyn FnMut(Option<&Frame>, &[u8]),
    ) {
        let mut frame = Self::buffer();
        emit(&mut frame);
        show(Some(&frame), frame.bytes());
    }
}

/// The largest run of bytes that a stream station sends at once: a Modbus ASCII frame of 513
/// characters, rounded up.
pub const STREAM_UNIT_MAX: usize = 520;

/// Parity of a serial character.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Parity {
    /// No parity bit.
    #[default]
    None,
    /// Even parity.
    Even,
    /// Odd parity.
    Odd,
}

/// Settings of a serial line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SerialLine {
    /// Bits per second; 0 on a wire without timing (pty, TCP).
    pub baud: u32,
    /// Data bits of a character, 7 or 8.
    pub data_bits: u8,
    /// Parity of a character.
    pub parity: Parity,
    /// Stop bits, 1 or 2.
    pub stop_bits: u8,
}

impl SerialLine {
    /// `baud`, eight data bits, no parity, one stop bit.
    #[must_use]
    pub const fn new_8n1(baud: u32) -> Self {
        Self { baud, data_bits: 8, parity: Parity::None, stop_bits: 1 }
    }

    /// Bits that one character takes on the wire, start and stop bits counted.
    #[must_use]
    pub const fn bits_per_character(&self) -> u32 {
        let parity = !matches!(self.parity, Parity::None) as u32;
        1 + self.data_bits as u32 + parity + self.stop_bits as u32
    }

    /// Nanoseconds that `count` characters take; 0 on a wire without timing.
    #[must_use]
    pub const fn characters_ns(&self, count: u32) -> u64 {
        if self.baud == 0 {
            return 0;
        }
        count as u64 * self.bits_per_character() as u64 * 1_000_000_000 / self.baud as u64
    }
}

/// Settings of a CAN bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CanLine {
    /// Bits per second.
    pub bit_rate: u32,
}

/// One CAN frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Frame {
    /// 11-bit or 29-bit identifier.
    pub id: u32,
    /// True for a 29-bit identifier.
    pub extended: bool,
    /// True for a remote transmission request, which carries no data.
    pub remote: bool,
    /// Data length, 0 to 8.
    pub len: u8,
    /// Data; bytes from `len` on are zero.
    pub data: [u8; 8],
}

impl core::fmt::Display for Frame {
    /// Formats it as candump's log: `30B#5443`, eight digits for 29 bits, `#R4` for a remote request.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let digits = if self.extended { 8 } else { 3 };
        write!(f, "{:0digits$X}#", self.id)?;
        if self.remote {
            return write!(f, "R{}", self.len);
        }
        self.bytes().iter().try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

impl Frame {
    /// A data frame with an 11-bit identifier. `data` beyond eight bytes is cut.
    #[must_use]
    pub fn standard(id: u16, data: &[u8]) -> Self {
        let len = data.len().min(8);
        let mut frame = Self { id: u32::from(id & 0x7FF), len: len as u8, ..Self::default() };
        frame.data[..len].copy_from_slice(&data[..len]);
        frame
    }

    /// The data that the frame carries.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.data[..usize::from(self.len.min(8))]
    }
}
