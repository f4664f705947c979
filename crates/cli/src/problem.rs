//! Errors of the command line: what happened, why, what to try, and a constant code whose first digit is
//! the exit code.

use std::borrow::Cow;
use std::fmt::Write as _;

use crate::terminal::escape_lines;

pub use polepair::error::Exit;

/// An error as the user sees it.
#[derive(Debug)]
pub struct Problem {
    /// Exit code, for scripts.
    pub exit: Exit,
    /// Stable: `E401`.
    pub code: Cow<'static, str>,
    /// One sentence.
    pub what: String,
    /// One sentence; empty if there is nothing to add.
    pub why: String,
    /// Things to try.
    pub hints: Vec<String>,
    /// A motor may turn that cannot be stopped from here.
    pub may_turn: bool,
}

/// Result of every verb.
pub type Result<T = Exit> = std::result::Result<T, Problem>;

impl Problem {
    /// A problem without reason and advice yet.
    pub fn new(exit: Exit, code: impl Into<Cow<'static, str>>, what: impl Into<String>) -> Self {
        Self {
            exit,
            code: code.into(),
            what: what.into(),
            why: String::new(),
            hints: Vec::new(),
            may_turn: false,
        }
    }

    /// Something about the command line.
    pub fn usage(code: &'static str, what: impl Into<String>) -> Self {
        Self::new(Exit::Usage, code, what)
    }

    /// Ctrl-C.
    pub fn interrupted() -> Self {
        Self::new(Exit::Interrupted, "E130", "")
    }

    /// Adds the label of an axis, if several were commanded.
    #[must_use]
    pub fn about(mut self, label: &str) -> Self {
        self.what = format!("{label}: {}", self.what);
        self
    }

    /// Adds the reason.
    #[must_use]
    pub fn why(mut self, why: impl Into<String>) -> Self {
        self.why = why.into();
        self
    }

    /// Adds something to try.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hints.push(hint.into());
        self
    }

    /// Adds something to try, if there is something.
    #[must_use]
    pub fn hint_if(self, hint: Option<impl Into<String>>) -> Self {
        match hint {
            Some(hint) => self.hint(hint),
            None => self,
        }
    }

    /// Text for the terminal.
    pub fn render(&self, colour: bool) -> String {
        let (red, blue, off) =
            if colour { ("\x1b[1;31m", "\x1b[34m", "\x1b[0m") } else { ("", "", "") };
        let mut text = format!("{red}error[{}]{off}: {}\n", self.code, escape_lines(&self.what));
        // Writing into a String cannot fail.
        if !self.why.is_empty() {
            let _ = writeln!(text, "  {}", escape_lines(&self.why).replace('\n', "\n  "));
        }
        if self.may_turn {
            let _ = writeln!(text, "  {red}The motor may still turn: cut its supply.{off}");
        }
        for hint in &self.hints {
            let _ = writeln!(text, "  {blue}try:{off} {}", escape_lines(hint));
        }
        text
    }
}

/// A file that cannot be read or written.
pub fn file_problem(path: &std::path::Path, verb: &str, error: &std::io::Error) -> Problem {
    use std::io::ErrorKind as Kind;
    let what = format!("cannot {verb} {}.", path.display());
    let (code, why) = match error.kind() {
        Kind::NotFound => ("E301", "There is no such file.".to_owned()),
        Kind::PermissionDenied => ("E302", "This account has no permission.".to_owned()),
        _ => ("E303", format!("The system says: {error}.")),
    };
    Problem::new(Exit::Adapter, code, what).why(why)
}

/// Problem of a feature that this program was built without.
#[cfg(not(all(feature = "tables", feature = "tls")))]
pub fn left_out_problem(feature: &str, what: &str) -> Problem {
    Problem::usage("E263", format!("this program was built without {what}."))
        .why("`make demo` and builds with fewer features leave out what takes long to build.")
        .hint(format!(
            "a released program has it, and `cargo build -p polepair-cli --features {feature}`"
        ))
}

/// A word that names no protocol.
pub fn no_such_protocol(word: &str) -> Problem {
    let known: Vec<&str> = polepair_core::proto::dissectors().iter().map(|d| d.name()).collect();
    let nearest = polepair_capture::nearest_word(word, known.iter().copied());
    Problem::usage("E203", format!("{word:?} is not a protocol that polepair knows."))
        .why(format!("It knows {}.", join_list(&known)))
        .hint_if(nearest.map(|name| format!("{name} (the nearest)")))
}

/// `a, b and c`.
pub fn join_list(words: &[&str]) -> String {
    match words {
        [] => "none".to_owned(),
        [only] => (*only).to_owned(),
        [most @ .., last] => format!("{} and {last}", most.join(", ")),
    }
}
