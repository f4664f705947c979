//! Variables of the drive, by the names of the set-up.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::{c_long, c_short};

use polepair_core::proto::tml::instruction::VariableKind;

use crate::call::{CallResult, TmlError, read_text, run_bool, write_value};
use crate::channel::target;
use crate::execute::{LONGS, WORDS};
use crate::power::position;
use crate::{Bool, Text};

/// A number of 16 bits before the point and 16 behind it, as TML's text has it.
pub fn fixed(what: &str, value: f64) -> CallResult<String> {
    let raw = (value * 65536.0).round();
    if !value.is_finite() || raw < f64::from(i32::MIN) || raw > f64::from(i32::MAX) {
        return Err(TmlError::new(format!(
            "{what} {value} is out of range: it is -32768 to less than 32768"
        )));
    }
    // Five digits distinguish all values.
    let text = format!("{:.5}", raw / 65536.0);
    Ok(text.trim_end_matches('0').trim_end_matches('.').to_owned())
}

/// Returns the address of a variable. Nothing is sent.
///
/// # Safety
/// `name` ends with a zero byte, and `address` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_GetVariableAddress(name: Text, address: *mut u16) -> Bool {
    run_bool("TS_GetVariableAddress", || {
        // SAFETY: as promised by the caller.
        unsafe {
            let name = read_text(name)?;
            write_value(address, target()?.variable(&name)?.address)
        }
    })
}

/// Writes a variable of 16 bits.
///
/// # Safety
/// `name` ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_SetIntVariable(name: Text, value: c_short) -> Bool {
    run_bool("TS_SetIntVariable", || {
        // SAFETY: as promised by the caller.
        let name = unsafe { read_text(name) }?;
        target()?.write_variable(&name, &WORDS, value)
    })
}

/// Reads a variable of 16 bits from the selected axis.
///
/// # Safety
/// `name` ends with a zero byte, and `value` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_GetIntVariable(name: Text, value: *mut c_short) -> Bool {
    run_bool("TS_GetIntVariable", || {
        // SAFETY: as promised by the caller.
        unsafe {
            let name = read_text(name)?;
            write_value(value, target()?.read_variable(&name, &WORDS)? as c_short)
        }
    })
}

/// Writes a variable of 32 bits.
///
/// # Safety
/// `name` ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_SetLongVariable(name: Text, value: c_long) -> Bool {
    run_bool("TS_SetLongVariable", || {
        // SAFETY: as promised by the caller.
        let name = unsafe { read_text(name) }?;
        target()?.write_variable(&name, &LONGS, position(value)?)
    })
}

/// Reads a variable of 32 bits from the selected axis. `long` is that of the platform's C compiler, and the value
/// keeps its sign.
///
/// # Safety
/// `name` ends with a zero byte, and `value` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_GetLongVariable(name: Text, value: *mut c_long) -> Bool {
    run_bool("TS_GetLongVariable", || {
        // SAFETY: as promised by the caller.
        unsafe {
            let name = read_text(name)?;
            let read = target()?.read_variable(&name, &LONGS)? as i32;
            write_value(value, c_long::from(read))
        }
    })
}

/// Reads the internal units of position in one turn of the motor, from the drive (ENCRESLONG).
///
/// # Safety
/// `value` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_GetMotorPositionScalingFactor(value: *mut f64) -> Bool {
    run_bool("TS_GetMotorPositionScalingFactor", || {
        let counts = target()?.read_variable("ENCRESLONG", &LONGS)?;
        if counts <= 0 {
            return Err(TmlError::new(format!(
                "the drive has {counts} counts in a turn (ENCRESLONG): its set-up is not loaded"
            )));
        }
        // SAFETY: as promised by the caller.
        unsafe { write_value(value, counts as f64) }
    })
}

/// Writes a fixed-point variable: 16 bits before the point and 16 behind it.
///
/// # Safety
/// `name` ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_SetFixedVariable(name: Text, value: f64) -> Bool {
    run_bool("TS_SetFixedVariable", || {
        // SAFETY: as promised by the caller.
        let name = unsafe { read_text(name) }?;
        let value = fixed(&name, value)?;
        target()?.write_variable(&name, &[VariableKind::Fixed], value)
    })
}

/// Reads a fixed-point variable from the selected axis.
///
/// # Safety
/// `name` ends with a zero byte, and `value` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_GetFixedVariable(name: Text, value: *mut f64) -> Bool {
    run_bool("TS_GetFixedVariable", || {
        // SAFETY: as promised by the caller.
        unsafe {
            let name = read_text(name)?;
            let raw = target()?.read_variable(&name, &[VariableKind::Fixed])? as i32;
            write_value(value, f64::from(raw) / 65536.0)
        }
    })
}
