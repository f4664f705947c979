//! Programs in the drive, and instructions as text.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::{c_char, c_int};
use std::path::Path;

use polepair::Program;
use polepair::program::AssemblyContext;

use crate::call::{CallResult, TmlError, read_text, run_bool, sent_text, write_text, write_value};
use crate::channel::{keep_labels, label, target};
use crate::power::command;
use crate::{Bool, Text};

/// Address of text programs: the start of the EEPROM.
const PROGRAM_START: u16 = 0x4000;
/// The largest script, bytes.
const SCRIPT_MAX: u64 = 1 << 20;

/// Sends instructions in TML's own text, separated by `;` or lines. All are checked before the first is sent.
///
/// # Safety
/// `commands` ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_Execute(commands: Text) -> Bool {
    run_bool("TS_Execute", || {
        // SAFETY: as promised by the caller.
        let text = unsafe { read_text(commands) }?;
        target()?.execute(&text)
    })
}

/// Sends the instructions of a text file.
///
/// # Safety
/// `file` ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_ExecuteScript(file: Text) -> Bool {
    run_bool("TS_ExecuteScript", || {
        // SAFETY: as promised by the caller.
        let path = unsafe { read_text(file) }?;
        let whole = |reason: String| TmlError::new(format!("{path}: {reason}"));
        let size = std::fs::metadata(&path).map_err(|error| whole(error.to_string()))?.len();
        if size > SCRIPT_MAX {
            return Err(whole(format!("larger than {SCRIPT_MAX} bytes: is it a script?")));
        }
        let text = std::fs::read_to_string(&path).map_err(|error| whole(error.to_string()))?;
        target()?.execute(&text)
    })
}

/// Copies the instructions that this thread's last function sent, one a line, as many as fit.
///
/// # Safety
/// `buffer` has `capacity` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_GetOutputOfExecute(buffer: *mut c_char, capacity: c_int) -> Bool {
    let text = sent_text();
    crate::call::run("TS_GetOutputOfExecute", 0, || {
        let capacity = usize::try_from(capacity).unwrap_or(0);
        // SAFETY: as promised by the caller.
        unsafe { write_text(&text, buffer, capacity) }?;
        Ok(1)
    })
}

/// Downloads a `.sw` file, or a program in TML's text, to where its first block lies, and has the drive's sums
/// agree. The motor must have no power.
fn download(path: &str) -> CallResult<u16> {
    let target = target()?;
    let (language, profile) = (target.axis.language()?, Some(target.setup));
    let context = AssemblyContext { language, profile, origin: PROGRAM_START };
    let read = Program::read(Path::new(path), &context);
    let program = read.map_err(|error| TmlError::from(&polepair::Error::from(error)))?;
    // The program asked for it: blocks in permanent memory are written.
    target.axis.download(&program, true, |_| ())?;
    keep_labels(program.labels().map(|(name, at)| (name.to_owned(), at)).collect())?;
    let first = program.pieces().first();
    first.map(|piece| piece.start).ok_or_else(|| TmlError::new(format!("{path} is empty")))
}

/// Downloads a program (`.sw`, or TML's text) and returns the address of its first instruction. Object files
/// (`.out`) are not read: have the vendor's software export a `.sw` file.
///
/// # Safety
/// `file` ends with a zero byte, and `entry` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_DownloadProgram(file: Text, entry: *mut u16) -> Bool {
    run_bool("TS_DownloadProgram", || {
        // SAFETY: as promised by the caller.
        let path = unsafe { read_text(file) }?;
        if Path::new(&path).extension().is_some_and(|end| end.eq_ignore_ascii_case("out")) {
            return Err(TmlError::new(
                "object files are not supported: export a .sw file with the vendor's software",
            ));
        }
        let start = download(&path)?;
        // SAFETY: as promised by the caller.
        unsafe { write_value(entry, start) }
    })
}

/// Downloads a `.sw` file to the drive's memory, EEPROM included, and verifies it.
///
/// # Safety
/// `file` ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_DownloadSwFile(file: Text) -> Bool {
    run_bool("TS_DownloadSwFile", || {
        // SAFETY: as promised by the caller.
        let path = unsafe { read_text(file) }?;
        download(&path).map(drop)
    })
}

/// Goes on with the program at an address (`GOTO`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_GOTO(address: u16) -> Bool {
    command("TS_GOTO", &format!("GOTO 0x{address:04X}"))
}

/// Calls a routine (`CALL`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_CALL(address: u16) -> Bool {
    command("TS_CALL", &format!("CALL 0x{address:04X}"))
}

/// Calls a routine that [`TS_ABORT`] can end (`CALLS`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_CancelableCALL(address: u16) -> Bool {
    command("TS_CancelableCALL", &format!("CALLS 0x{address:04X}"))
}

/// Runs an instruction with the address of a label.
///
/// # Safety
/// `name` ends with a zero byte.
unsafe fn run_at_label(function: &str, word: &str, name: Text) -> Bool {
    run_bool(function, || {
        // SAFETY: as promised by the caller.
        let name = unsafe { read_text(name) }?;
        let address = label(&name)?;
        target()?.execute(&format!("{word} 0x{address:04X}"))
    })
}

/// Goes on with the program at a label of the program in TML's text that [`TS_DownloadProgram`] has downloaded.
///
/// # Safety
/// `name` ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_GOTO_Label(name: Text) -> Bool {
    // SAFETY: as promised by the caller.
    unsafe { run_at_label("TS_GOTO_Label", "GOTO", name) }
}

/// Calls a routine at a label, as [`TS_GOTO_Label`] does.
///
/// # Safety
/// `name` ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_CALL_Label(name: Text) -> Bool {
    // SAFETY: as promised by the caller.
    unsafe { run_at_label("TS_CALL_Label", "CALL", name) }
}

/// Calls a routine at a label that [`TS_ABORT`] can end.
///
/// # Safety
/// `name` ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_CancelableCALL_Label(name: Text) -> Bool {
    // SAFETY: as promised by the caller.
    unsafe { run_at_label("TS_CancelableCALL_Label", "CALLS", name) }
}

/// Ends the routine that [`TS_CancelableCALL`] has called (`ABORT`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_ABORT() -> Bool {
    command("TS_ABORT", "ABORT")
}
