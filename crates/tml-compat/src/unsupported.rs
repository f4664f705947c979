//! Functions that programs may link and that are not supported: each fails with the reason. Nothing is sent.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_short;

use crate::call::{TmlError, run_bool};
use crate::{Bool, Text};

const HOME: &str = "which input is the home input is in the drive's set-up, whose format is not public: use the \
                    function for digital inputs with its number";
const CAM_FILE: &str = "the format of cam files is not public: write the table with TS_SetBuffer";
const SCALING: &str = "the scaling is in the drive's set-up, whose format is not public: `polepair info` shows the \
                       units of a drive that it knows";
const VERSION: &str =
    "how the original encodes the version is not public: `polepair info` shows it";
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
pub extern "system" fn TS_GetFirmwareVersion(_value: *mut i32) -> Bool {
    refuse("TS_GetFirmwareVersion", VERSION)
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
