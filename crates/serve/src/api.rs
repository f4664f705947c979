//! The routes: one table, from which the router is made, the guard knows who may do what, and tests
//! know what there is to try.

mod axis;
mod bench;
mod capture;
mod entry;
mod input;
mod look;
mod motion;
mod openapi;
mod record;

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::Method;
use axum::routing::{MethodRouter, delete, get, post};
use tokio::sync::Semaphore;

use crate::bench::{Bench, CAPTURE_MAX, Session};
use crate::guard::{Hosts, guard};
use crate::journal::Journal;
use crate::live;
use crate::message::Refused;
use crate::metrics::Metrics;
use crate::scope::{Scope, Scopes};
use crate::session::{Caller, Door};

pub(crate) use bench::of as bench_of;
pub use openapi::description;

/// Bytes of a body.
pub const BODY_MAX: usize = 1 << 20;
/// Captures that are taken in at once.
const UPLOADS_MAX: usize = 2;

/// What every route works with.
#[derive(Debug)]
pub(crate) struct Gate {
    pub bench: Bench,
    pub door: Door,
    pub hosts: Hosts,
    pub journal: Arc<Journal>,
    pub metrics: Metrics,
    pub board: live::Board,
    pub uploads: Arc<Semaphore>,
    /// What viewers are shown is written there, apart from what reads commands.
    pub threads: live::Threads,
    sessions: AtomicU64,
}

pub(crate) type Shared = Arc<Gate>;

impl Gate {
    pub fn new(
        bench: Bench,
        door: Door,
        hosts: Hosts,
        journal: Arc<Journal>,
        threads: live::Threads,
    ) -> Self {
        let (metrics, board) = (Metrics::default(), live::Board::default());
        let (uploads, sessions) = (Arc::new(Semaphore::new(UPLOADS_MAX)), AtomicU64::new(1));
        Self { bench, door, hosts, journal, metrics, board, uploads, threads, sessions }
    }

    /// A name for a client that stays.
    pub fn session(&self, caller: &Caller) -> Session {
        let n = self.sessions.fetch_add(1, Ordering::Relaxed);
        // A token's name has no space in it: this is nobody's else.
        format!("{} {n}", caller.name).into()
    }
}

/// Whoever asks by REST, by the name of the token: leases last from one request to the next.
pub(crate) fn by_rest(caller: &Caller) -> Session {
    caller.name.as_str().into()
}

/// The same, where a page that has the lease by its WebSocket asks by REST: its session, if the caller
/// goes by the same name and knows the epoch.
pub(crate) fn by_lease(gate: &Shared, caller: &Caller, axis: u16, epoch: u64) -> Session {
    let lease = gate.bench.axis(axis).ok().and_then(|state| state.lease);
    let of_caller = |owner: &str| owner.split(' ').next() == Some(&caller.name);
    match lease.filter(|lease| lease.epoch == epoch && of_caller(&lease.owner)) {
        Some(lease) => lease.owner.into(),
        None => by_rest(caller),
    }
}

/// What a caller needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Needs {
    /// Not even a token.
    Nothing,
    /// One of these scopes.
    One(&'static [Scope]),
}

impl Needs {
    /// Whether these scopes are enough.
    #[must_use]
    pub fn met_by(self, scopes: Scopes) -> bool {
        match self {
            Self::Nothing => true,
            Self::One(any) => any.iter().any(|scope| scopes.allow(*scope)),
        }
    }
}

impl fmt::Display for Needs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::One(any) = self else { return f.write_str("nothing") };
        let mut between = "";
        for scope in *any {
            write!(f, "{between}{scope}")?;
            between = " or ";
        }
        Ok(())
    }
}

/// A route.
#[derive(Clone, Copy)]
pub struct Route {
    /// `GET`, `POST`, `DELETE`.
    pub method: &'static str,
    /// With `{…}` where something is put in.
    pub path: &'static str,
    /// Who may.
    pub needs: Needs,
    /// Its body is a file, not JSON.
    pub takes_file: bool,
    answers: fn() -> MethodRouter<Shared>,
}

impl fmt::Debug for Route {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.method, self.path)
    }
}

const fn route(
    method: &'static str,
    path: &'static str,
    scopes: &'static [Scope],
    answers: fn() -> MethodRouter<Shared>,
) -> Route {
    Route { method, path, needs: Needs::One(scopes), takes_file: false, answers }
}

const READ: &[Scope] = &[Scope::Read];
const STOP: &[Scope] = &[Scope::Stop];
const MOVE: &[Scope] = &[Scope::Move];
const CONFIGURE: &[Scope] = &[Scope::Configure];
const RAW: &[Scope] = &[Scope::Raw];
/// Whoever may do something that needs a lease may have one.
pub(crate) const COMMAND: &[Scope] = &[Scope::Move, Scope::Configure, Scope::Raw];

/// Taking one in moves nothing and writes nothing: whoever may see, may.
const CAPTURES: &str = "/api/v1/captures";

const LOOK: &str = "/api/v1/links/{id}/look";

/// Who asks for it does not show a token before it has the answer.
const PROOF: &str = "/api/v1/proof/{challenge}";

/// Every route but the page's files, which any caller may read that has a token.
pub const ROUTES: &[Route] = &[
    Route { needs: Needs::Nothing, ..route("POST", "/api/v1/login", &[], || post(entry::login)) },
    Route { needs: Needs::Nothing, ..route("GET", PROOF, &[], || get(entry::prove)) },
    route("GET", "/api/v1/bench", READ, || get(bench::show)),
    route("GET", "/api/v1/live", READ, || get(live::upgrade)),
    Route { takes_file: true, ..route("POST", CAPTURES, READ, || post(capture::open)) },
    route("GET", "/api/v1/captures/{id}", READ, || get(capture::page)),
    route("GET", "/api/v1/captures/{id}/frames/{n}", READ, || get(capture::frame)),
    route("GET", "/api/v1/journal", READ, || get(record::journal)),
    route("GET", "/api/v1/openapi.json", READ, || get(record::openapi)),
    route("GET", "/metrics", READ, || get(record::metrics)),
    route("GET", LOOK, READ, || get(look::show)),
    route("POST", LOOK, CONFIGURE, || post(look::begin)),
    route("DELETE", LOOK, CONFIGURE, || delete(look::break_off)),
    route("POST", "/api/v1/links/{id}/look/take", CONFIGURE, || post(look::take_in)),
    route("GET", "/api/v1/axes/{id}", READ, || get(axis::show)),
    route("GET", "/api/v1/axes/{id}/signals/{words}", READ, || get(axis::signals)),
    route("GET", "/api/v1/axes/{id}/parameters", READ, || get(axis::parameters)),
    route("GET", "/api/v1/axes/{id}/parameters/{name}", READ, || get(axis::parameter)),
    route("POST", "/api/v1/axes/{id}/parameters", CONFIGURE, || post(axis::write)),
    route("GET", "/api/v1/axes/{id}/watchdog", READ, || get(axis::watchdog)),
    route("POST", "/api/v1/axes/{id}/watchdog", CONFIGURE, || post(axis::set_watchdog)),
    route("POST", "/api/v1/axes/{id}/lease", COMMAND, || post(motion::take)),
    route("POST", "/api/v1/axes/{id}/lease/renew", COMMAND, || post(motion::renew)),
    route("DELETE", "/api/v1/axes/{id}/lease", COMMAND, || delete(motion::give_back)),
    route("POST", "/api/v1/axes/{id}/commands", MOVE, || post(motion::command)),
    route("POST", "/api/v1/axes/{id}/raw", RAW, || post(motion::raw)),
    route("POST", "/api/v1/axes/{id}/dismiss", MOVE, || post(motion::dismiss)),
    route("POST", "/api/v1/dismiss", MOVE, || post(motion::dismiss_absent)),
    route("POST", "/api/v1/stop", STOP, || post(motion::stop)),
    route("POST", "/api/v1/release", MOVE, || post(motion::release)),
    route("POST", "/api/v1/simulation/pace", CONFIGURE, || post(bench::pace)),
    route("POST", "/api/v1/simulation/{link}/{drive}", CONFIGURE, || post(bench::act)),
];

impl Route {
    /// The route of that method and path.
    pub(crate) fn find(method: &Method, path: &str) -> Option<&'static Self> {
        let method = if *method == Method::HEAD { "GET" } else { method.as_str() };
        ROUTES.iter().find(|route| route.method == method && route.path == path)
    }
}

/// Every route, behind the guard.
pub(crate) fn router(gate: &Shared) -> Router {
    let mut router = Router::new();
    for route in ROUTES {
        let most = if route.takes_file { CAPTURE_MAX } else { BODY_MAX };
        let answers = (route.answers)().layer(DefaultBodyLimit::max(most));
        router = router.route(route.path, answers);
    }
    router
        .fallback(entry::page)
        .layer(axum::middleware::from_fn_with_state(Arc::clone(gate), guard))
        .with_state(Arc::clone(gate))
}

/// What routes answer.
pub(crate) type Answer<T> = Result<axum::Json<T>, Refused>;

/// Does what takes a while where nobody else's answer waits for it.
async fn apart<T: Send + 'static>(
    gate: &Shared,
    act: impl FnOnce(&Gate) -> Result<T, Refused> + Send + 'static,
) -> Result<T, Refused> {
    let gate = Arc::clone(gate);
    let done = tokio::task::spawn_blocking(move || act(&gate)).await;
    done.map_err(|error| Refused::new("gateway.busy", error.to_string()))?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reading_needs_read_and_stopping_stop_and_neither_moves() {
        let for_all = ROUTES.iter().filter(|route| route.needs == Needs::Nothing);
        assert_eq!(for_all.map(|route| route.path).collect::<Vec<_>>(), ["/api/v1/login", PROOF]);
        for route in ROUTES.iter().filter(|route| route.path != PROOF) {
            let by = |words: &str| route.needs.met_by(words.parse().unwrap());
            let viewer = by("read,stop");
            let is_read = route.method == "GET" || route.path == CAPTURES;
            assert_eq!(is_read, by("read") && route.needs != Needs::Nothing, "{route:?}");
            let for_viewers = is_read || ["/api/v1/stop", "/api/v1/login"].contains(&route.path);
            assert_eq!(viewer, for_viewers, "{route:?}");
        }
    }

    #[test]
    fn the_description_has_every_route_and_no_other() {
        let description: serde_json::Value = serde_json::from_str(&description()).unwrap();
        let paths = description["paths"].as_object().unwrap();
        let described: usize = paths.values().map(|path| path.as_object().unwrap().len()).sum();
        assert_eq!(described, ROUTES.len());
        for route in ROUTES {
            let method = route.method.to_ascii_lowercase();
            assert!(paths[route.path][method].is_object(), "{route:?}");
        }
    }
}
