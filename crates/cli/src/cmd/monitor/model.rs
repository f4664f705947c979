//! The data of the screen, independent of its drawing: axes, frames, link.

use std::collections::BTreeSet;
use std::time::Duration;

use polepair::axis::WireAirtime;
use polepair::listen::WireListener;
use polepair::url::shell_word;
use polepair::wire::OpenWire;
use polepair::{LocalAxis, LocalLink};
use polepair_capture::{DecodedFrame, Rule, RuleScope, Rules};
use polepair_core::proto;
use polepair_core::station::Counters;
use polepair_core::time::Instant;
use polepair_link::{LinkError, Losses, clock};

use super::monitored_axis::MonitoredAxis;
use super::traffic::{TrafficLog, WireDecoding};
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::LocalSession;
use crate::tap_queue::TapQueue;

/// Time limit of the return of a lost link.
const LOST_MAX: Duration = Duration::from_secs(10);
/// Time for which a confirmed stop is shown.
const STOP_SHOWN_MAX: Duration = Duration::from_secs(10);
/// Time limit of running stops at the end.
const STOP_MAX: Duration = Duration::from_secs(2);

/// A link that is watched.
pub struct Monitor {
    /// Connection string or name that the user gave.
    pub url: String,
    /// The axes; none where it only listens.
    pub axes: Vec<MonitoredAxis>,
    /// Log of the frames.
    pub traffic: TrafficLog,
    /// Index of the chosen axis.
    pub chosen: usize,
    session: Option<LocalSession>,
    listener: Option<WireListener>,
    tap_queue: TapQueue,
    period: Duration,
    started_at: Instant,
    lost: Option<(Instant, LinkError)>,
}

impl Monitor {
    /// A link whose axes are asked.
    pub fn with_link(
        link: LocalLink,
        url: &str,
        rules: Option<Rules>,
        taps: TapQueue,
        period: Duration,
    ) -> Result<Self> {
        if link.axes().is_empty() {
            return Err(Problem::new(Exit::NoReply, "E402", format!("there is no axis on {url}.")));
        }
        let protocols =
            link.wires().iter().map(|wire| wire_decoding(wire, link.axes(), rules.as_ref()));
        let traffic = TrafficLog::new(link.wires(), protocols.collect(), false);
        let axes = link.axes().iter().cloned().map(MonitoredAxis::new).collect();
        let session = LocalSession { link, arguments: url.to_owned() };
        session.listen_for_interrupts();
        Ok(Self { axes, period, session: Some(session), ..Self::unconnected(url, traffic, taps) })
    }

    /// Creates a monitor that only listens.
    pub fn with_listener(
        wire_listener: WireListener,
        url: &str,
        rules: Option<Rules>,
        taps: TapQueue,
    ) -> Self {
        let protocols =
            wire_listener.wires().iter().map(|wire| wire_decoding(wire, &[], rules.as_ref()));
        let traffic = TrafficLog::new(wire_listener.wires(), protocols.collect(), true);
        crate::interrupt::listen(|| {});
        Self { listener: Some(wire_listener), ..Self::unconnected(url, traffic, taps) }
    }

    fn unconnected(url: &str, traffic: TrafficLog, taps: TapQueue) -> Self {
        Self {
            url: url.to_owned(),
            axes: Vec::new(),
            traffic,
            chosen: 0,
            session: None,
            listener: None,
            tap_queue: taps,
            period: Duration::MAX,
            started_at: clock::now(),
            lost: None,
        }
        .started_now()
    }

    fn started_now(mut self) -> Self {
        self.started_at = self.now();
        self
    }

    /// The present time of the link.
    pub fn now(&self) -> Instant {
        self.axes.first().map_or_else(clock::now, |watched| watched.axis.connection().now())
    }

    /// Time since the monitor started.
    pub fn age(&self) -> Duration {
        self.now().since(self.started_at)
    }

    /// When it was begun, in nanoseconds since 1970, as frames have it.
    pub fn started_ns(&self) -> u64 {
        clock::wall_ns(self.started_at)
    }

    /// Interval of reading each axis.
    pub fn period(&self) -> Duration {
        self.period
    }

    /// The link whose axes are asked.
    #[cfg(test)]
    pub fn link(&self) -> Option<&LocalLink> {
        self.session.as_ref().map(|session| &session.link)
    }

    /// Returns whether it only listens.
    pub fn is_listening(&self) -> bool {
        self.listener.is_some()
    }

    /// Sends the due reads, and takes received frames. Waits for nothing. True when an axis is read anew.
    ///
    /// # Errors
    /// When the link is lost and does not come back.
    pub fn poll(&mut self, show: &mut dyn FnMut(&DecodedFrame<'_>)) -> Result<bool> {
        let mut anew = false;
        for (n, watched) in self.axes.iter_mut().enumerate() {
            anew |= watched.poll(self.period, n == self.chosen);
            let stopping = watched.stopping.take();
            watched.stopping = stopping.filter(|stop| !stop.is_expired(STOP_SHOWN_MAX));
        }
        self.process_received(show);
        self.traffic.update_rates(self.now());
        self.check_link().map(|()| anew)
    }

    /// Waits until everything that was asked is answered.
    pub fn wait_answers(&mut self, show: &mut dyn FnMut(&DecodedFrame<'_>)) {
        self.axes.iter_mut().for_each(MonitoredAxis::wait_answers);
        self.process_received(show);
    }

    /// Lets time pass on the link.
    pub fn sleep(&self, span: Duration) {
        match &self.session {
            Some(session) => session.link.sleep(span),
            None => clock::sleep_until(clock::now() + span),
        }
    }

    fn process_received(&mut self, show: &mut dyn FnMut(&DecodedFrame<'_>)) {
        let (received, lost) = self.tap_queue.drain();
        self.traffic.lost += lost;
        received.iter().for_each(|queued_unit| self.traffic.add_received(queued_unit, show));
    }

    fn check_link(&mut self) -> Result<()> {
        if let Some(gone) = self.listener.as_mut().and_then(WireListener::take_error) {
            return Err(outcome::link_problem(&gone));
        }
        let now = clock::now();
        let trouble = self.axes.iter().find_map(|watched| watched.axis.connection().link_error());
        self.lost = trouble.map(|error| (self.lost.as_ref().map_or(now, |lost| lost.0), error));
        match &self.lost {
            Some((since, error)) if now.since(*since) > LOST_MAX => {
                Err(outcome::link_problem(error))
            }
            _ => Ok(()),
        }
    }

    /// Duration and cause of the link's failure.
    pub fn trouble(&self) -> Option<(Duration, &LinkError)> {
        self.lost.as_ref().map(|(since, error)| (clock::now().since(*since), error))
    }

    /// Counters of the hosts of all wires; `None` without a host.
    pub fn counters(&self) -> Option<Counters> {
        let session = self.session.as_ref()?;
        let counted = self.axis_per_wire().map(|axis| session.link.counters(axis));
        Some(counted.fold(Counters::default(), Counters::plus))
    }

    /// Units that were received and could not be handed on.
    pub fn losses(&self) -> Losses {
        let of_axes = self.axis_per_wire().map(|axis| axis.connection().losses());
        let listener_losses = self.listener.iter().flat_map(|wire_listener| {
            (0..wire_listener.wires().len()).map(|wire| wire_listener.losses(wire))
        });
        of_axes.chain(listener_losses).fold(Losses::default(), |sum, more| Losses {
            overrun: sum.overrun + more.overrun,
            malformed: sum.malformed + more.malformed,
            errors: sum.errors + more.errors,
            refused: sum.refused + more.refused,
        })
    }

    /// An axis of each wire.
    fn axis_per_wire(&self) -> impl Iterator<Item = &LocalAxis> {
        let mut known = BTreeSet::new();
        let axes = self.axes.iter().map(|watched| &watched.axis);
        axes.filter(move |axis| known.insert(axis.connection().describe()))
    }

    /// Stops every axis: all stops are sent before the first is waited for.
    pub fn stop(&mut self) {
        self.axes.iter_mut().for_each(MonitoredAxis::stop);
    }

    /// Notes for a user who leaves: stops that are not confirmed, motors that turn.
    pub fn exit_notes(&mut self) -> Vec<String> {
        let mut lines = Vec::new();
        for watched in &mut self.axes {
            let label = watched.axis.label();
            if let Some(stopping) = &mut watched.stopping {
                let mut airtime = WireAirtime::default();
                stopping.give_up();
                while stopping.wait(&mut airtime, clock::scale_timeout(STOP_MAX)).is_some() {}
                let failed = match stopping.result() {
                    Some(ended) => ended.standstill.as_ref().err(),
                    None => stopping.failure(),
                };
                if let Some(why) = failed {
                    lines.push(format!("{label} may not have stopped: {why}"));
                    continue;
                }
            }
            if watched.is_turning() {
                let speed = watched.display_value(polepair_core::profile::Signal::Velocity);
                let speed = speed.map_or_else(String::new, |speed| format!(" at {speed}"));
                let url = shell_word(&self.url);
                lines.push(format!(
                    "{label} turned{speed} at the last reading and was not stopped; to stop it: \
                     polepair stop {url}"
                ));
            }
        }
        lines
    }
}

/// Decoding of the frames of a wire: each axis' frames by its own protocol, the others by any of the wire's.
fn wire_decoding(wire: &OpenWire, axes: &[LocalAxis], stated: Option<&Rules>) -> WireDecoding {
    let own: Vec<&LocalAxis> =
        axes.iter().filter(|axis| axis.connection().describe() == wire.name).collect();
    let drives =
        own.iter().map(|axis| (proto::drive_address(axis.number()), axis.profile())).collect();
    if let Some(rules) = stated {
        return WireDecoding { rules: rules.clone(), drives };
    }
    let mut rules = Vec::new();
    let mut add = |word: &str, scope| {
        let dissector = proto::find_dissector(word);
        rules.extend(dissector.map(|dissector| Rule { dissector, scope }));
    };
    if wire.protocols.len() > 1 {
        own.iter().for_each(|axis| add(axis.protocol(), RuleScope::Axis(axis.number())));
    }
    // An identifier that no protocol claims is of the one that claims fewest: its drives may have any.
    let mut words = wire.protocols.clone();
    words.sort_by_key(|word| claimed_count(word));
    words.iter().for_each(|word| add(word, RuleScope::Anywhere));
    WireDecoding { rules: Rules(rules), drives }
}

/// Number of identifiers of 11 bits that a protocol claims.
fn claimed_count(word: &str) -> usize {
    let dissector = proto::find_dissector(word);
    (0..0x800).filter(|id| dissector.is_some_and(|found| found.claims_id(*id, false))).count()
}
