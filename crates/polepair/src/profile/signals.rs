//! Reads which parameters are the signals of a drive, and by what the end of its motions is judged.

use super::digits::read_values;
use super::draft::{Draft, DraftCoupling, DraftSignal};
use super::motors::MotorChoice;
use super::read::optional_choice;
use super::step;
use crate::toml_file::{FileError, TomlTable};
use polepair_core::profile::{RelativeBase, Signal};

pub(super) fn read_signals(
    draft: &mut Draft,
    node: &TomlTable<'_, '_>,
    motor: MotorChoice,
) -> Result<(), FileError> {
    // A bare TOML key holds no space: `target-velocity` is as good as `"target velocity"`.
    let bare = Signal::ALL.map(|signal| signal.name().replace(' ', "-"));
    let mut names: Vec<&str> =
        bare.iter().map(String::as_str).chain(Signal::ALL.map(Signal::name)).collect();
    names.push(LIMIT);
    let Some(table) = node.table("signals", &names)? else { return Ok(()) };
    if let Some(limit) = table.table(LIMIT, &["parameter", "positive", "negative", "values"])? {
        for (signal, key) in LIMIT_ENDS {
            let Some(bits) = limit.integer(key)? else { continue };
            let source = DraftSignal {
                signal,
                parameter: limit.required_text("parameter")?,
                mask: bits.value,
                equals: Some(bits.value),
                values: read_values(&limit)?
                    .into_iter()
                    .filter(|(raw, _)| *raw == bits.value)
                    .collect(),
            };
            set_signal(draft, source);
        }
    }
    for (signal, bare) in Signal::ALL.into_iter().zip(&bare) {
        let key = if table.has(bare) { bare } else { signal.name() };
        if !table.has(key) {
            continue;
        }
        let source = read_signal_source(&table, key, signal, motor)?;
        set_signal(draft, source);
    }
    Ok(())
}

fn set_signal(draft: &mut Draft, source: DraftSignal) {
    match draft.signals.iter_mut().find(|known| known.signal == source.signal) {
        Some(old) => *old = source,
        None => draft.signals.push(source),
    }
}

/// The key for both limits in one parameter: their bits.
const LIMIT: &str = "limit";
const LIMIT_ENDS: [(Signal, &str); 2] =
    [(Signal::PositiveLimit, "positive"), (Signal::NegativeLimit, "negative")];

const RELATIVE_BASES: [(&str, RelativeBase); 3] = [
    ("actual", RelativeBase::Actual),
    ("target", RelativeBase::Target),
    ("either", RelativeBase::Either),
];

/// Reads the rules for judging the end of a motion.
pub(super) fn read_motion(draft: &mut Draft, node: &TomlTable<'_, '_>) -> Result<(), FileError> {
    let keys = ["window", "relative-from", "halted", "stalled", "unpowered", "coupling"];
    let Some(table) = node.table("motion", &keys)? else { return Ok(()) };
    let motion = &mut draft.motion;
    if let Some(window) = table.text("window")? {
        motion.window = Some(window);
    }
    if let Some(base) = optional_choice(&table, "relative-from", &RELATIVE_BASES)? {
        motion.relative_from = base;
    }
    if let Some(test) = table.text("halted")? {
        motion.halted = Some(step::parse_test(&test)?);
    }
    if let Some(test) = table.text("stalled")? {
        motion.stalled = Some(step::parse_test(&test)?);
    }
    if let Some(test) = table.text("unpowered")? {
        motion.unpowered = Some(step::parse_test(&test)?);
    }
    let parts = ["follower", "master-position", "ratio", "numerator", "denominator", "cam"];
    if let Some(coupling) = table.table("coupling", &parts)? {
        motion.coupling = Some(DraftCoupling {
            follower: coupling.required_text("follower")?,
            master_position: coupling.required_text("master-position")?,
            ratio: coupling.required_text("ratio")?,
            numerator: coupling.required_text("numerator")?,
            denominator: coupling.required_text("denominator")?,
            cam: coupling.required_text("cam")?,
        });
    }
    Ok(())
}

fn read_signal_source(
    table: &TomlTable<'_, '_>,
    key: &str,
    signal: Signal,
    motor: MotorChoice,
) -> Result<DraftSignal, FileError> {
    if !table.is_table(key) {
        let parameter = table.required_text(key)?;
        return Ok(DraftSignal { signal, parameter, mask: -1, equals: None, values: Vec::new() });
    }
    let keys = ["parameter", "mask", "equals", "values"];
    let node = table.table(key, &keys)?.ok_or_else(|| table.location().error("not a table"))?;
    Ok(DraftSignal {
        signal,
        parameter: node.required_text("parameter")?,
        mask: motor.read_integer(&node, "mask")?.map_or(-1, |found| found.value),
        equals: motor.read_integer(&node, "equals")?.map(|found| found.value),
        values: read_values(&node)?,
    })
}
