//! Who spoke regularly and fell silent.

use super::{AXES_MAX, odd};
use crate::session::{Notice, Oddity};
use crate::stamp::Stamp;

/// So often somebody must have been heard for his silence to mean something.
const OFTEN: u32 = 8;
/// Unanswered requests in a row that are a silence.
const MISSES: u32 = 3;
/// A steady speaker that misses so many of its turns is silent …
const TURNS: u64 = 10;
/// … and this long at least, ns.
const SILENCE_MIN: u64 = 1_000_000_000;
/// How often steady speakers are looked at, ns.
const LOOK: u64 = 100_000_000;

/// The axes of a link and when they were heard.
#[derive(Debug, Default)]
pub(super) struct Presence {
    axes: Vec<Axis>,
    looked: Option<Stamp>,
}

#[derive(Debug, Default)]
struct Axis {
    axis: u32,
    heard: u32,
    last: Option<Stamp>,
    /// Unanswered requests since.
    misses: u32,
    silent: bool,
    /// What it tells by itself: how often, when last, and the longest pause between.
    told: u32,
    told_last: Option<Stamp>,
    pause: u64,
}

impl Presence {
    fn of(&mut self, axis: u32) -> Option<&mut Axis> {
        let at = match self.axes.iter().position(|known| known.axis == axis) {
            Some(at) => at,
            None if self.axes.len() == AXES_MAX => return None,
            None => {
                self.axes.push(Axis { axis, ..Axis::default() });
                self.axes.len() - 1
            }
        };
        Some(&mut self.axes[at])
    }

    /// A host asks it something, which may end what it told by itself.
    pub fn asked(&mut self, axis: Option<u32>) {
        for known in self.axes.iter_mut().filter(|known| axis.is_none_or(|axis| axis == known.axis))
        {
            known.told = 0;
        }
    }

    /// It was heard; `unasked` when it spoke by itself.
    pub fn heard(&mut self, axis: Option<u32>, now: Option<Stamp>, unasked: bool) {
        let Some(known) = axis.and_then(|axis| self.of(axis)) else { return };
        known.heard = known.heard.saturating_add(1);
        (known.last, known.misses, known.silent) = (now, 0, false);
        if unasked {
            let pause = now.zip(known.told_last).map_or(0, |(now, last)| now.since(last));
            known.pause = if known.told > 1 { known.pause.max(pause) } else { pause };
            known.told = known.told.saturating_add(1);
            known.told_last = now;
        }
    }

    /// It left requests unanswered.
    pub fn missed(
        &mut self,
        axes: impl Iterator<Item = u32>,
        now: Option<Stamp>,
        notices: &mut Vec<Notice>,
    ) {
        for axis in axes {
            let Some(known) = self.of(axis) else { continue };
            known.misses = known.misses.saturating_add(1);
            if known.heard >= OFTEN && known.misses >= MISSES && !known.silent {
                known.silence(now, notices);
            }
        }
    }

    /// Time goes on: whoever told something steadily is missed.
    pub fn pass(&mut self, now: Stamp, notices: &mut Vec<Notice>) {
        if self.looked.is_some_and(|looked| now.since(looked) < LOOK) {
            return;
        }
        self.looked = Some(now);
        for known in &mut self.axes {
            let steady = known.told >= OFTEN && !known.silent;
            let quiet = known.last.map_or(0, |last| now.since(last));
            if steady && quiet > SILENCE_MIN.max(TURNS * known.pause) {
                known.silence(Some(now), notices);
            }
        }
    }
}

impl Axis {
    fn silence(&mut self, now: Option<Stamp>, notices: &mut Vec<Notice>) {
        self.silent = true;
        let quiet = now.zip(self.last).map(|(now, last)| now.since(last) as f64 / 1e9);
        let for_long = quiet.map_or(String::new(), |quiet| format!(" for {quiet:.1} s"));
        let text = format!(
            "axis {} has been silent{for_long}, after {} frames of it",
            self.axis, self.heard
        );
        notices.push(odd(Oddity::Silent, Some(self.axis), text));
    }
}
