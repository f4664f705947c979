//! Options of a server's start.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use crate::error::SetupError;
use crate::message::PORT;
use crate::scope::{Scope, Scopes};

/// What a server is told at its start.
#[derive(Debug, Clone)]
pub struct ServerOptions {
    /// Where it listens; port 0 takes a free one.
    pub bind: SocketAddr,
    /// Encrypts, with the certificate in the folder or a new one.
    pub tls: bool,
    /// Certificates of those who vouch for clients: nobody else gets as far as showing a token.
    pub client_ca: Option<PathBuf>,
    /// Names by which browsers may call it, besides the loopback's and the address that it listens on.
    pub host_names: Vec<String>,
    /// What anybody may do at most, whatever the token says.
    pub scopes: Scopes,
    /// Where tokens, certificate and journal are.
    pub folder: PathBuf,
}

impl ServerOptions {
    /// Loopback, no encryption, everything but raw requests.
    #[must_use]
    pub fn in_folder(folder: PathBuf) -> Self {
        Self {
            bind: SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), PORT),
            tls: false,
            client_ca: None,
            host_names: Vec::new(),
            scopes: [Scope::Read, Scope::Stop, Scope::Move, Scope::Configure].into_iter().collect(),
            folder,
        }
    }

    /// Refuses what would let others listen in, or could never be reached.
    ///
    /// # Errors
    /// `E252` for an address that others can reach, or clients' certificates, without encryption;
    /// `E254` for a name.
    pub fn check(&self) -> Result<(), SetupError> {
        if !self.bind.ip().is_loopback() && !self.tls {
            let what = format!("others can reach {}, and nothing would be encrypted", self.bind);
            return Err(SetupError::usage("E252", what)
                .why("A token that is intercepted can be used to move the motors.")
                .hint("add --tls, or listen on 127.0.0.1 and use an SSH tunnel"));
        }
        if self.client_ca.is_some() && !self.tls {
            return Err(
                SetupError::usage("E252", "client certificates need encryption").hint("add --tls")
            );
        }
        match self.host_names.iter().find(|name| !is_name(name)) {
            None => Ok(()),
            Some(name) => Err(SetupError::usage("E254", format!("{name:?} is not a host name"))
                .why("Every host name must be listed; there are no wildcards.")
                .hint("--name bench.example, or an IP address")),
        }
    }

    /// What goes before `://`.
    #[must_use]
    pub const fn scheme(&self) -> &'static str {
        if self.tls { "https" } else { "http" }
    }
}

/// Whether it can be a host's name or address: letters, digits, dots, hyphens; colons of IPv6.
fn is_name(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | ':');
    !name.is_empty() && name.len() <= 253 && name.chars().all(plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_loopback_goes_without_encryption() {
        let loopback = ServerOptions::in_folder(PathBuf::new());
        assert_eq!(loopback.check(), Ok(()));
        for address in ["0.0.0.0:1", "[::]:1", "192.168.0.5:80", "[fe80::1]:80"] {
            let mut options = loopback.clone();
            options.bind = address.parse().unwrap();
            assert_eq!(options.check().unwrap_err().code, "E252", "{address}");
            options.tls = true;
            assert_eq!(options.check(), Ok(()), "{address}");
        }
    }

    #[test]
    fn certificates_of_clients_need_encryption() {
        let mut options = ServerOptions::in_folder(PathBuf::new());
        options.client_ca = Some("ca.pem".into());
        assert_eq!(options.check().unwrap_err().code, "E252");
        options.tls = true;
        assert_eq!(options.check(), Ok(()));
    }

    #[test]
    fn no_name_stands_for_all() {
        let mut options = ServerOptions::in_folder(PathBuf::new());
        for name in ["*", "*.example", "", "a b", "a/b"] {
            options.host_names = vec![name.into()];
            assert_eq!(options.check().unwrap_err().code, "E254", "{name}");
        }
    }
}
