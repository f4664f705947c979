//! A serial wire that this program serves to others on this machine.

use std::path::Path;

use polepair_core::medium::Stream;
use polepair_link::{LinkError, LinkIo};

/// The end of the drives, and the place of the other end, as connection strings name it.
pub type ServedWire = (Box<dyn LinkIo<Stream>>, String);

/// A pseudo-terminal, with a link to it at `path`.
#[cfg(unix)]
pub fn open(path: Option<&Path>) -> Result<ServedWire, LinkError> {
    let pty = polepair_link::pty::Pty::open(path)?;
    let place = format!("serial://{}", pty_path(&pty));
    Ok((Box::new(pty), place))
}

/// A free TCP port of this machine, because Windows has no pseudo-terminals.
#[cfg(windows)]
pub fn open(path: Option<&Path>) -> Result<ServedWire, LinkError> {
    if let Some(path) = path {
        return Err(no_pty(path));
    }
    let server = polepair_link::tcp::TcpServer::bind("127.0.0.1:0")?;
    let place = format!("tcp://{}", server.address());
    Ok((Box::new(server), place))
}

/// The absolute path of a pseudo-terminal.
#[cfg(unix)]
pub fn pty_path(pty: &polepair_link::pty::Pty) -> String {
    let path = std::path::absolute(pty.path()).unwrap_or_else(|_| pty.path().into());
    path.display().to_string()
}

/// The error for `--pty`.
#[cfg(windows)]
pub fn no_pty(path: &Path) -> LinkError {
    LinkError::new(&path.display().to_string(), polepair_link::Cause::Unsuitable)
        .with_hint("Windows has no pseudo-terminals: use --tcp 127.0.0.1:4001.")
}
