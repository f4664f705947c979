//! Parameters of an axis: reading, writing, describing them.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_char;

use polepair::interface::{ParameterDescription, ReadValue, WriteValue};
use polepair::{Amount, Axis};
use polepair_core::profile::ParameterId;

use crate::axis::pp_axis;
use crate::error::{CallError, PP_OK, pp_status};
use crate::fixed_text::copy_text;
use crate::handle::{run, with_handle};
use crate::text::{SizedStruct, read_text, write_bytes, write_struct, write_value};

/// Reads a number in the unit of its parameter: "max current" in A, for example.
///
/// `name` is a name, the manual's symbol, or an address in the protocol's notation: "max current", "AP 6",
/// "0x6041", "R 51" (docs/reference/addresses.md). `*value` is NaN while its scale is not known. PP_USAGE for a
/// name that the drive does not have, with the nearest one as hint, and for text and bytes. Blocks until the
/// drive has replied. Thread-safe.
///
/// Example:
///
/// ```c
/// double current;
/// if (pp_axis_get(axis, "max current", PP_NTS, &current) == PP_OK)
///     printf("%g A\n", current);
/// ```
///
/// # Safety
/// `axis` is NULL or valid; `name` has `length` bytes; `value` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_get(
    axis: *const pp_axis,
    name: *const c_char,
    length: usize,
    value: *mut f64,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let (read, name) = read_number(axis, name, length)?;
            read.require_raw(name)?;
            write_value(value, read.value)
        })
    }
}

/// Reads the raw value of a parameter, as it is on the wire. As `pp_axis_get`.
///
/// # Safety
/// As `pp_axis_get`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_get_raw(
    axis: *const pp_axis,
    name: *const c_char,
    length: usize,
    value: *mut i64,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let (read, name) = read_number(axis, name, length)?;
            write_value(value, read.require_raw(name)?)
        })
    }
}

/// Reads a parameter of any kind as people read it: "1.2 A", "on", text, or bytes in hexadecimal.
///
/// Reads a parameter as text: the name as in `pp_axis_get`, the buffer as in `pp_link_url`. With PP_BUFFER the
/// parameter was read, and is read again by the next call.
///
/// # Safety
/// As `pp_axis_get`; `buffer` has `capacity` bytes; `needed` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_get_text(
    axis: *const pp_axis,
    name: *const c_char,
    length: usize,
    buffer: *mut c_char,
    capacity: usize,
    needed: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        with_handle(axis, |axis| {
            let opened = axis.opened()?;
            let read = opened.read(read_text(name, length)?)?;
            Ok(write_bytes(read.text.as_bytes(), true, buffer.cast(), capacity, needed))
        })
    }
}

/// Reads all bytes of a parameter that holds text or bytes, without its final zeros if it is text.
///
/// # Safety
/// As `pp_axis_get_text`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_get_bytes(
    axis: *const pp_axis,
    name: *const c_char,
    length: usize,
    buffer: *mut u8,
    capacity: usize,
    needed: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        with_handle(axis, |axis| {
            let bytes = axis.opened()?.get_bytes(read_text(name, length)?)?;
            Ok(write_bytes(&bytes, false, buffer, capacity, needed))
        })
    }
}

/// Writes a number in the unit of its parameter. It is not stored in permanent memory.
///
/// Behind the maker's symbol ("AP 6", "CSPD", "0x6083") a number could also be meant as the drive's own: PP_USAGE with
/// E217 where the two differ. Use the parameter's name, `pp_axis_set_raw` or `pp_axis_set_text`.
///
/// Limits are checked before a byte is sent: PP_USAGE with E216 outside of them, and with E219 for a parameter that
/// may move the motor of an axis that is not armed. Blocks until the drive has acknowledged it. Thread-safe.
///
/// # Safety
/// `axis` is NULL or valid; `name` has `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_set(
    axis: *const pp_axis,
    name: *const c_char,
    length: usize,
    value: f64,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { write(axis, name, length, || Ok(WriteValue::Amount(Amount::from(value))), 0) }
}

/// Writes a raw value, as it is on the wire. As `pp_axis_set`; with `store` other than 0 the drive also keeps it
/// in its permanent memory.
///
/// # Safety
/// As `pp_axis_set`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_set_raw(
    axis: *const pp_axis,
    name: *const c_char,
    length: usize,
    value: i64,
    store: i32,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { write(axis, name, length, || Ok(WriteValue::Raw(value)), store) }
}

/// Writes a value with its unit, or one of the parameter's words: "1200 mA", "on". As `pp_axis_set_raw`. Without a unit
/// it is in the parameter's unit, and behind the maker's symbol ("AP 6", "CSPD", "0x6083") the drive's own number.
///
/// # Safety
/// As `pp_axis_set`; `value` has `value_length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_set_text(
    axis: *const pp_axis,
    name: *const c_char,
    length: usize,
    value: *const c_char,
    value_length: usize,
    store: i32,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        write(
            axis,
            name,
            length,
            || Ok(WriteValue::Amount(Amount::from(read_text(value, value_length)?))),
            store,
        )
    }
}

/// Writes all bytes of a parameter that holds text or bytes. PP_USAGE with E257 on a server.
///
/// # Safety
/// `axis` is NULL or valid; `name` has `length` bytes; `bytes` has `count` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_set_bytes(
    axis: *const pp_axis,
    name: *const c_char,
    length: usize,
    bytes: *const u8,
    count: usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let opened = axis.opened()?;
            let id = opened.find(read_text(name, length)?)?;
            if bytes.is_null() {
                return Err(CallError::usage("the bytes are NULL", ""));
            }
            let bytes = std::slice::from_raw_parts(bytes, count);
            Ok(opened.interface().write_data(id, bytes)?)
        })
    }
}

/// Sends a request in the protocol's own text, and returns the value in the reply: "GAP 6, 0", "?APOS",
/// "read 0x6041" (`polepair encode --help`). PP_USAGE for what may move the motor of an axis that is not armed.
///
/// # Safety
/// `axis` is NULL or valid; `text` has `length` bytes; `value` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_send(
    axis: *const pp_axis,
    text: *const c_char,
    length: usize,
    value: *mut i64,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let text = read_text(text, length)?;
            let request = axis.opened()?.interface().start_raw(text)?;
            let reply = axis.finish(request)?.raw(text)?;
            if value.is_null() { Ok(()) } else { write_value(value, reply) }
        })
    }
}

/// A parameter, without its value. Texts end with a zero byte.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct pp_parameter {
    /// Size of this struct, set by the caller.
    pub size: u32,
    /// 1 if it can be read.
    pub readable: u32,
    /// 1 if it can be written.
    pub writable: u32,
    /// 1 if writing it may move the motor.
    pub moves: u32,
    /// Least raw value.
    pub raw_min: i64,
    /// Greatest raw value.
    pub raw_max: i64,
    /// The name that users type.
    pub name: [c_char; 128],
    /// Designation in the manual: "AP 6".
    pub symbol: [c_char; 64],
    /// Symbol of its unit. May be empty.
    pub unit: [c_char; 32],
    /// "number", "text" or "bytes".
    pub kind: [c_char; 16],
    /// Persistence of a written value: "volatile", "storable", "always", "unless-ram".
    pub persistence: [c_char; 32],
    /// Description. May be empty.
    pub about: [c_char; 512],
}

// SAFETY: size first, then plain numbers and bytes.
unsafe impl SizedStruct for pp_parameter {}

/// The number of parameters of an axis. A server is asked once.
///
/// # Safety
/// `axis` is NULL or valid; `count` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_parameter_count(
    axis: *const pp_axis,
    count: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { run(axis, |axis| write_value(count, axis.opened()?.parameters()?.len())) }
}

/// Describes the parameter at this place, from 0 on. Nothing is sent. PP_USAGE if there is none.
///
/// # Safety
/// `axis` is NULL or valid; `parameter` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_axis_parameter_at(
    axis: *const pp_axis,
    index: usize,
    parameter: *mut pp_parameter,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(axis, |axis| {
            let all = axis.opened()?.parameters()?;
            write_struct(
                parameter,
                &describe(all.get(index).ok_or_else(|| {
                    let what = format!("there is no parameter {index} of {}", all.len());
                    CallError::usage(what, "places are counted from 0; pp_axis_parameter_count")
                })?),
            )
        })
    }
}

fn describe(found: &ParameterDescription) -> pp_parameter {
    let mut value = pp_parameter {
        size: 0,
        readable: found.readable.into(),
        writable: found.writable.into(),
        moves: found.moves.into(),
        raw_min: found.raw_range.0,
        raw_max: found.raw_range.1,
        name: [0; 128],
        symbol: [0; 64],
        unit: [0; 32],
        kind: [0; 16],
        persistence: [0; 32],
        about: [0; 512],
    };
    copy_text(&found.name, &mut value.name);
    copy_text(&found.symbol, &mut value.symbol);
    copy_text(&found.unit, &mut value.unit);
    copy_text(&found.kind, &mut value.kind);
    copy_text(&found.persistence, &mut value.persistence);
    copy_text(&found.about, &mut value.about);
    value
}

/// Reads a number within the time limit of the handle; the name is for errors.
unsafe fn read_number<'a>(
    axis: &pp_axis,
    name: *const c_char,
    length: usize,
) -> Result<(ReadValue, &'a str), CallError> {
    // SAFETY: as promised by the caller.
    let name = unsafe { read_text(name, length)? };
    let (opened, id) = find(axis, name)?;
    let reply = axis.finish(opened.interface().start_read(id)?)?;
    Ok((opened.interface().reading(id, reply)?, name))
}

fn find<'a>(axis: &'a pp_axis, name: &str) -> Result<(&'a Axis, ParameterId), CallError> {
    let opened = axis.opened()?;
    Ok((opened, opened.find(name)?))
}

unsafe fn write(
    axis: *const pp_axis,
    name: *const c_char,
    length: usize,
    value: impl FnOnce() -> Result<WriteValue, CallError>,
    store: i32,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        with_handle(axis, |axis| {
            let name = read_text(name, length)?;
            let request = axis.opened()?.start_write(name, value()?, store != 0)?;
            axis.finish(request)?;
            Ok(PP_OK)
        })
    }
}
