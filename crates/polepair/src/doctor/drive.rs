//! Checks of a drive that replies: supply, temperature, faults, reaction to a lost link.

use super::CheckResult;
use super::objects::check_objects;
use crate::amount::Value;
use crate::axis::{LocalAxis, WatchdogState};
use crate::error::{Error, Exit};
use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::{ParameterId, Signal};

/// Below this no motor supply is there, whatever the drive [inferred: the smallest take 7 V].
const VOLTS_MIN: f64 = 5.0;
/// Power stages switch off at 80 to 130 °C [inferred].
const TEMPERATURE_MAX: f64 = 75.0;
/// Temperature below every plugged sensor, °C.
const TEMPERATURE_MIN: f64 = -30.0;

/// One check of a drive; no result if the drive does not report the value.
type DriveCheck = fn(&LocalAxis, &str) -> Result<Option<CheckResult>, Error>;

/// Text for a function that a drive lacks.
pub const ABSENT_TEXT: &str = "this firmware has none";

/// Returns whether a drive's refusal of a read means that it lacks the object. Profiles describe a kind of drive;
/// firmwares differ.
///
/// ```
/// let link = polepair::connect_local("sim:cia402:5?time=virtual")?;
/// let axis = &link.axes()[0];
/// let refused = axis.get_raw("0x2345").unwrap_err();
/// assert!(polepair::doctor::is_absent_error(axis, &refused));
/// let unasked = axis.get_raw("no such name").unwrap_err();
/// assert!(!polepair::doctor::is_absent_error(axis, &unasked), "the drive was not asked");
/// # Ok::<(), polepair::Error>(())
/// ```
#[must_use]
pub fn is_absent_error(axis: &LocalAxis, error: &Error) -> bool {
    let Error::Failed { outcome: Outcome::NotDone(Failure::Refused { code }), .. } = error else {
        return false;
    };
    match axis.protocol() {
        // Invalid command, wrong type, invalid value, command not available.
        "tmcl" => matches!(code, 2 | 3 | 4 | 6),
        // CiA 301: no such object, no such subindex.
        "canopen" => matches!(code, 0x0602_0000 | 0x0609_0011),
        // Illegal data address (Modbus application protocol 1.1b3, chapter 7).
        protocol if protocol.starts_with("modbus") => *code == 2,
        _ => false,
    }
}

/// Present setting of a drive's own watchdog; [`WatchdogState::None`] also if its profile has one and its firmware
/// refuses the parameter.
///
/// # Errors
/// [`Error`] by blame.
pub fn read_watchdog(axis: &LocalAxis) -> Result<WatchdogState, Error> {
    match axis.watchdog() {
        Err(error) if is_absent_error(axis, &error) => Ok(WatchdogState::None),
        other => other,
    }
}

/// Looks at one drive, by reads.
pub(super) fn check_drive(axis: &LocalAxis, on_event: &mut dyn FnMut(CheckResult)) {
    let looks: [DriveCheck; 5] =
        [check_objects, check_supply, check_temperature, check_faults, check_power];
    for query in looks {
        let about = axis.label();
        match query(axis, &about) {
            Ok(check) => check.into_iter().for_each(&mut *on_event),
            Err(error) => on_event(CheckResult::error(&about, &error)),
        }
    }
    on_event(check_watchdog(axis));
}

/// True if a drive has a signal.
enum Availability<T> {
    /// The profile has no source for it.
    NoSource,
    /// The maker left it out, which the standard permits.
    Absent(&'static str),
    Present(T),
}

fn read_signal(axis: &LocalAxis, signal: Signal) -> Result<Availability<Value>, Error> {
    let Some(source) = axis.profile().signal(signal) else { return Ok(Availability::NoSource) };
    match read_if_present(axis, source.parameter)? {
        Some(raw) => axis.value(source.parameter, raw).map(Availability::Present),
        None => Ok(Availability::Absent(signal.name())),
    }
}

fn read_if_present(axis: &LocalAxis, id: ParameterId) -> Result<Option<i64>, Error> {
    match axis.read_optional(id) {
        Err(error) if is_absent_error(axis, &error) => Ok(None),
        other => other,
    }
}

/// The check of a value; a missing one is not a fault.
fn check_present<T>(
    about: &str,
    availability: Availability<T>,
    query: impl FnOnce(T) -> CheckResult,
) -> Option<CheckResult> {
    match availability {
        Availability::NoSource => None,
        Availability::Absent(what) => {
            Some(CheckResult::ok(about, format!("{what}: absent, {ABSENT_TEXT}")))
        }
        Availability::Present(value) => Some(query(value)),
    }
}

/// The bits of a signal, and whether they mean true where it is a flag.
fn read_signal_bits(axis: &LocalAxis, signal: Signal) -> Result<Availability<(i64, bool)>, Error> {
    let Some(source) = axis.profile().signal(signal) else { return Ok(Availability::NoSource) };
    let Some(raw) = read_if_present(axis, source.parameter)? else {
        return Ok(Availability::Absent(signal.name()));
    };
    Ok(Availability::Present((raw & source.mask, source.is_set(raw))))
}

fn check_supply(axis: &LocalAxis, about: &str) -> Result<Option<CheckResult>, Error> {
    let volts = read_signal(axis, Signal::Voltage)?;
    Ok(check_present(about, volts, |volts| {
        let text = format!("supply {volts}");
        if volts.value < VOLTS_MIN {
            let remedy = "the motor's supply: fuse, emergency stop, polarity; the electronics may \
                          have a supply of their own";
            return CheckResult::wrong(about, Exit::Negative, text, remedy);
        }
        CheckResult::ok(about, text)
    }))
}

fn check_temperature(axis: &LocalAxis, about: &str) -> Result<Option<CheckResult>, Error> {
    let degrees = read_signal(axis, Signal::Temperature)?;
    Ok(check_present(about, degrees, |degrees| {
        let text = format!("temperature {degrees}");
        match degrees.value {
            value if value < TEMPERATURE_MIN => {
                CheckResult::suspicious(about, text, "the sensor's plug and cable")
            }
            value if value > TEMPERATURE_MAX => {
                CheckResult::suspicious(about, text, "cooling, load, current limit")
            }
            _ => CheckResult::ok(about, text),
        }
    }))
}

fn check_faults(axis: &LocalAxis, about: &str) -> Result<Option<CheckResult>, Error> {
    Ok(check_present(about, read_signal_bits(axis, Signal::Fault)?, |(code, _)| {
        fault_check(axis, about, code)
    }))
}

fn fault_check(axis: &LocalAxis, about: &str, raw: i64) -> CheckResult {
    let active = crate::active_faults(axis.profile(), raw);
    if active.is_empty() {
        return CheckResult::ok(about, "no faults");
    }
    let output = active
        .iter()
        .map(|fault| format!("{} ({}): {}", fault.text, fault.name, fault.cause))
        .collect::<Vec<_>>()
        .join(" ");
    let remedies: Vec<&str> = active.iter().map(|fault| &*fault.remedy).collect();
    let remedy = format!("{} `polepair clear` once the cause is gone", remedies.join(" "));
    if active.iter().any(|fault| !fault.is_warning) {
        CheckResult::wrong(about, Exit::DriveFault, output, remedy)
    } else {
        CheckResult::suspicious(about, output, remedy)
    }
}

fn check_power(axis: &LocalAxis, about: &str) -> Result<Option<CheckResult>, Error> {
    Ok(check_present(about, read_signal_bits(axis, Signal::Enabled)?, |(_, on)| {
        if on {
            CheckResult::suspicious(
                about,
                "the motor is powered",
                "`polepair disable` removes the power",
            )
        } else {
            CheckResult::ok(about, "the motor has no power")
        }
    }))
}

fn check_watchdog(axis: &LocalAxis) -> CheckResult {
    let (about, profile) = (axis.label(), axis.profile());
    let id = axis.watchdog_parameter();
    let name = id.and_then(|id| profile.parameter(id)).map_or("", |parameter| parameter.name);
    let state = match read_watchdog(axis) {
        Ok(state) => state,
        Err(error) => return CheckResult::error(&about, &error),
    };
    let text = match name {
        "" => format!("its watchdog: {}", axis.describe_watchdog(state)),
        name => format!("its watchdog ({name}): {}", axis.describe_watchdog(state)),
    };
    match state {
        WatchdogState::On(_) if axis.needs_heartbeat() => CheckResult::suspicious(
            &about,
            text,
            "add heartbeat=100 to the connection string of the program that moves it",
        ),
        WatchdogState::On(_) => CheckResult::ok(&about, text),
        WatchdogState::None => CheckResult::suspicious(
            &about,
            "no watchdog: the motor continues its last command if the link is lost",
            "install an emergency stop that works without a computer",
        ),
        WatchdogState::Off
        | WatchdogState::OtherNode { .. }
        | WatchdogState::LifeGuarding(_)
        | WatchdogState::NoReaction(_)
        | WatchdogState::Unknown => {
            CheckResult::suspicious(&about, text, "`polepair watchdog URL 500ms` sets it")
        }
    }
}
