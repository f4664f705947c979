//! One axis interface for every link: an axis on a wire of this program, and an axis of a running gateway.
//!
//! ```
//! # if polepair_core::drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! let link = polepair::connect("sim:tmcl?time=virtual")?; // or "ws://127.0.0.1:7365"
//! let axis = link.axis(1)?;
//! println!("{}: {}", axis.label(), axis.get("max current")?);
//! {
//!     let armed = axis.armed()?;
//!     armed.velocity("60 rpm")?;
//!     link.sleep(std::time::Duration::from_millis(500));
//!     armed.stop()?;
//! } // stopped, disabled and disarmed here, whatever happens in between
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```
//!
//! [`AxisInterface`] has two implementations: [`LocalAxis`], which sends requests through a connection of this
//! program, and `RemoteAxis` (feature `remote`), which asks a gateway. What an axis of a gateway cannot do is
//! in [`Axis::local`]: the methods of [`LocalAxis`].

mod armed;
mod facts;
mod link;
mod local;
mod reading;
mod request;

use std::fmt;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Duration;

use polepair_core::axis::{Command, Verb};
use polepair_core::error::{Failure, Outcome};
use polepair_core::plan::Argument;
use polepair_core::profile::{ParameterId, Signal};
use polepair_core::time::Instant;
use polepair_core::units::Unit;

pub use armed::Armed;
pub use facts::{AxisFacts, ParameterDescription, WatchdogKind};
pub use link::{Link, connect, is_gateway};
pub use reading::{AxisSnapshot, FaultReport, ReadValue, SignalReading, WatchdogReport};
pub use request::{AxisRequest, Reply, WriteValue};

use crate::amount::Amount;
use crate::axis::{DeviceDetail, LocalAxis};
use crate::error::Error;

/// What an axis can do, wherever its wire is.
///
/// Times and values are SI. Requests are sent once. Errors have a stable code ([`Error::code`]) and state
/// whether the drive may have executed the request ([`Error::executed`]).
pub trait AxisInterface: fmt::Debug + Send + Sync {
    /// What is known of the axis without a request.
    fn facts(&self) -> AxisFacts;

    /// The axis, if its wire is opened by this program.
    fn local(&self) -> Option<&LocalAxis> {
        None
    }

    /// The axis, if it belongs to a gateway.
    #[cfg(feature = "remote")]
    fn remote(&self) -> Option<&crate::remote::RemoteAxis> {
        None
    }

    /// The unit in which an argument of a verb is shown, and meant if none is given. `None` if the verb has no
    /// use for the argument.
    fn unit_of(&self, verb: Verb, which: Argument) -> Option<Unit>;

    /// The SI value of an argument of a verb.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217` for a wrong unit, `E218` if the verb does not take the argument.
    fn argument(&self, verb: Verb, which: Argument, amount: &Amount) -> Result<f64, Error>;

    /// The SI unit of a signal as text; empty for flags, codes and modes.
    fn signal_unit(&self, signal: Signal) -> String;

    /// Every parameter.
    ///
    /// # Errors
    /// [`Error::Gateway`] if a gateway does not answer.
    fn parameters(&self) -> Result<Vec<ParameterDescription>, Error>;

    /// The parameter with this name or address.
    ///
    /// # Errors
    /// `E213` with the nearest name.
    fn find(&self, name: &str) -> Result<ParameterId, Error>;

    /// Starts to read a parameter.
    ///
    /// # Errors
    /// Nothing was sent.
    fn start_read(&self, id: ParameterId) -> Result<AxisRequest, Error>;

    /// Starts to write a parameter. `store` also stores it in permanent memory.
    ///
    /// # Errors
    /// Nothing was written: `E216` outside the limits, `E219` for what moves an unarmed axis.
    fn start_write(
        &self,
        id: ParameterId,
        value: &WriteValue,
        store: bool,
    ) -> Result<AxisRequest, Error>;

    /// The value in the reply to [`start_read`](Self::start_read). Parameters that the scale depends on are
    /// read if necessary.
    ///
    /// # Errors
    /// What reading them brings.
    fn reading(&self, id: ParameterId, reply: Reply) -> Result<ReadValue, Error>;

    /// Reads text without its final zeros, or all bytes, of a parameter of any length.
    ///
    /// # Errors
    /// By source.
    fn read_data(&self, id: ParameterId) -> Result<Vec<u8>, Error>;

    /// Writes all bytes of a parameter of any length.
    ///
    /// # Errors
    /// By source; `E257` on a gateway.
    fn write_data(&self, id: ParameterId, data: &[u8]) -> Result<(), Error>;

    /// Starts a request in the protocol's own text: `GAP 1`, `read 0x6041:0`.
    ///
    /// # Errors
    /// `E221` for text that is no request, `E222` for one that may move the motor.
    fn start_raw(&self, text: &str) -> Result<AxisRequest, Error>;

    /// Starts a verb. The request ends when the verb has ended.
    ///
    /// # Errors
    /// Nothing was sent: `E218` for a drive without the verb, `E219` for an unarmed axis.
    fn start(&self, command: Command) -> Result<AxisRequest, Error>;

    /// Arms the axis: motion commands are let through. On a gateway this acquires the lease.
    ///
    /// # Errors
    /// `E220` if it is armed already, `gateway.lease` if another client has the lease.
    fn arm(&self) -> Result<(), Error>;

    /// Disarms the axis, and releases the lease. The motor is left as it is; on a gateway the end of a lease
    /// stops a motion.
    ///
    /// # Errors
    /// [`Error::Gateway`] if a gateway does not answer.
    fn disarm(&self) -> Result<(), Error>;

    /// Whether this program armed the axis, and its motion commands are let through.
    fn is_armed(&self) -> bool;

    /// Stops the motor, and returns when standstill is confirmed. An axis of a gateway is stopped whoever
    /// commands it.
    ///
    /// # Errors
    /// [`Error::may_turn`] states whether the motor may still turn.
    fn stop(&self) -> Result<(), Error>;

    /// Stops, disables and disarms the axis that this program armed. Without a reply the stop is repeated for
    /// [`STOP_RETRY_MAX`](crate::axis::STOP_RETRY_MAX).
    ///
    /// # Errors
    /// The first error; each step was tried.
    fn release(&self) -> Result<(), Error>;

    /// The last known state. Nothing is sent to the drive.
    ///
    /// # Errors
    /// [`Error::Gateway`] if a gateway does not answer.
    fn state(&self) -> Result<AxisSnapshot, Error>;

    /// Reads signals now.
    ///
    /// # Errors
    /// `E213` for a signal that the drive does not report; others by source.
    fn signals(&self, signals: &[Signal]) -> Result<Vec<SignalReading>, Error>;

    /// Reads which faults are active.
    ///
    /// # Errors
    /// By source.
    fn faults(&self) -> Result<Vec<FaultReport>, Error>;

    /// Reads the device information: name, versions, motors.
    ///
    /// # Errors
    /// [`Error::Link`] and [`Error::Gateway`].
    fn device_details(&self) -> Result<Vec<DeviceDetail>, Error>;

    /// Reads the setting of the drive's watchdog.
    ///
    /// # Errors
    /// By source.
    fn watchdog(&self) -> Result<WatchdogReport, Error>;

    /// Sets the drive's watchdog: it stops after so long without a message of its host; `None` switches it off.
    ///
    /// # Errors
    /// `E213` for a drive without a watchdog that can be set; others by source.
    fn set_watchdog(&self, after: Option<Duration>) -> Result<WatchdogReport, Error>;

    /// The time of the link's clock.
    fn now(&self) -> Instant;

    /// Waits on the link's clock; in virtual time it returns at once.
    fn sleep(&self, span: Duration);
}

/// One axis of a [`Link`]. Clones are the same axis; any thread may use it.
#[derive(Clone, Debug)]
pub struct Axis {
    interface: Arc<dyn AxisInterface>,
    facts: Arc<AxisFacts>,
}

impl<A: AxisInterface + 'static> From<A> for Axis {
    fn from(axis: A) -> Self {
        Self { facts: Arc::new(axis.facts()), interface: Arc::new(axis) }
    }
}

impl Axis {
    /// What is known of it without a request: product, verbs, signals.
    #[must_use]
    pub fn facts(&self) -> &AxisFacts {
        &self.facts
    }

    /// The methods that the two kinds of axes share.
    #[must_use]
    pub fn interface(&self) -> &dyn AxisInterface {
        &*self.interface
    }

    /// The axis with all methods of a wire that this program opened: streams, events, programs, rehearsals,
    /// moves that start together, and the drive's profile. `None` for an axis of a gateway.
    #[must_use]
    pub fn local(&self) -> Option<&LocalAxis> {
        self.interface.local()
    }

    /// The same, or the one error that says that a gateway does not offer `what`, with what to try instead.
    ///
    /// # Errors
    /// [`Error::Usage`] `E257`.
    pub fn require_local(&self, what: &str, hint: &str) -> Result<&LocalAxis, Error> {
        self.local().ok_or_else(|| not_on_gateway(what, hint))
    }

    /// The axis of a gateway. `None` for one whose wire this program opened.
    #[cfg(feature = "remote")]
    #[must_use]
    pub fn remote(&self) -> Option<&crate::remote::RemoteAxis> {
        self.interface.remote()
    }

    /// The number of the axis: the drive's address on the wire.
    #[must_use]
    pub fn number(&self) -> u32 {
        self.facts.number
    }

    /// Its name in a rack file; empty without one.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.facts.name
    }

    /// `axis 1`, or `axis 1 (x)` if it has a name; `axis 1 of link 2` on a gateway with several links.
    #[must_use]
    pub fn label(&self) -> &str {
        &self.facts.label
    }

    /// Whether the drive has this verb.
    #[must_use]
    pub fn has_verb(&self, verb: Verb) -> bool {
        self.facts.verbs.contains(&verb)
    }

    /// Whether the drive reports this signal.
    #[must_use]
    pub fn has_signal(&self, signal: Signal) -> bool {
        self.facts.signals.contains(&signal)
    }

    /// The unit in which an argument of a verb is shown. `None` if the verb has no use for it.
    #[must_use]
    pub fn unit_of(&self, verb: Verb, which: Argument) -> Option<Unit> {
        self.interface.unit_of(verb, which)
    }

    /// The SI value of an argument of a verb.
    ///
    /// # Errors
    /// As [`AxisInterface::argument`].
    pub fn argument(&self, verb: Verb, which: Argument, amount: &Amount) -> Result<f64, Error> {
        self.interface.argument(verb, which, amount)
    }

    /// The SI unit of a signal as text; empty for flags, codes and modes.
    #[must_use]
    pub fn signal_unit(&self, signal: Signal) -> String {
        self.interface.signal_unit(signal)
    }

    /// Every parameter.
    ///
    /// # Errors
    /// As [`AxisInterface::parameters`].
    pub fn parameters(&self) -> Result<Vec<ParameterDescription>, Error> {
        self.interface.parameters()
    }

    /// The parameter with this name or address.
    ///
    /// # Errors
    /// `E213` with the nearest name.
    pub fn find(&self, name: &str) -> Result<ParameterId, Error> {
        self.interface.find(name)
    }

    /// Reads a parameter by name, in its unit.
    ///
    /// # Errors
    /// [`Error`] by source; `E213` for text and bytes, which [`get_text`](Self::get_text) and
    /// [`get_bytes`](Self::get_bytes) read.
    pub fn get(&self, name: &str) -> Result<ReadValue, Error> {
        let id = self.find(name)?;
        let reply = self.interface.start_read(id)?.finish()?;
        let reading = self.interface.reading(id, reply)?;
        reading.require_raw(name)?;
        Ok(reading)
    }

    /// Reads the raw value of a parameter by name.
    ///
    /// # Errors
    /// As [`get`](Self::get).
    pub fn get_raw(&self, name: &str) -> Result<i64, Error> {
        self.interface.start_read(self.find(name)?)?.finish()?.raw(name)
    }

    /// Reads a parameter that holds text.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn get_text(&self, name: &str) -> Result<String, Error> {
        Ok(String::from_utf8_lossy(&self.get_bytes(name)?).into_owned())
    }

    /// Reads a parameter that holds bytes.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn get_bytes(&self, name: &str) -> Result<Vec<u8>, Error> {
        self.interface.read_data(self.find(name)?)
    }

    /// Writes a parameter by name: `set("max current", 1.2)` in its own unit, `set("max current", "1200 mA")`,
    /// or one of its words. Limits are checked before a byte is sent. Permanent memory is not written.
    ///
    /// # Errors
    /// [`Error`] by source; `E216` outside the limits, `E219` for what moves an unarmed axis.
    pub fn set(&self, name: &str, amount: impl Into<Amount>) -> Result<(), Error> {
        self.write(name, WriteValue::Amount(amount.into()), false)
    }

    /// Writes a parameter by name, and stores it in the drive's permanent memory.
    ///
    /// # Errors
    /// As [`set`](Self::set).
    pub fn set_and_store(&self, name: &str, amount: impl Into<Amount>) -> Result<(), Error> {
        self.write(name, WriteValue::Amount(amount.into()), true)
    }

    /// Writes the raw value of a parameter by name.
    ///
    /// # Errors
    /// As [`set`](Self::set).
    pub fn set_raw(&self, name: &str, raw: i64) -> Result<(), Error> {
        self.write(name, WriteValue::Raw(raw), false)
    }

    fn write(&self, name: &str, value: WriteValue, store: bool) -> Result<(), Error> {
        self.interface.start_write(self.find(name)?, &value, store)?.finish().map(drop)
    }

    /// Sends a request in the protocol's own text, and returns the value in the reply.
    ///
    /// # Errors
    /// As [`AxisInterface::start_raw`].
    pub fn raw(&self, text: &str) -> Result<i64, Error> {
        self.interface.start_raw(text)?.finish()?.raw(text)
    }

    /// Arms the axis: motion commands are let through. [`armed`](Self::armed) does it for a scope.
    ///
    /// # Errors
    /// As [`AxisInterface::arm`].
    pub fn arm(&self) -> Result<(), Error> {
        self.interface.arm()
    }

    /// Disarms the axis.
    ///
    /// # Errors
    /// As [`AxisInterface::disarm`].
    pub fn disarm(&self) -> Result<(), Error> {
        self.interface.disarm()
    }

    /// Whether this program armed the axis.
    #[must_use]
    pub fn is_armed(&self) -> bool {
        self.interface.is_armed()
    }

    /// Arms and enables the axis until the guard is dropped, which stops and disables it.
    ///
    /// # Errors
    /// [`Error`] by source; the axis is then disarmed again. `E220` if it is armed already: it then stays so.
    pub fn armed(&self) -> Result<Armed, Error> {
        Armed::new(self)
    }

    /// Starts a verb, and does not wait for its end.
    ///
    /// # Errors
    /// As [`AxisInterface::start`].
    pub fn start(&self, command: Command) -> Result<AxisRequest, Error> {
        self.interface.start(command)
    }

    /// Runs a verb to its end.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn run(&self, command: Command) -> Result<(), Error> {
        self.start(command)?.finish().map(drop)
    }

    /// Powers the motor. It holds its actual position. The axis must be armed.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn enable(&self) -> Result<(), Error> {
        self.run(Command::new(Verb::Enable))
    }

    /// Removes power from the motor.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn disable(&self) -> Result<(), Error> {
        self.run(Command::new(Verb::Disable))
    }

    /// Clears faults.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn clear(&self) -> Result<(), Error> {
        self.run(Command::new(Verb::Clear))
    }

    /// Turns at a speed: rad/s (m/s), or text with a unit. The axis must be armed.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn velocity(&self, speed: impl Into<Amount>) -> Result<(), Error> {
        let velocity = self.argument(Verb::Velocity, Argument::Velocity, &speed.into())?;
        self.run(Command { velocity: Some(velocity), ..Command::new(Verb::Velocity) })
    }

    /// Turns with a torque: N·m (or the drive's substitute: A, a share), or text with a unit. The axis must be
    /// armed.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn torque(&self, torque: impl Into<Amount>) -> Result<(), Error> {
        let torque = self.argument(Verb::Torque, Argument::Torque, &torque.into())?;
        self.run(Command { torque: Some(torque), ..Command::new(Verb::Torque) })
    }

    /// Starts a move to a position: rad (m), or text with a unit. Returns when the drive has acknowledged the
    /// start; [`wait`](Self::wait) waits for the arrival. The axis must be armed.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn move_to(&self, target: impl Into<Amount>) -> Result<(), Error> {
        self.run_move(Verb::MoveTo, &target.into(), None)
    }

    /// Starts a move by a distance. As [`move_to`](Self::move_to); it is never sent twice.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn move_by(&self, distance: impl Into<Amount>) -> Result<(), Error> {
        self.run_move(Verb::MoveBy, &distance.into(), None)
    }

    /// Starts a move by a distance from the last target, whether that was reached or not.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn move_on(&self, distance: impl Into<Amount>) -> Result<(), Error> {
        self.run_move(Verb::MoveOn, &distance.into(), None)
    }

    /// Starts a move to a position with an S-curve, whose acceleration takes `jerk_time` (s, or text with a
    /// unit) to build up.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn curve_to(
        &self,
        target: impl Into<Amount>,
        jerk_time: impl Into<Amount>,
    ) -> Result<(), Error> {
        self.run_move(Verb::CurveTo, &target.into(), Some(&jerk_time.into()))
    }

    /// Starts a move by a distance with an S-curve. It is never sent twice.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn curve_by(
        &self,
        distance: impl Into<Amount>,
        jerk_time: impl Into<Amount>,
    ) -> Result<(), Error> {
        self.run_move(Verb::CurveBy, &distance.into(), Some(&jerk_time.into()))
    }

    fn run_move(&self, verb: Verb, target: &Amount, jerk: Option<&Amount>) -> Result<(), Error> {
        let target = Some(self.argument(verb, Argument::Target, target)?);
        let jerk_time = jerk.map(|jerk| self.argument(verb, Argument::JerkTime, jerk));
        let jerk_time = jerk_time.transpose()?;
        self.run(Command { target, jerk_time, ..Command::new(verb) })
    }

    /// Finds the reference position, and waits for it. The axis must be armed.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn home(&self) -> Result<(), Error> {
        self.run(Command::new(Verb::Home))
    }

    /// Waits until the last move has arrived, at most so long; false if it has not.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn wait_reached(&self, within: Duration) -> Result<bool, Error> {
        if let Some(axis) = self.local() {
            return axis.wait_reached(within);
        }
        let request = self.start(Command::new(Verb::Reached).limited(within));
        match request.and_then(|mut request| request.wait(within)) {
            Ok(ended) => Ok(ended.is_some()),
            Err(error) if error.code() == "E101" => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Waits until the last move has arrived.
    ///
    /// # Errors
    /// `E101` if it has not arrived in time; others by source.
    pub fn wait(&self, within: Duration) -> Result<(), Error> {
        if let Some(axis) = self.local() {
            return axis.wait(within);
        }
        match self.wait_reached(within)? {
            true => Ok(()),
            false => Err(Error::Failed {
                what: format!("{}: the move did not arrive in time", self.label()),
                execution: String::new(),
                outcome: Outcome::NotDone(Failure::NotReached),
                received: Box::default(),
                may_turn: false,
                hint: String::new(),
            }),
        }
    }

    /// Stops the motor, and returns when standstill is confirmed.
    ///
    /// # Errors
    /// As [`AxisInterface::stop`].
    pub fn stop(&self) -> Result<(), Error> {
        self.interface.stop()
    }

    /// The last known state. Nothing is sent to the drive.
    ///
    /// # Errors
    /// [`Error::Gateway`] if a gateway does not answer.
    pub fn state(&self) -> Result<AxisSnapshot, Error> {
        self.interface.state()
    }

    /// Reads signals now, in SI.
    ///
    /// # Errors
    /// As [`AxisInterface::signals`].
    pub fn signals(&self, signals: &[Signal]) -> Result<Vec<SignalReading>, Error> {
        self.interface.signals(signals)
    }

    /// Reads signals again and again, every `period` on the link's clock, until `show` breaks. Readings that
    /// take longer than the period are not caught up with. A gateway is asked as often.
    ///
    /// # Errors
    /// As [`signals`](Self::signals).
    pub fn watch(
        &self,
        signals: &[Signal],
        period: Duration,
        mut show: impl FnMut(&[SignalReading]) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        loop {
            let began = self.interface.now();
            if show(&self.signals(signals)?).is_break() {
                return Ok(());
            }
            let spent = self.interface.now().since(began);
            self.interface.sleep(period.saturating_sub(spent));
        }
    }

    /// Reads which faults are active.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn faults(&self) -> Result<Vec<FaultReport>, Error> {
        self.interface.faults()
    }

    /// Reads the device information: name, versions, motors.
    ///
    /// # Errors
    /// As [`AxisInterface::device_details`].
    pub fn device_details(&self) -> Result<Vec<DeviceDetail>, Error> {
        self.interface.device_details()
    }

    /// Reads the setting of the drive's watchdog.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn watchdog(&self) -> Result<WatchdogReport, Error> {
        self.interface.watchdog()
    }

    /// Sets the drive's watchdog; `None` switches it off.
    ///
    /// # Errors
    /// As [`AxisInterface::set_watchdog`].
    pub fn set_watchdog(&self, after: Option<Duration>) -> Result<WatchdogReport, Error> {
        self.interface.set_watchdog(after)
    }

    /// The time of the link's clock.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.interface.now()
    }

    /// Waits on the link's clock; in virtual time it returns at once.
    pub fn sleep(&self, span: Duration) {
        self.interface.sleep(span);
    }
}

/// The error for what only a program with the wire itself can do.
pub(crate) fn not_on_gateway(what: &str, hint: &str) -> Error {
    let hint = match hint {
        "" => "open the link in this program; end the gateway first",
        hint => hint,
    };
    Error::usage("E257", format!("a gateway does not offer {what}"), hint)
}
