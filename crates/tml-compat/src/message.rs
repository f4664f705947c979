//! Messages that drives send without being asked.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_long;
use std::sync::{Mutex, PoisonError};

use crate::Bool;
use crate::call::{TmlError, run_bool};
use crate::channel::{messages, target};
use crate::message_queue::DriveMessage;

/// A function of the program: axis ID, address in data memory, value.
pub type Handler = extern "system" fn(axis: u16, address: u16, value: c_long);

static HANDLER: Mutex<Option<Handler>> = Mutex::new(None);

/// Bit 0 of MASTERID: the receiver is a host. Bits 4 to 11 are its axis ID.
const HOST_BIT: u16 = 1;

/// Sets the function that [`TS_CheckForUnrequestedDriveMessages`] calls, for the whole process. NULL removes it.
#[unsafe(no_mangle)]
pub extern "system" fn TS_RegisterHandlerForUnrequestedDriveMessages(handler: Option<Handler>) {
    *HANDLER.lock().unwrap_or_else(PoisonError::into_inner) = handler;
    // A channel that is open listens from now on. Without one, it begins with the first check.
    let _ = messages();
}

/// Calls the program's handler for each message that drives of the selected channel have sent, in the calling
/// thread. Values of 16 bits have their sign.
#[unsafe(no_mangle)]
pub extern "system" fn TS_CheckForUnrequestedDriveMessages() -> Bool {
    run_bool("TS_CheckForUnrequestedDriveMessages", || {
        let queue = messages()?;
        let handler = *HANDLER.lock().unwrap_or_else(PoisonError::into_inner);
        let handler = handler.ok_or_else(|| {
            TmlError::new(
                "there is no handler: call TS_RegisterHandlerForUnrequestedDriveMessages first",
            )
        })?;
        while let Some(DriveMessage { axis, address, value, long }) = queue.pop() {
            let value = if long {
                c_long::from(value.cast_signed())
            } else {
                c_long::from((value as u16).cast_signed())
            };
            handler(axis.into(), address, value);
        }
        Ok(())
    })
}

/// Has the drive send its status (SRL low word, SRH high word) and MER to a host when one of these bits changes.
#[unsafe(no_mangle)]
pub extern "system" fn TS_SendDataToHost(host: u8, status_bits: u32, error_bits: u16) -> Bool {
    run_bool("TS_SendDataToHost", || {
        let [low, high] = [status_bits as u16, (status_bits >> 16) as u16];
        let target = target()?;
        if !target.may_send_unasked {
            return Err(TmlError::new(
                "drives on RS-485 do not send without being asked: read the status instead",
            ));
        }
        let master = u16::from(host) << 4 | HOST_BIT;
        target.execute(&format!(
            "MASTERID = {master};SRL_MASK = {low};SRH_MASK = {high};MER_MASK = {error_bits}"
        ))
    })
}
