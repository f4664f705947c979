//! Source of a monitor on a link of this program: it polls the axes, or only listens.

use std::collections::BTreeSet;
use std::time::Duration;

use polepair::listen::WireListener;
use polepair::url::{shell_word, without_axes};
use polepair::wire::OpenWire;
use polepair::{LocalAxis, LocalLink};
use polepair_capture::{Rule, RuleScope, Rules};
use polepair_core::proto;
use polepair_core::station::Counters;
use polepair_core::time::Instant;
use polepair_link::{LinkError, Losses, clock};

use super::model::Monitor;
use super::monitored_axis::MonitoredAxis;
use super::source::{AxisRow, FrameSink, MonitorSource, ShownFrame, SourceStatus};
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

/// Polling of the axes of a link.
#[derive(Clone, Copy)]
pub struct Polling {
    /// Interval of reading each axis.
    pub period: Duration,
    /// True if a round of values waits for the slowest axis, as lines need it. A screen must not wait.
    pub completes_rounds: bool,
}

/// A link of this program.
pub struct LocalSource {
    /// Connection string or name that the user gave.
    url: String,
    /// The axes; none if the source only listens.
    pub axes: Vec<MonitoredAxis>,
    session: Option<LocalSession>,
    listener: Option<WireListener>,
    tap_queue: TapQueue,
    polling: Polling,
    lost: Option<(Instant, LinkError)>,
}

impl Monitor<LocalSource> {
    /// A monitor that polls the axes of a link.
    ///
    /// # Errors
    /// `E402` for a link without an axis.
    pub fn with_link(
        link: LocalLink,
        url: &str,
        rules: Option<Rules>,
        taps: TapQueue,
        polling: Polling,
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
        let source = LocalSource {
            url: url.to_owned(),
            axes,
            session: Some(session),
            listener: None,
            tap_queue: taps,
            polling,
            lost: None,
        };
        Ok(Self::new(source, url, traffic))
    }

    /// A monitor that only listens.
    pub fn with_listener(
        listener: WireListener,
        url: &str,
        rules: Option<Rules>,
        taps: TapQueue,
    ) -> Self {
        let protocols =
            listener.wires().iter().map(|wire| wire_decoding(wire, &[], rules.as_ref()));
        let traffic = TrafficLog::new(listener.wires(), protocols.collect(), true);
        crate::interrupt::listen(|| {});
        let source = LocalSource {
            url: url.to_owned(),
            axes: Vec::new(),
            session: None,
            listener: Some(listener),
            tap_queue: taps,
            polling: Polling { period: Duration::MAX, completes_rounds: false },
            lost: None,
        };
        Self::new(source, url, traffic)
    }
}

impl MonitorSource for LocalSource {
    fn now(&self) -> Instant {
        self.axes.first().map_or_else(clock::now, |watched| watched.axis.connection().now())
    }

    fn sleep(&self, span: Duration) {
        match &self.session {
            Some(session) => session.link.sleep(span),
            None => clock::sleep_until(clock::now() + span),
        }
    }

    fn poll(
        &mut self,
        chosen: usize,
        traffic: &mut TrafficLog,
        show: &mut FrameSink<'_>,
    ) -> Result<bool> {
        let mut round = false;
        for (n, watched) in self.axes.iter_mut().enumerate() {
            round |= watched.poll(self.polling.period, n == chosen);
            let stopping = watched.stopping.take();
            watched.stopping = stopping.filter(|stop| !stop.is_expired(STOP_SHOWN_MAX));
        }
        if round && self.polling.completes_rounds {
            self.wait_answers();
        }
        let (received, lost) = self.tap_queue.drain();
        traffic.lost += lost;
        for unit in &received {
            traffic.add_received(unit, &mut |event| show(ShownFrame::Decoded(event)));
        }
        self.check_link().map(|()| round)
    }

    fn axes(&self) -> Vec<AxisRow> {
        self.axes.iter().map(MonitoredAxis::row).collect()
    }

    fn status(&self) -> SourceStatus {
        let losses = self.losses();
        let counters = self.counters().unwrap_or_default();
        let is_listen_only = self.listener.is_some();
        let link = shell_word(without_axes(&self.url));
        SourceStatus {
            is_listen_only,
            trouble: self.lost.as_ref().map(|(since, error)| {
                let seconds = clock::now().since(*since).as_secs();
                format!("LINK DOWN for {seconds} s: {error}. Trying to open it again.")
            }),
            lock: None,
            links: Vec::new(),
            flaws: vec![
                (counters.silent, "silent"),
                (counters.resent, "resent"),
                (counters.late, "late"),
                (counters.foreign, "foreign"),
                (counters.corrupt, "corrupt"),
                (losses.errors, "bus errors"),
            ],
            lost: losses.overrun + losses.malformed,
            stop_problem: is_listen_only
                .then(|| format!("NOT STOPPED: this view only listens; polepair stop {link}")),
        }
    }

    fn stop(&mut self) {
        // All stops are sent before the first is waited for.
        self.axes.iter_mut().for_each(MonitoredAxis::stop);
    }

    fn exit_notes(&mut self) -> Vec<String> {
        let within = clock::scale_timeout(STOP_MAX);
        let notes = self.axes.iter_mut().filter_map(|watched| watched.exit_note(&self.url, within));
        notes.collect()
    }
}

impl LocalSource {
    /// The link whose axes are polled.
    #[cfg(test)]
    pub fn link(&self) -> Option<&LocalLink> {
        self.session.as_ref().map(|session| &session.link)
    }

    /// Waits until everything that was asked is answered.
    pub fn wait_answers(&mut self) {
        self.axes.iter_mut().for_each(MonitoredAxis::wait_answers);
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

    /// Counters of the hosts of all wires; `None` without a host.
    fn counters(&self) -> Option<Counters> {
        let session = self.session.as_ref()?;
        let counted = self.axis_per_wire().map(|axis| session.link.counters(axis));
        Some(counted.fold(Counters::default(), Counters::plus))
    }

    /// Units that were received and could not be handed on.
    fn losses(&self) -> Losses {
        let of_axes = self.axis_per_wire().map(|axis| axis.connection().losses());
        let of_listener = self
            .listener
            .iter()
            .flat_map(|listener| (0..listener.wires().len()).map(|wire| listener.losses(wire)));
        of_axes.chain(of_listener).fold(Losses::default(), |sum, more| Losses {
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
