//! A pseudo-terminal that gives access to a simulated drive like a serial port.

use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use polepair_core::medium::{SerialLine, Stream};
use polepair_core::station::LineEvent;
use polepair_core::time::Instant;
use rustix::fs::OFlags;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use crate::clock;
use crate::descriptor::Descriptor;
use crate::error::{Cause, LinkError};
use crate::link::{LinkIo, Received};
use crate::waker::LinkWaker;

/// The far end of a pseudo-terminal. Others open [`path`](Self::path).
#[derive(Debug)]
pub struct Pty {
    descriptor: Descriptor,
    client: Mutex<ClientRate>,
    /// Kept open: without any near end the far end reads errors while no client is there.
    _near_end: OwnedFd,
    name: String,
    alias: Option<PathBuf>,
}

/// Baud rate that the client has set.
#[derive(Debug)]
struct ClientRate {
    reported: u32,
    /// Bytes that came at a rate that was not reported yet.
    held: Vec<u8>,
}

/// Baud rate of a new pair, which no client sets: it shows that none was set.
const UNSET_RATE: u32 = 134;

impl Pty {
    /// Makes a pair in raw mode. With `alias`, a symbolic link of that name points to the near
    /// end until this object is dropped; one left behind by a killed process is replaced.
    ///
    /// # Errors
    /// [`LinkError`]; [`Cause::Busy`] when `alias` exists and is no symbolic link.
    pub fn open(alias: Option<&Path>) -> Result<Self, LinkError> {
        let (far, near, name) =
            open_pair().map_err(|errno| LinkError::from_io("pty", &errno.into()))?;
        let descriptor = Descriptor::new(far, &name)?;
        let alias = alias.map(|alias| create_alias(&name, alias)).transpose()?;
        let client = Mutex::new(ClientRate { reported: 0, held: Vec::new() });
        Ok(Self { descriptor, client, _near_end: near, name, alias })
    }

    /// Another descriptor of the far end.
    pub(crate) fn clone_far_end(&self) -> std::io::Result<OwnedFd> {
        self.descriptor.fd.try_clone()
    }

    /// Baud rate that the client has set; 0 if it never did.
    fn client_rate(&self) -> u32 {
        // The settings are those of the pair, whichever end is asked.
        let rate = tcgetattr(&self.descriptor.fd).map_or(0, |termios| termios.output_speed());
        if rate == UNSET_RATE { 0 } else { rate }
    }

    /// Path that a client opens: the alias if there is one.
    #[must_use]
    pub fn path(&self) -> &str {
        self.alias.as_deref().and_then(Path::to_str).unwrap_or(&self.name)
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        if let Some(alias) = &self.alias {
            let ours = std::fs::read_link(alias).is_ok_and(|to| to == Path::new(&self.name));
            if ours {
                let _ = std::fs::remove_file(alias);
            }
        }
    }
}

impl LinkIo<Stream> for Pty {
    fn now(&self) -> Instant {
        clock::now()
    }

    fn send(&self, unit: &[u8]) -> Result<(), LinkError> {
        self.descriptor.send(unit)
    }

    fn receive(&self, buffer: &mut [u8], until: Instant) -> Result<Received, LinkError> {
        let mut client = self.client.lock().unwrap_or_else(PoisonError::into_inner);
        if !client.held.is_empty() {
            let len = client.held.len().min(buffer.len());
            buffer[..len].copy_from_slice(&client.held[..len]);
            client.held.drain(..len);
            return Ok(Received::Bytes { len, at: clock::now() });
        }
        let received = self.descriptor.receive(buffer, until)?;
        let Received::Bytes { len, at } = received else { return Ok(received) };
        let rate = self.client_rate();
        if rate == client.reported {
            return Ok(received);
        }
        // First the rate, then the bytes that were sent at it.
        client.reported = rate;
        client.held.extend_from_slice(&buffer[..len]);
        Ok(Received::Line { event: LineEvent::Rate(rate), at })
    }

    fn set_line(&self, _line: SerialLine) -> Result<(), LinkError> {
        Ok(())
    }

    fn waker(&self) -> LinkWaker {
        self.descriptor.waker.clone()
    }

    fn describe(&self) -> String {
        self.path().to_owned()
    }
}

fn open_pair() -> Result<(OwnedFd, OwnedFd, String), rustix::io::Errno> {
    let far = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
    rustix::io::fcntl_setfd(&far, rustix::io::FdFlags::CLOEXEC)?;
    grantpt(&far)?;
    unlockpt(&far)?;
    let name = ptsname(&far, Vec::new())?;
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
    let near = rustix::fs::open(&name, flags, rustix::fs::Mode::empty())?;
    let mut termios = tcgetattr(&near)?;
    termios.make_raw();
    termios.set_speed(UNSET_RATE)?;
    tcsetattr(&near, OptionalActions::Now, &termios)?;
    rustix::io::ioctl_fionbio(&far, true)?;
    Ok((far, near, name.to_string_lossy().into_owned()))
}

fn create_alias(name: &str, alias: &Path) -> Result<PathBuf, LinkError> {
    let shown = alias.to_string_lossy();
    if let Ok(target) = std::fs::read_link(alias)
        && let Some(busy) = crate::ports::serving_instance(&target, alias)
    {
        return Err(LinkError::new(&shown, Cause::Busy).with_hint(&busy));
    }
    match std::fs::symlink_metadata(alias) {
        Ok(found) if found.is_symlink() => {
            std::fs::remove_file(alias).map_err(|e| pty_error(&e, &shown))?
        }
        Ok(_) => {
            let hint = "A file of this name exists; choose another path.";
            return Err(LinkError::new(&shown, Cause::Busy).with_hint(hint));
        }
        Err(_) => {}
    }
    std::os::unix::fs::symlink(name, alias).map_err(|e| pty_error(&e, &shown))?;
    Ok(alias.to_owned())
}

fn pty_error(error: &std::io::Error, shown: &str) -> LinkError {
    LinkError::from_io(shown, error)
}
