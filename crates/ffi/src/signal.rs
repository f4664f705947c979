//! Signals: the present state of an axis.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_char;

use polepair_core::profile::Signal;

use crate::axis::pp_axis;
use crate::error::{CallError, PP_NOTHING, PP_OK, pp_status};
use crate::fixed_text::copy_text;
use crate::handle::{run, with_handle};
use crate::text::{SizedStruct, write_struct, write_value};

/// A signal. Values are SI: rad, rad/s, N·m (or what the drive has in its place), A, V, K; m and m/s on a linear
/// axis. Flags are 0 or 1; codes and modes are the drive's own numbers.
pub type pp_signal = i32;

/// Position: rad or m.
pub const PP_SIGNAL_POSITION: pp_signal = 0;
/// Velocity: rad/s or m/s.
pub const PP_SIGNAL_VELOCITY: pp_signal = 1;
/// Torque.
pub const PP_SIGNAL_TORQUE: pp_signal = 2;
/// Motor current: A.
pub const PP_SIGNAL_CURRENT: pp_signal = 3;
/// Supply voltage: V.
pub const PP_SIGNAL_VOLTAGE: pp_signal = 4;
/// Temperature: K.
pub const PP_SIGNAL_TEMPERATURE: pp_signal = 5;
/// Target position.
pub const PP_SIGNAL_TARGET_POSITION: pp_signal = 6;
/// Target velocity.
pub const PP_SIGNAL_TARGET_VELOCITY: pp_signal = 7;
/// Fault code or fault word.
pub const PP_SIGNAL_FAULT: pp_signal = 8;
/// The motor has power.
pub const PP_SIGNAL_ENABLED: pp_signal = 9;
/// The motor moves.
pub const PP_SIGNAL_MOVING: pp_signal = 10;
/// The target is reached.
pub const PP_SIGNAL_REACHED: pp_signal = 11;
/// Mode of operation.
pub const PP_SIGNAL_MODE: pp_signal = 12;
/// Time of the drive: s.
pub const PP_SIGNAL_TIME: pp_signal = 13;
/// A limit holds the motor at the positive end.
pub const PP_SIGNAL_POSITIVE_LIMIT: pp_signal = 14;
/// A limit holds the motor at the negative end. Both are 1 if the drive does not report which end it is.
pub const PP_SIGNAL_NEGATIVE_LIMIT: pp_signal = 15;

/// Signals in the order of their numbers.
const SIGNALS: [Signal; 16] = [
    Signal::Position,
    Signal::Velocity,
    Signal::Torque,
    Signal::Current,
    Signal::Voltage,
    Signal::Temperature,
    Signal::TargetPosition,
    Signal::TargetVelocity,
    Signal::Fault,
    Signal::Enabled,
    Signal::Moving,
    Signal::Reached,
    Signal::Mode,
    Signal::Time,
    Signal::PositiveLimit,
    Signal::NegativeLimit,
];

/// The signal of a number.
pub(crate) fn read_signal(signal: pp_signal) -> Result<Signal, CallError> {
    let known = usize::try_from(signal).ok().and_then(|at| SIGNALS.get(at));
    let hint = "use PP_SIGNAL_POSITION to PP_SIGNAL_NEGATIVE_LIMIT";
    known.copied().ok_or_else(|| CallError::usage(format!("{signal} is no signal"), hint))
}

/// The number of a signal.
pub(crate) fn signal_number(signal: Signal) -> pp_signal {
    SIGNALS.iter().position(|known| *known == signal).map_or(-1, |at| at as pp_signal)
}

/// Reports whether an axis has a signal: 1 or 0. Nothing is sent.
///
/// # Safety
/// `axis` is NULL or valid; `has` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_has_signal(
    axis: *const pp_axis,
    signal: pp_signal,
    has: *mut i32,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| write_value(has, axis.opened()?.has_signal(read_signal(signal)?).into()))
    }
}

/// Reads a signal now. PP_USAGE with E213 if the drive does not report it. Blocks until the drive has replied.
///
/// Example:
///
/// ```c
/// double speed;
/// pp_axis_read(axis, PP_SIGNAL_VELOCITY, &speed);
/// ```
///
/// # Safety
/// `axis` is NULL or valid; `value` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_read(
    axis: *const pp_axis,
    signal: pp_signal,
    value: *mut f64,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { pp_axis_read_all(axis, &raw const signal, 1, value) }
}

/// Reads several signals now, in as few requests as the drive allows. `values` gets `count` of them.
///
/// # Safety
/// `axis` is NULL or valid; `signals` and `values` have `count` elements.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_read_all(
    axis: *const pp_axis,
    signals: *const pp_signal,
    count: usize,
    values: *mut f64,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let signals = read_signals(signals, count)?;
            if values.is_null() {
                return Err(CallError::usage("the pointer for a result is NULL", ""));
            }
            let read = axis.opened()?.signals(&signals)?;
            for (at, reading) in read.iter().take(count).enumerate() {
                values.add(at).write(reading.value);
            }
            Ok(())
        })
    }
}

/// The caller's signals.
///
/// # Safety
/// `signals` is NULL or has `count` elements.
pub(crate) unsafe fn read_signals(
    signals: *const pp_signal,
    count: usize,
) -> Result<Vec<Signal>, CallError> {
    if signals.is_null() || count == 0 || count > SIGNALS.len() {
        return Err(CallError::usage("there are no signals", "pass 1 to 14 of them"));
    }
    // SAFETY: as promised by the caller.
    let signals = unsafe { std::slice::from_raw_parts(signals, count) };
    signals.iter().map(|signal| read_signal(*signal)).collect()
}

/// The last known value of a signal, and its age in seconds. Nothing is sent, except that a server is asked.
/// PP_NOTHING if it was never read. `age` may be NULL.
///
/// # Safety
/// `axis` is NULL or valid; `value` is valid; `age` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_last(
    axis: *const pp_axis,
    signal: pp_signal,
    value: *mut f64,
    age: *mut f64,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        with_handle(axis, |axis| {
            let (opened, signal) = (axis.opened()?, read_signal(signal)?);
            let (last, old) = match opened.local() {
                Some(local) => {
                    let reading = local.state().reading(signal);
                    let Some(at) = reading.at else { return Ok(PP_NOTHING) };
                    (reading.value, local.connection().now().since(at))
                }
                None => {
                    let state = opened.state()?;
                    let Some(reading) = state.signal(signal) else { return Ok(PP_NOTHING) };
                    (reading.value, reading.age)
                }
            };
            write_value(value, last)?;
            if !age.is_null() {
                age.write(old.as_secs_f64());
            }
            Ok(PP_OK)
        })
    }
}

/// The last known state of an axis. -1 means unknown.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct pp_state {
    /// Size of this struct, set by the caller.
    pub size: u32,
    /// 1 if the motor has power.
    pub enabled: i32,
    /// 1 if the motor moves.
    pub moving: i32,
    /// 1 if this program armed the axis.
    pub armed: i32,
    /// Mode of operation in words. May be empty.
    pub mode: [c_char; 64],
    /// The client with the lease, on a server. May be empty.
    pub owner: [c_char; 64],
}

// SAFETY: size first, then plain numbers and bytes.
unsafe impl SizedStruct for pp_state {}

/// Gives the last known state of an axis. Nothing is sent, except that a server is asked.
///
/// # Safety
/// `axis` is NULL or valid; `state` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_state(axis: *const pp_axis, state: *mut pp_state) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let known = axis.opened()?.state()?;
            let mut value = pp_state {
                size: 0,
                enabled: known.enabled.map_or(-1, i32::from),
                moving: known.moving.map_or(-1, i32::from),
                armed: known.armed.into(),
                mode: [0; 64],
                owner: [0; 64],
            };
            copy_text(known.mode.as_deref().unwrap_or(""), &mut value.mode);
            copy_text(known.owner.as_deref().unwrap_or(""), &mut value.owner);
            write_struct(state, &value)
        })
    }
}
