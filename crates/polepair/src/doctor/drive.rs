//! A drive that answers: supply, temperature, faults, what it does when the link dies.

use super::Check;
use crate::amount::Value;
use crate::axis::Axis;
use crate::error::{Error, Exit};
use polepair_core::profile::{Access, Fault, Severity, Signal, Watchdog};

/// Below this no motor supply is there, whatever the drive [inferred: the smallest take 7 V].
const VOLTS_MIN: f64 = 5.0;
/// Power stages switch off at 80 to 130 °C [inferred].
const WARM: f64 = 75.0;
/// What no sensor reads that is plugged.
const COLD: f64 = -30.0;

/// Looks at one thing; nothing to say where the drive does not tell it.
type Look = fn(&Axis, &str) -> Result<Option<Check>, Error>;

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

fn read(axis: &Axis, signal: Signal) -> Result<Option<Value>, Error> {
    let Some(source) = axis.profile().signal(signal) else { return Ok(None) };
    let raw = axis.read(source.parameter)?;
    axis.value(source.parameter, raw).map(Some)
}

/// The bits of a signal, and whether they mean true where it is a flag.
fn bits(axis: &Axis, signal: Signal) -> Result<Option<(i64, bool)>, Error> {
    let Some(source) = axis.profile().signal(signal) else { return Ok(None) };
    let masked = axis.read(source.parameter)? & source.mask;
    Ok(Some((masked, source.equals.map_or(masked != 0, |equals| masked == equals))))
}

fn supply(axis: &Axis, about: &str) -> Result<Option<Check>, Error> {
    let volts = read(axis, Signal::Voltage)?;
    Ok(volts.map(|volts| {
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
    Ok(degrees.map(|degrees| {
        let said = format!("temperature {degrees}");
        match degrees.value {
            value if value < COLD => Check::look(about, said, "the sensor's plug and cable"),
            value if value > WARM => Check::look(about, said, "cooling, load, current limit"),
            _ => Check::ok(about, said),
        }
    }))
}

fn faults(axis: &Axis, about: &str) -> Result<Option<Check>, Error> {
    let Some((code, _)) = bits(axis, Signal::Fault)? else { return Ok(None) };
    let named = crate::faults(axis.profile(), u32::try_from(code).unwrap_or(0));
    if code == 0 {
        return Ok(Some(Check::ok(about, "no faults")));
    }
    let text = |fault: &&'static Fault| format!("{} ({}): {}", fault.text, fault.name, fault.cause);
    let said = named.iter().map(text).collect::<Vec<_>>().join(" ");
    let remedies: Vec<&str> = named.iter().map(|fault| fault.remedy).collect();
    let remedy = format!("{} `polepair clear` once the cause is gone", remedies.join(" "));
    let stops = named.iter().any(|fault| fault.severity == Severity::Fault);
    Ok(Some(match (named.is_empty(), stops) {
        (true, _) => {
            Check::look(about, format!("fault code {code:#x}, of which nothing is known"), remedy)
        }
        (false, true) => Check::wrong(about, Exit::DriveFault, said, remedy),
        (false, false) => Check::look(about, said, remedy),
    }))
}

fn powered(axis: &Axis, about: &str) -> Result<Option<Check>, Error> {
    Ok(bits(axis, Signal::Enabled)?.map(|(_, on)| match on {
        true => Check::look(about, "the motor is powered", "`polepair disable` takes power off it"),
        false => Check::ok(about, "the motor has no power"),
    }))
}

fn watchdog(axis: &Axis) -> Check {
    let (about, profile) = (axis.label(), axis.profile());
    match profile.watchdog {
        Watchdog::None => Check::look(
            &about,
            "no watchdog: the motor keeps doing what it was last told if the link dies",
            "an emergency stop that needs no computer",
        ),
        Watchdog::Fixed { after_ms } => {
            Check::ok(&about, format!("stops {after_ms} ms after the link dies"))
        }
        Watchdog::Configurable { parameter } => {
            let found = profile.parameter(parameter);
            let name = found.map_or("?", |parameter| parameter.name);
            if found.is_some_and(|parameter| parameter.access == Access::Write) {
                let said = format!("whether its watchdog ({name}) is on cannot be read");
                return Check::look(&about, said, format!("`polepair set URL {name:?}=…`"));
            }
            match axis.read(parameter).and_then(|raw| Ok((raw, axis.value(parameter, raw)?))) {
                Ok((0, _)) => {
                    let remedy = format!("`polepair set URL {name:?}=…`");
                    Check::look(&about, format!("its watchdog is off ({name} is 0)"), remedy)
                }
                Ok((_, value)) => Check::ok(&about, format!("its watchdog is on: {name} {value}")),
                Err(error) => Check::error(&about, &error),
            }
        }
    }
}
