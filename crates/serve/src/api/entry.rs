//! Coming in: tokens become cookies. And the page, which is read like anything else.

use axum::Json;
use axum::extract::{FromRequest as _, Request, State};
use axum::http::{HeaderName, Method, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use serde_json::json;

use super::Shared;
use super::input::Input;
use crate::guard::peer;
use crate::message::{Deed, ErrorBody, Login, Refused, Session};
use crate::page;
use crate::session::Caller;

/// Exchange a token for a cookie
#[utoipa::path(post, path = "/api/v1/login", tag = "gateway", request_body = Login, responses(
    (status = 200, body = Session),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn login(State(gate): State<Shared>, request: Request) -> Response {
    let peer = peer(&request);
    let tried = match Input::<Login>::from_request(request, &gate).await {
        Ok(Input(Login { token })) => gate.door.login(&token, peer),
        Err(refused) => Err(refused),
    };
    match noted(&gate, tried, peer) {
        Ok((caller, cookie)) => {
            let scopes = caller.scopes.iter().collect();
            (cookies(cookie), Json(Session { scopes })).into_response()
        }
        Err(refused) => refused.into_response(),
    }
}

/// The page's files, and its door: `/?once=…`.
pub(super) async fn page(State(gate): State<Shared>, request: Request) -> Response {
    let reads = matches!(*request.method(), Method::GET | Method::HEAD);
    let uri = request.uri();
    let once = uri.query().and_then(|query| query.strip_prefix("once="));
    if let ("/", Some(token), true) = (uri.path(), once, reads) {
        let peer = peer(&request);
        // A look ahead must not use the token up: nothing but a real visit does.
        let tried = match *request.method() {
            Method::GET => gate.door.login_once(token, peer),
            _ => Err(Refused::new("gateway.method", "this is for GET")),
        };
        return match noted(&gate, tried, peer) {
            Ok((_, cookie)) => {
                let there = (cookies(cookie), [(header::LOCATION, "/")]);
                (StatusCode::SEE_OTHER, there.0, there.1).into_response()
            }
            Err(refused) if refused.status() == 401 => page::locked(StatusCode::UNAUTHORIZED),
            Err(refused) => refused.into_response(),
        };
    }
    let missing = || Refused::new("gateway.missing", "there is no such thing here").into_response();
    page::file(uri.path()).unwrap_or_else(missing)
}

fn cookies(cookie: String) -> [(HeaderName, String); 1] {
    [(header::SET_COOKIE, cookie)]
}

/// Notes who came in or failed to. What was tried is noted nowhere.
fn noted(
    gate: &Shared,
    tried: Result<(Caller, String), Refused>,
    peer: std::net::IpAddr,
) -> Result<(Caller, String), Refused> {
    let (who, ok) = match &tried {
        Ok((caller, _)) => (caller.name.as_str(), true),
        Err(refused) if refused.code == "gateway.token" => ("nobody", false),
        // Beyond the limit nothing is written: the journal would be filled.
        Err(_) => return tried,
    };
    tracing::info!(%peer, who, ok, "login");
    gate.journal.write(who, Deed::Login, None, &json!({ "peer": peer, "ok": ok }))?;
    tried
}
