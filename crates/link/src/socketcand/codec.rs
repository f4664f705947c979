//! The elements of socketcand's ASCII protocol, for both of its ends: `doc/protocol.md` of the
//! project, and what its raw mode sends.

use polepair_core::medium::Frame;

use crate::hex::{self, Text};

/// The longest element taken; socketcand's own buffer.
pub const ELEMENT_MAX: usize = 128;
/// Words of an element that are looked at: `filter`, seconds, microseconds, identifier, length and
/// eight bytes, and one more to tell that there are too many.
const WORDS_MAX: usize = 14;

/// Cuts a stream of bytes into elements, from `<` to `>`.
#[derive(Clone, Debug)]
pub struct Elements {
    text: [u8; ELEMENT_MAX],
    len: usize,
    place: Place,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Place {
    Outside,
    Inside,
    Ended,
}

/// What a byte ended.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum End {
    /// An element, which [`Elements::text`] shows until the next byte.
    Element,
    /// Something that is none.
    Spoilt,
}

impl Default for Elements {
    fn default() -> Self {
        Self { text: [0; ELEMENT_MAX], len: 0, place: Place::Outside }
    }
}

impl Elements {
    /// Takes one byte; tells what it ended, if anything.
    pub fn push(&mut self, byte: u8) -> Option<End> {
        if self.place == Place::Ended {
            self.place = Place::Outside;
        }
        match (self.place, byte) {
            (place, b'<') => {
                (self.len, self.place) = (0, Place::Inside);
                // The end of the one before was lost.
                return (place == Place::Inside).then_some(End::Spoilt);
            }
            (Place::Inside, b'>') => {
                self.place = Place::Ended;
                return Some(End::Element);
            }
            (Place::Inside, b' '..=b'~') if self.len < ELEMENT_MAX => {
                self.text[self.len] = byte;
                self.len += 1;
            }
            (Place::Inside, _) => {
                self.place = Place::Outside;
                return Some(End::Spoilt);
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

/// What a client asks.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Request<'a> {
    /// The bus of that name.
    Open(&'a [u8]),
    /// Every frame from now on.
    RawMode,
    /// Only what is subscribed to.
    BcmMode,
    /// An answer, to see whether anybody is there.
    Echo,
    /// A frame to be sent.
    Send(Frame),
    /// Frames of an identifier, in place of what was wanted of it before.
    Subscribe(Wanted),
    /// No more of them.
    Unsubscribe(Id),
    /// Nothing that is known here.
    Unknown,
}

/// An identifier, and whether it is an extended one.
pub type Id = (u32, bool);

/// What a client wants to hear of an identifier.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Wanted {
    /// Which.
    pub id: Id,
    /// What comes sooner behind the last one than this, ns, is left out.
    pub every_ns: u64,
    /// Only frames in which one of these bits has changed; every one if `None`.
    pub mask: Option<[u8; 8]>,
}

impl<'a> Request<'a> {
    /// Reads an element of a client.
    #[must_use]
    pub fn of(text: &'a [u8]) -> Self {
        let mut words = [&b""[..]; WORDS_MAX];
        match split(text, &mut words) {
            [b"open", bus] => Self::Open(bus),
            [b"rawmode"] => Self::RawMode,
            [b"bcmmode"] => Self::BcmMode,
            [b"echo"] => Self::Echo,
            [b"send", id, len, data @ ..] => sent(id, len, data).map_or(Self::Unknown, Self::Send),
            [b"subscribe", s, us, id] => {
                let wanted = identified(id).and_then(|frame| wanted(s, us, &frame, None));
                wanted.map_or(Self::Unknown, Self::Subscribe)
            }
            [b"filter", s, us, id, len, data @ ..] => {
                let mask = sent(id, len, data);
                let wanted = mask.and_then(|mask| wanted(s, us, &mask, Some(mask.data)));
                wanted.map_or(Self::Unknown, Self::Subscribe)
            }
            [b"unsubscribe", id] => identified(id)
                .map_or(Self::Unknown, |frame| Self::Unsubscribe((frame.id, frame.extended))),
            _ => Self::Unknown,
        }
    }
}

/// What a server says.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Reply<'a> {
    /// It is there.
    Hi,
    /// It did as asked.
    Ok,
    /// The answer to an echo.
    Echo,
    /// A frame from the bus.
    Frame(Frame),
    /// An error frame of that class (`linux/can/error.h`).
    ErrorFrame(u32),
    /// It did not do as asked, and says why.
    Error(&'a [u8]),
    /// Nothing that a server says.
    Unknown,
}

impl<'a> Reply<'a> {
    /// Reads an element of a server.
    #[must_use]
    pub fn of(text: &'a [u8]) -> Self {
        let mut words = [&b""[..]; WORDS_MAX];
        match split(text, &mut words) {
            [b"hi"] => Self::Hi,
            [b"ok"] => Self::Ok,
            [b"echo"] => Self::Echo,
            [b"frame", id, _time, data @ ..] => {
                received(id, data).map_or(Self::Unknown, Self::Frame)
            }
            [b"error", class, time] if time.contains(&b'.') => {
                hex::number(class).map_or(Self::Unknown, Self::ErrorFrame)
            }
            [b"error", ..] => Self::Error(&text.trim_ascii()[5..]),
            _ => Self::Unknown,
        }
    }
}

/// Words between spaces, as many as there are places.
fn split<'a, 'w>(text: &'a [u8], words: &'w mut [&'a [u8]]) -> &'w [&'a [u8]] {
    let mut count = 0;
    let found = text.split(|&byte| byte == b' ').filter(|word| !word.is_empty());
    for (place, word) in words.iter_mut().zip(found) {
        *place = word;
        count += 1;
    }
    &words[..count]
}

/// Eight digits are an extended identifier, fewer a standard one.
fn identified(digits: &[u8]) -> Option<Frame> {
    let (id, extended) = (hex::number(digits)?, digits.len() == 8);
    let highest = if extended { 0x1FFF_FFFF } else { 0x7FF };
    (id <= highest).then_some(Frame { id, extended, ..Frame::default() })
}

/// `send`: the bytes as words of one or two digits.
fn sent(id: &[u8], len: &[u8], data: &[&[u8]]) -> Option<Frame> {
    let mut frame = identified(id)?;
    if hex::number(len)? as usize != data.len() || data.len() > 8 {
        return None;
    }
    for (byte, word) in frame.data.iter_mut().zip(data) {
        *byte = u8::try_from(hex::number(word)?).ok()?;
    }
    frame.len = data.len() as u8;
    Some(frame)
}

/// `subscribe` and `filter`: the interval as decimal seconds and microseconds.
fn wanted(s: &[u8], us: &[u8], of: &Frame, mask: Option<[u8; 8]>) -> Option<Wanted> {
    let decimal = |word| str::from_utf8(word).ok()?.parse::<u32>().ok().map(u64::from);
    let every_ns = decimal(s)? * 1_000_000_000 + decimal(us)? * 1000;
    Some(Wanted { id: (of.id, of.extended), every_ns, mask })
}

/// `frame`: the bytes as one word of digits, or as several.
fn received(id: &[u8], data: &[&[u8]]) -> Option<Frame> {
    let mut frame = identified(id)?;
    for pair in data.iter().flat_map(|word| word.chunks(2)) {
        let &[high, low] = pair else { return None };
        *frame.data.get_mut(usize::from(frame.len))? = hex::value(high)? << 4 | hex::value(low)?;
        frame.len += 1;
    }
    Some(frame)
}

/// Writes the request to send a frame; false when it cannot be said (remote frames).
pub(crate) fn write_send(frame: &Frame, text: &mut Text<'_>) -> bool {
    if frame.remote {
        return false;
    }
    text.bytes(b"< send ");
    write_id(frame, text);
    text.byte(b' ');
    text.number(frame.len.min(8).into(), 1);
    for &byte in frame.bytes() {
        text.byte(b' ');
        text.number(byte.into(), if byte < 0x10 { 1 } else { 2 });
    }
    text.bytes(b" >");
    true
}

/// Writes that a frame was received at `wall_us`, microseconds since 1970; nothing for a remote
/// frame, for which the protocol has no words.
#[cfg(unix)]
pub(crate) fn write_frame(frame: &Frame, wall_us: u64, text: &mut Text<'_>) {
    if frame.remote {
        return;
    }
    text.bytes(b"< frame ");
    write_id(frame, text);
    text.byte(b' ');
    text.decimal(wall_us / 1_000_000, 1);
    text.byte(b'.');
    text.decimal(wall_us % 1_000_000, 6);
    text.byte(b' ');
    frame.bytes().iter().for_each(|&byte| text.number(byte.into(), 2));
    text.bytes(b" >");
}

fn write_id(frame: &Frame, text: &mut Text<'_>) {
    text.number(frame.id, if frame.extended { 8 } else { 3 });
}
