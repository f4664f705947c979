//! The steps of a verb with the bytes that each would send, without sending them.

use crate::explain::Effect;
use crate::medium::Frame;
use crate::plan::Operand;
use crate::profile::ParameterId;
use crate::station::LineChange;

/// Effects of a request in the protocol's own text, determined before it is sent.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct TextRehearsal {
    /// The effect that it may have. What may move a motor needs an armed axis.
    pub effect: Effect,
    /// True if it stops the motor.
    pub is_stop: bool,
    /// True if it [moves bytes](crate::station::Request::moves_bytes).
    pub moves_bytes: bool,
    /// Change of the drive's place on its wire.
    pub line_change: Option<LineChange>,
}

/// Something a rehearsal would do.
#[derive(Clone, Copy, Debug)]
pub struct RehearsalStep<'a> {
    /// Action of the step, and its parameter.
    pub action: RehearsalAction,
    /// The bytes on the wire; a CAN frame's data.
    pub bytes: &'a [u8],
    /// The frame that carries them, on CAN.
    pub frame: Option<&'a Frame>,
}

/// Action of a step in a rehearsal.
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
    /// Writes a value that is read first; the bytes show the read.
    WriteReadValue(ParameterId, ParameterId),
    /// Writes a value that is read first, with these bits changed to these; the bytes show the read.
    WriteBits(ParameterId, i64, i64),
    /// Writes these with one request, values from their operands.
    WriteTogether(&'static [(ParameterId, Operand)]),
    /// Sends the protocol's own request.
    Send,
    /// Reads whether a program of the drive is running.
    QueryProgram,
    /// Ends the drive's program. Where the drive can report whether a program runs, only a running one.
    EndProgram,
    /// Waits, sending nothing.
    Wait(u32),
}
