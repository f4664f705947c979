//! Axes: descriptions, arming, stopping, faults.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_char;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use polepair::Axis;
use polepair::interface::{AxisRequest, Reply};
use polepair_core::profile::AxisKind;

use crate::error::{CallError, ErrorSlot, PP_OK, pp_error, pp_status};
use crate::fixed_text::copy_text;
use crate::handle::{Handle, return_handle, run, take_back, with_handle};
use crate::link::{check_open, copy_error, copy_error_text, pp_link, read_seconds};
use crate::text::{SizedStruct, read_text, write_bytes, write_struct, write_value};

/// One axis of a link: a motor. Several handles may stand for the same axis.
#[derive(Debug)]
pub struct pp_axis {
    axis: Axis,
    closed: Arc<AtomicBool>,
    /// Seconds as the bits of a double; NaN for none.
    time_limit: AtomicU64,
    errors: ErrorSlot,
}

impl Handle for pp_axis {
    fn errors(&self) -> &ErrorSlot {
        &self.errors
    }
}

impl pp_axis {
    /// The axis, if its link is open.
    pub(crate) fn opened(&self) -> Result<&Axis, CallError> {
        check_open(&self.closed)?;
        Ok(&self.axis)
    }

    /// Flag that is set when the link was closed.
    pub(crate) fn closed_flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.closed)
    }

    /// Waits for the end of a request, at most for the time limit.
    pub(crate) fn finish(&self, mut request: AxisRequest) -> Result<Reply, CallError> {
        let seconds = f64::from_bits(self.time_limit.load(Ordering::Relaxed));
        match Duration::try_from_secs_f64(seconds) {
            Err(_) => Ok(request.finish()?),
            Ok(limit) => request.wait(limit)?.ok_or_else(CallError::time_limit),
        }
    }
}

/// Description of an axis. Texts end with a zero byte.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct pp_axis_info {
    /// Size of this struct, set by the caller.
    pub size: u32,
    /// The drive's address on the wire.
    pub number: u32,
    /// 0 rotary (rad), 1 linear (m), 2 a share of full scale (-1 to 1).
    pub kind: u32,
    /// 1 if the drive is simulated.
    pub is_simulated: u32,
    /// Name in a rack file. May be empty.
    pub name: [c_char; 64],
    /// "axis 1", or "axis 1 (x)" if it has a name.
    pub label: [c_char; 64],
    /// The protocol's word: "tmcl".
    pub protocol: [c_char; 32],
    /// The profile's word: "tmcm-170".
    pub profile: [c_char; 64],
    /// The product's full name.
    pub title: [c_char; 128],
    /// Checks before the first motion. May be empty.
    pub caution: [c_char; 512],
    /// Reaction of the drive when its host falls silent.
    pub watchdog: [c_char; 256],
}

// SAFETY: size first, then plain numbers and bytes.
unsafe impl SizedStruct for pp_axis_info {}

/// Opens a handle for the axis at this place of a link, from 0 on.
///
/// Close it by `pp_axis_close`. Nothing is sent. PP_USAGE if there is no such axis.
///
/// # Safety
/// `link` is NULL or valid; `axis` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_axis_at(
    link: *const pp_link,
    index: usize,
    axis: *mut *mut pp_axis,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        return_axis(link, axis, |link| {
            let axes = link.opened()?.axes();
            axes.get(index).cloned().ok_or_else(|| {
                let what = format!("there is no axis {index} of {}", axes.len());
                CallError::usage(
                    what,
                    "places are counted from 0; pp_link_axis_count tells how many",
                )
            })
        })
    }
}

/// Opens a handle for an axis by its number or name: "1", "x", "1.2" for motor 2 of module 1.
///
/// # Safety
/// `link` is NULL or valid; `name` has `length` bytes; `axis` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_link_axis(
    link: *const pp_link,
    name: *const c_char,
    length: usize,
    axis: *mut *mut pp_axis,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        return_axis(link, axis, |link| Ok(link.opened()?.axis_named(read_text(name, length)?)?))
    }
}

unsafe fn return_axis(
    link: *const pp_link,
    out: *mut *mut pp_axis,
    find: impl FnOnce(&pp_link) -> Result<Axis, CallError>,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(link, |link| {
            write_value(out, std::ptr::null_mut())?;
            let (axis, closed) = (find(link)?, link.closed_flag());
            let time_limit = AtomicU64::new(f64::NAN.to_bits());
            return_handle(out, pp_axis { axis, closed, time_limit, errors: ErrorSlot::default() });
            Ok(())
        })
    }
}

/// Closes a handle of an axis. The motor is left as it is: `pp_axis_release` or `pp_link_close` stops it.
///
/// # Safety
/// `axis` is NULL or a handle that no other thread uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_close(axis: *mut pp_axis) {
    // SAFETY: as promised by the caller.
    drop(unsafe { take_back(axis) });
}

/// Copies the last error of an axis handle. PP_NOTHING if no call has failed.
///
/// # Safety
/// `axis` and `error` are NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_error(axis: *const pp_axis, error: *mut pp_error) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { copy_error(axis, error) }
}

/// Copies the last error of an axis handle as one text, for languages without structs: "E216: axis 1: …". PP_NOTHING
/// if no call has failed. As `pp_link_url` for the buffer.
///
/// # Safety
/// `axis` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_error_text(
    axis: *const pp_axis,
    buffer: *mut c_char,
    capacity: usize,
    needed: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { copy_error_text(axis, buffer, capacity, needed) }
}

/// Limits how long calls on this handle wait for a drive. A call that reaches it returns PP_PENDING, and its
/// request continues: the drive may still execute it. 0 or less for no limit, which is so at first: requests end
/// by themselves after the time-outs of their protocol. Stopping is not limited.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_set_time_limit(axis: *const pp_axis, seconds: f64) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let limit = if seconds > 0.0 { read_seconds(seconds)?.as_secs_f64() } else { f64::NAN };
            axis.time_limit.store(limit.to_bits(), Ordering::Relaxed);
            Ok(())
        })
    }
}

/// Describes an axis. Nothing is sent.
///
/// Example:
///
/// ```c
/// pp_axis_info info = { .size = sizeof info };
/// pp_axis_get_info(axis, &info);
/// puts(info.title);
/// ```
///
/// # Safety
/// `axis` is NULL or valid; `info` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_get_info(
    axis: *const pp_axis,
    info: *mut pp_axis_info,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let facts = axis.axis.facts();
            let mut value = pp_axis_info {
                size: 0,
                number: facts.number,
                kind: match facts.kind {
                    AxisKind::Rotary => 0,
                    AxisKind::Linear => 1,
                    AxisKind::Ratio => 2,
                },
                is_simulated: facts.is_simulated.into(),
                name: [0; 64],
                label: [0; 64],
                protocol: [0; 32],
                profile: [0; 64],
                title: [0; 128],
                caution: [0; 512],
                watchdog: [0; 256],
            };
            copy_text(&facts.name, &mut value.name);
            copy_text(&facts.label, &mut value.label);
            copy_text(&facts.protocol, &mut value.protocol);
            copy_text(&facts.profile, &mut value.profile);
            copy_text(&facts.title, &mut value.title);
            copy_text(&facts.caution, &mut value.caution);
            copy_text(&facts.watchdog_rule, &mut value.watchdog);
            write_struct(info, &value)
        })
    }
}

/// Reads the device information, a line each: "firmware: 1.42". As `pp_link_url` for the buffer.
///
/// # Safety
/// `axis` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_device(
    axis: *const pp_axis,
    buffer: *mut c_char,
    capacity: usize,
    needed: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        with_handle(axis, |axis| {
            let details = axis.opened()?.device_details()?;
            let lines = details.iter().map(|detail| format!("{}: {}\n", detail.name, detail.text));
            let text: String = lines.collect();
            Ok(write_bytes(text.as_bytes(), true, buffer.cast(), capacity, needed))
        })
    }
}

/// Arms an axis: motion commands of this program are allowed. On a server this acquires the lease. Nothing moves.
/// PP_USAGE with E220 if it is armed already.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_arm(axis: *const pp_axis) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { run(axis, |axis| Ok(axis.opened()?.arm()?)) }
}

/// Stops, disables and disarms an axis that this program armed. A stop without a reply is repeated for ten
/// seconds. If `may_turn` of the error is 1, cut the supply.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_release(axis: *const pp_axis) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { run(axis, |axis| Ok(axis.opened()?.interface().release()?)) }
}

/// Disarms an axis, and leaves the motor as it is. A server stops a motion when the lease ends.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_disarm(axis: *const pp_axis) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { run(axis, |axis| Ok(axis.opened()?.disarm()?)) }
}

/// Reports whether this program armed the axis: 1 or 0.
///
/// # Safety
/// `axis` is NULL or valid; `armed` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_is_armed(axis: *const pp_axis, armed: *mut i32) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { run(axis, |axis| write_value(armed, axis.opened()?.is_armed().into())) }
}

/// Stops the motor, armed or not, and returns when standstill is confirmed. Thread-safe: a stop overtakes
/// requests of other threads. If `may_turn` of the error is 1, cut the supply.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_stop(axis: *const pp_axis) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { run(axis, |axis| Ok(axis.opened()?.stop()?)) }
}

/// An active fault or warning.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct pp_fault {
    /// Size of this struct, set by the caller.
    pub size: u32,
    /// The drive's code.
    pub code: u32,
    /// 1 if the drive continues.
    pub is_warning: u32,
    /// 0.
    pub reserved: u32,
    /// The manual's short name.
    pub name: [c_char; 64],
    /// Name of the fault in words.
    pub text: [c_char; 128],
    /// Usual cause of the fault.
    pub cause: [c_char; 256],
    /// Remedy of the fault.
    pub remedy: [c_char; 256],
}

// SAFETY: size first, then plain numbers and bytes.
unsafe impl SizedStruct for pp_fault {}

/// Reads which faults are active. `*count` gets their number; the fault at `index` is copied to `fault`, which may
/// be NULL to ask for the number alone. PP_OK as well if there is none, and `fault` is left alone.
///
/// # Safety
/// `axis` is NULL or valid; `fault` is NULL or valid; `count` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_fault(
    axis: *const pp_axis,
    index: usize,
    fault: *mut pp_fault,
    count: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        with_handle(axis, |axis| {
            let faults = axis.opened()?.faults()?;
            write_value(count, faults.len())?;
            if let (Some(found), false) = (faults.get(index), fault.is_null()) {
                let mut value = pp_fault {
                    size: 0,
                    code: found.code,
                    is_warning: found.is_warning.into(),
                    reserved: 0,
                    name: [0; 64],
                    text: [0; 128],
                    cause: [0; 256],
                    remedy: [0; 256],
                };
                copy_text(&found.name, &mut value.name);
                copy_text(&found.text, &mut value.text);
                copy_text(&found.cause, &mut value.cause);
                copy_text(&found.remedy, &mut value.remedy);
                write_struct(fault, &value)?;
            }
            Ok(PP_OK)
        })
    }
}

/// Reads the drive's watchdog: seconds without a message of its host after which it stops, NaN for none.
///
/// # Safety
/// `axis` is NULL or valid; `seconds` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_watchdog(axis: *const pp_axis, seconds: *mut f64) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let after = axis.opened()?.watchdog()?.after;
            write_value(seconds, after.map_or(f64::NAN, |after| after.as_secs_f64()))
        })
    }
}

/// Sets the drive's watchdog; 0 switches it off. PP_USAGE for a drive without one that can be set.
///
/// # Safety
/// `axis` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_set_watchdog(axis: *const pp_axis, seconds: f64) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let after = read_seconds(seconds)?;
            Ok(axis.opened()?.set_watchdog((!after.is_zero()).then_some(after)).map(drop)?)
        })
    }
}
