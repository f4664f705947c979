//! Motion modes.

use std::ffi::{c_long, c_short};

use crate::Bool;
use crate::call::{CallResult, TmlError, run_bool};
use crate::channel::target;
use crate::power::position;
use crate::variable::fixed;

/// UPGRADE.2: an external reference is limited.
const LIMIT_REFERENCE: &str = "SRBL UPGRADE, 0xFFFF, 0x0004;";

/// Last instructions of a motion: reference of the motion and moment of its start.
pub fn start(base: Option<c_short>, moment: c_short) -> CallResult<String> {
    let from = match base {
        None => "",
        Some(0) => "TUM0;",
        Some(1) => "TUM1;",
        Some(other) => {
            return Err(TmlError::new(format!(
                "ReferenceBase {other} is not FROM_MEASURE (0) or FROM_REFERENCE (1)"
            )));
        }
    };
    let when = match moment {
        -1 => "",
        0 => "UPD!",
        1 => "UPD",
        other => {
            return Err(TmlError::new(format!(
                "MoveMoment {other} is not UPDATE_NONE (-1), UPDATE_ON_EVENT (0) or UPDATE_IMMEDIATE (1)"
            )));
        }
    };
    Ok(format!("{from}{when}"))
}

/// An assignment, unless the value is 0, which keeps the one before.
pub fn unless_zero(name: &str, value: f64) -> CallResult<String> {
    if value == 0.0 {
        return Ok(String::new());
    }
    Ok(format!("{name} = {};", fixed(name, value)?))
}

fn profile(speed: f64, acceleration: f64) -> CallResult<String> {
    Ok(unless_zero("CSPD", speed)? + &unless_zero("CACC", acceleration)?)
}

/// Moves to a position in counts, on a trapezoidal profile. Speed 0 and acceleration 0 keep the values before.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_MoveAbsolute(
    to: c_long,
    speed: f64,
    acceleration: f64,
    moment: c_short,
    base: c_short,
) -> Bool {
    run_bool("TS_MoveAbsolute", || {
        let (to, profile) = (position(to)?, profile(speed, acceleration)?);
        let start = start(Some(base), moment)?;
        target()?.execute(&format!("CPOS = {to};{profile}MODE PP;CPA;{start}"))
    })
}

/// Moves by a distance in counts, on a trapezoidal profile; additive: counted from the last target.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_MoveRelative(
    by: c_long,
    speed: f64,
    acceleration: f64,
    additive: Bool,
    moment: c_short,
    base: c_short,
) -> Bool {
    run_bool("TS_MoveRelative", || {
        let (by, profile) = (position(by)?, profile(speed, acceleration)?);
        let start = start(Some(base), moment)?;
        let adds = additivity(additive != 0);
        target()?.execute(&format!("CPOS = {by};{profile}{adds}MODE PP;CPR;{start}"))
    })
}

/// ACR.11: relative moves add up.
fn additivity(additive: bool) -> &'static str {
    if additive { "SRBL ACR, 0xFFFF, 0x0800;" } else { "SRBL ACR, 0xF7FF, 0x0000;" }
}

/// Turns at a speed, in counts per slow loop.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_MoveVelocity(
    speed: f64,
    acceleration: f64,
    moment: c_short,
    base: c_short,
) -> Bool {
    run_bool("TS_MoveVelocity", || {
        let speed = fixed("the speed", speed)?;
        let acceleration = unless_zero("CACC", acceleration)?;
        let start = start(Some(base), moment)?;
        target()?.execute(&format!("CSPD = {speed};{acceleration}MODE SP;{start}"))
    })
}

fn move_on_curve(
    function: &str,
    distance: c_long,
    [speed, acceleration]: [f64; 2],
    jerk_time: c_long,
    [moment, deceleration]: [c_short; 2],
    kind: &str,
) -> Bool {
    run_bool(function, || {
        let (distance, profile) = (position(distance)?, profile(speed, acceleration)?);
        let jerk = match position(jerk_time)? {
            0 => String::new(),
            time => format!("TJERK = {time};"),
        };
        // ACR.0: how it stops.
        let braking = match deceleration {
            0 => "SRBL ACR, 0xFFFE, 0x0000;",
            1 => "SRBL ACR, 0xFFFF, 0x0001;",
            other => {
                return Err(TmlError::new(format!(
                    "DecelerationType {other} is not S_CURVE_SPEED_PROFILE (0) or \
                     TRAPEZOIDAL_SPEED_PROFILE (1)"
                )));
            }
        };
        let start = start(Some(1), moment)?;
        target()?
            .execute(&format!("CPOS = {distance};{profile}{jerk}{braking}MODE PSC;{kind};{start}"))
    })
}

/// Moves to a position in counts, on an S-curve. `jerk_time` is in slow loops.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_MoveSCurveAbsolute(
    to: c_long,
    speed: f64,
    acceleration: f64,
    jerk_time: c_long,
    moment: c_short,
    deceleration: c_short,
) -> Bool {
    let (profile, how) = ([speed, acceleration], [moment, deceleration]);
    move_on_curve("TS_MoveSCurveAbsolute", to, profile, jerk_time, how, "CPA")
}

/// Moves by a distance in counts, on an S-curve.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_MoveSCurveRelative(
    by: c_long,
    speed: f64,
    acceleration: f64,
    jerk_time: c_long,
    moment: c_short,
    deceleration: c_short,
) -> Bool {
    let (profile, how) = ([speed, acceleration], [moment, deceleration]);
    move_on_curve("TS_MoveSCurveRelative", by, profile, jerk_time, how, "CPR")
}

/// The mode of an external reference, and what limits it.
fn external_mode(reference: c_short, fast: bool, limit: f64) -> CallResult<(&'static str, String)> {
    let (mode, limited) = match (reference, fast) {
        (0, _) => ("MODE PE;", Some("CSPD")),
        (1, _) => ("MODE SE;", Some("CACC")),
        (2, false) => ("MODE TES;", None),
        (2, true) => ("MODE TEF;", None),
        (3, false) => ("MODE VES;", None),
        (3, true) => ("MODE VEF;", None),
        (other, _) => {
            return Err(TmlError::new(format!(
                "ReferenceType {other} is not position (0), speed (1), torque (2) or voltage (3)"
            )));
        }
    };
    if limit == 0.0 {
        return Ok((mode, String::new()));
    }
    let name = limited
        .ok_or_else(|| TmlError::new("LimitVariation limits positions and speeds only: give 0"))?;
    Ok((mode, unless_zero(name, limit)? + LIMIT_REFERENCE))
}

/// Has the motor follow an analogue input. `fast` reads a torque or voltage in the fast loop.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetAnalogueMoveExternal(
    reference: c_short,
    fast: Bool,
    limit: f64,
    moment: c_short,
) -> Bool {
    run_bool("TS_SetAnalogueMoveExternal", || {
        let (mode, limit) = external_mode(reference, fast != 0, limit)?;
        target()?.execute(&format!("EXTREF 1;{limit}{mode}{}", start(None, moment)?))
    })
}

/// Has the motor follow a digital input, by a gear ratio if `set_ratio`.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetDigitalMoveExternal(
    set_ratio: Bool,
    denominator: c_short,
    numerator: c_short,
    limit: f64,
    moment: c_short,
) -> Bool {
    run_bool("TS_SetDigitalMoveExternal", || {
        let ratio = match set_ratio {
            0 => String::new(),
            _ => gear_ratio(denominator, numerator)?,
        };
        let limit = limited_acceleration(limit)?;
        let start = start(Some(1), moment)?;
        target()?.execute(&format!("{ratio}EXTREF 2;{limit}MODE GS;{start}"))
    })
}

/// A gear's ratio: both numbers, and their quotient.
pub fn gear_ratio(denominator: c_short, numerator: c_short) -> CallResult<String> {
    if denominator <= 0 {
        return Err(TmlError::new(format!(
            "Denominator {denominator} of a gear must be greater than 0"
        )));
    }
    let ratio = fixed("the ratio", f64::from(numerator) / f64::from(denominator))?;
    Ok(format!("GEARMASTER = {denominator};GEARSLAVE = {numerator};GEAR = {ratio};"))
}

/// The acceleration with which a slave may couple.
pub fn limited_acceleration(limit: f64) -> CallResult<String> {
    let acceleration = unless_zero("CACC", limit)?;
    Ok(if acceleration.is_empty() { acceleration } else { acceleration + LIMIT_REFERENCE })
}

/// Has the motor follow what the program writes to EREFP, EREFS, EREFT or EREFV.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetOnlineMoveExternal(
    reference: c_short,
    limit: f64,
    initial: f64,
    moment: c_short,
) -> Bool {
    run_bool("TS_SetOnlineMoveExternal", || {
        let (mode, limit) = external_mode(reference, false, limit)?;
        let initial = match reference {
            _ if initial == 0.0 => String::new(),
            1 => format!("EREFS = {};", fixed("InitialValue", initial)?),
            0 => format!("EREFP = {};", whole(initial, i32::MIN.into(), i32::MAX.into())?),
            2 => format!("EREFT = {};", whole(initial, i16::MIN.into(), i16::MAX.into())?),
            _ => format!("EREFV = {};", whole(initial, i16::MIN.into(), i16::MAX.into())?),
        };
        target()?.execute(&format!("{initial}EXTREF 0;{limit}{mode}{}", start(None, moment)?))
    })
}

fn whole(value: f64, min: f64, max: f64) -> CallResult<i32> {
    if !(min..=max).contains(&value) {
        return Err(TmlError::new(format!("InitialValue {value} is out of range: {min} to {max}")));
    }
    Ok(value as i32)
}

fn test_mode(
    function: &str,
    unit: &str,
    [max, increment, angle, angle_increment]: [c_short; 4],
    mode: &str,
    moment: c_short,
) -> Bool {
    run_bool(function, || {
        let start = start(None, moment)?;
        target()?.execute(&format!(
            "REFTST_{unit} = {max};RINCTST_{unit} = {increment};THTST = {angle};TINCTST = {angle_increment};\
             {mode};{start}"
        ))
    })
}

/// Applies a voltage that rises by an increment each slow loop; the electrical angle turns at the given rate.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_VoltageTestMode(
    max: c_short,
    increment: c_short,
    angle: c_short,
    angle_increment: c_short,
    moment: c_short,
) -> Bool {
    let values = [max, increment, angle, angle_increment];
    test_mode("TS_VoltageTestMode", "V", values, "MODE VT", moment)
}

/// Applies a torque that rises by an increment each slow loop; the electrical angle turns at the given rate.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_TorqueTestMode(
    max: c_short,
    increment: c_short,
    angle: c_short,
    angle_increment: c_short,
    moment: c_short,
) -> Bool {
    let values = [max, increment, angle, angle_increment];
    test_mode("TS_TorqueTestMode", "A", values, "MODE TT", moment)
}

/// Superposes a second motion on a gear (1), or ends that (0, -1); `update` has it take effect.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_MotionSuperposition(enable: c_short, update: c_short) -> Bool {
    let superposed = if enable > 0 { "REG_ON" } else { "REG_OFF" };
    let update = if update == 0 { "" } else { ";UPD" };
    crate::power::command("TS_MotionSuperposition", &format!("{superposed}{update}"))
}

#[cfg(test)]
mod tests {
    use super::{gear_ratio, start, unless_zero};

    #[test]
    fn a_motion_begins_where_and_when_it_is_commanded() {
        assert_eq!(start(Some(1), 1).expect("a start"), "TUM1;UPD");
        assert_eq!(start(Some(0), 0).expect("a start"), "TUM0;UPD!");
        assert_eq!(start(None, -1).expect("a start"), "");
        assert!(start(Some(2), 1).is_err() && start(None, 2).is_err());
    }

    #[test]
    fn numbers_that_do_not_fit_are_refused() {
        assert_eq!(unless_zero("CSPD", 30.5).expect("a speed"), "CSPD = 30.5;");
        assert_eq!(unless_zero("CSPD", 0.0).expect("nothing"), "");
        for value in [32768.0, -32769.0, f64::NAN, f64::INFINITY] {
            assert!(unless_zero("CSPD", value).is_err(), "{value}");
        }
        let ratio = gear_ratio(2, 1).expect("a gear");
        assert_eq!(ratio, "GEARMASTER = 2;GEARSLAVE = 1;GEAR = 0.5;");
        assert!(gear_ratio(0, 1).is_err());
    }
}
