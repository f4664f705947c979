//! The token: read from a file or the environment, never from the command line, and never printed.
//!
//! Why: CLIENT-2.

use std::fmt;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use polepair_messages::{PROOF_BYTES, parse_hex};

use crate::GatewayError;
use crate::address::Address;

/// Environment variable with a token.
pub(crate) const VARIABLE: &str = "POLEPAIR_TOKEN";
/// The file of tokens in a server's folder.
const TOKENS: &str = "tokens";
/// Bytes of such a file.
const FILE_MAX: u64 = 64 * 1024;

/// A token that is not shown.
#[derive(Clone)]
pub(crate) struct Secret {
    text: String,
    bytes: [u8; PROOF_BYTES],
    /// True if it is the token of this account's own server, and the user did not name it for this one.
    is_own: bool,
}

impl Secret {
    /// The value of the `Authorization` header.
    pub fn bearer(&self) -> String {
        format!("Bearer {}", self.text)
    }

    /// The token that a server must prove to have first; `None` if the user named it.
    pub fn token_to_prove(&self) -> Option<&[u8; PROOF_BYTES]> {
        self.is_own.then_some(&self.bytes)
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret")
    }
}

/// The folder of tokens, certificate and journal of this account's server: `$XDG_STATE_HOME/polepair`,
/// `~/.local/state/polepair`, `%LOCALAPPDATA%\polepair`. `None` where neither is known.
#[must_use]
pub fn state_folder() -> Option<PathBuf> {
    let base = env_path("XDG_STATE_HOME").or_else(|| env_path("LOCALAPPDATA"));
    let base = base.or_else(|| Some(env_path("HOME")?.join(".local").join("state")));
    base.map(|base| base.join("polepair"))
}

fn env_path(name: &str) -> Option<PathBuf> {
    std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from)
}

/// Token of that file; otherwise that of the environment; otherwise, for a server on this machine's loopback, the first
/// of this account's own server. That token moves the motors here: it is sent to no other host, and here only to a
/// server that proves to have it. A tunnel begins here as well, and while our server is down, any program may listen on
/// its port.
///
/// # Errors
/// `E301` to `E305` for a file, `E256` where there is no token in it, or none at all.
pub(crate) fn find_token(file: Option<&Path>, address: &Address) -> Result<Secret, GatewayError> {
    if let Some(file) = file {
        return read(file);
    }
    if let Some(text) = std::env::var(VARIABLE).ok().filter(|text| !text.is_empty()) {
        return parse_token(text.trim())
            .ok_or_else(|| GatewayError::new("E256", format!("{VARIABLE} holds no token")));
    }
    if !address.is_loopback() {
        let what = format!("the token is missing for {}", address.authority());
        return Err(GatewayError::new("E256", what).hint(format!(
            "--token-file or {VARIABLE} with a token of that server: your own server's token is \
             not sent to another host"
        )));
    }
    let folder = state_folder();
    let own = folder.map(|folder| folder.join(TOKENS)).filter(|file| file.exists());
    let own = own.map_or_else(|| Err(no_token_error()), |file| read(&file))?;
    Ok(Secret { is_own: true, ..own })
}

fn no_token_error() -> GatewayError {
    GatewayError::new("E256", "the token is missing for the server").hint(format!(
        "--token-file with the file `tokens` of the server's folder, or {VARIABLE} with a token \
         of it"
    ))
}

/// The first token of a file such as the server's: a token begins a line.
fn read(path: &Path) -> Result<Secret, GatewayError> {
    let mut text = String::new();
    open_private(path)?
        .take(FILE_MAX)
        .read_to_string(&mut text)
        .map_err(|error| unreadable(path, &error))?;
    let first = text.lines().find(|line| !line.trim().is_empty() && !line.starts_with('#'));
    let word = first.and_then(|line| line.split_whitespace().next());
    word.and_then(parse_token)
        .ok_or_else(|| GatewayError::new("E256", format!("{} holds no token", path.display())))
}

fn parse_token(text: &str) -> Option<Secret> {
    let bytes = parse_hex(text)?;
    Some(Secret { text: text.to_owned(), bytes, is_own: false })
}

pub(crate) fn unreadable(path: &Path, error: &std::io::Error) -> GatewayError {
    use std::io::ErrorKind as Kind;
    let code = match error.kind() {
        Kind::NotFound => "E301",
        Kind::PermissionDenied => "E302",
        _ => "E303",
    };
    GatewayError::new(code, format!("cannot read {}: {error}", path.display()))
}

/// Opens a file of secrets; refuses one that others may read.
pub(crate) fn open_private(path: &Path) -> Result<File, GatewayError> {
    let file = File::open(path).map_err(|error| unreadable(path, &error))?;
    if polepair_link::is_private_file(&file).map_err(|error| unreadable(path, &error))? {
        return Ok(file);
    }
    let what = format!("others may read {}", path.display());
    Err(GatewayError::new("E305", what).hint(format!("chmod 600 {}", path.display())))
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[test]
    fn the_first_token_of_a_private_file_is_taken() {
        let path = std::env::temp_dir().join(format!("polepair-secret-{}", std::process::id()));
        let write = |text: &str, mode| {
            std::fs::write(&path, text).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
        };
        let (one, two) = ("1".repeat(64), "2".repeat(64));
        write(&format!("# TOKEN SCOPES NAME\n\n{one} read,stop ann\n{two} read bob\n"), 0o600);
        let address = Address::parse("https://bench.example").unwrap();
        let find = || find_token(Some(&path), &address);
        let found = find().unwrap();
        assert_eq!(found.bearer(), format!("Bearer {one}"));
        assert_eq!(format!("{found:?}"), "Secret");
        for mode in [0o640, 0o604, 0o620] {
            write(&one, mode);
            assert_eq!(find().unwrap_err().code, "E305", "{mode:o}");
        }
        write("# none\n12345\n", 0o600);
        let wrong = find().unwrap_err();
        assert!(wrong.code == "E256" && !wrong.message.contains("12345"), "{wrong}");
        std::fs::remove_file(&path).unwrap();
        assert_eq!(find().unwrap_err().code, "E301");
    }
}
