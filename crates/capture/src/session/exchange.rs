//! Requests and what came of them, whatever the protocol: the dissector says what a frame is, what
//! it is owed and what answers it; here it is seen who got what, when, and what did not come.
//!
//! ```text
//!   exchange    the follower: what is wrong with single frames, whose turn it was
//!    ├ pairing  requests under way, and the answers that settle them
//!    ├ values   what was read and written, faults, states
//!    └ presence who spoke regularly and fell silent
//! ```
//!
//! Why: DEC-11 to DEC-13.

mod pairing;
mod presence;
mod values;

use polepair_core::error::WireError;
use polepair_core::explain::{Direction, Place, Talk, Turn};

use super::{Follower, Heard, Notice, Odd, Oddity, Quality};
use crate::decoder::{Wrong, strays};
use crate::explained::Explained;
use crate::stamp::Stamp;
use pairing::Pairing;
use presence::Presence;
use values::Values;

/// Axes of a link that are followed one by one.
const AXES_MAX: usize = 256;

/// Follows one protocol of requests and answers on one link.
#[derive(Debug, Default)]
pub(super) struct Exchanges {
    pairing: Pairing,
    presence: Presence,
    values: Values,
    /// The last place of each axis in a sequence that counts.
    places: Vec<(u32, u32)>,
    /// What may only be the end of a capture that was cut off, until something follows it.
    rest: Option<Odd>,
    /// Something whole was heard: what came before may have been cut off at its beginning.
    began: bool,
}

impl Follower for Exchanges {
    fn take(&mut self, heard: &Heard<'_>, said: &mut Explained, notices: &mut Vec<Notice>) {
        if heard.echo {
            return;
        }
        notices.extend(self.rest.take().map(Notice::Odd));
        if let Some(wrong) = heard.wrong {
            return self.spoiled(wrong, heard, said, notices);
        }
        self.began = true;
        let turn = heard.dissector.turn(&heard.raw, &self.talk(heard, said.axis));
        let quality = match turn {
            Turn::Asks(awaits) => {
                self.count(heard, said, notices);
                self.pairing.ask(awaits, heard, said, notices);
                self.presence.asked(said.axis);
                Quality::Good
            }
            Turn::Acknowledges => self.pairing.acknowledge(heard, notices),
            Turn::Answers | Turn::Tells => {
                let tells = turn == Turn::Tells;
                let settled = self.pairing.answer(tells, heard, said, notices);
                self.presence.heard(said.axis, heard.time, tells && !settled.asked);
                settled.quality
            }
            Turn::Aside => Quality::Good,
        };
        let request = self.pairing.answered_by(heard.number);
        self.values.take(heard, said, (quality, request), notices);
        self.presence.missed(self.pairing.given_up(), heard.time, notices);
    }

    fn pass(&mut self, now: Stamp, notices: &mut Vec<Notice>) {
        self.pairing.pass(now, notices);
        self.presence.missed(self.pairing.given_up(), Some(now), notices);
        self.presence.pass(now, notices);
    }

    fn end(&mut self, notices: &mut Vec<Notice>) {
        self.pairing.end(notices);
    }
}

impl Exchanges {
    fn talk<'a>(&'a self, heard: &Heard<'_>, axis: Option<u32>) -> Talk<'a> {
        Talk {
            direction: heard.direction,
            open: self.pairing.open(),
            form: self.pairing.form(axis),
            profile: heard.profile,
        }
    }

    /// A frame that breaks something, or bytes that are none.
    fn spoiled(
        &mut self,
        wrong: Wrong,
        heard: &Heard<'_>,
        said: &Explained,
        notices: &mut Vec<Notice>,
    ) {
        let short = matches!(wrong, Wrong::Wire(WireError::Short { .. }));
        let (kind, axis, text) = match heard.stray {
            true => (Oddity::Stray, None, strays(heard.raw.bytes.len())),
            false => (sort(wrong), said.axis, wrong.to_string()),
        };
        let odd = Odd { kind, axis, time: None, text };
        let cut = heard.stray || short;
        if cut && heard.raw.id.is_none() {
            // The capture may have begun in the middle of this, or may end in it.
            self.rest = Some(Odd { time: heard.time, ..odd }).filter(|_| self.began);
            if heard.direction != Some(Direction::ToDrive) {
                self.pairing.spoil();
            }
            return;
        }
        self.began = true;
        notices.push(Notice::Odd(odd));
        if heard.direction != Some(Direction::ToDrive) && heard.raw.id.is_none() {
            self.pairing.broken(heard, notices);
        }
        self.values.take(heard, said, (Quality::BadCheck, None), notices);
    }

    /// Points that count up: one that is left out was lost.
    fn count(&mut self, heard: &Heard<'_>, said: &Explained, notices: &mut Vec<Notice>) {
        let (Some(place), Some(axis)) = (heard.dissector.place(&heard.raw), said.axis) else {
            return;
        };
        let known = self.places.iter().position(|(of, _)| *of == axis);
        let Place::Counts(number, after) = place else {
            known.map(|at| self.places.swap_remove(at));
            return;
        };
        let Some(at) = known else {
            if self.places.len() < AXES_MAX {
                self.places.push((axis, number));
            }
            return;
        };
        let last = core::mem::replace(&mut self.places[at].1, number);
        let expected = (last + 1) % after;
        if number != expected && number != last {
            let missed = (number + after - expected) % after;
            let text = format!(
                "point {number} after {last} to axis {axis}: {missed} of a path are missing"
            );
            let kind = Oddity::Sequence;
            notices.push(Notice::Odd(Odd { kind, axis: Some(axis), time: None, text }));
        }
    }
}

fn sort(wrong: Wrong) -> Oddity {
    match wrong {
        Wrong::Stray(_) => Oddity::Stray,
        wrong if wrong.is_check() => Oddity::BadCheck,
        Wrong::Broken | Wrong::Wire(_) => Oddity::Malformed,
    }
}

/// Something odd of an axis, now.
fn odd(kind: Oddity, axis: Option<u32>, text: String) -> Notice {
    Notice::Odd(Odd { kind, axis, time: None, text })
}

#[cfg(test)]
mod tests;
