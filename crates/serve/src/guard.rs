//! The guard: one layer before every route, which denies everything that the route table does not permit.
//!
//! Order of the checks: security headers for every response; `Host` must be a name of the server; no
//! request of another site's page (`Origin`, and for changes a content type and a header that forms cannot
//! send); token; scope. Addresses are not trusted, and proxy headers are ignored.

use std::net::IpAddr;
use std::time::Duration;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};

use crate::api::{AccessRule, ApiRoute, SharedAppState};
use crate::auth::Caller;
use crate::connections::PeerConnection;
use crate::message::GatewayError;
use crate::options::HostName;
use crate::page;
use crate::scope::Scope;

/// Time limit of a reply, including the upload of a capture.
const ANSWER_MAX: Duration = Duration::from_secs(60);
/// A header that no form and no foreign page can send without a preflight request.
const CSRF_HEADER: &str = "x-polepair";
/// Content type of bodies.
const JSON: &str = "application/json";
/// Content type of files.
const OCTET_STREAM: &str = "application/octet-stream";
/// Headers of every answer.
const HEADERS: [(HeaderName, &str); 7] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'self'; img-src 'self' data: blob:; object-src 'none'; base-uri 'none'; \
         form-action 'none'; frame-ancestors 'none'",
    ),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (
        HeaderName::from_static("permissions-policy"),
        "camera=(), microphone=(), geolocation=(), usb=(), serial=()",
    ),
];

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
    fn match_host<'a>(&self, headers: &'a HeaderMap, target: Option<&str>) -> Option<&'a str> {
        let mut all = headers.get_all(header::HOST).iter();
        let host = all.next()?.to_str().ok().filter(|_| all.next().is_none())?;
        let same = target.is_none_or(|target| target.eq_ignore_ascii_case(host));
        let ours = self.hosts.iter().any(|known| known.eq_ignore_ascii_case(host));
        (ours && same).then_some(host)
    }

    /// Returns whether an origin is this server, by the name that the request itself uses.
    fn is_own_origin(&self, origin: &str, host: &str) -> bool {
        let own = origin
            .split_once("://")
            .is_some_and(|(scheme, from)| scheme == self.scheme && from.eq_ignore_ascii_case(host));
        own || self.origins.iter().any(|stated| stated.eq_ignore_ascii_case(origin))
    }

    /// Describes why a request is refused, with the host that it names.
    fn host_error(&self, headers: &HeaderMap) -> GatewayError {
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

/// The layer.
pub(crate) async fn guard(
    State(state): State<SharedAppState>,
    mut request: Request,
    next: Next,
) -> Response {
    let wants_page = request.method() == Method::GET
        && header_text(request.headers(), header::ACCEPT)
            .is_some_and(|kind| kind.contains("text/html"));
    let upgrade = is_upgrade(request.headers());
    let passed = match authorize(&state, &request) {
        Ok(Some(caller)) => {
            if let Some(connection) = request.extensions().get::<PeerConnection>() {
                connection.mark_authenticated();
            }
            request.extensions_mut().insert(caller);
            Ok(())
        }
        Ok(None) => Ok(()),
        Err(refused) => Err(refused),
    };
    let mut answer = match passed {
        Ok(()) if upgrade => next.run(request).await,
        Ok(()) => match tokio::time::timeout(ANSWER_MAX, next.run(request)).await {
            Ok(answer) => answer,
            Err(_) => StatusCode::REQUEST_TIMEOUT.into_response(),
        },
        Err(refused) => {
            state.metrics.count_refusal(&refused.code);
            match refused.status() {
                401 if wants_page => page::token_required_page(StatusCode::UNAUTHORIZED),
                _ => refused.into_response(),
            }
        }
    };
    state.metrics.count_response(answer.status().as_u16());
    let headers = answer.headers_mut();
    for (name, value) in HEADERS {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    answer
}

/// Authorizes a request; `None` for public routes.
fn authorize(state: &SharedAppState, request: &Request) -> Result<Option<Caller>, GatewayError> {
    let headers = request.headers();
    let target = request.uri().authority().map(|authority| authority.as_str());
    let host = state.hosts.match_host(headers, target);
    let host = host.ok_or_else(|| state.hosts.host_error(headers))?;
    let reads = matches!(*request.method(), Method::GET | Method::HEAD);
    let upgrade = is_upgrade(headers);
    check_origin(state, headers, host, reads && !upgrade)?;
    let path = request.extensions().get::<MatchedPath>().map(MatchedPath::as_str);
    let route = path.map(|path| ApiRoute::find(request.method(), path));
    if !reads {
        check_csrf(headers, route.flatten())?;
    }
    let once = request.uri().path() == "/" && request.uri().query().is_some_and(is_one_time_query);
    if once && reads || route.flatten().is_some_and(|route| route.access == AccessRule::Public) {
        return Ok(None);
    }
    let caller = authenticate(state, request)?;
    if upgrade && caller.by_cookie && !headers.contains_key(header::ORIGIN) {
        return Err(origin_error("a browser's cookie comes with the page's origin"));
    }
    let needs = match (path, route.flatten()) {
        (_, Some(route)) => route.access,
        // Paths outside the table belong to the page, which needs the scope to see.
        (None, None) if reads => AccessRule::AnyOf(&[Scope::Read]),
        (None, None) => {
            return Err(GatewayError::new("gateway.missing", "not found"));
        }
        (Some(_), None) => return Err(GatewayError::new("gateway.method", "not by this method")),
    };
    if needs.is_met_by(caller.scopes) {
        return Ok(Some(caller));
    }
    Err(GatewayError::new("gateway.scope", format!("this needs the scope {needs}"))
        .hint(format!("this token grants {}", caller.scopes)))
}

fn authenticate(state: &SharedAppState, request: &Request) -> Result<Caller, GatewayError> {
    let headers = request.headers();
    let peer = peer(request);
    let authorization =
        headers.get(header::AUTHORIZATION).map(|value| value.to_str().unwrap_or(""));
    let cookies: Vec<&str> =
        headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok()).collect();
    state.authenticator.authenticate(authorization, &cookies, peer)
}

/// Address of the client, by its socket.
pub(crate) fn peer(request: &Request) -> IpAddr {
    let connection = request.extensions().get::<PeerConnection>();
    connection.map_or(IpAddr::V4(std::net::Ipv4Addr::UNSPECIFIED), |connection| connection.peer)
}

/// Refuses requests of pages of another origin. A plain read by a link on another page is allowed: it changes nothing,
/// and the other page cannot see the reply.
fn check_origin(
    state: &SharedAppState,
    headers: &HeaderMap,
    host: &str,
    plain: bool,
) -> Result<(), GatewayError> {
    let mut origins = headers.get_all(header::ORIGIN).iter();
    let Some(origin) = origins.next() else { return Ok(()) };
    let ours = origin.to_str().is_ok_and(|origin| state.hosts.is_own_origin(origin, host));
    if plain || ours && origins.next().is_none() {
        return Ok(());
    }
    let shown = origin.to_str().ok().filter(|origin| origin.len() <= 253).unwrap_or("unreadable");
    Err(origin_error(&format!("this request comes from the page of another origin, {shown}"))
        .hint(format!("if that is this server behind a proxy, start it with --origin {shown}")))
}

/// Refuses what a form could send.
fn check_csrf(headers: &HeaderMap, route: Option<&ApiRoute>) -> Result<(), GatewayError> {
    let marked = header_text(headers, HeaderName::from_static(CSRF_HEADER)) == Some("1");
    let kind = header_text(headers, header::CONTENT_TYPE).unwrap_or_default();
    let kind = kind.split_once(';').map_or(kind, |(kind, _)| kind).trim();
    let wanted = if route.is_some_and(|route| route.accepts_file) { OCTET_STREAM } else { JSON };
    if marked && kind.eq_ignore_ascii_case(wanted) {
        return Ok(());
    }
    Err(origin_error("a request that changes something needs these headers")
        .hint(format!("send `Content-Type: {wanted}` and `X-Polepair: 1`")))
}

fn origin_error(what: &str) -> GatewayError {
    GatewayError::new("gateway.origin", what)
}

fn is_one_time_query(query: &str) -> bool {
    query.starts_with("once=")
}

fn is_upgrade(headers: &HeaderMap) -> bool {
    headers.contains_key(header::UPGRADE)
}

fn header_text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

#[cfg(test)]
mod tests {
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
