//! Coming in: tokens become cookies. And the page, which is read like anything else.

use axum::Json;
use axum::extract::{Extension, FromRequest as _, Path, Request, State};
use axum::http::{HeaderName, Method, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use serde_json::json;

use super::input::Input;
use super::{Answer, Shared, apart};
use crate::connections::Here;
use crate::guard::peer;
use crate::message::{Deed, ErrorBody, Login, Proof, Refused, Session};
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
        Ok(Input(Login { token })) => apart(&gate, move |gate| gate.door.login(&token, peer)).await,
        Err(refused) => Err(refused),
    };
    match noted(&gate, tried, peer).await {
        Ok((caller, cookie)) => {
            let scopes = caller.scopes.iter().collect();
            (cookies(cookie), Json(Session { scopes })).into_response()
        }
        Err(refused) => refused.into_response(),
    }
}

/// Prove to be the server of a token
///
/// Needs no token: who keeps the first one of the server's file sends 32 random bytes as 64 hexadecimal
/// digits, and sends the token once the answer is right.
#[utoipa::path(get, path = "/api/v1/proof/{challenge}", tag = "gateway",
    params(("challenge" = String, Path)), responses(
    (status = 200, body = Proof),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn prove(
    State(gate): State<Shared>,
    Extension(Here(here)): Extension<Here>,
    Path(challenge): Path<String>,
) -> Answer<Proof> {
    gate.door.proof(&challenge, here).map(Json)
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
            Method::GET => {
                let token = token.to_owned();
                apart(&gate, move |gate| gate.door.login_once(&token, peer)).await
            }
            _ => Err(Refused::new("gateway.method", "this is for GET")),
        };
        return match noted(&gate, tried, peer).await {
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
async fn noted(
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
    gate.bench.note(who, Deed::Login, json!({ "peer": peer, "ok": ok })).await?;
    tried
}
