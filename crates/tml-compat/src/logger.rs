//! The drive's data logger.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use polepair_core::data_logger::LogHead;
use polepair_core::proto::tml::logger::{FAST_LOOP, SLOW_LOOP};

use crate::Bool;
use crate::call::{CallResult, TmlError, read_array, run_bool, write_value};
use crate::channel::{keep_log, log, target};

/// The period of a log at most (header of TML_LIB).
const PERIOD_MAX: u16 = 0x7FFF;
/// A buffer starts at a multiple of this.
const ALIGNMENT: u16 = 8;

/// Points of a buffer's length and its number of words for each.
fn points(length: u16, count: u16) -> CallResult<u16> {
    let room = length.checked_sub(LogHead::len_for(count)).map(|room| room / count);
    room.filter(|points| *points > 0).ok_or_else(|| {
        let need = LogHead::len_for(count).saturating_add(count);
        TmlError::new(format!("a buffer of {length} words is too short: {need} are needed"))
    })
}

/// Writes the head of a log buffer: the addresses to be recorded, and the loops between two points.
///
/// The layout of the head is inferred, because no public text has it: the buffer must be memory that nothing else uses.
///
/// # Safety
/// `addresses` has `count` words.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_SetupLogger(
    buffer: u16,
    length: u16,
    addresses: *const u16,
    count: u16,
    period: u16,
) -> Bool {
    run_bool("TS_SetupLogger", || {
        if count == 0 || period == 0 || period > PERIOD_MAX {
            return Err(TmlError::new("countAddr is 1 or more, and period 1 to 0x7FFF"));
        }
        if !buffer.is_multiple_of(ALIGNMENT) || buffer.checked_add(length).is_none() {
            return Err(TmlError::new(format!(
                "a buffer of {length} words at 0x{buffer:04X} is not possible: it starts at a multiple of 8, and ends \
                 before 0xFFFF"
            )));
        }
        let points = points(length, count)?;
        // SAFETY: as promised by the caller.
        let addresses = unsafe { read_array(addresses, count.into()) }?;
        let target = target()?;
        target.check_single("the head of a log buffer")?;
        target.axis.set_up_drive_log(buffer, points, period, addresses)?;
        keep_log(buffer, points, count)
    })
}

/// Starts the logger in the slow or the fast loop, with the buffer that [`TS_SetupLogger`] has set up.
#[unsafe(no_mangle)]
pub extern "system" fn TS_StartLogger(buffer: u16, kind: u8) -> Bool {
    run_bool("TS_StartLogger", || {
        let bits = match u16::from(kind) {
            known @ (SLOW_LOOP | FAST_LOOP) => known,
            other => {
                return Err(TmlError::new(format!(
                    "LogType {other} is not LOGGER_SLOW (1) or LOGGER_FAST (2)"
                )));
            }
        };
        let target = target()?;
        // The link does not know that the pointer moves no motor.
        target.arm();
        target.axis.start_drive_log(buffer, bits)?;
        Ok(())
    })
}

/// Reads the number of points that are still to come: 0 when the log is complete.
///
/// # Safety
/// `left` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_CheckLoggerStatus(buffer: u16, left: *mut u16) -> Bool {
    run_bool("TS_CheckLoggerStatus", || {
        let target = target()?;
        target.check_single("the number of points to come")?;
        let points = target.axis.drive_log_points_left(buffer)?;
        // SAFETY: as promised by the caller.
        unsafe { write_value(left, points) }
    })
}

/// Stops the logger and reads its values, point by point, as many as `count` allows; `count` becomes their number.
///
/// # Safety
/// `values` has room for `count` words, and `count` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_UploadLoggerResults(
    buffer: u16,
    values: *mut u16,
    count: *mut u16,
) -> Bool {
    run_bool("TS_UploadLoggerResults", || {
        if values.is_null() || count.is_null() {
            return Err(TmlError::new("an array or its size is NULL"));
        }
        let target = target()?;
        target.check_single("a log")?;
        // SAFETY: as promised by the caller.
        let room = unsafe { count.read() };
        let (points, width) = log(buffer)?;
        target.arm();
        target.axis.stop_drive_log()?;
        let left = target.axis.drive_log_points_left(buffer)?;
        let taken = usize::from(points.saturating_sub(left)) * usize::from(width);
        let words = target.axis.read_drive_log(buffer, width, taken.min(room.into()))?;
        // SAFETY: as promised by the caller; there are at most as many.
        unsafe { std::ptr::copy_nonoverlapping(words.as_ptr(), values, words.len()) };
        // SAFETY: as promised by the caller.
        unsafe { write_value(count, words.len() as u16) }
    })
}
