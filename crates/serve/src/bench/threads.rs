//! Who looks after a bench: a thread each, or in virtual time whoever lets it pass.

use std::sync::{Arc, Mutex};

use polepair::events::Events;

use super::ears::Ears;
use super::eyes::Eyes;
use super::frames::Reader;
use super::hand::Hand;
use super::notes::Scribe;
use super::open::Link;
use super::shared::held;
use super::{Bench, Inner};
use crate::message::Refused;

impl Bench {
    /// Gives everything that looks after a link a thread.
    pub(super) fn start(
        &self,
        roots: Vec<(u16, polepair::Link)>,
        scribe: Scribe,
    ) -> Result<(), Refused> {
        let named = |what: &str| std::thread::Builder::new().name(format!("bench-{what}"));
        let writes = named("scribe").spawn(move || scribe.run());
        *held(&self.0.scribe) = Some(writes.map_err(|error| no_thread(&error))?);
        let mut threads = held(&self.0.threads);
        for link in &self.0.links {
            let (hand, eyes) = (Arc::new(Mutex::new(self.hand(link))), self.eyes(link));
            let lent = Arc::downgrade(&hand);
            let started = named("hand").spawn(move || Hand::run(&hand));
            let started = started.map_err(|error| no_thread(&error))?;
            link.wire.looked_after_by(started.thread().clone(), lent);
            threads.push(started);
            let watches = named("eyes").spawn(move || eyes.run());
            threads.push(watches.map_err(|error| no_thread(&error))?);
        }
        let reader = self.reader();
        let reads = named("frames").spawn(move || reader.run());
        threads.push(reads.map_err(|error| no_thread(&error))?);
        drop(threads);
        roots.into_iter().try_for_each(|(base, link)| self.hear(base, 0, &link))
    }

    /// Hears what the axes of an opened connection string send, from that place on; the bench's number
    /// of the first of them is `base`.
    pub(super) fn hear(
        &self,
        base: u16,
        first: usize,
        link: &polepair::Link,
    ) -> Result<(), Refused> {
        let hears = self.listener(base, first, link);
        if !self.0.shared.clock.is_real() {
            held(&self.0.ears).push(hears(link.events_from(first)?));
            return Ok(());
        }
        let link = link.clone();
        let named = std::thread::Builder::new().name("bench-ears".to_owned());
        // To listen, drives are asked first what they send; nobody waits for that.
        let listens = named.spawn(move || match link.events_from(first) {
            Ok(events) => hears(events).run(),
            Err(error) => tracing::warn!(%error, "what drives send unasked is not heard"),
        });
        held(&self.0.threads).push(listens.map_err(|error| no_thread(&error))?);
        Ok(())
    }

    /// Keeps what looks after the links, for [`pass`](Self::pass).
    pub(super) fn look_after(
        &self,
        roots: &[(u16, polepair::Link)],
        scribe: Scribe,
    ) -> Result<(), Refused> {
        let mut by_hand = held(&self.0.by_hand);
        by_hand.scribe = Some(scribe);
        for link in &self.0.links {
            let hand = Arc::new(Mutex::new(self.hand(link)));
            link.wire.looked_after_by(std::thread::current(), Arc::downgrade(&hand));
            by_hand.hands.push(hand);
        }
        drop(by_hand);
        let mut waiting = held(&self.0.waiting);
        waiting.eyes.extend(self.0.links.iter().map(|link| self.eyes(link)));
        waiting.reader = Some(self.reader());
        drop(waiting);
        roots.iter().try_for_each(|(base, link)| self.hear(*base, 0, link))
    }

    fn hand(&self, link: &Link) -> Hand {
        let (wire, desk) = (Arc::clone(&link.wire), Arc::clone(&link.desk));
        Hand::new(wire, desk, Arc::clone(&self.0.shared), link.url.clone())
    }

    fn eyes(&self, link: &Link) -> Eyes {
        Eyes::new(link, &self.0.shared, &self.0.telemetry)
    }

    /// What explains frames.
    fn reader(&self) -> Reader {
        let Inner { links, traffic, shared, .. } = &*self.0;
        let decoders = links.iter().map(Link::decoder).collect();
        let wires = links.iter().map(|link| Arc::clone(&link.wire)).collect();
        let (traffic, shared) = (Arc::clone(traffic), Arc::clone(shared));
        Reader { traffic, shared, decoders, wires, count: 0 }
    }

    /// What hears axes of an opened connection string, once it has their events.
    fn listener(
        &self,
        base: u16,
        first: usize,
        link: &polepair::Link,
    ) -> impl FnOnce(Events) -> Ears + Send + 'static {
        let count = link.axes().len() - first;
        let seats = self.0.axes.iter().skip(usize::from(base)).take(count);
        let wires: Vec<_> = seats.map(|seat| self.0.links[seat.link].wire.clone()).collect();
        let zeros = wires.iter().map(|wire| wire.zero()).collect();
        let (telemetry, shared) = (self.0.telemetry.clone(), self.0.shared.clone());
        move |events| Ears { events, base, first, zeros, wires, telemetry, shared, lost: 0 }
    }
}

pub(super) fn no_thread(error: &std::io::Error) -> Refused {
    Refused::new("gateway.busy", format!("no thread can be started: {error}"))
}
