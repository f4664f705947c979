//! Motion: verbs with their arguments.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_char;

use polepair::{Amount, Axis};
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;

use crate::axis::pp_axis;
use crate::error::{CallError, pp_status};
use crate::handle::run;
use crate::link::read_seconds;
use crate::text::{SizedStruct, read_struct, read_text};

/// A command to a drive, for `pp_axis_run` and `pp_axis_begin`.
pub type pp_verb = i32;

/// Powers the motor; it holds its actual position.
pub const PP_ENABLE: pp_verb = 0;
/// Removes power from the motor.
pub const PP_DISABLE: pp_verb = 1;
/// Clears faults.
pub const PP_CLEAR: pp_verb = 2;
/// Turns at `target`: rad/s, m/s, or a share.
pub const PP_VELOCITY: pp_verb = 3;
/// Turns with the torque `target`: N·m, or what the drive has in its place (A, a share).
pub const PP_TORQUE: pp_verb = 4;
/// Moves to the position `target`: rad or m.
pub const PP_MOVE_TO: pp_verb = 5;
/// Moves by the distance `target` from the actual position. Never sent twice.
pub const PP_MOVE_BY: pp_verb = 6;
/// Moves by the distance `target` from the last target. Never sent twice.
pub const PP_MOVE_ON: pp_verb = 7;
/// Moves to `target` with an S-curve.
pub const PP_CURVE_TO: pp_verb = 8;
/// Moves by `target` with an S-curve. Never sent twice.
pub const PP_CURVE_BY: pp_verb = 9;
/// Finds the drive's reference, and ends with it.
pub const PP_HOME: pp_verb = 10;
/// Saves the settings in the drive's permanent memory.
pub const PP_STORE: pp_verb = 11;

/// Limits of a motion. NaN means the drive's own value: set all fields by `pp_motion_init`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct pp_motion {
    /// Size of this struct, set by the caller.
    pub size: u32,
    /// 0.
    pub reserved: u32,
    /// Greatest speed on the way: rad/s or m/s.
    pub velocity: f64,
    /// rad/s² or m/s².
    pub acceleration: f64,
    /// rad/s² or m/s².
    pub deceleration: f64,
    /// Torque limit: N·m, or what the drive has in its place.
    pub torque: f64,
    /// Time in which the acceleration of an S-curve builds up: s.
    pub jerk_time: f64,
}

// SAFETY: size first, then plain numbers.
unsafe impl SizedStruct for pp_motion {}

const UNLIMITED: pp_motion = pp_motion {
    size: size_of::<pp_motion>() as u32,
    reserved: 0,
    velocity: f64::NAN,
    acceleration: f64::NAN,
    deceleration: f64::NAN,
    torque: f64::NAN,
    jerk_time: f64::NAN,
};

/// Sets the limits of a motion to what the drive has. `size` must be set before.
///
/// # Safety
/// `motion` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_motion_init(motion: *mut pp_motion) {
    // SAFETY: as promised by the caller.
    let _ = unsafe { crate::text::write_struct(motion, &UNLIMITED) };
}

/// The verb of a number.
pub(crate) fn read_verb(verb: pp_verb) -> Result<Verb, CallError> {
    Ok(match verb {
        PP_ENABLE => Verb::Enable,
        PP_DISABLE => Verb::Disable,
        PP_CLEAR => Verb::Clear,
        PP_VELOCITY => Verb::Velocity,
        PP_TORQUE => Verb::Torque,
        PP_MOVE_TO => Verb::MoveTo,
        PP_MOVE_BY => Verb::MoveBy,
        PP_MOVE_ON => Verb::MoveOn,
        PP_CURVE_TO => Verb::CurveTo,
        PP_CURVE_BY => Verb::CurveBy,
        PP_HOME => Verb::Home,
        PP_STORE => Verb::Store,
        other => {
            return Err(CallError::usage(
                format!("{other} is no verb"),
                "use PP_ENABLE to PP_STORE",
            ));
        }
    })
}

/// The argument that `target` sets.
const fn target_of(verb: Verb) -> Option<Argument> {
    match verb {
        Verb::Velocity => Some(Argument::Velocity),
        Verb::Torque => Some(Argument::Torque),
        Verb::MoveTo | Verb::MoveBy | Verb::MoveOn | Verb::CurveTo | Verb::CurveBy => {
            Some(Argument::Target)
        }
        _ => None,
    }
}

/// A command from a target in SI and limits.
///
/// # Safety
/// `limits` is NULL or valid.
pub(crate) unsafe fn build_command(
    verb: pp_verb,
    target: f64,
    limits: *const pp_motion,
) -> Result<Command, CallError> {
    // SAFETY: as promised by the caller.
    let limits = unsafe { read_struct(limits, UNLIMITED)? };
    let verb = read_verb(verb)?;
    let mut command = Command {
        velocity: given_value(limits.velocity),
        acceleration: given_value(limits.acceleration),
        deceleration: given_value(limits.deceleration),
        torque: given_value(limits.torque),
        jerk_time: given_value(limits.jerk_time),
        ..Command::new(verb)
    };
    match target_of(verb) {
        None => {}
        Some(_) if target.is_nan() => return Err(CallError::usage("the target is NaN", "")),
        Some(Argument::Velocity) => command.velocity = Some(target),
        Some(Argument::Torque) => command.torque = Some(target),
        Some(_) => command.target = Some(target),
    }
    Ok(command)
}

fn given_value(value: f64) -> Option<f64> {
    (!value.is_nan()).then_some(value)
}

/// The SI value of a text with a unit.
fn read_amount(axis: &Axis, verb: Verb, text: &str) -> Result<f64, CallError> {
    let which = target_of(verb).ok_or_else(|| CallError::usage("this verb takes no target", ""))?;
    Ok(axis.argument(verb, which, &Amount::from(text))?)
}

/// Runs a verb, and returns when the drive has acknowledged it; homing returns when it has ended.
///
/// `target` is SI, and ignored by verbs without one. `limits` may be NULL. The axis must be armed for what moves:
/// PP_USAGE with E219. PP_USAGE with E218 for a verb or an argument that the drive does not have, and with E216
/// outside of its limits: nothing was sent. Thread-safe.
///
/// Example:
///
/// ```c
/// pp_axis_run(axis, PP_MOVE_TO, 1.5708, NULL);
/// pp_axis_wait(axis, 10.0);
/// ```
///
/// # Safety
/// `axis` and `limits` are NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_run(
    axis: *const pp_axis,
    verb: pp_verb,
    target: f64,
    limits: *const pp_motion,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let command = build_command(verb, target, limits)?;
            axis.finish(axis.opened()?.start(command)?).map(drop)
        })
    }
}

/// Runs a verb with its target as text with a unit: "90 deg", "60 rpm". As `pp_axis_run`.
///
/// # Safety
/// As `pp_axis_run`; `target` has `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_run_text(
    axis: *const pp_axis,
    verb: pp_verb,
    target: *const c_char,
    length: usize,
    limits: *const pp_motion,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let opened = axis.opened()?;
            let amount = read_amount(opened, read_verb(verb)?, read_text(target, length)?)?;
            let command = build_command(verb, amount, limits)?;
            axis.finish(opened.start(command)?).map(drop)
        })
    }
}

/// Powers the motor of an armed axis; it holds its actual position. A drive without a switch for its power:
/// PP_USAGE with E218.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_enable(axis: *const pp_axis) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { pp_axis_run(axis, PP_ENABLE, f64::NAN, std::ptr::null()) }
}

/// Removes power from the motor.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_disable(axis: *const pp_axis) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { pp_axis_run(axis, PP_DISABLE, f64::NAN, std::ptr::null()) }
}

/// Clears faults.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_clear(axis: *const pp_axis) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { pp_axis_run(axis, PP_CLEAR, f64::NAN, std::ptr::null()) }
}

/// rad/s (m/s, a share): turns an armed axis at a speed. The motor turns until it is stopped.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_velocity(axis: *const pp_axis, speed: f64) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { pp_axis_run(axis, PP_VELOCITY, speed, std::ptr::null()) }
}

/// Turns an armed axis at a speed as text: "60 rpm".
///
/// # Safety
/// `axis` is NULL or valid; `speed` has `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_velocity_text(
    axis: *const pp_axis,
    speed: *const c_char,
    length: usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { pp_axis_run_text(axis, PP_VELOCITY, speed, length, std::ptr::null()) }
}

/// rad (m on a linear axis): starts a move of an armed axis to a position. `pp_axis_wait` waits for its end.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_move_to(axis: *const pp_axis, position: f64) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { pp_axis_run(axis, PP_MOVE_TO, position, std::ptr::null()) }
}

/// Starts a move of an armed axis to a position as text: "90 deg".
///
/// # Safety
/// `axis` is NULL or valid; `position` has `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_move_to_text(
    axis: *const pp_axis,
    position: *const c_char,
    length: usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { pp_axis_run_text(axis, PP_MOVE_TO, position, length, std::ptr::null()) }
}

/// rad (m on a linear axis): starts a move of an armed axis by a distance from its actual position. It is never
/// sent twice.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_move_by(axis: *const pp_axis, distance: f64) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { pp_axis_run(axis, PP_MOVE_BY, distance, std::ptr::null()) }
}

/// Starts a move of an armed axis by a distance as text: "-1 turn".
///
/// # Safety
/// `axis` is NULL or valid; `distance` has `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_move_by_text(
    axis: *const pp_axis,
    distance: *const c_char,
    length: usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { pp_axis_run_text(axis, PP_MOVE_BY, distance, length, std::ptr::null()) }
}

/// Finds the reference of an armed axis, and returns when it is found.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_home(axis: *const pp_axis) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { pp_axis_run(axis, PP_HOME, f64::NAN, std::ptr::null()) }
}

/// Waits until a move has reached its target, at most `seconds`. The motor is not stopped at that time: PP_NEGATIVE,
/// with E101. If it ended elsewhere, PP_NEGATIVE with E106 or E102. PP_DRIVE_FAULT if a fault ends the move,
/// PP_UNCONFIRMED if the drive reports no position.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_wait(axis: *const pp_axis, seconds: f64) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { run(axis, |axis| Ok(axis.opened()?.wait(read_seconds(seconds)?)?)) }
}
