//! The names by which a server may be called.

use std::net::IpAddr;

use axum::http::{HeaderMap, HeaderName, header};

use crate::message::GatewayError;
use crate::options::HostName;

/// The names by which a server may be called, as `Host` has them.
#[derive(Debug, Clone)]
pub struct AllowedHosts {
    scheme: &'static str,
    hosts: Vec<String>,
    origins: Vec<String>,
}

impl AllowedHosts {
    /// The loopback's names and the address that it listens on, each with the port, and without it where it
    /// is the scheme's own. Stated names count with their own port; those without one also count without a
    /// port, as a proxy on the usual port passes them on.
    #[must_use]
    pub fn new(
        scheme: &'static str,
        address: IpAddr,
        port: u16,
        names: &[String],
        origins: &[String],
    ) -> Self {
        let mut all = vec!["localhost".to_owned(), "127.0.0.1".into(), "[::1]".into()];
        if !address.is_unspecified() {
            all.push(bracketed(&address.to_string()));
        }
        let usual = port == if scheme == "https" { 443 } else { 80 };
        let hosts = all.into_iter().flat_map(|name| {
            let with_port = format!("{name}:{port}");
            if usual { vec![name, with_port] } else { vec![with_port] }
        });
        let mut hosts: Vec<String> = hosts.collect();
        for name in names.iter().filter_map(|name| HostName::parse(name)) {
            let host = bracketed(&name.host.to_ascii_lowercase());
            hosts.push(format!("{host}:{}", name.port.unwrap_or(port)));
            hosts.extend(name.port.is_none().then_some(host));
        }
        Self { scheme, hosts, origins: origins.to_vec() }
    }

    /// The host that a request is to, if it is ours.
    pub(crate) fn match_host<'a>(
        &self,
        headers: &'a HeaderMap,
        target: Option<&str>,
    ) -> Option<&'a str> {
        let mut all = headers.get_all(header::HOST).iter();
        let host = all.next()?.to_str().ok().filter(|_| all.next().is_none())?;
        let same = target.is_none_or(|target| target.eq_ignore_ascii_case(host));
        let ours = self.hosts.iter().any(|known| known.eq_ignore_ascii_case(host));
        (ours && same).then_some(host)
    }

    /// Returns whether an origin is this server, by the name that the request itself uses.
    pub(crate) fn is_own_origin(&self, origin: &str, host: &str) -> bool {
        let own = origin
            .split_once("://")
            .is_some_and(|(scheme, from)| scheme == self.scheme && from.eq_ignore_ascii_case(host));
        own || self.origins.iter().any(|stated| stated.eq_ignore_ascii_case(origin))
    }

    /// Describes why a request is refused, with the host that it names.
    pub(crate) fn host_error(&self, headers: &HeaderMap) -> GatewayError {
        let called = header_text(headers, header::HOST);
        let called = called.filter(|host| HostName::parse(host).is_some());
        let what = match called {
            Some(host) => format!("this server does not accept the host name {host}"),
            None => "the request has no valid host name".to_owned(),
        };
        let name = called.unwrap_or("HOST:PORT");
        GatewayError::new("gateway.host", what).hint(format!(
            "use the address that it printed; for a proxy or tunnel start it with --name {name}"
        ))
    }
}

fn bracketed(name: &str) -> String {
    if name.contains(':') { format!("[{name}]") } else { name.to_owned() }
}

pub(crate) fn header_text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    fn hosts(port: u16) -> AllowedHosts {
        let names = ["Bench.example".into(), "localhost:8080".into(), "[::1]:8443".into()];
        let origins = ["https://bench.example".into()];
        AllowedHosts::new("http", "127.0.0.1".parse().unwrap(), port, &names, &origins)
    }

    fn called(hosts: &AllowedHosts, host: &str) -> bool {
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, HeaderValue::from_str(host).unwrap());
        hosts.match_host(&headers, None).is_some()
    }

    #[test]
    fn only_names_that_are_its_own_reach_it() {
        let on_1234 = hosts(1234);
        for host in [
            "localhost:1234",
            "127.0.0.1:1234",
            "[::1]:1234",
            "bench.example:1234",
            "bench.example",
            "localhost:8080",
            "[::1]:8443",
        ] {
            assert!(called(&on_1234, host), "{host}");
        }
        for host in [
            "localhost",
            "localhost:80",
            "localhost:8081",
            "bench.example:8080",
            "evil.test:1234",
            "127.0.0.1.evil.test:1234",
            "",
        ] {
            assert!(!called(&on_1234, host), "{host}");
        }
        assert!(called(&hosts(80), "localhost"));
    }

    #[test]
    fn two_hosts_or_another_target_are_none() {
        let mut headers = HeaderMap::new();
        headers.append(header::HOST, HeaderValue::from_static("localhost:1"));
        assert!(hosts(1).match_host(&headers, Some("localhost:1")).is_some());
        assert!(hosts(1).match_host(&headers, Some("evil.test")).is_none());
        headers.append(header::HOST, HeaderValue::from_static("localhost:1"));
        assert!(hosts(1).match_host(&headers, None).is_none());
    }

    #[test]
    fn an_origin_is_the_same_to_the_letter() {
        let hosts = hosts(1234);
        assert!(hosts.is_own_origin("http://localhost:1234", "localhost:1234"));
        assert!(hosts.is_own_origin("https://bench.example", "bench.example"));
        for origin in [
            "https://localhost:1234",
            "http://localhost",
            "null",
            "",
            "http://localhost:12345",
            "http://127.0.0.1:1234",
            "http://localhost:1234.evil.test",
        ] {
            assert!(!hosts.is_own_origin(origin, "localhost:1234"), "{origin}");
        }
    }
}
