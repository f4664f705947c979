//! The gateway as all axes of a link share it: its links, the leases, and addresses that are parameters.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use polepair_client::message::{AxisInfo, BenchView, CommandArguments, ParameterInfo};
use polepair_client::{Gateway, GatewayError, Lease, LiveConnection};
use polepair_core::profile::{ParameterId, same_name};

use crate::error::Error;

/// Time limit of a verb that ends with the drive's reply.
pub(super) const REPLY_MAX: Duration = Duration::from_secs(10);
/// Time limit of a stop: the gateway repeats it for 10 s.
pub(super) const STOP_MAX: Duration = Duration::from_secs(12);
/// Parameters of an axis have lower numbers; addresses have this number and those above.
const FIRST_ADDRESS: u16 = 0x8000;

/// A gateway, and what this program holds of its axes.
#[derive(Debug)]
pub(super) struct Server {
    gateway: Gateway,
    bench: BenchView,
    /// The parameters of each axis, once they were read.
    parameters: Vec<OnceLock<Vec<ParameterInfo>>>,
    /// Addresses that are parameters of an axis: the gateway reads and writes them by their text.
    addresses: Mutex<Vec<(u16, String)>>,
    /// Open while an axis is leased or watched; opened again after the gateway was restarted.
    live: Mutex<Option<LiveConnection>>,
    slots: Vec<(Mutex<LeaseState>, Condvar)>,
}

/// The lease of an axis. A gateway grants one lease per axis to a session, so all threads of this program
/// share it, and the last user releases it.
#[derive(Debug, Default)]
struct LeaseState {
    lease: Option<Arc<Lease>>,
    armed: bool,
    /// Writes that use the lease now.
    users: usize,
    /// A [`LeaseGuard`] exists.
    locked: bool,
}

/// The right to acquire, arm and release the lease of an axis. Reading the lease, and stops, do not wait for it.
#[derive(Debug)]
pub struct LeaseGuard {
    server: Arc<Server>,
    axis: u16,
}

impl Server {
    pub fn new(gateway: Gateway, mut bench: BenchView) -> Self {
        if bench.links.len() > 1 {
            bench.axes.iter_mut().for_each(|axis| axis.label += &format!(" of link {}", axis.link));
        }
        let parameters = bench.axes.iter().map(|_| OnceLock::new()).collect();
        let slots = bench.axes.iter().map(|_| Default::default()).collect();
        let addresses = Mutex::default();
        Self { gateway, bench, parameters, addresses, live: Mutex::default(), slots }
    }

    pub const fn gateway(&self) -> &Gateway {
        &self.gateway
    }

    pub const fn bench(&self) -> &BenchView {
        &self.bench
    }

    /// The parameters of an axis, read at the first call.
    pub fn parameters(&self, axis: u16) -> Result<&[ParameterInfo], GatewayError> {
        let cached = &self.parameters[usize::from(axis)];
        if let Some(parameters) = cached.get() {
            return Ok(parameters);
        }
        let read = self.gateway.parameters(axis)?;
        Ok(cached.get_or_init(|| read))
    }

    /// Returns whether the parameters of an axis were read.
    pub fn has_parameters(&self, axis: u16) -> bool {
        self.parameters[usize::from(axis)].get().is_some()
    }

    /// The parameter with this name, symbol or address.
    pub fn find_parameter(&self, axis: u16, name: &str) -> Result<ParameterId, GatewayError> {
        let matches =
            |info: &ParameterInfo| same_name(&info.name, name) || same_name(&info.symbol, name);
        let index = self.parameters(axis)?.iter().position(matches);
        if let Some(index) = index.and_then(|index| u16::try_from(index).ok()) {
            return Ok(ParameterId(index));
        }
        if let Some(known) = self.find_address(axis, name) {
            return Ok(known);
        }
        // The gateway knows the protocol's addresses, and the nearest name.
        self.gateway.parameter(axis, name)?;
        self.add_address(axis, name.to_owned())
    }

    /// The name or address by which the gateway knows a parameter.
    pub fn parameter_name(&self, axis: u16, id: ParameterId) -> Result<String, GatewayError> {
        if let Some(index) = id.0.checked_sub(FIRST_ADDRESS)
            && let Some((_, address)) = lock(&self.addresses).get(usize::from(index))
        {
            return Ok(address.clone());
        }
        let parameter = self.parameters(axis)?.get(usize::from(id.0));
        parameter
            .map(|parameter| parameter.name.clone())
            .ok_or_else(|| GatewayError::new("E213", format!("there is no parameter {}", id.0)))
    }

    fn find_address(&self, axis: u16, text: &str) -> Option<ParameterId> {
        let known = lock(&self.addresses);
        let index =
            known.iter().position(|(of, address)| (*of, address.as_str()) == (axis, text))?;
        u16::try_from(index).ok()?.checked_add(FIRST_ADDRESS).map(ParameterId)
    }

    fn add_address(&self, axis: u16, text: String) -> Result<ParameterId, GatewayError> {
        let mut known = lock(&self.addresses);
        let id = u16::try_from(known.len()).ok().and_then(|id| id.checked_add(FIRST_ADDRESS));
        let id = id.ok_or_else(|| GatewayError::new("E213", "too many parameters by number"))?;
        known.push((axis, text));
        Ok(ParameterId(id))
    }

    /// The connection for leases and telemetry, opened if there is none.
    pub fn live_connection(&self) -> Result<LiveConnection, GatewayError> {
        let mut stored = lock(&self.live);
        if let Some(live) = stored.as_ref().filter(|live| live.check().is_ok()) {
            return Ok(live.clone());
        }
        let live = self.gateway.live()?;
        self.check_same_drives()?;
        *stored = Some(live.clone());
        Ok(live)
    }

    /// Refuses a gateway that was restarted with other drives: an axis is known by its index.
    pub fn check_same_drives(&self) -> Result<(), GatewayError> {
        let now = self.gateway.bench()?;
        match self.bench.axes.iter().find(|axis| !self.is_same_axis(axis, &now)) {
            None => Ok(()),
            Some(axis) => {
                let what =
                    format!("{}: the server was started again with other drives", axis.label);
                Err(GatewayError::new("E313", what).hint("connect again, and check its axes"))
            }
        }
    }

    fn is_same_axis(&self, axis: &AxisInfo, now: &BenchView) -> bool {
        let there = now.axes.iter().find(|there| there.id == axis.id);
        there.is_some_and(|there| axis_identity(now, there) == axis_identity(&self.bench, axis))
    }

    fn slot(&self, axis: u16) -> MutexGuard<'_, LeaseState> {
        lock(&self.slots[usize::from(axis)].0)
    }

    /// The lease of an axis that this program armed, whether it is still valid or not.
    pub fn armed_lease(&self, axis: u16) -> Option<Arc<Lease>> {
        let state = self.slot(axis);
        state.lease.clone().filter(|_| state.armed)
    }

    /// Waits until no other thread changes the lease of an axis, at most for this time.
    pub fn lock_slot_within(self: &Arc<Self>, axis: u16, within: Duration) -> Option<LeaseGuard> {
        let changed = &self.slots[usize::from(axis)].1;
        let waited = changed.wait_timeout_while(self.slot(axis), within, |state| state.locked);
        let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        (!std::mem::replace(&mut state.locked, true))
            .then(|| LeaseGuard { server: Arc::clone(self), axis })
    }

    /// [`try_lock_slot`](Self::try_lock_slot) without a time limit.
    pub fn lock_slot(self: &Arc<Self>, axis: u16) -> LeaseGuard {
        loop {
            if let Some(guard) = self.lock_slot_within(axis, REPLY_MAX) {
                return guard;
            }
        }
    }

    /// Runs something with the lease of an axis: the one that this program holds, or a new one for this call.
    pub fn with_lease<T>(
        self: &Arc<Self>,
        axis: u16,
        call: impl FnOnce(&Lease) -> Result<T, GatewayError>,
    ) -> Result<T, GatewayError> {
        let lease = self.lock_slot(axis).borrow_lease()?;
        let done = call(&lease);
        drop(lease);
        let guard = self.lock_slot(axis);
        self.slot(axis).users -= 1;
        // The call has its result, with any present holder of the lease.
        let _ = guard.release_lease();
        done
    }

    /// Stops what this program armed, all at once, disables it and releases it; the first error, after every
    /// axis was tried. An axis whose lease ended was stopped by that.
    pub fn stop_armed(self: &Arc<Self>) -> Result<(), GatewayError> {
        let ids = self.bench.axes.iter().map(|axis| axis.id);
        let armed = ids.filter_map(|id| Some((id, self.armed_lease(id)?)));
        let armed: Vec<_> = armed.filter(|(_, lease)| lease.check().is_ok()).collect();
        let started: Vec<_> = armed
            .iter()
            .map(|(id, lease)| {
                self.axis_has_verb(*id, "stop")
                    .then(|| lease.start("stop", CommandArguments::default()))
            })
            .collect();
        let stopped = started
            .into_iter()
            .flatten()
            .map(|result| result?.wait(STOP_MAX)?.ok_or_else(late_standstill));
        let stopped = stopped.fold(Ok(()), Result::and);
        armed.into_iter().fold(stopped, |ended, (id, lease)| {
            let disabled = if self.axis_has_verb(id, "disable") {
                lease.run("disable", CommandArguments::default(), REPLY_MAX)
            } else {
                Ok(())
            };
            drop(lease);
            ended.and(disabled).and(self.lock_slot(id).disarm_and_release())
        })
    }

    fn axis_has_verb(&self, id: u16, verb: &str) -> bool {
        let info = &self.bench.axes[usize::from(id)];
        info.verbs.iter().any(|known| known.verb == verb)
    }
}

fn axis_identity(bench: &BenchView, axis: &AxisInfo) -> Option<(String, u32, String)> {
    let link = bench.links.iter().find(|link| link.id == axis.link)?;
    Some((link.url.clone(), axis.number, axis.profile.clone()))
}

fn late_standstill() -> GatewayError {
    GatewayError {
        executed: None,
        ..GatewayError::new("E101", "standstill of a motor was not confirmed in time")
    }
}

impl LeaseGuard {
    /// Acquires the lease and arms the axis.
    ///
    /// # Errors
    /// As [`AxisControl::arm`](crate::interface::AxisControl::arm).
    pub fn arm(&self) -> Result<(), Error> {
        Ok(self.acquire_and_arm()?)
    }

    /// Disarms the axis and releases its lease.
    ///
    /// # Errors
    /// [`Error::Gateway`] if the gateway does not answer.
    pub fn disarm(&self) -> Result<(), Error> {
        Ok(self.disarm_and_release()?)
    }

    /// The lease that this program holds, or a new one, for a write.
    fn borrow_lease(&self) -> Result<Arc<Lease>, GatewayError> {
        let held = self.server.slot(self.axis).lease.clone();
        // The program that armed the axis learns that the lease was taken away.
        let is_armed = self.server.armed_lease(self.axis).is_some();
        let lease = match held {
            Some(lease) if is_armed => lease.check().map(|()| lease)?,
            Some(lease) if lease.check().is_ok() => lease,
            _ => Arc::new(self.server.live_connection()?.acquire_lease(self.axis)?),
        };
        let mut state = self.server.slot(self.axis);
        state.lease = Some(Arc::clone(&lease));
        state.users += 1;
        Ok(lease)
    }

    /// Acquires the lease and arms the axis. If that fails for an axis that was armed here before, it stays marked as
    /// armed: its program gets the error, and stops no other client's motion.
    pub(super) fn acquire_and_arm(&self) -> Result<(), GatewayError> {
        let held = self.server.slot(self.axis).lease.clone();
        let held = held.filter(|lease| lease.check().is_ok());
        if held.is_some() && self.server.armed_lease(self.axis).is_some() {
            let label = &self.server.bench.axes[usize::from(self.axis)].label;
            let what = format!("{label}: it is already armed");
            return Err(GatewayError::new("E220", what).hint(crate::axis::ALREADY_ARMED_HINT));
        }
        let lease = match &held {
            Some(lease) => Arc::clone(lease),
            None => Arc::new(self.server.live_connection()?.acquire_lease(self.axis)?),
        };
        if let Err(error) = lease.run("arm", CommandArguments::default(), REPLY_MAX) {
            if held.is_none() {
                // If that fails, the lease is not renewed and ends.
                let _ = lease.release();
            }
            return Err(error);
        }
        let mut state = self.server.slot(self.axis);
        state.lease = Some(lease);
        state.armed = true;
        Ok(())
    }

    /// Disarms the axis and releases its lease.
    pub(super) fn disarm_and_release(&self) -> Result<(), GatewayError> {
        let mut state = self.server.slot(self.axis);
        if !std::mem::take(&mut state.armed) {
            return Ok(());
        }
        let used = state.lease.clone().filter(|_| state.users > 0);
        drop(state);
        match used.filter(|lease| lease.check().is_ok()) {
            // A write uses the lease, and releases it at its end.
            Some(lease) => lease.run("disarm", CommandArguments::default(), REPLY_MAX),
            None => self.release_lease(),
        }
    }

    /// Releases a lease that is not used any more. One that has ended already is no error.
    fn release_lease(&self) -> Result<(), GatewayError> {
        let mut state = self.server.slot(self.axis);
        if state.armed || state.users > 0 {
            return Ok(());
        }
        let lease = state.lease.take();
        drop(state);
        let released = lease.map_or(Ok(()), |lease| lease.release());
        released.or_else(|error| if error.code == "gateway.lease" { Ok(()) } else { Err(error) })
    }
}

impl Drop for LeaseGuard {
    fn drop(&mut self) {
        self.server.slot(self.axis).locked = false;
        self.server.slots[usize::from(self.axis)].1.notify_all();
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
