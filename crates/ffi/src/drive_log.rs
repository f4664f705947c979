//! Recordings in a drive's own memory.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::{c_char, c_void};
use std::ops::ControlFlow;
use std::ptr;

use polepair::{DriveLog, DriveLogRequest, LocalAxis};

use crate::PP_NTS;
use crate::axis::pp_axis;
use crate::coupling::read_memory;
use crate::error::{CallError, pp_status};
use crate::handle::{return_handle, run};
use crate::text::{SizedStruct, read_struct, read_text, write_struct, write_value};
use crate::trace::pp_trace;

/// Function that a recording calls once.
pub type pp_started = Option<unsafe extern "C" fn(context: *mut c_void)>;

/// A recording in a drive's own memory. Set all fields by `pp_drive_log_init`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct pp_drive_log {
    /// Size of this struct, set by the caller.
    pub size: u32,
    /// 1 to accept a layout of the drive's buffer that no public source states.
    pub inferred: i32,
    /// Points a second: 1000 and its parts, up to 10000, on a TML drive.
    pub rate: f64,
    /// Length of the recording: s.
    pub seconds: f64,
    /// Condition of the start, such as "APOS > 1turn", with a zero byte behind it. NULL starts at once.
    pub on: *const c_char,
    /// Called when the recording runs, or while `on` is waited for: it may start a motion of this axis. May be NULL.
    pub started: pp_started,
    /// Argument of `started`.
    pub context: *mut c_void,
    /// First address of the drive's memory that nothing else uses; 0 for the memory that every such drive has.
    pub first_address: u32,
    /// Last address of that memory.
    pub last_address: u32,
}

// SAFETY: size first, then plain numbers and pointers, for which NULL is a value.
unsafe impl SizedStruct for pp_drive_log {}

const USUAL: pp_drive_log = pp_drive_log {
    size: size_of::<pp_drive_log>() as u32,
    inferred: 0,
    rate: 1000.0,
    seconds: 0.2,
    on: ptr::null(),
    started: None,
    context: ptr::null_mut(),
    first_address: 0,
    last_address: 0,
};

/// Sets a recording to 0.2 s with 1000 points a second, at once, in the memory that every such drive has. `size`
/// must be set before.
///
/// # Safety
/// `log` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_drive_log_init(log: *mut pp_drive_log) {
    // SAFETY: as promised by the caller.
    let _ = unsafe { write_struct(log, &USUAL) };
}

/// Records variables in the drive's own control loop, all of a point at one instant, and reads them. Blocks until
/// the points are read. TML drives have such a recorder; nothing moves, except by `started`.
///
/// `variables` are names with commas in between. `*trace` gets the rows for `pp_trace_read`, a value for each
/// variable in SI, until PP_NOTHING. PP_USAGE with E222 if the drive's layout is inferred and `inferred` is 0, with
/// E216 for what does not fit: nothing was sent. `log` may be NULL. Close the trace by `pp_trace_close`.
///
/// Example:
///
/// ```c
/// pp_drive_log log = { sizeof log };
/// pp_drive_log_init(&log);
/// log.inferred = 1;
/// pp_trace *trace;
/// double time, row[2];
/// if (pp_axis_record_in_drive(axis, "POSERR,APOS", PP_NTS, &log, &trace) == PP_OK)
///     while (pp_trace_read(trace, 0, &time, row) == PP_OK)
///         printf("%g %g %g\n", time, row[0], row[1]);
/// ```
///
/// # Safety
/// `axis` is NULL or valid; `variables` has `length` bytes; `log` is NULL or valid; `trace` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_record_in_drive(
    axis: *const pp_axis,
    variables: *const c_char,
    length: usize,
    log: *const pp_drive_log,
    trace: *mut *mut pp_trace,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            write_value(trace, ptr::null_mut())?;
            let options = read_struct(log, USUAL)?;
            let hint = "open the drive's link in this program";
            let local = axis.opened()?.require_local("recording in the drive", hint)?;
            let request = read_request(local, read_text(variables, length)?, &options)?;
            let plan = local.plan_drive_log(&request)?;
            let mut started = options.started;
            let recorded = local.record_in_drive(&plan, |_| {
                if let Some(started) = started.take() {
                    started(options.context);
                }
                ControlFlow::Continue(())
            })?;
            let (rows, columns) = (rows_of(&recorded), recorded.variables.len());
            return_handle(trace, pp_trace::of_rows(rows, columns, axis.closed_flag()));
            Ok(())
        })
    }
}

/// The recording that a caller describes.
///
/// # Safety
/// `options.on` is NULL or ends with a zero byte.
unsafe fn read_request(
    axis: &LocalAxis,
    names: &str,
    options: &pp_drive_log,
) -> Result<DriveLogRequest, CallError> {
    let variables = names.split(',').map(|name| axis.find(name.trim()));
    let start_when = if options.on.is_null() {
        None
    } else {
        // SAFETY: as promised by the caller.
        Some(axis.parse_log_condition(unsafe { read_text(options.on, PP_NTS)? })?)
    };
    let variables = variables.collect::<Result<_, _>>()?;
    Ok(DriveLogRequest {
        start_when,
        memory: read_memory(options.first_address, options.last_address)?,
        accept_inferred: options.inferred != 0,
        ..DriveLogRequest::at_rate(variables, options.rate, options.seconds)?
    })
}

/// Time and values of each point, in SI.
fn rows_of(log: &DriveLog) -> Vec<(f64, Vec<f64>)> {
    let columns: Vec<Vec<f64>> = log.variables.iter().map(|it| it.si_values().collect()).collect();
    let points = columns.first().map_or(0, Vec::len);
    let interval = log.interval.as_secs_f64();
    let row = |at: usize| columns.iter().map(|values| values[at]).collect();
    (0..points).map(|at| (interval * at as f64, row(at))).collect()
}
