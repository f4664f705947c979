//! The watchdog of a drive: read, and written like a parameter. It moves nothing, but it stops a turning
//! motor when the host is silent.

use std::sync::Arc;
use std::time::Duration;

use polepair::LocalAxis;
use polepair::axis::WatchdogState;
use polepair::doctor::read_watchdog;
use serde_json::json;
use tokio::sync::oneshot;

use super::Bench;
use super::journal_queue::ActionSubject;
use super::lease::SessionName;
use super::parameters::check_lease_held;
use super::reply::Continuation;
use super::reply::PendingReply;
use super::wire::WireRequest;
use crate::message::{GatewayError, JournalAction, SetWatchdog, WatchdogMode, WatchdogView};

impl Bench {
    /// Reads how an axis' own watchdog is set now.
    pub fn watchdog(&self, axis: u16) -> PendingReply<WatchdogView> {
        let (reply_sender, reply) = oneshot::channel();
        let result = self.find_axis(axis).map(|(link, index)| {
            let axis = link.wire.axes[index].1.clone();
            link.request_worker.submit_query(reply_sender, move || {
                Ok(watchdog_view(&axis, read_watchdog(&axis)?))
            });
        });
        PendingReply::from_receiver(reply, result)
    }

    /// Sets it under a lease, once the journal keeps that, and reads how it is set then.
    pub fn set_watchdog(
        &self,
        axis: u16,
        session: &SessionName,
        wanted: SetWatchdog,
    ) -> PendingReply<WatchdogView> {
        let (reply_sender, reply) = oneshot::channel();
        let result = self.find_axis(axis).and_then(|(link, index)| {
            let SetWatchdog { after_ms, epoch } = wanted;
            let after = after_ms.map(parse_duration).transpose()?.filter(|after| !after.is_zero());
            let (id, wire) = (axis, Arc::clone(&link.wire));
            let (worker, shared) = (Arc::clone(&link.request_worker), Arc::clone(&self.0.context));
            let (its, who) = (wire.axes[index].1.clone(), session.clone());
            let go: Continuation = Box::new(move |may| {
                // The receiver may have been dropped, here and below.
                if let Err(refused) = may {
                    return drop(reply_sender.send(Err(refused)));
                }
                let name = its.watchdog_parameter().and_then(|id| its.parameter(id));
                let detail = json!({ "watchdog": name.map(|its| its.name), "after_ms": after_ms });
                let (by, notes) = (who.clone(), Arc::clone(&shared));
                let then: Continuation = Box::new(move |recorded| match recorded {
                    Err(refused) => drop(reply_sender.send(Err(refused))),
                    Ok(()) => worker.submit_query(reply_sender, move || {
                        check_lease_held(&wire, index, epoch, &who)?;
                        let set = its.set_watchdog(after).map_err(GatewayError::from);
                        wire.set_host_watched(index, false);
                        let detail = json!({ "error": set.as_ref().err() });
                        shared.record(&who, JournalAction::Outcome, Some(id), detail);
                        Ok(watchdog_view(&its, set?))
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

fn parse_duration(ms: f64) -> Result<Duration, GatewayError> {
    Duration::try_from_secs_f64(ms / 1e3).map_err(|_| no_time(ms))
}

fn no_time(ms: f64) -> GatewayError {
    GatewayError::new("E217", format!("{ms} ms is no time"))
}

fn watchdog_view(axis: &LocalAxis, state: WatchdogState) -> WatchdogView {
    let report = axis.report_watchdog(state);
    WatchdogView {
        rule: axis.watchdog_rule(),
        set: match state {
            WatchdogState::None => WatchdogMode::None,
            WatchdogState::Off => WatchdogMode::Off,
            WatchdogState::On(_) => WatchdogMode::On,
            WatchdogState::OtherNode { .. } => WatchdogMode::Other,
            WatchdogState::NoReaction(_) => WatchdogMode::NoReaction,
            WatchdogState::Unknown => WatchdogMode::Untold,
        },
        text: report.text,
        after_ms: report.after.map(|after| after.as_secs_f64() * 1e3),
        parameter: report.parameter,
        caution: report.caution,
    }
}
