//! Errors that a drive reports by itself while it may go on.

use std::time::Duration;

use polepair_core::time::Instant;

use super::LocalAxis;

/// An emergency that came this long before the end of a motion may be its reason.
const REASON_MAX: Duration = Duration::from_secs(5);

impl LocalAxis {
    /// The last error that the drive reported by itself from `since` on, and the time of its message. The drive may go
    /// on all the same. Nothing is sent.
    #[must_use]
    pub fn emergency_since(&self, since: Instant) -> Option<(Instant, String)> {
        let emergency = self.state().emergency.filter(|emergency| emergency.at >= since)?;
        // A code of one bit each may be several faults; an emergency has one.
        let known = self.profile.faults.iter().find(|fault| fault.code == emergency.code);
        let about = match known {
            Some(fault) => fault.text.trim_end_matches('.'),
            None => "its meaning is in the drive's manual",
        };
        Some((emergency.at, format!("emergency {:04X}h ({about})", emergency.code)))
    }

    /// An error that the drive reported shortly before now, with its age: a reason for the end of a motion.
    pub(super) fn recent_emergency(&self) -> Option<String> {
        let now = self.connection.now();
        let recent = self.state().emergency.filter(|last| now.since(last.at) <= REASON_MAX)?;
        let (at, text) = self.emergency_since(recent.at)?;
        Some(format!("it sent {text} {:.1} s before", now.since(at).as_secs_f64()))
    }
}
