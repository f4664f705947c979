//! Adds single captures to a data set, for programs that read and store files themselves.

use std::ffi::OsString;
use std::path::Path;

use clap::Parser;
use polepair_capture::CaptureFormat;
use polepair_columns::DatasetSite;

use super::columns;
use super::folder::CaptureReport;
use crate::cmd::decode::Decode;
use crate::problem::{Exit, Problem, Result};

/// Options of `polepair decode` that hold for a capture of a data set.
const OPTIONS: [&str; 7] =
    ["--as", "--profile", "--from", "--times", "--site", "--gateway", "--tables"];

#[derive(Parser)]
struct DatasetCommand {
    #[command(flatten)]
    decode: Decode,
}

/// Result of a capture of a data set.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct DatasetCapture {
    /// False where the data set had it already, decoded with the same options.
    pub is_new: bool,
    /// Parts that were left out, and doubtful ones.
    pub remarks: Vec<String>,
}

/// Reason why a capture was not decoded.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct DatasetError {
    /// Stable: `E510`.
    pub code: String,
    /// Description of the error, in one or two sentences.
    pub message: String,
    /// Remedy to try; may be empty.
    pub hint: String,
    /// A file could not be read or written: another attempt may succeed.
    pub is_io: bool,
}

impl From<Problem> for DatasetError {
    fn from(problem: Problem) -> Self {
        let Problem { exit, code, what, why, hints, .. } = problem;
        let message = if why.is_empty() { what } else { format!("{what} {why}") };
        let is_io = exit == Exit::Adapter;
        Self { code: code.into_owned(), message, hint: hints.join("; "), is_io }
    }
}

/// Returns whether a name ends as the names of captures do.
#[must_use]
pub fn is_capture_name(name: &str) -> bool {
    CaptureFormat::from_path(Path::new(name)).is_some()
}

/// Checks options of `polepair decode`, and gives all that a decoded capture depends on beside itself.
///
/// # Errors
/// An option does not hold.
pub fn decode_inputs(options: &[String]) -> std::result::Result<String, DatasetError> {
    Ok(parse(Path::new("capture"), options).and_then(|decode| read_inputs(&decode))?)
}

fn read_inputs(decode: &Decode) -> std::result::Result<String, Problem> {
    decode.stated.source()?;
    let tables = columns::parse_tables(decode.tables.as_deref())?;
    let site = DatasetSite { root: Path::new("").to_owned(), name: decode.site.clone() };
    Ok(decode.folder_job(site, &tables).record("").inputs)
}

/// Decodes a capture on this thread into the data set at `root`. Its rows are called by `name`.
///
/// # Errors
/// The capture cannot be read, the data set cannot be written, or an option does not hold.
pub fn decode_capture(
    capture: &Path,
    name: &str,
    root: &Path,
    options: &[String],
) -> std::result::Result<DatasetCapture, DatasetError> {
    let decode_one = |decode: &Decode| -> Result<CaptureReport> {
        let tables = columns::parse_tables(decode.tables.as_deref())?;
        let site = DatasetSite { root: root.to_owned(), name: decode.site.clone() };
        decode.folder_job(site, &tables).decode_one(capture, name, 1)
    };
    let decode = parse(capture, options)?;
    let CaptureReport { is_new, remarks, .. } = decode_one(&decode)?;
    Ok(DatasetCapture { is_new, remarks })
}

fn parse(capture: &Path, options: &[String]) -> Result<Decode> {
    let mut words: Vec<OsString> = vec!["decode".into()];
    for option in options.chunks(2) {
        let [name, value] = option else { return Err(unknown_option(options)) };
        if !OPTIONS.contains(&name.as_str()) {
            return Err(unknown_option(options));
        }
        words.push(format!("{name}={value}").into());
    }
    words.extend(["--jobs=1".into(), "--".into(), capture.into()]);
    let command = DatasetCommand::try_parse_from(words);
    command.map(|it| it.decode).map_err(|error| {
        let text = error.to_string();
        let line = text.lines().next().unwrap_or_default().trim_start_matches("error: ");
        Problem::usage("E250", format!("{line}."))
    })
}

fn unknown_option(options: &[String]) -> Problem {
    Problem::usage("E250", format!("{:?} are not options of a data set.", options.join(" ")))
        .hint(format!("pairs of an option and its value: {}", OPTIONS.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::{decode_inputs, is_capture_name};

    #[test]
    fn options_are_checked_before_anything_is_read() {
        let check = |options: &[&str]| {
            decode_inputs(&options.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>())
        };
        let inputs = check(&["--as", "canopen", "--site", "hall 2"]).unwrap();
        assert!(inputs.contains("site=hall 2") && inputs.contains("as=canopen"), "{inputs}");
        assert_ne!(check(&["--tables", "frames"]), check(&[]));
        for wrong in [
            &["--as", "canopne"][..],
            &["--out", "elsewhere"],
            &["--as"],
            &["--tables", "frame"],
            &["--from", "nothing"],
        ] {
            let error = check(wrong).unwrap_err();
            assert!(!error.is_io && error.code.starts_with("E2"), "{error:?}");
        }
        assert!(is_capture_name("a/b.log") && is_capture_name("c.blf") && !is_capture_name("d.md"));
    }
}
