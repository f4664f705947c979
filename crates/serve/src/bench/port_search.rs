//! Searches ports that no link uses for drives of unknown protocol and rate.
//!
//! The search has its own thread: it waits for silence, minutes long, and uses no wire of the bench.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

use polepair::Connector;
use polepair::axis::summarize_details;
use polepair::search::{FoundLink, SearchReport, SearchStep, SilentPort, search};
use polepair::url::{AxisNumber, LinkTarget, Url};
use polepair_core::convert::saturating;
use polepair_core::time::Instant;
use polepair_link::{clock, ports};
use serde_json::json;

use super::clock::BenchClock;
use super::context::BenchEvent;
use super::lease::SessionName;
use super::lock::lock_unpoisoned;
use super::scan_flag::scan_error;
use super::thread_error::thread_error;
use super::{Bench, BenchInner};
use crate::message::{
    GatewayError, JournalAction, ScanState, SearchRequest, SearchView, SearchedDrive, SearchedPort,
};

/// Interval of progress reports.
const REPORT_INTERVAL: Duration = Duration::from_millis(100);

/// State of searches of this bench.
pub(super) struct BenchSearch {
    /// With which names and profiles.
    connector: Connector,
    /// Ports that may be searched, besides those that the system lists.
    more_ports: Vec<String>,
    /// The search under way, or the last.
    view: Mutex<Option<SearchView>>,
    cancelled: AtomicBool,
}

impl BenchSearch {
    pub fn new(connector: Connector, more_ports: Vec<String>) -> Self {
        Self { connector, more_ports, view: Mutex::default(), cancelled: AtomicBool::new(false) }
    }

    /// The search under way, or the last.
    pub fn last_view(&self) -> Option<SearchView> {
        lock_unpoisoned(&self.view).clone()
    }
}

impl Bench {
    /// Searches ports by reads only. [`BenchEvent::Search`] reports its progress and its end.
    ///
    /// # Errors
    /// `gateway.look` while a search is under way, or for a port that a link uses; `gateway.missing` for a name that is
    /// no port of this machine, and where there is none that is free.
    pub fn start_search(
        &self,
        session: &SessionName,
        request: &SearchRequest,
    ) -> Result<SearchView, GatewayError> {
        let ports = self.searchable_ports(request)?;
        let shared = &self.0.context;
        let view = SearchView {
            by: session.to_string(),
            began_ms: BenchClock::wall_ms(shared.now()),
            state: ScanState::UnderWay,
            step: String::new(),
            done: 0,
            of: 0,
            found: Vec::new(),
            silent: Vec::new(),
            error: None,
        };
        {
            let mut last = lock_unpoisoned(&self.0.port_search.view);
            if last.as_ref().is_some_and(|last| last.state == ScanState::UnderWay) {
                return Err(scan_error("a search is already running")
                    .hint("wait for its end, or cancel it"));
            }
            self.0.port_search.cancelled.store(false, Ordering::SeqCst);
            let detail = json!({ "search": ports });
            let bench = Arc::downgrade(&self.0);
            let named = std::thread::Builder::new().name("search".to_owned());
            let searches = named.spawn(move || run_search(&bench, &ports));
            lock_unpoisoned(&self.0.threads).push(searches.map_err(|error| thread_error(&error))?);
            shared.record(session, JournalAction::Look, None, detail);
            *last = Some(view.clone());
        }
        shared.publish(BenchEvent::Search(view.clone()));
        Ok(view)
    }

    /// The search that is under way, or the last.
    ///
    /// # Errors
    /// `gateway.missing` where there was none.
    pub fn search_view(&self) -> Result<SearchView, GatewayError> {
        self.0
            .port_search
            .last_view()
            .ok_or_else(|| GatewayError::new("gateway.missing", "no port was searched"))
    }

    /// Cancels a search: no query is sent after the present one.
    ///
    /// # Errors
    /// `gateway.missing` without a search.
    pub fn cancel_search(&self, session: &SessionName) -> Result<(), GatewayError> {
        let view = self.search_view()?;
        if view.state != ScanState::UnderWay {
            return Err(GatewayError::new("gateway.missing", "no search is running"));
        }
        self.0.port_search.cancelled.store(true, Ordering::SeqCst);
        let detail = json!({ "search": "broken_off" });
        self.0.context.record(session, JournalAction::Look, None, detail);
        Ok(())
    }

    /// The requested ports. Ports that the system does not list, and that no `--search-port` names, are refused: a
    /// client must not have the server write to any terminal.
    fn searchable_ports(&self, request: &SearchRequest) -> Result<Vec<String>, GatewayError> {
        let used: Vec<String> =
            self.0.links.iter().filter_map(|link| port_of_url(&link.url)).collect();
        let known = ports();
        let paths = known.iter().map(|port| port.path.clone());
        let all: Vec<String> = paths.chain(self.0.port_search.more_ports.iter().cloned()).collect();
        if request.ports.is_empty() {
            let free: Vec<String> = all.into_iter().filter(|port| !used.contains(port)).collect();
            return if free.is_empty() {
                Err(GatewayError::new("gateway.missing", "no port is free to be searched")
                    .hint("plug the adapter in; a port of a link is scanned on that link"))
            } else {
                Ok(free)
            };
        }
        for port in &request.ports {
            let stable = known.iter().any(|known| known.stable_name.as_deref() == Some(&**port));
            if !all.contains(port) && !stable {
                let what = format!("{port:?} is not a port of this machine");
                return Err(GatewayError::new("gateway.missing", what)
                    .hint("`polepair ports` lists them; `polepair serve --search-port PATH` allows another"));
            }
            if used.contains(port) {
                return Err(scan_error(format!("a link uses {port}")).hint("scan that link"));
            }
        }
        Ok(request.ports.clone())
    }
}

/// The port that a connection string opens on this machine.
fn port_of_url(url: &str) -> Option<String> {
    match url.parse::<Url>().ok()?.target {
        LinkTarget::Serial { path, .. } | LinkTarget::Slcan { path, .. } => Some(path),
        LinkTarget::Socketcan { interface } => Some(interface),
        _ => None,
    }
}

fn run_search(bench: &Weak<BenchInner>, ports: &[String]) {
    let Some(connector) = bench.upgrade().map(|bench| bench.port_search.connector.clone()) else {
        return;
    };
    let mut reported_at = Instant::ZERO;
    let report = search(&connector, ports, &mut |step| {
        // The last handle may be this one: nothing is held while a port is asked.
        let Some(bench) = bench.upgrade() else { return ControlFlow::Break(()) };
        let cancelled = bench.port_search.cancelled.load(Ordering::SeqCst);
        if cancelled || bench.context.is_closing() {
            return ControlFlow::Break(());
        }
        let now = clock::now();
        if now.since(reported_at) >= REPORT_INTERVAL {
            reported_at = now;
            bench.update_search(|view| note_step(view, step));
        }
        ControlFlow::Continue(())
    });
    let Some(bench) = bench.upgrade() else { return };
    bench.update_search(|view| match report {
        Ok(report) => note_report(view, report),
        Err(error) => {
            view.state = ScanState::Failed;
            view.error = Some(error.into());
        }
    });
}

impl BenchInner {
    /// Changes the view, and publishes it.
    fn update_search(&self, change: impl FnOnce(&mut SearchView)) {
        let mut last = lock_unpoisoned(&self.port_search.view);
        let Some(view) = last.as_mut() else { return };
        change(view);
        self.context.publish(BenchEvent::Search(view.clone()));
    }
}

fn note_step(view: &mut SearchView, step: &SearchStep<'_>) {
    view.step = format!("{}: {}", step.port, step.attempt);
    view.done = saturating(step.done);
    view.of = saturating(step.of.max(step.done));
}

fn note_report(view: &mut SearchView, report: SearchReport) {
    let drives = report.links.iter().flat_map(|FoundLink { url, drives }| {
        drives.iter().map(move |drive| SearchedDrive {
            url: format!("{url}#{}", AxisNumber(drive.number)),
            profile: drive.profile.name.to_owned(),
            drive: drive.profile.title.to_owned(),
            reported: summarize_details(&drive.details),
        })
    });
    view.found = drives.collect();
    let silent = report.silent.into_iter();
    let port =
        |SilentPort { port, error, tried, damaged }| SearchedPort { port, error, tried, damaged };
    view.silent = silent.map(port).collect();
    view.step = String::new();
    view.state = if report.is_interrupted { ScanState::BrokenOff } else { ScanState::Done };
}
