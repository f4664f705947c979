//! The frame of every exported function: it checks the handle, refuses a fork's child, keeps the error, and lets no
//! panic out.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::error::{CallError, ErrorSlot, PP_DEFECT, PP_FORKED, PP_OK, PP_USAGE, pp_status};

/// A handle that keeps its last error.
pub trait Handle {
    /// Slot of the last error.
    fn errors(&self) -> &ErrorSlot;
}

/// Set in a child process.
static FORKED: AtomicBool = AtomicBool::new(false);

/// Marks children of this process from now on: the threads of a link are not in them.
pub fn watch_forks() {
    #[cfg(unix)]
    {
        static ONCE: std::sync::Once = std::sync::Once::new();
        extern "C" fn in_child() {
            FORKED.store(true, Ordering::Relaxed);
        }
        // SAFETY: the function only stores a flag.
        ONCE.call_once(|| unsafe {
            libc::pthread_atfork(None, None, Some(in_child));
        });
    }
}

/// Returns whether this process is a child of the one that opened its links.
pub fn is_forked() -> bool {
    FORKED.load(Ordering::Relaxed)
}

/// Does the work of a function for a handle.
///
/// # Safety
/// `handle` is NULL, or a handle that was not closed.
pub unsafe fn with_handle<H: Handle>(
    handle: *const H,
    work: impl FnOnce(&H) -> Result<pp_status, CallError>,
) -> pp_status {
    // SAFETY: as promised by the caller.
    let Some(handle) = (unsafe { handle.as_ref() }) else { return PP_USAGE };
    if is_forked() {
        return PP_FORKED;
    }
    match catch_unwind(AssertUnwindSafe(|| work(handle))) {
        Ok(Ok(status)) => status,
        Ok(Err(failure)) => handle.errors().store(failure),
        Err(_) => handle.errors().store(defect()),
    }
}

/// [`run_value`] for work without a result.
///
/// # Safety
/// As [`with_handle`].
pub unsafe fn run<H: Handle>(
    handle: *const H,
    work: impl FnOnce(&H) -> Result<(), CallError>,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { with_handle(handle, |handle| work(handle).map(|()| PP_OK)) }
}

/// Closes a handle. In a fork's child, whose threads are gone, nothing is freed.
///
/// # Safety
/// `handle` is NULL, or comes from [`return_handle`] and is used no more.
pub unsafe fn take_back<H>(handle: *mut H) -> Option<Box<H>> {
    if handle.is_null() || is_forked() {
        return None;
    }
    // SAFETY: as promised by the caller.
    Some(unsafe { Box::from_raw(handle) })
}

/// Gives a handle to the caller.
///
/// # Safety
/// `out` is valid.
pub unsafe fn return_handle<H>(out: *mut *mut H, handle: H) {
    // SAFETY: as promised by the caller.
    unsafe { out.write(Box::into_raw(Box::new(handle))) };
}

/// A panic of the library.
pub fn defect() -> CallError {
    let hint = "the motor may be in any state: stop it by other means, and report the defect";
    CallError::new(PP_DEFECT, "E262", "a defect in the library ended the call", hint)
}
