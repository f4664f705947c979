//! Frames and notices of tests' own.

use polepair_core::explain::Sink as _;

use crate::session::{
    Change, Exchange, Fault, Notice, Odd, Oddity, Outcome, Quality, Signal, name,
};
use crate::{Event, Explained, Stamp};

/// When a made capture begins.
pub(crate) const BEGIN_NS: u64 = 1_700_000_000_000_000_000;

/// A capture that is made frame by frame.
#[derive(Default)]
pub(crate) struct Made {
    number: u64,
}

impl Made {
    /// The next frame: of an axis of `can0` that speaks CANopen, so many microseconds after the
    /// begin.
    pub(crate) fn frame(
        &mut self,
        us: u64,
        (axis, kind): (u32, &str),
        notices: &[Notice],
        take: &mut dyn FnMut(&Event<'_>),
    ) {
        self.number += 1;
        let mut explained = Explained::default();
        explained.kind(kind);
        explained.axis(axis);
        take(&Event {
            number: self.number,
            time: Some(stamp(us)),
            link: "can0",
            direction: None,
            protocol: Some("canopen"),
            bytes: &[0; 8],
            id: Some(0x180 + axis),
            extended: false,
            remote: false,
            wanted: 0,
            echo: false,
            stray: false,
            explained: &explained,
            wrong: None,
            notices,
            at: 0,
        });
    }
}

pub(crate) fn stamp(us: u64) -> Stamp {
    Stamp(BEGIN_NS + us * 1000)
}

pub(crate) fn odd(kind: Oddity, axis: u32) -> Notice {
    Notice::Odd(Odd { kind, axis: Some(axis), time: None, text: format!("{} here", kind.word()) })
}

pub(crate) fn signal(axis: u32, called: &str, value: f64) -> Notice {
    let (name, unit, quality) = (name(called), "mm", Quality::Good);
    Notice::Signal(Signal { axis, name, value, exact: None, unit, quality, request: None })
}

pub(crate) fn exchange(axis: u32, asked: u64, us: u64, outcome: Outcome) -> Notice {
    let answered = (outcome != Outcome::Unanswered).then(|| (2, Some(stamp(asked + us))));
    let (asked, retries) = ((1, Some(stamp(asked))), 0);
    Notice::Exchange(Exchange { axis: Some(axis), op: "read", asked, answered, outcome, retries })
}

pub(crate) fn change(axis: u32, to: &str) -> Notice {
    Notice::Change(Change { axis: Some(axis), what: "nmt", from: "", to: name(to) })
}

pub(crate) fn fault(axis: u32, gone: bool) -> Notice {
    let (text, cause, remedy) = ("over-voltage", "braking", "add a brake resistor");
    Notice::Fault(Fault { axis, code: 0x3210, text, cause, remedy, gone })
}
