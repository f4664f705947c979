//! Receiving: frames found in the bytes, echoes taken out, replies struck from the ledger.

use super::{
    Answered, Current, Echo, Host, Owed, QUARANTINE_TIMEOUTS, RECEIVE_MAX, Role, SUSPECT_NS,
    TIMELY_MIN,
};
use crate::error::Failure;
use crate::proto::modbus::ascii::{self, Fed};
use crate::proto::modbus::request::Ask;
use crate::proto::modbus::rtu::{self, ADU_MAX};
use crate::proto::modbus::wire::{
    BROADCAST, EXCEPTION_BIT, Format, PDU_MAX, ReplyPdu, Space, Span,
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

    /// The data in these bytes, if they are the whole reply to the one read that is owed, and
    /// nothing is in doubt: what happens most, so it is looked at first and where it lies.
    #[inline]
    pub(super) fn plain_read<'a>(&self, adu: &'a [u8]) -> Option<&'a [u8]> {
        let [owed] = self.owed() else { return None };
        let [unit, function, count, data @ .., _, _] = adu else { return None };
        let plain = self.received_len == 0 && !self.quarantine && owed.role == Role::Request;
        let owed_len = usize::from(owed.echo.1);
        let fits = (owed.unit, owed.function, owed_len) == (*unit, *function, data.len())
            && usize::from(*count) == data.len()
            && (1..=PDU_MAX - 2).contains(&data.len())
            && Space::read_by(*function).is_some();
        let echo = || adu.starts_with(&self.sent[..self.sent_len]);
        (plain && fits && !echo() && rtu::agrees(adu)).then_some(data)
    }

    /// Takes the data that came as a plain read.
    #[inline]
    pub(super) fn read(&mut self, now: Instant, adu_len: usize, data: &[u8]) {
        self.pace.heard(now, adu_len);
        self.soon = self.pace.early() > 0;
        self.pace.took(adu_len);
        if self.too_early(now, adu_len) {
            self.counters.late += 1;
            self.counters.early += 1;
            return;
        }
        self.owed_len = 0;
        self.answered(now, data);
        if self.held.is_none() {
            self.settle();
        }
    }

    /// Takes bytes to those that no frame was made of yet.
    #[cold]
    pub(super) fn collect(&mut self, now: Instant, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() {
            if self.received_len == RECEIVE_MAX {
                self.skip(1);
            }
            let room = (RECEIVE_MAX - self.received_len).min(rest.len());
            let (head, tail) = rest.split_at(room);
            self.received[self.received_len..self.received_len + room].copy_from_slice(head);
            self.received_len += room;
            self.pace.heard(now, self.received_len);
            self.work_rtu(now);
            rest = tail;
        }
    }

    fn work_rtu(&mut self, now: Instant) {
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
            && self.too_early(now, self.characters_of(pdu.len()))
        {
            self.counters.late += 1;
            self.counters.early += 1;
            return;
        }
        let role = self.owed[at].role;
        let lost = self.paid(at);
        match role {
            Role::Request => self.answer(now, &reply),
            Role::Abandoned => self.counters.late += 1,
            Role::Probe => {}
        }
        if self.owed_len == 0 && self.held.is_none() {
            self.settle();
            self.proved(now);
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
        if self.line.baud != 0 && !self.untimed {
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

    fn answer(&mut self, now: Instant, reply: &ReplyPdu<'_>) {
        match *reply {
            ReplyPdu::Exception { exception, .. } => {
                self.doubt_echo();
                self.fail(Failure::Refused { code: u32::from(exception.code()) });
            }
            ReplyPdu::Read { data, .. } => self.answered(now, data),
            _ => self.answered(now, &[]),
        }
    }

    /// An exchange that could tell of an echo had none.
    #[inline]
    fn doubt_echo(&mut self) {
        if self.echo != Echo::Learnt || self.echo_seen || self.junk {
            return;
        }
        let Some(Current { request, .. }) = &self.current else { return };
        if !matches!(request.ask, Ask::WriteCoil { .. } | Ask::WriteRegister { .. }) {
            self.echo = Echo::Unknown;
        }
    }

    /// The present request was answered, a read with these data.
    #[inline]
    fn answered(&mut self, now: Instant, data: &[u8]) {
        self.doubt_echo();
        if self.held.take().is_some() {
            self.counters.late += 1;
            self.answered = None;
        }
        let suspect = self.suspect(now, data);
        self.keep(data);
        if suspect {
            return self.hold(now);
        }
        self.remember(now, now);
        self.succeed();
    }

    /// Makes the data of a read the payload. One register is not worth a call that copies.
    #[inline]
    fn keep(&mut self, data: &[u8]) {
        self.payload_len = data.len();
        match *data {
            [high, low] => self.payload[..2].copy_from_slice(&[high, low]),
            _ => self.payload[..data.len()].copy_from_slice(data),
        }
    }

    /// Holds the answer back until another had its time to come.
    #[cold]
    fn hold(&mut self, now: Instant) {
        let Some(current) = &self.current else { return };
        let owed = Owed::of(&current.request, Role::Request);
        self.held = Some(now);
        self.owe(owed);
        let usual = self.answered.map_or(0, |before| before.latency_ns);
        let wait = (2 * usual).clamp(SUSPECT_NS, SUSPECT_NS.max(self.timeout_ns));
        self.deadline = Some(now.plus_ns(wait));
    }

    /// Notes the present exchange for the next one's sake: the answer came then, and is taken now.
    #[inline]
    pub(super) fn remember(&mut self, came: Instant, now: Instant) {
        let Some(Current { request, .. }) = &self.current else { return };
        self.answered = match request.ask {
            Ask::Read { space, start, count } => Some(Answered {
                at: came,
                latency_ns: now.0.saturating_sub(self.sent_at.0),
                unit: request.unit,
                space,
                start,
                count,
                len: self.payload_len,
            }),
            _ => None,
        };
    }

    /// Whether this may be the duplicate of the reply before: the same bytes to another question,
    /// at once, on a wire where timing tells nothing.
    #[inline]
    fn suspect(&self, now: Instant, data: &[u8]) -> bool {
        let (Some(before), Some(current)) = (&self.answered, &self.current) else { return false };
        let Ask::Read { space, start, count } = current.request.ask else { return false };
        !self.timed
            && before.start != start
            && before.count == count
            && before.unit == current.request.unit
            && before.space == space
            && now.0.saturating_sub(before.at.0) < SUSPECT_NS
            && self.payload[..before.len] == *data
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
