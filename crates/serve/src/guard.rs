//! The guard: one layer before every route, which denies everything that the route table does not permit.
//!
//! Order of the checks: security headers for every response; `Host` must be a name of the server; no
//! request of another site's page (`Origin`, and for changes a content type and a header that forms cannot
//! send); token; scope. Addresses are not trusted, and proxy headers are ignored.

use std::time::Duration;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};

use crate::access::AccessRule;
use crate::api::ApiRoute;
use crate::app_state::SharedAppState;
use crate::auth::Caller;
use crate::connections::{PeerConnection, peer};
use crate::hosts::header_text;
use crate::message::GatewayError;
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
