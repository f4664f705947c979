//! Digital inputs and outputs.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_short;

use crate::call::{CallResult, TmlError, run_bool, write_value};
use crate::channel::target;
use crate::execute::WORDS;
use crate::{Bool, Text};

/// Lines that an instruction can name.
const LINES: u8 = 16;
/// The variable with all inputs.
const INPUTS: &str = "INSTATUS";

/// The number of a line, if there is such a line.
pub fn check_line(line: u8) -> CallResult<u8> {
    if line < LINES {
        return Ok(line);
    }
    Err(TmlError::new(format!(
        "there is no line {line}: instructions name lines 0 to {}",
        LINES - 1
    )))
}

/// Makes a line an input.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetupInput(line: u8) -> Bool {
    run_bool("TS_SetupInput", || target()?.execute(&format!("SetAsInput({})", check_line(line)?)))
}

/// Makes a line an output.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetupOutput(line: u8) -> Bool {
    run_bool("TS_SetupOutput", || target()?.execute(&format!("SetAsOutput({})", check_line(line)?)))
}

/// Reads an input, 0 to 15, as a bit of INSTATUS: 0 or 1.
///
/// # Safety
/// `value` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_GetInput(line: u8, value: *mut u8) -> Bool {
    run_bool("TS_GetInput", || {
        let line = check_line(line)?;
        let inputs = target()?.read_variable(INPUTS, &WORDS)?;
        // SAFETY: as promised by the caller.
        unsafe { write_value(value, (inputs >> line & 1) as u8) }
    })
}

/// Sets an output, 0 to 15, to 0 or 1.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetOutput(line: u8, value: u8) -> Bool {
    run_bool("TS_SetOutput", || {
        let mask = 1_u16 << check_line(line)?;
        let value = match value {
            0 => 0,
            1 => mask,
            other => {
                return Err(TmlError::new(format!("value {other} of an output is not 0 or 1")));
            }
        };
        target()?.execute(&format!("OUT({line}) = {value}"))
    })
}

/// Reads all inputs, one bit each. `name` was the variable that the original used in between; it is not needed.
///
/// # Safety
/// `values` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_GetMultipleInputs(_name: Text, values: *mut c_short) -> Bool {
    run_bool("TS_GetMultipleInputs", || {
        let inputs = target()?.read_variable(INPUTS, &WORDS)?;
        // SAFETY: as promised by the caller.
        unsafe { write_value(values, inputs as c_short) }
    })
}

/// Sets all outputs, 0 to 15, to the bits of `values`. `name` was the variable that the original used in between; it is
/// not needed.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetMultipleOutputs(_name: Text, values: c_short) -> Bool {
    run_bool("TS_SetMultipleOutputs", || set_outputs(!0, values as u16))
}

/// Sets the outputs whose bits are in `lines` to the bits of `values`.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetMultipleOutputs2(lines: c_short, values: c_short) -> Bool {
    run_bool("TS_SetMultipleOutputs2", || set_outputs(lines as u16, values as u16))
}

fn set_outputs(lines: u16, values: u16) -> CallResult<()> {
    let numbers = (0..LINES).filter(|line| lines >> line & 1 != 0);
    let numbers: Vec<String> = numbers.map(|line| line.to_string()).collect();
    if numbers.is_empty() {
        return Ok(());
    }
    target()?.execute(&format!("OUT({}) = {}", numbers.join(", "), values & lines))
}
