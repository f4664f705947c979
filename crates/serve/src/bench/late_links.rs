//! Links that could not be opened at the start. They are retried, and their axes are added when they open.
//!
//! Why: GW-11.

use std::sync::{Arc, Weak};
use std::time::Duration;

use polepair::{Connector, Error};
use polepair_link::clock;
use serde_json::json;
use tokio::sync::oneshot;

use super::AXES_MAX;
use super::absent_axes;
use super::context::BenchEvent;
use super::journal_queue::ActionSubject;
use super::journal_sink::SERVER;
use super::lock::lock_unpoisoned;
use super::open::{BenchLink, tapped_connector};
use super::reply::Continuation;
use super::thread_error::thread_error;
use super::{Bench, BenchInner, PendingReply, REASON_MAX, SessionName};
use crate::message::{
    DismissAbsent, DismissReason, GatewayError, JournalAction, LinkView, UnreachedTarget,
};

/// Between two tries, at first and at last.
const RETRY_MIN: Duration = Duration::from_millis(100);
const RETRY_MAX: Duration = Duration::from_secs(2);

impl Bench {
    /// Tries a link again until it opens. The thread is never joined: an unresponsive host keeps it for seconds, and it
    /// holds nothing of the bench meanwhile.
    pub(super) fn spawn_link_opener(
        &self,
        id: u16,
        error: GatewayError,
        connector: &Connector,
    ) -> Result<(), GatewayError> {
        let n = usize::from(id);
        let url = self.0.links[n].url.clone();
        let detail = json!({ "link": id, "url": url, "open": false, "error": error });
        self.0.context.record(&SERVER.into(), JournalAction::Link, None, detail);
        tracing::debug!(link = id, %url, %error, "link is not open; trying again");
        let connector = tapped_connector(connector, &self.0.traffic, n);
        let bench = Arc::downgrade(&self.0);
        let named = std::thread::Builder::new().name("late-links".to_owned());
        let opens = named.spawn(move || retry_until_open(&bench, n, &connector, &url));
        opens.map(drop).map_err(|error| thread_error(&error))
    }

    /// Description of a link, with inherited pending stops of absent drives.
    pub(super) fn link_view(&self, link: &BenchLink) -> LinkView {
        let mut pending = self.0.context.inherited_stops_on(&link.url);
        pending.retain(|number| !link.has_axis(*number));
        LinkView { pending_stops: pending, ..link.view() }
    }

    /// Clears the inherited pending stop of an absent drive. The journal keeps the session and the reason.
    ///
    /// The reply is `E212` for a drive without one, and for a present drive: that is dismissed as an axis.
    pub fn dismiss_absent(
        &self,
        session: &SessionName,
        dismiss: DismissAbsent,
    ) -> PendingReply<()> {
        let (reply_sender, reply) = oneshot::channel();
        let shared = &self.0.context;
        let DismissAbsent { link: url, number, reason, note } = dismiss;
        let note: String = note.chars().take(REASON_MAX).collect();
        let is_there = self.0.links.iter().any(|link| link.url == url && link.has_axis(number));
        let result = if is_there {
            Err(GatewayError::new("E212", format!("axis {number} of {url} is there"))
                .hint("dismiss its stop by the number of the axis"))
        } else if reason == DismissReason::TakenOver {
            Err(GatewayError::new("gateway.lease", "a missing drive cannot be taken over"))
        } else if !shared.has_inherited_stop(&url, number) {
            Err(GatewayError::new("E212", format!("axis {number} of {url} has no pending stop")))
        } else {
            shared.journal.check_writable(shared.now())
        };
        if result.is_ok() {
            shared.remove_inherited_stop(&url, number);
            shared.publish(BenchEvent::BenchChanged);
            let detail = json!({ "how": "dismissed", "reason": reason, "note": note, "link": url,
                "number": number });
            let then: Continuation = Box::new(move |recorded| drop(reply_sender.send(recorded)));
            shared.journal.record(
                ActionSubject::new(session, JournalAction::StopEnded, None),
                detail,
                shared.now(),
                Some(then),
            );
        }
        PendingReply::from_receiver(reply, result)
    }

    /// Records the absent drives of a link with an inherited pending stop, and ends the host watch of the others.
    pub(super) fn close_link(&self, link: &BenchLink) {
        let pending = self.link_view(link).pending_stops.into_iter();
        pending.for_each(|n| self.0.context.add_not_standing(format!("axis {n} of {}", link.url)));
        link.wire.end_host_watch();
    }

    /// Links that are not open, whose axes are unknown, and absent axes of the others.
    pub(super) fn unreached(&self) -> Vec<UnreachedTarget> {
        let each = self.0.links.iter().flat_map(|link| {
            let why = link
                .wire
                .link_error()
                .filter(|_| !link.was_opened())
                .map(|(_, error)| (None, error));
            let absent = link.absent().into_iter().map(|axis| (Some(axis.number), axis.error));
            why.into_iter().chain(absent).map(|(number, error)| UnreachedTarget {
                link: link.id,
                url: link.url.clone(),
                number,
                error,
            })
        });
        each.collect()
    }

    /// Shows why a link is not open, when that is another reason than before.
    fn update_link_error(&self, n: usize, error: GatewayError) {
        let wire = &self.0.links[n].wire;
        let before = wire.link_error();
        if before.as_ref().is_some_and(|(_, before)| *before == error) {
            return;
        }
        let since = before.map_or_else(|| self.0.context.now(), |(since, _)| since);
        wire.set_link_error(Some((since, error)));
        self.0.context.publish(BenchEvent::BenchChanged);
    }

    /// Takes in a link that was opened, with its axes behind all others.
    fn add_opened_link(
        &self,
        n: usize,
        opened: &polepair::LocalLink,
        absent: Vec<(u32, Error)>,
    ) -> Result<(), GatewayError> {
        let (link, shared) = (&self.0.links[n], &self.0.context);
        let base = {
            let _one_at_a_time = lock_unpoisoned(&self.0.join_lock);
            let base = self.0.axes.len();
            if base + opened.axes().len() > AXES_MAX {
                let what = format!("its axes are too many: a bench holds {AXES_MAX}");
                return Err(
                    GatewayError::new("gateway.request", what).hint("serve it by another server")
                );
            }
            // All samples count from one moment.
            let _ = link.wire.time_origin.set(self.0.opened_at);
            link.set_opened_later(opened, absent);
            link.wire.set_link_error(None);
            for axis in opened.axes() {
                self.add_axis(n, axis);
            }
            base as u16
        };
        self.0.traffic.replace_decoder(n, link.decoder());
        // A stop of all axes meant these as well, and could not reach them.
        self.stop_if_locked(n, 0);
        let axes: Vec<u16> = link.wire.axes.iter().map(|(id, _)| *id).collect();
        let detail = json!({ "link": link.id, "url": link.url, "open": true, "axes": axes });
        shared.record(&SERVER.into(), JournalAction::Link, None, detail);
        tracing::info!(link = link.id, url = %link.url, ?axes, "link opened");
        shared.publish(BenchEvent::BenchChanged);
        self.listen_events(base, 0, opened)
    }
}

fn retry_until_open(bench: &Weak<BenchInner>, n: usize, connector: &Connector, url: &str) {
    let mut pause = RETRY_MIN;
    while open_bench(bench).is_some() {
        clock::sleep_until(clock::now() + pause);
        pause = (pause * 2).min(RETRY_MAX);
        let opened = connector.connect_present(url);
        let Some(bench) = open_bench(bench) else { return };
        let taken = match opened {
            Ok((opened, absent)) => bench.add_opened_link(n, &opened, absent),
            Err(error) => Err(error.into()),
        };
        match taken {
            Ok(()) => break,
            // The link is open, and only its unsolicited messages are lost.
            Err(error) if bench.0.links[n].was_opened() => {
                tracing::warn!(%error, "cannot listen for unsolicited messages");
                break;
            }
            Err(error) => bench.update_link_error(n, error),
        }
    }
    absent_axes::probe_until_joined(bench, n);
}

fn open_bench(bench: &Weak<BenchInner>) -> Option<Bench> {
    bench.upgrade().map(Bench).filter(|bench| !bench.0.context.is_closing())
}
