//! Paths of points: position, velocity and time (PVT), or position and time (PT).

use std::ffi::{c_int, c_long, c_short, c_uint};

use crate::Bool;
use crate::call::{CallResult, TmlError, run_bool};
use crate::channel::target;
use crate::motion::start;
use crate::power::position;
use crate::variable::fixed;

/// Largest integrity counter of a point.
const COUNTER_MAX: c_short = 127;
/// Largest number of points that counts as few.
const LOW_LEVEL_MAX: c_short = 15;

/// The word of `SETPVT`: bit 15 clears the buffer, 14 switches the check of the counter off, 13 sets it to bits 6 to
/// 0, 12 has absolute paths begin at the target, 7 sets how many points count as few to bits 11 to 8.
fn set_up(function: &str, flags: [c_short; 5], counter: c_short, low_level: c_short) -> Bool {
    run_bool(function, || {
        let [clear, check, change_counter, from_target, change_low_level] =
            flags.map(|flag| flag != 0);
        let word = u16::from(clear) << 15
            | u16::from(!check) << 14
            | u16::from(change_counter) << 13
            | u16::from(from_target) << 12
            | within("the low level", low_level, LOW_LEVEL_MAX)? << 8
            | u16::from(change_low_level) << 7
            | within("the counter", counter, COUNTER_MAX)?;
        target()?.execute(&format!("SETPVT {}", word.cast_signed()))
    })
}

fn within(what: &str, value: c_short, max: c_short) -> CallResult<u16> {
    if !(0..=max).contains(&value) {
        return Err(TmlError::new(format!("{what} {value} is out of range: 0 to {max}")));
    }
    Ok(value.cast_unsigned())
}

/// Sets up the buffer of PVT points.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_PVTSetup(
    clear: c_short,
    check: c_short,
    change_counter: c_short,
    from_target: c_short,
    change_low_level: c_short,
    counter: c_short,
    low_level: c_short,
) -> Bool {
    let flags = [clear, check, change_counter, from_target, change_low_level];
    set_up("TS_PVTSetup", flags, counter, low_level)
}

/// Sets up the buffer of PT points.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_PTSetup(
    clear: c_short,
    check: c_short,
    change_counter: c_short,
    from_target: c_short,
    change_low_level: c_short,
    counter: c_short,
    low_level: c_short,
) -> Bool {
    let flags = [clear, check, change_counter, from_target, change_low_level];
    set_up("TS_PTSetup", flags, counter, low_level)
}

fn pvt_point(to: c_long, velocity: f64, time: c_uint, counter: c_short) -> CallResult<String> {
    let (to, velocity) = (position(to)?, fixed("the velocity", velocity)?);
    Ok(format!("PVTP {to}, {velocity}, {time}, {}", within("the counter", counter, COUNTER_MAX)?))
}

fn pt_point(to: c_long, time: c_uint, counter: c_short) -> CallResult<String> {
    let to = position(to)?;
    Ok(format!("PTP {to}, {time}, {}", within("the counter", counter, COUNTER_MAX)?))
}

/// Instructions before the first point: absolute from an initial position, or relative.
fn beginning(kind: c_short, initial: c_long, mode: &str) -> CallResult<String> {
    match kind {
        0 => Ok(format!("PVTPOS0 = {};CPA;{mode};", position(initial)?)),
        1 => Ok(format!("CPR;{mode};")),
        other => Err(TmlError::new(format!(
            "PositionType {other} is not ABSOLUTE_POSITION (0) or RELATIVE_POSITION (1)"
        ))),
    }
}

fn time(value: c_int) -> CallResult<c_uint> {
    c_uint::try_from(value)
        .map_err(|_| TmlError::new(format!("time {value} of a point must not be negative")))
}

/// Begins a PVT path with its first point. Positions are in counts, velocities in counts per slow loop, times in
/// slow loops.
#[allow(unsafe_code, reason = "programs in C call it")]
#[allow(clippy::too_many_arguments, reason = "the prototype is the vendor's")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_SendPVTFirstPoint(
    to: c_long,
    velocity: f64,
    after: c_int,
    counter: c_short,
    kind: c_short,
    initial: c_long,
    moment: c_short,
    base: c_short,
) -> Bool {
    run_bool("TS_SendPVTFirstPoint", || {
        let (beginning, start) =
            (beginning(kind, initial, "MODE PVT")?, start(Some(base), moment)?);
        let (tum, when) = start.split_once(';').unwrap_or((&start, ""));
        let point = pvt_point(to, velocity, time(after)?, counter)?;
        target()?.execute(&format!("{beginning}{tum};{point};{when}"))
    })
}

/// Sends the next point of a PVT path.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_SendPVTPoint(
    to: c_long,
    velocity: f64,
    time: c_uint,
    counter: c_short,
) -> Bool {
    run_bool("TS_SendPVTPoint", || target()?.execute(&pvt_point(to, velocity, time, counter)?))
}

/// Begins a PT path with its first point.
#[allow(unsafe_code, reason = "programs in C call it")]
#[allow(clippy::too_many_arguments, reason = "the prototype is the vendor's")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_SendPTFirstPoint(
    to: c_long,
    after: c_int,
    counter: c_short,
    kind: c_short,
    initial: c_long,
    moment: c_short,
    base: c_short,
) -> Bool {
    run_bool("TS_SendPTFirstPoint", || {
        let (beginning, start) = (beginning(kind, initial, "MODE PT")?, start(Some(base), moment)?);
        let (tum, when) = start.split_once(';').unwrap_or((&start, ""));
        let point = pt_point(to, time(after)?, counter)?;
        target()?.execute(&format!("{beginning}{tum};{point};{when}"))
    })
}

/// Sends the next point of a PT path.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_SendPTPoint(to: c_long, time: c_uint, counter: c_short) -> Bool {
    run_bool("TS_SendPTPoint", || target()?.execute(&pt_point(to, time, counter)?))
}
