//! The device end: deframes requests, executes them in the firmware, replies.
//!
//! The firmware is passed to each call, so one drive can have several ends. Frames are separated in one of
//! two ways ([`Framing`]): by the announced length, confirmed by the CRC, which works with split, noisy and
//! joined frames; or by silence, like the TS drive (TS manual V2 §2.3: "more than 10 ms of silence is the
//! end").

use super::ascii::{self, AsciiDeframer, FeedResult};
use super::rtu::{self, ADU_MAX, ADU_MIN};
use super::tcp;
use super::wire::{
    AnnouncedLength, BROADCAST, Exception, Function, PDU_MAX, READ_WORDS_MAX, ReplyPdu, RequestPdu,
    Space, WRITE_WORDS_MAX, WireFormat, words,
};
use crate::error::WireError;
use crate::medium::SerialLine;
use crate::station::LineEvent;
use crate::time::Instant;
use core::time::Duration;

/// Received bytes that are kept until they are processed. Further ones are lost and counted.
const BUFFER_MAX: usize = 8 * ADU_MAX;
/// An unfinished frame is discarded after this time without a byte: longer than any adapter pauses,
/// shorter than any host waits for a reply.
const STALE_MS: u32 = 50;
/// The limit for TCP, where a segment may be sent again.
const TCP_STALE: Duration = Duration::from_secs(2);
/// Longest search for the end of a function without a known length, bytes.
const UNKNOWN_LEN_MAX: usize = 32;

/// Serial settings of a drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SerialSettings {
    /// RTU or ASCII.
    pub format: WireFormat,
    /// Baud rate and character.
    pub line: SerialLine,
}

/// The firmware of a simulated drive.
pub trait Firmware {
    /// The station address it now listens to, 1 to 247.
    fn address(&self) -> u8;

    /// Present settings of the serial line. Asked before every frame: a drive that changes them at power-up returns the
    /// new ones from then on.
    fn serial_settings(&self) -> SerialSettings;

    /// Returns whether it supports a function; others are refused with exception 01.
    fn supports(&self, function: Function) -> bool {
        !matches!(function, Function::Unknown(_) | Function::ReadWriteRegisters)
    }

    /// Most registers that one request of `function` may carry in `format`; more is refused with
    /// exception 03. The TS drive takes 12 in ASCII (TS manual V2 §2.4) \[I\].
    fn words_max(&self, function: Function, format: WireFormat) -> u16 {
        let _ = format;
        if function.read_space().is_some() { READ_WORDS_MAX } else { WRITE_WORDS_MAX }
    }

    /// Returns whether a read of one bit returns all lines from there on, eight to the byte. The TS manual V2 §2.3
    /// requests length 1 and receives 0F. If so, [`read_bits`](Self::read_bits) is called for eight, and lines that the
    /// drive does not have read as 0.
    fn reads_whole_bytes(&self) -> bool {
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

/// Separation of frames at an RTU end.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Framing {
    /// Framing by the announced length, confirmed by the CRC.
    Length,
    /// Framing by silence longer than this, µs, and nothing else: two requests with a shorter gap are one bad frame.
    Silence {
        /// The silence, µs.
        us: u32,
    },
}

impl Framing {
    /// Framing of the TS drive: more than 10 ms (TS manual V2 §2.3).
    pub const TS: Self = Self::Silence { us: 10_000 };
}

/// Counters of a device end.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct EndpointCounters {
    /// Requests for this station that were carried out, broadcasts included.
    pub executed: u64,
    /// Requests that were answered with an exception, or would have been if not broadcast.
    pub refused: u64,
    /// Whole frames of or for others.
    pub foreign: u64,
    /// Frames with a wrong check sum.
    pub corrupt: u64,
    /// Bytes that belonged to no frame.
    pub skipped: u64,
}

/// The protocol's obeying end on one serial line.
#[derive(Clone, Debug)]
pub struct SerialEndpoint {
    framing: Framing,
    format: WireFormat,
    buffer: [u8; BUFFER_MAX],
    len: usize,
    overrun: bool,
    backlog: bool,
    ascii: AsciiDeframer,
    /// Transaction of the present request, on TCP.
    transaction: u16,
    last_byte: Instant,
    reply: [u8; ascii::FRAME_MAX],
    reply_len: usize,
    reply_at: Instant,
    counters: EndpointCounters,
}

impl SerialEndpoint {
    /// An end that just got power.
    #[must_use]
    pub fn new(framing: Framing) -> Self {
        Self {
            framing,
            format: WireFormat::Rtu,
            buffer: [0; BUFFER_MAX],
            len: 0,
            overrun: false,
            backlog: false,
            ascii: AsciiDeframer::default(),
            transaction: 0,
            last_byte: Instant::ZERO,
            reply: [0; ascii::FRAME_MAX],
            reply_len: 0,
            reply_at: Instant::ZERO,
            counters: EndpointCounters::default(),
        }
    }

    /// Counters of the endpoint.
    #[must_use]
    pub const fn counters(&self) -> EndpointCounters {
        self.counters
    }

    /// Takes bytes; `now` is when the last of them arrived.
    pub fn handle_input<F: Firmware>(&mut self, now: Instant, bytes: &[u8], firmware: &mut F) {
        self.apply_format(firmware);
        match self.format {
            WireFormat::Ascii => self.buffer_bytes(bytes),
            WireFormat::Tcp => {
                // The rest of a frame comes from the connection that sent its beginning, or never.
                if now.since(self.last_byte) > TCP_STALE {
                    self.counters.skipped += self.len as u64;
                    self.len = 0;
                }
                self.buffer_bytes(bytes);
            }
            WireFormat::Rtu => {
                let first = firmware.serial_settings().line.characters_ns(bytes.len() as u32);
                // The bytes are handed over when the last one has come: the silence was before the first.
                let silence = now.0.saturating_sub(first).saturating_sub(self.last_byte.0);
                if self.len > 0 && silence > self.frame_end_ns() {
                    self.handle_silence(now, firmware);
                }
                self.buffer_bytes(bytes);
            }
        }
        self.last_byte = now;
        self.process_buffer(now, firmware);
    }

    /// Handles an event of the wire: half-received and half-sent frames are discarded.
    pub fn handle_line(&mut self, event: LineEvent) {
        if !matches!(event, LineEvent::Up) {
            self.clear();
        }
    }

    /// To be called at or after [`poll_timeout`](Self::poll_timeout).
    pub fn handle_timeout<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        self.apply_format(firmware);
        let due = now.0 > self.last_byte.0.saturating_add(self.frame_end_ns());
        if self.reply_len == 0 && matches!(self.format, WireFormat::Rtu) && self.len > 0 && due {
            self.handle_silence(now, firmware);
        }
        self.process_buffer(now, firmware);
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
            WireFormat::Ascii | WireFormat::Tcp => None,
            WireFormat::Rtu => Some(self.last_byte.plus_ns(self.frame_end_ns() + 1)),
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

    /// Discards half-received and unsent bytes, as a loss of power does.
    pub fn clear(&mut self) {
        self.len = 0;
        self.overrun = false;
        self.backlog = false;
        self.reply_len = 0;
        self.ascii.clear();
    }

    /// Silence after which the received bytes are processed, ns.
    fn frame_end_ns(&self) -> u64 {
        match self.framing {
            Framing::Length => u64::from(STALE_MS) * 1_000_000,
            Framing::Silence { us } => u64::from(us) * 1000,
        }
    }

    const fn ends_by_silence(&self) -> bool {
        matches!((self.format, self.framing), (WireFormat::Rtu, Framing::Silence { .. }))
    }

    /// Applies the firmware's present format.
    fn apply_format<F: Firmware>(&mut self, firmware: &F) {
        let format = firmware.serial_settings().format;
        if format != self.format && self.reply_len == 0 {
            self.clear();
            self.format = format;
        }
    }

    fn buffer_bytes(&mut self, bytes: &[u8]) {
        let capacity = BUFFER_MAX - self.len;
        let stored = bytes.len().min(capacity);
        self.buffer[self.len..self.len + stored].copy_from_slice(&bytes[..stored]);
        self.len += stored;
        // A frame that has lost bytes must fail its check, and not be cut elsewhere.
        self.overrun |= stored < bytes.len();
        self.counters.skipped += (bytes.len() - stored) as u64;
    }

    fn drop_front(&mut self, count: usize) {
        debug_assert!(count <= self.len);
        self.buffer.copy_within(count..self.len, 0);
        self.len -= count;
    }

    /// Executes complete requests, until a reply waits to be sent.
    fn process_buffer<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        match (self.format, self.framing) {
            (WireFormat::Ascii, _) => self.process_ascii(now, firmware),
            (WireFormat::Tcp, _) => self.process_tcp(now, firmware),
            (WireFormat::Rtu, Framing::Length) => self.process_by_length(now, firmware),
            (WireFormat::Rtu, Framing::Silence { .. }) => {}
        }
        self.backlog = self.reply_len > 0 && self.len > 0 && !self.ends_by_silence();
    }

    /// The silence that ends a frame has passed.
    fn handle_silence<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        match self.framing {
            Framing::Silence { .. } => self.process_whole_buffer(now, firmware),
            Framing::Length => {
                while self.len > 0 && self.reply_len == 0 {
                    self.process_by_length(now, firmware);
                    if self.len > 0 && self.reply_len == 0 {
                        self.counters.skipped += 1;
                        self.drop_front(1);
                    }
                }
            }
        }
    }

    /// Everything since the last silence is one frame, good or bad.
    fn process_whole_buffer<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        let len = core::mem::take(&mut self.len);
        let whole = !core::mem::take(&mut self.overrun) && (ADU_MIN..=ADU_MAX).contains(&len);
        if whole && rtu::crc_matches(&self.buffer[..len]) {
            self.handle_rtu_frame(now, len, firmware);
        } else {
            self.counters.corrupt += 1;
        }
    }

    fn process_by_length<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        while self.reply_len == 0 && self.len > 0 {
            match scan_head(&self.buffer[..self.len], firmware.address()) {
                RequestScan::Frame(len) => {
                    self.handle_rtu_frame(now, len, firmware);
                    self.drop_front(len);
                }
                RequestScan::Skip => {
                    self.counters.skipped += 1;
                    self.drop_front(1);
                }
                RequestScan::More => break,
            }
        }
    }

    fn process_ascii<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        let mut used = 0;
        while used < self.len && self.reply_len == 0 {
            let fed = self.ascii.feed(self.buffer[used]);
            used += 1;
            match fed {
                FeedResult::Incomplete => {}
                FeedResult::Skipped(count) => self.counters.skipped += count as u64,
                FeedResult::Complete => self.handle_ascii_frame(now, firmware),
            }
        }
        self.drop_front(used);
    }

    fn handle_rtu_frame<F: Firmware>(&mut self, now: Instant, len: usize, firmware: &mut F) {
        debug_assert!((ADU_MIN..=ADU_MAX).contains(&len));
        let mut adu = [0; ADU_MAX];
        adu[..len].copy_from_slice(&self.buffer[..len]);
        self.handle_pdu(now, adu[0], &adu[1..len - 2], firmware);
    }

    /// Executes the requests of a connection one after the other, however many wait.
    fn process_tcp<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        while self.reply_len == 0 && self.len > 0 {
            match tcp::span(&self.buffer[..self.len]) {
                AnnouncedLength::Bytes(len) if len <= self.len => {
                    let mut adu = [0; tcp::ADU_MAX];
                    adu[..len].copy_from_slice(&self.buffer[..len]);
                    self.drop_front(len);
                    if let Ok((header, pdu)) = tcp::decode(&adu[..len]) {
                        self.transaction = header.transaction;
                        self.handle_pdu(now, header.unit, pdu, firmware);
                    }
                }
                AnnouncedLength::Bytes(_) | AnnouncedLength::More => break,
                AnnouncedLength::Unknown | AnnouncedLength::Never => {
                    self.counters.skipped += 1;
                    self.drop_front(1);
                }
            }
        }
    }

    fn handle_ascii_frame<F: Firmware>(&mut self, now: Instant, firmware: &mut F) {
        let mut bytes = [0; ADU_MAX];
        let len = self.ascii.bytes().len();
        bytes[..len].copy_from_slice(self.ascii.bytes());
        match ascii::decode(&bytes[..len]) {
            Ok((unit, pdu)) if !pdu.is_empty() => self.handle_pdu(now, unit, pdu, firmware),
            _ => self.counters.corrupt += 1,
        }
    }

    /// Executes one frame with a valid check sum. A broadcast has no reply.
    fn handle_pdu<F: Firmware>(&mut self, now: Instant, unit: u8, pdu: &[u8], firmware: &mut F) {
        if !self.is_addressed(unit, firmware.address()) {
            self.counters.foreign += 1;
            return;
        }
        let wire = firmware.serial_settings();
        let mut reply = [0; PDU_MAX + 3];
        let result = execute(now, pdu, unit == BROADCAST, self.format, firmware, &mut reply);
        match result {
            Ok(_) => self.counters.executed += 1,
            Err(_) => self.counters.refused += 1,
        }
        // Executed, but never answered (Modbus serial line, 2.1).
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
            WireFormat::Rtu => rtu::emit(unit, &mut self.reply, put),
            WireFormat::Ascii => ascii::emit(unit, &mut self.reply, put),
            WireFormat::Tcp => {
                let header = tcp::Header { transaction: self.transaction, unit };
                tcp::emit(header, &mut self.reply, put)
            }
        };
        self.reply_at = now.plus_ns(self.turnaround_ns(&wire.line));
    }

    /// Returns whether this station executes requests to a unit. On TCP the first station is also the device itself.
    const fn is_addressed(&self, unit: u8, own: u8) -> bool {
        let is_device = matches!(self.format, WireFormat::Tcp) && unit == tcp::DEVICE_UNIT;
        unit == BROADCAST || unit == own || is_device && own == 1
    }

    /// A standard RTU station detects the end of a request after 3.5 characters of silence (MSL 2.5.1.1); an
    /// end that waited for silence has already waited.
    fn turnaround_ns(&self, line: &SerialLine) -> u64 {
        match (self.format, self.framing) {
            (WireFormat::Rtu, Framing::Length) => rtu::silence_ns(line),
            _ => 0,
        }
    }
}

enum RequestScan {
    Frame(usize),
    Skip,
    More,
}

/// Classifies the head of `bytes` for the station `own`: requests to it or to all, or valid frames of and for
/// other stations, which are skipped.
fn scan_head(bytes: &[u8], own: u8) -> RequestScan {
    let unit = bytes[0];
    let request = check_span(bytes, rtu::request_span(bytes), unit == own || unit == BROADCAST);
    if matches!(request, RequestScan::Frame(_)) || unit == own || unit == BROADCAST {
        return request;
    }
    match check_span(bytes, rtu::reply_span(bytes), false) {
        RequestScan::Skip => request,
        reply => reply,
    }
}

fn check_span(bytes: &[u8], span: AnnouncedLength, mine: bool) -> RequestScan {
    match span {
        AnnouncedLength::Bytes(len) if bytes.len() < len => RequestScan::More,
        AnnouncedLength::Bytes(len) if rtu::crc_matches(&bytes[..len]) => RequestScan::Frame(len),
        AnnouncedLength::More => RequestScan::More,
        AnnouncedLength::Unknown if mine => find_by_crc(bytes),
        AnnouncedLength::Bytes(_) | AnnouncedLength::Unknown | AnnouncedLength::Never => {
            RequestScan::Skip
        }
    }
}

/// A frame of a function with unknown length ends where the check sum is first valid.
fn find_by_crc(bytes: &[u8]) -> RequestScan {
    let max = bytes.len().min(UNKNOWN_LEN_MAX);
    match (ADU_MIN..=max).find(|&len| rtu::crc_matches(&bytes[..len])) {
        Some(len) => RequestScan::Frame(len),
        None if bytes.len() < UNKNOWN_LEN_MAX => RequestScan::More,
        None => RequestScan::Skip,
    }
}

/// Has the firmware carry out a request, and writes the reply PDU.
fn execute<F: Firmware>(
    now: Instant,
    pdu: &[u8],
    broadcast: bool,
    format: WireFormat,
    firmware: &mut F,
    reply: &mut [u8],
) -> Result<usize, Exception> {
    let function = Function::of_code(pdu[0]);
    if !firmware.supports(function) {
        return Err(Exception::IllegalFunction);
    }
    let request = RequestPdu::parse(pdu).map_err(exception_for)?;
    match request {
        RequestPdu::Read { .. } if broadcast => Err(Exception::IllegalFunction),
        RequestPdu::Read { space, start, count } if space.is_bits() => {
            read_bits(now, space, start, count, firmware, reply)
        }
        RequestPdu::Read { space, start, count } => {
            check_count(count, firmware.words_max(function, format))?;
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
        RequestPdu::WriteRegisters { start, words } => {
            let count = (words.len() / 2) as u16;
            check_count(count, firmware.words_max(function, format))?;
            write_words(now, start, words, firmware)?;
            Ok(ReplyPdu::Wrote { coils: false, start, count }.emit(reply))
        }
        // No station answers a broadcast, and this one reads.
        RequestPdu::ReadWriteRegisters { .. } if broadcast => Err(Exception::IllegalFunction),
        RequestPdu::ReadWriteRegisters { read_start, read_count, start, words } => {
            check_count(read_count, firmware.words_max(Function::ReadHoldingRegisters, format))?;
            check_range(read_start, read_count)?;
            // A refused read leaves nothing written, so it is tried before the write, which comes before the read that
            // is answered (MAP 6.17).
            read_words(now, Space::Holding, read_start, read_count, firmware, reply)?;
            write_words(now, start, words, firmware)?;
            let len = read_words(now, Space::Holding, read_start, read_count, firmware, reply)?;
            reply[0] = function.code();
            Ok(len)
        }
        RequestPdu::Unknown { .. } => Err(Exception::IllegalFunction),
    }
}

/// A request that contradicts itself is an illegal value (MAP 7, exception 03).
const fn exception_for(_: WireError) -> Exception {
    Exception::IllegalValue
}

const fn check_count(count: u16, max: u16) -> Result<(), Exception> {
    if count > max { Err(Exception::IllegalValue) } else { Ok(()) }
}

/// An address range must not run over FFFF.
const fn check_range(start: u16, count: u16) -> Result<(), Exception> {
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
    check_range(start, count)?;
    // Some drives fill the whole byte even where one bit was asked for.
    let requested = if count == 1 && firmware.reads_whole_bytes() { 8 } else { count };
    let mut bits = [0; PDU_MAX - 2];
    let bits = &mut bits[..usize::from(requested).div_ceil(8)];
    firmware.read_bits(now, space, start, requested, bits)?;
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
    check_range(start, count)?;
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
    check_range(start, count)?;
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
    // The whole range before the first register: a refused write has changed nothing.
    check_range(start, count as u16)?;
    for (value, word) in values.iter_mut().zip(words(data)) {
        *value = word;
    }
    firmware.write_words(now, Function::WriteRegisters, start, &values[..count])
}
