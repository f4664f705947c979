//! One axis of a link, wherever its wire is.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Duration;

use polepair_core::axis::{Command, Verb};
use polepair_core::error::{Failure, Outcome};
use polepair_core::plan::Argument;
use polepair_core::profile::{ParameterId, Signal};
use polepair_core::time::Instant;
use polepair_core::units::Unit;

use super::{
    AxisFacts, AxisInterface, AxisRequest, AxisSnapshot, FaultReport, ParameterDescription,
    ReadValue, SignalReading, WatchdogReport, WriteValue, not_on_gateway,
};
use crate::amount::Amount;
use crate::axis::{DeviceDetail, LocalAxis};
use crate::error::Error;

/// One axis of a [`Link`](super::Link). Clones are the same axis; any thread may use it.
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
    /// Facts without a request: product, verbs, signals.
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

    /// The local axis, or the one error for `what` that a gateway does not offer, with `hint`.
    ///
    /// # Errors
    /// [`Error::Usage`] `E257`.
    pub fn require_local(&self, what: &str, hint: &str) -> Result<&LocalAxis, Error> {
        self.local().ok_or_else(|| not_on_gateway(what, hint))
    }

    /// The axis of a gateway. `None` for one whose wire this program opened.
    #[cfg(feature = "remote")]
    #[must_use]
    pub fn remote(&self) -> Option<&crate::interface::remote::RemoteAxis> {
        self.interface.remote()
    }

    /// The number of the axis: the drive's address on the wire.
    #[must_use]
    pub fn number(&self) -> u32 {
        self.facts.number
    }

    /// Name in a rack file; empty without one.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.facts.name
    }

    /// `axis 1`, or `axis 1 (x)` if it has a name; `axis 1 of link 2` on a gateway with several links.
    #[must_use]
    pub fn label(&self) -> &str {
        &self.facts.label
    }

    /// Returns whether the drive has this verb.
    #[must_use]
    pub fn has_verb(&self, verb: Verb) -> bool {
        self.facts.verbs.contains(&verb)
    }

    /// Returns whether the drive reports this signal.
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
    /// As [`AxisMotion::argument`](super::AxisMotion::argument).
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
    /// As [`AxisParameters::parameters`](super::AxisParameters::parameters).
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

    /// Reads a parameter of any kind by name: a number in its unit, text, or bytes.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn read(&self, name: &str) -> Result<ReadValue, Error> {
        self.interface.read(self.find(name)?)
    }

    /// Reads a number by name, in its unit.
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
    /// or one of its words; `set("AP 6", "12")` in the drive's own number, because the name is the maker's. Limits
    /// are checked before a byte is sent. Permanent memory is not written.
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
        self.start_write(name, value, store)?.finish().map(drop)
    }

    /// Starts to write a parameter by name, and does not wait for the reply.
    ///
    /// # Errors
    /// As [`set`](Self::set). Nothing was written.
    pub fn start_write(
        &self,
        name: &str,
        value: WriteValue,
        store: bool,
    ) -> Result<AxisRequest, Error> {
        let id = self.find(name)?;
        let value = match value {
            WriteValue::Amount(amount) => {
                WriteValue::Amount(self.interface.amount_for_name(name, id, amount)?)
            }
            raw @ WriteValue::Raw(_) => raw,
        };
        self.interface.start_write(id, &value, store)
    }

    /// Sends a request in the protocol's own text, and returns the value in the reply.
    ///
    /// # Errors
    /// As [`AxisMotion::start_raw`](super::AxisMotion::start_raw).
    pub fn raw(&self, text: &str) -> Result<i64, Error> {
        self.interface.start_raw(text)?.finish()?.raw(text)
    }

    /// Arms the axis: motion commands are allowed. [`armed`](Self::armed) does it for a scope.
    ///
    /// # Errors
    /// As [`AxisControl::arm`](super::AxisControl::arm).
    pub fn arm(&self) -> Result<(), Error> {
        self.interface.arm()
    }

    /// Disarms the axis.
    ///
    /// # Errors
    /// As [`AxisControl::disarm`](super::AxisControl::disarm).
    pub fn disarm(&self) -> Result<(), Error> {
        self.interface.disarm()
    }

    /// Returns whether this program armed the axis.
    #[must_use]
    pub fn is_armed(&self) -> bool {
        self.interface.is_armed()
    }

    /// Starts a verb, and does not wait for its end.
    ///
    /// # Errors
    /// As [`AxisMotion::start`](super::AxisMotion::start).
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

    /// Waits until the last move has arrived, at most for this time; false if it has not.
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
        if self.wait_reached(within)? {
            Ok(())
        } else {
            Err(Error::Failed {
                what: format!("{}: the move did not arrive in time", self.label()),
                execution: String::new(),
                outcome: Outcome::NotDone(Failure::NotReached),
                received: Box::default(),
                may_turn: false,
                hint: String::new(),
            })
        }
    }

    /// Stops the motor, and returns when standstill is confirmed.
    ///
    /// # Errors
    /// As [`AxisControl::stop`](super::AxisControl::stop).
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
    /// As [`AxisReadings::signals`](super::AxisReadings::signals).
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
    /// As [`AxisReadings::device_details`](super::AxisReadings::device_details).
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
    /// As [`AxisReadings::set_watchdog`](super::AxisReadings::set_watchdog).
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
