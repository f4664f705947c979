//! Commands: checked, recorded in the journal, passed to the worker of their wire.

use super::command_worker::scaled_ttl_ms;
use super::journal_queue::ActionSubject;
use super::*;

impl Bench {
    /// Has an axis do something, once, if the session's lease, the lock, the arming, the limits and the
    /// command's age let it.
    pub fn command(
        &self,
        axis: u16,
        session: &SessionName,
        request: CommandRequest,
    ) -> PendingReply<CommandOutcome> {
        let CommandRequest { id, verb, arguments, .. } = &request;
        let detail = json!({ "id": id, "verb": verb, "arguments": arguments });
        let CommandRequest { issued_ms, ttl_ms, epoch, .. } = request;
        let header = CommandHeader { id: id.clone(), issued_ms, ttl_ms, epoch };
        self.submit_command(axis, session, header, detail, parse_action(&request))
    }

    /// Sends a request in the protocol's own text, for which no limits stand: once, under a lease and
    /// while motion is not locked, because it may move the motor.
    pub fn raw(
        &self,
        axis: u16,
        session: &SessionName,
        request: RawRequest,
    ) -> PendingReply<CommandOutcome> {
        let RawRequest { id, issued_ms, ttl_ms, epoch, text } = request;
        let detail = json!({ "id": id, "raw": text });
        let header = CommandHeader { id, issued_ms, ttl_ms, epoch };
        self.submit_command(axis, session, header, detail, Ok(CommandAction::Raw(text)))
    }

    /// Announces a command, and gives the order once that is kept. What ends motion waits for nothing.
    pub(super) fn submit_command(
        &self,
        axis: u16,
        session: &SessionName,
        order: CommandHeader,
        detail: serde_json::Value,
        action: Result<CommandAction, GatewayError>,
    ) -> PendingReply<CommandOutcome> {
        let id = order.id.clone();
        let ends_motion = action.as_ref().is_ok_and(CommandAction::ends_motion);
        // A stop is never answered from the history: sent twice does no harm, not sent at all does.
        let key = (!ends_motion).then(|| CommandKey::new(session, axis, &detail));
        let (wire, index, sequence) = match self.register_command(axis, &order, key) {
            Ok((CommandLookup::New, wire, index, sequence)) => (Arc::clone(wire), index, sequence),
            Ok((CommandLookup::Finished(outcome), ..)) => return PendingReply::ready(Ok(outcome)),
            Ok((CommandLookup::Active(receiver), ..)) => {
                return PendingReply::from_receiver(receiver, Ok(()));
            }
            Err(error) => return refused_reply(error, id),
        };
        let (reply_sender, receiver) = oneshot::channel();
        let (shared, session) = (Arc::clone(&self.0.context), session.clone());
        let now = shared.now();
        let go = {
            let (shared, session) = (Arc::clone(&shared), session.clone());
            move |recorded: Result<(), GatewayError>| match (recorded, action) {
                (Ok(()), Ok(action)) => {
                    let prepared = None;
                    let commanded = QueuedCommand {
                        axis: index,
                        session,
                        header: order,
                        action,
                        prepared,
                        reply: reply_sender,
                    };
                    wire.submit_reserved(sequence, WireRequest::Command(Box::new(commanded)));
                }
                (Ok(()), Err(error)) => {
                    let outcome = command_outcome(order.id, Some(error));
                    shared.report_outcome((&session, axis), outcome, false, reply_sender);
                }
                (Err(error), _) => {
                    // Nothing was sent, and nothing will be: a repetition gets the same reply.
                    let outcome = command_outcome(order.id, Some(error));
                    shared.lock_history().finish(&outcome);
                    // The receiver may have been dropped.
                    let _ = reply_sender.send(Ok(outcome));
                }
            }
        };
        let what = ActionSubject::new(&session, JournalAction::Command, Some(axis));
        // A command that ends a motion does not wait for a disk.
        if ends_motion {
            shared.journal.record(what, detail, now, None);
            go(Ok(()));
        } else {
            shared.journal.write_ahead(what, detail, now, Box::new(go));
        }
        PendingReply::from_receiver(receiver, Ok(()))
    }

    /// Looks a command up, and gives a new one its number on the wire. Commands that end motion have no key: they are
    /// always new.
    fn register_command(
        &self,
        axis: u16,
        header: &CommandHeader,
        key: Option<CommandKey>,
    ) -> Result<(CommandLookup, &Arc<BenchWire>, usize, u64), GatewayError> {
        let (link, index) = self.find_axis(axis)?;
        let CommandHeader { id, issued_ms, ttl_ms, .. } = header;
        if !issued_ms.is_finite() || !(0.0..=TTL_MAX_MS).contains(ttl_ms) {
            let what = format!("a command is valid for 0 to {TTL_MAX_MS} ms");
            return Err(GatewayError::new("gateway.request", what));
        }
        // Before the journal is written: a stop that is asked meanwhile has a higher number and voids this
        // command.
        let sequence = link.wire.reserve_number()?;
        let now = self.0.context.now();
        // With any advance of its clock, within the limit.
        let stale = now + Duration::from_secs_f64((scaled_ttl_ms(*ttl_ms) + 1000.0) / 1e3);
        let lookup = match key {
            Some(key) => self.0.context.lock_history().register(id, key, stale, now)?,
            None => CommandLookup::New,
        };
        Ok((lookup, &link.wire, index, sequence))
    }

    /// Writes a journal entry for what no command worker does, and does it once the entry is written.
    pub(super) fn run_after_journal<T: Send + 'static>(
        &self,
        what: ActionSubject<'_>,
        detail: serde_json::Value,
        then: impl FnOnce() -> Result<T, GatewayError> + Send + 'static,
    ) -> PendingReply<T> {
        let (reply_sender, reply) = oneshot::channel();
        let BenchContext { journal, .. } = &*self.0.context;
        journal.write_ahead(
            what,
            detail,
            self.0.context.now(),
            Box::new(move |recorded: Result<(), GatewayError>| {
                // The receiver may have been dropped.
                let _ = reply_sender.send(recorded.and_then(|()| then()));
            }),
        );
        PendingReply::from_receiver(reply, Ok(()))
    }

    /// Writes a record that concerns no link. The reply comes when it is written.
    pub fn write_journal(
        &self,
        who: &str,
        action: JournalAction,
        detail: serde_json::Value,
    ) -> PendingReply<()> {
        self.run_after_journal(ActionSubject::new(&who.into(), action, None), detail, || Ok(()))
    }
}

fn refused_reply(error: GatewayError, id: String) -> PendingReply<CommandOutcome> {
    PendingReply::ready(Ok(command_outcome(id, Some(error))))
}
