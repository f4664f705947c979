//! Words in the drive's memory.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use polepair::Program;

use crate::Bool;
use crate::call::{CallResult, TmlError, read_array, run_bool, write_value};
use crate::channel::target;

/// Programs, cams and buffers lie from here on; below is data memory.
const PROGRAM_MEMORY: u16 = 0x4000;
/// The EEPROM ends before this address.
const EEPROM_END: u16 = 0x8000;

fn check_range(address: u16, count: u16) -> CallResult<()> {
    if count == 0 {
        return Err(TmlError::new("there is nothing to transfer: nSize is 0"));
    }
    if address < PROGRAM_MEMORY {
        return Err(TmlError::new(format!(
            "0x{address:04X} is in data memory: use the functions for variables"
        )));
    }
    if address.checked_add(count - 1).is_none() {
        return Err(TmlError::new(format!("{count} words from 0x{address:04X} do not fit")));
    }
    Ok(())
}

/// Writes words from an address on, EEPROM included, and verifies them. The motor must have no power.
///
/// # Safety
/// `words` has `count` words.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_SetBuffer(address: u16, words: *const u16, count: u16) -> Bool {
    run_bool("TS_SetBuffer", || {
        check_range(address, count)?;
        // SAFETY: as promised by the caller.
        let words = unsafe { read_array(words, count.into()) }?;
        let program = Program::from_words(address, words.to_vec());
        target()?.axis.download(&program, true, |_| ())?;
        Ok(())
    })
}

/// Reads words from an address on.
///
/// # Safety
/// `words` has room for `count` words.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_GetBuffer(address: u16, words: *mut u16, count: u16) -> Bool {
    run_bool("TS_GetBuffer", || {
        check_range(address, count)?;
        if words.is_null() {
            return Err(TmlError::new("an array is NULL"));
        }
        let read = target()?.axis.upload(address, count.into(), |_| ())?;
        let read = read.pieces().first().map_or(&[][..], |piece| &piece.words);
        if read.len() != usize::from(count) {
            return Err(TmlError::new(format!("{} of {count} words were read", read.len())));
        }
        // SAFETY: as promised by the caller.
        unsafe { std::ptr::copy_nonoverlapping(read.as_ptr(), words, read.len()) };
        Ok(())
    })
}

/// Asks the drive for the sum of its words from `start` to `end`, modulo 65536.
///
/// # Safety
/// `sum` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_OnlineChecksum(start: u16, end: u16, sum: *mut u16) -> Bool {
    run_bool("TS_OnlineChecksum", || {
        let memory = if start < EEPROM_END { "spi" } else { "pm" };
        let text = format!("?CHECKSUM,{memory} 0x{start:04X}, 0x{end:04X}");
        let value = target()?.query(&text)?;
        // SAFETY: as promised by the caller.
        unsafe { write_value(sum, value as u16) }
    })
}
