//! Work that waits for a drive and moves nothing: reads, settings, preparation of commands. The command
//! worker passes such work to the request worker of its wire, because it must not wait.
//!
//! Why: GW-12.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, PoisonError, Weak};
use std::time::Duration;

use super::lock::lock_unpoisoned;
use super::reply::Continuation;
use super::reply::ReplySender;
use super::wire::{BenchWire, CommandAction, QueuedCommand, WireRequest};
use crate::message::GatewayError;

/// Jobs in the queue of one request worker.
const JOBS_MAX: usize = 64;

/// The jobs of one wire.
pub(super) struct RequestWorker {
    wire: Weak<BenchWire>,
    jobs: Mutex<VecDeque<Continuation>>,
    wakeup: Condvar,
}

impl RequestWorker {
    pub fn new(wire: &Arc<BenchWire>) -> Self {
        Self { wire: Arc::downgrade(wire), jobs: Mutex::default(), wakeup: Condvar::new() }
    }

    /// Queues a job. Without room it is refused at once.
    pub fn submit(&self, job: Continuation) {
        let mut jobs = lock_unpoisoned(&self.jobs);
        if jobs.len() < JOBS_MAX {
            jobs.push_back(job);
            self.wakeup.notify_one();
            return;
        }
        drop(jobs);
        let what = "too many requests wait for this link";
        job(Err(GatewayError::new("gateway.busy", what).hint("ask less often")));
    }

    /// Queues a request, whose reply is sent later.
    pub fn submit_query<T: Send + 'static>(
        &self,
        reply_sender: ReplySender<T>,
        request: impl FnOnce() -> Result<T, GatewayError> + Send + 'static,
    ) {
        self.submit(Box::new(move |may| {
            // The receiver may have been dropped.
            let _ = reply_sender.send(may.and_then(|()| request()));
        }));
    }

    /// Prepares a command and returns it to the command worker. A stop in between goes first.
    pub fn prepare_command(&self, sequence: u64, mut commanded: QueuedCommand) {
        let Some(wire) = self.wire.upgrade() else { return };
        self.submit(Box::new(move |may| {
            let CommandAction::Run(command) = commanded.action else { return };
            let axis = &wire.axes[commanded.axis].1;
            commanded.prepared = Some(may.and_then(|()| Ok(axis.prepare(command)?)));
            wire.submit_first(sequence, WireRequest::Command(Box::new(commanded)));
        }));
    }

    /// Does one job, if there is any. False when there is none.
    pub fn run_next(&self) -> bool {
        let job = lock_unpoisoned(&self.jobs).pop_front();
        job.map(|job| job(Ok(()))).is_some()
    }

    /// Waits for a job, at most for this time.
    pub fn wait(&self, at_most: Duration) {
        let jobs = lock_unpoisoned(&self.jobs);
        if jobs.is_empty() {
            let waited = self.wakeup.wait_timeout(jobs, at_most);
            drop(waited.unwrap_or_else(PoisonError::into_inner));
        }
    }
}
