//! Links that could not be opened at the start: they are tried again until they open, and then their
//! axes join as if they had been there.
//!
//! Why: GW-11.

use std::sync::{Arc, Weak};
use std::time::Duration;

use polepair::{Connector, Error};
use polepair_link::clock;
use serde_json::json;
use tokio::sync::oneshot;

use super::absent;
use super::open::{AXES_MAX, Link, tapped};
use super::shared::{Event, SERVER, held};
use super::threads::no_thread;
use super::wire::Go;
use super::{Bench, Inner, REASON_MAX, Reply, Session};
use crate::message::{Deed, DismissAbsent, DismissReason, LinkView, Refused, Unreached};

/// Between two tries, at first and at last.
const AGAIN_AFTER: Duration = Duration::from_millis(100);
const AGAIN_AFTER_MAX: Duration = Duration::from_secs(2);

impl Bench {
    /// Tries a link again until it opens. Nobody waits for the thread that does: a host that does not
    /// answer keeps it for seconds, and it holds nothing of the bench meanwhile.
    pub(super) fn open_later(
        &self,
        id: u16,
        error: Refused,
        connector: &Connector,
    ) -> Result<(), Refused> {
        let n = usize::from(id);
        let url = self.0.links[n].url.clone();
        let detail = json!({ "link": id, "url": url, "open": false, "error": error });
        self.0.shared.noted(&SERVER.into(), Deed::Link, None, detail);
        tracing::debug!(link = id, %url, %error, "a link is not open, and is tried again");
        let connector = tapped(connector, &self.0.traffic, n);
        let bench = Arc::downgrade(&self.0);
        let named = std::thread::Builder::new().name("bench-opens".to_owned());
        let opens = named.spawn(move || keep_trying(&bench, n, &connector, &url));
        opens.map(drop).map_err(|error| no_thread(&error))
    }

    /// What is told of a link, with what the server before owed drives that are not there.
    pub(super) fn link_view(&self, link: &Link) -> LinkView {
        let mut owed = self.0.shared.owed_before_on(&link.url);
        owed.retain(|number| !link.has(*number));
        LinkView { owed, ..link.told() }
    }

    /// Owes a drive that is not there its stop no more, which the server before owed it. The journal keeps
    /// who said so, and why.
    ///
    /// The reply is `E212` where that one is owed none, or is there: then it is dismissed as an axis.
    pub fn dismiss_absent(&self, session: &Session, dismiss: DismissAbsent) -> Reply<()> {
        let (tell, told) = oneshot::channel();
        let shared = &self.0.shared;
        let DismissAbsent { link: url, number, reason, note } = dismiss;
        let note: String = note.chars().take(REASON_MAX).collect();
        let is_there = self.0.links.iter().any(|link| link.url == url && link.has(number));
        let asked = if is_there {
            Err(Refused::new("E212", format!("axis {number} of {url} is there"))
                .hint("dismiss its stop as that of an axis"))
        } else if reason == DismissReason::TakenOver {
            Err(Refused::new("gateway.lease", "nobody can take over a drive that is not there"))
        } else if !shared.is_owed_before(&url, number) {
            Err(Refused::new("E212", format!("axis {number} of {url} is owed no stop")))
        } else {
            shared.notes.takes(shared.now())
        };
        if asked.is_ok() {
            shared.forget_owed_before(&url, number);
            shared.tell(Event::Bench);
            let detail = json!({ "how": "dismissed", "reason": reason, "note": note, "link": url,
                "number": number });
            let then: Go = Box::new(move |kept| drop(tell.send(kept)));
            shared.notes.done((session, Deed::StopEnded, None), detail, shared.now(), Some(then));
        }
        Reply::of(told, asked)
    }

    /// Names the drives of a link that the server before owed a stop and that are not there still, and
    /// ends what was set in the others for as long as this server speaks.
    pub(super) fn leave_link(&self, link: &Link) {
        let owed = self.link_view(link).owed.into_iter();
        owed.for_each(|n| self.0.shared.leaves(format!("axis {n} of {}", link.url)));
        link.wire.end_watch();
    }

    /// Links that are not open, whose axes nobody knows, and axes that are not there on the others.
    pub(super) fn unreached(&self) -> Vec<Unreached> {
        let each = self.0.links.iter().flat_map(|link| {
            let why =
                link.wire.lost().filter(|_| !link.was_opened()).map(|(_, error)| (None, error));
            let absent = link.absent().into_iter().map(|axis| (Some(axis.number), axis.error));
            why.into_iter().chain(absent).map(|(number, error)| Unreached {
                link: link.id,
                url: link.url.clone(),
                number,
                error,
            })
        });
        each.collect()
    }

    /// Shows why a link is not open, when that is another reason than before.
    fn show_why(&self, n: usize, error: Refused) {
        let wire = &self.0.links[n].wire;
        let before = wire.lost();
        if before.as_ref().is_some_and(|(_, before)| *before == error) {
            return;
        }
        let since = before.map_or_else(|| self.0.shared.now(), |(since, _)| since);
        wire.show_lost(Some((since, error)));
        self.0.shared.tell(Event::Bench);
    }

    /// Takes in a link that was opened, with its axes behind all others.
    fn take_link(
        &self,
        n: usize,
        opened: &polepair::Link,
        absent: Vec<(u32, Error)>,
    ) -> Result<(), Refused> {
        let (link, shared) = (&self.0.links[n], &self.0.shared);
        let base = {
            let _one_at_a_time = held(&self.0.growing);
            let base = self.0.axes.len();
            if base + opened.axes().len() > AXES_MAX {
                let what = format!("its axes are too many: a bench holds {AXES_MAX}");
                return Err(
                    Refused::new("gateway.request", what).hint("serve it by another server")
                );
            }
            // All samples count from one moment.
            let _ = link.wire.zero.set(self.0.opened);
            link.opened_later(opened, absent);
            link.wire.show_lost(None);
            for axis in opened.axes() {
                self.add(n, axis);
            }
            base as u16
        };
        self.0.traffic.explain_by(n, link.decoder());
        // Who stopped everything meant these as well, and could not reach them.
        self.stop_if_locked(n, 0);
        let axes: Vec<u16> = link.wire.axes.iter().map(|(id, _)| *id).collect();
        let detail = json!({ "link": link.id, "url": link.url, "open": true, "axes": axes });
        shared.noted(&SERVER.into(), Deed::Link, None, detail);
        tracing::info!(link = link.id, url = %link.url, ?axes, "a link is open after all");
        shared.tell(Event::Bench);
        self.hear(base, 0, opened)
    }
}

fn keep_trying(bench: &Weak<Inner>, n: usize, connector: &Connector, url: &str) {
    let mut pause = AGAIN_AFTER;
    let here = || bench.upgrade().map(Bench).filter(|bench| !bench.0.shared.is_closing());
    while here().is_some() {
        clock::sleep_until(clock::now() + pause);
        pause = (pause * 2).min(AGAIN_AFTER_MAX);
        let opened = connector.connect_present(url);
        let Some(bench) = here() else { return };
        let taken = match opened {
            Ok((opened, absent)) => bench.take_link(n, &opened, absent),
            Err(error) => Err(error.into()),
        };
        match taken {
            Ok(()) => break,
            // It is open, and only what it says by itself is not heard.
            Err(error) if bench.0.links[n].was_opened() => {
                tracing::warn!(%error, "what drives send unasked is not heard");
                break;
            }
            Err(error) => bench.show_why(n, error),
        }
    }
    absent::keep_asking(bench, n);
}
