//! What has to wait for a drive and moves nothing: questions, settings, getting ready. The hand never
//! waits, so it leaves these to the desk of its wire.
//!
//! Why: GW-12.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, PoisonError, Weak};
use std::time::Duration;

use super::shared::held;
use super::wire::{Commanded, Do, Go, Order, Tell, Wire};
use crate::message::Refused;

/// Jobs that wait at one desk.
const JOBS_MAX: usize = 64;

/// The jobs of one wire.
pub(super) struct Desk {
    wire: Weak<Wire>,
    jobs: Mutex<VecDeque<Go>>,
    called: Condvar,
}

impl Desk {
    pub fn new(wire: &Arc<Wire>) -> Self {
        Self { wire: Arc::downgrade(wire), jobs: Mutex::default(), called: Condvar::new() }
    }

    /// Leaves a job here. Where there is no room it is told so, at once.
    pub fn leave(&self, job: Go) {
        let mut jobs = held(&self.jobs);
        if jobs.len() < JOBS_MAX {
            jobs.push_back(job);
            self.called.notify_one();
            return;
        }
        drop(jobs);
        let what = "too much is asked of this link at once";
        job(Err(Refused::new("gateway.busy", what).hint("ask less often")));
    }

    /// Leaves a question here, whose answer is told.
    pub fn ask<T: Send + 'static>(
        &self,
        tell: Tell<T>,
        ask: impl FnOnce() -> Result<T, Refused> + Send + 'static,
    ) {
        self.leave(Box::new(move |may| {
            // Who has gone does not want to know.
            let _ = tell.send(may.and_then(|()| ask()));
        }));
    }

    /// Makes a command ready, and gives it back to the hand. A stop that comes between goes before.
    pub fn prepare(&self, said: u64, mut commanded: Commanded) {
        let Some(wire) = self.wire.upgrade() else { return };
        self.leave(Box::new(move |may| {
            let Do::Run(command) = commanded.deed else { return };
            let axis = &wire.axes[commanded.axis].1;
            commanded.prepared = Some(may.and_then(|()| Ok(axis.prepare(command)?)));
            wire.order_next(said, Order::Command(Box::new(commanded)));
        }));
    }

    /// Does one job, if there is any. False when there is none.
    pub fn work(&self) -> bool {
        let job = held(&self.jobs).pop_front();
        job.map(|job| job(Ok(()))).is_some()
    }

    /// Waits for a job, at most so long.
    pub fn wait(&self, at_most: Duration) {
        let jobs = held(&self.jobs);
        if jobs.is_empty() {
            let waited = self.called.wait_timeout(jobs, at_most);
            drop(waited.unwrap_or_else(PoisonError::into_inner));
        }
    }
}
