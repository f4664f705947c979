//! One axis interface for every link: an axis on a wire of this program, and an axis of a running gateway.
//!
//! ```
//! # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
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
mod axis_facts;
mod axis_handle;
mod latest;
mod link;
mod local_axis;
mod motion;
mod reading;
#[cfg(feature = "remote")]
pub mod remote;
mod request;

use std::fmt;
use std::ops::ControlFlow;
use std::time::Duration;

use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::{ParameterId, Signal};
use polepair_core::time::Instant;
use polepair_core::units::Unit;

pub use armed::Armed;
pub use axis_facts::{AxisFacts, ParameterDescription, WatchdogKind};
pub use axis_handle::Axis;
pub use latest::LatestValue;
pub use link::{Link, connect, is_gateway};
pub use motion::{EndedMotion, MotionMonitor, start_each, stop_each};
pub use reading::{
    AxisSnapshot, FaultReport, MotionState, ReadValue, Reply, SignalReading, WatchdogReport,
};
pub use request::AxisRequest;

use crate::amount::Amount;
pub use crate::amount::WriteValue;
use crate::axis::{DeviceDetail, LocalAxis, NamedValue, WriteChange};
use crate::error::Error;

/// Parameters of an axis: names, values, and writes of several together.
pub trait AxisParameters {
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

    /// The amount that a caller means who wrote `name` for the parameter. Behind our name a bare number is in the
    /// parameter's unit. Behind the maker's symbol or a number (`AP 6`, `CSPD`, `0x6083`), text without a unit
    /// becomes [`Amount::Own`], because that is what the maker's manual and programs write there, and a number
    /// becomes [`Amount::Either`], because reading the same symbol gives a number in the unit.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for an id that the drive does not have; [`Error::Gateway`].
    fn amount_for_name(&self, name: &str, id: ParameterId, amount: Amount)
    -> Result<Amount, Error>;

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

    /// Reads a parameter of any kind: a number in its unit, text, or bytes.
    ///
    /// # Errors
    /// By source.
    fn read(&self, id: ParameterId) -> Result<ReadValue, Error>;

    /// Reads a parameter of each drive that the axis addresses, with the drive's number: one, or the members
    /// of a group.
    ///
    /// # Errors
    /// By source.
    fn read_each(&self, id: ParameterId) -> Result<Vec<(u32, ReadValue)>, Error>;

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

    /// The changes that writing values for several parameters would make. The present values are read; nothing is
    /// written.
    ///
    /// # Errors
    /// As [`write_all`](Self::write_all).
    fn plan_changes(&self, values: &[NamedValue]) -> Result<Vec<WriteChange>, Error>;

    /// Writes values for several parameters, those first that scale others; `store` also stores them in permanent
    /// memory. Each value is checked before the first one is written. `each` is called after a parameter was
    /// written, and ends the writing with [`ControlFlow::Break`].
    ///
    /// # Errors
    /// Nothing was written: `E213`, `E214`, `E216`, `E217` for the name, the access, the limits or the meaning of a
    /// value, and `E219` for what moves an unarmed axis. Others by source, after the writes before.
    fn write_all(
        &self,
        values: &[NamedValue],
        store: bool,
        each: &mut dyn FnMut(&WriteChange) -> ControlFlow<()>,
    ) -> Result<(), Error>;
}

/// Verbs of an axis, their arguments, and the motion that they start.
pub trait AxisMotion {
    /// The unit in which an argument of a verb is shown, and meant if none is given. `None` if the verb has no
    /// use for the argument.
    fn unit_of(&self, verb: Verb, which: Argument) -> Option<Unit>;

    /// The SI value of an argument of a verb.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217` for a wrong unit, `E218` if the verb does not take the argument.
    fn argument(&self, verb: Verb, which: Argument, amount: &Amount) -> Result<f64, Error>;

    /// Starts a verb. The request ends when the verb has ended.
    ///
    /// # Errors
    /// Nothing was sent: `E218` for a drive without the verb, `E219` for an unarmed axis.
    fn start(&self, command: Command) -> Result<AxisRequest, Error>;

    /// Starts a request in the protocol's own text: `GAP 1`, `read 0x6041:0`.
    ///
    /// # Errors
    /// `E221` for text that is no request, `E222` for one that may move the motor.
    fn start_raw(&self, text: &str) -> Result<AxisRequest, Error>;

    /// Checks a command as far as possible without sending it.
    ///
    /// # Errors
    /// As [`start`](Self::start). A gateway checks values when the command is started.
    fn check_command(&self, command: Command) -> Result<(), Error>;

    /// Writes the operation mode of a verb before the axis is enabled: some drives change their mode only
    /// without power. A gateway does this itself.
    ///
    /// # Errors
    /// [`Error`] by source.
    fn prepare_mode(&self, _verb: Verb) -> Result<(), Error> {
        Ok(())
    }

    /// Readings that show whether the motor still follows its command. A drive on a wire of this program is read; a
    /// gateway has sent them already, and those older than `since` are left out. The speed is read if `velocity` is
    /// true.
    ///
    /// # Errors
    /// Errors by source; `E401` if the gateway has not received the drive lately.
    fn motion_state(&self, since: Instant, velocity: bool) -> Result<MotionState, Error>;
}

/// Control of an axis: arming, stops and release.
pub trait AxisControl {
    /// Arms the axis: motion commands are allowed. On a gateway this acquires the lease.
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

    /// Returns whether this program armed the axis, and its motion commands are allowed.
    fn is_armed(&self) -> bool;

    /// Checks that this program still controls the axis that it armed. Nothing is sent.
    ///
    /// # Errors
    /// [`Error::Gateway`] if the lease has ended (`gateway.lease`), or the gateway or its link is lost (`E313`).
    /// [`Error::may_turn`] states whether the motor may still turn.
    fn check_control(&self) -> Result<(), Error> {
        Ok(())
    }

    /// Stops the motor, and returns when standstill is confirmed. An axis of a gateway is stopped also if another
    /// client commands it.
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
}

/// Signals, faults and facts that are read from the drive.
pub trait AxisReadings {
    /// The SI unit of a signal as text; empty for flags, codes and modes.
    fn signal_unit(&self, signal: Signal) -> String;

    /// Reads signals now.
    ///
    /// # Errors
    /// `E213` for a signal that the drive does not report; others by source.
    fn signals(&self, signals: &[Signal]) -> Result<Vec<SignalReading>, Error>;

    /// Reads a signal, as people read it: in the drive's unit, with the digits that it resolves. `None` if the drive
    /// does not report it.
    ///
    /// # Errors
    /// By source.
    fn signal_text(&self, signal: Signal) -> Result<Option<String>, Error>;

    /// A value of a signal in SI, as people read it. `None` for a signal that the drive does not report, or in an
    /// unknown scale.
    fn format_signal(&self, signal: Signal, si: f64) -> Option<String>;

    /// The latest value of a signal or parameter by its name, for a caller that reads it `hz` times a second.
    ///
    /// # Errors
    /// `E213` with the nearest name; others by source.
    fn latest_value(&self, name: &str, hz: f64) -> Result<LatestValue, Error>;

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

    /// Sets the time without a message of its host after which the drive's watchdog stops it; `None` switches it off.
    ///
    /// # Errors
    /// `E213` for a drive without a watchdog that can be set; others by source.
    fn set_watchdog(&self, after: Option<Duration>) -> Result<WatchdogReport, Error>;
}

/// Methods of an axis on any wire: of this program, or of a gateway.
///
/// Times and values are SI. Requests are sent once. Errors have a stable code ([`Error::code`]) and state
/// whether the drive may have executed the request ([`Error::executed`]).
pub trait AxisInterface:
    fmt::Debug + Send + Sync + AxisParameters + AxisMotion + AxisControl + AxisReadings
{
    /// Facts on the axis without a request.
    fn facts(&self) -> AxisFacts;

    /// The axis, if its wire is opened by this program.
    fn local(&self) -> Option<&LocalAxis> {
        None
    }

    /// The axis, if it belongs to a gateway.
    #[cfg(feature = "remote")]
    fn remote(&self) -> Option<&crate::interface::remote::RemoteAxis> {
        None
    }

    /// The last known state. Nothing is sent to the drive.
    ///
    /// # Errors
    /// [`Error::Gateway`] if a gateway does not answer.
    fn state(&self) -> Result<AxisSnapshot, Error>;

    /// The time of the link's clock.
    fn now(&self) -> Instant;

    /// Waits on the link's clock; in virtual time it returns at once.
    fn sleep(&self, span: Duration);
}

/// The error for what only a program with the wire itself can do.
pub(crate) fn not_on_gateway(what: &str, hint: &str) -> Error {
    let hint = match hint {
        "" => "open the link in this program; end the gateway first",
        hint => hint,
    };
    Error::usage("E257", format!("a gateway does not offer {what}"), hint)
}
