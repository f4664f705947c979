//! Key `watchdog` of a profile.

use polepair_core::convert::saturating;

use super::draft::DraftWatchdog;
use crate::spelling;
use crate::toml_file::{FileError, Located, TomlTable};

fn read_life_guarding(
    table: &TomlTable<'_, '_>,
) -> Result<Option<[Located<String>; 2]>, FileError> {
    if !table.has("life_guarding") {
        return Ok(None);
    }
    let names = table.texts("life_guarding")?;
    names.try_into().map(Some).map_err(|_| {
        table.location().error("`life_guarding` needs two names: of the period and of the factor")
    })
}

pub(super) fn read_watchdog(node: &TomlTable<'_, '_>) -> Result<Option<DraftWatchdog>, FileError> {
    let keys = ["kind", "after_ms", "parameter", "on_can", "reaction", "life_guarding"];
    let Some(table) = node.table("watchdog", &keys)? else { return Ok(None) };
    let kind = table.required_text("kind")?;
    Ok(Some(match kind.value.as_str() {
        "none" => DraftWatchdog::None,
        "fixed" => {
            let ms = table.integer_between("after_ms", 1, i64::from(u32::MAX))?;
            let ms = ms.ok_or_else(|| kind.location.error("`fixed` needs `after_ms`"))?;
            DraftWatchdog::Fixed(saturating(ms))
        }
        "configurable" => DraftWatchdog::Configurable {
            parameter: table.required_text("parameter")?,
            on_can: table.text("on_can")?,
        },
        "heartbeat" => DraftWatchdog::Heartbeat {
            consumer: table.required_text("parameter")?,
            reaction: table.text("reaction")?,
            life_guarding: read_life_guarding(&table)?,
        },
        "life guarding" => DraftWatchdog::LifeGuarding {
            objects: read_life_guarding(&table)?
                .ok_or_else(|| kind.location.error("`life guarding` needs `life_guarding`"))?,
            reaction: table.text("reaction")?,
        },
        other => {
            let known = ["none", "fixed", "configurable", "heartbeat", "life guarding"];
            let hint = spelling::suggestion(other, known);
            return Err(kind
                .location
                .error(format!("`{other}` is none of {}{hint}", known.join(", "))));
        }
    }))
}
