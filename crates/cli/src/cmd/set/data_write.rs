//! Writes of parameters with any length: text, or the bytes of a file.

use std::fs::File;
use std::io::Read;

use polepair::axis::DATA_MAX;
use polepair::interface::WriteValue;
use polepair::{Amount, LocalAxis};
use polepair_core::profile::{Access, Encoding, ParameterId};

use crate::outcome;
use crate::problem::{Problem, Result};
use crate::progress::Progress;
use crate::value::plural;

/// A write to a parameter that is no number.
pub struct DataWrite {
    id: ParameterId,
    name: &'static str,
    data: Vec<u8>,
    /// The file that the bytes come from.
    file: Option<String>,
}

impl DataWrite {
    /// Write of `NAME=VALUE`; `None` for a number. `@FILE` means the bytes of a file.
    pub fn for_setting(
        axis: &LocalAxis,
        id: ParameterId,
        value: &WriteValue,
    ) -> Result<Option<Self>> {
        let WriteValue::Amount(Amount::Text(value)) = value else { return Ok(None) };
        let Some(parameter) = axis.parameter(id) else { return Ok(None) };
        let file = value.strip_prefix('@').filter(|file| !file.is_empty());
        let untyped = parameter.encoding == Encoding::AnyLength;
        if parameter.encoding.is_number() && !(untyped && file.is_some()) {
            return Ok(None);
        }
        if parameter.access == Access::Read && !untyped {
            let what = format!("{:?} can only be read.", parameter.name);
            return Err(Problem::usage("E214", what).why(outcome::sent_so_far()));
        }
        let data = match (file, parameter.encoding) {
            (Some(file), _) => read_file(file)?,
            (None, Encoding::Text) => value.as_bytes().to_vec(),
            (None, _) => parse_bytes(value)?,
        };
        let file = file.map(str::to_owned);
        Ok(Some(Self { id, name: parameter.name, data, file }))
    }

    /// Description of the planned write.
    pub fn planned(&self) -> String {
        format!("{}: -> {}", self.name, self.described())
    }

    /// Writes the value and returns the line for it.
    pub fn apply(&self, axis: &LocalAxis) -> Result<String> {
        let progress = Progress::of_transfer("written");
        let written = axis.write_data(self.id, &self.data, &mut |count| progress.set(count));
        written.map_err(outcome::to_problem)?;
        Ok(format!("{} = {}", self.name, self.described()))
    }

    fn described(&self) -> String {
        let count = plural(self.data.len() as u64, "byte");
        match &self.file {
            Some(file) => format!("{count} of {file}"),
            None => count,
        }
    }
}

fn read_file(name: &str) -> Result<Vec<u8>> {
    let wrong =
        |why: String| Problem::usage("E230", format!("{name}: {why}.")).why(outcome::sent_so_far());
    let file = File::open(name).map_err(|error| wrong(error.to_string()))?;
    let mut data = Vec::new();
    let most = DATA_MAX as u64 + 1;
    file.take(most).read_to_end(&mut data).map_err(|error| wrong(error.to_string()))?;
    if data.len() > DATA_MAX {
        return Err(wrong("it is larger than 256 MiB".to_owned()));
    }
    if data.is_empty() {
        return Err(wrong("it is empty".to_owned()));
    }
    Ok(data)
}

/// Bytes in hexadecimal: `0F 00` or `0F00`.
fn parse_bytes(text: &str) -> Result<Vec<u8>> {
    let digits: String = text.chars().filter(|c| !c.is_whitespace()).collect();
    let bytes: Option<Vec<u8>> = digits.as_bytes().chunks(2).map(parse_byte).collect();
    bytes.filter(|bytes| !bytes.is_empty()).ok_or_else(|| {
        Problem::usage("E217", format!("{text:?} is not a sequence of bytes."))
            .why(outcome::sent_so_far())
            .hint("two hexadecimal digits a byte, as in \"0F 00\", or @FILE")
    })
}

/// A byte of two hexadecimal digits.
fn parse_byte(digits: &[u8]) -> Option<u8> {
    let hex = digits.len() == 2 && digits.iter().all(u8::is_ascii_hexdigit);
    u8::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok().filter(|_| hex)
}
