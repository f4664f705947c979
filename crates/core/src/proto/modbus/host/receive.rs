//! Receives: finds frames in the bytes, removes echoes, records replies.

use super::{
    AwaitedReply, CurrentExchange, DUPLICATE_WINDOW_NS, EchoState, LATEST_TIMEOUTS, LastRead,
    RECEIVE_MAX, ReplyRole, SerialHost, TIMELY_STREAK_MIN,
};
use crate::error::Failure;
use crate::proto::modbus::ascii::{self, FeedResult};
use crate::proto::modbus::device_id;
use crate::proto::modbus::host_request::RequestBody;
use crate::proto::modbus::rtu::{self, ADU_MAX};
use crate::proto::modbus::wire::{
    AnnouncedLength, BROADCAST, EXCEPTION_BIT, Function, PDU_MAX, ReplyPdu, Space, WireFormat,
};
use crate::station::Counters;
use crate::time::Instant;

impl SerialHost {
    pub(super) fn skip_bytes(&mut self, count: usize) {
        self.received_noise |= count > 0;
        self.counters.skipped += count as u64;
        self.drop_front(count);
    }

    fn drop_front(&mut self, count: usize) {
        debug_assert!(count <= self.received_len, "no more is dropped than was received");
        self.received.copy_within(count..self.received_len, 0);
        self.received_len -= count;
        self.early_bytes.consume(count);
    }

    /// Data of the complete reply to the one outstanding read, if nothing is in doubt: the usual case, so it is tested
    /// first and in place.
    #[inline]
    pub(super) fn expected_read_data<'a>(&self, adu: &'a [u8]) -> Option<&'a [u8]> {
        // The usual reply: one request, nothing in doubt, and the whole frame in one piece.
        let [awaited] = self.outstanding() else { return None };
        let [unit, function, count, data @ .., _, _] = adu else { return None };
        let plain =
            self.received_len == 0 && !self.quarantine && awaited.role == ReplyRole::Request;
        let owed_len = usize::from(awaited.reply_fields.1);
        let fits = (awaited.unit, awaited.function, owed_len) == (*unit, *function, data.len())
            && usize::from(*count) == data.len()
            && (1..=PDU_MAX - 2).contains(&data.len())
            && Space::of_read_code(*function).is_some();
        (plain && fits && !self.is_echo(adu) && rtu::crc_matches(adu)).then_some(data)
    }

    fn is_echo(&self, adu: &[u8]) -> bool {
        adu.starts_with(&self.sent[..self.sent_len])
    }

    /// Takes the data that came as a plain read.
    #[inline]
    pub(super) fn accept_read(&mut self, now: Instant, adu_len: usize, data: &[u8]) {
        self.early_bytes.note_received(now, adu_len);
        self.frame_is_early = self.early_bytes.count() > 0;
        self.early_bytes.consume(adu_len);
        debug_assert_eq!(self.outstanding_len, 1, "the only awaited reply");
        if self.is_too_early(now, adu_len) {
            self.counters.late += 1;
            self.counters.early += 1;
            return;
        }
        self.outstanding_len = 0;
        self.accept_answer(now, data);
        if self.held_since.is_none() {
            self.end_quarantine();
        }
    }

    /// Takes bytes to those that no frame was made of yet.
    #[cold]
    pub(super) fn buffer_bytes(&mut self, now: Instant, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() {
            // Twice the longest frame: what fills it without one is noise, and the newest bytes matter.
            if self.received_len == RECEIVE_MAX {
                self.skip_bytes(1);
            }
            let capacity = (RECEIVE_MAX - self.received_len).min(rest.len());
            let (head, tail) = rest.split_at(capacity);
            self.received[self.received_len..self.received_len + capacity].copy_from_slice(head);
            self.received_len += capacity;
            self.early_bytes.note_received(now, self.received_len);
            self.process_rtu(now);
            rest = tail;
        }
    }

    fn process_rtu(&mut self, now: Instant) {
        while self.received_len > 0 {
            match self.scan_received() {
                ReplyScan::Skip(count) => self.skip_bytes(count),
                ReplyScan::More => break,
                ReplyScan::Echo => {
                    self.handle_identical(now);
                    self.drop_front(self.sent_len);
                }
                ReplyScan::Frame(len) => {
                    let mut adu = [0; ADU_MAX];
                    adu[..len].copy_from_slice(&self.received[..len]);
                    self.frame_is_early = self.early_bytes.count() > 0;
                    self.drop_front(len);
                    self.handle_frame(now, adu[0], &adu[1..len - 2]);
                }
            }
        }
    }

    /// Classifies the head of the received bytes.
    fn scan_received(&mut self) -> ReplyScan {
        let bytes = &self.received[..self.received_len];
        let sent = &self.sent[..self.sent_len];
        if !sent.is_empty() && bytes.starts_with(sent) {
            return ReplyScan::Echo;
        }
        let span = rtu::reply_span(bytes);
        match span {
            AnnouncedLength::Bytes(len)
                if len <= bytes.len() && rtu::crc_matches(&bytes[..len]) =>
            {
                return ReplyScan::Frame(len);
            }
            // The head fits an awaited reply, so its rest is waited for before any byte of it is skipped.
            AnnouncedLength::Bytes(len) if len > bytes.len() && self.is_expected_head(bytes) => {
                return ReplyScan::More;
            }
            _ => {}
        }
        let perhaps = sent.starts_with(bytes)
            || span == AnnouncedLength::More
            || matches!(span, AnnouncedLength::Bytes(len) if len > bytes.len());
        if perhaps {
            // Noise may announce a long frame. A whole awaited reply behind it must not wait for that.
            return self.find_expected_reply(bytes).map_or(ReplyScan::More, ReplyScan::Skip);
        }
        if self.is_expected_head(bytes) && !sent.starts_with(&bytes[..3]) {
            self.counters.corrupt += 1;
        }
        ReplyScan::Skip(1)
    }

    /// Returns whether bytes begin like an expected reply.
    fn is_expected_head(&self, bytes: &[u8]) -> bool {
        let [unit, function, ..] = *bytes else { return false };
        self.outstanding()
            .iter()
            .any(|awaited| awaited.unit == unit && awaited.function == function & !EXCEPTION_BIT)
    }

    /// Position of a complete expected reply after bytes that look like the head of a longer frame: those
    /// bytes are noise.
    fn find_expected_reply(&self, bytes: &[u8]) -> Option<usize> {
        (1..bytes.len().saturating_sub(rtu::ADU_MIN)).find(|&at| {
            let rest = &bytes[at..];
            match rtu::reply_span(rest) {
                AnnouncedLength::Bytes(len) if len <= rest.len() => {
                    self.is_expected_head(rest) && rtu::crc_matches(&rest[..len])
                }
                _ => false,
            }
        })
    }

    pub(super) fn process_ascii(&mut self, now: Instant, bytes: &[u8]) {
        let held = self.ascii.pending();
        self.early_bytes.note_received(now, held + bytes.len());
        let early = self.early_bytes.count();
        self.early_bytes.consume(early);
        self.frame_is_early |= held > 0 && early > 0;
        for (at, &character) in bytes.iter().enumerate() {
            if character == ascii::START {
                self.frame_is_early = held + at < early;
            }
            match self.ascii.feed(character) {
                FeedResult::Incomplete => {}
                FeedResult::Skipped(count) => {
                    self.counters.skipped += count as u64;
                    self.received_noise = true;
                }
                FeedResult::Complete => self.handle_ascii_frame(now),
            }
        }
    }

    fn handle_ascii_frame(&mut self, now: Instant) {
        let mut bytes = [0; ADU_MAX];
        let len = self.ascii.bytes().len();
        bytes[..len].copy_from_slice(self.ascii.bytes());
        let Ok((unit, pdu)) = ascii::decode(&bytes[..len]) else {
            self.counters.corrupt += 1;
            return;
        };
        let mut again = [0; ascii::FRAME_MAX];
        let again_len = ascii::emit(unit, &mut again, |out| {
            out[..pdu.len()].copy_from_slice(pdu);
            pdu.len()
        });
        if again[..again_len] == self.sent[..self.sent_len] {
            self.handle_identical(now);
        } else {
            self.handle_frame(now, unit, pdu);
        }
    }

    /// The very bytes that were sent last: our echo, or the reply to a single write, which has the
    /// same bytes. Where there is an echo, the first of them is it: if the echo was damaged, that
    /// costs an answer, where the other guess would make an answer of an echo.
    fn handle_identical(&mut self, now: Instant) {
        let Some(last) = self.outstanding().last().copied().filter(is_single_write) else {
            return self.handle_idle_identical();
        };
        let known = self.echo != EchoState::NotDetected && !self.echo_seen;
        // An echo is back before a drive could have answered. It has the bytes of the reply to functions 05
        // and 06, so time alone distinguishes them; where time is fiction, the first is taken for the echo
        // (MODBUS-1).
        let early = self.is_timed && now < self.earliest_reply(self.sent_len) && !self.echo_seen;
        if early || known {
            self.counters.echoed += 1;
            self.echo_seen = true;
            self.learn_echo(early);
            return;
        }
        self.frame_is_early = false;
        let (address, value) = last.reply_fields;
        let mut pdu = [0; 5];
        pdu[0] = last.function;
        pdu[1..3].copy_from_slice(&address.to_be_bytes());
        pdu[3..5].copy_from_slice(&value.to_be_bytes());
        self.handle_frame(now, last.unit, &pdu);
    }

    /// Handles a repeated frame where no reply with these bytes is expected.
    fn handle_idle_identical(&mut self) {
        let single = matches!(self.sent_function(), 0x05 | 0x06);
        if single && self.sent_unit != Some(BROADCAST) {
            self.counters.late += 1;
        } else {
            self.counters.echoed += 1;
            self.echo_seen = true;
            self.learn_echo(true);
        }
    }

    fn sent_function(&self) -> u8 {
        match self.format {
            WireFormat::Rtu | WireFormat::Tcp => self.sent[1],
            WireFormat::Ascii => self.sent_nibble(3) << 4 | self.sent_nibble(4),
        }
    }

    fn sent_nibble(&self, at: usize) -> u8 {
        ascii::hex_value(self.sent[at]).unwrap_or(0)
    }

    fn learn_echo(&mut self, sure: bool) {
        if sure && self.echo == EchoState::NotDetected {
            self.echo = EchoState::Detected;
        }
    }

    /// Handles a frame with a valid check sum.
    fn handle_frame(&mut self, now: Instant, unit: u8, pdu: &[u8]) {
        let Ok(reply) = ReplyPdu::parse(pdu) else {
            self.counters.foreign += 1;
            return;
        };
        let Some(at) = self
            .outstanding()
            .iter()
            .position(|awaited| awaited.unit == unit && matches_outstanding(awaited, &reply))
        else {
            // Without a request under way it can only be late; with one it may be another station's.
            let idle = self.outstanding_len == 0;
            if idle {
                self.counters.late += 1
            } else {
                self.counters.foreign += 1
            }
            return;
        };
        if at + 1 == self.outstanding_len
            && !self.quarantine
            && self.is_too_early(now, self.frame_characters(pdu.len()))
        {
            self.counters.late += 1;
            self.counters.early += 1;
            return;
        }
        let role = self.outstanding[at].role;
        debug_assert!(at < self.outstanding_len, "the reply belongs to an awaited one");
        let lost = self.remove_outstanding(at);
        match role {
            ReplyRole::Request => self.handle_reply(now, &reply),
            ReplyRole::Abandoned => self.counters.late += 1,
            ReplyRole::Probe => {}
        }
        if self.outstanding_len == 0 && self.held_since.is_none() {
            self.end_quarantine();
            self.handle_proof(now);
        } else if self.quarantine {
            // A drive replies in order: its outstanding replies may be as late again.
            self.deadline = Some(now.plus_ns(LATEST_TIMEOUTS * self.timeout_ns));
        }
        if lost {
            self.retry_or_fail(now);
        }
    }

    /// Strikes an entry and all older ones of its station from the ledger. Returns whether the
    /// present request was among the older ones: its reply will not come any more.
    fn remove_outstanding(&mut self, at: usize) -> bool {
        let unit = self.outstanding[at].unit;
        let mut stored = 0;
        let mut lost = false;
        for n in 0..self.outstanding_len {
            let awaited = self.outstanding[n];
            // A drive replies in order: what was asked of it before this one will not be answered.
            if n > at || awaited.unit != unit {
                self.outstanding[stored] = awaited;
                stored += 1;
            } else if n < at {
                lost |= awaited.role == ReplyRole::Request;
            }
        }
        self.outstanding_len = stored;
        lost
    }

    /// Returns whether a reply arrived sooner than its bytes can travel. In the first exchange this shows that the wire
    /// has no timing, whatever its baud rate (a pseudo-terminal). Later such a reply is ignored, and shows the same if
    /// nothing else arrives.
    fn is_too_early(&mut self, now: Instant, len: usize) -> bool {
        let soon = self.frame_is_early || now < self.earliest_reply(len);
        // A virtual port reports a baud rate too. Sixteen replies that took their time show a real line.
        if self.line.baud != 0 && !self.untimed {
            self.timely_streak = if soon { 0 } else { self.timely_streak.saturating_add(1) };
            self.is_timed |= self.timely_streak >= TIMELY_STREAK_MIN;
        }
        if !soon {
            self.early_streak = 0;
            return false;
        }
        if !self.is_timed {
            return false;
        }
        let Counters { answered, late, silent, echoed, resent, .. } = self.counters;
        self.is_timed = answered + late + silent + echoed + resent > 0;
        self.early_reply_seen = self.is_timed;
        self.is_timed
    }

    /// Earliest time of a complete reply of `len` characters to the last request. One twentieth is left for clock
    /// differences.
    fn earliest_reply(&self, len: usize) -> Instant {
        let whole = self.sent_ns + self.line.characters_ns(len as u32);
        self.sent_at.plus_ns(whole - whole / 20)
    }

    fn handle_reply(&mut self, now: Instant, reply: &ReplyPdu<'_>) {
        match *reply {
            ReplyPdu::Exception { exception, .. } => {
                self.note_missing_echo();
                if self.retry_as_multiple_write(now, exception) {
                    return;
                }
                self.fail_current(Failure::Refused { code: u32::from(exception.code()) });
            }
            ReplyPdu::Read { data, .. } | ReplyPdu::ReadWritten { data } => {
                self.accept_answer(now, data)
            }
            ReplyPdu::Unknown { data, .. } => {
                let body = self.current.as_ref().map(|current| current.request.body);
                let text = body.and_then(|body| body.device_text(data)).unwrap_or_default();
                self.accept_answer(now, text);
            }
            _ => self.accept_answer(now, &[]),
        }
    }

    /// Notes an exchange without an echo that could have shown one.
    #[inline]
    fn note_missing_echo(&mut self) {
        if self.echo != EchoState::Detected || self.echo_seen || self.received_noise {
            return;
        }
        let Some(CurrentExchange { request, .. }) = &self.current else { return };
        if !matches!(
            request.body,
            RequestBody::WriteCoil { .. } | RequestBody::WriteRegister { .. }
        ) {
            self.echo = EchoState::NotDetected;
        }
    }

    /// The present request was answered, a read with these data.
    #[inline]
    fn accept_answer(&mut self, now: Instant, data: &[u8]) {
        self.note_missing_echo();
        if self.held_since.take().is_some() {
            self.counters.late += 1;
            // Two replies to one read: which of them is the old one cannot be known afterwards.
            self.last_read = None;
        }
        let suspect = self.is_suspected_duplicate(now, data);
        self.store_payload(data);
        if suspect {
            return self.hold_answer(now);
        }
        self.remember_read(now, now);
        self.complete_current();
    }

    /// Makes the data of a read the payload. One register is not worth a call that copies.
    #[inline]
    fn store_payload(&mut self, data: &[u8]) {
        self.payload_len = data.len();
        match *data {
            [high, low] => self.payload[..2].copy_from_slice(&[high, low]),
            _ => self.payload[..data.len()].copy_from_slice(data),
        }
    }

    /// Holds the answer back until another had its time to come.
    #[cold]
    fn hold_answer(&mut self, now: Instant) {
        let Some(current) = &self.current else { return };
        let awaited = AwaitedReply::of(&current.request, ReplyRole::Request);
        self.held_since = Some(now);
        self.add_outstanding(awaited);
        let usual = self.last_read.map_or(0, |before| before.latency_ns);
        let wait = (2 * usual).clamp(DUPLICATE_WINDOW_NS, DUPLICATE_WINDOW_NS.max(self.timeout_ns));
        self.deadline = Some(now.plus_ns(wait));
    }

    /// Notes the present exchange for the next one's sake: the answer came then, and is taken now.
    #[inline]
    pub(super) fn remember_read(&mut self, came: Instant, now: Instant) {
        let Some(CurrentExchange { request, .. }) = &self.current else { return };
        self.last_read = match request.body {
            RequestBody::Read { space, start, count } => Some(LastRead {
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

    /// Returns whether this may be a duplicate of the previous reply: the same bytes for another request, at once, on a
    /// wire without timing.
    #[inline]
    fn is_suspected_duplicate(&self, now: Instant, data: &[u8]) -> bool {
        let (Some(before), Some(current)) = (&self.last_read, &self.current) else { return false };
        let RequestBody::Read { space, start, count } = current.request.body else { return false };
        !self.is_timed
            && before.start != start
            && before.count == count
            && before.unit == current.request.unit
            && before.space == space
            && now.0.saturating_sub(before.at.0) < DUPLICATE_WINDOW_NS
            && self.payload[..before.len] == *data
    }
}

fn is_single_write(awaited: &AwaitedReply) -> bool {
    matches!(awaited.function, 0x05 | 0x06)
}

enum ReplyScan {
    Frame(usize),
    Echo,
    Skip(usize),
    More,
}

/// Returns whether a reply is of the expected kind: function, byte count, address and value.
pub(super) fn matches_outstanding(awaited: &AwaitedReply, reply: &ReplyPdu<'_>) -> bool {
    match *reply {
        ReplyPdu::Exception { function, .. } => function == awaited.function,
        ReplyPdu::Read { space, data } => {
            space.read_function().code() == awaited.function
                && data.len() == usize::from(awaited.reply_fields.1)
        }
        ReplyPdu::ReadWritten { data } => {
            awaited.function == Function::ReadWriteRegisters.code()
                && data.len() == usize::from(awaited.reply_fields.1)
        }
        ReplyPdu::WroteCoil { address, on } => {
            awaited.function == 0x05 && awaited.reply_fields == (address, coil_word(on))
        }
        ReplyPdu::WroteRegister { address, value } => {
            awaited.function == 0x06 && awaited.reply_fields == (address, value)
        }
        ReplyPdu::Wrote { coils, start, count } => {
            awaited.function == if coils { 0x0F } else { 0x10 }
                && awaited.reply_fields == (start, count)
        }
        ReplyPdu::Unknown { function, data } => {
            function == awaited.function
                && matches!(data, [device_id::MEI_TYPE, code, ..]
                    if u16::from(*code) == awaited.reply_fields.0)
        }
    }
}

fn coil_word(on: bool) -> u16 {
    if on { 0xFF00 } else { 0 }
}
