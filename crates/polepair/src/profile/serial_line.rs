//! The serial line of a drive from the factory: `line = { baud = 38400, parity = "even", stop = 1 }`.

use polepair_core::convert::saturating;
use polepair_core::medium::{Parity, SerialLine};

use super::read::optional_choice;
use crate::toml_file::{FileError, TomlTable};

const BAUD_MAX: i64 = 4_000_000;
const PARITIES: [(&str, Parity); 3] =
    [("none", Parity::None), ("even", Parity::Even), ("odd", Parity::Odd)];

/// Reads the table, if there is one.
pub(super) fn read(node: &TomlTable<'_, '_>) -> Result<Option<SerialLine>, FileError> {
    let Some(table) = node.table("line", &["baud", "parity", "stop", "bits"])? else {
        return Ok(None);
    };
    let Some(baud) = table.integer_between("baud", 1, BAUD_MAX)? else {
        return Err(table.location().error("`line` needs a `baud` rate"));
    };
    let plain = SerialLine::new_8n1(saturating(baud));
    let stop_bits = table.integer_between("stop", 1, 2)?.map_or(plain.stop_bits, saturating);
    let data_bits = table.integer_between("bits", 7, 8)?.map_or(plain.data_bits, saturating);
    let parity = optional_choice(&table, "parity", &PARITIES)?.unwrap_or(Parity::None);
    Ok(Some(SerialLine { parity, stop_bits, data_bits, ..plain }))
}
