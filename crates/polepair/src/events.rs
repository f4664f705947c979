//! Events of a link: values that drives send by themselves, faults, restarts, a lost link.
//!
//! ```
//! # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! use std::time::Duration;
//! let link = polepair::connect_local("sim:tmcl?time=virtual")?;
//! let events = link.events()?;
//! link.axis(1)?.arm(true);
//! let event = events.next(Duration::from_secs(1)).expect("it was armed");
//! assert_eq!(event.to_string(), "axis 1: armed");
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```
//!
//! While an event stream is open, the link is read even without an open request. Replies to requests of this
//! program are not events, but a fault that a reply shows is one.

use crate::axis::LocalAxis;
use crate::connect::LocalLink;
use crate::error::{Error, Exit};
use crate::simulate::{Simulation, SimulationPace};
use crate::url::AxisNumber;
use polepair_core::axis::{AxisEvent, AxisEventKind, Presence, Reading};
use polepair_core::profile::{Fault, ParameterId, Signal};
use polepair_core::time::Instant;
use polepair_core::units::Unit;
use polepair_link::{ConnectionEvent, LinkError, ListenerGuard, Mailbox, clock};
use std::fmt;
use std::task;
use std::time::Duration;

/// Events that wait for a listener at most; then the oldest go, and [`Events::lost`] counts them.
pub const EVENTS_MAX: usize = 8192;
/// Step of virtual time between two checks.
const VIRTUAL_STEP: Duration = Duration::from_millis(1);

/// One thing that happened.
#[derive(Clone, PartialEq, Debug)]
pub struct Event {
    /// When it arrived, on the link's clock; where it was found out otherwise, when that was.
    pub at: Instant,
    /// The number of the axis; `None` for what happened to the link.
    pub axis: Option<u32>,
    /// The axis' place in [`LocalLink::axes`], the wire's in [`LocalLink::wires`] where there is no axis.
    pub index: usize,
    /// Kind of the event.
    pub kind: EventKind,
}

/// Kind of an event.
#[derive(Clone, PartialEq, Debug)]
#[non_exhaustive]
pub enum EventKind {
    /// The drive sent a signal's value: of a flag or a code, when it changed.
    Signal {
        /// Signal of the axis.
        signal: Signal,
        /// Value in SI, in the machine's scale.
        reading: Reading,
    },
    /// The drive sent the value of a parameter that is not a signal.
    Parameter {
        /// Parameter of the axis' profile.
        parameter: ParameterId,
        /// Raw value of the drive.
        raw: i64,
        /// Value in `unit`; NaN while a parameter that the scale depends on was never read.
        value: f64,
        /// The unit in which the axis shows it.
        unit: Unit,
    },
    /// The drive now has a fault.
    FaultAppeared {
        /// The drive's code, or the bit of its fault word.
        code: u32,
        /// Name, cause and remedy, if the profile knows it.
        fault: Option<&'static Fault>,
    },
    /// The drive has a fault no more.
    FaultCleared {
        /// Code as in [`FaultAppeared`](Self::FaultAppeared).
        code: u32,
        /// Name, cause and remedy, if the profile knows it.
        fault: Option<&'static Fault>,
    },
    /// State of the drive in its network from now on. One that restarted or is gone is disarmed.
    Presence(Presence),
    /// Motion commands are allowed from now on.
    Armed,
    /// They are no longer.
    Disarmed,
    /// The link was lost. It is tried again.
    LinkLost {
        /// Cause in the system's words, and what to try.
        error: Box<LinkError>,
    },
    /// The link is there again.
    LinkBack,
}

/// Events of a link, or of one of its axes, from its creation on. It keeps the link open.
#[derive(Debug)]
pub struct Events {
    mailbox: Mailbox,
    /// Listeners, one for each wire.
    listeners: Vec<ListenerGuard>,
    /// The axes of each wire, in the order of its connection, with their places in the link.
    axes: Vec<Vec<(usize, LocalAxis)>>,
    /// Simulation whose time only passes in waits.
    simulation: Option<Simulation>,
}

impl LocalLink {
    /// Listens to all events on every wire and axis from now on. Drives whose messages have an unknown
    /// layout are read for it first.
    ///
    /// # Errors
    /// Errors of the reads that it needs; drives that refuse them are listened to nevertheless.
    pub fn events(&self) -> Result<Events, Error> {
        self.events_from(0)
    }

    /// [`events`](Self::events) of the axes from index `first` on: of those that were [added](LocalLink::add_drives)
    /// later.
    ///
    /// # Errors
    /// As [`events`](Self::events).
    pub fn events_from(&self, first: usize) -> Result<Events, Error> {
        let axes = || self.axes().iter().enumerate().skip(first);
        // Before listening: the reads would otherwise be the first events.
        axes().try_for_each(|(_, axis)| axis.read_event_layout())?;
        let mut events = Events::new(self.simulation());
        axes().for_each(|(index, axis)| events.add_axis(index, axis));
        events.start_listening(false);
        Ok(events)
    }
}

impl LocalAxis {
    /// Listens to what happens to this axis and its link from now on; as [`LocalLink::events`]. Its
    /// events' [`index`](Event::index) is 0.
    ///
    /// # Errors
    /// As [`LocalLink::events`].
    pub fn events(&self) -> Result<Events, Error> {
        self.read_event_layout()?;
        let mut events = Events::new(self.simulation.as_ref());
        events.add_axis(0, self);
        events.start_listening(true);
        Ok(events)
    }

    /// Reads how what the drive sends by itself is laid out, and what the scales of its signals depend
    /// on, as far as that is not known: the values in it are events from then on. A drive that restarts
    /// may have another layout, so that its messages are not understood until this is done again.
    ///
    /// # Errors
    /// A drive without a reply. A refusal is no error.
    pub fn read_event_layout(&self) -> Result<(), Error> {
        if AxisNumber(self.number).is_group() {
            return Ok(());
        }
        let unlearnt: Vec<ParameterId> = self.connection.with_axes(|axes, _| {
            (0..)
                .map_while(|n| axes.unread_prerequisite(self.index, n))
                .take(self.params().len())
                .collect()
        });
        unlearnt.into_iter().try_for_each(|id| ignore_refusal(self.read(id).map(drop)))?;
        let mut signal_parameters =
            self.profile.signals.iter().filter_map(|s| self.profile.parameter(s.parameter));
        signal_parameters
            .try_for_each(|parameter| ignore_refusal(self.read_unread_factors(parameter)))
    }
}

fn ignore_refusal(result: Result<(), Error>) -> Result<(), Error> {
    match result {
        Err(error) if error.exit() == Exit::Refused => Ok(()),
        result => result,
    }
}

impl Events {
    fn new(simulation: Option<&Simulation>) -> Self {
        let virtual_time =
            simulation.filter(|simulation| simulation.pace() == SimulationPace::Virtual);
        Self {
            mailbox: Mailbox::new(EVENTS_MAX),
            listeners: Vec::new(),
            axes: Vec::new(),
            simulation: virtual_time.cloned(),
        }
    }

    fn add_axis(&mut self, index: usize, axis: &LocalAxis) {
        let shares =
            |axes: &&mut Vec<(usize, LocalAxis)>| axes[0].1.connection.is_same(&axis.connection);
        match self.axes.iter_mut().find(shares) {
            Some(axes) => axes.push((index, axis.clone())),
            None => self.axes.push(vec![(index, axis.clone())]),
        }
    }

    fn start_listening(&mut self, one: bool) {
        for (wire, axes) in self.axes.iter().enumerate() {
            let axis = &axes[0].1;
            let only = one.then_some(axis.index);
            self.listeners.push(axis.connection.listen(&self.mailbox, wire, only));
        }
    }

    /// The next event; waits at most this time on the link's clock. `None` after the time limit or an
    /// [interruption](Self::interrupt).
    #[must_use]
    pub fn next(&self, within: Duration) -> Option<Event> {
        let deadline = clock::now() + within;
        self.next_until(Some(within), deadline)
    }

    /// The next event; waits until an interruption.
    fn next_unbounded(&self) -> Option<Event> {
        self.next_until(None, Instant::FAR_FUTURE)
    }

    fn next_until(&self, within: Option<Duration>, deadline: Instant) -> Option<Event> {
        let Some(simulation) = &self.simulation else {
            return self.first_event(|| self.mailbox.wait_next(deadline));
        };
        let until = within.map(|within| simulation.now() + within);
        loop {
            let left = until.map_or(VIRTUAL_STEP, |until| until.since(simulation.now()));
            if let Some(event) = self.poll() {
                return Some(event);
            }
            if left.is_zero() || self.mailbox.take_interrupt() {
                return None;
            }
            // In small steps, so that an event is seen at its own time and not at the end of the wait.
            simulation.advance(left.min(VIRTUAL_STEP));
        }
    }

    /// The next event that has happened already.
    #[must_use]
    pub fn poll(&self) -> Option<Event> {
        if self.simulation.is_some() {
            // In virtual time no thread of the connection runs by itself.
            self.listeners.iter().for_each(ListenerGuard::catch_up);
        }
        self.first_event(|| self.mailbox.pop())
    }

    /// The first notice that is an event.
    fn first_event(&self, take: impl Fn() -> Option<(usize, ConnectionEvent)>) -> Option<Event> {
        loop {
            if let Some(event) = self.to_event(take()?) {
                return Some(event);
            }
        }
    }

    /// Returns whether an event is available; otherwise `waker` is woken at the next one, or at an
    /// [interruption](Self::interrupt).
    #[must_use]
    pub fn ready_or_wake(&self, waker: &task::Waker) -> bool {
        self.mailbox.ready_or_wake(waker)
    }

    /// Returns whether time passes only during a wait here: a simulation in virtual time.
    #[must_use]
    pub fn in_virtual_time(&self) -> bool {
        self.simulation.is_some()
    }

    /// Number of events that were dropped because they were not read in time.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.mailbox.missed()
    }

    /// Ends a wait under way on another thread, or else the next. So do the link's
    /// [interrupters](LocalLink::interrupters).
    pub fn interrupt(&self) {
        self.mailbox.interrupt();
    }

    fn to_event(&self, notice: (usize, ConnectionEvent)) -> Option<Event> {
        let (wire, notice) = notice;

        Some(match notice {
            ConnectionEvent::Axis(event) => return self.axis_event(wire, &event),
            ConnectionEvent::LinkLost(at, error) => {
                link_event(at, EventKind::LinkLost { error }, wire)
            }
            ConnectionEvent::LinkRestored(at) => link_event(at, EventKind::LinkBack, wire),
        })
    }

    fn axis_event(&self, wire: usize, event: &AxisEvent) -> Option<Event> {
        let (position, axis) = self.axes.get(wire)?.iter().find(|(_, a)| a.index == event.axis)?;
        let kind = match event.kind {
            AxisEventKind::Signal(signal, reading) => EventKind::Signal {
                signal,
                reading: axis.reading_in_machine_scale(signal, reading),
            },
            AxisEventKind::Parameter(id, raw, si) => axis.parameter_event(id, raw, si),
            AxisEventKind::Address(address, raw) => {
                let parameter = axis.find_unnamed(&address)?;
                let (value, unit) = (raw as f64, axis.unit(parameter));
                EventKind::Parameter { parameter, raw, value, unit }
            }
            AxisEventKind::Fault { code, appeared: true } => {
                EventKind::FaultAppeared { code, fault: profile_fault(code, axis.profile.faults) }
            }
            AxisEventKind::Fault { code, appeared: false } => {
                EventKind::FaultCleared { code, fault: profile_fault(code, axis.profile.faults) }
            }
            AxisEventKind::Presence(presence) => EventKind::Presence(presence),
            AxisEventKind::Armed(true) => EventKind::Armed,
            AxisEventKind::Armed(false) => EventKind::Disarmed,
            // Events of later versions of the core.
            _ => return None,
        };
        Some(Event { at: event.at, axis: Some(axis.number), index: *position, kind })
    }
}

fn profile_fault(code: u32, axis_profile_faults: &[Fault]) -> Option<&Fault> {
    axis_profile_faults.iter().find(|fault| fault.code == code)
}

fn link_event(at: Instant, kind: EventKind, wire: usize) -> Event {
    Event { at, axis: None, index: wire, kind }
}

impl LocalAxis {
    fn parameter_event(&self, parameter: ParameterId, raw: i64, si: f64) -> EventKind {
        let unit = self.unit(parameter);
        let value = si / self.factor(parameter) / unit.si_factor();
        EventKind::Parameter { parameter, raw, value, unit }
    }
}

impl Iterator for Events {
    type Item = Event;

    /// Waits for the next event; ends at an interruption.
    fn next(&mut self) -> Option<Event> {
        self.next_unbounded()
    }
}

impl Iterator for &Events {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        self.next_unbounded()
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(axis) = self.axis {
            write!(f, "axis {}: ", AxisNumber(axis))?;
        }
        self.kind.fmt(f)
    }
}

impl fmt::Display for EventKind {
    /// One sentence without full stop. A parameter is printed by its index in the profile, because its name
    /// is known to the axis only.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Signal { signal, reading } => write!(f, "{} {}", signal.name(), reading.value),
            Self::Parameter { parameter, value, unit, .. } => {
                write!(f, "parameter {} {value} {}", parameter.0, unit.symbol())
            }
            Self::FaultAppeared { code, fault } => write!(f, "fault {code} {}", fault_name(*fault)),
            Self::FaultCleared { code, fault } => {
                write!(f, "fault {code} {} cleared", fault_name(*fault))
            }
            Self::Presence(presence) => f.write_str(presence.name()),
            Self::Armed => f.write_str("armed"),
            Self::Disarmed => f.write_str("disarmed"),
            Self::LinkLost { error } => error.fmt(f),
            Self::LinkBack => f.write_str("the link is back"),
        }
    }
}

fn fault_name(fault: Option<&'static Fault>) -> &'static str {
    fault.map_or("", |fault| fault.name)
}
