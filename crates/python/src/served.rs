//! A running server as a link: the same methods as [`ServedLink`](crate::link::ServedLink), asked of a gateway.
//!
//! ```text
//!   ServedLink            one gateway, what it has, the leases that are held through it
//!    └ ServedAxis         the same methods as a local axis; motion needs its lease
//!       ├ ServedRequest   a command or a question under way
//!       └ ServedWatch     signals as they come
//! ```
//!
//! Why: PY-6.

mod axis;
mod request;
mod watch;

use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use polepair_client::message::{AxisInfo, BenchView, CommandArguments, ParameterInfo, StopRequest};
use polepair_client::{Gateway, GatewayError, GatewayOptions, Lease, LiveConnection, select_axes};
use pyo3::prelude::*;

pub use axis::ServedAxis;
pub use request::{ServedAmount, ServedRead, ServedRequest};
pub use watch::ServedWatch;

use crate::errors::{refused_to_py_error, usage_error};
use crate::process_local::ProcessLocal;
use request::wait_end;

/// What a verb may take that is over when the drive has answered.
const ANSWER_MAX: Duration = Duration::from_secs(10);
/// How long a server says a stop again before it tells that it is owed.
const STOP_MAX: Duration = Duration::from_secs(12);

/// A server that was joined.
#[pyclass(frozen, name = "ServedLink", module = "polepair._polepair")]
#[derive(Debug)]
pub struct ServedLink(ProcessLocal<Arc<RemoteServer>>);

/// What the axes of a server have in common.
#[derive(Debug)]
struct RemoteServer {
    gateway: Gateway,
    bench: BenchView,
    /// Of each axis, once somebody asked for them.
    parameters: Vec<OnceLock<Vec<ParameterInfo>>>,
    /// Addresses that are parameters of an axis: the server reads and writes them by their text.
    addresses: Mutex<Vec<(u16, String)>>,
    /// There while something is held or watched; another one after the server was gone.
    live: Mutex<Option<LiveConnection>>,
    slots: Vec<(Mutex<AxisLeaseState>, Condvar)>,
}

/// Parameters of an axis have lower numbers, addresses this one and those above.
const FIRST_ADDRESS: u16 = 0x8000;

/// What this program has of an axis. A server gives one session one lease of an axis, whoever of its
/// threads asks: so they share it, and the last gives it back.
#[derive(Debug, Default)]
struct AxisLeaseState {
    lease: Option<Arc<Lease>>,
    armed: bool,
    /// Settings that are under way by the lease.
    users: usize,
    /// Somebody has a [`SlotGuard`].
    locked: bool,
}

/// The right to take, arm and give back an axis. The server is asked meanwhile, and whoever only looks,
/// or stops, does not wait for that.
#[derive(Debug)]
struct SlotGuard {
    server: Arc<RemoteServer>,
    axis: u16,
}

/// Joins a server.
#[pyfunction]
#[pyo3(signature = (url, token_file=None, certificate=None, client_cert=None, client_key=None))]
pub fn join(
    py: Python<'_>,
    url: String,
    token_file: Option<PathBuf>,
    certificate: Option<String>,
    client_cert: Option<PathBuf>,
    client_key: Option<PathBuf>,
) -> PyResult<ServedLink> {
    let options = GatewayOptions { url, token_file, certificate, client_cert, client_key };
    let gateway = py
        .detach(|| Gateway::new(&options))
        .map_err(|refused| refused_to_py_error(py, &refused))?;
    let bench = wait_end(py, gateway.spawn(Gateway::bench))?;
    Ok(ServedLink(Arc::new(RemoteServer::new(gateway, bench)).into()))
}

impl RemoteServer {
    fn new(gateway: Gateway, mut bench: BenchView) -> Self {
        if bench.links.len() > 1 {
            bench.axes.iter_mut().for_each(|axis| axis.label += &format!(" of link {}", axis.link));
        }
        let parameters = bench.axes.iter().map(|_| OnceLock::new()).collect();
        let slots = bench.axes.iter().map(|_| Default::default()).collect();
        let addresses = Mutex::default();
        Self { gateway, bench, parameters, addresses, live: Mutex::default(), slots }
    }

    /// The number of an address that was found on an axis before.
    fn find_address(&self, axis: u16, text: &str) -> Option<u16> {
        let known = lock(&self.addresses);
        let at = known.iter().position(|(of, address)| (*of, address.as_str()) == (axis, text))?;
        u16::try_from(at).ok()?.checked_add(FIRST_ADDRESS)
    }

    fn add_address(&self, axis: u16, text: String) -> Result<u16, GatewayError> {
        let mut known = lock(&self.addresses);
        let at = u16::try_from(known.len()).ok().and_then(|at| at.checked_add(FIRST_ADDRESS));
        let too_many = || GatewayError::new("E213", "too many parameters by number");
        let id = at.ok_or_else(too_many)?;
        known.push((axis, text));
        Ok(id)
    }

    /// The address that has that number.
    fn address(&self, id: u16) -> Option<String> {
        let at = id.checked_sub(FIRST_ADDRESS)?;
        lock(&self.addresses).get(usize::from(at)).map(|(_, text)| text.clone())
    }

    fn live_connection(&self) -> Result<LiveConnection, GatewayError> {
        let mut stored = lock(&self.live);
        if let Some(live) = stored.as_ref().filter(|live| live.check().is_ok()) {
            return Ok(live.clone());
        }
        let live = self.gateway.live()?;
        self.check_same_drives()?;
        *stored = Some(live.clone());
        Ok(live)
    }

    /// Refuses a server that was started again with other drives: an axis is known by its index.
    fn check_same_drives(&self) -> Result<(), GatewayError> {
        fn axis_identity(bench: &BenchView, axis: &AxisInfo) -> Option<(String, u32, String)> {
            let link = bench.links.iter().find(|link| link.id == axis.link)?;
            Some((link.url.clone(), axis.number, axis.profile.clone()))
        }
        let now = self.gateway.bench()?;
        let is_same = |axis: &AxisInfo| {
            let there = now.axes.iter().find(|there| there.id == axis.id);
            there
                .is_some_and(|there| axis_identity(&now, there) == axis_identity(&self.bench, axis))
        };
        match self.bench.axes.iter().find(|axis| !is_same(axis)) {
            None => Ok(()),
            Some(axis) => {
                let what = "the server was started again with other drives";
                let what = format!("{}: {what}", axis.label);
                Err(GatewayError::new("E313", what)
                    .hint("connect again, and look which axes there are"))
            }
        }
    }

    fn slot(&self, axis: u16) -> MutexGuard<'_, AxisLeaseState> {
        lock(&self.slots[usize::from(axis)].0)
    }

    /// The lease of an axis that is armed here, whether it is still ours or not.
    fn armed_lease(&self, axis: u16) -> Option<Arc<Lease>> {
        let lease_state = self.slot(axis);
        lease_state.lease.clone().filter(|_| lease_state.armed)
    }

    /// Waits at most so long until nobody else changes what is held of an axis.
    fn lock_slot_within(self: &Arc<Self>, axis: u16, within: Duration) -> Option<SlotGuard> {
        let changed = &self.slots[usize::from(axis)].1;
        let waited = changed.wait_timeout_while(self.slot(axis), within, |place| place.locked);
        let (mut place, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let change = || SlotGuard { server: Arc::clone(self), axis };
        (!std::mem::replace(&mut place.locked, true)).then(change)
    }

    /// The same, however long that takes.
    fn lock_slot(self: &Arc<Self>, axis: u16) -> SlotGuard {
        loop {
            if let Some(change) = self.lock_slot_within(axis, ANSWER_MAX) {
                return change;
            }
        }
    }

    /// Lends the lease of an axis: that which is held here, or one for so long.
    fn with_lease<T>(
        self: &Arc<Self>,
        axis: u16,
        what: impl FnOnce(&Lease) -> Result<T, GatewayError>,
    ) -> Result<T, GatewayError> {
        let lease = self.lock_slot(axis).borrow_lease()?;
        let done = what(&lease);
        drop(lease);
        let change = self.lock_slot(axis);
        self.slot(axis).users -= 1;
        // What was done was done, whoever has the axis by now.
        let _ = change.release_lease();
        done
    }

    /// Stops what is armed here, all at once, switches it off and gives it back; the first error, after
    /// every one was tried. What is ours no more was stopped by that.
    fn stop_armed(self: &Arc<Self>) -> Result<(), GatewayError> {
        let ids = self.bench.axes.iter().map(|axis| axis.id);
        let armed = ids.filter_map(|id| Some((id, self.armed_lease(id)?)));
        let armed: Vec<_> = armed.filter(|(_, lease)| lease.check().is_ok()).collect();
        let does = |id: u16, verb: &str| {
            let info = &self.bench.axes[usize::from(id)];
            info.verbs.iter().any(|known| known.verb == verb)
        };
        let begin = |(id, lease): &(u16, Arc<Lease>)| {
            does(*id, "stop").then(|| lease.start("stop", CommandArguments::default()))
        };
        let started: Vec<_> = armed.iter().map(begin).collect();
        let late = || GatewayError {
            executed: None,
            ..GatewayError::new("E101", "a motor was not seen to stand in time")
        };
        let stopped =
            started.into_iter().flatten().map(|result| result?.wait(STOP_MAX)?.ok_or_else(late));
        let stopped = stopped.fold(Ok(()), Result::and);
        armed.into_iter().fold(stopped, |ended, (id, lease)| {
            let off = match does(id, "disable") {
                true => lease.run("disable", CommandArguments::default(), ANSWER_MAX),
                false => Ok(()),
            };
            drop(lease);
            ended.and(off).and(self.lock_slot(id).disarm())
        })
    }

    fn parameters(&self, axis: u16) -> Result<&[ParameterInfo], GatewayError> {
        let cached = &self.parameters[usize::from(axis)];
        if let Some(parameters) = cached.get() {
            return Ok(parameters);
        }
        let read = self.gateway.parameters(axis)?;
        Ok(cached.get_or_init(|| read))
    }

    /// Stops axes, whoever commands them; the first error, after every one was tried.
    fn stop(gateway: &Gateway, axes: Vec<u16>) -> Result<(), GatewayError> {
        let request = StopRequest { axes: Some(axes), reason: String::new() };
        let stopped = gateway.stop(&request)?.axes;
        stopped.into_iter().find_map(|axis| axis.error).map_or(Ok(()), Err)
    }
}

impl SlotGuard {
    /// The lease that is held here, or a new one, for a setting.
    fn borrow_lease(&self) -> Result<Arc<Lease>, GatewayError> {
        let held = self.server.slot(self.axis).lease.clone();
        // Who has armed it is to hear that it was taken away.
        let of_arming = self.server.armed_lease(self.axis).is_some();
        let lease = match held {
            Some(lease) if of_arming => lease.check().map(|()| lease)?,
            Some(lease) if lease.check().is_ok() => lease,
            _ => Arc::new(self.server.live_connection()?.acquire_lease(self.axis)?),
        };
        let mut lease_state = self.server.slot(self.axis);
        lease_state.lease = Some(Arc::clone(&lease));
        lease_state.users += 1;
        Ok(lease)
    }

    /// Takes the axis and lets its motion through. What was armed here and taken away stays so where
    /// that fails: who armed it hears of it, and stops nobody else's motion.
    fn arm(&self) -> Result<(), GatewayError> {
        let held = self.server.slot(self.axis).lease.clone();
        let held = held.filter(|lease| lease.check().is_ok());
        if held.is_some() && self.server.armed_lease(self.axis).is_some() {
            let label = &self.server.bench.axes[usize::from(self.axis)].label;
            let hint =
                "move it in the block that armed it: the end of a second block would stop it";
            return Err(
                GatewayError::new("E220", format!("{label}: it is already armed")).hint(hint)
            );
        }
        let lease = match &held {
            Some(lease) => Arc::clone(lease),
            None => Arc::new(self.server.live_connection()?.acquire_lease(self.axis)?),
        };
        if let Err(why) = lease.run("arm", CommandArguments::default(), ANSWER_MAX) {
            if held.is_none() {
                // Where that cannot be said, it is renewed no more, and ends.
                let _ = lease.release();
            }
            return Err(why);
        }
        let mut lease_state = self.server.slot(self.axis);
        lease_state.lease = Some(lease);
        lease_state.armed = true;
        Ok(())
    }

    /// Lets motion through no longer, and gives the axis back.
    fn disarm(&self) -> Result<(), GatewayError> {
        let mut lease_state = self.server.slot(self.axis);
        if !std::mem::take(&mut lease_state.armed) {
            return Ok(());
        }
        let used = lease_state.lease.clone().filter(|_| lease_state.users > 0);
        drop(lease_state);
        match used.filter(|lease| lease.check().is_ok()) {
            // A setting is under way by it, and gives it back.
            Some(lease) => lease.run("disarm", CommandArguments::default(), ANSWER_MAX),
            None => self.release_lease(),
        }
    }

    /// Gives the lease back that nobody here uses any more. One that is ours no more is no error.
    fn release_lease(&self) -> Result<(), GatewayError> {
        let mut lease_state = self.server.slot(self.axis);
        if lease_state.armed || lease_state.users > 0 {
            return Ok(());
        }
        let lease = lease_state.lease.take();
        drop(lease_state);
        let given_back = lease.map_or(Ok(()), |lease| lease.release());
        given_back.or_else(|why| if why.code == "gateway.lease" { Ok(()) } else { Err(why) })
    }
}

impl Drop for SlotGuard {
    fn drop(&mut self) {
        self.server.slot(self.axis).locked = false;
        self.server.slots[usize::from(self.axis)].1.notify_all();
    }
}

fn lock<T>(what: &Mutex<T>) -> MutexGuard<'_, T> {
    what.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What only who opens a link has.
pub fn unsupported_error(py: Python<'_>, what: &str, hint: &str) -> PyErr {
    usage_error(py, "E257", &format!("{what} is nothing that a server does"), hint)
}

#[pymethods]
impl ServedLink {
    /// Where the server is.
    #[getter]
    fn url(&self) -> String {
        self.0.gateway.url().to_owned()
    }

    /// Every axis, in order.
    fn axes(&self, py: Python<'_>) -> PyResult<Vec<ServedAxis>> {
        let joined = self.0.in_own_process(py)?;
        Ok(joined.bench.axes.iter().map(|info| ServedAxis::new(joined, info.clone())).collect())
    }

    /// The axis of that number, if there is but one.
    fn axis(&self, py: Python<'_>, number: u32) -> PyResult<ServedAxis> {
        self.named(py, &number.to_string())
    }

    /// The axis of that name, or `LINK#NUMBER`.
    fn named(&self, py: Python<'_>, name: &str) -> PyResult<ServedAxis> {
        let joined = self.0.in_own_process(py)?;
        let mut found = select_axes(&joined.bench, name)
            .map_err(|refused| refused_to_py_error(py, &refused))?;
        match (found.pop(), found.len()) {
            (Some(info), 0) => Ok(ServedAxis::new(joined, info)),
            _ => Err(usage_error(py, "E212", &format!("{name:?} is not one axis"), "name one")),
        }
    }

    /// Stops every axis, whoever commands it; nothing is locked.
    fn stop_all(&self, py: Python<'_>) -> PyResult<()> {
        let joined = self.0.in_own_process(py)?;
        let axes = joined.bench.axes.iter().map(|axis| axis.id).collect();
        wait_end(py, joined.gateway.spawn(move |gateway| RemoteServer::stop(gateway, axes)))
    }

    /// Stops, disables and disarms what this program armed of it, and raises what went wrong.
    fn stop_armed(&self, py: Python<'_>) -> PyResult<()> {
        let joined = Arc::clone(self.0.in_own_process(py)?);
        py.detach(|| joined.stop_armed()).map_err(|refused| refused_to_py_error(py, &refused))
    }

    fn events(&self, py: Python<'_>) -> PyResult<()> {
        Err(unsupported_error(
            py,
            "listening to events",
            "watch signals, or ask `axis.state()` and `axis.faults()` again",
        ))
    }

    #[getter]
    fn simulation(&self, py: Python<'_>) -> PyResult<()> {
        let hint = "meddle with its simulated drives on its page, or open `sim:` in this program";
        Err(unsupported_error(py, "lending its simulation", hint))
    }

    fn losses(&self, py: Python<'_>) -> PyResult<()> {
        Err(unsupported_error(py, "telling a wire's losses", "its page counts what each link lost"))
    }

    fn trace(&self, py: Python<'_>) -> PyResult<()> {
        let hint = "its page shows frames, explained; or open the link in this program, trace=True";
        Err(unsupported_error(py, "lending its frames", hint))
    }
}
