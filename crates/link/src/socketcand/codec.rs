//! Elements of socketcand's ASCII protocol for both ends: `doc/protocol.md` of the project, and its raw
//! mode.

use polepair_core::medium::Frame;

use crate::hex::{self, TextWriter};

/// The longest element taken; socketcand's own buffer.
pub const ELEMENT_MAX: usize = 128;
/// Words of an element that are parsed: `filter`, seconds, microseconds, identifier, length and eight bytes, and one
/// more to detect too many.
const WORDS_MAX: usize = 14;

/// Cuts a stream of bytes into elements, from `<` to `>`.
#[derive(Clone, Debug)]
pub struct ElementSplitter {
    text: [u8; ELEMENT_MAX],
    len: usize,
    position: ElementPosition,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum ElementPosition {
    Outside,
    Inside,
    Ended,
}

/// Result of a byte: the end of an element.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ElementEnd {
    /// An element, which [`ElementSplitter::text`] shows until the next byte.
    Element,
    /// Something that is none.
    Malformed,
}

impl Default for ElementSplitter {
    fn default() -> Self {
        Self { text: [0; ELEMENT_MAX], len: 0, position: ElementPosition::Outside }
    }
}

impl ElementSplitter {
    /// Processes one byte; returns the element that it ended, if any.
    pub fn push(&mut self, byte: u8) -> Option<ElementEnd> {
        if self.position == ElementPosition::Ended {
            self.position = ElementPosition::Outside;
        }
        match (self.position, byte) {
            (element_position, b'<') => {
                (self.len, self.position) = (0, ElementPosition::Inside);
                // The end of the one before was lost.
                return (element_position == ElementPosition::Inside)
                    .then_some(ElementEnd::Malformed);
            }
            (ElementPosition::Inside, b'>') => {
                self.position = ElementPosition::Ended;
                return Some(ElementEnd::Element);
            }
            (ElementPosition::Inside, b' '..=b'~') if self.len < ELEMENT_MAX => {
                self.text[self.len] = byte;
                self.len += 1;
            }
            (ElementPosition::Inside, _) => {
                self.position = ElementPosition::Outside;
                return Some(ElementEnd::Malformed);
            }
            // Line ends between elements are for people's eyes.
            _ => {}
        }
        None
    }

    /// The inside of the element that has just ended.
    #[must_use]
    pub fn text(&self) -> &[u8] {
        &self.text[..self.len]
    }
}

/// A request of a client.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ClientRequest<'a> {
    /// The bus of that name.
    Open(&'a [u8]),
    /// Every frame from now on.
    RawMode,
    /// Only subscribed identifiers.
    BcmMode,
    /// An answer, to see whether anybody is there.
    Echo,
    /// A frame to be sent.
    Send(Frame),
    /// Subscribes to an identifier, in place of an earlier subscription to it.
    Subscribe(SubscribeRequest),
    /// No more of them.
    Unsubscribe(CanId),
    /// Nothing that is known here.
    Unknown,
}

/// An identifier, and whether it is an extended one.
pub type CanId = (u32, bool);

/// A subscription to an identifier.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SubscribeRequest {
    /// CAN identifier.
    pub id: CanId,
    /// Shortest interval between frames, ns; frames that come sooner are left out.
    pub min_interval_ns: u64,
    /// Only frames in which one of these bits has changed; every one if `None`.
    pub mask: Option<[u8; 8]>,
}

impl<'a> ClientRequest<'a> {
    /// Reads an element of a client.
    #[must_use]
    pub fn parse(text: &'a [u8]) -> Self {
        let mut words = [&b""[..]; WORDS_MAX];
        match split_words(text, &mut words) {
            [b"open", bus] => Self::Open(bus),
            [b"rawmode"] => Self::RawMode,
            [b"bcmmode"] => Self::BcmMode,
            [b"echo"] => Self::Echo,
            [b"send", id, len, data @ ..] => {
                parse_send(id, len, data).map_or(Self::Unknown, Self::Send)
            }
            [b"subscribe", s, us, id] => {
                let wanted = parse_id(id).and_then(|frame| parse_subscribe(s, us, &frame, None));
                wanted.map_or(Self::Unknown, Self::Subscribe)
            }
            [b"filter", s, us, id, len, data @ ..] => {
                let mask = parse_send(id, len, data);
                let wanted = mask.and_then(|mask| parse_subscribe(s, us, &mask, Some(mask.data)));
                wanted.map_or(Self::Unknown, Self::Subscribe)
            }
            [b"unsubscribe", id] => parse_id(id)
                .map_or(Self::Unknown, |frame| Self::Unsubscribe((frame.id, frame.extended))),
            _ => Self::Unknown,
        }
    }
}

/// A reply of the server.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ServerReply<'a> {
    /// Greeting of the server.
    Hi,
    /// The request succeeded.
    Ok,
    /// The answer to an echo.
    Echo,
    /// A frame from the bus.
    Frame(Frame),
    /// An error frame of that class (`linux/can/error.h`).
    ErrorFrame(u32),
    /// The request failed; the text has the reason.
    Error(&'a [u8]),
    /// Not a valid reply.
    Unknown,
}

impl<'a> ServerReply<'a> {
    /// Reads an element of a server.
    #[must_use]
    pub fn parse(text: &'a [u8]) -> Self {
        let mut words = [&b""[..]; WORDS_MAX];
        match split_words(text, &mut words) {
            [b"hi"] => Self::Hi,
            [b"ok"] => Self::Ok,
            [b"echo"] => Self::Echo,
            [b"frame", id, _time, data @ ..] => {
                parse_frame(id, data).map_or(Self::Unknown, Self::Frame)
            }
            [b"error", class, time] if time.contains(&b'.') => {
                hex::parse_hex(class).map_or(Self::Unknown, Self::ErrorFrame)
            }
            [b"error", ..] => Self::Error(&text.trim_ascii()[5..]),
            _ => Self::Unknown,
        }
    }
}

/// Words between spaces, as many as there are places.
fn split_words<'a, 'w>(text: &'a [u8], words: &'w mut [&'a [u8]]) -> &'w [&'a [u8]] {
    let mut count = 0;
    let found = text.split(|&byte| byte == b' ').filter(|word| !word.is_empty());
    for (slot, word) in words.iter_mut().zip(found) {
        *slot = word;
        count += 1;
    }
    &words[..count]
}

/// Eight digits are an extended identifier, fewer a standard one.
fn parse_id(digits: &[u8]) -> Option<Frame> {
    let (id, extended) = (hex::parse_hex(digits)?, digits.len() == 8);
    let highest = if extended { 0x1FFF_FFFF } else { 0x7FF };
    (id <= highest).then_some(Frame { id, extended, ..Frame::default() })
}

/// `send`: the bytes as words of one or two digits.
fn parse_send(id: &[u8], len: &[u8], data: &[&[u8]]) -> Option<Frame> {
    let mut frame = parse_id(id)?;
    if hex::parse_hex(len)? as usize != data.len() || data.len() > 8 {
        return None;
    }
    for (byte, word) in frame.data.iter_mut().zip(data) {
        *byte = u8::try_from(hex::parse_hex(word)?).ok()?;
    }
    frame.len = data.len() as u8;
    Some(frame)
}

/// `subscribe` and `filter`: the interval as decimal seconds and microseconds.
fn parse_subscribe(
    s: &[u8],
    us: &[u8],
    of: &Frame,
    mask: Option<[u8; 8]>,
) -> Option<SubscribeRequest> {
    let every_ns = parse_decimal(s)? * 1_000_000_000 + parse_decimal(us)? * 1000;
    Some(SubscribeRequest { id: (of.id, of.extended), min_interval_ns: every_ns, mask })
}

fn parse_decimal(word: &[u8]) -> Option<u64> {
    str::from_utf8(word).ok()?.parse::<u32>().ok().map(u64::from)
}

/// `frame`: the bytes as one word of digits, or as several.
fn parse_frame(id: &[u8], data: &[&[u8]]) -> Option<Frame> {
    let mut frame = parse_id(id)?;
    for pair in data.iter().flat_map(|word| word.chunks(2)) {
        let &[high, low] = pair else { return None };
        *frame.data.get_mut(usize::from(frame.len))? =
            hex::digit_value(high)? << 4 | hex::digit_value(low)?;
        frame.len += 1;
    }
    Some(frame)
}

/// Writes the request to send a frame; false for frames that the protocol cannot carry (remote frames).
pub(crate) fn write_send(frame: &Frame, text: &mut TextWriter<'_>) -> bool {
    if frame.remote {
        return false;
    }
    text.push_bytes(b"< send ");
    write_id(frame, text);
    text.push_byte(b' ');
    text.push_hex(frame.len.min(8).into(), 1);
    for &byte in frame.bytes() {
        text.push_byte(b' ');
        text.push_hex(byte.into(), if byte < 0x10 { 1 } else { 2 });
    }
    text.push_bytes(b" >");
    true
}

/// Writes that a frame was received at `wall_us`, microseconds since 1970; nothing for a remote
/// frame, for which the protocol has no words.
pub(crate) fn write_frame(frame: &Frame, wall_us: u64, text: &mut TextWriter<'_>) {
    if frame.remote {
        return;
    }
    text.push_bytes(b"< frame ");
    write_id(frame, text);
    text.push_byte(b' ');
    text.push_decimal(wall_us / 1_000_000, 1);
    text.push_byte(b'.');
    text.push_decimal(wall_us % 1_000_000, 6);
    text.push_byte(b' ');
    frame.bytes().iter().for_each(|&byte| text.push_hex(byte.into(), 2));
    text.push_bytes(b" >");
}

fn write_id(frame: &Frame, text: &mut TextWriter<'_>) {
    text.push_hex(frame.id, if frame.extended { 8 } else { 3 });
}
