//! Receiving: frames found in the bytes, echoes taken out, replies struck from the ledger.

use super::{
    Answered, Echo, Host, Owed, QUARANTINE_TIMEOUTS, Role, SUSPECT_NS, TIMELY_MIN, answer_to,
};
use crate::error::Failure;
use crate::proto::modbus::ascii::{self, Fed};
use crate::proto::modbus::request::{Answer, Request, WORDS_MAX};
use crate::proto::modbus::rtu::{self, ADU_MAX};
use crate::proto::modbus::wire::{
    BROADCAST, EXCEPTION_BIT, Format, Function, ReplyPdu, Span, words,
};
use crate::station::Counters;
use crate::time::Instant;

impl Host {
    pub(super) fn skip(&mut self, count: usize) {
        self.junk |= count > 0;
        self.counters.skipped += count as u64;
        self.drop_front(count);
    }

    fn drop_front(&mut self, count: usize) {
        self.received.copy_within(count..self.received_len, 0);
        self.received_len -= count;
        self.pace.took(count);
    }

    pub(super) fn work_rtu(&mut self, now: Instant) {
        while self.received_len > 0 {
            match self.cut() {
                Cut::Skip(count) => self.skip(count),
                Cut::More => break,
                Cut::Echo => {
                    self.identical(now);
                    self.drop_front(self.sent_len);
                }
                Cut::Frame(len) => {
                    let mut adu = [0; ADU_MAX];
                    adu[..len].copy_from_slice(&self.received[..len]);
                    self.soon = self.pace.early() > 0;
                    self.drop_front(len);
                    self.frame(now, adu[0], &adu[1..len - 2]);
                }
            }
        }
    }

    /// What the head of the received bytes is.
    fn cut(&mut self) -> Cut {
        let bytes = &self.received[..self.received_len];
        let sent = &self.sent[..self.sent_len];
        if !sent.is_empty() && bytes.starts_with(sent) {
            return Cut::Echo;
        }
        let span = rtu::reply_span(bytes);
        match span {
            Span::Bytes(len) if len <= bytes.len() && rtu::agrees(&bytes[..len]) => {
                return Cut::Frame(len);
            }
            Span::Bytes(len) if len > bytes.len() && self.awaited(bytes) => return Cut::More,
            _ => {}
        }
        let perhaps = sent.starts_with(bytes)
            || span == Span::More
            || matches!(span, Span::Bytes(len) if len > bytes.len());
        if perhaps {
            return self.expected_within(bytes).map_or(Cut::More, Cut::Skip);
        }
        if self.awaited(bytes) && !sent.starts_with(&bytes[..3]) {
            self.counters.corrupt += 1;
        }
        Cut::Skip(1)
    }

    /// Whether bytes begin as a reply does that is owed.
    fn awaited(&self, bytes: &[u8]) -> bool {
        let [unit, function, ..] = *bytes else { return false };
        let ours = |owed: &Owed| owed.unit == unit && owed.function == function & !EXCEPTION_BIT;
        self.owed().iter().any(ours)
    }

    /// Where, behind bytes that look like the head of a longer frame, a whole reply lies that is
    /// owed: those bytes are noise.
    fn expected_within(&self, bytes: &[u8]) -> Option<usize> {
        (1..bytes.len().saturating_sub(rtu::ADU_MIN)).find(|&at| {
            let rest = &bytes[at..];
            match rtu::reply_span(rest) {
                Span::Bytes(len) if len <= rest.len() => {
                    self.awaited(rest) && rtu::agrees(&rest[..len])
                }
                _ => false,
            }
        })
    }

    pub(super) fn work_ascii(&mut self, now: Instant, bytes: &[u8]) {
        let held = self.characters.pending();
        self.pace.heard(now, held + bytes.len());
        let early = self.pace.early();
        self.pace.took(early);
        self.soon |= held > 0 && early > 0;
        for (at, &character) in bytes.iter().enumerate() {
            if character == ascii::START {
                self.soon = held + at < early;
            }
            match self.characters.feed(character) {
                Fed::Goes => {}
                Fed::Skipped(count) => {
                    self.counters.skipped += count as u64;
                    self.junk = true;
                }
                Fed::Ended => self.ended_ascii(now),
            }
        }
    }

    fn ended_ascii(&mut self, now: Instant) {
        let mut bytes = [0; ADU_MAX];
        let len = self.characters.bytes().len();
        bytes[..len].copy_from_slice(self.characters.bytes());
        let Ok((unit, pdu)) = ascii::open(&bytes[..len]) else {
            self.counters.corrupt += 1;
            return;
        };
        let mut again = [0; ascii::FRAME_MAX];
        let again_len = ascii::emit(unit, &mut again, |out| {
            out[..pdu.len()].copy_from_slice(pdu);
            pdu.len()
        });
        if again[..again_len] == self.sent[..self.sent_len] {
            self.identical(now);
        } else {
            self.frame(now, unit, pdu);
        }
    }

    /// The very bytes that were sent last: our echo, or the reply to a single write, which has the
    /// same bytes. Where there is an echo, the first of them is it: if the echo was damaged, that
    /// costs an answer, where the other guess would make an answer of an echo.
    fn identical(&mut self, now: Instant) {
        let single = |owed: &Owed| matches!(owed.function, 0x05 | 0x06);
        let Some(last) = self.owed().last().copied().filter(single) else {
            return self.idle_identical();
        };
        let known = self.echo != Echo::Unknown && !self.echo_seen;
        let early = self.timed && now < self.earliest(self.sent_len) && !self.echo_seen;
        if early || known {
            self.counters.echoed += 1;
            self.echo_seen = true;
            self.learn(early);
            return;
        }
        self.soon = false;
        let (address, value) = last.echo;
        let mut pdu = [0; 5];
        pdu[0] = last.function;
        pdu[1..3].copy_from_slice(&address.to_be_bytes());
        pdu[3..5].copy_from_slice(&value.to_be_bytes());
        self.frame(now, last.unit, &pdu);
    }

    /// The same, where no reply with these bytes can be owed.
    fn idle_identical(&mut self) {
        let single = matches!(self.sent_function(), 0x05 | 0x06);
        if single && self.sent_unit != Some(BROADCAST) {
            self.counters.late += 1;
        } else {
            self.counters.echoed += 1;
            self.echo_seen = true;
            self.learn(true);
        }
    }

    fn sent_function(&self) -> u8 {
        match self.format {
            Format::Rtu => self.sent[1],
            Format::Ascii => {
                let nibble = |at: usize| ascii::nibble(self.sent[at]).unwrap_or(0);
                nibble(3) << 4 | nibble(4)
            }
        }
    }

    fn learn(&mut self, sure: bool) {
        if sure && self.echo == Echo::Unknown {
            self.echo = Echo::Learnt;
        }
    }

    /// One whole frame whose check agrees.
    fn frame(&mut self, now: Instant, unit: u8, pdu: &[u8]) {
        let Ok(reply) = ReplyPdu::parse(pdu) else {
            self.counters.foreign += 1;
            return;
        };
        let Some(at) = self.owed().iter().position(|owed| owed.unit == unit && fits(owed, &reply))
        else {
            let idle = self.owed_len == 0;
            if idle {
                self.counters.late += 1
            } else {
                self.counters.foreign += 1
            }
            return;
        };
        if at + 1 == self.owed_len
            && !self.quarantine
            && self.too_early(now, self.characters_of(pdu))
        {
            self.counters.late += 1;
            return;
        }
        let owed = self.owed[at];
        let result = match reply {
            ReplyPdu::Exception { exception, .. } => {
                Err(Failure::Refused { code: u32::from(exception.code()) })
            }
            reply => Ok(reply),
        };
        let lost = self.paid(at);
        match owed.role {
            Role::Request => self.answer(now, result),
            Role::Abandoned => self.counters.late += 1,
            Role::Probe => {}
        }
        if self.owed_len == 0 && self.held.is_none() {
            self.settle();
        } else if self.quarantine {
            // A drive answers in order: what it still owes may be as late again.
            self.deadline = Some(now.plus_ns(QUARANTINE_TIMEOUTS * self.timeout_ns));
        }
        if lost {
            self.lost(now);
        }
    }

    /// Strikes an entry and all older ones of its station from the ledger. Returns whether the
    /// present request was among the older ones: its reply will not come any more.
    fn paid(&mut self, at: usize) -> bool {
        let unit = self.owed[at].unit;
        let mut kept = 0;
        let mut lost = false;
        for n in 0..self.owed_len {
            let owed = self.owed[n];
            if n > at || owed.unit != unit {
                self.owed[kept] = owed;
                kept += 1;
            } else if n < at {
                lost |= owed.role == Role::Request;
            }
        }
        self.owed_len = kept;
        lost
    }

    /// Whether a reply comes sooner than its bytes can travel. In the first exchange of all it shows
    /// that the wire has no timing, whatever its baud rate (a pseudo-terminal); later it is left
    /// alone, and shows the same if nothing else comes.
    fn too_early(&mut self, now: Instant, len: usize) -> bool {
        let soon = self.soon || now < self.earliest(len);
        if self.line.baud != 0 {
            self.timely = if soon { 0 } else { self.timely.saturating_add(1) };
            self.timed |= self.timely >= TIMELY_MIN;
        }
        if !soon {
            self.early_streak = 0;
            return false;
        }
        if !self.timed {
            return false;
        }
        let Counters { answered, late, silent, echoed, resent, .. } = self.counters;
        self.timed = answered + late + silent + echoed + resent > 0;
        self.early = self.timed;
        self.timed
    }

    /// When a reply of so many characters to what was sent last can be complete. A twentieth is left to
    /// clocks that differ.
    fn earliest(&self, len: usize) -> Instant {
        let whole = self.sent_ns + self.line.characters_ns(len as u32);
        self.sent_at.plus_ns(whole - whole / 20)
    }

    fn characters_of(&self, pdu: &[u8]) -> usize {
        match self.format {
            Format::Rtu => pdu.len() + 3,
            Format::Ascii => 2 * pdu.len() + 7,
        }
    }

    fn answer(&mut self, now: Instant, result: Result<ReplyPdu<'_>, Failure>) {
        let Some(current) = self.current else { return };
        if !matches!(current.request.ask.function(), Function::WriteCoil | Function::WriteRegister)
            && self.echo == Echo::Learnt
            && !self.echo_seen
            && !self.junk
        {
            self.echo = Echo::Unknown;
        }
        let reply = match result {
            Ok(reply) => reply,
            Err(failure) => return self.end(Err(failure)),
        };
        let answer = self.fill(&current.request, reply);
        if self.held.take().is_some() {
            self.counters.late += 1;
            self.answered = None;
        }
        if self.suspect(now, &answer) {
            self.held = Some((now, answer));
            self.owe(&current.request, Role::Request);
            let usual = self.answered.map_or(0, |before| before.latency_ns);
            let wait = (2 * usual).clamp(SUSPECT_NS, SUSPECT_NS.max(self.timeout_ns));
            self.deadline = Some(now.plus_ns(wait));
            return;
        }
        let latency_ns = now.0.saturating_sub(self.sent_at.0);
        self.answered = Some(Answered { at: now, latency_ns, answer });
        self.end(Ok(answer));
    }

    /// Whether this may be the duplicate of the reply before: the same bytes to another question,
    /// at once, on a wire where timing tells nothing.
    fn suspect(&self, now: Instant, answer: &Answer) -> bool {
        let Some(before) = self.answered else { return false };
        let same = before.answer.unit == answer.unit
            && before.answer.function == answer.function
            && before.answer.words == answer.words
            && before.answer.count == answer.count;
        same && !self.timed
            && answer.function.reads().is_some()
            && before.answer.start != answer.start
            && now.since(before.at).as_nanos() < u128::from(SUSPECT_NS)
    }

    fn fill(&mut self, request: &Request, reply: ReplyPdu<'_>) -> Answer {
        let mut answer = answer_to(request, request.ask.echo().1);
        self.payload_len = 0;
        match reply {
            ReplyPdu::Read { space, data } => {
                self.payload[..data.len()].copy_from_slice(data);
                self.payload_len = data.len();
                if space.is_bits() {
                    for (at, &byte) in data.iter().enumerate().take(2 * WORDS_MAX) {
                        answer.words[at / 2] |= u16::from(byte) << (8 * (at % 2));
                    }
                } else {
                    for (slot, word) in answer.words.iter_mut().zip(words(data)) {
                        *slot = word;
                    }
                }
            }
            ReplyPdu::WroteCoil { on, .. } => answer.words[0] = u16::from(on),
            ReplyPdu::WroteRegister { value, .. } => answer.words[0] = value,
            _ => {}
        }
        answer
    }
}

enum Cut {
    Frame(usize),
    Echo,
    Skip(usize),
    More,
}

/// Whether a reply is of the kind that is owed: function, byte count, address and value.
fn fits(owed: &Owed, reply: &ReplyPdu<'_>) -> bool {
    let coil = |on: bool| if on { 0xFF00 } else { 0 };
    match *reply {
        ReplyPdu::Exception { function, .. } => function == owed.function,
        ReplyPdu::Read { space, data } => {
            space.read().code() == owed.function && data.len() == usize::from(owed.echo.1)
        }
        ReplyPdu::WroteCoil { address, on } => {
            owed.function == 0x05 && owed.echo == (address, coil(on))
        }
        ReplyPdu::WroteRegister { address, value } => {
            owed.function == 0x06 && owed.echo == (address, value)
        }
        ReplyPdu::Wrote { coils, start, count } => {
            owed.function == if coils { 0x0F } else { 0x10 } && owed.echo == (start, count)
        }
        ReplyPdu::Unknown { .. } => false,
    }
}
