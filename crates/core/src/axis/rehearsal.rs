//! The steps of a verb with the bytes that each would send, without sending them.

use crate::medium::Frame;
use crate::profile::ParameterId;

/// Something a rehearsal would do.
#[derive(Clone, Copy, Debug)]
pub struct RehearsalStep<'a> {
    /// What the step does, and to which parameter.
    pub action: RehearsalAction,
    /// The bytes on the wire; a CAN frame's data.
    pub bytes: &'a [u8],
    /// The frame that carries them, on CAN.
    pub frame: Option<&'a Frame>,
}

/// What a rehearsed step does.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum RehearsalAction {
    /// Reads a parameter.
    Read(ParameterId),
    /// Writes a raw value.
    Write(ParameterId, i64),
    /// Has the parameter's value kept over power-off.
    Store(ParameterId),
    /// Writes a raw value if the parameter holds another.
    WriteIfDifferent(ParameterId, i64),
    /// Writes what a read will bring; the bytes show the read.
    WriteReadValue(ParameterId, ParameterId),
    /// Sends the protocol's own request.
    Send,
    /// Asks whether a program of the drive runs.
    QueryProgram,
    /// Ends the drive's program; where it can be asked whether one runs, only if one does.
    EndProgram,
    /// Waits, sending nothing.
    Wait(u32),
}
