//! The file of logged-in browsers, so a restarted server still accepts them.
//!
//! One line each: digest of the cookie, digest of its token, end in milliseconds since 1970. Neither cookie
//! nor token can be derived from it.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::error::SetupError;
use crate::message::parse_hex;
use crate::token::{require_private, to_hex};

/// Bytes of the file: more than as many lines as there are cookies.
const FILE_MAX: u64 = 64 * 1024;

/// A login of a browser.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SessionRecord {
    /// Digest of its cookie.
    pub cookie_digest: [u8; 32],
    /// Digest of the token of its login.
    pub token_digest: [u8; 32],
    /// End of its validity, ms since 1970.
    pub until_ms: u64,
}

/// The file with the logins.
#[derive(Debug)]
pub(super) struct SessionFile {
    path: PathBuf,
    writing: Mutex<()>,
}

impl SessionFile {
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), writing: Mutex::new(()) }
    }

    /// Reads the file, at most `max` lines. None without a file.
    ///
    /// # Errors
    /// It cannot be read, others may read or write it, or a line is something else: then nothing of it
    /// is believed.
    pub fn read(&self, max: usize) -> Result<Vec<SessionRecord>, SetupError> {
        let failed = |error: io::Error| SetupError::file(&self.path, "read", &error);
        let file = match File::open(&self.path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(error) => return Err(failed(error)),
        };
        require_private(&self.path, &file)?;
        let mut text = String::new();
        file.take(FILE_MAX).read_to_string(&mut text).map_err(failed)?;
        let lines = text.lines().filter(|line| !line.starts_with('#')).take(max);
        let lines: Option<Vec<_>> = lines.map(SessionRecord::parse).collect();
        lines.ok_or_else(|| {
            let what = format!("{} has an invalid session", self.path.display());
            SetupError::usage("E230", what).hint("remove the file")
        })
    }

    /// Writes the sessions of that moment. A later caller writes later, so the file has the newest.
    ///
    /// # Errors
    /// It cannot be written; the earlier file stays.
    pub fn write(&self, lines: impl FnOnce() -> Vec<SessionRecord>) -> Result<(), SetupError> {
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let text: String = lines().iter().map(SessionRecord::file_line).collect();
        let text = format!("# COOKIE TOKEN UNTIL: who is logged in, by digests\n{text}");
        polepair_files::write_private(&self.path, text.as_bytes())
            .map_err(|error| SetupError::file(&self.path, "write", &error))
    }
}

impl SessionRecord {
    fn parse(text: &str) -> Option<Self> {
        let mut words = text.split(' ');
        let (cookie, token) = (parse_hex(words.next()?)?, parse_hex(words.next()?)?);
        let until_ms = words.next()?.parse().ok()?;
        words.next().is_none().then_some(Self {
            cookie_digest: cookie,
            token_digest: token,
            until_ms,
        })
    }

    fn file_line(&self) -> String {
        format!(
            "{} {} {}\n",
            to_hex(&self.cookie_digest),
            to_hex(&self.token_digest),
            self.until_ms
        )
    }
}
