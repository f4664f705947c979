//! A drive that answers: supply, temperature, faults, what it does when the link dies.

use super::Check;
use crate::amount::Value;
use crate::axis::{Axis, WatchdogState};
use crate::error::{Error, Exit};
use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::{Fault, ParameterId, Severity, Signal};

/// Below this no motor supply is there, whatever the drive [inferred: the smallest take 7 V].
const VOLTS_MIN: f64 = 5.0;
/// Power stages switch off at 80 to 130 °C [inferred].
const WARM: f64 = 75.0;
/// What no sensor reads that is plugged.
const COLD: f64 = -30.0;

/// Looks at one thing; nothing to say where the drive does not tell it.
type Look = fn(&Axis, &str) -> Result<Option<Check>, Error>;

/// What is said of something that a drive has not.
pub const ABSENT: &str = "this firmware has none";

/// Whether a drive that refused a read said by it that it has no such thing. Profiles tell what drives
/// of a kind have; their firmwares differ.
///
/// ```
/// let link = polepair::connect("sim:cia402:5?time=virtual")?;
/// let refused = link.axes()[0].get_raw("0x2345").unwrap_err();
/// assert!(!polepair::doctor::says_absent(&link.axes()[0], &refused), "nobody was asked");
/// # Ok::<(), polepair::Error>(())
/// ```
#[must_use]
pub fn says_absent(axis: &Axis, error: &Error) -> bool {
    let Error::Failed { outcome: Outcome::NotDone(Failure::Refused { code }), .. } = error else {
        return false;
    };
    match axis.protocol() {
        // Invalid command, wrong type, invalid value, command not available.
        "tmcl" => matches!(code, 2 | 3 | 4 | 6),
        // CiA 301: no such object, no such subindex.
        "canopen" => matches!(code, 0x0602_0000 | 0x0609_0011),
        _ => false,
    }
}

/// How a drive's own watchdog is set now; [`WatchdogState::None`] also where its profile has one and its
/// firmware refuses the parameter.
///
/// # Errors
/// [`Error`] by blame.
pub fn watchdog_if_any(axis: &Axis) -> Result<WatchdogState, Error> {
    match axis.watchdog() {
        Err(error) if says_absent(axis, &error) => Ok(WatchdogState::None),
        other => other,
    }
}

/// Looks at one drive, by reads.
pub(super) fn examine(axis: &Axis, hear: &mut dyn FnMut(Check)) {
    let looks: [Look; 4] = [supply, temperature, faults, powered];
    for look in looks {
        let about = axis.label();
        match look(axis, &about) {
            Ok(check) => check.into_iter().for_each(&mut *hear),
            Err(error) => hear(Check::error(&about, &error)),
        }
    }
    hear(watchdog(axis));
}

/// What a drive has that tells a signal.
enum Told<T> {
    /// Its profile knows of none.
    Nowhere,
    /// Its maker left it out, which the standard lets him.
    Lacking(&'static str),
    This(T),
}

fn read(axis: &Axis, signal: Signal) -> Result<Told<Value>, Error> {
    let Some(source) = axis.profile().signal(signal) else { return Ok(Told::Nowhere) };
    match read_if_there(axis, source.parameter)? {
        Some(raw) => axis.value(source.parameter, raw).map(Told::This),
        None => Ok(Told::Lacking(signal.name())),
    }
}

fn read_if_there(axis: &Axis, id: ParameterId) -> Result<Option<i64>, Error> {
    match axis.read_if_any(id) {
        Err(error) if says_absent(axis, &error) => Ok(None),
        other => other,
    }
}

/// The check of what was told; that it is absent is no fault.
fn check<T>(about: &str, told: Told<T>, look: impl FnOnce(T) -> Check) -> Option<Check> {
    match told {
        Told::Nowhere => None,
        Told::Lacking(what) => Some(Check::ok(about, format!("{what}: absent, {ABSENT}"))),
        Told::This(value) => Some(look(value)),
    }
}

/// The bits of a signal, and whether they mean true where it is a flag.
fn bits(axis: &Axis, signal: Signal) -> Result<Told<(i64, bool)>, Error> {
    let Some(source) = axis.profile().signal(signal) else { return Ok(Told::Nowhere) };
    let Some(raw) = read_if_there(axis, source.parameter)? else {
        return Ok(Told::Lacking(signal.name()));
    };
    let masked = raw & source.mask;
    Ok(Told::This((masked, source.equals.map_or(masked != 0, |equals| masked == equals))))
}

fn supply(axis: &Axis, about: &str) -> Result<Option<Check>, Error> {
    let volts = read(axis, Signal::Voltage)?;
    Ok(check(about, volts, |volts| {
        let said = format!("supply {volts}");
        if volts.value < VOLTS_MIN {
            let remedy = "the motor's supply: fuse, emergency stop, polarity; the electronics may \
                          have a supply of their own";
            return Check::wrong(about, Exit::Negative, said, remedy);
        }
        Check::ok(about, said)
    }))
}

fn temperature(axis: &Axis, about: &str) -> Result<Option<Check>, Error> {
    let degrees = read(axis, Signal::Temperature)?;
    Ok(check(about, degrees, |degrees| {
        let said = format!("temperature {degrees}");
        match degrees.value {
            value if value < COLD => Check::look(about, said, "the sensor's plug and cable"),
            value if value > WARM => Check::look(about, said, "cooling, load, current limit"),
            _ => Check::ok(about, said),
        }
    }))
}

fn faults(axis: &Axis, about: &str) -> Result<Option<Check>, Error> {
    Ok(check(about, bits(axis, Signal::Fault)?, |(code, _)| fault(axis, about, code)))
}

fn fault(axis: &Axis, about: &str, code: i64) -> Check {
    let named = crate::faults(axis.profile(), u32::try_from(code).unwrap_or(0));
    if code == 0 {
        return Check::ok(about, "no faults");
    }
    let text = |fault: &&'static Fault| format!("{} ({}): {}", fault.text, fault.name, fault.cause);
    let said = named.iter().map(text).collect::<Vec<_>>().join(" ");
    let remedies: Vec<&str> = named.iter().map(|fault| fault.remedy).collect();
    let remedy = format!("{} `polepair clear` once the cause is gone", remedies.join(" "));
    let stops = named.iter().any(|fault| fault.severity == Severity::Fault);
    match (named.is_empty(), stops) {
        (true, _) => {
            Check::look(about, format!("fault code {code:#x}, of which nothing is known"), remedy)
        }
        (false, true) => Check::wrong(about, Exit::DriveFault, said, remedy),
        (false, false) => Check::look(about, said, remedy),
    }
}

fn powered(axis: &Axis, about: &str) -> Result<Option<Check>, Error> {
    Ok(check(about, bits(axis, Signal::Enabled)?, |(_, on)| match on {
        true => Check::look(about, "the motor is powered", "`polepair disable` takes power off it"),
        false => Check::ok(about, "the motor has no power"),
    }))
}

fn watchdog(axis: &Axis) -> Check {
    let (about, profile) = (axis.label(), axis.profile());
    let id = axis.watchdog_parameter();
    let name = id.and_then(|id| profile.parameter(id)).map_or("", |parameter| parameter.name);
    let state = match watchdog_if_any(axis) {
        Ok(state) => state,
        Err(error) => return Check::error(&about, &error),
    };
    let said = match name {
        "" => format!("its watchdog: {}", axis.watchdog_in_words(state)),
        name => format!("its watchdog ({name}): {}", axis.watchdog_in_words(state)),
    };
    match state {
        WatchdogState::On(_) if axis.owes_heartbeat() => {
            Check::look(&about, said, "add heartbeat=100 to the connection of whoever moves it")
        }
        WatchdogState::On(_) => Check::ok(&about, said),
        WatchdogState::None => Check::look(
            &about,
            "no watchdog: the motor keeps doing what it was last told if the link dies",
            "an emergency stop that needs no computer",
        ),
        WatchdogState::Off
        | WatchdogState::Other { .. }
        | WatchdogState::NoReaction(_)
        | WatchdogState::Untold => {
            Check::look(&about, said, "`polepair watchdog URL 500ms` sets it")
        }
    }
}
