//! What is shown, whoever draws it: axes, frames, the link.

use std::collections::BTreeSet;
use std::time::Duration;

use polepair::axis::{Class, Stopping};
use polepair::listen::Listening;
use polepair::url::shell_word;
use polepair::wire::OpenWire;
use polepair::{Axis, Link};
use polepair_capture::{Event, Rule, Rules, Scope};
use polepair_core::proto;
use polepair_core::station::Counters;
use polepair_core::time::Instant;
use polepair_link::{LinkError, Losses, clock};

use super::axes::Watched;
use super::traffic::{Spoken, Traffic};
use crate::ears::Ears;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::Session;

/// How long a link that was lost may take to come back.
const LOST_MAX: Duration = Duration::from_secs(10);
/// How long a stop that has succeeded is told of.
const TOLD_MAX: Duration = Duration::from_secs(10);
/// How long leaving waits for stops that are under way.
const STOP_MAX: Duration = Duration::from_secs(2);

/// A link that is watched.
pub struct Monitor {
    /// How the user named it.
    pub url: String,
    /// The axes; none where it only listens.
    pub axes: Vec<Watched>,
    /// What passes.
    pub traffic: Traffic,
    /// Which axis is chosen.
    pub chosen: usize,
    session: Option<Session>,
    listening: Option<Listening>,
    ears: Ears,
    period: Duration,
    begun: Instant,
    lost: Option<(Instant, LinkError)>,
}

impl Monitor {
    /// A link whose axes are asked.
    pub fn commanding(
        link: Link,
        url: &str,
        rules: Option<Rules>,
        ears: Ears,
        period: Duration,
    ) -> Result<Self> {
        if link.axes().is_empty() {
            return Err(Problem::new(Exit::NoReply, "E402", format!("there is no axis on {url}.")));
        }
        let spoken = link.wires().iter().map(|wire| spoken(wire, link.axes(), rules.as_ref()));
        let traffic = Traffic::new(link.wires(), spoken.collect(), false);
        let axes = link.axes().iter().cloned().map(Watched::new).collect();
        let session = Session { link, words: url.to_owned() };
        session.listen();
        Ok(Self { axes, period, session: Some(session), ..Self::bare(url, traffic, ears) })
    }

    /// A link on which nothing is said.
    pub fn listening(heard: Listening, url: &str, rules: Option<Rules>, ears: Ears) -> Self {
        let spoken = heard.wires().iter().map(|wire| spoken(wire, &[], rules.as_ref()));
        let traffic = Traffic::new(heard.wires(), spoken.collect(), true);
        crate::interrupt::listen(|| {});
        Self { listening: Some(heard), ..Self::bare(url, traffic, ears) }
    }

    fn bare(url: &str, traffic: Traffic, ears: Ears) -> Self {
        Self {
            url: url.to_owned(),
            axes: Vec::new(),
            traffic,
            chosen: 0,
            session: None,
            listening: None,
            ears,
            period: Duration::MAX,
            begun: clock::now(),
            lost: None,
        }
        .since_now()
    }

    fn since_now(mut self) -> Self {
        self.begun = self.now();
        self
    }

    /// The present time of the link.
    pub fn now(&self) -> Instant {
        self.axes.first().map_or_else(clock::now, |watched| watched.axis.connection().now())
    }

    /// How long it has been watched.
    pub fn age(&self) -> Duration {
        self.now().since(self.begun)
    }

    /// When it was begun, in nanoseconds since 1970, as frames have it.
    pub fn began(&self) -> u64 {
        clock::wall_ns(self.begun)
    }

    /// How often each axis is asked.
    pub fn period(&self) -> Duration {
        self.period
    }

    /// The link whose axes are asked.
    #[cfg(test)]
    pub fn link(&self) -> Option<&Link> {
        self.session.as_ref().map(|session| &session.link)
    }

    /// Whether it only listens.
    pub fn is_listening(&self) -> bool {
        self.listening.is_some()
    }

    /// Asks what is to be asked, takes what came. Waits for nothing. True when an axis is asked anew.
    ///
    /// # Errors
    /// When the link is lost and does not come back.
    pub fn look(&mut self, show: &mut dyn FnMut(&Event<'_>)) -> Result<bool> {
        let mut anew = false;
        for (n, watched) in self.axes.iter_mut().enumerate() {
            anew |= watched.look(self.period, n == self.chosen);
            let stopping = watched.stopping.take();
            let told = |stop: &Stopping| !stop.is_over(&watched.axis, TOLD_MAX);
            watched.stopping = stopping.filter(told);
        }
        self.hear(show);
        self.traffic.pace(self.now());
        self.check_link().map(|()| anew)
    }

    /// Waits until everything that was asked is answered.
    pub fn settle(&mut self, show: &mut dyn FnMut(&Event<'_>)) {
        self.axes.iter_mut().for_each(Watched::settle);
        self.hear(show);
    }

    /// Lets time pass on the link.
    pub fn sleep(&self, span: Duration) {
        match &self.session {
            Some(session) => session.link.sleep(span),
            None => clock::sleep_until(clock::now() + span),
        }
    }

    fn hear(&mut self, show: &mut dyn FnMut(&Event<'_>)) {
        let (heard, lost) = self.ears.take();
        self.traffic.lost += lost;
        heard.iter().for_each(|heard| self.traffic.take(heard, show));
    }

    fn check_link(&mut self) -> Result<()> {
        if let Some(gone) = self.listening.as_mut().and_then(Listening::trouble) {
            return Err(outcome::link_error(&gone));
        }
        let now = clock::now();
        let trouble = self.axes.iter().find_map(|watched| watched.axis.connection().trouble());
        self.lost = trouble.map(|error| (self.lost.as_ref().map_or(now, |lost| lost.0), error));
        match &self.lost {
            Some((since, error)) if now.since(*since) > LOST_MAX => Err(outcome::link_error(error)),
            _ => Ok(()),
        }
    }

    /// Why the link is down, and since when.
    pub fn trouble(&self) -> Option<(Duration, &LinkError)> {
        self.lost.as_ref().map(|(since, error)| (clock::now().since(*since), error))
    }

    /// What the hosts of all wires counted; `None` where there is none.
    pub fn counters(&self) -> Option<Counters> {
        let session = self.session.as_ref()?;
        let counted = self.wires().map(|axis| session.link.counters(axis));
        Some(counted.fold(Counters::default(), Counters::plus))
    }

    /// What links noticed and could not hand on.
    pub fn losses(&self) -> Losses {
        let of_axes = self.wires().map(|axis| axis.connection().losses());
        let heard = self
            .listening
            .iter()
            .flat_map(|heard| (0..heard.wires().len()).map(|wire| heard.losses(wire)));
        of_axes.chain(heard).fold(Losses::default(), |sum, more| Losses {
            overrun: sum.overrun + more.overrun,
            malformed: sum.malformed + more.malformed,
            errors: sum.errors + more.errors,
            refused: sum.refused + more.refused,
        })
    }

    /// An axis of each wire.
    fn wires(&self) -> impl Iterator<Item = &Axis> {
        let mut known = BTreeSet::new();
        let axes = self.axes.iter().map(|watched| &watched.axis);
        axes.filter(move |axis| known.insert(axis.connection().describe()))
    }

    /// Stops every axis: all are told before the first is waited for.
    pub fn stop(&mut self) {
        self.axes.iter_mut().for_each(Watched::stop);
    }

    /// What a person who leaves must know: stops that are not confirmed, motors that turn.
    pub fn farewell(&mut self) -> Vec<String> {
        let mut said = Vec::new();
        for watched in &mut self.axes {
            let label = watched.axis.label();
            if let Some(stopping) = &mut watched.stopping {
                stopping.settle(&watched.axis, STOP_MAX);
                if let Class::Failed(why) = stopping.class() {
                    said.push(format!("{label} may not have stopped: {why}"));
                    continue;
                }
            }
            if watched.turns() {
                let speed = watched.shown(polepair_core::profile::Signal::Velocity);
                let speed = speed.map_or_else(String::new, |speed| format!(" at {speed}"));
                let url = shell_word(&self.url);
                said.push(format!(
                    "{label} turned{speed} when last asked and was left so; this stops it: \
                     polepair stop {url}"
                ));
            }
        }
        said
    }
}

/// How the frames of a wire are explained: each axis' frames by its own protocol, the others by any
/// of the wire's.
fn spoken(wire: &OpenWire, axes: &[Axis], stated: Option<&Rules>) -> Spoken {
    let own: Vec<&Axis> =
        axes.iter().filter(|axis| axis.connection().describe() == wire.name).collect();
    let profile = own.first().map(|axis| axis.profile());
    if let Some(rules) = stated {
        return Spoken { rules: rules.clone(), profile };
    }
    let mut rules = Vec::new();
    let mut add = |word: &str, scope| {
        let dissector = proto::dissector(word);
        rules.extend(dissector.map(|dissector| Rule { dissector, scope }));
    };
    if wire.protocols.len() > 1 {
        own.iter().for_each(|axis| add(axis.protocol(), Scope::Axis(axis.number())));
    }
    // An identifier that no protocol claims is of the one that claims fewest: its drives may have any.
    let mut words = wire.protocols.clone();
    words.sort_by_key(|word| claimed(word));
    words.iter().for_each(|word| add(word, Scope::Anywhere));
    Spoken { rules: Rules(rules), profile }
}

/// How many identifiers of 11 bits a protocol claims.
fn claimed(word: &str) -> usize {
    let dissector = proto::dissector(word);
    (0..0x800).filter(|id| dissector.is_some_and(|found| found.claims(*id, false))).count()
}
