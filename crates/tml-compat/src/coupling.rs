//! Electronic gears and cams between axes.

use std::ffi::{c_long, c_short};

use crate::Bool;
use crate::call::{CallResult, TmlError, run_bool};
use crate::channel::target;
use crate::motion::{gear_ratio, limited_acceleration, start, unless_zero};
use crate::power::position;

/// The bit of an ID word that names a group.
const GROUP_BIT: u16 = 1 << 8;

/// Values that a master sends, and their receiver.
fn master(
    group: Bool,
    slave: u8,
    base: c_short,
    enable: Bool,
    moment: c_short,
) -> CallResult<String> {
    let slave = u16::from(slave) | if group != 0 { GROUP_BIT } else { 0 };
    // OSR.15: the master sends its target, or its position.
    let sends = match base {
        0 => "SRBL OSR, 0x7FFF, 0x0000;",
        1 => "SRBL OSR, 0xFFFF, 0x8000;",
        other => {
            return Err(TmlError::new(format!(
                "ReferenceBase {other} is not FROM_MEASURE (0) or FROM_REFERENCE (1)"
            )));
        }
    };
    let start = start(None, moment)?;
    Ok(match enable {
        0 => format!("RGM;{start}"),
        _ => format!("SLAVEID = {slave};{sends}SGM;{start}"),
    })
}

/// Makes the axis master of a gear, or ends that.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetGearingMaster(
    group: Bool,
    slave: u8,
    base: c_short,
    enable: Bool,
    set_slave_position: Bool,
    moment: c_short,
) -> Bool {
    run_bool("TS_SetGearingMaster", || {
        if set_slave_position != 0 {
            return Err(TmlError::new(
                "SetSlavePos is not supported: the instruction for it is not public; give FALSE",
            ));
        }
        target()?.execute(&master(group, slave, base, enable, moment)?)
    })
}

/// Source of the master position of a slave.
fn source(enable: c_short) -> CallResult<Option<&'static str>> {
    Ok(match enable {
        0 => None,
        1 => Some("EXTREF 0;"),
        2 => Some("EXTREF 2;"),
        other => {
            return Err(TmlError::new(format!(
                "EnableSlave {other} is not SLAVE_NONE (0), SLAVE_COMMUNICATION_CHANNEL (1) or \
                 SLAVE_2ND_ENCODER (2)"
            )));
        }
    })
}

/// Makes the axis slave of a gear.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetGearingSlave(
    denominator: c_short,
    numerator: c_short,
    base: c_short,
    enable: c_short,
    limit: f64,
    moment: c_short,
) -> Bool {
    run_bool("TS_SetGearingSlave", || {
        let (ratio, limit) = (gear_ratio(denominator, numerator)?, limited_acceleration(limit)?);
        let mode = source(enable)?.map_or_else(String::new, |source| format!("{source}MODE GS;"));
        let start = start(Some(base), moment)?;
        target()?.execute(&format!("{ratio}{limit}{mode}{start}"))
    })
}

/// Makes the axis master of a cam, or ends that.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetCammingMaster(
    group: Bool,
    slave: u8,
    base: c_short,
    enable: Bool,
    moment: c_short,
) -> Bool {
    run_bool("TS_SetCammingMaster", || {
        target()?.execute(&master(group, slave, base, enable, moment)?)
    })
}

/// Copies a cam table from the EEPROM to the memory where it is executed (`INITCAM`).
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_CamInitialization(load: u16, run: u16) -> Bool {
    run_bool("TS_CamInitialization", || {
        target()?.execute(&format!("INITCAM 0x{load:04X}, 0x{run:04X}"))
    })
}

/// Common settings of both kinds of cam: table, offset and factors; 0 keeps the previous value.
fn cam(run: u16, offset: c_long, [input, output]: [f64; 2]) -> CallResult<String> {
    let table = match run {
        0 => String::new(),
        // The variable is signed.
        run => format!("CAMSTART = {};", run.cast_signed()),
    };
    let offset = match position(offset)? {
        0 => String::new(),
        offset => format!("CAMOFF = {offset};"),
    };
    Ok(table + &offset + &unless_zero("CAMX", input)? + &unless_zero("CAMY", output)?)
}

/// Makes the axis slave of a relative cam. `run` is the address of the table.
#[allow(unsafe_code, reason = "programs in C call it")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetCammingSlaveRelative(
    run: u16,
    base: c_short,
    enable: c_short,
    moment: c_short,
    offset: c_long,
    input_factor: f64,
    output_factor: f64,
) -> Bool {
    run_bool("TS_SetCammingSlaveRelative", || {
        let cam = cam(run, offset, [input_factor, output_factor])?;
        // ACR.12: the kind of cam.
        let mode = source(enable)?.map_or_else(String::new, |source| {
            format!("{source}SRBL ACR, 0xEFFF, 0x0000;MODE CS;")
        });
        target()?.execute(&format!("{cam}{mode}{}", start(Some(base), moment)?))
    })
}

/// Makes the axis slave of an absolute cam. `limit` is the speed at which it may go to the table's position.
#[allow(unsafe_code, reason = "programs in C call it")]
#[allow(clippy::too_many_arguments, reason = "the prototype is the vendor's")]
#[unsafe(no_mangle)]
pub extern "system" fn TS_SetCammingSlaveAbsolute(
    run: u16,
    limit: f64,
    base: c_short,
    enable: c_short,
    moment: c_short,
    offset: c_long,
    input_factor: f64,
    output_factor: f64,
) -> Bool {
    run_bool("TS_SetCammingSlaveAbsolute", || {
        let cam = cam(run, offset, [input_factor, output_factor])?;
        let limit = match unless_zero("CSPD", limit)? {
            speed if speed.is_empty() => speed,
            speed => format!("{speed}SRBL UPGRADE, 0xFFFF, 0x0004;"),
        };
        let mode = source(enable)?.map_or_else(String::new, |source| {
            format!("{source}SRBL ACR, 0xFFFF, 0x1000;MODE CS;")
        });
        target()?.execute(&format!("{cam}{limit}{mode}{}", start(Some(base), moment)?))
    })
}
