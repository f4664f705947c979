//! `polepair completions SHELL`

use clap::{Args, CommandFactory as _};
use clap_complete::Shell;

use crate::problem::{Exit, Result};
use crate::terminal::DataOutput;

/// Prints a script that makes a shell complete polepair's verbs and options.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair completions bash > ~/.local/share/bash-completion/completions/polepair
  polepair completions zsh > ~/.zfunc/_polepair
  polepair completions fish > ~/.config/fish/completions/polepair.fish")]
pub struct Completions {
    /// The shell
    shell: Shell,
}

impl Completions {
    pub fn run(self) -> Result {
        let mut out = DataOutput::stdout();
        let mut command = super::CommandLine::command();
        clap_complete::generate(self.shell, &mut command, "polepair", out.buffer());
        out.flush()?;
        Ok(Exit::Ok)
    }
}
