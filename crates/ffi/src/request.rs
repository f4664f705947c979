//! Requests that run while the program does something else: begin, poll or wait, close.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_char;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use polepair::interface::{AxisRequest, ReadValue, WriteValue};
use polepair::{Amount, Axis};
use polepair_core::profile::ParameterId;

use crate::axis::pp_axis;
use crate::error::{CallError, ErrorSlot, PP_INTERRUPTED, PP_OK, PP_PENDING, pp_error, pp_status};
use crate::handle::{Handle, return_handle, run, take_back, with_handle};
use crate::link::{check_open, copy_error, copy_error_text, read_seconds};
use crate::motion::{build_command, pp_motion, pp_verb};
use crate::text::{read_text, write_bytes, write_value};

/// Time limit for the request of a motion to end after its stop.
const CANCEL_WAIT_MAX: Duration = Duration::from_secs(10);

/// A request that was begun.
#[derive(Debug)]
pub struct pp_request {
    state: Mutex<RequestProgress>,
    axis: Axis,
    purpose: RequestPurpose,
    closed: Arc<AtomicBool>,
    errors: ErrorSlot,
}

#[derive(Clone, Copy, Debug)]
enum RequestPurpose {
    Read(ParameterId),
    Write,
    Motion,
}

#[derive(Debug)]
enum RequestProgress {
    Running(AxisRequest),
    Done(Option<ReadValue>),
    /// Result that every later poll returns.
    Failed(pp_status),
}

impl Handle for pp_request {
    fn errors(&self) -> &ErrorSlot {
        &self.errors
    }
}

impl pp_request {
    fn lock(&self) -> MutexGuard<'_, RequestProgress> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Continues it, at most for this time.
    fn wait(&self, at_most: Duration) -> pp_status {
        let mut state = self.lock();
        let RequestProgress::Running(request) = &mut *state else {
            return if let RequestProgress::Failed(status) = *state { status } else { PP_OK };
        };
        let ended = check_open(&self.closed).and_then(|()| {
            let Some(reply) = request.wait(at_most)? else { return Ok(None) };
            let RequestPurpose::Read(id) = self.purpose else { return Ok(Some(None)) };
            Ok(Some(Some(self.axis.interface().reading(id, reply)?)))
        });
        match ended {
            Ok(None) => PP_PENDING,
            Ok(Some(read)) => {
                *state = RequestProgress::Done(read);
                PP_OK
            }
            Err(failure) => {
                let status = self.errors.store(failure);
                *state = RequestProgress::Failed(status);
                status
            }
        }
    }

    /// Ends it before its time.
    fn cancel(&self) -> Result<pp_status, CallError> {
        if !matches!(*self.lock(), RequestProgress::Running(_)) {
            return Ok(PP_OK);
        }
        match self.purpose {
            RequestPurpose::Read(_) => {
                let cancelled =
                    CallError::new(PP_INTERRUPTED, "E130", "the request was cancelled", "");
                *self.lock() = RequestProgress::Failed(self.errors.store(cancelled));
                Ok(PP_OK)
            }
            RequestPurpose::Write => {
                let hint = "wait for its end: the drive executes what it has received";
                Err(CallError::usage("a write that was begun cannot be cancelled", hint))
            }
            RequestPurpose::Motion => {
                check_open(&self.closed)?;
                self.axis.stop()?;
                // How the motion ended is the request's own result.
                let status = self.wait(CANCEL_WAIT_MAX);
                Ok(if status == PP_PENDING { PP_PENDING } else { PP_OK })
            }
        }
    }

    /// Value that the request has read.
    fn reading(&self) -> Result<ReadValue, CallError> {
        match &*self.lock() {
            RequestProgress::Done(Some(read)) => Ok(read.clone()),
            RequestProgress::Done(None) => {
                Err(CallError::usage("this request reads nothing", "begin it by pp_axis_begin_get"))
            }
            _ => {
                let hint = "poll or wait until PP_OK is returned";
                Err(CallError::usage("the request has no result", hint))
            }
        }
    }
}

unsafe fn begin(
    axis: *const pp_axis,
    out: *mut *mut pp_request,
    start: impl FnOnce(&Axis) -> Result<(AxisRequest, RequestPurpose), CallError>,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            write_value(out, std::ptr::null_mut())?;
            let opened = axis.opened()?;
            let (request, purpose) = start(opened)?;
            let (state, closed) =
                (Mutex::new(RequestProgress::Running(request)), axis.closed_flag());
            let (axis, errors) = (opened.clone(), ErrorSlot::default());
            return_handle(out, pp_request { state, axis, purpose, closed, errors });
            Ok(())
        })
    }
}

/// Begins to read a parameter, and returns at once. As `pp_axis_get`.
///
/// Example:
///
/// ```c
/// pp_request *request;
/// pp_axis_begin_get(axis, "max current", PP_NTS, &request);
/// while (pp_request_poll(request) == PP_PENDING)
///     do_something_else();
/// double value;
/// pp_request_value(request, &value);
/// pp_request_close(request);
/// ```
///
/// # Safety
/// `axis` is NULL or valid; `name` has `length` bytes; `request` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_begin_get(
    axis: *const pp_axis,
    name: *const c_char,
    length: usize,
    request: *mut *mut pp_request,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        begin(axis, request, |axis| {
            let id = axis.find(read_text(name, length)?)?;
            Ok((axis.interface().start_read(id)?, RequestPurpose::Read(id)))
        })
    }
}

/// Begins to write a parameter, and returns at once. As `pp_axis_set_text`.
///
/// # Safety
/// `axis` is NULL or valid; the texts have their lengths; `request` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_begin_set_text(
    axis: *const pp_axis,
    name: *const c_char,
    length: usize,
    value: *const c_char,
    value_length: usize,
    store: i32,
    request: *mut *mut pp_request,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        begin(axis, request, |axis| {
            let value = WriteValue::Amount(Amount::from(read_text(value, value_length)?));
            let request = axis.start_write(read_text(name, length)?, value, store != 0)?;
            Ok((request, RequestPurpose::Write))
        })
    }
}

/// Begins a verb, and returns at once. As `pp_axis_run`; limits are checked before.
///
/// # Safety
/// `axis` and `limits` are NULL or valid; `request` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_begin(
    axis: *const pp_axis,
    verb: pp_verb,
    target: f64,
    limits: *const pp_motion,
    request: *mut *mut pp_request,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        begin(axis, request, |axis| {
            Ok((axis.start(build_command(verb, target, limits)?)?, RequestPurpose::Motion))
        })
    }
}

/// Polls a request: PP_PENDING before its end, PP_OK if it was executed, otherwise the status of its failure.
///
/// # Safety
/// `request` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_request_poll(request: *const pp_request) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { with_handle(request, |request| Ok(request.wait(Duration::ZERO))) }
}

/// Waits for the end of a request, at most `seconds`. Returns the same as `pp_request_poll`.
///
/// # Safety
/// `request` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_request_wait(request: *const pp_request, seconds: f64) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { with_handle(request, |request| Ok(request.wait(read_seconds(seconds)?))) }
}

/// Cancels a request.
///
/// A verb (`pp_axis_begin`): the axis is stopped, as by `pp_axis_stop`, and the request ends. A read ends at once, and
/// `pp_request_poll` then returns PP_INTERRUPTED. A write cannot be cancelled: PP_USAGE, and it continues. For a
/// request that has ended already, nothing is done.
///
/// Returns PP_OK; PP_PENDING if the axis was stopped and the request has not ended within 10 s; the error of the stop.
/// Thread-safe.
///
/// Example:
///
/// ```c
/// pp_axis_begin(axis, PP_HOME, 0, NULL, &request);
/// if (pp_request_wait(request, 30.0) == PP_PENDING)
///     pp_request_cancel(request);
/// pp_request_close(request);
/// ```
///
/// # Safety
/// `request` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_request_cancel(request: *const pp_request) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { with_handle(request, pp_request::cancel) }
}

/// Gives the value that a request has read, in the unit of its parameter. PP_USAGE before its end.
///
/// # Safety
/// `request` is NULL or valid; `value` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_request_value(
    request: *const pp_request,
    value: *mut f64,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { run(request, |request| write_value(value, request.reading()?.value)) }
}

/// Gives the value that a request has read, raw as on the wire. PP_USAGE before its end.
///
/// # Safety
/// `request` is NULL or valid; `value` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_request_raw(request: *const pp_request, value: *mut i64) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(request, |request| {
            let read = request.reading()?;
            write_value(value, read.require_raw(&read.name)?)
        })
    }
}

/// Gives the value that a request has read, as text. PP_USAGE before its end. The buffer is used as in `pp_link_url`.
///
/// # Safety
/// `request` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_request_text(
    request: *const pp_request,
    buffer: *mut c_char,
    capacity: usize,
    needed: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        with_handle(request, |request| {
            let text = request.reading()?.text;
            Ok(write_bytes(text.as_bytes(), true, buffer.cast(), capacity, needed))
        })
    }
}

/// Copies the error of a request. PP_NOTHING if it has none.
///
/// # Safety
/// `request` and `error` are NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_request_error(
    request: *const pp_request,
    error: *mut pp_error,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { copy_error(request, error) }
}

/// Copies the last error of a request handle as one text, for languages without structs: "E216: axis 1: …". PP_NOTHING
/// if no call has failed. As `pp_link_url` for the buffer.
///
/// # Safety
/// `request` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_request_error_text(
    request: *const pp_request,
    buffer: *mut c_char,
    capacity: usize,
    needed: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { copy_error_text(request, buffer, capacity, needed) }
}

/// Closes a request. One that has not ended continues: a motion is ended by `pp_axis_stop`.
///
/// # Safety
/// `request` is NULL or a handle that no other thread uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_request_close(request: *mut pp_request) {
    // SAFETY: as promised by the caller.
    drop(unsafe { take_back(request) });
}
