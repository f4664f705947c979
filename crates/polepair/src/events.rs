//! What happens on a link though nobody asked: values that drives send by themselves, faults,
//! restarts, a cable that was pulled.
//!
//! ```
//! # if polepair_core::drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! use std::time::Duration;
//! let link = polepair::connect("sim:tmcl?time=virtual")?;
//! let events = link.events()?;
//! link.axis(1)?.arm(true);
//! let event = events.next(Duration::from_secs(1)).expect("it was armed");
//! assert_eq!(event.to_string(), "axis 1: armed");
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```
//!
//! While somebody listens, the link is read though nobody waits for an answer. What answers a
//! question of this program is no event, but a fault that it shows is one.

use crate::axis::Axis;
use crate::connect::Link;
use crate::error::{Error, Exit};
use crate::simulate::{Pace, Simulation};
use crate::url::Number;
use polepair_core::axis::{Change, News, Presence, Reading};
use polepair_core::profile::{Fault, ParameterId, Signal};
use polepair_core::time::Instant;
use polepair_core::units::Unit;
use polepair_link::{LinkError, Listening, Mailbox, Notice, clock};
use std::fmt;
use std::task;
use std::time::Duration;

/// Events that wait for a listener at most; then the oldest go, and [`Events::lost`] counts them.
pub const EVENTS_MAX: usize = 8192;
/// How far virtual time goes between two looks.
const STEP: Duration = Duration::from_millis(1);

/// One thing that happened.
#[derive(Clone, PartialEq, Debug)]
pub struct Event {
    /// When it arrived, on the link's clock; where it was found out otherwise, when that was.
    pub at: Instant,
    /// The number of the axis; `None` for what happened to the link.
    pub axis: Option<u32>,
    /// The axis' place in [`Link::axes`], the wire's in [`Link::wires`] where there is no axis.
    pub place: usize,
    /// What happened.
    pub kind: Kind,
}

/// What happened.
#[derive(Clone, PartialEq, Debug)]
#[non_exhaustive]
pub enum Kind {
    /// The drive sent a signal's value: of a flag or a code, when it changed.
    Signal {
        /// Which signal.
        signal: Signal,
        /// Its value in SI, as the machine has it.
        reading: Reading,
    },
    /// The drive sent the value of a parameter that no signal tells.
    Parameter {
        /// Which parameter of the axis' profile.
        parameter: ParameterId,
        /// As it lies in the drive.
        raw: i64,
        /// In `unit`; NaN while a parameter that the scale depends on was never read.
        value: f64,
        /// The unit in which the axis shows it.
        unit: Unit,
    },
    /// The drive now has a fault.
    FaultAppeared {
        /// The drive's code, or the bit of its fault word.
        code: u32,
        /// Its name, cause and remedy, where the profile knows it.
        fault: Option<&'static Fault>,
    },
    /// The drive has a fault no more.
    FaultCleared {
        /// As in [`FaultAppeared`](Self::FaultAppeared).
        code: u32,
        /// The same.
        fault: Option<&'static Fault>,
    },
    /// How the drive takes part in its network from now on. One that restarted or is gone is
    /// disarmed.
    Presence(Presence),
    /// Motion commands are let through from now on.
    Armed,
    /// They are no longer.
    Disarmed,
    /// The link was lost. It is tried again.
    LinkLost {
        /// Why, in the system's words, and what to try.
        error: Box<LinkError>,
    },
    /// The link is there again.
    LinkBack,
}

/// What happens on a link, or to one of its axes, from when this was made. It keeps the link open.
#[derive(Debug)]
pub struct Events {
    mailbox: Mailbox,
    /// One for each wire.
    listening: Vec<Listening>,
    /// The axes of each wire, in the order of its connection, with their places in the link.
    axes: Vec<Vec<(usize, Axis)>>,
    /// What makes time pass, where it does not by itself.
    simulation: Option<Simulation>,
}

impl Link {
    /// Listens to what happens on every wire and axis from now on. Drives of which it is not known
    /// yet how what they send is laid out are asked that first.
    ///
    /// # Errors
    /// What asking brings; drives that refuse to tell are listened to all the same.
    pub fn events(&self) -> Result<Events, Error> {
        self.events_from(0)
    }

    /// The same of the axes from that place on alone: of those that were
    /// [taken in](Link::take_in) later.
    ///
    /// # Errors
    /// As [`events`](Self::events).
    pub fn events_from(&self, first: usize) -> Result<Events, Error> {
        let axes = || self.axes().iter().enumerate().skip(first);
        axes().try_for_each(|(_, axis)| axis.learn())?;
        let mut events = Events::new(self.simulation());
        axes().for_each(|(place, axis)| events.add(place, axis));
        events.listen(false);
        Ok(events)
    }
}

impl Axis {
    /// Listens to what happens to this axis and its link from now on; as [`Link::events`]. Its
    /// events' [`place`](Event::place) is 0.
    ///
    /// # Errors
    /// As [`Link::events`].
    pub fn events(&self) -> Result<Events, Error> {
        self.learn()?;
        let mut events = Events::new(self.simulation.as_ref());
        events.add(0, self);
        events.listen(true);
        Ok(events)
    }

    /// Reads how what the drive sends by itself is laid out, and what the scales of its signals depend
    /// on, as far as that is not known: the values in it are events from then on. A drive that restarts
    /// may have it otherwise, so that what it sends is not understood until this is done again.
    ///
    /// # Errors
    /// When the drive does not answer. That it refuses to tell is no error.
    pub fn learn(&self) -> Result<(), Error> {
        if Number(self.number).is_group() {
            return Ok(());
        }
        let unlearnt: Vec<ParameterId> = self.connection.with(|axes, _| {
            (0..).map_while(|n| axes.unlearnt(self.index, n)).take(self.params().len()).collect()
        });
        let refused = |told: Result<(), Error>| match told {
            Err(error) if error.exit() == Exit::Refused => Ok(()),
            told => told,
        };
        unlearnt.into_iter().try_for_each(|id| refused(self.read(id).map(drop)))?;
        let mut told =
            self.profile.signals.iter().filter_map(|s| self.profile.parameter(s.parameter));
        told.try_for_each(|parameter| refused(self.read_unread_factors(parameter)))
    }
}

impl Events {
    fn new(simulation: Option<&Simulation>) -> Self {
        let virtual_time = simulation.filter(|simulation| simulation.pace() == Pace::Virtual);
        Self {
            mailbox: Mailbox::new(EVENTS_MAX),
            listening: Vec::new(),
            axes: Vec::new(),
            simulation: virtual_time.cloned(),
        }
    }

    fn add(&mut self, place: usize, axis: &Axis) {
        let shares = |axes: &&mut Vec<(usize, Axis)>| axes[0].1.connection.is(&axis.connection);
        match self.axes.iter_mut().find(shares) {
            Some(axes) => axes.push((place, axis.clone())),
            None => self.axes.push(vec![(place, axis.clone())]),
        }
    }

    fn listen(&mut self, one: bool) {
        for (wire, axes) in self.axes.iter().enumerate() {
            let axis = &axes[0].1;
            let only = one.then_some(axis.index);
            self.listening.push(axis.connection.listen(&self.mailbox, wire, only));
        }
    }

    /// The next event; waits for one at most so long, on the link's clock. `None` when none came, or
    /// when somebody [interrupted](Self::interrupt).
    #[must_use]
    pub fn next(&self, within: Duration) -> Option<Event> {
        let deadline = clock::now() + within;
        self.next_until(Some(within), deadline)
    }

    /// The next event; waits for one until somebody interrupts.
    fn next_ever(&self) -> Option<Event> {
        self.next_until(None, Instant::FAR)
    }

    fn next_until(&self, within: Option<Duration>, deadline: Instant) -> Option<Event> {
        let Some(simulation) = &self.simulation else {
            return self.first(|| self.mailbox.wait(deadline));
        };
        let until = within.map(|within| simulation.now() + within);
        loop {
            let left = until.map_or(STEP, |until| until.since(simulation.now()));
            if let Some(event) = self.poll() {
                return Some(event);
            }
            if left.is_zero() || self.mailbox.interrupted() {
                return None;
            }
            simulation.pass(left.min(STEP));
        }
    }

    /// The next event that has happened already.
    #[must_use]
    pub fn poll(&self) -> Option<Event> {
        if self.simulation.is_some() {
            self.listening.iter().for_each(Listening::catch_up);
        }
        self.first(|| self.mailbox.take())
    }

    /// The first notice that is an event.
    fn first(&self, take: impl Fn() -> Option<(usize, Notice)>) -> Option<Event> {
        loop {
            if let Some(event) = self.event(take()?) {
                return Some(event);
            }
        }
    }

    /// Tells whether an event is there; else `waker` is woken when one is, or when somebody
    /// [interrupts](Self::interrupt).
    #[must_use]
    pub fn ready_or_wake(&self, waker: &task::Waker) -> bool {
        self.mailbox.ready_or_wake(waker)
    }

    /// Whether time passes only while somebody waits here: in a simulation in virtual time.
    #[must_use]
    pub fn in_virtual_time(&self) -> bool {
        self.simulation.is_some()
    }

    /// How many events were thrown away so far because nobody took them in time.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.mailbox.missed()
    }

    /// Ends a wait under way on another thread, or else the next. So do the link's
    /// [interrupters](Link::interrupters).
    pub fn interrupt(&self) {
        self.mailbox.interrupt();
    }

    fn event(&self, (wire, notice): (usize, Notice)) -> Option<Event> {
        let of_link = |at, kind| Event { at, axis: None, place: wire, kind };
        Some(match notice {
            Notice::Axis(news) => return self.of_axis(wire, &news),
            Notice::Lost(at, error) => of_link(at, Kind::LinkLost { error }),
            Notice::Back(at) => of_link(at, Kind::LinkBack),
        })
    }

    fn of_axis(&self, wire: usize, news: &News) -> Option<Event> {
        let (place, axis) = self.axes.get(wire)?.iter().find(|(_, a)| a.index == news.axis)?;
        let fault = |code| axis.profile.faults.iter().find(|fault| fault.code == code);
        let kind = match news.change {
            Change::Signal(signal, reading) => {
                Kind::Signal { signal, reading: axis.reading_of_machine(signal, reading) }
            }
            Change::Parameter(id, raw, si) => axis.pushed(id, raw, si),
            Change::Fault { code, appeared: true } => {
                Kind::FaultAppeared { code, fault: fault(code) }
            }
            Change::Fault { code, appeared: false } => {
                Kind::FaultCleared { code, fault: fault(code) }
            }
            Change::Presence(presence) => Kind::Presence(presence),
            Change::Armed(true) => Kind::Armed,
            Change::Armed(false) => Kind::Disarmed,
            // Those that later versions of the core tell.
            _ => return None,
        };
        Some(Event { at: news.at, axis: Some(axis.number), place: *place, kind })
    }
}

impl Axis {
    fn pushed(&self, parameter: ParameterId, raw: i64, si: f64) -> Kind {
        let unit = self.unit(parameter);
        let value = si / self.factor(parameter) / unit.si();
        Kind::Parameter { parameter, raw, value, unit }
    }
}

impl Iterator for Events {
    type Item = Event;

    /// Waits for the next event; ends when somebody interrupts.
    fn next(&mut self) -> Option<Event> {
        self.next_ever()
    }
}

impl Iterator for &Events {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        self.next_ever()
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(axis) = self.axis {
            write!(f, "axis {}: ", Number(axis))?;
        }
        self.kind.fmt(f)
    }
}

impl fmt::Display for Kind {
    /// In one sentence without full stop. A parameter is told by its place in the profile: who has
    /// the axis knows its name.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let of_fault = |fault: &Option<&'static Fault>| fault.map_or("", |fault| fault.name);
        match self {
            Self::Signal { signal, reading } => write!(f, "{} {}", signal.name(), reading.value),
            Self::Parameter { parameter, value, unit, .. } => {
                write!(f, "parameter {} {value} {}", parameter.0, unit.symbol())
            }
            Self::FaultAppeared { code, fault } => write!(f, "fault {code} {}", of_fault(fault)),
            Self::FaultCleared { code, fault } => {
                write!(f, "fault {code} {} cleared", of_fault(fault))
            }
            Self::Presence(presence) => f.write_str(presence.name()),
            Self::Armed => f.write_str("armed"),
            Self::Disarmed => f.write_str("disarmed"),
            Self::LinkLost { error } => error.fmt(f),
            Self::LinkBack => f.write_str("the link is back"),
        }
    }
}
