//! The frame of every exported function: it keeps the error's text, and lets no panic out.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::cell::RefCell;
use std::ffi::{CStr, CString};
use std::fmt::Display;
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::{Bool, Text};

/// Reason why a function failed, in words, with what to try.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct TmlError(String);

/// Result of a function.
pub type CallResult<T> = Result<T, TmlError>;

impl TmlError {
    /// An error with nothing to try.
    pub fn new(text: impl Into<String>) -> Self {
        Self(text.into())
    }

    /// The error of a link or drive, for an instruction that was sent as words.
    pub fn of_instruction(error: &polepair::Error, words: &str, instruction: &str) -> Self {
        Self(Self::from(error).0.replace(words, instruction))
    }
}

impl Display for TmlError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl From<&polepair::Error> for TmlError {
    fn from(error: &polepair::Error) -> Self {
        let hint = error.hint();
        Self(if hint.is_empty() { error.to_string() } else { format!("{error}: {hint}") })
    }
}

impl From<polepair::Error> for TmlError {
    fn from(error: polepair::Error) -> Self {
        Self::from(&error)
    }
}

thread_local! {
    /// Text of this thread's last error. Programs hold its pointer until the next call.
    static LAST_ERROR: RefCell<CString> = RefCell::default();
    /// Instructions that this thread's last function sent.
    static SENT: RefCell<String> = const { RefCell::new(String::new()) };
}

/// The text of the last error, valid until the thread's next function fails.
pub fn last_error() -> Text {
    LAST_ERROR.with_borrow(|text| text.as_ptr())
}

/// The text of the last error.
pub fn last_error_text() -> String {
    LAST_ERROR.with_borrow(|text| text.to_string_lossy().into_owned())
}

/// Instructions that this thread's last function sent, one a line.
pub fn sent_text() -> String {
    SENT.with_borrow(Clone::clone)
}

/// Notes an instruction that was sent.
pub fn note_sent(instruction: &str) {
    SENT.with_borrow_mut(|sent| {
        sent.push_str(instruction);
        sent.push_str(";\n");
    });
}

/// Runs the work of a function. Its error is kept, with the function's name.
pub fn run<T>(function: &str, failed: T, work: impl FnOnce() -> CallResult<T>) -> T {
    let outcome = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| {
        Err(TmlError::new(
            "a defect in the library ended the call: the motor may be in any state, stop it by other means",
        ))
    });
    outcome.unwrap_or_else(|error| {
        let text = format!("{function}: {error}").replace('\0', " ");
        LAST_ERROR.set(CString::new(text).unwrap_or_default());
        failed
    })
}

/// [`run`] for a function whose result is `TRUE` or `FALSE`. It may send instructions.
pub fn run_bool(function: &str, work: impl FnOnce() -> CallResult<()>) -> Bool {
    SENT.with_borrow_mut(String::clear);
    run(function, 0, || work().map(|()| 1))
}

/// The caller's text.
///
/// # Safety
/// `text` is NULL or ends with a zero byte.
pub unsafe fn read_text(text: Text) -> CallResult<String> {
    if text.is_null() {
        return Err(TmlError::new("a text is NULL"));
    }
    // SAFETY: as promised by the caller.
    let text = unsafe { CStr::from_ptr(text) };
    Ok(text.to_string_lossy().into_owned())
}

/// Writes a result.
///
/// # Safety
/// `out` is NULL or valid.
pub unsafe fn write_value<T>(out: *mut T, value: T) -> CallResult<()> {
    if out.is_null() {
        return Err(TmlError::new("the pointer for a result is NULL"));
    }
    // SAFETY: as promised by the caller.
    unsafe { out.write(value) };
    Ok(())
}

/// The caller's array.
///
/// # Safety
/// `values` is NULL or has `count` values.
pub unsafe fn read_array<'a, T>(values: *const T, count: usize) -> CallResult<&'a [T]> {
    if values.is_null() {
        return Err(TmlError::new("an array is NULL"));
    }
    // SAFETY: as promised by the caller.
    Ok(unsafe { std::slice::from_raw_parts(values, count) })
}

/// Copies a text into the caller's buffer, as much as fits, with a zero byte behind it.
///
/// # Safety
/// `buffer` is NULL or has `capacity` bytes.
pub unsafe fn write_text(
    text: &str,
    buffer: *mut std::ffi::c_char,
    capacity: usize,
) -> CallResult<()> {
    if buffer.is_null() || capacity == 0 {
        return Err(TmlError::new("there is no buffer for the text"));
    }
    let length = text.len().min(capacity - 1);
    // SAFETY: as promised by the caller; one byte is left for the zero.
    unsafe {
        std::ptr::copy_nonoverlapping(text.as_ptr(), buffer.cast(), length);
        buffer.add(length).write(0);
    }
    Ok(())
}
