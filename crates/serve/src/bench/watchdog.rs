//! The drive's own watchdog: read, and set as parameters are written. Nothing moves by it; a motor that
//! turns is stopped by it once nobody speaks.

use std::sync::Arc;
use std::time::Duration;

use polepair::Axis;
use polepair::axis::WatchdogState;
use serde_json::json;
use tokio::sync::oneshot;

use super::Bench;
use super::lease::Session;
use super::parameters::still_holds;
use super::reply::Reply;
use super::wire::{Go, Order};
use crate::message::{Deed, Refused, SetWatchdog, WatchdogSet, WatchdogTold};

impl Bench {
    /// Reads how an axis' own watchdog is set now.
    pub fn watchdog(&self, axis: u16) -> Reply<WatchdogTold> {
        let (tell, told) = oneshot::channel();
        let asked = self.seat(axis).map(|(link, place)| {
            let axis = link.wire.axes[place].1.clone();
            link.desk.ask(tell, move || Ok(shown(&axis, axis.watchdog()?)));
        });
        Reply::of(told, asked)
    }

    /// Sets it under a lease, once the journal keeps that, and reads how it is set then.
    pub fn set_watchdog(
        &self,
        axis: u16,
        session: &Session,
        wanted: SetWatchdog,
    ) -> Reply<WatchdogTold> {
        let (tell, told) = oneshot::channel();
        let asked = self.seat(axis).and_then(|(link, place)| {
            let SetWatchdog { after_ms, epoch } = wanted;
            let after = after_ms.map(span).transpose()?.filter(|after| !after.is_zero());
            let (id, wire) = (axis, Arc::clone(&link.wire));
            let (desk, shared) = (Arc::clone(&link.desk), Arc::clone(&self.0.shared));
            let (its, who) = (wire.axes[place].1.clone(), session.clone());
            let go: Go = Box::new(move |may| {
                // Who has gone does not want to know, here and below.
                if let Err(refused) = may {
                    return drop(tell.send(Err(refused)));
                }
                let name = its.watchdog_parameter().and_then(|id| its.profile().parameter(id));
                let detail = json!({ "watchdog": name.map(|its| its.name), "after_ms": after_ms });
                let (by, notes) = (who.clone(), Arc::clone(&shared));
                let then: Go = Box::new(move |kept| match kept {
                    Err(refused) => drop(tell.send(Err(refused))),
                    Ok(()) => desk.ask(tell, move || {
                        still_holds(&wire, place, epoch, &who)?;
                        let set = its.set_watchdog(after).map_err(Refused::from);
                        wire.note_watch(place, false);
                        let detail = json!({ "error": set.as_ref().err() });
                        shared.noted(&who, Deed::Outcome, Some(id), detail);
                        Ok(shown(&its, set?))
                    }),
                });
                let what = (&by, Deed::Parameters, Some(id));
                notes.notes.announce(what, detail, notes.now(), then);
            });
            let session = session.clone();
            link.wire.order(Order::Write { axis: place, session, epoch, go })
        });
        Reply::of(told, asked)
    }
}

fn span(ms: f64) -> Result<Duration, Refused> {
    let wrong = || Refused::new("E217", format!("{ms} ms is no time"));
    Duration::try_from_secs_f64(ms / 1e3).map_err(|_| wrong())
}

fn shown(axis: &Axis, state: WatchdogState) -> WatchdogTold {
    let parameter = axis.watchdog_parameter().and_then(|id| axis.profile().parameter(id));
    WatchdogTold {
        rule: axis.watchdog_rule(),
        set: match state {
            WatchdogState::None => WatchdogSet::None,
            WatchdogState::Off => WatchdogSet::Off,
            WatchdogState::On(_) => WatchdogSet::On,
            WatchdogState::Other { .. } => WatchdogSet::Other,
            WatchdogState::NoReaction(_) => WatchdogSet::NoReaction,
            WatchdogState::Untold => WatchdogSet::Untold,
        },
        text: axis.watchdog_in_words(state),
        after_ms: state.after().map(|after| after.as_secs_f64() * 1e3),
        parameter: parameter.map(|parameter| parameter.name.to_owned()),
        caution: axis.watchdog_caution(false).unwrap_or_default(),
    }
}
