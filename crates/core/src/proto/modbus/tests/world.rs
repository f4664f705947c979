//! A hand-made wire with virtual time, a small drive behind it, and faults on demand.

extern crate std;

use std::collections::{BTreeMap, VecDeque};
use std::vec::Vec;

use crate::error::Failure;
use crate::medium::SerialLine;
use crate::proto::HostOptions;
use crate::proto::modbus::device::{Firmware, Framing, SerialEndpoint, SerialSettings};
use crate::proto::modbus::host::SerialHost;
use crate::proto::modbus::host_request::{Answer, HostRequest, RequestBody};
use crate::proto::modbus::wire::{Exception, Function, Space, WireFormat};
use crate::station::{EventSubject, Host as _, RequestClass, Station, Ticket, Timed};
use crate::time::Instant;

pub const UNTIMED: HostOptions = HostOptions { reply_timeout_ms: Some(100), ..HostOptions::new(0) };

/// A register file that notes what was written.
#[derive(Debug)]
pub struct RegisterDrive {
    pub address: u8,
    pub format: WireFormat,
    pub baud: u32,
    pub whole_byte: bool,
    pub registers: BTreeMap<u16, u16>,
    pub coils: u16,
    /// A function that it does not have.
    pub lacks: Option<Function>,
    pub writes: Vec<(u16, Vec<u16>)>,
}

impl RegisterDrive {
    pub fn new(address: u8, format: WireFormat, baud: u32) -> Self {
        let registers = (0..0x200_u16).map(|n| (n, n.wrapping_mul(257))).collect();
        let (coils, lacks, writes) = (0b0101, None, Vec::new());
        Self { address, format, baud, whole_byte: false, registers, coils, lacks, writes }
    }
}

impl Firmware for RegisterDrive {
    fn address(&self) -> u8 {
        self.address
    }

    fn serial_settings(&self) -> SerialSettings {
        SerialSettings { format: self.format, line: SerialLine::new_8n1(self.baud) }
    }

    fn supports(&self, function: Function) -> bool {
        Some(function) != self.lacks && !matches!(function, Function::Unknown(_))
    }

    fn words_max(&self, function: Function, format: WireFormat) -> u16 {
        match format {
            WireFormat::Ascii => 12,
            WireFormat::Rtu | WireFormat::Tcp if function.read_space().is_some() => 125,
            WireFormat::Rtu | WireFormat::Tcp => 123,
        }
    }

    fn reads_whole_bytes(&self) -> bool {
        self.whole_byte
    }

    fn read_bits(
        &mut self,
        _: Instant,
        _: Space,
        start: u16,
        count: u16,
        out: &mut [u8],
    ) -> Result<(), Exception> {
        if start + count > 16 {
            return Err(Exception::IllegalAddress);
        }
        for at in 0..count {
            out[usize::from(at / 8)] |= ((self.coils >> (start + at) & 1) as u8) << (at % 8);
        }
        Ok(())
    }

    fn read_words(
        &mut self,
        _: Instant,
        _: Space,
        start: u16,
        out: &mut [u16],
    ) -> Result<(), Exception> {
        for (at, word) in (start..).zip(out) {
            *word = *self.registers.get(&at).ok_or(Exception::IllegalAddress)?;
        }
        Ok(())
    }

    fn write_bit(&mut self, _: Instant, address: u16, on: bool) -> Result<(), Exception> {
        if address > 15 {
            return Err(Exception::IllegalAddress);
        }
        self.writes.push((address, std::vec![u16::from(on)]));
        self.coils = self.coils & !(1 << address) | u16::from(on) << address;
        Ok(())
    }

    fn write_words(
        &mut self,
        _: Instant,
        _: Function,
        start: u16,
        words: &[u16],
    ) -> Result<(), Exception> {
        if usize::from(start) + words.len() > 0x200 {
            return Err(Exception::IllegalAddress);
        }
        self.writes.push((start, words.to_vec()));
        for (at, &word) in (start..).zip(words) {
            self.registers.insert(at, word);
        }
        Ok(())
    }
}

/// Fault of a wire for a reply: the bytes that arrive, each with its time after the reply was sent.
pub type ReplyFault = std::boxed::Box<dyn FnMut(usize, Vec<u8>) -> Vec<(u64, Vec<u8>)>>;

/// Host and drive on one wire.
#[allow(missing_debug_implementations)]
pub struct TestWorld {
    pub now: Instant,
    pub host: SerialHost,
    pub end: SerialEndpoint,
    pub drive: RegisterDrive,
    /// Applied to each reply, counted from 1.
    pub fault: ReplyFault,
    pub replies: usize,
    /// The host receives its own frames.
    pub echo: bool,
    /// The largest piece in which bytes arrive.
    pub piece: usize,
    to_host: VecDeque<(Instant, Vec<u8>)>,
    to_drive: VecDeque<(Instant, Vec<u8>)>,
    ticket: u32,
}

impl TestWorld {
    pub fn new(format: WireFormat, framing: Framing, options: &HostOptions) -> Self {
        Self {
            now: Instant(1_000_000_000),
            host: SerialHost::new(format, options),
            end: SerialEndpoint::new(framing),
            drive: RegisterDrive::new(1, format, options.baud),
            fault: std::boxed::Box::new(|_, bytes| std::vec![(0, bytes)]),
            replies: 0,
            echo: false,
            piece: 1000,
            to_host: VecDeque::new(),
            to_drive: VecDeque::new(),
            ticket: 0,
        }
    }

    pub fn plain(format: WireFormat) -> Self {
        Self::new(format, Framing::Length, &UNTIMED)
    }

    fn pieces(&self, at: Instant, bytes: &[u8]) -> Vec<(Instant, Vec<u8>)> {
        let line = SerialLine::new_8n1(self.drive.baud);
        let mut sent = 0;
        let piece = |piece: &[u8]| {
            sent += piece.len();
            (at.plus_ns(line.characters_ns(sent as u32) + 1000), piece.to_vec())
        };
        bytes.chunks(self.piece).map(piece).collect()
    }

    /// One event: whatever comes first. False when nothing is to come.
    pub fn step(&mut self) -> bool {
        self.drain();
        let times = [
            self.to_host.iter().map(|x| x.0).min(),
            self.to_drive.iter().map(|x| x.0).min(),
            self.host.poll_timeout(),
            self.end.poll_timeout(),
        ];
        let Some(next) = times.into_iter().flatten().min() else { return false };
        self.now = self.now.max(next);
        if times[0] == Some(next) {
            let at = self.to_host.iter().position(|x| x.0 == next).unwrap();
            let (_, bytes) = self.to_host.remove(at).unwrap();
            self.host.handle_input(self.now, &bytes);
        } else if times[1] == Some(next) {
            let at = self.to_drive.iter().position(|x| x.0 == next).unwrap();
            let (_, bytes) = self.to_drive.remove(at).unwrap();
            self.end.handle_input(self.now, &bytes, &mut self.drive);
        }
        self.host.handle_timeout(self.now);
        self.end.handle_timeout(self.now, &mut self.drive);
        self.drain();
        true
    }

    fn drain(&mut self) {
        let mut out = [0; 520];
        while let Some(len) = self.host.poll_transmit(self.now, &mut out) {
            let pieces = self.pieces(self.now, &out[..len]);
            if self.echo {
                self.to_host.extend(pieces.clone());
            }
            self.to_drive.extend(pieces);
        }
        while let Some(len) = self.end.poll_transmit(self.now, &mut out) {
            self.replies += 1;
            for (delay_ns, bytes) in (self.fault)(self.replies, out[..len].to_vec()) {
                // A drive answers in order.
                let last = self.to_host.back().map_or(self.now, |last| last.0);
                let at = self.now.plus_ns(delay_ns).max(if self.echo { self.now } else { last });
                let pieces = self.pieces(at, &bytes);
                self.to_host.extend(pieces);
            }
        }
    }

    pub fn inject_to_drive(&mut self, bytes: &[u8]) {
        self.end.handle_input(self.now, bytes, &mut self.drive);
    }

    /// Asks and runs until the answer.
    pub fn request(
        &mut self,
        unit: u8,
        query: RequestBody,
        class: RequestClass,
    ) -> Result<Answer, Failure> {
        self.ticket += 1;
        let ticket = Ticket(self.ticket);
        let request = HostRequest { unit, body: query, class };
        let mut steps = 0;
        while self.host.submit(self.now, ticket, request).is_err() {
            assert!(self.step(), "nothing to come, yet the host is not free");
            steps += 1;
            assert!(steps < 10_000, "never free");
        }
        for _ in 0..10_000 {
            if let Some((to, result)) = self.host.poll_event() {
                assert_eq!(*to, EventSubject::Request(ticket));
                return *result;
            }
            assert!(self.step(), "nothing to come, yet no outcome");
        }
        panic!("a request that never ends");
    }

    pub fn read(&mut self, start: u16, count: u16) -> Result<Answer, Failure> {
        self.request(
            1,
            RequestBody::Read { space: Space::Holding, start, count },
            RequestClass::Idempotent,
        )
    }

    pub fn write(&mut self, address: u16, value: u16) -> Result<Answer, Failure> {
        self.request(1, RequestBody::WriteRegister { address, value }, RequestClass::NoRetry)
    }

    /// Runs until nothing more happens.
    pub fn rest(&mut self) {
        for _ in 0..10_000 {
            if !self.step() {
                return;
            }
        }
        panic!("it never comes to rest");
    }
}
