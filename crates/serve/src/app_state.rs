//! State shared by all requests.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use tokio::runtime::Handle;
use tokio::sync::Semaphore;

use crate::auth::{Authenticator, Caller};
use crate::bench::{Bench, SessionName};
use crate::broadcaster::Broadcaster;
use crate::hosts::AllowedHosts;
use crate::journal::JournalFile;
use crate::message::BenchView;
use crate::metrics::Metrics;

/// Captures that are taken in at once.
const UPLOADS_MAX: usize = 2;

/// The runtimes that serve viewers.
#[derive(Debug)]
pub(crate) struct LiveRuntimes {
    /// They receive messages of authenticated viewers and execute them.
    pub inbound: Handle,
    /// They send to viewers.
    pub outbound: Handle,
    /// True if connections are encrypted; else those that write stand back.
    pub encrypted: bool,
}

/// State shared by all routes.
#[derive(Debug)]
pub(crate) struct AppState {
    pub bench: Bench,
    pub authenticator: Authenticator,
    pub hosts: AllowedHosts,
    pub journal: Arc<JournalFile>,
    pub metrics: Metrics,
    pub broadcaster: Broadcaster,
    pub uploads: Arc<Semaphore>,
    /// Runtimes for writers of viewers, apart from the readers of commands.
    pub runtimes: LiveRuntimes,
    sessions: AtomicU64,
}

pub(crate) type SharedAppState = Arc<AppState>;

impl AppState {
    pub fn new(
        bench: Bench,
        authenticator: Authenticator,
        hosts: AllowedHosts,
        journal: Arc<JournalFile>,
        runtimes: LiveRuntimes,
    ) -> Self {
        let (metrics, broadcaster) = (Metrics::default(), Broadcaster::default());
        let (uploads, sessions) = (Arc::new(Semaphore::new(UPLOADS_MAX)), AtomicU64::new(1));
        Self {
            bench,
            authenticator,
            hosts,
            journal,
            metrics,
            broadcaster,
            uploads,
            runtimes,
            sessions,
        }
    }

    /// The bench as a caller sees it.
    pub fn bench_view(&self, caller: &Caller) -> BenchView {
        BenchView { scopes: caller.scopes.iter().collect(), ..self.bench.snapshot() }
    }

    /// A name for a client that stays.
    pub fn new_session(&self, caller: &Caller) -> SessionName {
        let n = self.sessions.fetch_add(1, Ordering::Relaxed);
        // A token's name has no space in it, so this name is unique.
        format!("{} {n}", caller.name).into()
    }
}

/// Session of a REST client, by the name of the token: leases last from one request to the next.
pub(crate) fn rest_session(caller: &Caller) -> SessionName {
    caller.name.as_str().into()
}

/// [`rest_session`], or the session of a page that has the lease by its WebSocket and asks by REST, if the caller has
/// the same name and knows the epoch.
pub(crate) fn lease_session(
    app_state: &SharedAppState,
    caller: &Caller,
    axis: u16,
    epoch: u64,
) -> SessionName {
    let lease = app_state.bench.axis_state(axis).ok().and_then(|state| state.lease);
    match lease.filter(|lease| lease.epoch == epoch && is_callers(&lease.owner, &caller.name)) {
        Some(lease) => lease.owner.into(),
        None => rest_session(caller),
    }
}

fn is_callers(owner: &str, caller_name: &str) -> bool {
    owner.split(' ').next() == Some(caller_name)
}
