//! Power, status, and when a motion mode takes effect.
#![allow(unsafe_code, reason = "programs in C call it, with pointers of theirs")]

use std::ffi::{c_int, c_long, c_short};

use crate::Bool;
use crate::call::{CallResult, TmlError, run_bool, write_value};
use crate::channel::target;
use crate::execute::WORDS;

/// Registers as [`TS_ReadStatus`] numbers them.
const REGISTERS: [&str; 8] = ["MCR", "MSR", "ISR", "SRL", "SRH", "MER", "DER", "DER2"];
/// MER.2: the set-up table is invalid.
const MER_SETUP: i64 = 1 << 2;
/// SRH.0: ENDINIT was executed.
const SRH_ENDINIT: i64 = 1;

/// Sends one text to the selected axis or group.
pub fn command(function: &str, text: &str) -> Bool {
    run_bool(function, || target()?.execute(text))
}

/// A position of the drive: 32 bits.
pub fn position(value: c_long) -> CallResult<i32> {
    i32::try_from(value)
        .map_err(|_| TmlError::new(format!("position {value} is out of range: it has 32 bits")))
}

/// Checks that the drive's set-up table is valid, ends the initialisation, and waits until it has.
#[unsafe(no_mangle)]
pub extern "system" fn TS_DriveInitialisation() -> Bool {
    run_bool("TS_DriveInitialisation", || {
        let target = target()?;
        target.check_single("the result of the initialisation")?;
        if target.read_variable("MER", &WORDS)? & MER_SETUP != 0 {
            return Err(TmlError::new(
                "the drive's set-up table is invalid: download its set-up with the vendor's software, then \
                 reset the drive",
            ));
        }
        target.execute("ENDINIT")?;
        target.wait_for(|target| Ok(target.read_variable("SRH", &WORDS)? & SRH_ENDINIT != 0))
    })
}

/// Resets the selected drives (`RESET`). They are disabled.
#[unsafe(no_mangle)]
pub extern "system" fn TS_Reset() -> Bool {
    command("TS_Reset", "RESET")
}

/// Clears faults whose cause is gone (`FAULTR`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_ResetFault() -> Bool {
    command("TS_ResetFault", "FAULTR")
}

/// Stores all settings in the drive's EEPROM (`SAVE`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_Save() -> Bool {
    command("TS_Save", "SAVE")
}

/// Powers the motor (`AXISON`), or takes the power off it (`AXISOFF`). SRL.15 is set while it has power.
#[unsafe(no_mangle)]
pub extern "system" fn TS_Power(enable: Bool) -> Bool {
    command("TS_Power", if enable == 0 { "AXISOFF" } else { "AXISON" })
}

/// Reads a register of the selected axis: 0 MCR, 1 MSR, 2 ISR, 3 SRL, 4 SRH, 5 MER, 6 DER, 7 DER2.
///
/// # Safety
/// `status` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn TS_ReadStatus(register: c_short, status: *mut u16) -> Bool {
    run_bool("TS_ReadStatus", || {
        let name = usize::try_from(register).ok().and_then(|place| REGISTERS.get(place));
        let name = name.ok_or_else(|| {
            TmlError::new(format!("{register} is not a register: they are 0 (MCR) to 7 (DER2)"))
        })?;
        let value = target()?.read_variable(name, &WORDS)?;
        // SAFETY: as promised by the caller.
        unsafe { write_value(status, value as u16) }
    })
}

/// Has the motion parameters take effect now (`UPD`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_UpdateImmediate() -> Bool {
    command("TS_UpdateImmediate", "UPD")
}

/// Has the motion parameters take effect at the event that is set (`UPD!`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_UpdateOnEvent() -> Bool {
    command("TS_UpdateOnEvent", "UPD!")
}

/// Sets the actual position, in counts (`SAP`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetPosition(value: c_long) -> Bool {
    run_bool("TS_SetPosition", || target()?.execute(&format!("SAP {}", position(value)?)))
}

/// Sets the current of a stepper at standstill, in the drive's unit (`IDRSTEP`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetCurrent(value: c_short) -> Bool {
    run_bool("TS_SetCurrent", || target()?.execute(&format!("IDRSTEP = {value}")))
}

/// Sets the target position to the actual position (`STA`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetTargetPositionToActual() -> Bool {
    command("TS_SetTargetPositionToActual", "STA")
}

/// Stops the motor with the deceleration that is set (`STOP`). It keeps its power.
#[unsafe(no_mangle)]
pub extern "system" fn TS_Stop() -> Bool {
    command("TS_Stop", "STOP")
}

/// Sets the deceleration of quick stops, in counts per slow loop squared (`CDEC`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_QuickStopDecelerationRate(deceleration: f64) -> Bool {
    run_bool("TS_QuickStopDecelerationRate", || {
        let text = format!("CDEC = {}", crate::variable::fixed("the deceleration", deceleration)?);
        target()?.execute(&text)
    })
}

/// Makes the axis send its time to the others at this period, in slow loops; 0 ends it (`SETSYNC`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_SendSynchronization(period: c_int) -> Bool {
    run_bool("TS_SendSynchronization", || target()?.execute(&format!("SETSYNC {period}")))
}

/// Sets the counts of one turn of a gear's or cam's master; 0x80000001 for a master without end (`MASTERRES`).
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetMasterResolution(counts: c_int) -> Bool {
    run_bool("TS_SetMasterResolution", || target()?.execute(&format!("MASTERRES = {counts}")))
}
