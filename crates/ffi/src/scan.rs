//! Scans: which drives are on a wire.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_char;
use std::ops::ControlFlow;

use polepair::scan::{ScanReport, scan};

use crate::error::{CallError, ErrorSlot, PP_OK, PP_USAGE, pp_error, pp_status};
use crate::fixed_text::copy_text;
use crate::handle::{Handle, defect, return_handle, run, take_back};
use crate::link::{copy_error, copy_error_text};
use crate::text::{SizedStruct, read_text, write_struct, write_value};

/// Result of a scan.
#[derive(Debug)]
pub struct pp_scan {
    found: Option<ScanReport>,
    errors: ErrorSlot,
}

impl Handle for pp_scan {
    fn errors(&self) -> &ErrorSlot {
        &self.errors
    }
}

/// A drive that a scan has found. Texts end with a zero byte.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct pp_found {
    /// Size of this struct, set by the caller.
    pub size: u32,
    /// Address on the wire.
    pub number: u32,
    /// The profile's word: "tmcm-170".
    pub profile: [c_char; 64],
    /// The product's full name.
    pub title: [c_char; 128],
    /// Identity that the drive reports. May be empty.
    pub identity: [c_char; 256],
    /// Conflict of its address: two drives share it. May be empty.
    pub clash: [c_char; 256],
}

// SAFETY: size first, then plain numbers and bytes.
unsafe impl SizedStruct for pp_found {}

/// Scans a wire for drives, by reads only: addresses `first` to `last` of a connection string without `#`.
///
/// `*scan` is set even if the scan fails: the handle then keeps the error, and must be closed. Blocks until every
/// address was tried; `pp_scan_count` is 0 if no drive replied. Nothing moves.
///
/// # Safety
/// `url` has `length` bytes; `scan` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_scan_open(
    url: *const c_char,
    length: usize,
    first: u32,
    last: u32,
    scan: *mut *mut pp_scan,
) -> pp_status {
    if scan.is_null() {
        return PP_USAGE;
    }
    let errors = ErrorSlot::default();
    let looked = std::panic::catch_unwind(|| {
        // SAFETY: as promised by the caller.
        let url = unsafe { read_text(url, length)? };
        let connector = polepair::Connector::discover();
        Ok::<_, CallError>(self::scan(&connector, url, first..=last, &mut |_| {
            ControlFlow::Continue(())
        })?)
    })
    .unwrap_or_else(|_| Err(defect()));
    let (found, status) = match looked {
        Ok(found) => (Some(found), PP_OK),
        Err(failure) => (None, errors.store(failure)),
    };
    // SAFETY: as promised by the caller.
    unsafe { return_handle(scan, pp_scan { found, errors }) };
    status
}

/// The number of drives that were found.
///
/// # Safety
/// `scan` is NULL or valid; `count` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_scan_count(scan: *const pp_scan, count: *mut usize) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(scan, |scan| {
            write_value(count, scan.found.as_ref().map_or(0, |found| found.found.len()))
        })
    }
}

/// Describes the drive at this index, from 0 on.
///
/// # Safety
/// `scan` is NULL or valid; `found` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_scan_at(
    scan: *const pp_scan,
    index: usize,
    found: *mut pp_found,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(scan, |scan| {
            let drive = scan.found.as_ref().and_then(|all| all.found.get(index));
            let drive =
                drive.ok_or_else(|| CallError::usage("there is no such drive", "pp_scan_count"))?;
            let mut value = pp_found {
                size: 0,
                number: drive.number,
                profile: [0; 64],
                title: [0; 128],
                identity: [0; 256],
                clash: [0; 256],
            };
            copy_text(drive.profile.name, &mut value.profile);
            copy_text(drive.profile.title, &mut value.title);
            copy_text(&drive.identified.to_string(), &mut value.identity);
            let clash = drive.clash.as_ref().map(ToString::to_string).unwrap_or_default();
            copy_text(&clash, &mut value.clash);
            write_struct(found, &value)
        })
    }
}

/// Copies the error of a scan. PP_NOTHING if it has none.
///
/// # Safety
/// `scan` and `error` are NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_scan_error(scan: *const pp_scan, error: *mut pp_error) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { copy_error(scan, error) }
}

/// Copies the last error of a scan handle as one text, for languages without structs: "E216: axis 1: …". PP_NOTHING
/// if no call has failed. As `pp_link_url` for the buffer.
///
/// # Safety
/// `scan` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_scan_error_text(
    scan: *const pp_scan,
    buffer: *mut c_char,
    capacity: usize,
    needed: *mut usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe { copy_error_text(scan, buffer, capacity, needed) }
}

/// Closes a scan.
///
/// # Safety
/// `scan` is NULL or a handle that no other thread uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_scan_close(scan: *mut pp_scan) {
    // SAFETY: as promised by the caller.
    drop(unsafe { take_back(scan) });
}
