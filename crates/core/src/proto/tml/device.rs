//! The device end: receives frames, calls the firmware, sends acknowledgements and messages.
//!
//! The [`Firmware`] is passed to each call, so one drive object has a [`SerialEndpoint`] and a
//! [`CanEndpoint`]; [`Relay`](super::relay::Relay) is both, with the path between them.
//!
//! Broken frames are handled as in the manual's recovery (TML communication manual, chapter 3): bytes are
//! counted by the length byte only, so after a lost byte the boundary is lost until the host has sent
//! enough of `0D`.

use super::rules::TmlWire;
use super::serial::{self, ACK, Deframer, FRAME_MAX, RecoveryPolicy, SYNC, SerialPiece};
use super::wire::{IdCode, Instruction, Message};
use super::{technocan, tmlcan};
use crate::medium::{CanLine, Frame, Parity, SerialLine};
use crate::time::Instant;

/// Errors on a drive's wires, for its communication error register.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum LineFault {
    /// A character without stop bit, or a break.
    SerialReceive,
    /// More to send than the serial line takes.
    SerialOverrun,
    /// More to send than the CAN bus takes.
    CanOverrun,
    /// The CAN controller went off the bus.
    BusOff,
}

/// The firmware of a simulated drive: settings of the wires, and the execution of messages.
pub trait Firmware {
    /// Axis ID, 1 to 255 (AAR bits 7 to 0).
    fn axis(&self) -> u8;
    /// Groups, bit 0 is group 1 (AAR bits 15 to 8).
    fn groups(&self) -> u8;
    /// Baud rate that the serial port is set to (SCIBR).
    fn baud(&self) -> u32;
    /// Bit rate that the CAN port is set to (CANBR).
    fn bit_rate(&self) -> u32;
    /// Executes a message to this drive with a valid check sum.
    fn execute(&mut self, now: Instant, message: &Message);
    /// The next message that the drive has to send: an answer, a notice, an order to other drives.
    fn poll_message(&mut self, now: Instant) -> Option<Message>;
    /// A CAN message arrived whole, for whomever it is.
    fn note_can_message(&mut self) {}
    /// Something went wrong on a wire.
    fn note_line_fault(&mut self, trouble: LineFault) {
        let _ = trouble;
    }
}

/// Differences between installations, and values that the manuals do not state.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Quirks {
    /// Standard of the serial port: RS-232 (also for Ethernet) or RS-485. `None` if nothing is connected:
    /// bytes that are sent there are lost.
    pub wire: Option<TmlWire>,
    /// Protocol of the CAN port: TMLCAN or TechnoCAN. `None` as for the serial port.
    pub can: Option<TmlWire>,
    /// Pause between two bytes that ends a broken frame, ms. \[I\] `None`: the manual has no such pause, only
    /// the synchronisation.
    pub byte_timeout_ms: Option<u32>,
    /// The serial wire takes no time (pty, TCP): nothing is held back for what went before.
    pub untimed: bool,
}

impl Default for Quirks {
    fn default() -> Self {
        let (wire, can) = (Some(TmlWire::Rs232), Some(TmlWire::TmlCan));
        Self { wire, can, byte_timeout_ms: None, untimed: false }
    }
}

/// Messages that wait for the serial line at most.
pub const SERIAL_OUT_MAX: usize = 32;
/// Messages that wait for the CAN bus at most.
pub const CAN_OUT_MAX: usize = 32;

/// The serial end of a drive.
#[derive(Debug)]
pub struct SerialEndpoint {
    quirks: Quirks,
    deframer: Deframer,
    last_byte: Instant,
    /// Acknowledgements and `0D` go before messages.
    control_bytes: [u8; CONTROL_BYTES_MAX],
    control_len: usize,
    out: MessageQueue<SERIAL_OUT_MAX>,
    /// Time at which the last character that was handed out has left.
    free_at: Instant,
    /// Something waits for the line to be free.
    is_waiting: bool,
    baud: u32,
}

/// Single bytes that wait for the line at most.
const CONTROL_BYTES_MAX: usize = 16;

impl SerialEndpoint {
    /// The end of a drive that was just powered.
    #[must_use]
    pub fn new(quirks: Quirks, firmware: &impl Firmware) -> Self {
        Self {
            quirks,
            deframer: Deframer::new(RecoveryPolicy::Drop),
            last_byte: Instant::ZERO,
            control_bytes: [0; CONTROL_BYTES_MAX],
            control_len: 0,
            out: MessageQueue::EMPTY,
            free_at: Instant::ZERO,
            is_waiting: false,
            baud: firmware.baud(),
        }
    }

    /// Takes a byte from the line. A message that it completes was acknowledged, if its kind is.
    pub fn handle_byte(&mut self, now: Instant, byte: u8) -> Option<Message> {
        if let Some(pause) = self.quirks.byte_timeout_ms
            && now > self.last_byte.plus_ms(pause)
        {
            self.deframer.clear();
        }
        self.last_byte = now;
        self.deframer.push(byte);
        match self.deframer.next_piece()? {
            SerialPiece::Message(message) => Some(message),
            SerialPiece::Sync => self.handle_sync(SYNC),
            SerialPiece::Stray(byte) => self.handle_sync(byte),
            // On RS-485 a drive receives the replies and acknowledgements of others too.
            SerialPiece::Ack | SerialPiece::Broken(_) => None,
        }
    }

    /// Queues the acknowledgement of a message to `to`, where the wire has one and it is this
    /// drive's to give.
    pub fn acknowledge(&mut self, to: IdCode, axis: u8) {
        let Some(wire) = self.quirks.wire else { return };
        if wire.acknowledges(to) && (wire == TmlWire::Rs232 || to.id == axis) {
            self.queue_control(ACK);
        }
    }

    /// Queues a message. False if there is no room for it.
    #[must_use]
    pub fn send(&mut self, message: &Message) -> bool {
        self.quirks.wire.is_none() || self.out.push(message)
    }

    /// Bytes were lost or garbled on the wire: the begun frame is dropped.
    pub fn handle_break(&mut self) {
        self.deframer.clear();
    }

    /// Writes the next output into `out`: single bytes first, then one message at a time.
    pub fn poll_transmit(
        &mut self,
        now: Instant,
        out: &mut [u8],
        firmware: &impl Firmware,
    ) -> Option<usize> {
        self.is_waiting = false;
        if now < self.free_at {
            let full = self.control_len > 0 || !self.out.is_empty();
            self.is_waiting = full || self.baud != firmware.baud();
            return None;
        }
        let len = self.take_control_bytes(out);
        if len == 0 {
            self.baud = firmware.baud();
            return None;
        }
        if !self.quirks.untimed {
            self.free_at = now.plus_ns(self.line().characters_ns(len as u32));
        }
        Some(len)
    }

    /// Time at which the line is free for waiting messages.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.is_waiting.then_some(self.free_at)
    }

    /// Present line settings: 8 data bits, 2 stop bits (manual, chapter 3). A new baud rate applies after the
    /// acknowledgement of its own change.
    #[must_use]
    pub fn line(&self) -> SerialLine {
        SerialLine { baud: self.baud, data_bits: 8, parity: Parity::None, stop_bits: 2 }
    }

    /// "0D; larger values are accepted too". Real drives reply to any of them with `0D`. \[I\] On RS-485 no
    /// drive replies, because all would at once.
    fn handle_sync(&mut self, byte: u8) -> Option<Message> {
        if serial::is_sync(byte) && self.quirks.wire == Some(TmlWire::Rs232) {
            self.queue_control(SYNC);
        }
        None
    }

    fn queue_control(&mut self, byte: u8) {
        if let Some(slot) = self.control_bytes.get_mut(self.control_len) {
            *slot = byte;
            self.control_len += 1;
        }
    }

    fn take_control_bytes(&mut self, out: &mut [u8]) -> usize {
        if self.control_len > 0 {
            let len = core::mem::take(&mut self.control_len).min(out.len());
            out[..len].copy_from_slice(&self.control_bytes[..len]);
            return len;
        }
        let Some(message) = self.out.pop() else { return 0 };
        let mut frame = [0; FRAME_MAX];
        let len = serial::encode(&message, &mut frame).min(out.len());
        out[..len].copy_from_slice(&frame[..len]);
        len
    }
}

/// The CAN end of a drive.
#[derive(Debug)]
pub struct CanEndpoint {
    protocol: Option<TmlWire>,
    out: MessageQueue<CAN_OUT_MAX>,
    bit_rate: u32,
}

impl CanEndpoint {
    /// The end of a drive that was just powered.
    #[must_use]
    pub fn new(quirks: Quirks, firmware: &impl Firmware) -> Self {
        Self { protocol: quirks.can, out: MessageQueue::EMPTY, bit_rate: firmware.bit_rate() }
    }

    /// The message in a frame that concerns a drive with this axis ID and these groups, its ID as
    /// the drive's own; `None` for everybody else's, at the least possible cost.
    #[must_use]
    pub fn handle_frame(&self, frame: &Frame, axis: u8, groups: u8) -> Option<Message> {
        if !self.concerns(frame, axis, groups) {
            return None;
        }
        if self.protocol == Some(TmlWire::TmlCan) {
            return tmlcan::decode(frame).ok();
        }
        let mut message = technocan::decode(frame).ok()?.message()?;
        if !message.to.group {
            message.to.id = axis;
        }
        Some(message)
    }

    /// Queues a message. False if there is no room for it, or if it has no place on this bus.
    #[must_use]
    pub fn send(&mut self, message: &Message) -> bool {
        self.protocol.is_none() || self.out.push(message)
    }

    /// The next frame to send. What TechnoCAN cannot carry is dropped.
    pub fn poll_transmit(&mut self, firmware: &impl Firmware) -> Option<Frame> {
        while let Some(message) = self.out.pop() {
            match self.protocol {
                Some(TmlWire::TmlCan) => return Some(tmlcan::encode(&message)),
                _ => {
                    if let Ok(frame) = technocan::encode(&message) {
                        return Some(frame);
                    }
                }
            }
        }
        self.bit_rate = firmware.bit_rate();
        None
    }

    /// Present bus settings.
    #[must_use]
    pub fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }

    /// Looks at the identifier alone.
    fn concerns(&self, frame: &Frame, axis: u8, groups: u8) -> bool {
        let id = frame.id;
        if self.protocol == Some(TmlWire::TmlCan) {
            let to = IdCode { group: id >> 21 & 1 != 0, id: (id >> 13) as u8, host: false };
            return frame.extended && to.concerns(axis, groups);
        }
        let number = id as u8 & technocan::AXIS_MAX;
        match id >> 5 {
            _ if frame.extended => false,
            0x0 => number & groups != 0,
            0x1 | 0x10 => number == 0,
            0x2 | 0x9 | 0xA | 0xB => number != 0 && number == axis & technocan::AXIS_MAX,
            _ => false,
        }
    }
}

/// Messages in the order in which they came.
#[derive(Clone, Debug)]
struct MessageQueue<const N: usize> {
    messages: [Message; N],
    first: usize,
    len: usize,
}

impl<const N: usize> MessageQueue<N> {
    const EMPTY: Self = Self { messages: [EMPTY_MESSAGE; N], first: 0, len: 0 };

    const fn is_empty(&self) -> bool {
        self.len == 0
    }

    fn push(&mut self, message: &Message) -> bool {
        if self.len == N {
            return false;
        }
        self.messages[(self.first + self.len) % N] = *message;
        self.len += 1;
        true
    }

    fn pop(&mut self) -> Option<Message> {
        if self.len == 0 {
            return None;
        }
        let message = self.messages[self.first];
        self.first = (self.first + 1) % N;
        self.len -= 1;
        Some(message)
    }
}

const EMPTY_MESSAGE: Message =
    Message { to: IdCode::BROADCAST, instruction: Instruction::of(0, []) };
