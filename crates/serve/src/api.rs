//! The route table. The router, the guard's permissions and the tests are made from it.

mod axis;
mod bench;
mod capture;
mod diagnostics;
mod input;
mod login;
mod motion;
mod openapi;
mod scan;
mod search;

use std::fmt;
use std::sync::Arc;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::Method;
use axum::routing::{MethodRouter, delete, get, post};

use crate::access::{AccessRule, LEASE_SCOPES};
use crate::app_state::{AppState, SharedAppState};
use crate::bench::CAPTURE_MAX;
use crate::live;
use crate::message::GatewayError;
use crate::scope::Scope;

pub use openapi::openapi_json;

/// Bytes of a body.
pub const BODY_MAX: usize = 1 << 20;

/// A route.
#[derive(Clone, Copy)]
pub struct ApiRoute {
    /// `GET`, `POST`, `DELETE`.
    pub method: &'static str,
    /// With `{…}` where something is put in.
    pub path: &'static str,
    /// Required access.
    pub access: AccessRule,
    /// True if its body is a file, not JSON.
    pub accepts_file: bool,
    handler: fn() -> MethodRouter<SharedAppState>,
}

impl fmt::Debug for ApiRoute {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.method, self.path)
    }
}

const fn route(
    method: &'static str,
    path: &'static str,
    scopes: &'static [Scope],
    answers: fn() -> MethodRouter<SharedAppState>,
) -> ApiRoute {
    ApiRoute {
        method,
        path,
        access: AccessRule::AnyOf(scopes),
        accepts_file: false,
        handler: answers,
    }
}

const READ: &[Scope] = &[Scope::Read];
const STOP: &[Scope] = &[Scope::Stop];
const MOVE: &[Scope] = &[Scope::Move];
const CONFIGURE: &[Scope] = &[Scope::Configure];
const RAW: &[Scope] = &[Scope::Raw];

/// Opening a capture moves nothing and writes nothing, so it needs only the scope to see.
const CAPTURES_PATH: &str = "/api/v1/captures";

/// A plan for stored paths sends nothing to the drive.
const PATHS_PATH: &str = "/api/v1/axes/{id}/paths";

const SEARCH_PATH: &str = "/api/v1/search";

const SCAN_PATH: &str = "/api/v1/links/{id}/look";

/// The client shows its token only after it has checked this reply.
const PROOF_PATH: &str = "/api/v1/proof/{challenge}";

/// Every route but the page's files, which any caller may read that has a token.
pub const ROUTES: &[ApiRoute] = &[
    ApiRoute {
        access: AccessRule::Public,
        ..route("POST", "/api/v1/login", &[], || post(login::login))
    },
    ApiRoute { access: AccessRule::Public, ..route("GET", PROOF_PATH, &[], || get(login::prove)) },
    route("GET", "/api/v1/bench", READ, || get(bench::show)),
    route("GET", "/api/v1/live", READ, || get(live::upgrade)),
    ApiRoute { accepts_file: true, ..route("POST", CAPTURES_PATH, READ, || post(capture::open)) },
    route("GET", "/api/v1/captures/{id}", READ, || get(capture::page)),
    route("GET", "/api/v1/captures/{id}/frames/{n}", READ, || get(capture::frame)),
    route("GET", "/api/v1/journal", READ, || get(diagnostics::journal)),
    route("GET", "/api/v1/openapi.json", READ, || get(diagnostics::openapi)),
    route("GET", "/metrics", READ, || get(diagnostics::metrics)),
    route("GET", SEARCH_PATH, READ, || get(search::show)),
    route("POST", SEARCH_PATH, CONFIGURE, || post(search::start)),
    route("DELETE", SEARCH_PATH, CONFIGURE, || delete(search::cancel)),
    route("GET", SCAN_PATH, READ, || get(scan::show)),
    route("POST", SCAN_PATH, CONFIGURE, || post(scan::start)),
    route("DELETE", SCAN_PATH, CONFIGURE, || delete(scan::cancel)),
    route("POST", "/api/v1/links/{id}/look/take", CONFIGURE, || post(scan::add_drives)),
    route("GET", "/api/v1/axes/{id}", READ, || get(axis::show)),
    route("GET", "/api/v1/axes/{id}/signals/{words}", READ, || get(axis::signals)),
    route("GET", "/api/v1/axes/{id}/parameters", READ, || get(axis::parameters)),
    route("GET", "/api/v1/axes/{id}/parameters/{name}", READ, || get(axis::parameter)),
    route("GET", "/api/v1/axes/{id}/device", READ, || get(axis::device)),
    route("GET", PATHS_PATH, READ, || get(axis::paths)),
    route("POST", PATHS_PATH, READ, || post(axis::plan_paths)),
    route("GET", "/api/v1/axes/{id}/program", READ, || get(axis::program)),
    route("GET", "/api/v1/axes/{id}/program/state", READ, || get(axis::program_state)),
    route("POST", "/api/v1/axes/{id}/parameters", CONFIGURE, || post(axis::write)),
    route("GET", "/api/v1/axes/{id}/watchdog", READ, || get(axis::watchdog)),
    route("POST", "/api/v1/axes/{id}/watchdog", CONFIGURE, || post(axis::set_watchdog)),
    route("POST", "/api/v1/axes/{id}/lease", LEASE_SCOPES, || post(motion::acquire_lease)),
    route("POST", "/api/v1/axes/{id}/lease/renew", LEASE_SCOPES, || post(motion::renew_lease)),
    route("DELETE", "/api/v1/axes/{id}/lease", LEASE_SCOPES, || delete(motion::release_lease)),
    route("POST", "/api/v1/axes/{id}/commands", MOVE, || post(motion::command)),
    route("POST", "/api/v1/axes/{id}/drive-log", MOVE, || post(motion::record_in_drive)),
    route("POST", "/api/v1/axes/{id}/raw", RAW, || post(motion::raw)),
    route("POST", "/api/v1/axes/{id}/dismiss", MOVE, || post(motion::dismiss)),
    route("POST", "/api/v1/dismiss", MOVE, || post(motion::dismiss_absent)),
    route("POST", "/api/v1/stop", STOP, || post(motion::stop)),
    route("POST", "/api/v1/release", MOVE, || post(motion::release)),
    route("POST", "/api/v1/simulation/pace", CONFIGURE, || post(bench::set_time_scale)),
    route("POST", "/api/v1/simulation/{link}/{drive}", CONFIGURE, || post(bench::apply_action)),
];

impl ApiRoute {
    /// The route of that method and path.
    pub(crate) fn find(method: &Method, path: &str) -> Option<&'static Self> {
        let method = if *method == Method::HEAD { "GET" } else { method.as_str() };
        ROUTES.iter().find(|route| route.method == method && route.path == path)
    }
}

/// Every route. The server puts its guard in front.
pub(crate) fn router(state: &SharedAppState) -> Router {
    let mut router = Router::new();
    for route in ROUTES {
        let max_value = if route.accepts_file { CAPTURE_MAX } else { BODY_MAX };
        let answers = (route.handler)().layer(DefaultBodyLimit::max(max_value));
        router = router.route(route.path, answers);
    }
    router.fallback(login::serve_page).with_state(Arc::clone(state))
}

/// Result of a route.
pub(crate) type ApiResult<T> = Result<axum::Json<T>, GatewayError>;

/// Runs work that takes a while on a thread where it delays no other reply.
async fn run_blocking<T: Send + 'static>(
    state: &SharedAppState,
    act: impl FnOnce(&AppState) -> Result<T, GatewayError> + Send + 'static,
) -> Result<T, GatewayError> {
    let state = Arc::clone(state);
    let done = tokio::task::spawn_blocking(move || act(&state)).await;
    done.map_err(|error| GatewayError::new("gateway.busy", error.to_string()))?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reading_needs_read_and_stopping_stop_and_neither_moves() {
        let for_all = ROUTES.iter().filter(|route| route.access == AccessRule::Public);
        assert_eq!(
            for_all.map(|route| route.path).collect::<Vec<_>>(),
            ["/api/v1/login", PROOF_PATH]
        );
        for route in ROUTES.iter().filter(|route| route.path != PROOF_PATH) {
            let by = |words: &str| route.access.is_met_by(words.parse().unwrap());
            let viewer = by("read,stop");
            let is_read =
                route.method == "GET" || [CAPTURES_PATH, PATHS_PATH].contains(&route.path);
            assert_eq!(is_read, by("read") && route.access != AccessRule::Public, "{route:?}");
            let for_viewers = is_read || ["/api/v1/stop", "/api/v1/login"].contains(&route.path);
            assert_eq!(viewer, for_viewers, "{route:?}");
        }
    }

    #[test]
    fn the_description_has_every_route_and_no_other() {
        let description: serde_json::Value = serde_json::from_str(&openapi_json()).unwrap();
        let paths = description["paths"].as_object().unwrap();
        let described: usize = paths.values().map(|path| path.as_object().unwrap().len()).sum();
        assert_eq!(described, ROUTES.len());
        for route in ROUTES {
            let method = route.method.to_ascii_lowercase();
            assert!(paths[route.path][method].is_object(), "{route:?}");
        }
    }
}
