//! Axes of an open link that did not reply when it was opened. They are polled until they reply, and then
//! added.

use std::collections::VecDeque;
use std::sync::{Arc, Weak};
use std::time::Duration;

use polepair::scan::DriveScanner;
use polepair_core::time::Instant;
use polepair_link::clock;
use serde_json::json;
use tokio::sync::oneshot;

use super::context::BenchEvent;
use super::journal_sink::SERVER;
use super::thread_error::thread_error;
use super::wire::StopBatch;
use super::{Bench, BenchInner};
use crate::message::{GatewayError, JournalAction};

/// Between two questions at least; no longer where questions are short.
const PROBE_INTERVAL: Duration = Duration::from_secs(2);
/// Divisor of the wire's time for searches of absent drives.
const AIRTIME_DIVISOR: u32 = 20;

impl Bench {
    /// Asks for the axes that are not there on a link, one after the other, until all have joined.
    pub(super) fn spawn_absent_probe(&self, n: usize) -> Result<(), GatewayError> {
        let bench = Arc::downgrade(&self.0);
        let named = std::thread::Builder::new().name("absent-axes".to_owned());
        let asks = named.spawn(move || probe_until_joined(&bench, n));
        asks.map(drop).map_err(|error| thread_error(&error))
    }

    /// The next absent drive: those with an inherited pending stop, and one of the others between them.
    fn next_absent(&self, n: usize, queue: &mut VecDeque<u32>, others: &mut usize) -> Option<u32> {
        let link = &self.0.links[n];
        let absent: Vec<u32> = link.absent().iter().map(|axis| axis.number).collect();
        queue.retain(|number| absent.contains(number));
        if queue.is_empty() {
            let pending = self.0.context.inherited_stops_on(&link.url);
            let has_pending_stop = |number: &&u32| pending.contains(number);
            let rest: Vec<u32> =
                absent.iter().filter(|number| !has_pending_stop(number)).copied().collect();
            queue.extend(absent.iter().filter(has_pending_stop));
            *others += 1;
            queue.extend(rest.get(*others % rest.len().max(1)));
        }
        queue.pop_front()
    }

    /// Returns whether a drive may be asked now. One with a pending stop is asked at any time: a stop of the other axes
    /// waits for one question at most. Any other waits until they are at rest.
    fn may_probe(&self, n: usize, number: u32) -> bool {
        let link = &self.0.links[n];
        let is_free = link.wire.link_error().is_none() && !link.wire.scan_flag.is_active();
        let outstanding = self.0.context.has_inherited_stop(&link.url, number);
        is_free && (outstanding || link.wire.check_at_rest().is_ok())
    }

    /// Queries one axis and adds it when it answers. Runs in the request worker of the wire, so that
    /// nothing else is queried meanwhile.
    fn probe_absent(&self, n: usize, number: u32) -> Result<(), GatewayError> {
        let (link, shared) = (&self.0.links[n], &self.0.context);
        if shared.is_closing() || !self.may_probe(n, number) {
            return Ok(());
        }
        let stops = link.wire.stop_count();
        // An axis of the link may be commanded meanwhile: queries would delay its commands.
        let broken =
            || shared.is_closing() || link.wire.stop_count() != stops || !self.may_probe(n, number);
        let (root, index) = {
            let (root, index) = link.scan.root()?;
            (root.clone(), index)
        };
        let mut scanner =
            DriveScanner::on_link(link.scan.connector(), &root, index, number..=number)?;
        while scanner.next_address(&broken)?.is_some() {
            scanner.query_next(&broken)?;
        }
        let found: Vec<_> = scanner.finish().found;
        let found: Vec<_> = found.into_iter().filter(|one| one.clash.is_none()).take(1).collect();
        if found.is_empty() || shared.is_closing() || !self.may_probe(n, number) {
            return Ok(());
        }
        let added = self.add_found_drives(n, &found)?;
        link.remove_absent(number);
        // A stop of all axes meant this one as well, and could not reach it.
        self.stop_if_locked(n, link.wire.axes.len() - added.axes.len());
        let detail = json!({ "link": link.id, "drives": [number], "axes": added.axes });
        shared.record(&SERVER.into(), JournalAction::TakeIn, None, detail);
        tracing::info!(link = link.id, number, "an absent axis answers now");
        shared.publish(BenchEvent::BenchChanged);
        Ok(())
    }

    /// Stops the axes of a link from index `first` on, if everything was stopped before they joined.
    pub(super) fn stop_if_locked(&self, n: usize, first: usize) {
        let (wire, shared) = (&self.0.links[n].wire, &self.0.context);
        let lock = shared.current_lock().clone();
        if let Some(lock) = lock {
            let axes = (first..wire.axes.len()).map(|index| (index, 0)).collect();
            let (who, reason, since) = (lock.by.as_str().into(), lock.reason, shared.now());
            wire.submit_stop(StopBatch {
                axes,
                session: who,
                reason,
                requested_at: since,
                collector: None,
            });
        }
    }
}

/// Asks until none is absent any more, or the bench closes.
pub(super) fn probe_until_joined(bench: &Weak<BenchInner>, n: usize) {
    let (mut queue, mut others) = (VecDeque::new(), 0);
    let mut again_at: Instant = clock::now();
    loop {
        clock::sleep_until(again_at);
        let Some(bench) = bench.upgrade().map(Bench).filter(|b| !b.0.context.is_closing()) else {
            return;
        };
        let Some(number) = bench.next_absent(n, &mut queue, &mut others) else { return };
        let started_at = clock::now();
        again_at = started_at + PROBE_INTERVAL;
        if !bench.may_probe(n, number) {
            continue;
        }
        let (reply_sender, reply) = oneshot::channel();
        let (worker, asks) = (&bench.0.links[n].request_worker, bench.clone());
        worker.submit_query(reply_sender, move || asks.probe_absent(n, number));
        // The bench may be closed meanwhile: it is not kept from here.
        drop(bench);
        if let Ok(Err(error)) = reply.blocking_recv() {
            tracing::debug!(link = n, number, %error, "cannot query an absent axis");
        }
        let took = clock::now().since(started_at);
        again_at = again_at.max(clock::now() + took * AIRTIME_DIVISOR);
    }
}
