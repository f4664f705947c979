//! Links: opening, closing, stopping.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_char;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use polepair::interface::stop_each;
use polepair::{Axis, Error, Link};

use crate::error::{
    CallError, ErrorSlot, PP_FORKED, PP_NOTHING, PP_OK, PP_USAGE, pp_error, pp_status,
};
use crate::handle::{
    Handle, defect, is_forked, return_handle, run, take_back, watch_forks, with_handle,
};
use crate::link_events::LinkEvents;
use crate::text::{SizedStruct, read_text, write_bytes, write_struct, write_value};

/// A link: a serial port, a CAN bus, a simulation, or the axes of a running server.
#[derive(Debug)]
pub struct pp_link {
    link: Option<Link>,
    closed: Arc<AtomicBool>,
    pub(crate) events: Mutex<Option<LinkEvents>>,
    errors: ErrorSlot,
}

// SAFETY: size first, then plain numbers and bytes.
unsafe impl SizedStruct for pp_error {}

impl Handle for pp_link {
    fn errors(&self) -> &ErrorSlot {
        &self.errors
    }
}

impl pp_link {
    /// The link, if it was opened.
    pub(crate) fn opened(&self) -> Result<&Link, CallError> {
        let hint = "pp_link_error says why; close the handle, and open another one";
        self.link.as_ref().ok_or_else(|| CallError::usage("the link was not opened", hint))
    }

    /// Flag by which the axes see that it was closed.
    pub(crate) fn closed_flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.closed)
    }
}

/// Copies the last error of a handle.
///
/// # Safety
/// `handle` and `out` are NULL or valid.
pub(crate) unsafe fn copy_error<H: Handle>(handle: *const H, out: *mut pp_error) -> pp_status {
    // SAFETY: as promised by the caller.
    let Some(handle) = (unsafe { handle.as_ref() }) else { return PP_USAGE };
    let Some(error) = handle.errors().read() else { return PP_NOTHING };
    // SAFETY: as promised by the caller.
    match unsafe { write_struct(out, &error) } {
        Ok(()) => PP_OK,
        Err(_) => PP_USAGE,
    }
}

/// Copies the last error of a handle as one text.
///
/// # Safety
/// `handle` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
pub(crate) unsafe fn copy_error_text<H: Handle>(
    handle: *const H,
    buffer: *mut c_char,
    capacity: usize,
    needed: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    let Some(handle) = (unsafe { handle.as_ref() }) else { return PP_USAGE };
    let Some(text) = handle.errors().text() else { return PP_NOTHING };
    // SAFETY: as promised by the caller.
    unsafe { write_bytes(text.as_bytes(), true, buffer.cast(), capacity, needed) }
}

/// Opens a link by its connection string, and finds out which drives are there.
///
/// `url` is as on the command line: "tmcl+serial:///dev/ttyUSB0#1", "tml+serial://COM3#1", "sim:tmcl",
/// "ws://host:7365" (docs/reference/connection-strings.md). `*link` is set even if the link
/// cannot be opened: the handle then keeps the error, and must be closed. It is NULL only in a child process after
/// `fork`. Nothing moves.
///
/// Returns PP_OK; PP_USAGE for a wrong connection string; PP_ADAPTER for a port that is missing or in use;
/// PP_NO_REPLY if a drive does not reply. Blocks until the drives have replied. Thread-safe.
///
/// Example:
///
/// ```c
/// pp_link *link;
/// if (pp_link_open("sim:tmcl", PP_NTS, &link) != PP_OK) {
///     pp_error error = { .size = sizeof error };
///     pp_link_error(link, &error);
///     fprintf(stderr, "%s. %s\n", error.message, error.hint);
/// }
/// ```
///
/// # Safety
/// `url` has `length` bytes; `link` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_open(
    url: *const c_char,
    length: usize,
    link: *mut *mut pp_link,
) -> pp_status {
    if link.is_null() {
        return PP_USAGE;
    }
    if is_forked() {
        // SAFETY: as promised by the caller.
        unsafe { link.write(std::ptr::null_mut()) };
        return PP_FORKED;
    }
    watch_forks();
    // SAFETY: as promised by the caller.
    let opened = std::panic::catch_unwind(|| unsafe {
        Ok::<_, CallError>(polepair::connect(read_text(url, length)?)?)
    });
    let errors = ErrorSlot::default();
    let (opened, status) = match opened.unwrap_or_else(|_| Err(defect())) {
        Ok(opened) => (Some(opened), PP_OK),
        Err(failure) => (None, errors.store(failure)),
    };
    let (closed, events) = (Arc::default(), Mutex::default());
    // SAFETY: as promised by the caller.
    unsafe { return_handle(link, pp_link { link: opened, closed, events, errors }) };
    status
}

/// Closes a link: stops, disables and disarms every axis that this program armed by it, then closes the wire.
///
/// All stops are sent before the first is waited for; a stop without a reply is repeated for ten seconds.
/// `error` may be NULL; if an axis could not be stopped, it gets the error. The handle is invalid afterwards,
/// whatever is returned. Handles of its axes stay valid until they are closed, and refuse to work. `link` may be
/// NULL. Must not be called from an event handler of the same link.
///
/// # Safety
/// `link` is NULL or a handle that no other thread uses; `error` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_close(link: *mut pp_link, error: *mut pp_error) -> pp_status {
    // SAFETY: as promised by the caller.
    let Some(handle) = (unsafe { take_back(link) }) else { return PP_OK };
    handle.closed.store(true, Ordering::SeqCst);
    let closed = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        drop(handle.events.lock().unwrap_or_else(PoisonError::into_inner).take());
        let Some(opened) = &handle.link else { return Ok(()) };
        let stopped = release_armed(opened.axes());
        opened.clone().close();
        stopped
    }));
    let failure = match closed {
        Ok(Ok(())) => return PP_OK,
        Ok(Err(failure)) => CallError::from(failure),
        Err(_) => defect(),
    };
    let status = handle.errors.store(failure);
    // SAFETY: as promised by the caller.
    unsafe { copy_error(&raw const *handle, error) };
    status
}

/// Stops, disables and disarms the armed ones of these axes; the first error, after all were tried.
fn release_armed(axes: &[Axis]) -> Result<(), Error> {
    let armed = axes.iter().filter(|axis| axis.is_armed());
    let armed: Vec<(Axis, bool)> = armed.map(|axis| (axis.clone(), true)).collect();
    let stopped = stop_each(&armed, |_, _| true);
    let mut first = Ok(());
    for ((axis, _), stopped) in armed.iter().zip(stopped) {
        first = first.and(stopped.into_result()).and(axis.disarm());
    }
    first
}

/// Copies the last error of a link. PP_NOTHING if no call has failed.
///
/// # Safety
/// `link` and `error` are NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_error(link: *const pp_link, error: *mut pp_error) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { copy_error(link, error) }
}

/// Copies the last error of a link handle as one text, for languages without structs: "E216: axis 1: …". PP_NOTHING
/// if no call has failed. As `pp_link_url` for the buffer.
///
/// # Safety
/// `link` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_error_text(
    link: *const pp_link,
    buffer: *mut c_char,
    capacity: usize,
    needed: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { copy_error_text(link, buffer, capacity, needed) }
}

/// The number of axes of a link.
///
/// # Safety
/// `link` is NULL or valid; `count` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_axis_count(link: *const pp_link, count: *mut usize) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { run(link, |link| write_value(count, link.opened()?.axes().len())) }
}

/// Copies the connection string of a link, with a zero byte behind it.
///
/// `*needed` gets its length in bytes without the zero byte; `buffer` may be NULL to ask for it. PP_BUFFER if
/// `capacity` is too small.
///
/// # Safety
/// `link` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_url(
    link: *const pp_link,
    buffer: *mut c_char,
    capacity: usize,
    needed: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        with_handle(link, |link| {
            let url = link.opened()?.url();
            Ok(write_bytes(url.as_bytes(), true, buffer.cast(), capacity, needed))
        })
    }
}

/// Stops every axis of a link, armed by this program or not, and returns when standstill is confirmed.
///
/// All stops are sent before the first is waited for. On a server, axes are stopped also while other clients command
/// them. If `may_turn` of the error is 1, cut the supply. Thread-safe: a stop overtakes requests of other threads.
///
/// # Safety
/// `link` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_stop_all(link: *const pp_link) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { run(link, |link| Ok(link.opened()?.stop_all()?)) }
}

/// Waits on the clock of a link: in a simulation with `time=virtual`, time passes at once.
///
/// # Safety
/// `link` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_sleep(link: *const pp_link, seconds: f64) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(link, |link| {
            link.opened()?.sleep(read_seconds(seconds)?);
            Ok(())
        })
    }
}

/// A time of the caller's in seconds.
pub(crate) fn read_seconds(seconds: f64) -> Result<Duration, CallError> {
    Duration::try_from_secs_f64(seconds)
        .map_err(|_| CallError::usage(format!("{seconds} s is no time"), "pass seconds from 0 on"))
}

/// Refuses a call on a link that was closed, or in a fork's child.
pub(crate) fn check_open(closed: &AtomicBool) -> Result<(), CallError> {
    if is_forked() || closed.load(Ordering::SeqCst) {
        return Err(CallError::usage("the link of this handle was closed", "open it again"));
    }
    Ok(())
}
