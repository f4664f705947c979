//! Leases of the axes of one wire.

use super::super::journal_queue::ActionSubject;
use super::*;

impl CommandWorker {
    pub(super) fn handle_lease(&mut self, request: LeaseRequest) {
        let LeaseRequest { axis, session, action, epoch, reply } = request;
        let granted = match action {
            LeaseAction::Take | LeaseAction::TakeOver => {
                return self.acquire_lease(axis, &session, action == LeaseAction::TakeOver, reply);
            }
            LeaseAction::Renew => self.renew(axis, &session, epoch).map(Some),
            LeaseAction::Drop => {
                let given_back = self.axes[axis].lease.release(&session, epoch, self.context.now());
                given_back.map(|lost| {
                    lost.into_iter().for_each(|lost| self.end_lease(axis, lost, "given back"));
                    None
                })
            }
        };
        // The receiver may have been dropped, here and below.
        let _ = reply.send(granted);
    }

    pub(super) fn renew(
        &mut self,
        axis: usize,
        session: &SessionName,
        epoch: u64,
    ) -> Result<LeaseGrant, GatewayError> {
        let (now, lasts) = (self.context.now(), self.context.lease_duration);
        let watched = &mut self.axes[axis];
        let held = watched.lease.renew(session, epoch, now, lasts);
        let held = held.map_err(|refused| watched.lease_error(refused))?;
        self.publish_lease(axis);
        Ok(lease_grant(&held, now))
    }

    /// Grants a lease, and reports it once the journal has it: its epoch is never given again.
    pub(super) fn acquire_lease(
        &mut self,
        axis: usize,
        session: &SessionName,
        over: bool,
        reply_sender: ReplySender<Option<LeaseGrant>>,
    ) {
        let (now, lasts) = (self.context.now(), self.context.lease_duration);
        // A lease is a promise that a stop reaches the axis, so none is given for a link that is lost or
        // closing.
        let closes = self.context.is_closing() || self.lost;
        let may = if closes {
            Err(unavailable_error(self.lost))
        } else if self.wire.scan_flag.is_active() {
            let what = "a scan of this link is running";
            Err(scan_error(what).hint("wait for the end of the scan, or cancel it"))
        } else {
            // The journal must name the holder before a motor moves.
            self.context.journal.check_writable(now)
        };
        let slot = &mut self.axes[axis].lease;
        let before = slot.holder().map(|holder| holder.epoch);
        let (held, lost) = match may.and_then(|()| slot.acquire(session, over, now, lasts)) {
            Ok(taken) => taken,
            Err(refused) => return drop(reply_sender.send(Err(refused))),
        };
        debug_assert!(
            self.axes[axis].lease.holder().is_some(),
            "a lease that was given has a holder"
        );
        self.axes[axis].link_loss = None;
        let over = lost.is_some();
        lost.into_iter().for_each(|lost| self.end_lease(axis, lost, "taken over"));
        self.publish_lease(axis);
        // The same client asked again: nothing has changed that belongs into the journal.
        if before == Some(held.epoch) {
            return drop(reply_sender.send(Ok(Some(lease_grant(&held, now)))));
        }
        let (wire, epoch) = (Arc::clone(&self.wire), held.epoch);
        let (id, action) =
            (self.axes[axis].id, if over { JournalAction::TakeOver } else { JournalAction::Lease });
        let (what, detail) =
            (ActionSubject::new(session, action, Some(id)), json!({ "epoch": epoch }));
        self.context.journal.write_ahead(
            what,
            detail,
            now,
            Box::new(move |recorded: Result<(), GatewayError>| {
                if recorded.is_err() {
                    // Before all commands that wait: none of them may run under a lease that has no record.
                    wire.submit_first(0, WireRequest::LeaseNotRecorded { axis, epoch });
                }
                let _ = reply_sender.send(recorded.map(|()| Some(lease_grant(&held, now))));
            }),
        );
    }

    /// Revokes a lease that was granted and not reported.
    pub(super) fn revoke_unrecorded_lease(&mut self, axis: usize, epoch: u64) {
        let slot = &mut self.axes[axis].lease;
        // Another client may have taken the axis over since.
        let its = slot.holder().is_some_and(|holder| holder.epoch == epoch);
        if let Some(lost) = its.then(|| slot.end()).flatten() {
            self.end_lease(axis, lost, "the journal could not record it");
        }
    }
}
