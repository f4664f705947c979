//! The obeying end: deframes requests, has the firmware carry them out, answers.
//!
//! The firmware is lent with every call, so that one drive can stand behind several ends. Bytes are
//! told apart in one of two ways ([`Framing`]): by the length that a frame announces, confirmed by
//! the CRC, which survives splits, noise and glued frames; or by silence alone, as the TS drive does
//! (TS manual V2 §2.3: "more than 10 ms of silence is the end").

use super::ascii::{self, Collector, Fed};
use super::rtu::{self, ADU_MAX, ADU_MIN};
use super::wire::{
    BROADCAST, Exception, Format, Function, PDU_MAX, READ_WORDS_MAX, ReplyPdu, RequestPdu, Space,
    Span, WRITE_WORDS_MAX, words,
};
use crate::error::WireError;
use crate::medium::SerialLine;
use crate::station::LineEvent;
use crate::time::Instant;

/// Bytes kept of what arrived and was not carried out yet. What does not fit is lost and counted.
const BUFFER_MAX: usize = 2 * ADU_MAX;
/// An unfinished frame is given up after so long without a byte: longer than any adapter pauses,
/// shorter than any host waits for a reply.
const STALE_MS: u32 = 50;
/// A function without a known length is looked for at most over so many bytes.
const UNKNOWN_MAX: usize = 32;

/// How a drive now speaks.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Wire {
    /// RTU or ASCII.
    pub format: Format,
    /// Baud rate and character.
    pub line: SerialLine,
}

/// What a simulated drive does with requests.
pub trait Firmware {
    /// The station address it now listens to, 1 to 247.
    fn address(&self) -> u8;

    /// How it now speaks. Asked before every frame: a drive that changes it at power-up says so
    /// from then on.
    fn wire(&self) -> Wire;

    /// Whether it knows a function; others are refused with exception 01.
    fn supports(&self, function: Function) -> bool {
        !matches!(function, Function::Unknown(_))
    }

    /// Most registers that one request of `function` may carry in `format`; more is refused with
    /// exception 03. The TS drive takes 12 in ASCII (TS manual V2 §2.4) \[I\].
    fn words_max(&self, function: Function, format: Format) -> u16 {
        let _ = format;
        if function.reads().is_some() { READ_WORDS_MAX } else { WRITE_WORDS_MAX }
    }

    /// Whether a read of one bit brings all lines from there on, eight to the byte. The TS manual
    /// V2 §2.3 asks for length 1 and gets 0F. If so, [`read_bits`](Self::read_bits) is asked for
    /// eight, and lines that the drive does not have are to read as 0.
    fn whole_byte(&self) -> bool {
        false
    }

    /// Reads `count` coils or discrete inputs from `start` on into `out`, eight to a byte, lowest
    /// address in bit 0. `out` comes zeroed and has `count` / 8 bytes, rounded up.
    ///
    /// # Errors
    /// The exception to answer.
    fn read_bits(
        &mut self,
        now: Instant,
        space: Space,
        start: u16,
        count: u16,
        out: &mut [u8],
    ) -> Result<(), Exception>;

    /// Reads `out.len()` holding or input registers from `start` on.
    ///
    /// # Errors
    /// The exception to answer.
    fn read_words(
        &mut self,
        now: Instant,
        space: Space,
        start: u16,
        out: &mut [u16],
    ) -> Result<(), Exception>;

    /// Writes a coil. Several coils are written one after the other, up to the first refusal.
    ///
    /// # Errors
    /// The exception to answer.
    fn write_bit(&mut self, now: Instant, address: u16, on: bool) -> Result<(), Exception>;

    /// Writes holding registers from `start` on: one for function 06, 1 to 123 for function 10. All
    /// or none.
    ///
    /// # Errors
    /// The exception to answer.
    fn write_words(
        &mut self,
        now: Instant,
        function: Function,
        start: u16,
        words: &[u16],
    ) -> Result<(), Exception>;
}

/// How an RTU end tells frames apart.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Framing {
    /// By the length they announce, confirmed by the CRC.
    Length,
    /// By more than so many microseconds of silence, and nothing else: two requests closer than
    /// that are one bad frame.
    Silence {
        /// The silence, µs.
        us: u32,
    },
}

impl Framing {
    /// As the TS drive does: more than 10 ms (TS manual V2 §2.3).
    pub const TS: Self = Self::Silence { us: 10_000 };
}

/// What an obeying end counted.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Heard {
    /// Requests for this station that were carried out, broadcasts included.
    pub executed: u64,
    /// Requests that were answered with an exception, or would have been if not broadcast.
    pub refused: u64,
    /// Whole frames of or for others.
    pub foreign: u64,
    /// Frames whose check failed.
    pub corrupt: u64,
    /// Bytes that belonged to no frame.
    pub skipped: u64,
}

/// The protocol's obeying end on one serial line.
#[derive(Clone, Debug)]
pub struct SerialEnd {
    framing: Framing,
    format: Format,
    buffer: [u8; BUFFER_MAX],
    len: usize,
    overrun: bool,
    backlog: bool,
    characters: Collector,
    last_byte: Instant,
    reply: [u8; ascii::FRAME_MAX],
    reply_len: usize,
    reply_at: Instant,
    heard: Heard,
}

impl SerialEnd {
    /// An end that just got power.
    #[must_use]
    pub fn new(framing: Framing) -> Self {
        Self {
            framing,
            format: Format::Rtu,
            buffer: [0; BUFFER_MAX],
            len: 0,
            overrun: false,
            backlog: false,
            characters: Collector::default(),
            last_byte: Instant::ZERO,
            reply: [0; ascii::FRAME_MAX],
            reply_len: 0,
            reply_at: Instant::ZERO,
            heard: Heard::default(),
        }
    }

    /// What it counted.
    #[must_use]
    pub const fn heard(&self) -> Heard {
        self.heard
    }

    /// Takes bytes; `now` is when the last of them arrived.
    pub fn handle_input<F: Firmware>(&mut self, now: Instant, bytes: &[u8], firmware: &mut F) {
        self.follow(firmware);
        match self.format {
            Format::Ascii => self.store(bytes),
            Format::Rtu => {
                let first = firmware.wire().line.characters_ns(bytes.len() as u32);
                let silence = now.0.saturating_sub(first).saturating_sub(self.last_byte.0);
                if self.len > 0 && silence > self.end_ns() {
                    self.silence(now, firmware);
                }
                self.store(bytes);
            }
        }
        self.last_byte = now;
        self.work(now, firmware);
    }

    /// Takes what happened to the wire: whatever was half received or half sent is gone.
    pub fn handle_line(&mut self, event: LineEvent) {
        if !matches!(event, LineEvent::Up) {
            self.clear();
        }
    }

    /// To be called at or after [`poll_timeout`](Self::poll_timeout).
    pub fn handle_timeout<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        self.follow(firmware);
        let due = now.0 > self.last_byte.0.saturating_add(self.end_ns());
        if self.reply_len == 0 && matches!(self.format, Format::Rtu) && self.len > 0 && due {
            self.silence(now, firmware);
        }
        self.work(now, firmware);
    }

    /// When it next wants [`handle_timeout`](Self::handle_timeout), or
    /// [`poll_transmit`](Self::poll_transmit) for a reply that waits.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        if self.reply_len > 0 {
            return Some(self.reply_at);
        }
        match self.format {
            _ if self.len == 0 => None,
            _ if self.backlog => Some(self.last_byte),
            Format::Ascii => None,
            Format::Rtu => Some(self.last_byte.plus_ns(self.end_ns() + 1)),
        }
    }

    /// Writes the reply that is due into `out` and returns its length. `out` must hold
    /// [`STREAM_UNIT_MAX`](crate::medium::STREAM_UNIT_MAX) bytes, else the reply is lost.
    pub fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        if self.reply_len == 0 || now < self.reply_at {
            return None;
        }
        let len = core::mem::take(&mut self.reply_len);
        out.get_mut(..len)?.copy_from_slice(&self.reply[..len]);
        Some(len)
    }

    /// Forgets what was half received and what was not sent yet, as a loss of power does.
    pub fn clear(&mut self) {
        self.len = 0;
        self.overrun = false;
        self.backlog = false;
        self.reply_len = 0;
        self.characters.clear();
    }

    /// Silence after which what was received is judged, ns.
    fn end_ns(&self) -> u64 {
        match self.framing {
            Framing::Length => u64::from(STALE_MS) * 1_000_000,
            Framing::Silence { us } => u64::from(us) * 1000,
        }
    }

    const fn ends_by_silence(&self) -> bool {
        matches!((self.format, self.framing), (Format::Rtu, Framing::Silence { .. }))
    }

    /// Speaks as the firmware now does.
    fn follow<F: Firmware>(&mut self, firmware: &F) {
        let format = firmware.wire().format;
        if format != self.format && self.reply_len == 0 {
            self.clear();
            self.format = format;
        }
    }

    fn store(&mut self, bytes: &[u8]) {
        let room = BUFFER_MAX - self.len;
        let kept = bytes.len().min(room);
        self.buffer[self.len..self.len + kept].copy_from_slice(&bytes[..kept]);
        self.len += kept;
        self.overrun |= kept < bytes.len();
        self.heard.skipped += (bytes.len() - kept) as u64;
    }

    fn drop_front(&mut self, count: usize) {
        self.buffer.copy_within(count..self.len, 0);
        self.len -= count;
    }

    /// Carries out what is complete, until a reply waits to be sent.
    fn work<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        match (self.format, self.framing) {
            (Format::Ascii, _) => self.work_ascii(now, firmware),
            (Format::Rtu, Framing::Length) => self.work_by_length(now, firmware),
            (Format::Rtu, Framing::Silence { .. }) => {}
        }
        self.backlog = self.reply_len > 0 && self.len > 0 && !self.ends_by_silence();
    }

    /// The silence that ends a frame has passed.
    fn silence<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        match self.framing {
            Framing::Silence { .. } => self.take_all(now, firmware),
            Framing::Length => {
                while self.len > 0 && self.reply_len == 0 {
                    self.work_by_length(now, firmware);
                    if self.len > 0 && self.reply_len == 0 {
                        self.heard.skipped += 1;
                        self.drop_front(1);
                    }
                }
            }
        }
    }

    /// Everything since the last silence is one frame, good or bad.
    fn take_all<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        let len = core::mem::take(&mut self.len);
        let whole = !core::mem::take(&mut self.overrun) && (ADU_MIN..=ADU_MAX).contains(&len);
        if whole && rtu::agrees(&self.buffer[..len]) {
            self.take_rtu(now, len, firmware);
        } else {
            self.heard.corrupt += 1;
        }
    }

    fn work_by_length<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        while self.reply_len == 0 && self.len > 0 {
            match cut(&self.buffer[..self.len], firmware.address()) {
                Cut::Frame(len) => {
                    self.take_rtu(now, len, firmware);
                    self.drop_front(len);
                }
                Cut::Skip => {
                    self.heard.skipped += 1;
                    self.drop_front(1);
                }
                Cut::More => break,
            }
        }
    }

    fn work_ascii<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        let mut used = 0;
        while used < self.len && self.reply_len == 0 {
            let fed = self.characters.feed(self.buffer[used]);
            used += 1;
            match fed {
                Fed::Goes => {}
                Fed::Skipped(count) => self.heard.skipped += count as u64,
                Fed::Ended => self.take_ascii(now, firmware),
            }
        }
        self.drop_front(used);
    }

    fn take_rtu<F: Firmware>(&mut self, now: Instant, len: usize, firmware: &mut F) {
        let mut adu = [0; ADU_MAX];
        adu[..len].copy_from_slice(&self.buffer[..len]);
        self.take(now, adu[0], &adu[1..len - 2], firmware);
    }

    fn take_ascii<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        let mut bytes = [0; ADU_MAX];
        let len = self.characters.bytes().len();
        bytes[..len].copy_from_slice(self.characters.bytes());
        match ascii::open(&bytes[..len]) {
            Ok((unit, pdu)) if !pdu.is_empty() => self.take(now, unit, pdu, firmware),
            _ => self.heard.corrupt += 1,
        }
    }

    /// Carries out one frame whose check agrees. A broadcast is obeyed in silence.
    fn take<F: Firmware>(&mut self, now: Instant, unit: u8, pdu: &[u8], firmware: &mut F) {
        if unit != BROADCAST && unit != firmware.address() {
            self.heard.foreign += 1;
            return;
        }
        let wire = firmware.wire();
        let mut reply = [0; PDU_MAX + 3];
        let result = execute(now, pdu, unit == BROADCAST, self.format, firmware, &mut reply);
        match result {
            Ok(_) => self.heard.executed += 1,
            Err(_) => self.heard.refused += 1,
        }
        if unit == BROADCAST {
            return;
        }
        let function = pdu[0];
        let len = result.unwrap_or_else(|exception| {
            ReplyPdu::Exception { function, exception }.emit(&mut reply)
        });
        let put = |out: &mut [u8]| {
            out[..len].copy_from_slice(&reply[..len]);
            len
        };
        self.reply_len = match self.format {
            Format::Rtu => rtu::emit(unit, &mut self.reply, put),
            Format::Ascii => ascii::emit(unit, &mut self.reply, put),
        };
        self.reply_at = now.plus_ns(self.turnaround_ns(&wire.line));
    }

    /// A standard RTU station knows that a request ended after 3.5 characters of silence (MSL
    /// 2.5.1.1); an end that waited for silence already has waited.
    fn turnaround_ns(&self, line: &SerialLine) -> u64 {
        match (self.format, self.framing) {
            (Format::Rtu, Framing::Length) => rtu::silence_ns(line),
            _ => 0,
        }
    }
}

enum Cut {
    Frame(usize),
    Skip,
    More,
}

/// What the head of `bytes` is to the station `own`: requests to it or to all, or anything whole of
/// and for other stations, which is stepped over.
fn cut(bytes: &[u8], own: u8) -> Cut {
    let unit = bytes[0];
    let request = whole(bytes, rtu::request_span(bytes), unit == own || unit == BROADCAST);
    if matches!(request, Cut::Frame(_)) || unit == own || unit == BROADCAST {
        return request;
    }
    match whole(bytes, rtu::reply_span(bytes), false) {
        Cut::Skip => request,
        reply => reply,
    }
}

fn whole(bytes: &[u8], span: Span, mine: bool) -> Cut {
    match span {
        Span::Bytes(len) if bytes.len() < len => Cut::More,
        Span::Bytes(len) if rtu::agrees(&bytes[..len]) => Cut::Frame(len),
        Span::More => Cut::More,
        Span::Unknown if mine => search(bytes),
        Span::Bytes(_) | Span::Unknown | Span::Never => Cut::Skip,
    }
}

/// A frame of a function whose length is not known ends where the check first agrees.
fn search(bytes: &[u8]) -> Cut {
    let most = bytes.len().min(UNKNOWN_MAX);
    match (ADU_MIN..=most).find(|&len| rtu::agrees(&bytes[..len])) {
        Some(len) => Cut::Frame(len),
        None if bytes.len() < UNKNOWN_MAX => Cut::More,
        None => Cut::Skip,
    }
}

/// Has the firmware carry out a request, and writes the reply PDU.
fn execute<F: Firmware>(
    now: Instant,
    pdu: &[u8],
    broadcast: bool,
    format: Format,
    firmware: &mut F,
    reply: &mut [u8],
) -> Result<usize, Exception> {
    let function = Function::of_code(pdu[0]);
    if !firmware.supports(function) {
        return Err(Exception::IllegalFunction);
    }
    let request = RequestPdu::parse(pdu).map_err(refusal)?;
    match request {
        RequestPdu::Read { .. } if broadcast => Err(Exception::IllegalFunction),
        RequestPdu::Read { space, start, count } if space.is_bits() => {
            read_bits(now, space, start, count, firmware, reply)
        }
        RequestPdu::Read { space, start, count } => {
            limit(count, firmware.words_max(function, format))?;
            read_words(now, space, start, count, firmware, reply)
        }
        RequestPdu::WriteCoil { address, on } => {
            firmware.write_bit(now, address, on)?;
            Ok(ReplyPdu::WroteCoil { address, on }.emit(reply))
        }
        RequestPdu::WriteRegister { address, value } => {
            firmware.write_words(now, function, address, &[value])?;
            Ok(ReplyPdu::WroteRegister { address, value }.emit(reply))
        }
        RequestPdu::WriteCoils { start, count, bits } => {
            write_coils(now, start, count, bits, firmware)?;
            Ok(ReplyPdu::Wrote { coils: true, start, count }.emit(reply))
        }
        RequestPdu::WriteRegisters { start, words: data } => {
            let count = (data.len() / 2) as u16;
            limit(count, firmware.words_max(function, format))?;
            write_words(now, start, data, firmware)?;
            Ok(ReplyPdu::Wrote { coils: false, start, count }.emit(reply))
        }
        RequestPdu::Unknown { .. } => Err(Exception::IllegalFunction),
    }
}

/// A request that contradicts itself is an illegal value (MAP 7, exception 03).
const fn refusal(_: WireError) -> Exception {
    Exception::IllegalValue
}

const fn limit(count: u16, most: u16) -> Result<(), Exception> {
    if count > most { Err(Exception::IllegalValue) } else { Ok(()) }
}

/// An address range must not run over FFFF.
const fn range(start: u16, count: u16) -> Result<(), Exception> {
    match start.checked_add(count - 1) {
        Some(_) => Ok(()),
        None => Err(Exception::IllegalAddress),
    }
}

fn read_bits<F: Firmware>(
    now: Instant,
    space: Space,
    start: u16,
    count: u16,
    firmware: &mut F,
    reply: &mut [u8],
) -> Result<usize, Exception> {
    range(start, count)?;
    let asked = if count == 1 && firmware.whole_byte() { 8 } else { count };
    let mut bits = [0; PDU_MAX - 2];
    let bits = &mut bits[..usize::from(asked).div_ceil(8)];
    firmware.read_bits(now, space, start, asked, bits)?;
    Ok(ReplyPdu::Read { space, data: bits }.emit(reply))
}

fn read_words<F: Firmware>(
    now: Instant,
    space: Space,
    start: u16,
    count: u16,
    firmware: &mut F,
    reply: &mut [u8],
) -> Result<usize, Exception> {
    range(start, count)?;
    let mut values = [0; READ_WORDS_MAX as usize];
    let values = &mut values[..usize::from(count)];
    firmware.read_words(now, space, start, values)?;
    let mut data = [0; 2 * READ_WORDS_MAX as usize];
    for (pair, value) in data.as_chunks_mut::<2>().0.iter_mut().zip(&*values) {
        *pair = value.to_be_bytes();
    }
    Ok(ReplyPdu::Read { space, data: &data[..2 * values.len()] }.emit(reply))
}

fn write_coils<F: Firmware>(
    now: Instant,
    start: u16,
    count: u16,
    bits: &[u8],
    firmware: &mut F,
) -> Result<(), Exception> {
    range(start, count)?;
    for at in 0..count {
        let on = bits[usize::from(at / 8)] >> (at % 8) & 1 == 1;
        firmware.write_bit(now, start + at, on)?;
    }
    Ok(())
}

fn write_words<F: Firmware>(
    now: Instant,
    start: u16,
    data: &[u8],
    firmware: &mut F,
) -> Result<(), Exception> {
    let mut values = [0; WRITE_WORDS_MAX as usize];
    let count = data.len() / 2;
    range(start, count as u16)?;
    for (value, word) in values.iter_mut().zip(words(data)) {
        *value = word;
    }
    firmware.write_words(now, Function::WriteRegisters, start, &values[..count])
}
