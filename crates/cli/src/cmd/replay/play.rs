//! One wire played: each frame in its time, and what comes back heard meanwhile.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use polepair::frame_bits;
use polepair::wire::AnyLink;
use polepair_core::explain::{Act, Cut, Direction, Dissector, Raw};
use polepair_core::medium::{Frame, Medium, SerialLine};
use polepair_core::stream::cyclic::Spread;
use polepair_core::time::Instant;
use polepair_link::{Cause, Link, LinkError, Received};

use super::choose::Item;
use super::feed::Items;
use crate::ears::Unit;
use crate::interrupt;

/// From the beginning to the first frame.
const LEAD_MS: u32 = 20;
/// How long is listened after the last frame.
const LINGER_MS: u32 = 200;
/// How long a wire may take nothing.
const STALL: Duration = Duration::from_secs(1);
/// How often somebody who waits looks whether it is over: a wire that is lost ends the others too.
const LOOK_MS: u32 = 50;
/// Units that are heard between two frames that are late.
const HEARD_MAX: usize = 64;

/// How fast it is played.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Pace {
    /// So many times as fast as it was recorded.
    Recorded(f64),
    /// Each frame as soon as the one before is through and answered, but no later than recorded.
    Fast,
}

/// What came of it.
#[derive(Debug, Default)]
pub struct Played {
    pub sent: u64,
    pub heard: u64,
    /// How late frames were, against the recorded times.
    pub late: Spread,
    /// Axes that were sent what may move them, and whether there was such a frame to nobody known.
    pub moved: BTreeSet<u32>,
    pub moved_any: bool,
    /// Frames that the link has no form for, and the first reason.
    pub unsent: u64,
    pub trouble: Option<LinkError>,
    /// The link is gone, or takes nothing.
    pub ended_by: Option<LinkError>,
}

/// What all wires of a replay share.
#[derive(Clone)]
pub struct Score {
    pub pace: Pace,
    /// Somebody wants everybody to end.
    pub halt: Arc<AtomicBool>,
}

impl Score {
    fn is_over(&self) -> bool {
        self.halt.load(Ordering::Relaxed) || interrupt::came()
    }

    /// Plays a wire until its frames, or patience, end. `rate` is its bits a second, if it has such.
    pub fn play(&self, link: AnyLink, rate: Option<u32>, items: Items) -> Played {
        match link {
            AnyLink::Serial(link) => Player::new(self, link, rate).run(items),
            AnyLink::Can(link) => Player::new(self, link, rate).run(items),
        }
    }
}

/// What a medium's units are for a player.
trait Playable: Medium {
    fn of(unit: &Unit) -> Option<&Self::Unit>;
    /// How long it takes on a wire of that rate.
    fn takes(unit: &Self::Unit, rate: u32) -> u64;
    /// Takes what came; whether it completes an answer.
    fn answers(
        by: &dyn Dissector,
        heard: &Self::Unit,
        asked: &Self::Unit,
        so_far: &mut Vec<u8>,
    ) -> bool;
}

impl Playable for polepair_core::medium::Stream {
    fn of(unit: &Unit) -> Option<&[u8]> {
        match unit {
            Unit::Bytes(bytes) => Some(bytes),
            Unit::Frame(_) => None,
        }
    }

    fn takes(unit: &[u8], rate: u32) -> u64 {
        SerialLine::n81(rate).characters_ns(u32::try_from(unit.len()).unwrap_or(u32::MAX))
    }

    fn answers(by: &dyn Dissector, heard: &[u8], _: &[u8], so_far: &mut Vec<u8>) -> bool {
        so_far.extend_from_slice(heard);
        loop {
            match by.cut(so_far, Some(Direction::ToHost), false) {
                Cut::Frame(_) | Cut::Broken(_) => return true,
                Cut::Skip(count) if (1..=so_far.len()).contains(&count) => {
                    so_far.drain(..count);
                }
                Cut::Skip(_) | Cut::More => return false,
            }
        }
    }
}

impl Playable for polepair_core::medium::Can {
    fn of(unit: &Unit) -> Option<&Frame> {
        match unit {
            Unit::Frame(frame) => Some(frame),
            Unit::Bytes(_) => None,
        }
    }

    fn takes(frame: &Frame, rate: u32) -> u64 {
        u64::from(frame_bits(frame)) * 1_000_000_000 / u64::from(rate.max(1))
    }

    fn answers(by: &dyn Dissector, heard: &Frame, asked: &Frame, _: &mut Vec<u8>) -> bool {
        let raw = |frame| Raw {
            bytes: Frame::bytes(frame),
            id: Some(frame.id),
            extended: frame.extended,
        };
        by.answers(&raw(heard), &raw(asked))
    }
}

struct Player<'a, M: Playable> {
    score: &'a Score,
    link: Box<dyn Link<M>>,
    rate: Option<u32>,
    buffer: M::Buffer,
    played: Played,
}

/// Why a wire is played no further.
enum Over {
    Halted,
    Gone(LinkError),
}

impl From<LinkError> for Over {
    fn from(error: LinkError) -> Self {
        Self::Gone(error)
    }
}

impl<'a, M: Playable> Player<'a, M> {
    fn new(score: &'a Score, link: Box<dyn Link<M>>, rate: Option<u32>) -> Self {
        Self { score, link, rate, buffer: M::buffer(), played: Played::default() }
    }

    fn run(mut self, items: Items) -> Played {
        match self.all(items) {
            Ok(()) | Err(Over::Halted) => {}
            Err(Over::Gone(error)) => {
                self.score.halt.store(true, Ordering::Relaxed);
                self.played.ended_by = Some(error);
            }
        }
        self.played
    }

    fn all(&mut self, items: Items) -> Result<(), Over> {
        let begin = self.link.now().plus_ms(LEAD_MS);
        // When the last one went out, its moment in the capture, and it itself.
        let mut before: Option<(Instant, Item)> = None;
        for item in items.iter().flatten() {
            let due = match (self.score.pace, before.take()) {
                (Pace::Recorded(speed), _) => begin.plus_ns((item.at as f64 / speed) as u64),
                (Pace::Fast, None) => begin,
                (Pace::Fast, Some((sent, last))) => self.through(sent, &last, item.at)?,
            };
            self.hear(due)?;
            let Some(unit) = M::of(&item.unit) else { continue };
            self.send(unit)?;
            let now = self.link.now();
            if let Pace::Recorded(_) = self.score.pace {
                self.played.late.note(now.since(due).as_nanos() as u64);
            }
            self.count(&item);
            before = Some((now, item));
        }
        let end = self.link.now().plus_ms(LINGER_MS);
        self.hear(end)
    }

    fn count(&mut self, item: &Item) {
        if item.effect.act >= Act::Moves {
            // Nobody's number, or 0, is everybody's.
            let axis = item.axis.filter(|axis| *axis > 0);
            self.played.moved_any |= axis.is_none();
            self.played.moved.extend(axis);
        }
    }

    /// Waits until the last frame is through the wire and answered, but no longer than was waited
    /// when it was recorded. When the next one may go.
    fn through(&mut self, sent: Instant, last: &Item, next: u64) -> Result<Instant, Over> {
        let Some(unit) = M::of(&last.unit) else { return Ok(sent) };
        let through = sent.plus_ns(self.rate.map_or(0, |rate| M::takes(unit, rate)));
        let latest = sent.plus_ns(next.saturating_sub(last.at)).max(through);
        let Some(by) = last.answered else { return Ok(through) };
        let mut so_far = Vec::new();
        loop {
            match self.receive(latest)? {
                None => return Ok(latest),
                Some(len) => {
                    let heard = M::unit(std::borrow::Borrow::borrow(&self.buffer), len);
                    if M::answers(by, heard, unit, &mut so_far) {
                        return Ok(through);
                    }
                }
            }
        }
    }

    /// Hears what comes until then.
    fn hear(&mut self, until: Instant) -> Result<(), Over> {
        let mut late = 0;
        while self.receive(until)?.is_some() && late < HEARD_MAX {
            late += usize::from(self.link.now() >= until);
        }
        Ok(())
    }

    /// The length of what came; `None` when `until` did.
    fn receive(&mut self, until: Instant) -> Result<Option<usize>, Over> {
        loop {
            if self.score.is_over() {
                return Err(Over::Halted);
            }
            let look = until.min(self.link.now().plus_ms(LOOK_MS));
            match self.link.receive(std::borrow::BorrowMut::borrow_mut(&mut self.buffer), look)? {
                Received::Bytes { len, .. } => {
                    self.played.heard += 1;
                    return Ok(Some(len));
                }
                Received::TimedOut if look == until => return Ok(None),
                Received::TimedOut | Received::Line { .. } | Received::Woken => {}
            }
        }
    }

    /// Sends, however long that takes the wire; what it has no form for is counted.
    fn send(&mut self, unit: &M::Unit) -> Result<(), Over> {
        let give_up = self.link.now() + STALL;
        self.link.ready(give_up)?;
        loop {
            match self.link.send(unit) {
                Ok(()) => {
                    self.played.sent += 1;
                    return Ok(());
                }
                Err(error) if error.cause() == Cause::Unsuitable => {
                    self.played.unsent += 1;
                    self.played.trouble.get_or_insert(error);
                    return Ok(());
                }
                // A frame was not sent at all. Of bytes a part may have been.
                Err(error)
                    if error.cause() == Cause::Stalled
                        && M::KIND == polepair_core::medium::MediumKind::Can
                        && self.link.now() < give_up
                        && !self.score.is_over() => {}
                Err(error) => return Err(error.into()),
            }
        }
    }
}
