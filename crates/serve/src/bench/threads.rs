//! The threads of a bench. In virtual time, the caller runs their work.

use std::sync::{Arc, Mutex};

use polepair::events::Events;

use super::command_worker::CommandWorker;
use super::event_listener::DriveEventListener;
use super::frames::TrafficDecoder;
use super::journal_queue::JournalWriter;
use super::lock::lock_unpoisoned;
use super::open::BenchLink;
use super::poller::AxisPoller;
use super::thread_error::thread_error;
use super::{Bench, BenchInner};
use crate::message::GatewayError;

impl Bench {
    /// Gives everything that looks after a link a thread.
    pub(super) fn start_threads(
        &self,
        roots: Vec<(u16, polepair::LocalLink)>,
        scribe: JournalWriter,
    ) -> Result<(), GatewayError> {
        let writes = named_thread("journal-writer").spawn(move || scribe.run());
        *lock_unpoisoned(&self.0.journal_thread) =
            Some(writes.map_err(|error| thread_error(&error))?);
        let mut threads = lock_unpoisoned(&self.0.threads);
        for link in &self.0.links {
            let (worker, axis_poller) =
                (Arc::new(Mutex::new(self.new_command_worker(link))), self.new_poller(link));
            let send_stops = CommandWorker::stop_sender(&worker);
            let started = named_thread("command-worker").spawn(move || CommandWorker::run(&worker));
            let started = started.map_err(|error| thread_error(&error))?;
            link.wire.set_worker(started.thread().clone(), send_stops);
            threads.push(started);
            let watches = named_thread("axis-poller").spawn(move || axis_poller.run());
            threads.push(watches.map_err(|error| thread_error(&error))?);
        }
        let reader = self.new_traffic_decoder();
        let reads = named_thread("frame-decoder").spawn(move || reader.run());
        threads.push(reads.map_err(|error| thread_error(&error))?);
        drop(threads);
        roots.into_iter().try_for_each(|(base, link)| self.listen_events(base, 0, &link))
    }

    /// Listens to the axes of an opened connection string, from `first` on; `base` is the bench's number of the first
    /// of them.
    pub(super) fn listen_events(
        &self,
        base: u16,
        first: usize,
        link: &polepair::LocalLink,
    ) -> Result<(), GatewayError> {
        let new_listener = self.new_event_listener(base, first, link);
        if !self.0.context.clock.is_real() {
            lock_unpoisoned(&self.0.event_listeners).push(new_listener(link.events_from(first)?));
            return Ok(());
        }
        let link = link.clone();
        let named = std::thread::Builder::new().name("event-listener".to_owned());
        // A listener first asks drives for their settings, for which no caller waits.
        let listens = named.spawn(move || match link.events_from(first) {
            Ok(events) => new_listener(events).run(),
            Err(error) => tracing::warn!(%error, "cannot listen for unsolicited messages"),
        });
        lock_unpoisoned(&self.0.threads).push(listens.map_err(|error| thread_error(&error))?);
        Ok(())
    }

    /// Keeps what looks after the links, for [`pass`](Self::pass).
    pub(super) fn set_up_virtual(
        &self,
        roots: &[(u16, polepair::LocalLink)],
        scribe: JournalWriter,
    ) -> Result<(), GatewayError> {
        let mut by_hand = lock_unpoisoned(&self.0.non_blocking);
        by_hand.journal_writer = Some(scribe);
        for link in &self.0.links {
            let worker = Arc::new(Mutex::new(self.new_command_worker(link)));
            link.wire.set_worker(std::thread::current(), CommandWorker::stop_sender(&worker));
            by_hand.command_workers.push(worker);
        }
        drop(by_hand);
        let mut waiting = lock_unpoisoned(&self.0.blocking);
        waiting.pollers.extend(self.0.links.iter().map(|link| self.new_poller(link)));
        waiting.traffic_decoder = Some(self.new_traffic_decoder());
        drop(waiting);
        roots.iter().try_for_each(|(base, link)| self.listen_events(*base, 0, link))
    }

    fn new_command_worker(&self, link: &BenchLink) -> CommandWorker {
        let (wire, worker) = (Arc::clone(&link.wire), Arc::clone(&link.request_worker));
        CommandWorker::new(wire, worker, Arc::clone(&self.0.context), link.url.clone())
    }

    fn new_poller(&self, link: &BenchLink) -> AxisPoller {
        AxisPoller::new(link, &self.0.context, &self.0.telemetry)
    }

    /// Decoder of the frames.
    fn new_traffic_decoder(&self) -> TrafficDecoder {
        let BenchInner { links, traffic, context, .. } = &*self.0;
        let decoders = links.iter().map(BenchLink::decoder).collect();
        let wires = links.iter().map(|link| Arc::clone(&link.wire)).collect();
        let (traffic, shared) = (Arc::clone(traffic), Arc::clone(context));
        TrafficDecoder { traffic, context: shared, decoders, wires, count: 0 }
    }

    /// Listener of an opened connection string, once its events are subscribed.
    fn new_event_listener(
        &self,
        base: u16,
        first: usize,
        link: &polepair::LocalLink,
    ) -> impl FnOnce(Events) -> DriveEventListener + Send + 'static {
        let count = link.axes().len() - first;
        let seats = self.0.axes.iter().skip(usize::from(base)).take(count);
        let wires: Vec<_> = seats.map(|entry| self.0.links[entry.link].wire.clone()).collect();
        let zeros = wires.iter().map(|wire| wire.time_origin()).collect();
        let (telemetry, shared) = (self.0.telemetry.clone(), self.0.context.clone());
        move |events| DriveEventListener {
            events,
            base,
            first,
            time_origins: zeros,
            wires,
            telemetry,
            context: shared,
            lost: 0,
        }
    }
}

fn named_thread(what: &str) -> std::thread::Builder {
    std::thread::Builder::new().name(what.to_owned())
}
