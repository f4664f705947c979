//! Emergencies: which faults a node has, and when they come too fast.

use polepair_core::drives;
use polepair_core::profile::{Fault as Known, Profile};
use polepair_core::proto::canopen::emcy::{Emergency, class};
use polepair_core::proto::canopen::explain::say;

use super::odd;
use crate::session::{Fault, Notice, Oddity};
use crate::stamp::Stamp;

/// Faults of a node that are known to be there at once.
const OPEN_MAX: usize = 16;
/// So many emergencies of a node within [`STORM_NS`] are a storm.
const STORM: usize = 8;
const STORM_NS: u64 = 1_000_000_000;
/// The drive that alone sends the code alone (TS manual, 3.5.2).
const SHORT_FORM: &str = "syntron-ts-canopen";

/// The faults of one node.
#[derive(Debug, Default)]
pub(super) struct Faults {
    open: Vec<(u32, Words)>,
    times: [Stamp; STORM],
    count: usize,
    storms: bool,
}

/// What is known of a fault.
#[derive(Clone, Copy, Debug)]
pub(super) struct Words {
    pub text: &'static str,
    cause: &'static str,
    remedy: &'static str,
    /// They are the drive's, not the standard's.
    own: bool,
    /// The drive was concluded from the form of the frame.
    pub inferred: bool,
}

impl Words {
    /// Of a fault that only a statusword tells.
    pub const UNNAMED: Self = Self {
        text: "a fault that the drive did not name",
        cause: "",
        remedy: "",
        own: false,
        inferred: false,
    };

    /// What a code means: the drive's own words, else the standard's for its class.
    pub fn of(code: u32, short: bool, profile: Option<&'static Profile>) -> Self {
        let own = say::own(profile);
        let inferred = short && own.is_none();
        let usual = || drives::profiles().iter().copied().find(|known| known.name == SHORT_FORM);
        let book = if inferred { usual() } else { own };
        let known = book.and_then(|book| book.faults.iter().find(|fault| fault.code == code));
        match known {
            Some(Known { text, cause, remedy, .. }) => {
                Self { text, cause, remedy, own: true, inferred }
            }
            None => Self { text: class(code as u16), ..Self::UNNAMED },
        }
    }

    const fn fault(self, node: u8, code: u32, gone: bool) -> Notice {
        let Self { text, cause, remedy, .. } = self;
        Notice::Fault(Fault { axis: node as u32, code, text, cause, remedy, gone })
    }
}

impl Faults {
    /// None is known to be there.
    pub const fn is_empty(&self) -> bool {
        self.open.is_empty()
    }

    /// An emergency.
    pub fn take(
        &mut self,
        node: u8,
        emergency: &Emergency,
        words: Words,
        now: Option<Stamp>,
        notices: &mut Vec<Notice>,
    ) {
        self.storm(node, now, notices);
        // All of 00xxh takes faults back; of drives with numbers of their own, 0000h alone.
        let gone = if words.own { 0 } else { 0xFF };
        match (emergency.code, emergency.register) {
            (code, _) if code > gone => self.open(node, code.into(), words, notices),
            (_, 0) => self.clear(node, notices),
            _ => self.clear_last(node, notices),
        }
    }

    /// A fault is there.
    pub fn open(&mut self, node: u8, code: u32, words: Words, notices: &mut Vec<Notice>) {
        if self.open.iter().any(|(known, _)| *known == code) {
            return;
        }
        // A statusword told that there is one, not which.
        self.open.retain(|(known, _)| *known != 0);
        if self.open.len() < OPEN_MAX {
            self.open.push((code, words));
        }
        notices.push(words.fault(node, code, false));
    }

    /// None is there any more.
    pub fn clear(&mut self, node: u8, notices: &mut Vec<Notice>) {
        let gone = self.open.drain(..).map(|(code, words)| words.fault(node, code, true));
        notices.extend(gone);
    }

    fn clear_last(&mut self, node: u8, notices: &mut Vec<Notice>) {
        notices.extend(self.open.pop().map(|(code, words)| words.fault(node, code, true)));
    }

    fn storm(&mut self, node: u8, now: Option<Stamp>, notices: &mut Vec<Notice>) {
        let Some(now) = now else { return };
        let last = self.times[(self.count + STORM - 1) % STORM];
        if self.count > 0 && now.since(last) > STORM_NS {
            (self.count, self.storms) = (0, false);
        }
        let oldest = core::mem::replace(&mut self.times[self.count % STORM], now);
        self.count += 1;
        let dense = self.count > STORM && now.since(oldest) <= STORM_NS;
        if dense && !core::mem::replace(&mut self.storms, true) {
            let ms = now.since(oldest) / 1_000_000;
            let text = format!("{} emergencies within {ms} ms", STORM + 1);
            notices.push(odd(Oddity::Storm, node, text));
        }
    }
}
