//! An axis of any CANopen drive, from its profile alone.
//!
//! A parameter is an object: its index, and as space its sub-index. In plans,
//! `send FUNCTION INDEX VALUE`: function 0 orders the state that INDEX names (1 start, 2 stop, 128
//! pre-operational, 129 reset, 130 reset communication), 1 to 4 sends VALUE in INDEX bytes as that
//! RPDO, 5 sends SYNC, 6 switches RPDO INDEX on (VALUE 1, with its usual identifier) or off (0), 7
//! the TPDO, 8 has the drive watch the host's heartbeat, which comes within INDEX ms, 9 takes that
//! back, 10 gives the connection option (6007h) the value that it had when it was read.

use super::address::{axis_index, axis_offset};
use super::cob::Cob;
use super::emcy::Emergency;
use super::generic::GENERIC;
use super::host::{CanHost, HOST_ID, frame_sender};
use super::host_request::{Answer, HostRequest};
use super::known_pdo::KnownPdo;
use super::nmt::{NmtCommand, NmtMessage, NmtState};
use super::pdo::{BitField, CobId, max_frame_bits};
use super::sdo::{AbortCode, ObjectIndex, SdoRequest};
use super::{NODE_MAX, text};
use crate::axis::{
    AnswerDecoder, CyclicDriver, DataDriver, DriveReport, Driver, Presence, REPORTS_MAX, Refusal,
    RequestEncoder, WriteRules,
};
use crate::error::{Failure, Unsupported};
use crate::explain::RawFrame;
use crate::medium::{Can, Frame};
use crate::profile::{Encoding, Parameter, ParameterId, Profile, Severity, Signal};
use crate::proto::options::{self, OptionKey, OptionKind};
use crate::proto::{HostOptions, Protocol, drive_address, sub_axis, with_sub_axis};
use crate::station::RequestClass;
use crate::stream::cyclic::{self, SetpointKind};

/// Object 1010h:1, and the value that stores everything.
const STORE_ALL: (ObjectIndex, u64) = (ObjectIndex::new(0x1010, 1), 0x6576_6173);
/// Number of SYNC in [`Driver::function_request`].
const SEND_SYNC: u8 = 5;
const SWITCH_RPDO: u8 = 6;
const SWITCH_TPDO: u8 = 7;
const WATCH_HEARTBEAT: u8 = 8;
const UNWATCH_HEARTBEAT: u8 = 9;
const RESTORE_CONNECTION_OPTION: u8 = 10;
const CONTROLWORD: ObjectIndex = ObjectIndex::new(0x6040, 0);
/// Controlword that ends a motion: quick stop.
const STOP_WORD: u16 = 0x02;
/// Set-point of the interpolated position mode.
const INTERPOLATION_RECORD: ObjectIndex = ObjectIndex::new(0x60C1, 1);
/// Reaction to a lost connection (CiA 402-2), among them quick stop.
const CONNECTION_OPTION: ObjectIndex = ObjectIndex::new(0x6007, 0);
const OPTION_QUICK_STOP: u16 = 3;
const CONSUMER_HEARTBEAT: ObjectIndex = ObjectIndex::new(0x1016, 1);

/// One axis of a node.
#[derive(Clone, Copy, Debug)]
pub struct CanopenDriver {
    profile: &'static Profile,
    node: u8,
    /// Axis of the node; 0 is the first.
    sub_axis: u8,
    /// Offset of the axis' objects from those of the profile.
    offset: u16,
    /// Mappings of the node's process data, as far as they were read or written.
    rpdos: [KnownPdo; 4],
    tpdos: [KnownPdo; 4],
    /// PDO of each kind of set-point.
    setpoint_pdos: [Option<SetpointPdo>; 3],
    /// True if it was set to watch the host's heartbeat.
    watches_host: bool,
    /// Connection option before it was set to quick stop.
    original_option: Option<u16>,
}

/// An RPDO that brings a set-point and the controlword.
#[derive(Clone, Copy, Debug)]
struct SetpointPdo {
    target: ParameterId,
    /// Controlword that makes the drive follow: enable operation, in the interpolated position mode with bit 4.
    follow_word: u16,
    number: u8,
    bytes: u8,
    target_field: BitField,
    controlword_field: BitField,
}

impl CanopenDriver {
    /// The axis of that address: the node, and which of its axes.
    #[must_use]
    pub const fn new(profile: &'static Profile, address: u32) -> Self {
        let (rpdos, tpdos) = ([KnownPdo::UNKNOWN; 4], [KnownPdo::UNKNOWN; 4]);
        let offset = if profile.lists_motors { 0 } else { axis_offset(sub_axis(address)) };
        Self {
            profile,
            node: address as u8,
            sub_axis: sub_axis(address),
            offset,
            rpdos,
            tpdos,
            setpoint_pdos: [None; 3],
            watches_host: false,
            original_option: None,
        }
    }

    /// The report of the node's present fault code, unless the code is a note.
    fn fault_report(&self, code: u16) -> Option<DriveReport> {
        let known = self.profile.faults.iter().find(|fault| fault.code == u32::from(code));
        if known.is_some_and(|fault| fault.severity == Severity::Note) {
            return None;
        }
        Some(match self.profile.signal(Signal::Fault) {
            Some(source) if source.equals.is_none() => {
                DriveReport::Parameter(source.parameter, code.into())
            }
            _ => DriveReport::Signal(Signal::Fault, code.into()),
        })
    }

    /// Updates the known PDO mapping from an object that was read or written.
    fn learn_pdo(&mut self, object: ObjectIndex, bits: u64) {
        let pdos = match object.index {
            0x1400..=0x17FF => &mut self.rpdos,
            0x1800..=0x1BFF => &mut self.tpdos,
            _ => return,
        };
        let Some(pdo) = pdos.get_mut(usize::from(object.index & 0x1FF)) else { return };
        match (object.index & 0x200 != 0, object.sub) {
            (true, sub) => {
                pdo.learn(sub, bits as u32, self.profile, self.offset);
            }
            (false, 1) => pdo.enabled = bits as u32 & CobId::INVALID == 0,
            _ => return,
        }
        self.setpoint_pdos = SETPOINTS.map(|setpoint| self.find_setpoint_pdo(setpoint));
    }

    fn learn_read(&mut self, object: ObjectIndex, bits: u64) {
        if object == self.own_object(CONNECTION_OPTION) && bits as u16 != OPTION_QUICK_STOP {
            self.original_option = Some(bits as u16);
        }
        self.learn_pdo(object, bits);
    }

    fn learn_written(&mut self, object: ObjectIndex, bits: u64) {
        if object == CONSUMER_HEARTBEAT {
            self.watches_host = bits != 0;
        }
        self.learn_pdo(object, bits);
    }

    fn find_parameter(&self, object: ObjectIndex) -> Option<ParameterId> {
        self.profile
            .parameters
            .iter()
            .position(|p| (p.index, p.space) == (object.index, object.sub))
            .map(|at| ParameterId(at as u16))
    }

    fn find_setpoint_pdo(&self, setpoint: SetpointKind) -> Option<SetpointPdo> {
        let targets = setpoint_objects(setpoint);
        targets.iter().find_map(|target| self.find_pdo_with(*target))
    }

    fn find_pdo_with(&self, target: ObjectIndex) -> Option<SetpointPdo> {
        let follow_word = if target == INTERPOLATION_RECORD { 0x1F } else { 0x0F };
        let target = self.find_parameter(target)?;
        let control = self.find_parameter(CONTROLWORD)?;
        (1..).zip(&self.rpdos).filter(|(_, pdo)| pdo.enabled).find_map(|(number, pdo)| {
            let (field, control) = (pdo.field(target)?, pdo.field(control)?);
            Some(SetpointPdo {
                target,
                follow_word,
                number,
                bytes: pdo.bytes(),
                target_field: field,
                controlword_field: control,
            })
        })
    }

    /// Switches PDO `number` on or off.
    fn switch_pdo(&self, sends: bool, number: u16, on: bool) -> Result<HostRequest, Unsupported> {
        let n = u8::try_from(number).ok().filter(|n| (1..=4).contains(n));
        let n = n.ok_or(Unsupported::BadArgument)?;
        let (cob, base) = if sends {
            (Cob::Tpdo(n, self.node), 0x17FF)
        } else {
            (Cob::Rpdo(n, self.node), 0x13FF)
        };
        let off = if on { 0 } else { CobId::INVALID };
        let bits = u64::from(u32::from(cob.id()) | off);
        Ok(self.write_object(ObjectIndex::new(base + number, 1), bits, 4))
    }

    const fn write_object(&self, object: ObjectIndex, bits: u64, len: u8) -> HostRequest {
        let object = self.own_object(object);
        HostRequest::Write { node: self.node, object, bits, len, class: RequestClass::ReadBack }
    }

    const fn read_object(&self, object: ObjectIndex) -> HostRequest {
        HostRequest::Read { node: self.node, object: self.own_object(object) }
    }

    /// The object of this axis, by that of the first.
    const fn own_object(&self, object: ObjectIndex) -> ObjectIndex {
        let index = axis_index(object.index, self.offset);
        ObjectIndex { index, ..object }
    }

    /// The object that a parameter is.
    const fn parameter_object(&self, parameter: &Parameter) -> ObjectIndex {
        self.own_object(ObjectIndex { index: parameter.index, sub: parameter.space })
    }
}

/// Kinds of set-points, in the order of their numbers.
const SETPOINTS: [SetpointKind; 3] =
    [SetpointKind::Position, SetpointKind::Velocity, SetpointKind::Torque];

/// The objects that may be commanded cycle by cycle, the usual one first (CiA 402-2).
const fn setpoint_objects(setpoint: SetpointKind) -> &'static [ObjectIndex] {
    const POSITIONS: [ObjectIndex; 2] = [ObjectIndex::new(0x607A, 0), INTERPOLATION_RECORD];
    const VELOCITIES: [ObjectIndex; 1] = [ObjectIndex::new(0x60FF, 0)];
    const TORQUES: [ObjectIndex; 1] = [ObjectIndex::new(0x6071, 0)];
    match setpoint {
        SetpointKind::Position => &POSITIONS,
        SetpointKind::Velocity => &VELOCITIES,
        SetpointKind::Torque => &TORQUES,
    }
}

const NOT_WHOLE: &str = "the object has more than eight bytes: read it as text or as bytes (`:str`, \
                        `:bytes`)";
const FIRST_AXIS_ONLY: &str = "process data are configured for the first axis of a node alone";
const NO_NUMBER: &str =
    "this object has no number of a known size: its type is text, bytes or not known";

/// Bytes of an encoding, and whether it is signed.
#[must_use]
pub const fn encoding_width(encoding: Encoding) -> (u8, bool) {
    (encoding.size(), encoding.is_signed())
}

/// Number in `len` bytes; in all eight if the node does not state the number of bytes.
const fn decode_number(bits: u64, len: u32, signed: bool) -> i64 {
    let len = if len == 0 || len > 8 { 8 } else { len };
    let above = 64 - 8 * len;
    if signed {
        (bits << above).cast_signed() >> above
    } else {
        (bits << above >> above).cast_signed()
    }
}

impl RequestEncoder for CanopenDriver {
    type Request = HostRequest;

    fn read_request(&self, parameter: &Parameter) -> Result<HostRequest, Unsupported> {
        if !parameter.encoding.is_number() {
            return Err(Unsupported::Forbidden(NO_NUMBER));
        }
        Ok(HostRequest::Read { node: self.node, object: self.parameter_object(parameter) })
    }

    fn write_request(
        &self,
        parameter: &Parameter,
        raw: i64,
        class: RequestClass,
    ) -> Result<HostRequest, Unsupported> {
        let len = parameter.encoding.size();
        if len == 0 {
            return Err(Unsupported::Forbidden(NO_NUMBER));
        }
        let bits = raw.cast_unsigned() & u64::MAX >> (64 - 8 * u32::from(len));
        Ok(HostRequest::Write {
            node: self.node,
            object: self.parameter_object(parameter),
            bits,
            len,
            class,
        })
    }

    fn function_request(
        &self,
        function: u8,
        index: u16,
        value: i64,
    ) -> Result<HostRequest, Unsupported> {
        let node = self.node;
        if self.sub_axis != 0 && matches!(function, 1..=4 | SWITCH_RPDO | SWITCH_TPDO) {
            return Err(Unsupported::Forbidden(FIRST_AXIS_ONLY));
        }
        Ok(match function {
            0 => {
                let specifier = u8::try_from(index).map_err(|_| Unsupported::BadArgument)?;
                match NmtCommand::from(specifier) {
                    NmtCommand::Other(_) => return Err(Unsupported::BadArgument),
                    command => HostRequest::Nmt(NmtMessage { command, node }),
                }
            }
            1..=4 if (1..=8).contains(&index) => {
                let data = value.cast_unsigned();
                HostRequest::Process { cob: Cob::Rpdo(function, node), data, len: index as u8 }
            }
            SEND_SYNC => HostRequest::Sync(None),
            SWITCH_RPDO => self.switch_pdo(false, index, value != 0)?,
            SWITCH_TPDO => self.switch_pdo(true, index, value != 0)?,
            WATCH_HEARTBEAT => HostRequest::WatchHeartbeat { node, ms: index },
            // A consumer heartbeat that was not set is not cleared: it is only read.
            UNWATCH_HEARTBEAT if self.watches_host => HostRequest::WatchHeartbeat { node, ms: 0 },
            UNWATCH_HEARTBEAT => self.read_object(CONSUMER_HEARTBEAT),
            RESTORE_CONNECTION_OPTION => match self.original_option {
                Some(option) => self.write_object(CONNECTION_OPTION, option.into(), 2),
                None => self.read_object(CONNECTION_OPTION),
            },
            _ => return Err(Unsupported::Forbidden("no such CANopen function in plans")),
        })
    }

    /// Everything is kept at once: CANopen keeps no object by itself.
    fn store_request(&self, _parameter: &Parameter) -> Result<HostRequest, Unsupported> {
        let (object, bits) = STORE_ALL;
        Ok(HostRequest::Write {
            node: self.node,
            object,
            bits,
            len: 4,
            class: RequestClass::NoRetry,
        })
    }

    fn parse_request(&self, text: &str) -> Result<HostRequest, Unsupported> {
        text::parse_request(text, self.node).ok_or(Unsupported::BadText)
    }

    fn decode_request(&self, frame: &RawFrame<'_>) -> Result<HostRequest, Unsupported> {
        let id = frame.id.filter(|_| !frame.extended && frame.bytes.len() <= 8);
        let id = id.and_then(|id| u16::try_from(id).ok()).ok_or(Unsupported::BadBytes)?;
        let frame = Frame::standard(id, frame.bytes);
        let statement = text::Statement::of(&frame, false).map_err(|_| Unsupported::BadBytes)?;
        // The reply does not name its receiver.
        let request = if statement.frame(self.node) == frame {
            statement.to_host_request(self.node)
        } else {
            None
        };
        request.ok_or(Unsupported::BadBytes)
    }
}

impl AnswerDecoder for CanopenDriver {
    type Answer = Answer;

    fn decode_answer(
        &mut self,
        parameter: Option<&Parameter>,
        answer: &Answer,
    ) -> Result<i64, Failure> {
        let encoding = parameter.map(|parameter| encoding_width(parameter.encoding));
        match *answer {
            Answer::Value { object, bits, len } => {
                self.learn_read(object, bits);
                if len > 8 {
                    return Err(Failure::NotReady { hint: NOT_WHOLE });
                }
                // A reply without a length has the width of the profile: the TS pads with zeros.
                let (width, signed) = encoding.unwrap_or((0, false));
                match u8::try_from(len) {
                    Ok(found @ 1..) if found < width => {
                        return Err(Failure::WrongSize { found, need: width });
                    }
                    _ => {}
                }
                Ok(decode_number(bits, if len == 0 { width.into() } else { len }, signed))
            }
            Answer::Written { object, bits } => {
                self.learn_written(object, bits);
                let (width, signed) = encoding.unwrap_or((0, false));
                Ok(decode_number(bits, width.into(), signed))
            }
            Answer::Transferred(count) => Ok(count.into()),
            Answer::State(state) => Ok(u8::from(state).into()),
            Answer::Identity([_, _, _, serial]) => Ok(serial.into()),
            Answer::Lss(reply) => text::lss_outcome(reply),
            Answer::Sent | Answer::HeartbeatLost | Answer::Emergency(_) | Answer::Process(..) => {
                Ok(0)
            }
        }
    }

    /// The aborts that a device gives for an object or a sub-index that it does not have.
    fn refusal(&self, code: u32) -> Refusal {
        match AbortCode(code) {
            AbortCode::NO_OBJECT | AbortCode::NO_SUB => Refusal::Missing,
            _ => Refusal::Final,
        }
    }

    fn decode_unsolicited(&mut self, answer: &Answer) -> [Option<DriveReport>; REPORTS_MAX] {
        let mut reports = [None; REPORTS_MAX];
        match *answer {
            Answer::State(state) => {
                if state == NmtState::BootUp {
                    *self = Self::new(self.profile, self.address());
                }
                reports[0] = presence_of(state).map(DriveReport::Presence);
            }
            Answer::HeartbeatLost => reports[0] = Some(DriveReport::Presence(Presence::Gone)),
            // The message does not name an axis of the node; the others are read too.
            Answer::Emergency(Emergency { code, .. }) => {
                reports[0] = self.fault_report(code).filter(|_| self.sub_axis == 0);
                reports[1] = Some(DriveReport::Emergency(code.into()));
            }
            Answer::Process(number @ 1..=4, data, len) => {
                return self.tpdos[usize::from(number) - 1].decode_values(data, len);
            }
            _ => {}
        }
        reports
    }

    /// The mappings of TPDOs, entries first: the count makes one whole.
    fn unread_prerequisite(&self, n: usize) -> Option<ParameterId> {
        let unknown = (0_u16..4).filter(|pdo| self.tpdos[usize::from(*pdo)].bytes() == 0);
        let objects =
            unknown.flat_map(|pdo| (1..=8).chain([0]).map(move |sub| (0x1A00 + pdo, sub)));
        let parameters = self.profile.parameters;
        objects
            .filter_map(|object| parameters.iter().position(|p| (p.index, p.space) == object))
            .nth(n)
            .map(|id| ParameterId(id as u16))
    }
}

impl WriteRules for CanopenDriver {}

impl DataDriver for CanopenDriver {
    fn data_read_request(
        &self,
        parameter: &Parameter,
        block: bool,
        max: u16,
    ) -> Result<HostRequest, Unsupported> {
        Ok(HostRequest::Upload {
            node: self.node,
            object: self.parameter_object(parameter),
            block,
            max,
        })
    }

    fn data_write_request(
        &self,
        parameter: &Parameter,
        size: u32,
        block: bool,
    ) -> Result<HostRequest, Unsupported> {
        let object = self.parameter_object(parameter);
        Ok(HostRequest::Download { node: self.node, object, block, size })
    }
}

impl CyclicDriver for CanopenDriver {
    fn setpoint_parameter(&self, setpoint: SetpointKind) -> Option<ParameterId> {
        self.setpoint_pdos[setpoint as usize].map(|bringer| bringer.target)
    }

    fn setpoint_request(
        &self,
        setpoint: SetpointKind,
        raw: i64,
        command: cyclic::SetpointCommand,
    ) -> Option<HostRequest> {
        let SetpointPdo { number, bytes, target_field, controlword_field, follow_word, .. } =
            self.setpoint_pdos[setpoint as usize]?;
        let controlword = match command {
            cyclic::SetpointCommand::Follow => follow_word,
            cyclic::SetpointCommand::Stop => STOP_WORD,
        };
        let data = controlword_field
            .insert(target_field.insert(0, raw.cast_unsigned()), controlword.into());
        Some(HostRequest::Process { cob: Cob::Rpdo(number, self.node), data, len: bytes })
    }

    fn sync_request(&self) -> Option<HostRequest> {
        Some(HostRequest::Sync(None))
    }

    fn cycle_bits(&self) -> (u32, u32) {
        let pdos =
            self.rpdos.iter().chain(&self.tpdos).filter(|pdo| pdo.enabled && pdo.bytes() > 0);
        (pdos.map(|pdo| max_frame_bits(pdo.bytes())).sum(), max_frame_bits(0))
    }
}

impl Driver for CanopenDriver {
    fn profile(&self) -> &'static Profile {
        self.profile
    }

    fn address(&self) -> u32 {
        with_sub_axis(self.node.into(), self.sub_axis)
    }

    fn data(&self) -> Option<&dyn DataDriver<Request = HostRequest>> {
        Some(self)
    }

    fn cycles(&self) -> Option<&dyn CyclicDriver<Request = HostRequest>> {
        Some(self)
    }
}

/// A node's state in the words that all protocols have.
const fn presence_of(state: NmtState) -> Option<Presence> {
    Some(match state {
        NmtState::BootUp => Presence::Restarted,
        NmtState::PreOperational => Presence::Preparing,
        NmtState::Operational => Presence::Operating,
        NmtState::Stopped => Presence::Halted,
        NmtState::Other(_) => return None,
    })
}

/// Period of the host's heartbeat.
const HEARTBEAT: OptionKey = OptionKey::new(
    "heartbeat",
    OptionKind::Milliseconds,
    "period of the host's heartbeat, which ends one second after the program's last request; drives that \
     watch it (1016h) then stop",
    |options, ms| options.heartbeat_ms = Some(ms),
);
/// The data sheet of the device.
const DATA_SHEET: OptionKey = OptionKey::for_link(
    "eds",
    OptionKind::Text,
    "data sheet of the device (EDS or DCF): its objects by name, and the verbs of CiA 402 if it is a drive",
);

/// CANopen in the registry.
#[derive(Debug)]
pub enum Canopen {}

impl Protocol for Canopen {
    type Medium = Can;
    type Host = CanHost;
    const NAME: &'static str = "canopen";
    const PROFILE_PROTOCOL: &'static str = "canopen";
    const SCAN_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=NODE_MAX as u32;
    const VALID_ADDRESSES: core::ops::RangeInclusive<u32> = 1..=NODE_MAX as u32;
    /// CiA 402-1: up to eight, each with objects 800h above the one before.
    const SUB_AXES: core::ops::RangeInclusive<u8> = 1..=8;
    const HOST_ADDRESS: Option<u32> = Some(HOST_ID as u32);
    /// The TS's (manual, 3.2); many others have no fixed one.
    const DEFAULT_RATE: u32 = 500_000;
    const KEYS: &[OptionKey] =
        &[options::TIMEOUT, options::host_key(1, 127), HEARTBEAT, DATA_SHEET];

    fn generic_profile() -> &'static Profile {
        &GENERIC
    }

    fn create_host(options: &HostOptions, _axes: &[u32]) -> CanHost {
        CanHost::new(options)
    }

    fn create_driver(
        profile: &'static Profile,
        address: u32,
    ) -> impl Driver<Request = HostRequest, Answer = Answer> + Send + 'static {
        CanopenDriver::new(profile, address)
    }

    /// The pre-defined connection set of CiA 301, and what LSS and NMT have for everybody.
    fn uses_can_id(address: u32, id: u32, extended: bool) -> bool {
        let everybody = matches!(id, 0x000 | 0x080 | 0x100 | 0x7E4 | 0x7E5);
        // EMCY, four PDOs each way, SDO each way, heartbeat.
        let of_node = matches!(id >> 7, 1 | 3..=12 | 14) && id & 0x7F == drive_address(address);
        !extended && (everybody || of_node)
    }

    /// Upload of the device type, which every node has (CiA 301, 7.5.2.1).
    fn presence_frame(_options: &HostOptions, address: u32) -> Option<Frame> {
        let node = u8::try_from(address).ok().filter(|node| (1..=NODE_MAX).contains(node))?;
        Some(SdoRequest::Read(ObjectIndex::new(0x1000, 0)).emit(node))
    }

    fn frame_sender(options: &HostOptions, frame: &Frame) -> Option<u32> {
        frame_sender(options, frame)
    }
}
