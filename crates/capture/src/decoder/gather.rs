//! Frames into batches. Process data whose mapping is known, and by which no state changes, are not
//! explained: their conversation is told that they came, and their bytes go into the batch. Neither
//! are frames that say what an earlier one said with the same bytes.
//!
//! Why: DEC-3, DEC-6.

use polepair_core::medium::Frame;

use super::{Decoder, Event, Wire};
use crate::batch::{Batch, Says};
use crate::read::Scan;
use crate::record::{Data, Record};

/// Takes a batch that is full; what comes then goes into it anew.
type Full<'a> = &'a mut dyn FnMut(&mut Batch);

impl Decoder {
    /// Takes a piece of the capture, cut anywhere. Its frames are put into `batch`, which `full` is
    /// given as often as it has as many as it should.
    pub fn gather(&mut self, piece: &[u8], batch: &mut Batch, full: Full<'_>) {
        batch.piece(self.head);
        let mut reader = core::mem::take(&mut self.reader);
        reader.feed(piece, &mut |record| self.put(record, self.known(record), batch, full));
        self.reader = reader;
    }

    /// The same of a piece that begins where a line does, and was looked through.
    pub fn gather_lines(&mut self, piece: &[u8], scan: &Scan, batch: &mut Batch, full: Full<'_>) {
        if scan.lines().is_empty() || !self.reader.pass_over(0, 0) {
            return self.gather(piece, batch, full);
        }
        batch.piece(self.head);
        let mut reader = core::mem::take(&mut self.reader);
        let before = reader.came();
        // What a line behind another is does not hang on that one: the reader is told of them later.
        let (mut from, mut at, mut lines) = (0, 0, 0);
        // Where each link of the piece is, once it is known.
        let mut wires = [None; Scan::LINKS_MAX];
        for line in scan.lines() {
            if batch.is_stopped() {
                break;
            }
            if line.at > at {
                reader.pass_over(lines, (at - from) as u64);
                let between = &piece[at..line.at];
                reader.feed(between, &mut |record| {
                    self.put(record, self.known(record), batch, full);
                });
                (from, lines) = (line.at, 0);
            }
            let (record, wire) = (scan.record(line, before), &mut wires[usize::from(line.link)]);
            *wire = wire.or_else(|| self.known(&record));
            self.put(&record, *wire, batch, full);
            (at, lines) = (line.end, lines + 1);
        }
        reader.pass_over(lines, (at - from) as u64);
        reader.feed(&piece[at..], &mut |record| self.put(record, self.known(record), batch, full));
        self.reader = reader;
    }

    /// Ends the capture: what waits for more is put into `batch` as it is.
    pub fn gather_rest(&mut self, batch: &mut Batch, full: Full<'_>) {
        batch.piece(self.head);
        let mut head = self.head;
        self.finish(&mut |event| keep(event, &mut head, batch, full));
        self.head = head;
    }

    /// Which link a record is of, where one before was.
    fn known(&self, record: &Record<'_>) -> Option<usize> {
        self.wires.iter().position(|wire| *wire.name == *record.link)
    }

    /// Takes a record of that link, if one of it came before.
    #[inline]
    fn put(&mut self, record: &Record<'_>, wire: Option<usize>, batch: &mut Batch, full: Full<'_>) {
        if batch.is_stopped() {
            return;
        }
        if let Data::Frame(frame) = &record.data
            && let Some(at) = wire
            && (self.is_settled(at, record, frame, batch)
                || self.is_repeated(at, record, frame, batch))
        {
            if batch.is_full() {
                hand_over(self.head, batch, full);
            }
            return;
        }
        let mut head = self.head;
        self.record(record, &mut |event| keep(event, &mut head, batch, full));
        self.head = head;
    }

    /// Whether a frame changes nothing; then it is put into the batch.
    #[inline]
    fn is_settled(
        &mut self,
        at: usize,
        record: &Record<'_>,
        frame: &Frame,
        batch: &mut Batch,
    ) -> bool {
        let Some(now) = record.time.filter(|_| self.follows) else { return false };
        let Wire { name, lanes, session, .. } = &mut self.wires[at];
        let Some(lane) = lanes.left(frame) else { return false };
        let Some(process) = session.settled(frame, now) else { return false };
        let whose = (Says::Process(process), &*name, lane.dissector.name());
        let added = batch.add(record, (self.count + 1, frame), &mut lane.voice, whose);
        self.count += u64::from(added);
        added
    }

    /// Whether a frame says what an earlier one said; then its conversation takes it, and it is put
    /// into the batch.
    fn is_repeated(
        &mut self,
        at: usize,
        record: &Record<'_>,
        frame: &Frame,
        batch: &mut Batch,
    ) -> bool {
        let Wire { name, repeats, conversation, session, .. } = &mut self.wires[at];
        let Some(known) = repeats.of(frame, record.direction) else { return false };
        let protocol = known.lane.dissector.name();
        if !session.repeats(protocol, frame.id) {
            return false;
        }
        self.count += 1;
        self.explained.copy(&known.said);
        self.notices.clear();
        if known.asks {
            conversation.ask(&super::raw(frame));
        }
        let heard = known.lane.heard(self.count, record, frame, None);
        session.take(&heard, &mut self.explained, &mut self.notices);
        if self.notices.is_empty() && self.explained.is_as(&known.said) {
            let whose = (Says::Same(&known.said), &*name, protocol);
            if batch.add(record, (self.count, frame), &mut known.voice, whose) {
                return true;
            }
        }
        let said = (&self.explained, &*self.notices);
        let event = Event::of_frame(record, (self.count, frame), (name, Some(protocol)), said);
        self.head.see(&event);
        batch.keep(&event);
        true
    }
}

fn keep(event: &Event<'_>, head: &mut crate::text::Head, batch: &mut Batch, full: Full<'_>) {
    head.see(event);
    batch.keep(event);
    if batch.is_full() {
        hand_over(*head, batch, full);
    }
}

fn hand_over(head: crate::text::Head, batch: &mut Batch, full: Full<'_>) {
    full(batch);
    batch.begin(head);
}
