//! An axis of any CANopen drive, from its profile alone.
//!
//! A parameter is an object: its index, and as space its sub-index. In plans,
//! `send FUNCTION INDEX VALUE`: function 0 orders the state that INDEX names (1 start, 2 stop, 128
//! pre-operational, 129 reset, 130 reset communication), 1 to 4 sends VALUE in INDEX bytes as that
//! RPDO, 5 sends SYNC, 6 switches RPDO INDEX on (VALUE 1, with its usual identifier) or off (0), 7
//! the TPDO, 8 has the drive watch the host's heartbeat, which comes within INDEX ms, 9 takes that
//! back, 10 gives the connection option (6007h) the value that it had when it was read.

use super::ask::{Answer, Ask};
use super::cob::Cob;
use super::emcy::Emergency;
use super::generic::GENERIC;
use super::host::{HOST_ID, Host, sender};
use super::mapped::Mapped;
use super::nmt::{Command, Order, State};
use super::pdo::{CobId, Field, frame_bits};
use super::sdo::{Abort, Object};
use super::{NODE_MAX, text};
use crate::axis::{Driver, Presence, TOLD_MAX, Told};
use crate::error::{Failure, Unsupported};
use crate::explain::Raw;
use crate::medium::{Can, Frame};
use crate::profile::{Encoding, Parameter, ParameterId, Profile, Severity, Signal};
use crate::proto::{HostOptions, Protocol};
use crate::station::Class;
use crate::stream::cyclic::{self, Setpoint};

/// Object 1010h:1, and what is written there: store everything.
const STORE: (Object, u64) = (Object::new(0x1010, 1), 0x6576_6173);
/// What [`Driver::send`] calls SYNC.
const SEND_SYNC: u8 = 5;
const SWITCH_RPDO: u8 = 6;
const SWITCH_TPDO: u8 = 7;
const WATCH: u8 = 8;
const WATCH_NO_MORE: u8 = 9;
const GIVE_OPTION_BACK: u8 = 10;
const CONTROLWORD: u16 = 0x6040;
/// What a lost connection leads to (CiA 402-2), and quick stop among it.
const CONNECTION_OPTION: Object = Object::new(0x6007, 0);
const QUICK_STOP: u16 = 3;
const CONSUMER: Object = Object::new(0x1016, 1);

/// One node.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    profile: &'static Profile,
    node: u8,
    /// How the node's process data lie, as far as was read or written.
    rpdos: [Mapped; 4],
    tpdos: [Mapped; 4],
    /// What brings each kind of set-point.
    bringers: [Option<Bringer>; 3],
    /// It watches the host's heartbeat because it was told to.
    watches: bool,
    /// What the connection option was before it was made a quick stop.
    option: Option<u16>,
}

/// An RPDO that brings a set-point and the controlword.
#[derive(Clone, Copy, Debug)]
struct Bringer {
    target: ParameterId,
    number: u8,
    bytes: u8,
    place: Field,
    control: Field,
}

impl Axis {
    /// The node of that number.
    #[must_use]
    pub const fn new(profile: &'static Profile, address: u32) -> Self {
        let (rpdos, tpdos) = ([Mapped::UNKNOWN; 4], [Mapped::UNKNOWN; 4]);
        Self {
            profile,
            node: address as u8,
            rpdos,
            tpdos,
            bringers: [None; 3],
            watches: false,
            option: None,
        }
    }

    /// What the node's fault code is from now on, unless it is a note.
    fn fault(&self, code: u16) -> Option<Told> {
        let known = self.profile.faults.iter().find(|fault| fault.code == u32::from(code));
        if known.is_some_and(|fault| fault.severity == Severity::Note) {
            return None;
        }
        Some(match self.profile.signal(Signal::Fault) {
            Some(source) if source.equals.is_none() => {
                Told::Parameter(source.parameter, code.into())
            }
            _ => Told::Signal(Signal::Fault, code.into()),
        })
    }

    /// Takes what was read or written of a PDO.
    fn learn(&mut self, object: Object, bits: u64) {
        let pdos = match object.index {
            0x1400..=0x17FF => &mut self.rpdos,
            0x1800..=0x1BFF => &mut self.tpdos,
            _ => return,
        };
        let Some(pdo) = pdos.get_mut(usize::from(object.index & 0x1FF)) else { return };
        match (object.index & 0x200 != 0, object.sub) {
            (true, sub) => pdo.learn(sub, bits as u32, self.profile),
            (false, 1) => pdo.on = bits as u32 & CobId::INVALID == 0,
            _ => return,
        }
        self.bringers = SETPOINTS.map(|setpoint| self.bringer(setpoint));
    }

    fn learn_read(&mut self, object: Object, bits: u64) {
        if object == CONNECTION_OPTION && bits as u16 != QUICK_STOP {
            self.option = Some(bits as u16);
        }
        self.learn(object, bits);
    }

    fn learn_written(&mut self, object: Object, bits: u64) {
        if object == CONSUMER {
            self.watches = bits != 0;
        }
        self.learn(object, bits);
    }

    fn parameter(&self, index: u16) -> Option<ParameterId> {
        let is = |p: &Parameter| (p.index, p.space) == (index, 0);
        self.profile.parameters.iter().position(is).map(|at| ParameterId(at as u16))
    }

    fn bringer(&self, setpoint: Setpoint) -> Option<Bringer> {
        let target = self.parameter(target(setpoint))?;
        let control = self.parameter(CONTROLWORD)?;
        (1..).zip(&self.rpdos).filter(|(_, pdo)| pdo.on).find_map(|(number, pdo)| {
            let (place, control) = (pdo.field(target)?, pdo.field(control)?);
            Some(Bringer { target, number, bytes: pdo.bytes(), place, control })
        })
    }

    /// Switches PDO `number` on or off.
    fn switch(&self, sends: bool, number: u16, on: bool) -> Result<Ask, Unsupported> {
        let n = u8::try_from(number).ok().filter(|n| (1..=4).contains(n));
        let n = n.ok_or(Unsupported::BadArgument)?;
        let (cob, base) = match sends {
            true => (Cob::Tpdo(n, self.node), 0x17FF),
            false => (Cob::Rpdo(n, self.node), 0x13FF),
        };
        let off = if on { 0 } else { CobId::INVALID };
        let bits = u64::from(u32::from(cob.id()) | off);
        Ok(self.put(Object::new(base + number, 1), bits, 4))
    }

    const fn put(&self, object: Object, bits: u64, len: u8) -> Ask {
        Ask::Write { node: self.node, object, bits, len, class: Class::Confirm }
    }

    const fn ask(&self, object: Object) -> Ask {
        Ask::Read { node: self.node, object }
    }
}

/// In the order of their numbers.
const SETPOINTS: [Setpoint; 3] = [Setpoint::Position, Setpoint::Velocity, Setpoint::Torque];

/// The object that is commanded cycle by cycle (CiA 402-2).
const fn target(setpoint: Setpoint) -> u16 {
    match setpoint {
        Setpoint::Position => 0x607A,
        Setpoint::Velocity => 0x60FF,
        Setpoint::Torque => 0x6071,
    }
}

/// The controlword that goes with a set-point: enable operation, or quick stop.
const fn controlword(order: cyclic::Order) -> u64 {
    match order {
        cyclic::Order::Go => 0x0F,
        cyclic::Order::Stop => 0x02,
    }
}

/// The object that a parameter is.
const fn object(parameter: &Parameter) -> Object {
    Object { index: parameter.index, sub: parameter.space }
}

/// Bytes of an encoding, and whether it is signed.
#[must_use]
pub const fn width(encoding: Encoding) -> (u8, bool) {
    match encoding {
        Encoding::Bit | Encoding::U8 => (1, false),
        Encoding::I8 => (1, true),
        Encoding::U16 => (2, false),
        Encoding::I16 => (2, true),
        Encoding::U32 => (4, false),
        Encoding::I32 | Encoding::I32LowFirst | Encoding::Fixed | Encoding::TensAndThousandths => {
            (4, true)
        }
    }
}

/// The number that `len` bytes are; all eight when the node does not say how many.
const fn number(bits: u64, len: u32, signed: bool) -> i64 {
    let len = if len == 0 || len > 8 { 8 } else { len };
    let above = 64 - 8 * len;
    match signed {
        true => (bits << above).cast_signed() >> above,
        false => (bits << above >> above).cast_signed(),
    }
}

impl Driver for Axis {
    type Request = Ask;
    type Answer = Answer;

    fn profile(&self) -> &'static Profile {
        self.profile
    }

    fn address(&self) -> u32 {
        self.node.into()
    }

    fn read(&self, parameter: &Parameter) -> Result<Ask, Unsupported> {
        Ok(Ask::Read { node: self.node, object: object(parameter) })
    }

    fn write(&self, parameter: &Parameter, raw: i64, class: Class) -> Result<Ask, Unsupported> {
        let (len, _) = width(parameter.encoding);
        let bits = raw.cast_unsigned() & u64::MAX >> (64 - 8 * u32::from(len));
        Ok(Ask::Write { node: self.node, object: object(parameter), bits, len, class })
    }

    fn send(&self, function: u8, index: u16, value: i64) -> Result<Ask, Unsupported> {
        let node = self.node;
        Ok(match function {
            0 => {
                let specifier = u8::try_from(index).map_err(|_| Unsupported::BadArgument)?;
                match Command::from(specifier) {
                    Command::Other(_) => return Err(Unsupported::BadArgument),
                    command => Ask::Order(Order { command, node }),
                }
            }
            1..=4 if (1..=8).contains(&index) => {
                let data = value.cast_unsigned();
                Ask::Process { cob: Cob::Rpdo(function, node), data, len: index as u8 }
            }
            SEND_SYNC => Ask::Sync(None),
            SWITCH_RPDO => self.switch(false, index, value != 0)?,
            SWITCH_TPDO => self.switch(true, index, value != 0)?,
            WATCH => Ask::Watch { node, ms: index },
            // What was not set is not taken back, only asked.
            WATCH_NO_MORE if self.watches => Ask::Watch { node, ms: 0 },
            WATCH_NO_MORE => self.ask(CONSUMER),
            GIVE_OPTION_BACK => match self.option {
                Some(option) => self.put(CONNECTION_OPTION, option.into(), 2),
                None => self.ask(CONNECTION_OPTION),
            },
            _ => return Err(Unsupported::Forbidden("no such CANopen function in plans")),
        })
    }

    /// Everything is kept at once: CANopen keeps no object by itself.
    fn keep(&self, _parameter: &Parameter) -> Result<Ask, Unsupported> {
        let (object, bits) = STORE;
        Ok(Ask::Write { node: self.node, object, bits, len: 4, class: Class::Never })
    }

    fn parse(&self, text: &str) -> Result<Ask, Unsupported> {
        text::request(text, self.node).ok_or(Unsupported::BadText)
    }

    fn decode(&self, frame: &Raw<'_>) -> Result<Ask, Unsupported> {
        let id = frame.id.filter(|_| !frame.extended && frame.bytes.len() <= 8);
        let id = id.and_then(|id| u16::try_from(id).ok()).ok_or(Unsupported::BadBytes)?;
        let frame = Frame::standard(id, frame.bytes);
        let said = text::Said::of(&frame, false).map_err(|_| Unsupported::BadBytes)?;
        // What it says does not say to whom.
        let ask = if said.frame(self.node) == frame { said.ask(self.node) } else { None };
        ask.ok_or(Unsupported::BadBytes)
    }

    fn answer(&mut self, parameter: Option<&Parameter>, answer: &Answer) -> Result<i64, Failure> {
        let encoding = parameter.map(|parameter| width(parameter.encoding));
        match *answer {
            Answer::Value { object, bits, len } => {
                self.learn_read(object, bits);
                // Of what has no length the profile's counts: the TS pads with zeros.
                let (width, signed) = encoding.unwrap_or((0, false));
                Ok(number(bits, if len == 0 { width.into() } else { len }, signed))
            }
            Answer::Written { object, bits } => {
                self.learn_written(object, bits);
                let (width, signed) = encoding.unwrap_or((0, false));
                Ok(number(bits, width.into(), signed))
            }
            Answer::Transferred(count) => Ok(count.into()),
            Answer::State(state) => Ok(u8::from(state).into()),
            Answer::Identity([_, _, _, serial]) => Ok(serial.into()),
            Answer::Lss(reply) => text::outcome(reply),
            Answer::Sent | Answer::Lost | Answer::Emergency(_) | Answer::Process(..) => Ok(0),
        }
    }

    /// The aborts that a device gives for an object or a sub-index that it does not have.
    fn lacks(&self, code: u32) -> bool {
        matches!(Abort(code), Abort::NO_OBJECT | Abort::NO_SUB)
    }

    fn unasked(&mut self, answer: &Answer) -> [Option<Told>; TOLD_MAX] {
        let mut told = [None; TOLD_MAX];
        match *answer {
            Answer::State(state) => {
                if state == State::BootUp {
                    *self = Self::new(self.profile, self.node.into());
                }
                told[0] = presence(state).map(Told::Presence);
            }
            Answer::Lost => told[0] = Some(Told::Presence(Presence::Gone)),
            Answer::Emergency(Emergency { code, .. }) => told[0] = self.fault(code),
            Answer::Process(number @ 1..=4, data, len) => {
                return self.tpdos[usize::from(number) - 1].told(data, len);
            }
            _ => {}
        }
        told
    }

    /// The mappings of TPDOs, entries first: the count makes one whole.
    fn unlearnt(&self, n: usize) -> Option<ParameterId> {
        let unknown = (0_u16..4).filter(|pdo| self.tpdos[usize::from(*pdo)].bytes() == 0);
        let objects =
            unknown.flat_map(|pdo| (1..=8).chain([0]).map(move |sub| (0x1A00 + pdo, sub)));
        let parameters = self.profile.parameters;
        let known = |object| parameters.iter().position(|p| (p.index, p.space) == object);
        objects.filter_map(known).nth(n).map(|id| ParameterId(id as u16))
    }

    fn followed(&self, setpoint: Setpoint) -> Option<ParameterId> {
        self.bringers[setpoint as usize].map(|bringer| bringer.target)
    }

    fn follow(&self, setpoint: Setpoint, raw: i64, order: cyclic::Order) -> Option<Ask> {
        let Bringer { number, bytes, place, control, .. } = self.bringers[setpoint as usize]?;
        let data = control.put(place.put(0, raw.cast_unsigned()), controlword(order));
        Some(Ask::Process { cob: Cob::Rpdo(number, self.node), data, len: bytes })
    }

    fn beat(&self) -> Option<Ask> {
        Some(Ask::Sync(None))
    }

    fn cycle_bits(&self) -> (u32, u32) {
        let pdos = self.rpdos.iter().chain(&self.tpdos).filter(|pdo| pdo.on && pdo.bytes() > 0);
        (pdos.map(|pdo| frame_bits(pdo.bytes())).sum(), frame_bits(0))
    }
}

/// A node's state in the words that all protocols have.
const fn presence(state: State) -> Option<Presence> {
    Some(match state {
        State::BootUp => Presence::Restarted,
        State::PreOperational => Presence::Preparing,
        State::Operational => Presence::Operating,
        State::Stopped => Presence::Halted,
        State::Other(_) => return None,
    })
}

/// CANopen as the registry knows it.
#[derive(Debug)]
pub enum Canopen {}

impl Protocol for Canopen {
    type Medium = Can;
    type Host = Host;
    const NAME: &'static str = "canopen";
    const PROFILE: &'static str = "canopen";
    const ADDRESSES: core::ops::RangeInclusive<u32> = 1..=NODE_MAX as u32;
    const EVERY_ADDRESS: core::ops::RangeInclusive<u32> = 1..=NODE_MAX as u32;
    const HOST: Option<u32> = Some(HOST_ID as u32);
    /// The TS's (manual, 3.2); many others have no fixed one.
    const BAUD: u32 = 500_000;

    fn generic() -> &'static Profile {
        &GENERIC
    }

    fn host(options: &HostOptions, _axes: &[u32]) -> Host {
        Host::new(options)
    }

    fn driver(
        profile: &'static Profile,
        address: u32,
    ) -> impl Driver<Request = Ask, Answer = Answer> + Send + 'static {
        Axis::new(profile, address)
    }

    /// The pre-defined connection set of CiA 301, and what LSS and NMT have for everybody.
    fn uses(address: u32, id: u32, extended: bool) -> bool {
        let everybody = matches!(id, 0x000 | 0x080 | 0x100 | 0x7E4 | 0x7E5);
        // EMCY, four PDOs each way, SDO each way, heartbeat.
        let of_node = matches!(id >> 7, 1 | 3..=12 | 14) && id & 0x7F == address;
        !extended && (everybody || of_node)
    }

    fn sender(options: &HostOptions, frame: &Frame) -> Option<u32> {
        sender(options, frame)
    }
}
