//! Login: exchanges tokens for cookies. Also serves the page.

use axum::Json;
use axum::extract::{Extension, FromRequest as _, Path, Request, State};
use axum::http::{HeaderName, Method, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use serde_json::json;

use super::input::JsonBody;
use super::{ApiResult, run_blocking};
use crate::app_state::SharedAppState;
use crate::auth::Caller;
use crate::connections::LocalAddress;
use crate::connections::peer;
use crate::message::{ErrorBody, GatewayError, JournalAction, Login, Proof, SessionInfo};
use crate::page;

/// Exchange a token for a cookie
#[utoipa::path(post, path = "/api/v1/login", tag = "gateway", request_body = Login, responses(
    (status = 200, body = SessionInfo),
    (status = "default", body = ErrorBody),
))]
pub(super) async fn login(State(state): State<SharedAppState>, request: Request) -> Response {
    let peer = peer(&request);
    let tried = match JsonBody::<Login>::from_request(request, &state).await {
        Ok(JsonBody(Login { token })) => {
            run_blocking(&state, move |state| state.authenticator.login(&token, peer)).await
        }
        Err(refused) => Err(refused),
    };
    match record_login(&state, tried, peer).await {
        Ok((caller, cookie)) => {
            let scopes = caller.scopes.iter().collect();
            (cookies(cookie), Json(SessionInfo { scopes })).into_response()
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
    State(state): State<SharedAppState>,
    Extension(LocalAddress(here)): Extension<LocalAddress>,
    Path(challenge): Path<String>,
) -> ApiResult<Proof> {
    state.authenticator.proof(&challenge, here).map(Json)
}

/// The page's files, and its login: `/?once=…`.
pub(super) async fn serve_page(State(state): State<SharedAppState>, request: Request) -> Response {
    let reads = matches!(*request.method(), Method::GET | Method::HEAD);
    let uri = request.uri();
    let once = uri.query().and_then(|query| query.strip_prefix("once="));
    if let ("/", Some(token), true) = (uri.path(), once, reads) {
        let peer = peer(&request);
        // A look ahead must not use the token up: nothing but a real visit does.
        let tried = match *request.method() {
            Method::GET => {
                let token = token.to_owned();
                run_blocking(&state, move |state| state.authenticator.login_one_time(&token, peer))
                    .await
            }
            _ => Err(GatewayError::new("gateway.method", "this is for GET")),
        };
        return match record_login(&state, tried, peer).await {
            Ok((_, cookie)) => {
                let there = (cookies(cookie), [(header::LOCATION, "/")]);
                (StatusCode::SEE_OTHER, there.0, there.1).into_response()
            }
            Err(refused) if refused.status() == 401 => {
                page::token_required_page(StatusCode::UNAUTHORIZED)
            }
            Err(refused) => refused.into_response(),
        };
    }
    page::file(uri.path())
        .unwrap_or_else(|| GatewayError::new("gateway.missing", "not found").into_response())
}

fn cookies(cookie: String) -> [(HeaderName, String); 1] {
    [(header::SET_COOKIE, cookie)]
}

/// Records who came in or failed to. The tried token is recorded nowhere.
async fn record_login(
    state: &SharedAppState,
    tried: Result<(Caller, String), GatewayError>,
    peer: std::net::IpAddr,
) -> Result<(Caller, String), GatewayError> {
    let (who, ok) = match &tried {
        Ok((caller, _)) => (caller.name.as_str(), true),
        Err(refused) if refused.code == "gateway.token" => ("nobody", false),
        // Beyond the limit nothing is written: the journal would be filled.
        Err(_) => return tried,
    };
    tracing::info!(%peer, who, ok, "login");
    state.bench.write_journal(who, JournalAction::Login, json!({ "peer": peer, "ok": ok })).await?;
    tried
}
