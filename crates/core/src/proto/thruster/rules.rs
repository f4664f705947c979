//! Requests that a host does not send, with the reasons.

use super::wire::{
    BIT_RATES, CommandKind, CommandWord, ID_MAX, POSITION_MAX, RANGE_PARAMETER, REFUSED, RPM_MIN,
    Request, TIMEOUT_MS,
};
use crate::station::RequestClass;

/// The class that a request has by itself.
#[must_use]
pub fn class_of(request: &Request) -> RequestClass {
    let value = request.value();
    match (request.command, request.command.definition()) {
        (CommandWord::TC | CommandWord::VC, _) if value == 0 => RequestClass::Stop,
        (CommandWord::LS, _) => RequestClass::Stop,
        // Speed 0 starts nothing.
        (CommandWord::LA | CommandWord::LR, _) if request.sub == 0 => RequestClass::ReadBack,
        (_, Some((CommandKind::Query, _))) => RequestClass::Idempotent,
        (CommandWord::VM | CommandWord::ST, _) | (_, Some((CommandKind::Order, _))) => {
            RequestClass::ReadBack
        }
        _ => RequestClass::NoRetry,
    }
}

/// Returns whether a drive stores the setting of a request over power-off (sections 2.2, 2.4, 4.1). \[I\] SP and AZ,
/// which set a value by the manual, without a word on storage.
#[must_use]
pub const fn is_stored(request: &Request) -> bool {
    matches!(
        request.command,
        CommandWord::CI | CommandWord::CB | CommandWord::SR | CommandWord::SP | CommandWord::AZ
    )
}

/// Checks whether a request may be sent.
///
/// # Errors
/// The rule that it breaks, and the remedy.
pub fn check(request: &Request) -> Result<(), &'static str> {
    let Request { command, sub, data } = *request;
    let Some((shape, _)) = command.definition() else {
        return Err("the manual has no such command");
    };
    let Some(data) = data else {
        return match shape {
            CommandKind::Set => Err("this command needs a value: without one drives refuse it"),
            _ => Ok(()),
        };
    };
    if data & 0xFFFF == REFUSED {
        return Err("its last two bytes would be EE EE, which in the reply means refused: \
                    choose a neighbouring value");
    }
    let value = command.width().decode(data);
    match command {
        CommandWord::TC if !is_within(-100, 100, value) => {
            Err("the signal goes from -100 to 100 %")
        }
        CommandWord::VC if value != 0 && value.abs() < i64::from(RPM_MIN) => {
            Err("the slowest speed is 30 rpm; 0 stops")
        }
        CommandWord::VC if value.abs() > i64::from(i16::MAX) => {
            Err("a speed has 16 bits: at most 32767 rpm")
        }
        CommandWord::CI if !is_within(1, ID_MAX.into(), value) => Err("ids are 1 to 127"),
        CommandWord::CB if !BIT_RATES.iter().any(|rate| i64::from(*rate) == value) => {
            Err("bit rates are 1000, 800, 666, 500, 400, 333, 250, 200, 150, 125, 100, 83, 80, \
                 66, 50, 40, 33, 20 and 10 kbit/s")
        }
        CommandWord::ST if value != 0 && !is_valid_timeout(value) => {
            Err("the time is 100 to 60000 ms, or 0 for never")
        }
        CommandWord::VM if value > 0xFFFF => Err("VM has two bytes: flags and frames"),
        CommandWord::SR if value > 0xFF_FFFF => Err("SR has three bytes: frames and an interval"),
        CommandWord::LA if value.abs() > i64::from(POSITION_MAX) => {
            Err("absolute positions go from -179.9 to 179.9 degrees")
        }
        CommandWord::SP if sub == RANGE_PARAMETER => check_range(data),
        _ => Ok(()),
    }
}

fn is_within(min: i64, max: i64, value: i64) -> bool {
    (min..=max).contains(&value)
}

fn is_valid_timeout(value: i64) -> bool {
    u16::try_from(value).is_ok_and(|ms| TIMEOUT_MS.contains(&ms))
}

fn check_range(data: u32) -> Result<(), &'static str> {
    let (reverse, forward) = range_ends(data);
    let max = POSITION_MAX as i16;
    if (-max..=0).contains(&reverse) && (0..=max).contains(&forward) {
        return Ok(());
    }
    Err("the safe range goes from at least -179.9 to at most 179.9 degrees and has zero in it")
}

/// The ends of a safe range, tenths of a degree: reverse, forward.
#[must_use]
pub const fn range_ends(data: u32) -> (i16, i16) {
    (((data >> 16) as u16).cast_signed(), (data as u16).cast_signed())
}

/// The data of a safe range, tenths of a degree.
#[must_use]
pub const fn range_data(reverse: i16, forward: i16) -> u32 {
    (reverse.cast_unsigned() as u32) << 16 | forward.cast_unsigned() as u32
}
