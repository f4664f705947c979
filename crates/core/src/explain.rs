//! Explanation of a frame: fields with names, byte ranges and meanings, written to a sink.

mod conversation;
mod effect;

use crate::error::WireError;
use crate::profile::{Encoding, Parameter, ParameterAddress, Profile};

pub use conversation::{
    ConversationContext, FrameRole, FrameValue, ReplyCount, ReplyExpectation, SequencePosition,
    ShortText, ValueSource,
};
pub use effect::{Effect, Impact};

/// Who sent the bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Direction {
    /// Host to drive.
    ToDrive,
    /// Drive to host.
    ToHost,
}

/// What an explainer may know besides the bytes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Context<'a> {
    /// Who sent them, if known.
    pub direction: Option<Direction>,
    /// The request that these bytes answer, if known.
    pub request: Option<&'a [u8]>,
    /// The product's tables, for names.
    pub profile: Option<&'static Profile>,
    /// Nobody stated the profile: it is a usual drive's, and its names say so where drives differ.
    pub profile_assumed: bool,
    /// CAN identifier, for frames.
    pub id: Option<u32>,
    /// True for a CAN identifier of 29 bits.
    pub extended: bool,
    /// True for a CAN remote request: the bytes are what it asks for, and do not count.
    pub remote: bool,
    /// CAN identifier of the request, as wide as `id`.
    pub request_id: Option<u32>,
}

/// A frame as it stands on the wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct RawFrame<'a> {
    /// Its bytes.
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
    /// A number, to be shown in hexadecimal with so many digits.
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
    /// Byte after the last; `start` for what stands in a CAN identifier.
    pub end: u16,
    /// Its value.
    pub value: FieldValue<'a>,
    /// What the value means, where there is a name for it; empty otherwise.
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
    /// What the frame breaks. Fields found so far stand.
    fn error(&mut self, error: WireError);
    /// Whether words are wanted: where not, an explainer may leave out pieces of text and readings
    /// that take it long (DEC-10).
    fn wants_text(&self) -> bool {
        true
    }
    /// A value that the frame carries. Whose it is, [`axis`](Self::axis) says.
    fn frame_value(&mut self, reading: FrameValue<'_>) {
        let _ = reading;
    }
}

/// Where, at the head of some bytes, a frame ends.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FrameBoundary {
    /// The first so many bytes are a whole frame whose check agrees.
    Frame(usize),
    /// The first so many bytes have a frame's length and shape, but its check fails.
    Corrupt(usize),
    /// The first so many bytes belong to no frame.
    Skip(usize),
    /// Too few to tell.
    Incomplete,
}

/// What can be said in a protocol's own language, made into bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct EncodedFrame {
    /// Bytes written.
    pub len: usize,
    /// CAN identifier, for frames.
    pub id: Option<u32>,
    /// True for a CAN identifier of 29 bits.
    pub extended: bool,
    /// For a CAN remote request, the length that it asks for.
    pub remote_len: Option<u8>,
    /// How many bytes the answer has, if there is one.
    pub answer_len: Option<usize>,
    /// What the one who sends this should know; empty if nothing.
    pub warning: &'static str,
}

/// The wire that a text is encoded for.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum WireKind {
    /// The protocol's own, or its usual one.
    #[default]
    Default,
    /// RS-232, or whatever carries bytes alone.
    Serial,
    /// RS-485, where its rules differ.
    Rs485,
    /// CAN.
    Can,
}

/// How to encode a text.
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

/// Why a text could not be encoded: where, and what was expected there.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct TextError {
    /// Byte offset in the text.
    pub at: usize,
    /// What would have been right.
    pub expected: &'static str,
}

/// Why a text became no bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EncodeError {
    /// It is not of the language.
    Text(TextError),
    /// The wire's rules forbid it; the sentence says which, and what to do instead.
    Forbidden(&'static str),
}

impl From<TextError> for EncodeError {
    fn from(error: TextError) -> Self {
        Self::Text(error)
    }
}

/// Something that a drive tells of itself: its name, a version.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DeviceFact {
    /// What it is.
    pub name: &'static str,
    /// How it is asked.
    pub query: FactQuery,
}

/// How a drive is asked for a fact, by reads only.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FactQuery {
    /// A parameter, by its address.
    Address(&'static str),
    /// A request in the protocol's own text.
    Text(&'static str),
    /// A request in the protocol's own text, with a number behind it, 0 and up: its value has how many
    /// characters of the fact it brings in the highest byte, at most seven, then those. With fewer than
    /// seven the fact is whole. It costs a drive that does not have it an exchange: who is known
    /// without is not asked.
    Characters(&'static str),
    /// How many parameters there are: the first has to be there, the others are counted up to the
    /// first that is refused. The last is one that no drive has: a drive that tells it does not look at
    /// which is asked, and has one.
    Count(&'static str, &'static [&'static str]),
}

/// One protocol as captures, dashboards and the encoder see it. Stateless: what spans frames is the
/// caller's [`Context`].
pub trait Dissector: Sync {
    /// The word users type: `tmcl`, `modbus-rtu`.
    fn name(&self) -> &'static str;
    /// Where the first frame in a serial stream ends. `ended` says that no more bytes follow soon:
    /// silence, a change of direction, or the end of the capture.
    fn find_frame(&self, bytes: &[u8], direction: Option<Direction>, ended: bool) -> FrameBoundary;
    /// The length of the frame whose check agrees at the head of some bytes, if there is one.
    fn valid_frame_len(&self, bytes: &[u8], direction: Option<Direction>) -> Option<usize> {
        match self.find_frame(bytes, direction, true) {
            FrameBoundary::Frame(len) => Some(len),
            _ => None,
        }
    }
    /// Whether a CAN identifier can be this protocol's; `false` for protocols without CAN.
    fn claims_id(&self, id: u32, extended: bool) -> bool {
        let _ = (id, extended);
        false
    }
    /// Whether a CAN remote request with that identifier can be this protocol's.
    fn claims_remote(&self, id: u32, extended: bool) -> bool {
        let _ = (id, extended);
        false
    }
    /// Whether other protocols use this CAN identifier for frames that may look alike: then a
    /// capture's frame is not explained so unless something else proves that its axis speaks this
    /// protocol, or somebody says so.
    fn shares_id(&self, id: u32, extended: bool) -> bool {
        let _ = (id, extended);
        false
    }
    /// Explains one frame: a cut of the stream, or a CAN frame's data with its id in the context.
    fn explain(&self, bytes: &[u8], context: &Context<'_>, sink: &mut dyn ExplainSink);
    /// Whose a frame is that breaks nothing, whatever it holds, and neither asks nor answers: what
    /// it says is its conversation's to tell, and [`explain`](Self::explain) knows less of it.
    fn process_data_axis(&self, frame: &RawFrame<'_>) -> Option<u32> {
        let _ = frame;
        None
    }
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
    /// What a code of this protocol means: a status, an exception, a fault.
    fn code_meaning(&self, code: u32) -> Option<&'static str>;
    /// The language that [`encode`](Self::encode) reads; protocols on several wires share one.
    fn language(&self) -> &'static str {
        self.name()
    }
    /// Whether its texts are made of a drive's names, so that where nobody says which drive it is a
    /// usual one's are better than none.
    fn encodes_by_name(&self) -> bool {
        false
    }
    /// Whether a usual drive's names help to explain frames of one that nobody named.
    fn explains_by_name(&self) -> bool {
        self.encodes_by_name()
    }
    /// The language of the programs that its drives keep and run; `None` where there are none.
    fn program_language(&self) -> Option<&'static dyn crate::program::ProgramLanguage> {
        None
    }
    /// Writes the line by which a drive in a mode of text lines is asked something that changes nothing,
    /// and after it the line that ends the mode, both without their carriage return. False where there is
    /// no such mode, or the address has no letter there.
    fn write_text_mode(
        &self,
        address: u32,
        query: &mut dyn FnMut(&str),
        exit: &mut dyn FnMut(&str),
    ) -> bool {
        let _ = (address, query, exit);
        false
    }
    /// Whether a line, without its carriage return, is an answer in that mode.
    fn is_text_answer(&self, line: &[u8]) -> bool {
        let _ = line;
        false
    }
    /// The language of programs that are instructions; `None` where there are none.
    fn instruction_language(&self) -> Option<&'static dyn crate::program::InstructionLanguage> {
        None
    }
    /// Whether axes have groups that a message can go to.
    fn has_groups(&self) -> bool {
        false
    }
    /// Explains what is expected after a request that was encoded: who answers with what. Says
    /// nothing where the length alone is known.
    fn explain_expected_reply(
        &self,
        request: &RawFrame<'_>,
        addressing: &EncodeOptions,
        sink: &mut dyn ExplainSink,
    ) {
        let _ = (request, addressing, sink);
    }
    /// Explains a value by the name of what it is read from: a register's bits, which the fields'
    /// ranges count. `false` when nothing has that name.
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
    /// Writes an address as [`parse_address`](Self::parse_address) reads it, without its type.
    fn write_address(&self, address: &ParameterAddress, out: &mut dyn core::fmt::Write) {
        let _ = (address, out);
    }
    /// The parameter at an address that no profile describes, as far as the protocol itself tells. It
    /// has no name.
    fn describe_address(&self, address: &ParameterAddress) -> Parameter {
        address.describe(Encoding::I32)
    }
    /// Whether a frame is about the parameter at an address, by its own fields: `field` gives the one
    /// of that name.
    fn concerns<'a>(
        &self,
        address: &ParameterAddress,
        field: &dyn Fn(&str) -> Option<FieldValue<'a>>,
    ) -> bool {
        let _ = (address, field);
        false
    }
    /// Whether a drive that refuses with that code has no block transfer: nothing was transferred, and
    /// it can be asked without blocks.
    fn refuses_blocks(&self, code: u32) -> bool {
        let _ = code;
        false
    }
    /// The profiles of a standard: they describe what every drive of the protocol has at the same
    /// address, if it has it.
    fn standard_profiles(&self) -> &'static [&'static str] {
        &[]
    }
    /// What drives of this protocol tell of themselves beside their profile.
    fn device_facts(&self) -> &'static [DeviceFact] {
        &[]
    }
    /// Writes the answer to a [`FactQuery::Text`] in words; nothing where it says nothing.
    fn write_fact(&self, name: &str, raw: i64, out: &mut dyn core::fmt::Write) {
        let _ = (name, raw, out);
    }
    /// Tells how a parameter is reached on the wire, where that is more than its number.
    fn explain_parameter(&self, parameter: &Parameter, sink: &mut dyn ExplainSink) {
        let _ = (parameter, sink);
    }
    /// Whether a frame, sent to a drive, is what answers belong to. On serial lines every one is
    /// unless this says otherwise.
    fn is_request(&self, frame: &RawFrame<'_>) -> bool {
        frame.id.is_none()
    }
    /// Whether a frame says by itself that it answers `request`. Where none does, a reply on a serial
    /// line belongs to the last request.
    fn is_answer_to(&self, frame: &RawFrame<'_>, request: &RawFrame<'_>) -> bool {
        let _ = (frame, request);
        false
    }
    /// What a frame is in its conversation. By default nothing is known of it.
    fn role(&self, frame: &RawFrame<'_>, talk: &ConversationContext<'_>) -> FrameRole {
        let _ = (frame, talk);
        FrameRole::Unrelated
    }
    /// Who sends such a frame, where it tells that by itself. `open` is the last request on the line
    /// that is not answered yet.
    fn direction(&self, frame: &RawFrame<'_>, open: Option<RawFrame<'_>>) -> Option<Direction> {
        self.role(
            frame,
            &ConversationContext { open_request: open, ..ConversationContext::default() },
        )
        .direction()
    }
    /// What a frame may do to the drive that it is sent to. By default nobody can tell.
    fn effect(&self, frame: &RawFrame<'_>, profile: Option<&'static Profile>) -> Effect {
        let _ = (frame, profile);
        Effect::UNKNOWN
    }
    /// Why an answer refuses its request; `None` where it does not.
    fn refusal_reason(
        &self,
        answer: &RawFrame<'_>,
        request: &RawFrame<'_>,
    ) -> Option<&'static str> {
        let _ = (answer, request);
        None
    }
    /// Whether a request, once it is answered, decides how its axis answers later ones.
    fn sets_reply_format(&self, request: &RawFrame<'_>) -> bool {
        let _ = request;
        false
    }
    /// Whether an answer shows that its drive has forgotten what `talk` says it was told: it
    /// started again.
    fn shows_restart(
        &self,
        answer: &RawFrame<'_>,
        request: &RawFrame<'_>,
        talk: &ConversationContext<'_>,
    ) -> bool {
        let _ = (answer, request, talk);
        false
    }
    /// Where a request stands in a sequence that counts.
    fn sequence_position(&self, request: &RawFrame<'_>) -> Option<SequencePosition> {
        let _ = request;
        None
    }
}
