//! Explanation of a frame: fields with names, byte ranges and meanings, written to a sink.

mod conversation;
mod effect;
mod number;

use crate::error::WireError;
use crate::profile::{Encoding, Parameter, ParameterAddress, Profile};

pub use conversation::{
    ConversationContext, FrameRole, FrameValue, ReplyCount, ReplyExpectation, SequencePosition,
    ShortText, ValueSource,
};
pub use effect::{Effect, Impact};
pub use number::{ByteOrder, Decimal, NumberPlace, NumberStyle};

/// Direction of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Direction {
    /// Host to drive.
    ToDrive,
    /// Drive to host.
    ToHost,
}

/// Context of a frame for an explainer.
#[derive(Clone, Copy, Debug, Default)]
pub struct Context<'a> {
    /// Direction of the frame, if known.
    pub direction: Option<Direction>,
    /// The request that these bytes answer, if known.
    pub request: Option<&'a [u8]>,
    /// The product's tables, for names.
    pub profile: Option<&'static Profile>,
    /// The profile is a default, not stated by the user; explanations mention it where drives differ.
    pub profile_assumed: bool,
    /// CAN identifier, for frames.
    pub id: Option<u32>,
    /// True for a CAN identifier of 29 bits.
    pub extended: bool,
    /// True for a CAN remote request: its bytes have the requested length and no content.
    pub remote: bool,
    /// CAN identifier of the request, as wide as `id`.
    pub request_id: Option<u32>,
}

/// A frame as on the wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct RawFrame<'a> {
    /// Bytes of the frame.
    pub bytes: &'a [u8],
    /// CAN identifier, for frames.
    pub id: Option<u32>,
    /// True for a CAN identifier of 29 bits.
    pub extended: bool,
}

/// A value of a field.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum FieldValue<'a> {
    /// A number, to be shown in decimal.
    Int(i64),
    /// A number that is shown in hexadecimal with this many digits.
    Hex(u64, u8),
    /// A real number.
    Real(f64),
    /// Text.
    Text(&'a str),
    /// Big-endian 16-bit words, as they lie in the frame.
    Words(&'a [u8]),
}

impl FieldValue<'_> {
    /// The number, where it is a whole one.
    #[must_use]
    pub fn integer(self) -> Option<i64> {
        match self {
            Self::Int(number) => Some(number),
            Self::Hex(number, _) => i64::try_from(number).ok(),
            _ => None,
        }
    }
}

/// One field of a frame.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Field<'a> {
    /// The protocol's name for it, `snake_case`.
    pub name: &'static str,
    /// First byte in the frame.
    pub start: u16,
    /// Offset after the last byte; `start` for a field in the CAN identifier.
    pub end: u16,
    /// Value of the field.
    pub value: FieldValue<'a>,
    /// Name of the value; empty where it has none.
    pub meaning: &'static str,
}

/// Takes what an explainer finds.
pub trait ExplainSink {
    /// The protocol's word for the frame: `GAP`, `read holding registers`.
    fn kind(&mut self, kind: &str);
    /// The axis, station or module it concerns.
    fn axis(&mut self, axis: u32);
    /// One field, in the order of the bytes.
    fn field(&mut self, field: Field<'_>);
    /// A piece of the one-line meaning; pieces are joined as they come.
    fn text(&mut self, piece: &str);
    /// Reports an error of the frame. Fields that were reported before remain valid.
    fn error(&mut self, error: WireError);
    /// Returns whether text is wanted. If not, an explainer may leave it out (DEC-10).
    fn wants_text(&self) -> bool {
        true
    }
    /// Returns whether [values](Self::frame_value) are wanted. If not, an explainer may leave them out.
    fn wants_values(&self) -> bool {
        true
    }
    /// Reports a value in the frame. [`axis`](Self::axis) names its axis.
    fn frame_value(&mut self, reading: FrameValue<'_>) {
        let _ = reading;
    }
    /// A [text](Self::text) that is the number at `place`.
    fn number(&mut self, number: i64, style: NumberStyle, place: NumberPlace) {
        let _ = place;
        if let Some(digits) = style.text_of(number) {
            self.text(digits.as_str());
        }
    }
    /// A [field](Self::field) whose value is the number at `place`, as its kind of value has it. A real number counts
    /// tenths.
    fn number_field(&mut self, field: Field<'_>, place: NumberPlace) {
        let _ = place;
        self.field(field);
    }
    /// A [value](Self::frame_value) that is the number at `place`.
    fn number_value(&mut self, reading: FrameValue<'_>, place: NumberPlace) {
        let _ = place;
        self.frame_value(reading);
    }
}

/// The end of the first frame in some bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FrameBoundary {
    /// The first bytes, of this number, are a complete frame with a valid check sum.
    Frame(usize),
    /// The first bytes, of this number, have a frame's length and shape, but its check fails.
    Corrupt(usize),
    /// The first bytes, of this number, belong to no frame.
    Skip(usize),
    /// More bytes are needed.
    Incomplete,
}

/// A text in a protocol's own language, encoded.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct EncodedFrame {
    /// Bytes written.
    pub len: usize,
    /// CAN identifier, for frames.
    pub id: Option<u32>,
    /// True for a CAN identifier of 29 bits.
    pub extended: bool,
    /// For a CAN remote request: the requested length.
    pub remote_len: Option<u8>,
    /// Length of the reply in bytes, if there is one.
    pub answer_len: Option<usize>,
    /// A warning for the sender; empty if there is none.
    pub warning: &'static str,
}

/// The wire that a text is encoded for.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum WireKind {
    /// The protocol's own, or its usual one.
    #[default]
    Default,
    /// RS-232, or any other line without bus addressing.
    Serial,
    /// RS-485, where its rules differ.
    Rs485,
    /// CAN.
    Can,
}

/// Options for encoding a text.
#[derive(Clone, Copy, Debug, Default)]
pub struct EncodeOptions {
    /// Axis, station or module address; the protocol's default if `None`.
    pub axis: Option<u32>,
    /// `axis` is a mask of groups, 0 for everybody; only for protocols that
    /// [have groups](Dissector::has_groups).
    pub groups: bool,
    /// The text is for the host at `axis`, as answers are; only for protocols that
    /// [have groups](Dissector::has_groups).
    pub to_host: bool,
    /// Host address; the protocol's default if `None`.
    pub host: Option<u32>,
    /// The product's tables, for names.
    pub profile: Option<&'static Profile>,
    /// The wire.
    pub wire: WireKind,
}

/// Position and reason of an error in a text.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct TextError {
    /// Byte offset in the text.
    pub at: usize,
    /// The expected text.
    pub expected: &'static str,
}

/// Reason why a text could not be encoded.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EncodeError {
    /// The text is not of the language.
    Text(TextError),
    /// A rule of the wire forbids it; the text names the rule and the remedy.
    Forbidden(&'static str),
}

impl From<TextError> for EncodeError {
    fn from(error: TextError) -> Self {
        Self::Text(error)
    }
}

/// A device fact beside the profile: a name or a version.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DeviceFact {
    /// Name of the fact.
    pub name: &'static str,
    /// Query for the fact.
    pub query: FactQuery,
}

/// Query for a device fact. Only reads are used.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FactQuery {
    /// A parameter, by its address.
    Address(&'static str),
    /// A request in the protocol's own text.
    Text(&'static str),
    /// A request in the protocol's own text, with a number from 0 up appended. The highest byte of the reply
    /// has the number of characters in this reply, at most seven, then come the characters. A reply with
    /// fewer than seven is the last one. Costs one exchange on a drive that does not have the fact, so a
    /// known drive without it is not asked.
    Characters(&'static str),
    /// The number of existing parameters. The first parameter must exist; the others are counted up to the
    /// first refusal. The last one is a parameter that no drive has: a drive that replies to it ignores the
    /// number in the request, and has one parameter.
    Count(&'static str, &'static [&'static str]),
}

/// Frames of a protocol: where they end, and which identifiers they have.
pub trait FrameFormat {
    /// Finds the end of the first frame in a serial stream. `ended` means that no more bytes follow soon:
    /// silence, a change of direction, or the end of the capture.
    fn find_frame(&self, bytes: &[u8], direction: Option<Direction>, ended: bool) -> FrameBoundary;

    /// Length of the frame with a valid check sum at the start of some bytes, if there is one.
    fn valid_frame_len(&self, bytes: &[u8], direction: Option<Direction>) -> Option<usize> {
        match self.find_frame(bytes, direction, true) {
            FrameBoundary::Frame(len) => Some(len),
            _ => None,
        }
    }

    /// Returns whether a CAN identifier can belong to this protocol; `false` for protocols without CAN.
    fn claims_id(&self, id: u32, extended: bool) -> bool {
        let _ = (id, extended);
        false
    }

    /// Returns whether a CAN remote request with that identifier can belong to this protocol.
    fn claims_remote(&self, id: u32, extended: bool) -> bool {
        let _ = (id, extended);
        false
    }

    /// Returns whether other protocols use this CAN identifier for frames of the same form. A frame of a capture is
    /// then explained only if other evidence shows that its axis uses this protocol, or the user stated the protocol.
    fn shares_id(&self, id: u32, extended: bool) -> bool {
        let _ = (id, extended);
        false
    }

    /// Tests the content of a valid CAN frame for this protocol: `Some(true)` for content that few frames of others
    /// have by chance (a known state or instruction, a check sum), `Some(false)` for content that the protocol does not
    /// define, `None` where any content is valid.
    fn content_evidence(&self, frame: &RawFrame<'_>) -> Option<bool> {
        let _ = frame;
        None
    }

    /// The axis of a valid process data frame, which neither asks nor replies. Its meaning depends on the
    /// conversation; [`explain`](Dissector::explain) alone knows less.
    fn process_data_axis(&self, frame: &RawFrame<'_>) -> Option<u32> {
        let _ = frame;
        None
    }
}

/// Parameters by their numbers, in the protocol's own notation.
pub trait AddressNotation {
    /// Reads a parameter's number in the protocol's own notation, such as `0x2030:1:u16`; `None` where
    /// the text has not the form of a number.
    fn parse_address(&self, text: &str) -> Option<Result<ParameterAddress, TextError>> {
        let _ = text;
        None
    }

    /// An address with all that it can have, as an example.
    fn address_example(&self) -> &'static str {
        ""
    }

    /// The address that manuals of other makers mean by a text, where that has another form than here: `R 0` for
    /// Modbus' 40001. It is no address for [`parse_address`](Self::parse_address), because a manual may also mean the
    /// number itself.
    fn manual_address(&self, text: &str) -> Option<ParameterAddress> {
        let _ = text;
        None
    }

    /// Writes an address as [`parse_address`](Self::parse_address) reads it, without its type.
    fn write_address(&self, address: &ParameterAddress, out: &mut dyn core::fmt::Write) {
        let _ = (address, out);
    }

    /// Describes the parameter at an address without a profile, as far as the protocol defines it. It has
    /// no name.
    fn describe_address(&self, address: &ParameterAddress) -> Parameter {
        address.describe(Encoding::I32)
    }

    /// Returns whether a frame concerns the parameter at an address, judged by its own fields: `field` returns the
    /// field of that name.
    fn concerns<'a>(
        &self,
        address: &ParameterAddress,
        field: &dyn Fn(&str) -> Option<FieldValue<'a>>,
    ) -> bool {
        let _ = (address, field);
        false
    }

    /// Explains how a parameter is addressed on the wire, where that is more than its number.
    fn explain_parameter(&self, parameter: &Parameter, sink: &mut dyn ExplainSink) {
        let _ = (parameter, sink);
    }

    /// Returns whether this refusal code means that the drive does not support block transfer. Nothing was transferred,
    /// and a transfer without blocks may follow.
    fn refuses_blocks(&self, code: u32) -> bool {
        let _ = code;
        false
    }
}

/// Frames in their conversation: requests, replies, and their effect on a drive.
pub trait FrameConversation {
    /// Returns whether a frame to a drive is a request with a reply. True by default for every frame on a serial line.
    fn is_request(&self, frame: &RawFrame<'_>) -> bool {
        frame.id.is_none()
    }

    /// Returns whether a CAN frame is a request by its identifier, and its explanation depends on nothing but its
    /// bytes: then it is the same for each frame with these bytes.
    fn is_plain_request(&self, frame: &RawFrame<'_>) -> bool {
        let _ = frame;
        false
    }

    /// Returns whether the frame itself shows that it replies to `request`. If none does, a reply on a serial line
    /// belongs to the last request.
    fn is_answer_to(&self, frame: &RawFrame<'_>, request: &RawFrame<'_>) -> bool {
        let _ = (frame, request);
        false
    }

    /// Returns whether each reply repeats a number of its request: then several requests may be open at once, no reply
    /// belongs to another, and nothing is an echo.
    fn has_transactions(&self) -> bool {
        false
    }

    /// The role of a frame in its conversation. Unknown by default.
    fn role(&self, frame: &RawFrame<'_>, talk: &ConversationContext<'_>) -> FrameRole {
        let _ = (frame, talk);
        FrameRole::Unrelated
    }

    /// The direction of a frame, where the frame itself shows it. `open` is the last request on the line
    /// without a reply.
    fn direction(&self, frame: &RawFrame<'_>, open: Option<RawFrame<'_>>) -> Option<Direction> {
        self.role(
            frame,
            &ConversationContext { open_request: open, ..ConversationContext::default() },
        )
        .direction()
    }

    /// The effect that a frame may have on its drive. Unknown by default.
    fn effect(&self, frame: &RawFrame<'_>, profile: Option<&'static Profile>) -> Effect {
        let _ = (frame, profile);
        Effect::UNKNOWN
    }

    /// Reason for which an answer refuses its request; `None` if it does not.
    fn refusal_reason(
        &self,
        answer: &RawFrame<'_>,
        request: &RawFrame<'_>,
    ) -> Option<&'static str> {
        let _ = (answer, request);
        None
    }

    /// Returns whether a request, once it has a reply, sets the format of the axis' later replies.
    fn sets_reply_format(&self, request: &RawFrame<'_>) -> bool {
        let _ = request;
        false
    }

    /// Returns whether an answer that fits its request is evidence for the protocol: it repeats something of the
    /// request that other protocols do not have there by chance.
    fn is_evident_answer(&self, answer: &RawFrame<'_>) -> bool {
        let _ = answer;
        true
    }

    /// Returns whether a reply shows that the drive has lost the settings in `talk`: it restarted.
    fn shows_restart(
        &self,
        answer: &RawFrame<'_>,
        request: &RawFrame<'_>,
        talk: &ConversationContext<'_>,
    ) -> bool {
        let _ = (answer, request, talk);
        false
    }

    /// The position of a request in a counted sequence.
    fn sequence_position(&self, request: &RawFrame<'_>) -> Option<SequencePosition> {
        let _ = request;
        None
    }
}

/// Facts that drives of a protocol have beside their profile, and the text mode in which they state them.
pub trait DriveFacts {
    /// The profiles of a standard: they describe what every drive of the protocol has at the same
    /// address, if it has it.
    fn standard_profiles(&self) -> &'static [&'static str] {
        &[]
    }

    /// Facts that drives of this protocol have beside their profile.
    fn device_facts(&self) -> &'static [DeviceFact] {
        &[]
    }

    /// The recorder in its drives; `None` where there is none.
    fn data_logger(&self) -> Option<&'static crate::data_logger::DataLogger> {
        None
    }

    /// A request in the protocol's own text that begins the motion of a verb, in the drive's own units, for drives
    /// whose profile has no steps for it. `None` where there is none.
    fn verb_example(&self, verb: crate::verb::Verb) -> Option<&'static str> {
        let _ = verb;
        None
    }

    /// Writes the reply to a [`FactQuery::Text`] as text; nothing where it has no meaning.
    fn write_fact(&self, name: &str, raw: i64, out: &mut dyn core::fmt::Write) {
        let _ = (name, raw, out);
    }

    /// Writes the line that reads something from a drive in text mode, and then the line that ends the mode,
    /// both without their carriage return. Returns false where the protocol has no text mode, or the address
    /// has no letter in it.
    fn write_text_mode(
        &self,
        address: u32,
        query: &mut dyn FnMut(&str),
        exit: &mut dyn FnMut(&str),
    ) -> bool {
        let _ = (address, query, exit);
        false
    }

    /// Returns whether a line, without its carriage return, is a reply in text mode.
    fn is_text_answer(&self, line: &[u8]) -> bool {
        let _ = line;
        false
    }
}

/// One protocol as captures, dashboards and the encoder see it. Stateless: what spans frames is the
/// caller's [`Context`].
pub trait Dissector: Sync + FrameFormat + AddressNotation + FrameConversation + DriveFacts {
    /// The word users type: `tmcl`, `modbus-rtu`.
    fn name(&self) -> &'static str;

    /// Explains one frame: a cut of the stream, or a CAN frame's data with its id in the context.
    fn explain(&self, bytes: &[u8], context: &Context<'_>, sink: &mut dyn ExplainSink);

    /// Encodes text of the protocol's own language.
    ///
    /// # Errors
    /// The place in the text, or the rule that forbids it.
    fn encode(
        &self,
        text: &str,
        addressing: &EncodeOptions,
        out: &mut [u8],
    ) -> Result<EncodedFrame, EncodeError>;

    /// Meaning of a code of this protocol: a status, an exception, a fault.
    fn code_meaning(&self, code: u32) -> Option<&'static str>;

    /// The language that [`encode`](Self::encode) reads, and the word of the protocol in profiles; protocols on several
    /// wires share one.
    fn language(&self) -> &'static str {
        self.name()
    }

    /// Returns whether texts use a drive's names. If so, a usual drive's names are used where no profile is stated.
    fn encodes_by_name(&self) -> bool {
        false
    }

    /// Returns whether a usual drive's names help to explain frames of an unknown drive.
    fn explains_by_name(&self) -> bool {
        self.encodes_by_name()
    }

    /// The language of the programs that its drives keep and run; `None` where there are none.
    fn program_language(&self) -> Option<&'static dyn crate::program::ProgramLanguage> {
        None
    }

    /// The language of programs that are instructions; `None` where there are none.
    fn instruction_language(&self) -> Option<&'static dyn crate::program::InstructionLanguage> {
        None
    }

    /// Returns whether axes have groups that a message can address.
    fn has_groups(&self) -> bool {
        false
    }

    /// Explains the expected reply to an encoded request: the sender and the content. Reports nothing where
    /// only the length is known.
    fn explain_expected_reply(
        &self,
        request: &RawFrame<'_>,
        addressing: &EncodeOptions,
        sink: &mut dyn ExplainSink,
    ) {
        let _ = (request, addressing, sink);
    }

    /// Explains a value by the name of its source: the bits of a register, with the bit numbers as ranges of
    /// the fields. `false` when there is no such name.
    fn explain_named_value(
        &self,
        name: &str,
        value: u32,
        profile: Option<&'static Profile>,
        sink: &mut dyn ExplainSink,
    ) -> bool {
        let _ = (name, value, profile, sink);
        false
    }
}
