//! Words as parts of paths.

use std::fmt::Write as _;

/// Date of rows without a time: readers of partitions take it for null.
pub(crate) const NO_DATE: &str = "__HIVE_DEFAULT_PARTITION__";

/// A word as part of a path, other signs than letters, digits, `-`, `_` and `.` by their bytes: `%2F`.
pub(crate) fn escape(word: &str) -> String {
    let mut out = String::new();
    for byte in word.bytes() {
        let plain = byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
        if plain { out.push(byte.into()) } else { _ = write!(out, "%{byte:02X}") }
    }
    if out.is_empty() { NO_DATE.to_owned() } else { out }
}
