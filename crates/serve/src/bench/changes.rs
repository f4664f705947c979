//! Changes of a drive that move nothing: under a lease, once the journal keeps them, on the thread that waits for the
//! link.

use std::sync::Arc;

use polepair::LocalAxis;
use serde_json::{Value, json};
use tokio::sync::oneshot;

use super::Bench;
use super::journal_queue::ActionSubject;
use super::lease::SessionName;
use super::parameters::check_lease_held;
use super::reply::{Continuation, PendingReply};
use super::wire::{BenchWire, WireRequest};
use crate::message::{GatewayError, JournalAction};

/// An axis that is changed.
pub(super) struct ChangedAxis {
    pub(super) wire: Arc<BenchWire>,
    /// Index among the axes of the wire.
    pub(super) index: usize,
    pub(super) axis: LocalAxis,
}

impl Bench {
    /// Changes an axis by `work`, which may wait for the drive. `detail` is the entry of the journal.
    pub(super) fn change_axis<T: Send + 'static>(
        &self,
        axis: u16,
        session: &SessionName,
        epoch: u64,
        detail: impl FnOnce(&LocalAxis) -> Value,
        work: impl FnOnce(&ChangedAxis) -> Result<T, GatewayError> + Send + 'static,
    ) -> PendingReply<T> {
        let (reply_sender, reply) = oneshot::channel();
        let result = self.find_axis(axis).and_then(|(link, index)| {
            let (id, wire) = (axis, Arc::clone(&link.wire));
            let (worker, shared) = (Arc::clone(&link.request_worker), Arc::clone(&self.0.context));
            let changed = ChangedAxis { axis: wire.axes[index].1.clone(), wire, index };
            let detail = detail(&changed.axis);
            let who = session.clone();
            let go: Continuation = Box::new(move |may| {
                // The receiver may have been dropped, here and below.
                if let Err(refused) = may {
                    return drop(reply_sender.send(Err(refused)));
                }
                let (by, notes) = (who.clone(), Arc::clone(&shared));
                let then: Continuation = Box::new(move |recorded| match recorded {
                    Err(refused) => drop(reply_sender.send(Err(refused))),
                    Ok(()) => worker.submit_query(reply_sender, move || {
                        check_lease_held(&changed.wire, changed.index, epoch, &who)?;
                        let ended = work(&changed);
                        let detail = json!({ "error": ended.as_ref().err() });
                        shared.record(&who, JournalAction::Outcome, Some(id), detail);
                        ended
                    }),
                });
                let what = ActionSubject::new(&by, JournalAction::Parameters, Some(id));
                notes.journal.write_ahead(what, detail, notes.now(), then);
            });
            let session = session.clone();
            link.wire.submit(WireRequest::Write { axis: index, session, epoch, then: go })
        });
        PendingReply::from_receiver(reply, result)
    }
}
