//! `polepair fleet …`: the part of the Python package that decodes captures of many machines.

use std::ffi::OsString;
use std::process::{Command, Stdio};

use clap::Args;

use crate::data_output::DataOutput;
use crate::problem::{Exit, Problem, Result};

/// Interpreters by name, in the order in which they are tried.
const INTERPRETERS: [&str; 3] = ["python3", "python", "py"];
/// Ends well where the package is installed.
const PROBE: &str = "import importlib.util, sys; \
                     sys.exit(0 if importlib.util.find_spec('polepair') and \
                     importlib.util.find_spec('polepair.fleet') else 1)";

/// Decodes a folder or bucket of captures to one data set, on this machine or on a Ray cluster, and answers
/// questions about it.
///
/// This is a part of the Python package: pip install "polepair[fleet]"
#[derive(Args, Debug)]
#[command(
    disable_help_flag = true,
    override_usage = "polepair fleet <decode|ask|sql|questions> …",
    after_help = "\
Examples:
  polepair fleet decode captures dataset
  polepair fleet decode s3://plant/captures s3://plant/dataset --ray auto
  polepair fleet questions
  polepair fleet ask dataset faults-by-week
  polepair fleet sql dataset \"select axis, max(value) from signals group by axis\"
  polepair fleet decode --help"
)]
pub struct Fleet {
    /// Words for the Python package; decode --help lists its options
    #[arg(value_name = "WORD", trailing_var_arg = true, allow_hyphen_values = true)]
    words: Vec<OsString>,
}

impl Fleet {
    pub fn run(self) -> Result {
        let interpreter = INTERPRETERS.iter().find(|interpreter| {
            let mut probe = Command::new(interpreter);
            probe.args(["-c", PROBE]).stdin(Stdio::null()).stdout(Stdio::null());
            probe.stderr(Stdio::null()).status().is_ok_and(|status| status.success())
        });
        if self.words.is_empty()
            || interpreter.is_none()
                && self.words.iter().any(|word| word == "--help" || word == "-h")
        {
            return print_help();
        }
        let interpreter = interpreter.ok_or_else(|| {
            Problem::usage("E250", "the Python package of polepair is not installed.")
                .why("`polepair fleet` is a part of it.")
                .hint("pip install \"polepair[fleet]\"")
        })?;
        let mut program = Command::new(interpreter);
        let status = program.args(["-m", "polepair.fleet"]).args(self.words).status();
        let status = status.map_err(|error| {
            let what = format!("{interpreter} cannot be started.");
            Problem::new(Exit::Adapter, "E303", what).why(format!("The system says: {error}."))
        })?;
        // The error has been printed.
        match status.code() {
            Some(0) => Ok(Exit::Ok),
            code => Err(Problem::new(exit_of(code), "E299", "")),
        }
    }
}

fn print_help() -> Result {
    let mut out = DataOutput::stdout();
    if let Some(fleet) = crate::command().find_subcommand_mut("fleet") {
        out.buffer().extend(fleet.render_help().to_string().bytes());
    }
    out.flush()?;
    Ok(Exit::Ok)
}

const fn exit_of(code: Option<i32>) -> Exit {
    match code {
        Some(1) => Exit::Negative,
        Some(2) => Exit::Usage,
        _ => Exit::Interrupted,
    }
}
