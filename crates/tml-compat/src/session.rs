//! Channels, set-ups, and the selected axis.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::{c_char, c_int};

use crate::call::{last_error, last_error_text, read_text, run, run_bool, write_text};
use crate::channel::{self, BROADCAST, group_address};
use crate::{Bool, Text};

/// Text of the thread's last error, valid until its next function fails. Empty without one.
#[unsafe(no_mangle)]
pub extern "system" fn TS_GetLastErrorText() -> Text {
    last_error()
}

/// Copies the text of the thread's last error, as much as fits into `capacity` bytes.
///
/// # Safety
/// `buffer` has `capacity` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_Basic_GetLastErrorText(buffer: *mut c_char, capacity: c_int) {
    let text = last_error_text();
    let capacity = usize::try_from(capacity).unwrap_or(0);
    // SAFETY: as promised by the caller. Without a buffer there is no text to give.
    let _ = unsafe { write_text(&text, buffer, capacity) };
}

/// Opens a channel, selects it and returns its descriptor, or -1.
///
/// `device` is a port (`/dev/ttyUSB0`, `COM1`), a CAN interface (`can0`), the address of a serial server
/// (`10.0.0.5:4001`), or a connection string (`tmlcan+socketcand://10.0.0.5/can0`). On RS-232, `host` is the axis
/// ID of the drive at the cable; on RS-485 and CAN, an axis ID that no drive has.
///
/// # Safety
/// `device` ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_OpenChannel(
    device: Text,
    channel_type: u8,
    host: u8,
    baud: u32,
) -> c_int {
    run("TS_OpenChannel", -1, || {
        // SAFETY: as promised by the caller.
        let device = unsafe { read_text(device) }?;
        channel::open(&device, channel_type, host, baud)
    })
}

/// Selects an open channel, for this thread.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SelectChannel(descriptor: c_int) -> Bool {
    run_bool("TS_SelectChannel", || channel::select_channel(descriptor))
}

/// Closes a channel; -1 is the selected one. The drives stay as they are: stop them first.
#[unsafe(no_mangle)]
pub extern "system" fn TS_CloseChannel(descriptor: c_int) {
    run_bool("TS_CloseChannel", || channel::close(descriptor));
}

/// Loads a set-up archive (`.t.zip`), or a folder with `variables.cfg`, and returns its index, or -1.
///
/// # Safety
/// `path` ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_LoadSetup(path: Text) -> c_int {
    run("TS_LoadSetup", -1, || {
        // SAFETY: as promised by the caller.
        let path = unsafe { read_text(path) }?;
        channel::load_setup(&path)
    })
}

/// Gives an axis of the selected channel the names of a set-up.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetupAxis(axis: u8, setup: c_int) -> Bool {
    run_bool("TS_SetupAxis", || channel::set_up(axis.into(), setup))
}

/// Gives a group of the selected channel, 1 to 8, the names of a set-up.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetupGroup(group: u8, setup: c_int) -> Bool {
    run_bool("TS_SetupGroup", || channel::set_up(group_address(group)?, setup))
}

/// Gives the broadcast of the selected channel, to all of its axes, the names of a set-up.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetupBroadcast(setup: c_int) -> Bool {
    run_bool("TS_SetupBroadcast", || channel::set_up(BROADCAST, setup))
}

/// Has this thread's commands go to an axis that is set up.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SelectAxis(axis: u8) -> Bool {
    run_bool("TS_SelectAxis", || channel::select_address(axis.into()))
}

/// Has this thread's commands go to a group that is set up.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SelectGroup(group: u8) -> Bool {
    run_bool("TS_SelectGroup", || channel::select_address(group_address(group)?))
}

/// Has this thread's commands go to all axes of the channel.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SelectBroadcast() -> Bool {
    run_bool("TS_SelectBroadcast", || channel::select_address(BROADCAST))
}
