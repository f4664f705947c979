//! A drive as data: parameters, faults, signals and plans in tables, written as TOML and compiled to
//! constants.

mod address;
mod bits;
mod digits;
mod encoding;
mod motion;
mod scale;

use crate::medium::{MediumKind, SerialLine};
use crate::plan::{ARRIVAL, Plan};
use crate::units::Unit;
use crate::verb::Verb;

pub use crate::parameter_id::ParameterId;
pub use address::{ParameterAddress, encoding_word, parse_address_number, parse_encoding};
pub use bits::{BitName, bit_names};
pub use digits::{DigitDefect, DigitField};
pub use encoding::Encoding;
pub use motion::{CouplingParameters, MotionRules, RelativeBase};
pub use scale::{ComputeScale, NoScale, ObjectKey, Scale, ScaleRule, ScaleRuleValue};

/// The description of one product for the upper layers.
#[derive(Clone, Debug)]
pub struct Profile {
    /// The word users type: `tmcm-171`.
    pub name: &'static str,
    /// The family that implements it: `tmcm17x`; the protocol's name for its generic driver.
    pub family: &'static str,
    /// Protocol of the drive: `tmcl`, `modbus`.
    pub protocol: &'static str,
    /// The product's full name.
    pub title: &'static str,
    /// The manuals it was made from.
    pub source: &'static str,
    /// Rotary, linear or ratio.
    pub axis: AxisKind,
    /// Motors behind one address; 0 where that is not known.
    pub motors: u8,
    /// The profiles of the motors behind the first, where each has registers of its own.
    pub further_motors: &'static [&'static Self],
    /// Each motor of an address has places of its own, listed in the profile's file.
    pub lists_motors: bool,
    /// Named settings and readings. A [`ParameterId`] is an index into this table.
    pub parameters: &'static [Parameter],
    /// Faults and warnings in words.
    pub faults: &'static [Fault],
    /// The parameter of each signal.
    pub signals: &'static [SignalSource],
    /// The plan of each verb.
    pub plans: &'static [Plan],
    /// Rules for judging the end of a motion.
    pub motion: MotionRules,
    /// The setting that keeps writes out of permanent memory, where every write goes there otherwise.
    /// It applies to parameters of [`Persistence::UnlessRam`].
    pub ram: Option<RamMode>,
    /// Settings that decide how the drive is reached: address, baud rate, framing, locks. What
    /// copies settings from one drive to another leaves them alone.
    pub link_settings: &'static [ParameterId],
    /// Parameters that a drive of this profile may lack, because the standard leaves them optional. A drive
    /// without one is not at fault: see
    /// [`AxisDirectory::lacks_parameter`](crate::axis::AxisDirectory::lacks_parameter).
    pub optional: &'static [ParameterId],
    /// Reaction of the drive to the loss of the link.
    pub watchdog: Watchdog,
    /// Longest time the drive may take for a reply, ms.
    pub reply_timeout_ms: u32,
    /// On Modbus a single register is written by function 16, because the drive has no function 06.
    pub multiple_writes: bool,
    /// Serial line from the factory, where it differs from what is usual for the protocol.
    pub line: Option<SerialLine>,
    /// Checks before and after, in one paragraph, shown before the first motion.
    pub caution: &'static str,
    /// Identity that distinguishes it from other products of its protocol, by reads only.
    pub identity: Option<Identity>,
}

/// Compares texts in a constant, where `==` is not available.
const fn is_equal(one: &str, other: &str) -> bool {
    let (one, other) = (one.as_bytes(), other.as_bytes());
    if one.len() != other.len() {
        return false;
    }
    let mut n = 0;
    while n < one.len() {
        if one[n] != other[n] {
            return false;
        }
        n += 1;
    }
    true
}

impl Profile {
    /// The profile of a motor behind the same address, counted from 0.
    #[must_use]
    pub fn of_motor(&'static self, number: u8) -> &'static Self {
        let further = number.checked_sub(1).and_then(|n| self.further_motors.get(usize::from(n)));
        further.unwrap_or(&self)
    }

    /// The parameter of that id.
    #[must_use]
    pub fn parameter(&self, id: ParameterId) -> Option<&'static Parameter> {
        self.parameters.get(usize::from(id.0))
    }

    /// The parameter that a person means by `name`: its name or its symbol, letter case, spaces,
    /// hyphens and underscores ignored.
    #[must_use]
    pub fn find_parameter(&self, name: &str) -> Option<ParameterId> {
        let at = self
            .parameters
            .iter()
            .position(|p| same_name(p.name, name) || same_name(p.symbol, name))?;
        u16::try_from(at).ok().map(ParameterId)
    }

    /// The index of the parameter with this symbol, for a constant of the drive's firmware.
    ///
    /// # Panics
    /// Without such a symbol: in a constant this is an error of the compiler.
    #[must_use]
    pub const fn index_of(&self, symbol: &str) -> u16 {
        let mut n = 0;
        while n < self.parameters.len() {
            if is_equal(self.parameters[n].symbol, symbol) {
                return self.parameters[n].index;
            }
            n += 1;
        }
        panic!("the profile has no parameter with this symbol")
    }

    /// The index of the parameter with exactly this name, for a constant of the drive's firmware.
    ///
    /// # Panics
    /// Without such a name: in a constant this is an error of the compiler.
    #[must_use]
    pub const fn index_named(&self, name: &str) -> u16 {
        let mut n = 0;
        while n < self.parameters.len() {
            if is_equal(self.parameters[n].name, name) {
                return self.parameters[n].index;
            }
            n += 1;
        }
        panic!("the profile has no parameter with this name")
    }

    /// The parameter at an index and space.
    #[must_use]
    pub fn find_object(&self, (index, space): ObjectKey) -> Option<ParameterId> {
        let at = self.parameters.iter().position(|p| (p.index, p.space) == (index, space))?;
        u16::try_from(at).ok().map(ParameterId)
    }

    /// The source of a signal.
    #[must_use]
    pub fn signal(&self, signal: Signal) -> Option<&'static SignalSource> {
        self.signals.iter().find(|source| source.signal == signal)
    }

    /// The fault code in a raw value of the drive's fault signal. The value of a signed parameter is negative where
    /// the highest bit of the drive's word is set; that bit is a fault like any other.
    #[must_use]
    pub fn fault_word(&self, raw: i64) -> u32 {
        let source = self.signal(Signal::Fault);
        let parameter = source.and_then(|source| self.parameter(source.parameter));
        let word = raw as u32;
        match parameter.map_or(4, |parameter| parameter.encoding.size()) {
            1 => word & 0xFF,
            2 => word & 0xFFFF,
            _ => word,
        }
    }

    /// The faults of a code: the fault with that code, or each set bit where the drive reports faults as
    /// bits.
    pub fn faults_for_code(&self, code: u32) -> impl Iterator<Item = &'static Fault> + use<> {
        let faults = self.faults;
        let whole = faults.iter().any(|fault| fault.code == code);
        let bits = !whole && faults.iter().all(|fault| fault.code.is_power_of_two());
        faults
            .iter()
            .filter(move |fault| if bits { fault.code & code != 0 } else { fault.code == code })
    }

    /// The verbs that have a [plan](Self::plan).
    pub fn verbs(&'static self) -> impl Iterator<Item = Verb> {
        Verb::ALL.into_iter().filter(|verb| self.plan(*verb).is_some())
    }

    /// The plan for a verb. A drive that can move has one that waits for its arrival.
    #[must_use]
    pub fn plan(&self, verb: Verb) -> Option<&'static Plan> {
        let own = self.plans.iter().find(|plan| plan.verb == verb);
        match verb {
            Verb::Reached => own.or_else(|| {
                self.plans
                    .iter()
                    .any(|plan| plan.verb.is_move() || plan.verb == Verb::Home)
                    .then_some(&ARRIVAL)
            }),
            _ => own,
        }
    }
}

/// Returns whether two parameter names are the same: case, spaces, hyphens and underscores do not count.
#[must_use]
pub fn same_name(a: &str, b: &str) -> bool {
    fn plain(text: &str) -> impl Iterator<Item = u8> + '_ {
        let letters = text.bytes().filter(|c| !matches!(c, b' ' | b'_' | b'-'));
        letters.map(|c| c.to_ascii_lowercase())
    }
    plain(a).eq(plain(b))
}

/// A read whose reply identifies the product.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Identity {
    /// The request.
    pub query: IdentityQuery,
    /// Bits of the reply that identify the product; none when any valid reply does.
    pub mask: i64,
    /// Value of these bits.
    pub equals: i64,
    /// Bits of the reply with the firmware version; none when there are none.
    pub firmware: i64,
}

/// A request that identifies a drive. It changes nothing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum IdentityQuery {
    /// A parameter.
    Parameter(ParameterId),
    /// A request in the protocol's own text.
    Text(&'static str),
}

/// Role of a parameter in addressing its drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AddressRole {
    /// The drive's own address.
    Drive,
    /// The drive's own address, which holds from its next start on.
    DriveAfterRestart,
    /// The address of the host that it answers.
    Host,
}

/// The parameter and value that keep writes in RAM.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct RamMode {
    /// The parameter.
    pub parameter: ParameterId,
    /// The raw value that means RAM.
    pub ram: i64,
    /// The raw value that means permanent memory.
    pub flash: i64,
}

/// Kind of motion of an axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AxisKind {
    /// Positions in rad.
    Rotary,
    /// Positions in m.
    Linear,
    /// Positions, or the output, as a share of the whole.
    Ratio,
}

/// Reaction of a drive to the loss of its host.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Watchdog {
    /// None: the drive continues its last command.
    None,
    /// The drive stops after a time that cannot be set.
    Fixed {
        /// Time to the stop, ms.
        after_ms: u32,
    },
    /// The drive stops after the time written to a parameter, 0 = never.
    Configurable {
        /// The parameter that holds the time.
        parameter: ParameterId,
        /// The one that holds it for requests that come by CAN, where that is another.
        on_can: Option<ParameterId>,
    },
    /// The drive monitors the host's heartbeat (CiA 301, 7.2.8.3.2). A parameter selects the reaction.
    Heartbeat {
        /// Parameter with the sender of the heartbeat, and its longest pause: node-ID in bits 16 to 22, ms in bits 0 to
        /// 15; 0 in either is never (CiA 301, 1016h).
        consumer: ParameterId,
        /// Parameter with the reaction: 0 is nothing, 1 fault, 2 power off, 3 quick stop (CiA 402-2, 6007h).
        /// `None` for a drive that always stops.
        reaction: Option<ParameterId>,
        /// Parameters of life guarding, the older way: the period of the master's requests, and the number of them
        /// after which the drive reacts; 0 in either is never (CiA 301, 7.2.8.2.2, 100Ch and 100Dh).
        life_guarding: Option<[ParameterId; 2]>,
    },
    /// The drive knows life guarding alone.
    LifeGuarding {
        /// Period of the master's requests, and the number of them after which the drive reacts.
        objects: [ParameterId; 2],
        /// Parameter with the reaction, see [`Heartbeat`](Self::Heartbeat).
        reaction: Option<ParameterId>,
    },
}

impl Watchdog {
    /// The parameter with the time-out on that medium; `None` where there is none, or where it needs
    /// others as well.
    #[must_use]
    pub const fn time_parameter(self, medium: MediumKind) -> Option<ParameterId> {
        match (self, medium) {
            (Self::Configurable { on_can: Some(parameter), .. }, MediumKind::Can) => {
                Some(parameter)
            }
            (Self::Configurable { parameter, .. }, _) => Some(parameter),
            _ => None,
        }
    }
}

/// One named setting or reading of a drive.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// The word users type: `max current`.
    pub name: &'static str,
    /// Symbol in the manual: `AP 6`, `Fn_33`.
    pub symbol: &'static str,
    /// Purpose, in a sentence; empty where no source has one.
    pub about: &'static str,
    /// The protocol's address space: TMCL 0 = axis parameter, 1 + bank = global parameter;
    /// Modbus 0 = holding register, 1 = coil, 2 = discrete input, 3 = input register;
    /// TML 0 = data memory; CANopen the sub-index.
    pub space: u8,
    /// The protocol's number within the space.
    pub index: u16,
    /// Encoding of the raw value on the wire.
    pub encoding: Encoding,
    /// The unit of the value shown.
    pub unit: Unit,
    /// From raw to that unit.
    pub scale: Scale,
    /// Least raw value that may be written.
    pub min: i64,
    /// Greatest raw value that may be written.
    pub max: i64,
    /// Raw value from the factory, where known.
    pub default: Option<i64>,
    /// Read, written or both.
    pub access: Access,
    /// Persistence of a written value.
    pub persistence: Persistence,
    /// True if the product's own manual documents it.
    pub certainty: Certainty,
    /// True when writing it may start, change or enable motion: it needs an armed axis and is
    /// never sent twice.
    pub moves: bool,
    /// Chapter of the manual.
    pub section: &'static str,
    /// Names of raw values.
    pub values: &'static [(i64, &'static str)],
    /// Decimal digits with meanings of their own, from the right; empty for a number.
    pub digits: &'static [DigitField],
    /// Bits and groups of bits with names of their own; empty for a number.
    pub bits: &'static [BitName],
}

impl Parameter {
    /// Returns whether a raw value is within its limits, and each of its digits has a meaning.
    #[must_use]
    pub fn allows(&self, raw: i64) -> bool {
        self.encoding.is_between(raw, self.min, self.max) && self.digit_defect(raw).is_none()
    }

    /// Returns whether a raw value may be sent: limits that no manual states bind only what is given in a unit.
    #[must_use]
    pub fn allows_raw(&self, raw: i64) -> bool {
        let (min, max) = self.encoding.raw_range();
        let fits = !self.encoding.is_real() && self.encoding.is_between(raw, min, max);
        self.allows(raw)
            || self.certainty == Certainty::Inferred && fits && self.digit_defect(raw).is_none()
    }
}

/// Read, written or both.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Access {
    /// Can only be read.
    Read,
    /// Can only be written.
    Write,
    /// Both.
    ReadWrite,
}

/// Persistence of a written value.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Persistence {
    /// Gone with the power, or not a setting at all.
    Volatile,
    /// Gone with the power unless a store command saves it.
    Storable,
    /// Every write goes to flash or EEPROM.
    Always,
    /// Kept in flash, unless the drive was switched to keep writes in RAM.
    UnlessRam,
}

impl Persistence {
    /// Name in profiles.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Volatile => "volatile",
            Self::Storable => "storable",
            Self::Always => "always",
            Self::UnlessRam => "unless-ram",
        }
    }
}

/// Certainty of a fact.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Certainty {
    /// Documented in the product's own manual.
    Documented,
    /// Concluded from sibling products, drivers or the standard.
    Inferred,
    /// Present in the drive, without documentation.
    Undocumented,
}

/// One fault or warning.
#[derive(PartialEq, Eq, Debug)]
pub struct Fault {
    /// The drive's code, or the bit mask in its flag word.
    pub code: u32,
    /// The manual's short name.
    pub name: &'static str,
    /// Description of the fault.
    pub text: &'static str,
    /// Usual cause.
    pub cause: &'static str,
    /// Remedy.
    pub remedy: &'static str,
    /// A fault stops the drive, a warning does not.
    pub severity: Severity,
}

/// A fault stops the drive, a warning does not, a note is neither.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Severity {
    /// Information only, such as "position reached".
    Note,
    /// The drive goes on.
    Warning,
    /// The drive stopped.
    Fault,
}

/// A value that an axis reports about itself.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
#[repr(u8)]
pub enum Signal {
    /// Actual position.
    Position,
    /// Actual velocity.
    Velocity,
    /// Actual torque, or the value used for it.
    Torque,
    /// Motor current.
    Current,
    /// Supply voltage.
    Voltage,
    /// Temperature of the power stage.
    Temperature,
    /// Commanded position.
    TargetPosition,
    /// Commanded velocity.
    TargetVelocity,
    /// Fault code or fault bits; zero is none.
    Fault,
    /// True while the motor is powered.
    Enabled,
    /// True while a move, path or homing runs.
    Moving,
    /// True when the last move arrived.
    Reached,
    /// Mode of operation.
    Mode,
    /// Clock of the drive, which drives of a bus may synchronise.
    Time,
    /// True while a limit switch or a limit of the drive holds the motor at the positive end.
    PositiveLimit,
    /// State of the limit switch at the negative end. Both are true if the drive does not report which end it is.
    NegativeLimit,
}

impl Signal {
    /// Number of signals.
    pub const COUNT: usize = 16;
    /// Every signal, in order.
    pub const ALL: [Self; Self::COUNT] = [
        Self::Position,
        Self::Velocity,
        Self::Torque,
        Self::Current,
        Self::Voltage,
        Self::Temperature,
        Self::TargetPosition,
        Self::TargetVelocity,
        Self::Fault,
        Self::Enabled,
        Self::Moving,
        Self::Reached,
        Self::Mode,
        Self::Time,
        Self::PositiveLimit,
        Self::NegativeLimit,
    ];

    /// The signal of a [`name`](Self::name).
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|signal| signal.name() == name)
    }

    /// True for measured or computed values, false for flags and codes.
    #[must_use]
    pub const fn is_measured(self) -> bool {
        !self.is_limit()
            && !matches!(
                self,
                Self::Fault | Self::Enabled | Self::Moving | Self::Reached | Self::Mode
            )
    }

    /// True for the two limits.
    #[must_use]
    pub const fn is_limit(self) -> bool {
        matches!(self, Self::PositiveLimit | Self::NegativeLimit)
    }

    /// The word users type.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Torque => "torque",
            Self::Current => "current",
            Self::Voltage => "voltage",
            Self::Temperature => "temperature",
            Self::TargetPosition => "target position",
            Self::TargetVelocity => "target velocity",
            Self::Fault => "fault",
            Self::Enabled => "enabled",
            Self::Moving => "moving",
            Self::Reached => "reached",
            Self::Mode => "mode",
            Self::Time => "time",
            Self::PositiveLimit => "positive limit",
            Self::NegativeLimit => "negative limit",
        }
    }
}

/// Source of a signal: `P(parameter) & mask`, as a flag if `flag` is set.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SignalSource {
    /// The signal.
    pub signal: Signal,
    /// The parameter to read.
    pub parameter: ParameterId,
    /// Bits that count; all ones for a number.
    pub mask: i64,
    /// For a flag: the masked value that means true. `None` for a number, whose masked bits are its value, and
    /// for a flag that any of its bits sets.
    pub equals: Option<i64>,
    /// Names of masked values, where the parameter's own names are not for them.
    pub values: &'static [(i64, &'static str)],
}

impl SignalSource {
    /// True if the signal is a flag here.
    #[must_use]
    pub const fn is_flag(&self) -> bool {
        self.equals.is_some()
            || self.signal.is_limit()
            || matches!(self.signal, Signal::Enabled | Signal::Moving | Signal::Reached)
    }

    /// The flag in a raw value of the parameter.
    #[must_use]
    pub fn is_set(&self, raw: i64) -> bool {
        let masked = raw & self.mask;
        self.equals.map_or(masked != 0, |equals| masked == equals)
    }
}
