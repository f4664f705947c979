//! A drive on two wires: messages for other axes on its serial port are sent on CAN, messages for its host
//! on CAN are sent on the serial port (TML communication manual, chapters 1 and 2).
//!
//! A drive needs no setting for it: the host uses the axis ID of the connected drive, and the host bit
//! distinguishes the two.

use super::device::{CanEndpoint, Firmware, LineFault, Quirks, SerialEndpoint};
use super::online::OnlineMessage;
use super::rules::TmlWire;
use super::wire::{IdCode, Message};
use crate::medium::{CanLine, Frame, SerialLine};
use crate::station::LineEvent;
use crate::time::Instant;

/// The wires of a drive, one or both of them connected.
#[derive(Debug)]
pub struct Relay {
    quirks: Quirks,
    serial: SerialEndpoint,
    can: CanEndpoint,
    dropped: u64,
}

/// Messages that a firmware may hand over at once.
const MESSAGES_MAX: usize = 64;

impl Relay {
    /// The wires of a drive that was just powered.
    #[must_use]
    pub fn new(quirks: Quirks, firmware: &impl Firmware) -> Self {
        let (serial, can) =
            (SerialEndpoint::new(quirks, firmware), CanEndpoint::new(quirks, firmware));
        Self { quirks, serial, can, dropped: 0 }
    }

    /// Messages that found a queue full.
    #[must_use]
    pub const fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Takes bytes from the serial line, as they come.
    pub fn handle_bytes(&mut self, now: Instant, bytes: &[u8], firmware: &mut impl Firmware) {
        for &byte in bytes {
            if let Some(message) = self.serial.handle_byte(now, byte) {
                if !is_answer(&message) {
                    // The drive at the cable acknowledges for all axes behind it, before it forwards the message
                    // (RS-232).
                    self.serial.acknowledge(message.to, firmware.axis());
                }
                self.handle_serial_message(now, &message, firmware);
            }
        }
    }

    /// Takes a frame from the CAN bus.
    pub fn handle_frame(&mut self, now: Instant, frame: &Frame, firmware: &mut impl Firmware) {
        let (axis, groups) = (firmware.axis(), firmware.groups());
        let Some(message) = self.can.handle_frame(frame, axis, groups) else { return };
        firmware.note_can_message();
        if !message.to.host {
            firmware.execute(now, &message);
        } else if self.quirks.wire == Some(TmlWire::Rs232) {
            self.send_serial(&message, firmware);
        }
    }

    /// Takes what happened to the serial line.
    pub fn handle_serial_line(&mut self, event: LineEvent, firmware: &mut impl Firmware) {
        match event {
            LineEvent::Break => firmware.note_line_fault(LineFault::SerialReceive),
            LineEvent::Down => {}
            _ => return,
        }
        self.serial.handle_break();
    }

    /// Takes what happened to the CAN bus.
    pub fn handle_can_line(&mut self, event: LineEvent, firmware: &mut impl Firmware) {
        if event == LineEvent::BusOff {
            firmware.note_line_fault(LineFault::BusOff);
        }
    }

    /// Writes the next output on the serial line.
    pub fn poll_bytes(
        &mut self,
        now: Instant,
        out: &mut [u8],
        firmware: &mut impl Firmware,
    ) -> Option<usize> {
        self.forward_messages(now, firmware);
        self.serial.poll_transmit(now, out, firmware)
    }

    /// Writes the next frame on the CAN bus.
    pub fn poll_frame(&mut self, now: Instant, firmware: &mut impl Firmware) -> Option<Frame> {
        self.forward_messages(now, firmware);
        self.can.poll_transmit(firmware)
    }

    /// Forwards the drive's messages to their wires. To be called whenever it may have a new one.
    pub fn forward_messages(&mut self, now: Instant, firmware: &mut impl Firmware) {
        // Bounded: a program in the drive may send without end.
        for _ in 0..MESSAGES_MAX {
            let Some(message) = firmware.poll_message(now) else { return };
            let for_host = message.to.host && message.to.id == firmware.axis();
            match self.quirks.wire {
                Some(TmlWire::Rs485) if !is_synchronisation(&message) => {
                    self.send_serial(&message, firmware);
                }
                _ if for_host => self.send_serial(&message, firmware),
                _ => self.send_can(&message, firmware),
            }
        }
    }

    /// Time at which the serial line is free for waiting messages.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.serial.poll_timeout()
    }

    /// Present settings of the serial line.
    #[must_use]
    pub fn serial_line(&self) -> SerialLine {
        self.serial.line()
    }

    /// Present settings of the CAN bus.
    #[must_use]
    pub fn can_line(&self) -> CanLine {
        self.can.line()
    }

    /// Handles a message from the host, or on RS-485 from any sender.
    fn handle_serial_message(
        &mut self,
        now: Instant,
        message: &Message,
        firmware: &mut impl Firmware,
    ) {
        let to = message.to;
        let rs232 = self.quirks.wire == Some(TmlWire::Rs232);
        if to.host && rs232 && to.id == firmware.axis() {
            return; // the host's own address: nobody else has it
        }
        if rs232 && is_for_others(to, firmware.axis()) {
            self.send_can(message, firmware);
        }
        if !to.concerns(firmware.axis(), firmware.groups()) {
            return;
        }
        // On RS-232 axis ID 0 is the drive that is connected (manual, chapter 2): it answers. On the
        // other wires several drives would.
        let is_connected = rs232 && to.id == 0 && !to.group;
        let to = if is_connected { IdCode::axis(firmware.axis()) } else { to };
        firmware.execute(now, &Message { to, ..*message });
    }

    fn send_serial(&mut self, message: &Message, firmware: &mut impl Firmware) {
        if !self.serial.send(message) {
            self.dropped += 1;
            firmware.note_line_fault(LineFault::SerialOverrun);
        }
    }

    fn send_can(&mut self, message: &Message, firmware: &mut impl Firmware) {
        if !self.can.send(message) {
            self.dropped += 1;
            firmware.note_line_fault(LineFault::CanOverrun);
        }
    }
}

fn is_for_others(to: IdCode, axis: u8) -> bool {
    to.group || to.id == 0 || to.id != axis
}

/// Returns whether a message keeps the drives' times together. It goes to the drives on the CAN bus (manual,
/// chapter 5, example 4): on RS-485 only the host begins (chapter 3).
fn is_synchronisation(message: &Message) -> bool {
    let online = OnlineMessage::parse(&message.instruction);
    matches!(online, Some(OnlineMessage::Synchronisation | OnlineMessage::MasterTime(_)))
}

/// Returns whether a message replies to a drive's request to another drive on RS-485: a reply is not acknowledged
/// (manual, chapter 3).
fn is_answer(message: &Message) -> bool {
    use OnlineMessage::{GotData, Pong, TakeChecksum, TakeData, TakeData2, TakeVersion};
    OnlineMessage::parse(&message.instruction).is_some_and(|online| {
        matches!(
            online,
            GotData { .. }
                | Pong { .. }
                | TakeChecksum { .. }
                | TakeData { .. }
                | TakeData2 { .. }
                | TakeVersion { .. }
        )
    })
}
