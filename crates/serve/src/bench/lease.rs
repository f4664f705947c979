//! The lease of an axis: one owner at a time, with an epoch that increases with each owner. This module
//! sends nothing and reads no clock.
//!
//! Why: GW-2.

use std::sync::Arc;
use std::time::Duration;

use polepair_core::time::Instant;

use crate::message::GatewayError;

/// A client's session, as leases and the journal name it.
pub type SessionName = Arc<str>;

/// The right to command one axis.
#[derive(Debug, Default)]
pub(super) struct LeaseSlot {
    holder: Option<LeaseHolder>,
    /// Epoch of the last lease; 0 before the first.
    epoch: u64,
    /// Something was set in motion under the lease, and no stop followed.
    moved: bool,
}

/// Holder of a lease.
#[derive(Clone, Debug)]
pub(super) struct LeaseHolder {
    /// Session of the holder.
    pub session: SessionName,
    /// The lease's epoch.
    pub epoch: u64,
    /// Time at which it ends unless it is renewed.
    pub until: Instant,
}

/// A lease that ended.
#[derive(Debug)]
pub(super) struct EndedLease {
    /// Last holder.
    pub holder: LeaseHolder,
    /// True if it set the axis in motion, which must be stopped.
    pub moved: bool,
}

impl LeaseSlot {
    /// A free lease, whose next epoch is higher than that.
    pub fn after_epoch(epoch: u64) -> Self {
        Self { epoch, ..Self::default() }
    }

    /// Holder of the lease.
    pub fn holder(&self) -> Option<&LeaseHolder> {
        self.holder.as_ref()
    }

    /// Gives the lease to a session; from another one only if it is to `take` it. Returns the lease,
    /// and the one that ended with it.
    pub fn acquire(
        &mut self,
        session: &SessionName,
        take: bool,
        now: Instant,
        lasts: Duration,
    ) -> Result<(LeaseHolder, Option<EndedLease>), GatewayError> {
        if let Some(holder) = self.current_holder(now).filter(|holder| holder.session == *session) {
            let renewed = LeaseHolder { until: now + lasts, ..holder.clone() };
            self.holder = Some(renewed.clone());
            return Ok((renewed, None));
        }
        if let Some(holder) = self.current_holder(now).filter(|_| !take) {
            let what = format!("{} controls this axis", holder.session);
            return Err(lease_error(what)
                .hint("wait until it is released, or take it over on the server's page"));
        }
        let lost = self.end();
        debug_assert!(self.holder.is_none(), "a lease has one holder");
        self.epoch += 1;
        let holder =
            LeaseHolder { session: session.clone(), epoch: self.epoch, until: now + lasts };
        self.holder = Some(holder.clone());
        Ok((holder, lost))
    }

    /// Keeps it for longer.
    pub fn renew(
        &mut self,
        session: &SessionName,
        epoch: u64,
        now: Instant,
        lasts: Duration,
    ) -> Result<LeaseHolder, GatewayError> {
        let holder = self.check_holder(session, epoch, now)?;
        let renewed = LeaseHolder { until: now + lasts, ..holder.clone() };
        self.holder = Some(renewed.clone());
        Ok(renewed)
    }

    /// Gives it back.
    pub fn release(
        &mut self,
        session: &SessionName,
        epoch: u64,
        now: Instant,
    ) -> Result<Option<EndedLease>, GatewayError> {
        self.check_holder(session, epoch, now)?;
        Ok(self.end())
    }

    /// Ends the lease. The caller stops its motions.
    pub fn end(&mut self) -> Option<EndedLease> {
        // The next holder has moved nothing yet.
        let moved = std::mem::take(&mut self.moved);
        self.holder.take().map(|holder| EndedLease { holder, moved })
    }

    /// Ends it if its time is over.
    pub fn expire(&mut self, now: Instant) -> Option<EndedLease> {
        let over = self.holder.as_ref().is_some_and(|holder| holder.until <= now);
        if over { self.end() } else { None }
    }

    /// The lease, if it is its caller's and of this epoch, and not over.
    pub fn check_holder(
        &self,
        session: &SessionName,
        epoch: u64,
        now: Instant,
    ) -> Result<&LeaseHolder, GatewayError> {
        match self.current_holder(now) {
            Some(holder) if holder.session == *session && holder.epoch == epoch => Ok(holder),
            Some(holder) if holder.session == *session => {
                let what = format!("epoch {epoch} is over, this is {}", holder.epoch);
                Err(lease_error(what).hint("commands of an older lease are not executed"))
            }
            Some(holder) => Err(lease_error(format!("{} controls this axis", holder.session))
                .hint("wait until it is released, or take it over on the server's page")),
            None => Err(lease_error("no client has the lease of this axis").hint(
                "acquire it, and \
                 renew it",
            )),
        }
    }

    /// Notes that something was set in motion under the lease.
    pub fn mark_moved(&mut self) {
        self.moved = true;
    }

    /// Records that its motion was stopped.
    pub fn mark_stopped(&mut self) {
        self.moved = false;
    }

    fn current_holder(&self, now: Instant) -> Option<&LeaseHolder> {
        self.holder.as_ref().filter(|holder| now < holder.until)
    }
}

fn lease_error(what: impl Into<String>) -> GatewayError {
    GatewayError::new("gateway.lease", what)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LASTS: Duration = Duration::from_millis(1500);

    fn at(ms: u32) -> Instant {
        Instant::ZERO.plus_ms(ms)
    }

    #[test]
    fn a_lease_is_one_sessions_until_it_ends_or_is_taken() {
        let (ann, bob): (SessionName, SessionName) = ("ann".into(), "bob".into());
        let mut slot = LeaseSlot::default();
        let (lease, lost) = slot.acquire(&ann, false, at(0), LASTS).unwrap();
        assert!(lease.epoch == 1 && lost.is_none());
        assert_eq!(slot.acquire(&bob, false, at(1), LASTS).unwrap_err().code, "gateway.lease");
        slot.mark_moved();
        let (lease_holder, lost) = slot.acquire(&bob, true, at(2), LASTS).unwrap();
        assert_eq!(lease_holder.epoch, 2);
        assert!(lost.is_some_and(|lost| lost.moved && lost.holder.session == ann));
        assert!(slot.renew(&ann, 1, at(3), LASTS).is_err());
        assert!(slot.check_holder(&bob, 1, at(3)).is_err(), "an older epoch");
        assert!(slot.check_holder(&bob, 2, at(3)).is_ok());
    }

    #[test]
    fn a_lease_that_is_not_renewed_ends_by_itself() {
        let ann: SessionName = "ann".into();
        let mut slot = LeaseSlot::default();
        slot.acquire(&ann, false, at(0), LASTS).unwrap();
        slot.renew(&ann, 1, at(1000), LASTS).unwrap();
        assert!(slot.expire(at(2499)).is_none());
        assert!(slot.check_holder(&ann, 1, at(2500)).is_err(), "over, though nobody looked yet");
        assert!(slot.expire(at(2500)).is_some());
        let (again, _) = slot.acquire(&ann, false, at(2600), LASTS).unwrap();
        assert_eq!(again.epoch, 2, "what was said before is not carried out after");
    }
}
