//! Events: what the drive watches, what it does then, and whether the program waits for it.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::{c_int, c_long, c_short};

use crate::Bool;
use crate::call::{CallResult, TmlError, run_bool, write_value};
use crate::channel::target;
use crate::execute::{Target, WORDS};
use crate::line::check_line;
use crate::power::position;
use crate::variable::fixed;

/// SRL.14: the event that was set last has occurred.
const SRL_EVENT: i64 = 1 << 14;

fn has_occurred(target: &Target) -> CallResult<bool> {
    Ok(target.read_variable("SRL", &WORDS)? & SRL_EVENT != 0)
}

/// Sets an event. A wait ends when it occurs, or at a fault of the drive.
fn set_event(
    function: &str,
    event: impl FnOnce() -> CallResult<String>,
    wait: Bool,
    stop: Bool,
) -> Bool {
    run_bool(function, || {
        let (event, target) = (event()?, target()?);
        if wait != 0 {
            target.check_single("an event")?;
        }
        target.execute(&event)?;
        if stop != 0 {
            target.execute("STOP!")?;
        }
        if wait != 0 { target.wait_for(has_occurred) } else { Ok(()) }
    })
}

/// The name of an event by its direction.
const fn over_or_under(over: Bool, names: [&'static str; 2]) -> &'static str {
    if over != 0 { names[0] } else { names[1] }
}

fn position_event(
    kind: c_short,
    value: c_long,
    over: Bool,
    [absolute, relative]: [[&'static str; 2]; 2],
) -> CallResult<String> {
    let names = match kind {
        0 => absolute,
        1 => relative,
        other => {
            return Err(TmlError::new(format!(
                "PositionType {other} is not ABSOLUTE_POSITION (0) or RELATIVE_POSITION (1)"
            )));
        }
    };
    Ok(format!("!{} {}", over_or_under(over, names), position(value)?))
}

/// True if the event that was set last has occurred.
///
/// # Safety
/// `occurred` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_CheckEvent(occurred: *mut Bool) -> Bool {
    run_bool("TS_CheckEvent", || {
        let value = has_occurred(&target()?)?;
        // SAFETY: as promised by the caller.
        unsafe { write_value(occurred, value.into()) }
    })
}

/// The motion is complete.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetEventOnMotionComplete(wait: Bool, stop: Bool) -> Bool {
    set_event("TS_SetEventOnMotionComplete", || Ok("!MC".to_owned()), wait, stop)
}

/// The motor's position is over or under a value, in counts.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetEventOnMotorPosition(
    kind: c_short,
    value: c_long,
    over: Bool,
    wait: Bool,
    stop: Bool,
) -> Bool {
    set_event(
        "TS_SetEventOnMotorPosition",
        || position_event(kind, value, over, [["AMPO", "AMPU"], ["RMPO", "RMPU"]]),
        wait,
        stop,
    )
}

/// The load's position is over or under a value, in counts.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetEventOnLoadPosition(
    kind: c_short,
    value: c_long,
    over: Bool,
    wait: Bool,
    stop: Bool,
) -> Bool {
    set_event(
        "TS_SetEventOnLoadPosition",
        || position_event(kind, value, over, [["ALPO", "ALPU"], ["RPO", "RPU"]]),
        wait,
        stop,
    )
}

/// The motor's speed is over or under a value.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetEventOnMotorSpeed(
    speed: f64,
    over: Bool,
    wait: Bool,
    stop: Bool,
) -> Bool {
    let name = over_or_under(over, ["MSO", "MSU"]);
    set_event(
        "TS_SetEventOnMotorSpeed",
        || Ok(format!("!{name} {}", fixed("the speed", speed)?)),
        wait,
        stop,
    )
}

/// The load's speed is over or under a value.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetEventOnLoadSpeed(
    speed: f64,
    over: Bool,
    wait: Bool,
    stop: Bool,
) -> Bool {
    let name = over_or_under(over, ["LSO", "LSU"]);
    set_event(
        "TS_SetEventOnLoadSpeed",
        || Ok(format!("!{name} {}", fixed("the speed", speed)?)),
        wait,
        stop,
    )
}

/// A time in slow loops is over.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetEventOnTime(time: u16, wait: Bool, stop: Bool) -> Bool {
    set_event("TS_SetEventOnTime", || Ok(format!("!RT {time}")), wait, stop)
}

/// The position reference is over or under a value, in counts.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetEventOnPositionRef(
    value: c_long,
    over: Bool,
    wait: Bool,
    stop: Bool,
) -> Bool {
    let name = over_or_under(over, ["PRO", "PRU"]);
    set_event(
        "TS_SetEventOnPositionRef",
        || Ok(format!("!{name} {}", position(value)?)),
        wait,
        stop,
    )
}

/// The speed reference is over or under a value.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetEventOnSpeedRef(
    speed: f64,
    over: Bool,
    wait: Bool,
    stop: Bool,
) -> Bool {
    let name = over_or_under(over, ["SRO", "SRU"]);
    set_event(
        "TS_SetEventOnSpeedRef",
        || Ok(format!("!{name} {}", fixed("the speed", speed)?)),
        wait,
        stop,
    )
}

/// The torque reference is over or under a value, in the drive's unit of current.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetEventOnTorqueRef(
    torque: c_int,
    over: Bool,
    wait: Bool,
    stop: Bool,
) -> Bool {
    let name = over_or_under(over, ["TRO", "TRU"]);
    set_event("TS_SetEventOnTorqueRef", || Ok(format!("!{name} {torque}")), wait, stop)
}

/// The edge of a switch or an index: -1 falling, 1 rising, 0 none.
fn edge_event(
    transition: c_short,
    [falling, rising, none]: [&str; 3],
    event: &str,
) -> CallResult<String> {
    Ok(match transition {
        -1 => format!("{falling};{event}"),
        1 => format!("{rising};{event}"),
        0 => none.to_owned(),
        other => {
            return Err(TmlError::new(format!(
                "TransitionType {other} is not -1 (falling), 0 (off) or 1 (rising)"
            )));
        }
    })
}

/// The index of encoder 1 or 2 passes.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetEventOnEncoderIndex(
    index: c_short,
    transition: c_short,
    wait: Bool,
    stop: Bool,
) -> Bool {
    set_event(
        "TS_SetEventOnEncoderIndex",
        || match index {
            1 => edge_event(transition, ["ENCAPI0", "ENCAPI1", "DISCAPI"], "!CAP"),
            2 => edge_event(transition, ["EN2CAPI0", "EN2CAPI1", "DIS2CAPI"], "!CAP"),
            other => Err(TmlError::new(format!("index {other} is not INDEX_1 (1) or INDEX_2 (2)"))),
        },
        wait,
        stop,
    )
}

/// A limit switch changes: -1 the negative one, 1 the positive one.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetEventOnLimitSwitch(
    switch: c_short,
    transition: c_short,
    wait: Bool,
    stop: Bool,
) -> Bool {
    set_event(
        "TS_SetEventOnLimitSwitch",
        || match switch {
            -1 => edge_event(transition, ["ENLSN0", "ENLSN1", "DISLSN"], "!LSN"),
            1 => edge_event(transition, ["ENLSP0", "ENLSP1", "DISLSP"], "!LSP"),
            other => Err(TmlError::new(format!(
                "limit switch {other} is not LSW_NEGATIVE (-1) or LSW_POSITIVE (1)"
            ))),
        },
        wait,
        stop,
    )
}

/// A digital input, 0 to 15, is high (1) or low (0).
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetEventOnDigitalInput(
    line: u8,
    state: c_short,
    wait: Bool,
    stop: Bool,
) -> Bool {
    set_event(
        "TS_SetEventOnDigitalInput",
        || match state {
            0 | 1 => Ok(format!("!IN#{} {state}", check_line(line)?)),
            other => Err(TmlError::new(format!("state {other} is not IO_LOW (0) or IO_HIGH (1)"))),
        },
        wait,
        stop,
    )
}
