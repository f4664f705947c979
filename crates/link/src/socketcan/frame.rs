//! `struct can_frame` of `linux/can.h`, and the meaning of error frames (`linux/can/error.h`).

use polepair_core::medium::Frame;

/// Bytes of a classic frame.
pub(super) const FRAME_LEN: usize = 16;
const EXTENDED: u32 = 0x8000_0000;
const REMOTE: u32 = 0x4000_0000;
const ERROR: u32 = 0x2000_0000;

const CONTROLLER: u32 = 0x04;
const BUS_OFF: u32 = 0x40;
const RESTARTED: u32 = 0x100;
/// Transmit time-out, protocol violation, transceiver, no acknowledgement, bus error.
const WIRE_ERRORS: u32 = 0x01 | 0x08 | 0x10 | 0x20 | 0x80;
/// `data[1]` of a controller's problem: receive and transmit overflow; error-active again.
const OVERFLOW: u8 = 0x03;
const ACTIVE: u8 = 0x40;

/// Content of a frame from the kernel.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum UnpackedFrame {
    Frame(Frame),
    Error(CanErrorReport),
}

/// Report of the controller about itself and the wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) struct CanErrorReport {
    /// True if the controller is disconnected from the bus.
    pub(super) bus_off: bool,
    /// True if the controller is connected to the bus again.
    pub(super) active: bool,
    /// Frames were lost in the controller.
    pub(super) overflow: bool,
    /// Something was wrong on the wire.
    pub(super) wire_error: bool,
}

pub(super) fn pack(frame: &Frame) -> [u8; FRAME_LEN] {
    let extended = if frame.extended { EXTENDED } else { 0 };
    let remote = if frame.remote { REMOTE } else { 0 };
    let mut out = [0; FRAME_LEN];
    out[..4].copy_from_slice(&(frame.id | extended | remote).to_ne_bytes());
    out[4] = frame.len.min(8);
    if !frame.remote {
        out[8..].copy_from_slice(&frame.data);
    }
    out
}

/// `None` for a text that is no classic frame.
pub(super) fn unpack(bytes: &[u8]) -> Option<UnpackedFrame> {
    let bytes: &[u8; FRAME_LEN] = bytes.try_into().ok()?;
    let word = u32::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let (extended, remote, len) = (word & EXTENDED != 0, word & REMOTE != 0, bytes[4]);
    if len > 8 {
        return None;
    }
    if word & ERROR != 0 {
        return Some(UnpackedFrame::Error(error_frame(word, bytes[9])));
    }
    let id = word & if extended { 0x1FFF_FFFF } else { 0x7FF };
    let mut frame = Frame { id, extended, remote, len, data: [0; 8] };
    let data_len = if remote { 0 } else { usize::from(len) };
    frame.data[..data_len].copy_from_slice(&bytes[8..8 + data_len]);
    Some(UnpackedFrame::Frame(frame))
}

const fn error_frame(class: u32, controller: u8) -> CanErrorReport {
    let controller = if class & CONTROLLER != 0 { controller } else { 0 };
    CanErrorReport {
        bus_off: class & BUS_OFF != 0,
        active: class & RESTARTED != 0 || controller & ACTIVE != 0,
        overflow: controller & OVERFLOW != 0,
        wire_error: class & WIRE_ERRORS != 0,
    }
}
