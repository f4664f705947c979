//! Texts and structs that cross the interface.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::{CStr, c_char};
use std::mem::size_of;

use crate::PP_NTS;
use crate::error::{CallError, PP_BUFFER, PP_OK, pp_status};

/// A struct that begins with its size.
///
/// # Safety
/// The first field is a `u32`, and every bit pattern of a prefix is valid.
pub unsafe trait SizedStruct: Copy {}

/// The caller's text.
///
/// # Safety
/// `text` is NULL, or points to `length` bytes, or with [`PP_NTS`] to a text that ends with a zero byte.
pub unsafe fn read_text<'a>(text: *const c_char, length: usize) -> Result<&'a str, CallError> {
    if text.is_null() {
        return Err(CallError::usage("a text is NULL", ""));
    }
    // SAFETY: as promised by the caller.
    let bytes = unsafe {
        match length {
            PP_NTS => CStr::from_ptr(text).to_bytes(),
            _ => std::slice::from_raw_parts(text.cast(), length),
        }
    };
    std::str::from_utf8(bytes).map_err(|_| CallError::usage("a text is not UTF-8", ""))
}

/// Copies bytes into the caller's buffer, with a zero byte behind them if `is_text`, and returns their number.
///
/// # Safety
/// `buffer` is NULL or has `capacity` bytes; `length` is NULL or valid.
pub unsafe fn write_bytes(
    bytes: &[u8],
    is_text: bool,
    buffer: *mut u8,
    capacity: usize,
    length: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        if !length.is_null() {
            length.write(bytes.len());
        }
        let needed = bytes.len() + usize::from(is_text);
        if buffer.is_null() || capacity < needed {
            return PP_BUFFER;
        }
        std::ptr::copy_nonoverlapping(bytes.as_ptr(), buffer, bytes.len());
        if is_text {
            buffer.add(bytes.len()).write(0);
        }
    }
    PP_OK
}

/// Writes a result.
///
/// # Safety
/// `out` is NULL or valid.
pub unsafe fn write_value<T>(out: *mut T, value: T) -> Result<(), CallError> {
    if out.is_null() {
        return Err(CallError::usage("the pointer for a result is NULL", ""));
    }
    // SAFETY: as promised by the caller.
    unsafe { out.write(value) };
    Ok(())
}

/// Writes as much of a struct as the caller knows; its size stays as the caller set it.
///
/// # Safety
/// `out` is NULL, or its first field is the number of bytes that may be written.
pub unsafe fn write_struct<T: SizedStruct>(out: *mut T, value: &T) -> Result<(), CallError> {
    if out.is_null() {
        return Err(CallError::usage("the pointer for a result is NULL", ""));
    }
    // SAFETY: as promised by the caller and by the trait.
    unsafe {
        let size = checked_size::<T>(out.cast::<u32>().read())?;
        let (from, to) = (std::ptr::from_ref(value).cast::<u8>(), out.cast::<u8>());
        let skipped = size_of::<u32>();
        std::ptr::copy_nonoverlapping(from.add(skipped), to.add(skipped), size - skipped);
    }
    Ok(())
}

/// The caller's struct over a default, as far as the caller knows it.
///
/// # Safety
/// `given` is NULL, or its first field is the number of bytes that may be read.
pub unsafe fn read_struct<T: SizedStruct>(given: *const T, default: T) -> Result<T, CallError> {
    let mut value = default;
    if !given.is_null() {
        // SAFETY: as promised by the caller and by the trait.
        unsafe {
            let size = checked_size::<T>(given.cast::<u32>().read())?;
            let to = std::ptr::from_mut(&mut value).cast::<u8>();
            std::ptr::copy_nonoverlapping(given.cast::<u8>(), to, size);
        }
    }
    Ok(value)
}

/// Number of bytes of a struct caller and library both know.
fn checked_size<T>(size: u32) -> Result<usize, CallError> {
    let size = size as usize;
    if size < size_of::<u32>() * 2 || size > 1 << 16 {
        let hint = "set its first field to its size: struct.size = sizeof struct";
        return Err(CallError::usage(format!("the size of a struct is {size}"), hint));
    }
    Ok(size.min(size_of::<T>()))
}
