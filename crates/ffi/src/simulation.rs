//! The simulation behind a `sim:` link: what its motors do, and what happens to them.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::c_char;

use polepair::simulate::{Simulation, parse_act};

use crate::error::{CallError, pp_status};
use crate::handle::run;
use crate::link::{pp_link, read_seconds};
use crate::text::{SizedStruct, read_text, write_struct};

/// True state of a simulated motor, independent of the reports of its drive.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct pp_truth {
    /// Size of this struct, set by the caller.
    pub size: u32,
    /// 1 if the power stage is on.
    pub enabled: u32,
    /// The drive's fault code or bits; 0 for none.
    pub fault: u32,
    /// 0.
    pub reserved: u32,
    /// Writes to permanent memory since power-on.
    pub flash_writes: u64,
    /// Shaft position since power-on: rad.
    pub position: f64,
    /// Shaft speed: rad/s.
    pub velocity: f64,
    /// Motor current: A.
    pub current: f64,
    /// Torque: N·m.
    pub torque: f64,
    /// Temperature of the winding: °C.
    pub winding: f64,
}

// SAFETY: size first, then plain numbers.
unsafe impl SizedStruct for pp_truth {}

fn simulation(link: &pp_link) -> Result<&Simulation, CallError> {
    let hint = "open it by a connection string with sim:";
    link.opened()?.simulation().ok_or_else(|| CallError::usage("the link is no simulation", hint))
}

/// Gives the true state of a simulated motor. `drive` counts from 0.
///
/// # Safety
/// `link` is NULL or valid; `truth` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_simulation_truth(
    link: *const pp_link,
    drive: usize,
    truth: *mut pp_truth,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(link, |link| {
            let found = simulation(link)?.truth(0, drive);
            let found = found.ok_or_else(|| no_such_drive(drive))?;
            let value = pp_truth {
                size: 0,
                enabled: found.enabled.into(),
                fault: found.fault,
                reserved: 0,
                flash_writes: found.flash_writes,
                position: found.position,
                velocity: found.velocity,
                current: found.current,
                torque: found.torque,
                winding: found.winding,
            };
            write_struct(truth, &value)
        })
    }
}

/// Does something to a simulated drive, as `polepair act`: "supply=18", "home=0.5turn", "power-cycle"
/// (docs/reference/command-line/simulate-and-serve.md). `drive` counts from 0.
///
/// # Safety
/// `link` is NULL or valid; `act` has `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_simulation_act(
    link: *const pp_link,
    drive: usize,
    act: *const c_char,
    length: usize,
) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(link, |link| {
            let act = parse_act(read_text(act, length)?)?;
            if simulation(link)?.act(0, drive, act) { Ok(()) } else { Err(no_such_drive(drive)) }
        })
    }
}

/// Lets virtual time pass, in a simulation with `time=virtual`.
///
/// # Safety
/// `link` is NULL or valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pp_simulation_advance(link: *const pp_link, seconds: f64) -> pp_status {
    // SAFETY: as promised by the caller.
    unsafe {
        run(link, |link| {
            simulation(link)?.advance(read_seconds(seconds)?);
            Ok(())
        })
    }
}

fn no_such_drive(drive: usize) -> CallError {
    CallError::usage(format!("the simulation has no drive {drive}, or it cannot do that"), "")
}
