//! Versions of the library and of its binary interface.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_char;

/// Version of the binary interface that this header describes. It changes only if a program that was built with
/// an older header would no longer work.
pub const PP_ABI_VERSION: u32 = 0;

/// Version of the binary interface of the library that is loaded. Compare it with `PP_ABI_VERSION`.
#[unsafe(no_mangle)]
pub extern "C" fn pp_abi_version() -> u32 {
    PP_ABI_VERSION
}

/// Version of the library: "0.1.0". The text is constant, ends with a zero byte, and is never freed.
#[unsafe(no_mangle)]
pub extern "C" fn pp_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}
