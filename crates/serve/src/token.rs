//! Tokens: 256 random bits that grant scopes.
//!
//! They are in a file that only its owner can read, one a line: token in hexadecimal, scopes, name. They
//! are compared in constant time, and never printed.

use std::fmt::{self, Write as _};
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Write as _};
use std::net::SocketAddr;
use std::path::Path;

use subtle::ConstantTimeEq as _;

use crate::error::SetupError;
use crate::message::{PROOF_BYTES, parse_hex, token_proof};
use crate::scope::{Scope, Scopes};

/// Bytes of a token.
const TOKEN_BYTES: usize = PROOF_BYTES;
/// Tokens of a file.
const TOKENS_MAX: usize = 64;
/// Bytes of such a file.
const FILE_MAX: u64 = 64 * 1024;

/// Something that cannot be guessed.
#[derive(Clone)]
pub struct AccessToken([u8; TOKEN_BYTES]);

impl AccessToken {
    /// A new one, from the system's randomness.
    ///
    /// # Errors
    /// When the system has none to give.
    pub fn generate() -> Result<Self, SetupError> {
        let mut bytes = [0; TOKEN_BYTES];
        getrandom::fill(&mut bytes).map_err(|error| {
            SetupError::adapter("E318", "the system has no random numbers").why(error.to_string())
        })?;
        Ok(Self(bytes))
    }

    /// Reads its hexadecimal digits.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        parse_hex(text).map(Self)
    }

    /// Hexadecimal digits of the token. For the file, the URL and the cookie alone.
    #[must_use]
    pub fn reveal(&self) -> String {
        to_hex(&self.0)
    }

    /// Returns whether both are the same; takes as long whatever differs.
    #[must_use]
    pub fn matches(&self, other: &Self) -> bool {
        self.0.ct_eq(&other.0).into()
    }

    /// Proof of knowing the token, for a client at that address.
    #[must_use]
    pub fn proof(&self, challenge: &[u8; TOKEN_BYTES], address: SocketAddr) -> String {
        token_proof(&self.0, challenge, address)
    }

    /// Digest of the token, for places where it must not be kept itself.
    #[must_use]
    pub fn digest(&self) -> [u8; 32] {
        *blake3::hash(&self.0).as_bytes()
    }
}

impl fmt::Debug for AccessToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token")
    }
}

/// Bytes as hexadecimal digits; `parse_hex` reads them.
pub(crate) fn to_hex(bytes: &[u8; TOKEN_BYTES]) -> String {
    bytes.iter().fold(String::with_capacity(2 * TOKEN_BYTES), |mut text, byte| {
        // Writing into a String cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// A token, its client, and its scopes.
#[derive(Debug, Clone)]
pub struct Grant {
    /// The secret.
    pub token: AccessToken,
    /// Scopes that the token grants.
    pub scopes: Scopes,
    /// Name for the journal.
    pub name: String,
}

/// Reads the file's tokens. Where there is no file yet it is made, with two tokens: `operator`, who may
/// do all but raw requests, and `viewer`, who may see and stop.
///
/// # Errors
/// The file cannot be made or read, others may read it, or it holds something else.
pub fn load(path: &Path) -> Result<Vec<Grant>, SetupError> {
    match File::open(path) {
        Ok(file) => read(path, file),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => make(path),
        Err(error) => Err(SetupError::file(path, "read", &error)),
    }
}

fn make(path: &Path) -> Result<Vec<Grant>, SetupError> {
    let operator = Scopes::from_iter([Scope::Read, Scope::Stop, Scope::Move, Scope::Configure]);
    let viewer = Scopes::from_iter([Scope::Read, Scope::Stop]);
    let grants = vec![new_grant("operator", operator)?, new_grant("viewer", viewer)?];
    let mut text = String::from("# TOKEN SCOPES NAME; a token grants its scopes to its holder\n");
    for Grant { token, scopes, name } in &grants {
        let _ = writeln!(text, "{} {scopes} {name}", token.reveal());
    }
    write_private_file(path, text.as_bytes())?;
    Ok(grants)
}

fn new_grant(name: &str, scopes: Scopes) -> Result<Grant, SetupError> {
    Ok::<_, SetupError>(Grant { token: AccessToken::generate()?, scopes, name: name.to_owned() })
}

/// Makes a file that only its owner can read; there must be none yet.
pub(crate) fn write_private_file(path: &Path, bytes: &[u8]) -> Result<(), SetupError> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let written = options.open(path).and_then(|mut file| file.write_all(bytes));
    written.map_err(|error| SetupError::file(path, "write", &error))
}

/// Refuses a file that others may read.
pub(crate) fn require_private(path: &Path, file: &File) -> Result<(), SetupError> {
    let its = polepair_link::is_private_file(file);
    if its.map_err(|error| SetupError::file(path, "read", &error))? {
        return Ok(());
    }
    Err(SetupError::adapter("E305", format!("others may read {}", path.display()))
        .why("Its content allows any reader to move motors.")
        .hint(format!("chmod 600 {}, or remove it to get new ones", path.display())))
}

fn read(path: &Path, file: File) -> Result<Vec<Grant>, SetupError> {
    require_private(path, &file)?;
    let mut text = String::new();
    file.take(FILE_MAX)
        .read_to_string(&mut text)
        .map_err(|error| SetupError::file(path, "read", &error))?;
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let lines = lines.filter(|(_, line)| !line.starts_with('#')).take(TOKENS_MAX);
    let grants: Result<Vec<_>, _> = lines.map(|(n, line)| parse_grant(path, n + 1, line)).collect();
    let grants = grants?;
    if grants.is_empty() {
        return Err(invalid_line(path, 1, "it holds no token"));
    }
    Ok(grants)
}

fn parse_grant(path: &Path, line: usize, text: &str) -> Result<Grant, SetupError> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let [token, scopes, name] = words[..] else {
        return Err(invalid_line(path, line, "a line has a token, scopes and a name"));
    };
    let token =
        AccessToken::parse(token).ok_or_else(|| invalid_line(path, line, "that is not a token"))?;
    let scopes =
        scopes.parse::<Scopes>().map_err(|error| invalid_line(path, line, &error.to_string()))?;
    Ok(Grant { token, scopes, name: name.to_owned() })
}

/// Error of a line, without its content.
fn invalid_line(path: &Path, line: usize, why: &str) -> SetupError {
    SetupError::usage("E230", format!("{}:{line}: {why}", path.display()))
        .hint("remove the file to get a new one")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_comes_back_from_its_digits_and_hides_otherwise() {
        let token = AccessToken::generate().unwrap();
        let text = token.reveal();
        assert_eq!(text.len(), 64);
        assert!(AccessToken::parse(&text).is_some_and(|same| same.matches(&token)));
        assert!(!AccessToken::generate().unwrap().matches(&token), "two are never the same");
        assert_eq!(format!("{token:?}"), "Token");
        assert!(
            AccessToken::parse(&text[1..]).is_none()
                && AccessToken::parse(&"g".repeat(64)).is_none()
        );
    }
}
