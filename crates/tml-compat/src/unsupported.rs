//! Functions that programs may link and that are not supported: each fails with the reason. Nothing is sent.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_short;

use crate::call::{TmlError, run_bool};
use crate::{Bool, Text};

const HOME: &str = "which input is the home input is in the drive's set-up, whose format is not public: use the \
                    function for digital inputs with its number";
const LOGGER: &str =
    "the layout of the drive's log buffer is not public: `polepair watch` records signals";
const CAM_FILE: &str = "the format of cam files is not public: write the table with TS_SetBuffer";
const OUTPUTS: &str = "the instruction for it is not public: use TS_SetMultipleOutputs2";
const SCALING: &str = "the scaling is in the drive's set-up, whose format is not public: `polepair info` shows the \
                       units of a drive that it knows";
const VERSION: &str =
    "how the original encodes the version is not public: `polepair info` shows it";
const LABELS: &str =
    "labels are in object files, which are not read: use the function with an address";

fn refuse(function: &str, why: &str) -> Bool {
    run_bool(function, || Err(TmlError::new(format!("not supported: {why}"))))
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_CamDownload(
    _file: Text,
    _load: u16,
    _run: u16,
    _next_load: *mut u16,
    _next_run: *mut u16,
) -> Bool {
    refuse("TS_CamDownload", CAM_FILE)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_GetHomeInput(_value: *mut u8) -> Bool {
    refuse("TS_GetHomeInput", HOME)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetEventOnHomeInput(_state: c_short, _wait: Bool, _stop: Bool) -> Bool {
    refuse("TS_SetEventOnHomeInput", HOME)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetMultipleOutputs(_name: Text, _values: c_short) -> Bool {
    refuse("TS_SetMultipleOutputs", OUTPUTS)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_GOTO_Label(_label: Text) -> Bool {
    refuse("TS_GOTO_Label", LABELS)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_CALL_Label(_label: Text) -> Bool {
    refuse("TS_CALL_Label", LABELS)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_CancelableCALL_Label(_label: Text) -> Bool {
    refuse("TS_CancelableCALL_Label", LABELS)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetupLogger(
    _buffer: u16,
    _length: u16,
    _addresses: *const u16,
    _count: u16,
    _period: u16,
) -> Bool {
    refuse("TS_SetupLogger", LOGGER)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_StartLogger(_buffer: u16, _kind: u8) -> Bool {
    refuse("TS_StartLogger", LOGGER)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_CheckLoggerStatus(_buffer: u16, _left: *mut u16) -> Bool {
    refuse("TS_CheckLoggerStatus", LOGGER)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_UploadLoggerResults(
    _buffer: u16,
    _values: *mut u16,
    _count: *mut u16,
) -> Bool {
    refuse("TS_UploadLoggerResults", LOGGER)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_GetFirmwareVersion(_value: *mut i32) -> Bool {
    refuse("TS_GetFirmwareVersion", VERSION)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_GetMotorPositionScalingFactor(_value: *mut f64) -> Bool {
    refuse("TS_GetMotorPositionScalingFactor", SCALING)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_GetLoadPositionScalingFactor(_value: *mut f64) -> Bool {
    refuse("TS_GetLoadPositionScalingFactor", SCALING)
}

/// Not supported.
#[unsafe(no_mangle)]
pub extern "system" fn TS_GetTimeScalingFactor(_value: *mut f64) -> Bool {
    refuse("TS_GetTimeScalingFactor", SCALING)
}
