//! Errors of the server's start and of the journal, for the user who starts it.

use std::fmt;
use std::path::Path;

use polepair::error::Exit;

use crate::message::GatewayError;

/// A problem with the machine, a file or an option.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SetupError {
    /// The exit code that goes with it.
    pub exit: Exit,
    /// Stable code; the page on exit codes explains it.
    pub code: &'static str,
    /// Description of the error, in a sentence without full stop.
    pub what: String,
    /// Reason in a sentence; empty if there is nothing to add.
    pub why: String,
    /// Remedy to try; may be empty.
    pub hint: String,
}

impl SetupError {
    /// The caller's options or files are wrong.
    pub fn usage(code: &'static str, what: impl Into<String>) -> Self {
        Self::new(Exit::Usage, code, what)
    }

    /// The machine lacks a needed resource.
    pub fn adapter(code: &'static str, what: impl Into<String>) -> Self {
        Self::new(Exit::Adapter, code, what)
    }

    /// A file that cannot be read or written.
    #[must_use]
    pub fn file(path: &Path, verb: &str, error: &std::io::Error) -> Self {
        use std::io::ErrorKind as Kind;
        let code = match error.kind() {
            Kind::NotFound => "E301",
            Kind::PermissionDenied => "E302",
            _ => "E303",
        };
        Self::adapter(code, format!("cannot {verb} {}", path.display()))
            .why(format!("The system says: {error}."))
    }

    fn new(exit: Exit, code: &'static str, what: impl Into<String>) -> Self {
        Self { exit, code, what: what.into(), why: String::new(), hint: String::new() }
    }

    /// Adds the reason.
    #[must_use]
    pub fn why(mut self, why: impl Into<String>) -> Self {
        self.why = why.into();
        self
    }

    /// Adds what to try.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = hint.into();
        self
    }
}

impl From<GatewayError> for SetupError {
    fn from(refused: GatewayError) -> Self {
        let exit = refused.exit();
        let code = match refused.code {
            std::borrow::Cow::Borrowed(code) => code,
            std::borrow::Cow::Owned(_) => "E299",
        };
        Self { hint: refused.hint, ..Self::new(exit, code, refused.message) }
    }
}

impl fmt::Display for SetupError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.what, self.code)
    }
}

impl std::error::Error for SetupError {}
