//! Options of a server's start.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use crate::error::SetupError;
use crate::message::PORT;
use crate::scope::{Scope, Scopes};

/// Options of a server.
#[derive(Debug, Clone)]
pub struct ServerOptions {
    /// Listening address; port 0 takes a free one.
    pub bind: SocketAddr,
    /// Encrypts, with the certificate in the folder or a new one.
    pub tls: bool,
    /// CA certificates of clients: without a certificate of these, a client cannot even show a token.
    pub client_ca: Option<PathBuf>,
    /// Names by which clients may call it, besides the loopback's and the address that it listens on: a host,
    /// or a host and the port of a proxy or tunnel.
    pub host_names: Vec<String>,
    /// Origins of its page behind a proxy with another scheme: `https://bench.example`.
    pub origins: Vec<String>,
    /// Scopes that limit all tokens.
    pub scopes: Scopes,
    /// Folder of tokens, certificate and journal.
    pub folder: PathBuf,
    /// Ports that clients may have searched for drives, besides those that the system lists.
    pub search_ports: Vec<String>,
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
            origins: Vec::new(),
            scopes: [Scope::Read, Scope::Stop, Scope::Move, Scope::Configure].into_iter().collect(),
            folder,
            search_ports: Vec::new(),
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
        if let Some(name) = self.host_names.iter().find(|name| HostName::parse(name).is_none()) {
            return Err(SetupError::usage("E254", format!("{name:?} is not a host name"))
                .why("Every host name must be listed; there are no wildcards.")
                .hint("--name bench.example, --name localhost:8080, or an IP address"));
        }
        if let Some(origin) = self.origins.iter().find(|origin| !is_origin(origin)) {
            return Err(SetupError::usage("E254", format!("{origin:?} is not an origin"))
                .why("An origin is a scheme and a host, with a port if it is not the usual one.")
                .hint("--origin https://bench.example"));
        }
        Ok(())
    }

    /// Scheme before `://`.
    #[must_use]
    pub const fn scheme(&self) -> &'static str {
        if self.tls { "https" } else { "http" }
    }
}

/// A host by which clients may call the server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct HostName<'a> {
    /// Name or address, without brackets.
    pub host: &'a str,
    /// The port of a proxy or tunnel, if it is stated.
    pub port: Option<u16>,
}

impl<'a> HostName<'a> {
    /// Parses `bench.example`, `localhost:8080`, `fe80::1` and `[::1]:8080`.
    pub(crate) fn parse(text: &'a str) -> Option<Self> {
        let (host, port) = match (text.strip_prefix('['), text.matches(':').count()) {
            (Some(rest), _) => {
                let (host, port) = rest.split_once(']')?;
                (host, if port.is_empty() { None } else { Some(port.strip_prefix(':')?) })
            }
            (None, 1) => text.split_once(':').map(|(host, port)| (host, Some(port)))?,
            _ => (text, None),
        };
        let port = port
            .map(|port| port.parse().ok().filter(|port| *port != 0))
            .map_or(Some(None), |port: Option<u16>| port.map(Some))?;
        let valid = !host.is_empty() && host.len() <= 253 && host.chars().all(is_host_char);
        valid.then_some(Self { host, port })
    }
}

fn is_host_char(c: char) -> bool {
    // Letters, digits, dots, hyphens; colons of IPv6.
    c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | ':')
}

/// Returns whether it can be the origin of a page: a scheme and a host, without a path.
fn is_origin(origin: &str) -> bool {
    let host = origin.strip_prefix("https://").or_else(|| origin.strip_prefix("http://"));
    host.is_some_and(|host| HostName::parse(host).is_some())
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
    fn no_name_covers_all() {
        let mut options = ServerOptions::in_folder(PathBuf::new());
        for name in ["*", "*.example", "", "a b", "a/b", "a:", "a:0", "a:70000", "a:b", "[::1]8080"]
        {
            options.host_names = vec![name.into()];
            assert_eq!(options.check().unwrap_err().code, "E254", "{name}");
        }
        for name in ["bench.example", "localhost:8080", "fe80::1", "[::1]:8080", "[::1]"] {
            options.host_names = vec![name.into()];
            assert_eq!(options.check(), Ok(()), "{name}");
        }
    }

    #[test]
    fn an_origin_is_a_scheme_and_a_host() {
        let mut options = ServerOptions::in_folder(PathBuf::new());
        for origin in ["https://bench.example", "http://localhost:8080", "https://[::1]:8443"] {
            options.origins = vec![origin.into()];
            assert_eq!(options.check(), Ok(()), "{origin}");
        }
        for origin in ["bench.example", "https://", "ftp://bench.example", "https://a/b", "null"] {
            options.origins = vec![origin.into()];
            assert_eq!(options.check().unwrap_err().code, "E254", "{origin}");
        }
    }
}
