//! Replies that may still come to requests that were given up.
//!
//! Most replies do not name the request they belong to. So after a missing reply the next one of the
//! same kind may be the older request's, and its value wrong. The rule against that is the same in every
//! protocol: the drive is *in doubt*, and only stops are sent to it. A doubt ends in one of two ways:
//!
//! - A *probe* is answered, which is a query of another kind than every outstanding reply. A drive
//!   replies in order, so nothing older can come behind the reply to the probe.
//! - The latest possible reply is overdue.
//!
//! A protocol states what distinguishes its replies, the kind `K` (an opcode, a variable, a command word),
//! and which queries change nothing and can therefore be probes.

use crate::time::Instant;

/// Probes sent into silence at most, in one doubt.
pub const PROBES_MAX: u8 = 4;
/// Latest time of a reply after its request was given up, in reply timeouts.
pub(super) const LATEST_TIMEOUTS: u64 = 3;

/// The outstanding replies of one drive.
#[derive(Clone, Copy, Debug)]
pub(super) struct OutstandingReplies<K, const N: usize> {
    /// A kind for each reply that may come, and until when; those without a kind are free.
    replies: [(Option<K>, Instant); N],
    /// True if there were more kinds than places: the next reply may be of any kind.
    overflowed: bool,
    probes_sent: u8,
    until: Instant,
}

impl<K: Copy + PartialEq, const N: usize> OutstandingReplies<K, N> {
    pub const NONE: Self = Self {
        replies: [(None, Instant::ZERO); N],
        overflowed: false,
        probes_sent: 0,
        until: Instant::ZERO,
    };

    /// Notes a reply that may come before `until`.
    pub fn add(&mut self, kind: K, until: Instant) {
        self.until = self.until.max(until);
        let free = self.replies.iter().position(|(kind, _)| kind.is_none());
        // A kind that is known already needs no place of its own. Only how often it may come is lost.
        let same = || self.replies.iter().position(|(other, _)| *other == Some(kind));
        match free.or_else(same) {
            Some(at) => self.replies[at] = (Some(kind), until),
            None => self.overflowed = true,
        }
    }

    /// Forgets the replies that are overdue.
    pub fn expire(&mut self, now: Instant) {
        if now >= self.until {
            *self = Self::NONE;
        }
        for reply in self.replies.iter_mut().filter(|(_, until)| now >= *until) {
            reply.0 = None;
        }
    }

    /// Number of replies of a kind that may still come.
    pub fn count(&self, now: Instant, kind: K) -> u8 {
        self.replies.iter().filter(|reply| is_outstanding(reply, now, kind)).count() as u8
    }

    /// Returns whether the next reply of a kind may belong to an older request.
    pub fn may_include(&self, now: Instant, kind: K) -> bool {
        self.overflowed || self.count(now, kind) > 0
    }

    pub fn is_empty(&self) -> bool {
        !self.overflowed && self.replies.iter().all(|(kind, _)| kind.is_none())
    }

    /// Time at which the last of them is overdue.
    pub const fn until(&self) -> Instant {
        self.until
    }

    pub const fn may_probe(&self) -> bool {
        self.probes_sent < PROBES_MAX
    }

    /// The first of `probes` to which no outstanding reply fits.
    pub fn next_probe(&mut self, now: Instant, probes: &[K]) -> Option<K> {
        let probe = probes.iter().copied().find(|probe| self.count(now, *probe) == 0)?;
        self.probes_sent = self.probes_sent.saturating_add(1);
        Some(probe)
    }

    fn remove(&mut self, kind: K) {
        for reply in self.replies.iter_mut().filter(|(other, _)| *other == Some(kind)) {
            reply.0 = None;
        }
    }
}

fn is_outstanding<K: PartialEq>(reply: &(Option<K>, Instant), now: Instant, kind: K) -> bool {
    now < reply.1 && reply.0 == Some(kind)
}

#[derive(Clone, Copy, Debug)]
struct DriveInDoubt<K, const N: usize> {
    address: u8,
    outstanding: OutstandingReplies<K, N>,
    probe_due: bool,
}

/// The drives in doubt of one line: `DRIVES` at most, with `N` outstanding replies each.
///
/// A reply of a drive that finds no place puts the whole line in doubt, until that reply is overdue.
#[derive(Clone, Debug)]
pub(super) struct ReplyLedger<K, const DRIVES: usize, const N: usize> {
    drives: [Option<DriveInDoubt<K, N>>; DRIVES],
    /// Time until which replies of drives without a place may come.
    line_until: Option<Instant>,
}

impl<K: Copy + PartialEq, const DRIVES: usize, const N: usize> ReplyLedger<K, DRIVES, N> {
    pub const fn new() -> Self {
        Self { drives: [None; DRIVES], line_until: None }
    }

    /// Notes a reply of a drive that may come before `until`. Returns false when the drive has no place.
    pub fn add(&mut self, address: u8, kind: K, until: Instant) -> bool {
        let known = self.drives.iter().position(|drive| is_drive(drive, address));
        let place = known.or_else(|| self.drives.iter().position(Option::is_none));
        let Some(place) = place else {
            self.line_until = self.line_until.max(Some(until));
            return false;
        };
        let fresh =
            DriveInDoubt { address, outstanding: OutstandingReplies::NONE, probe_due: false };
        self.drives[place].get_or_insert(fresh).outstanding.add(kind, until);
        true
    }

    /// States whether a probe to a drive in doubt is worth sending. None is sent beyond [`PROBES_MAX`].
    pub fn set_probe_due(&mut self, address: u8, due: bool) {
        if let Some(drive) = self.drive_mut(address) {
            drive.probe_due = due && drive.outstanding.may_probe();
        }
    }

    /// Allows one more probe to a drive that is known to be there.
    pub fn allow_probe(&mut self, address: u8) {
        if let Some(drive) = self.drive_mut(address) {
            drive.outstanding.probes_sent = drive.outstanding.probes_sent.min(PROBES_MAX - 1);
        }
    }

    /// The next probe that is due, and its drive.
    pub fn next_probe(&mut self, now: Instant, probes: &[K]) -> Option<(u8, K)> {
        let drive = self.drives.iter_mut().flatten().find(|drive| drive.probe_due)?;
        drive.probe_due = false;
        Some((drive.address, drive.outstanding.next_probe(now, probes)?))
    }

    /// Number of replies of a kind that may still come from a drive.
    pub fn count(&self, now: Instant, address: u8, kind: K) -> u8 {
        self.drive(address).map_or(0, |drive| drive.outstanding.count(now, kind))
    }

    /// Returns whether the next reply of a kind from a drive may belong to an older request.
    pub fn may_include(&self, now: Instant, address: u8, kind: K) -> bool {
        let drive = self.drive(address);
        self.is_line_in_doubt(now)
            || drive.is_some_and(|drive| drive.outstanding.may_include(now, kind))
    }

    /// Returns whether the next reply of a kind from any drive may belong to an older request.
    pub fn may_any_include(&self, now: Instant, kind: K) -> bool {
        let mut drives = self.drives.iter().flatten();
        self.is_line_in_doubt(now) || drives.any(|drive| drive.outstanding.may_include(now, kind))
    }

    pub fn is_in_doubt(&self, now: Instant, address: u8) -> bool {
        self.is_line_in_doubt(now) || self.drive(address).is_some()
    }

    pub fn is_empty(&self) -> bool {
        self.line_until.is_none() && self.drives.iter().all(Option::is_none)
    }

    /// A drive answered what no older request could own: nothing older is to come.
    pub fn settle(&mut self, address: u8) {
        for drive in self.drives.iter_mut().filter(|drive| is_drive(drive, address)) {
            *drive = None;
        }
    }

    /// No reply of this kind is to come from any drive.
    pub fn settle_kind(&mut self, kind: K) {
        for slot in &mut self.drives {
            let Some(drive) = slot else { continue };
            drive.outstanding.remove(kind);
            if drive.outstanding.is_empty() {
                *slot = None;
            }
        }
    }

    /// Ends a doubt whose replies are all overdue, and returns its drive. `probed` is in doubt until its
    /// probe has ended.
    pub fn pop_expired(&mut self, now: Instant, probed: Option<u8>) -> Option<u8> {
        self.line_until.take_if(|until| now >= *until);
        let unprobed = self
            .drives
            .iter_mut()
            .filter(|drive| drive.as_ref().is_some_and(|drive| probed != Some(drive.address)));
        for slot in unprobed {
            let Some(drive) = slot else { continue };
            drive.outstanding.expire(now);
            if now >= drive.outstanding.until() {
                return slot.take().map(|drive| drive.address);
            }
        }
        None
    }

    /// Time at which the first doubt ends by itself.
    pub fn deadline(&self) -> Option<Instant> {
        let drives = self.drives.iter().flatten().map(|drive| drive.outstanding.until());
        drives.chain(self.line_until).min()
    }

    fn is_line_in_doubt(&self, now: Instant) -> bool {
        self.line_until.is_some_and(|until| now < until)
    }

    fn drive(&self, address: u8) -> Option<&DriveInDoubt<K, N>> {
        self.drives.iter().flatten().find(|drive| drive.address == address)
    }

    fn drive_mut(&mut self, address: u8) -> Option<&mut DriveInDoubt<K, N>> {
        self.drives.iter_mut().flatten().find(|drive| drive.address == address)
    }
}

fn is_drive<K, const N: usize>(drive: &Option<DriveInDoubt<K, N>>, address: u8) -> bool {
    drive.as_ref().is_some_and(|drive| drive.address == address)
}

#[cfg(test)]
mod tests {
    use super::{OutstandingReplies, PROBES_MAX, ReplyLedger};
    use crate::time::Instant;

    const DRIVE: u8 = 7;
    const OTHER_DRIVE: u8 = 8;
    const PROBES: [char; 3] = ['a', 'b', 'c'];

    fn at(ms: u32) -> Instant {
        Instant::ZERO.plus_ms(ms)
    }

    #[test]
    fn a_probe_is_of_a_kind_that_no_outstanding_reply_has() {
        let mut ledger = ReplyLedger::<char, 2, 4>::new();
        ledger.add(DRIVE, 'a', at(100));
        ledger.set_probe_due(DRIVE, true);
        assert_eq!(ledger.next_probe(at(1), &PROBES), Some((DRIVE, 'b')));
        assert_eq!(ledger.next_probe(at(1), &PROBES), None, "one was due");
        ledger.add(DRIVE, 'b', at(101));
        ledger.set_probe_due(DRIVE, true);
        assert_eq!(ledger.next_probe(at(2), &PROBES), Some((DRIVE, 'c')));
    }

    #[test]
    fn an_answered_probe_ends_the_doubt_of_its_drive_alone() {
        let mut ledger = ReplyLedger::<char, 3, 4>::new();
        ledger.add(DRIVE, 'a', at(100));
        ledger.add(OTHER_DRIVE, 'a', at(100));
        ledger.settle(DRIVE);
        assert!(!ledger.is_in_doubt(at(1), DRIVE));
        assert!(ledger.is_in_doubt(at(1), OTHER_DRIVE));
        assert!(!ledger.may_include(at(1), DRIVE, 'a'));
        assert!(ledger.may_include(at(1), OTHER_DRIVE, 'a'));
        assert!(!ledger.may_include(at(1), OTHER_DRIVE, 'b'));
    }

    #[test]
    fn a_doubt_ends_when_its_last_reply_is_overdue() {
        let mut ledger = ReplyLedger::<char, 2, 4>::new();
        ledger.add(DRIVE, 'a', at(100));
        ledger.add(DRIVE, 'b', at(150));
        assert_eq!(ledger.deadline(), Some(at(150)));
        assert_eq!(ledger.pop_expired(at(120), None), None);
        assert_eq!((ledger.count(at(120), DRIVE, 'a'), ledger.count(at(120), DRIVE, 'b')), (0, 1));
        assert_eq!(ledger.pop_expired(at(150), Some(DRIVE)), None, "its probe is under way");
        assert_eq!(ledger.pop_expired(at(150), None), Some(DRIVE));
        assert!(ledger.is_empty());
        assert_eq!(ledger.deadline(), None);
    }

    #[test]
    fn a_reply_without_a_place_puts_the_whole_line_in_doubt() {
        let mut ledger = ReplyLedger::<char, 2, 4>::new();
        assert!(ledger.add(1, 'a', at(100)));
        assert!(ledger.add(2, 'a', at(100)));
        assert!(!ledger.is_in_doubt(at(1), DRIVE), "no place is needed yet");
        assert!(!ledger.add(DRIVE, 'b', at(200)));
        assert!(ledger.is_in_doubt(at(1), OTHER_DRIVE));
        assert!(ledger.may_include(at(1), OTHER_DRIVE, 'c'));
        assert_eq!(ledger.pop_expired(at(100), None), Some(1));
        assert_eq!(ledger.pop_expired(at(100), None), Some(2));
        assert!(ledger.is_in_doubt(at(199), DRIVE));
        assert_eq!(ledger.deadline(), Some(at(200)));
        assert_eq!(ledger.pop_expired(at(200), None), None);
        assert!(ledger.is_empty());
    }

    #[test]
    fn probes_into_silence_are_few_and_one_more_can_be_allowed() {
        let mut ledger = ReplyLedger::<char, 2, 4>::new();
        ledger.add(DRIVE, 'x', at(100));
        for _ in 0..PROBES_MAX {
            ledger.set_probe_due(DRIVE, true);
            assert!(ledger.next_probe(at(1), &PROBES).is_some());
        }
        ledger.set_probe_due(DRIVE, true);
        assert_eq!(ledger.next_probe(at(1), &PROBES), None);
        ledger.allow_probe(DRIVE);
        ledger.set_probe_due(DRIVE, true);
        assert_eq!(ledger.next_probe(at(1), &PROBES), Some((DRIVE, 'a')));
    }

    #[test]
    fn more_kinds_than_places_leave_every_kind_in_doubt() {
        let mut replies = OutstandingReplies::<char, 2>::NONE;
        replies.add('a', at(100));
        replies.add('b', at(100));
        replies.add('a', at(120));
        assert!(!replies.may_include(at(1), 'c'), "a kind that is known takes no place");
        replies.add('c', at(130));
        assert!(replies.may_include(at(1), 'd'));
        replies.expire(at(129));
        assert!(!replies.is_empty());
        replies.expire(at(130));
        assert!(replies.is_empty());
        assert!(!replies.may_include(at(130), 'd'));
    }

    #[test]
    fn a_kind_that_no_drive_can_send_any_more_is_settled_for_all() {
        let mut ledger = ReplyLedger::<char, 3, 4>::new();
        ledger.add(DRIVE, 'a', at(100));
        ledger.add(OTHER_DRIVE, 'a', at(100));
        ledger.add(OTHER_DRIVE, 'b', at(100));
        assert!(ledger.may_any_include(at(1), 'a'));
        ledger.settle_kind('a');
        assert!(!ledger.may_any_include(at(1), 'a'));
        assert!(!ledger.is_in_doubt(at(1), DRIVE));
        assert!(ledger.is_in_doubt(at(1), OTHER_DRIVE));
    }
}
