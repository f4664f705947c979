//! Status codes and errors.

use std::ffi::c_char;
use std::sync::{Mutex, PoisonError};

use polepair::Error;

use crate::fixed_text::copy_text;

/// Result of a call: `PP_OK`, or one of the other `PP_` codes. Codes below 64 are the exit codes of the command line
/// (docs/reference/exit-codes.md).
pub type pp_status = i32;

/// The call is done.
pub const PP_OK: pp_status = 0;
/// The answer is no, or the drive did not keep what was written.
pub const PP_NEGATIVE: pp_status = 1;
/// The caller's words or values are wrong. Nothing was sent.
pub const PP_USAGE: pp_status = 2;
/// The adapter or the port: missing, in use, unplugged.
pub const PP_ADAPTER: pp_status = 3;
/// The drive does not reply.
pub const PP_NO_REPLY: pp_status = 4;
/// Replies are damaged or contradict each other.
pub const PP_CORRUPT: pp_status = 5;
/// The drive refused the request.
pub const PP_REFUSED: pp_status = 6;
/// A part was done.
pub const PP_PARTIAL: pp_status = 7;
/// The drive has a fault.
pub const PP_DRIVE_FAULT: pp_status = 8;
/// The drive reports that it is done, and nothing that it reports shows it.
pub const PP_UNCONFIRMED: pp_status = 9;
/// The request has not ended yet.
pub const PP_PENDING: pp_status = 64;
/// There is nothing to return: no event, no sample, no error.
pub const PP_NOTHING: pp_status = 65;
/// The caller's buffer is too small. The length that it needs is returned.
pub const PP_BUFFER: pp_status = 66;
/// The process is a child of the one that opened the link. Nothing was done.
pub const PP_FORKED: pp_status = 67;
/// A defect in the library. The motor may be in any state: stop it by other means.
pub const PP_DEFECT: pp_status = 68;
/// The wait was interrupted.
pub const PP_INTERRUPTED: pp_status = 130;

/// An error, as `pp_link_error` and its siblings copy it. Texts end with a zero byte; one that is too long is cut.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct pp_error {
    /// Size of this struct, set by the caller: `sizeof(pp_error)`.
    pub size: u32,
    /// Status that the failed call returned.
    pub status: pp_status,
    /// True if the drive executed the request: 1 yes, 0 no, -1 unknown, or in part.
    pub executed: i32,
    /// 1 if the motor may still turn, and only cutting its supply stops it.
    pub may_turn: i32,
    /// Stable code: "E401" (docs/reference/exit-codes.md).
    pub code: [c_char; 32],
    /// Description of the error, in a sentence without full stop.
    pub message: [c_char; 1024],
    /// Remedy to try. May be empty.
    pub hint: [c_char; 512],
}

/// An error of the interface itself, or of the library.
#[derive(Debug)]
pub struct CallError {
    status: pp_status,
    executed: i32,
    may_turn: bool,
    code: String,
    message: String,
    hint: String,
}

impl CallError {
    /// An error of the caller's arguments.
    pub fn usage(message: impl Into<String>, hint: &str) -> Self {
        Self::new(PP_USAGE, "E260", message, hint)
    }

    /// A status with its own words; nothing was executed.
    pub fn new(status: pp_status, code: &str, message: impl Into<String>, hint: &str) -> Self {
        let (code, hint) = (code.to_owned(), hint.to_owned());
        Self { status, executed: 0, may_turn: false, code, message: message.into(), hint }
    }

    /// The wait ended before the request did.
    pub fn time_limit() -> Self {
        let message = "the time limit of the call has passed; the request continues";
        let hint = "the drive may still execute it: raise the limit by pp_axis_set_time_limit";
        Self { executed: -1, ..Self::new(PP_PENDING, "E261", message, hint) }
    }

    fn to_error(&self) -> pp_error {
        let mut error = pp_error {
            size: 0,
            status: self.status,
            executed: self.executed,
            may_turn: self.may_turn.into(),
            code: [0; 32],
            message: [0; 1024],
            hint: [0; 512],
        };
        copy_text(&self.code, &mut error.code);
        copy_text(&self.message, &mut error.message);
        copy_text(&self.hint, &mut error.hint);
        error
    }
}

impl From<Error> for CallError {
    fn from(error: Error) -> Self {
        Self {
            status: error.exit() as i32,
            executed: error.executed().map_or(-1, i32::from),
            may_turn: error.may_turn(),
            code: error.code().to_owned(),
            message: error.to_string(),
            hint: error.hint().to_owned(),
        }
    }
}

/// The last error of a handle.
#[derive(Debug, Default)]
pub struct ErrorSlot(Mutex<Option<CallError>>);

impl ErrorSlot {
    /// Keeps an error, and returns its status.
    pub fn store(&self, failure: CallError) -> pp_status {
        let status = failure.status;
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(failure);
        status
    }

    /// The last error as one text: `E216: message. Hint`.
    pub fn text(&self) -> Option<String> {
        let stored = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        stored.as_ref().map(|CallError { code, message, hint, .. }| {
            if hint.is_empty() {
                format!("{code}: {message}")
            } else {
                format!("{code}: {message}. {hint}")
            }
        })
    }

    /// The last error for the caller.
    pub fn read(&self) -> Option<pp_error> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map(CallError::to_error)
    }
}
