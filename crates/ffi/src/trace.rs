//! Traces: signals again and again, with their times.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_char;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use polepair::Axis;
use polepair::remote::SampleRows;
use polepair_core::profile::Signal;
use polepair_core::time::Instant;

use crate::axis::pp_axis;
use crate::error::{CallError, ErrorSlot, PP_NOTHING, PP_OK, pp_error, pp_status};
use crate::handle::{Handle, return_handle, run, take_back, with_handle};
use crate::link::{check_open, copy_error, copy_error_text, read_seconds};
use crate::signal::{pp_signal, read_signals};
use crate::text::write_value;

/// A trace of an axis.
#[derive(Debug)]
pub struct pp_trace {
    source: Mutex<TraceSource>,
    columns: usize,
    closed: Arc<AtomicBool>,
    errors: ErrorSlot,
}

#[derive(Debug)]
enum TraceSource {
    /// A drive on a wire of this program is read.
    Polled { axis: Axis, signals: Vec<Signal>, period: Duration, began: Instant, next: Instant },
    /// A server sends rows.
    Pushed { axis: Axis, rows: SampleRows },
    /// The drive has recorded them.
    Recorded { rows: std::vec::IntoIter<(f64, Vec<f64>)> },
}

impl pp_trace {
    /// A trace of rows that are there already: time in seconds and a value for each column.
    pub(crate) fn of_rows(
        rows: Vec<(f64, Vec<f64>)>,
        columns: usize,
        closed: Arc<AtomicBool>,
    ) -> Self {
        let source = Mutex::new(TraceSource::Recorded { rows: rows.into_iter() });
        Self { source, columns, closed, errors: ErrorSlot::default() }
    }
}

impl Handle for pp_trace {
    fn errors(&self) -> &ErrorSlot {
        &self.errors
    }
}

/// Begins a trace: a row of signals every `period` seconds.
///
/// A drive on a wire of this program is read by `pp_trace_read` itself, on the thread that calls it: rows that the
/// wire is too slow for are left out, not interpolated. A server sends rows by itself.
///
/// Example:
///
/// ```c
/// pp_signal signals[] = { PP_SIGNAL_POSITION, PP_SIGNAL_VELOCITY };
/// pp_trace *trace;
/// pp_axis_trace(axis, signals, 2, 0.01, &trace);
/// double time, row[2];
/// while (pp_trace_read(trace, 1.0, &time, row) == PP_OK && time < 2.0)
///     printf("%g %g %g\n", time, row[0], row[1]);
/// pp_trace_close(trace);
/// ```
///
/// # Safety
/// `axis` is NULL or valid; `signals` has `count` elements; `trace` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_trace(
    axis: *const pp_axis,
    signals: *const pp_signal,
    count: usize,
    period: f64,
    trace: *mut *mut pp_trace,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            write_value(trace, std::ptr::null_mut())?;
            let (opened, signals) = (axis.opened()?, read_signals(signals, count)?);
            let missing = signals.iter().find(|signal| !opened.has_signal(**signal));
            if let Some(signal) = missing {
                let what = format!("{} does not report {}", opened.label(), signal.name());
                return Err(CallError::usage(what, "pp_axis_has_signal tells what it reports"));
            }
            let period = read_seconds(period)?;
            let source = match opened.remote() {
                Some(remote) => {
                    let rows = remote.subscribe(&signals, period.as_secs_f64())?;
                    TraceSource::Pushed { axis: opened.clone(), rows }
                }
                None => {
                    let (axis, began) = (opened.clone(), opened.interface().now());
                    TraceSource::Polled { axis, signals, period, began, next: began }
                }
            };
            let (source, closed) = (Mutex::new(source), axis.closed_flag());
            return_handle(
                trace,
                pp_trace { source, columns: count, closed, errors: ErrorSlot::default() },
            );
            Ok(())
        })
    }
}

/// Reads the next row of a trace. Waits for it at most `seconds`, then returns PP_NOTHING.
///
/// `*time` gets seconds: since the trace began, or since the start of the server. `row` gets a value for each
/// signal, in the order of `pp_axis_trace`.
///
/// # Safety
/// `trace` is NULL or valid; `time` is valid; `row` has as many elements as the trace has signals.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_trace_read(
    trace: *const pp_trace,
    seconds: f64,
    time: *mut f64,
    row: *mut f64,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        with_handle(trace, |trace| {
            check_open(&trace.closed)?;
            if row.is_null() {
                return Err(CallError::usage("the pointer for a result is NULL", ""));
            }
            let at_most = read_seconds(seconds)?;
            let mut source = trace.source.lock().unwrap_or_else(PoisonError::into_inner);
            let Some((at, values)) = next_row(&mut source, at_most)? else { return Ok(PP_NOTHING) };
            write_value(time, at)?;
            for (place, value) in values.iter().take(trace.columns).enumerate() {
                row.add(place).write(*value);
            }
            Ok(PP_OK)
        })
    }
}

fn next_row(
    source: &mut TraceSource,
    at_most: Duration,
) -> Result<Option<(f64, Vec<f64>)>, CallError> {
    match source {
        TraceSource::Recorded { rows } => Ok(rows.next()),
        TraceSource::Pushed { axis, rows } => {
            // A sample of one signal alone ends a wait without a row.
            let (interface, mut left) = (axis.interface(), at_most);
            let began = interface.now();
            loop {
                let row = rows.wait(left).map_err(polepair::Error::from)?;
                if row.is_some() || left.is_zero() {
                    return Ok(row);
                }
                left = at_most.saturating_sub(interface.now().since(began));
            }
        }
        TraceSource::Polled { axis, signals, period, began, next } => {
            let interface = axis.interface();
            let due = next.since(interface.now());
            interface.sleep(due.min(at_most));
            if due > at_most {
                return Ok(None);
            }
            let (at, values) = (interface.now(), axis.signals(signals)?);
            // Rows that are late are left out.
            *next = (*next + *period).max(at);
            let values = values.iter().map(|reading| reading.value).collect();
            Ok(Some((at.since(*began).as_secs_f64(), values)))
        }
    }
}

/// Copies the last error of a trace. PP_NOTHING if no call has failed.
///
/// # Safety
/// `trace` and `error` are NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_trace_error(trace: *const pp_trace, error: *mut pp_error) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { copy_error(trace, error) }
}

/// Copies the last error of a trace handle as one text, for languages without structs: "E216: axis 1: …". PP_NOTHING
/// if no call has failed. As `pp_link_url` for the buffer.
///
/// # Safety
/// `trace` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_trace_error_text(
    trace: *const pp_trace,
    buffer: *mut c_char,
    capacity: usize,
    needed: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { copy_error_text(trace, buffer, capacity, needed) }
}

/// Ends a trace.
///
/// # Safety
/// `trace` is NULL or a handle that no other thread uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_trace_close(trace: *mut pp_trace) {
    // SAFETY: as promised by the caller.
    drop(unsafe { take_back(trace) });
}
