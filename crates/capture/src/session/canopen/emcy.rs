//! Emergencies: active faults of a node, and emergencies that come too fast.

use polepair_core::profile::{Fault as Known, Profile};
use polepair_core::proto::canopen::emcy::{Emergency, class_text};
use polepair_core::proto::canopen::explain::meanings;

use super::anomaly;
use crate::session::{AnomalyKind, FaultNotice, SessionNotice};
use crate::timestamp::Timestamp;

/// Faults of a node that are known to be there at once.
const ACTIVE_MAX: usize = 16;
/// Emergencies of a node within [`STORM_NS`] that are a storm.
const STORM: usize = 8;
const STORM_NS: u64 = 1_000_000_000;
/// The drive that alone sends the code alone (TS manual, 3.5.2).
const SHORT_FORM: &str = "syntron-ts-canopen";

/// The faults of one node.
#[derive(Debug, Default)]
pub(super) struct NodeFaults {
    active: Vec<(u32, FaultText)>,
    recent_times: [Timestamp; STORM],
    count: usize,
    in_storm: bool,
}

/// Description of a fault.
#[derive(Clone, Copy, Debug)]
pub(super) struct FaultText {
    pub text: &'static str,
    cause: &'static str,
    remedy: &'static str,
    /// They are the drive's, not the standard's.
    drive_specific: bool,
    /// The drive was concluded from the form of the frame.
    pub inferred: bool,
}

impl FaultText {
    /// Description of a fault that only a statusword reports.
    pub const UNNAMED: Self = Self {
        text: "a fault that the drive did not name",
        cause: "",
        remedy: "",
        drive_specific: false,
        inferred: false,
    };

    /// Meaning of a code: the drive's own words, otherwise the standard's for its class.
    pub fn lookup(code: u32, short: bool, profile: Option<&'static Profile>) -> Self {
        let own = meanings::canopen_profile(profile);
        let inferred = short && own.is_none();
        let usual =
            || polepair_drives::profiles().iter().copied().find(|known| known.name == SHORT_FORM);
        let book = if inferred { usual() } else { own };
        let known = book.and_then(|book| book.faults.iter().find(|fault| fault.code == code));
        match known {
            Some(Known { text, cause, remedy, .. }) => {
                Self { text, cause, remedy, drive_specific: true, inferred }
            }
            None => Self { text: class_text(code as u16), ..Self::UNNAMED },
        }
    }

    const fn to_notice(self, node: u8, code: u32, gone: bool) -> SessionNotice {
        let Self { text, cause, remedy, .. } = self;
        SessionNotice::Fault(FaultNotice { axis: node as u32, code, text, cause, remedy, gone })
    }
}

impl NodeFaults {
    /// None is known to be there.
    pub const fn is_empty(&self) -> bool {
        self.active.is_empty()
    }

    /// An emergency.
    pub fn handle_emergency(
        &mut self,
        node: u8,
        emergency: &Emergency,
        words: FaultText,
        now: Option<Timestamp>,
        notices: &mut Vec<SessionNotice>,
    ) {
        self.check_storm(node, now, notices);
        // All of 00xxh takes faults back; of drives with numbers of their own, 0000h alone.
        let gone = if words.drive_specific { 0 } else { 0xFF };
        match (emergency.code, emergency.register) {
            (code, _) if code > gone => self.add(node, code.into(), words, notices),
            (_, 0) => self.clear(node, notices),
            _ => self.clear_last(node, notices),
        }
    }

    /// A fault is there.
    pub fn add(&mut self, node: u8, code: u32, words: FaultText, notices: &mut Vec<SessionNotice>) {
        if self.active.iter().any(|(known, _)| *known == code) {
            return;
        }
        // The statusword reported a fault without its code.
        self.active.retain(|(known, _)| *known != 0);
        if self.active.len() < ACTIVE_MAX {
            self.active.push((code, words));
        }
        notices.push(words.to_notice(node, code, false));
    }

    /// None is there any more.
    pub fn clear(&mut self, node: u8, notices: &mut Vec<SessionNotice>) {
        let gone = self.active.drain(..).map(|(code, words)| words.to_notice(node, code, true));
        notices.extend(gone);
    }

    fn clear_last(&mut self, node: u8, notices: &mut Vec<SessionNotice>) {
        notices.extend(self.active.pop().map(|(code, words)| words.to_notice(node, code, true)));
    }

    fn check_storm(&mut self, node: u8, now: Option<Timestamp>, notices: &mut Vec<SessionNotice>) {
        let Some(now) = now else { return };
        let last = self.recent_times[(self.count + STORM - 1) % STORM];
        if self.count > 0 && now.since(last) > STORM_NS {
            (self.count, self.in_storm) = (0, false);
        }
        let oldest = core::mem::replace(&mut self.recent_times[self.count % STORM], now);
        self.count += 1;
        let dense = self.count > STORM && now.since(oldest) <= STORM_NS;
        if dense && !core::mem::replace(&mut self.in_storm, true) {
            let ms = now.since(oldest) / 1_000_000;
            let text = format!("{} emergencies within {ms} ms", STORM + 1);
            notices.push(anomaly(AnomalyKind::Storm, node, text));
        }
    }
}
