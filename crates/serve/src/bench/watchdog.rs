//! The watchdog of a drive: read, and written like a parameter. It moves nothing, but it stops a turning
//! motor when the host is silent.

use std::time::Duration;

use polepair::LocalAxis;
use polepair::axis::WatchdogState;
use polepair::doctor::read_watchdog;
use serde_json::json;
use tokio::sync::oneshot;

use super::Bench;
use super::lease::SessionName;
use super::reply::PendingReply;
use crate::message::{GatewayError, SetWatchdog, WatchdogMode, WatchdogView};

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
        let SetWatchdog { after_ms, epoch } = wanted;
        let after = match after_ms.map(parse_duration).transpose() {
            Ok(after) => after.filter(|after| !after.is_zero()),
            Err(refused) => return PendingReply::ready(Err(refused)),
        };
        let detail = |its: &LocalAxis| {
            let name = its.watchdog_parameter().and_then(|id| its.parameter(id));
            json!({ "watchdog": name.map(|its| its.name), "after_ms": after_ms })
        };
        self.change_axis(axis, session, epoch, detail, move |changed| {
            let set = changed.axis.set_watchdog(after);
            changed.wire.set_host_watched(changed.index, false);
            Ok(watchdog_view(&changed.axis, set?))
        })
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
            WatchdogState::OtherNode { .. } | WatchdogState::LifeGuarding(_) => WatchdogMode::Other,
            WatchdogState::NoReaction(_) => WatchdogMode::NoReaction,
            WatchdogState::Unknown => WatchdogMode::Untold,
        },
        text: report.text,
        after_ms: report.after.map(|after| after.as_secs_f64() * 1e3),
        parameter: report.parameter,
        caution: report.caution,
    }
}
