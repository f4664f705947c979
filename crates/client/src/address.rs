//! The address of a server.

use std::net::{IpAddr, Ipv6Addr};

use polepair_messages::PORT;

use crate::GatewayError;

/// A server's address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Address {
    pub tls: bool,
    pub host: String,
    pub port: u16,
}

impl Address {
    /// Parses `http://127.0.0.1:7365`; `https`, `ws` and `wss` are the same with and without encryption.
    /// The one-time address that the server prints is accepted too.
    ///
    /// # Errors
    /// `E256` for an invalid address, `E252` where a token would cross a network in clear text.
    pub fn parse(url: &str) -> Result<Self, GatewayError> {
        let (scheme, rest) =
            url.split_once("://").ok_or_else(|| url_problem("it has no `://`", url))?;
        let tls = match scheme {
            "http" | "ws" => false,
            "https" | "wss" => true,
            _ => return Err(url_problem("it begins with http, https, ws or wss", url)),
        };
        let location = rest.split_once(['/', '?', '#']).map_or(rest, |(location, _)| location);
        // Addresses appear in logs and in lists of processes.
        if location.contains('@') {
            return Err(url_problem("a secret does not belong there", url));
        }
        let (host, port) =
            split(location).ok_or_else(|| url_problem("that is no HOST:PORT", url))?;
        let address = Self { tls, host, port };
        // The token would cross the network in clear text.
        if !tls && !address.is_loopback() {
            let what =
                format!("{} is another machine, and nothing would be encrypted", address.host);
            return Err(GatewayError::new("E252", what).hint(
                "https:// for a server with --tls, or an SSH tunnel to its 127.0.0.1, with \
                        --token-file",
            ));
        }
        Ok(address)
    }

    /// The authority as a `Host` header has it.
    pub fn authority(&self) -> String {
        let Self { host, port, .. } = self;
        if host.contains(':') { format!("[{host}]:{port}") } else { format!("{host}:{port}") }
    }

    /// Returns whether the server is on this machine, by loopback or through a tunnel that starts here.
    pub fn is_loopback(&self) -> bool {
        let ip = self.host.parse::<IpAddr>();
        ip.map_or(self.host == "localhost", |ip| ip.is_loopback())
    }
}

fn url_problem(why: &str, url: &str) -> GatewayError {
    GatewayError::new("E256", format!("{url:?} is not the URL of a server: {why}"))
        .hint("http://127.0.0.1:7365, or https://HOST:PORT for another machine")
}

/// Host and port of `HOST`, `HOST:PORT`, `[IPV6]:PORT`.
fn split(location: &str) -> Option<(String, u16)> {
    if let Some(rest) = location.strip_prefix('[') {
        let (host, port) = rest.split_once(']')?;
        let host = host.parse::<Ipv6Addr>().ok()?.to_string();
        let port = if port.is_empty() { PORT } else { port.strip_prefix(':')?.parse().ok()? };
        return Some((host, port));
    }
    let (host, port) = match location.split_once(':') {
        Some((host, port)) => (host, port.parse().ok()?),
        None => (location, PORT),
    };
    (!host.is_empty() && host.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '-')))
        .then(|| (host.to_ascii_lowercase(), port))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_and_written() {
        for (url, authority, tls) in [
            ("http://127.0.0.1:7365", "127.0.0.1:7365", false),
            ("ws://localhost", "localhost:7365", false),
            ("https://bench.example:1/", "bench.example:1", true),
            ("wss://[fe80::1]:8", "[fe80::1]:8", true),
            ("http://[::1]/?once=abc", "[::1]:7365", false),
        ] {
            let address = Address::parse(url).unwrap();
            assert_eq!((&*address.authority(), address.tls), (authority, tls), "{url}");
        }
    }

    #[test]
    fn a_text_that_is_no_address_is_refused() {
        let wrong = ["127.0.0.1:7365", "ftp://a", "http://", "http://a b", "http://a:b@localhost"];
        for url in wrong.into_iter().chain(["http://localhost:99999", "http://[::1"]) {
            assert_eq!(Address::parse(url).unwrap_err().code, "E256", "{url}");
        }
    }

    #[test]
    fn a_token_never_passes_a_network_unencrypted() {
        for url in ["http://192.168.0.5", "ws://bench.example", "http://127.0.0.1.example"] {
            assert_eq!(Address::parse(url).unwrap_err().code, "E252", "{url}");
        }
    }
}
