//! A running server as a link: the same methods as [`Link`](crate::link::Link), asked of a gateway.
//!
//! ```text
//!   Link            one gateway, what it has, the leases that are held through it
//!    └ Axis         the same methods as a local axis; motion needs its lease
//!       ├ Request   a command or a question under way
//!       └ Watch     signals as they come
//! ```

mod axis;
mod request;
mod watch;

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use polepair_client::message::{Arguments, BenchView, ParameterInfo, StopOrder};
use polepair_client::{Gateway, Lease, Live, Options, Refused, pick};
use pyo3::prelude::*;

pub use axis::Axis;
pub use request::{Amount, Read, Request};
pub use watch::Watch;

use crate::errors::{told, usage};
use crate::outside::Outside;

/// What a verb may take that is over when the drive has answered.
const ANSWER_MAX: Duration = Duration::from_secs(10);

/// A server that was joined.
#[pyclass(frozen, name = "ServedLink", module = "polepair._polepair")]
#[derive(Debug)]
pub struct Link(Outside<Arc<Joined>>);

/// What the axes of a server have in common.
#[derive(Debug)]
struct Joined {
    gateway: Gateway,
    bench: BenchView,
    /// Of each axis, once somebody asked for them.
    parameters: Vec<OnceLock<Vec<ParameterInfo>>>,
    /// There while something is held or watched; another one after the server was gone.
    live: Mutex<Option<Live>>,
    places: Vec<Mutex<Place>>,
}

/// What this program has of an axis. A server gives one session one lease of an axis, whoever of its
/// threads asks: so they share it, and the last gives it back.
#[derive(Debug, Default)]
struct Place {
    lease: Option<Arc<Lease>>,
    armed: bool,
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
) -> PyResult<Link> {
    let options = Options { url, token_file, certificate, client_cert, client_key };
    let joined = py.detach(|| Joined::new(&options));
    Ok(Link(Arc::new(joined.map_err(|refused| told(py, &refused))?).into()))
}

impl Joined {
    fn new(options: &Options) -> Result<Self, Refused> {
        let gateway = Gateway::new(options)?;
        let mut bench = gateway.bench()?;
        if bench.links.len() > 1 {
            bench.axes.iter_mut().for_each(|axis| axis.label += &format!(" of link {}", axis.link));
        }
        let parameters = bench.axes.iter().map(|_| OnceLock::new()).collect();
        let places = bench.axes.iter().map(|_| Mutex::default()).collect();
        Ok(Self { gateway, bench, parameters, live: Mutex::default(), places })
    }

    fn live(&self) -> Result<Live, Refused> {
        let mut kept = locked(&self.live);
        if let Some(live) = kept.as_ref().filter(|live| live.check().is_ok()) {
            return Ok(live.clone());
        }
        let live = self.gateway.live()?;
        *kept = Some(live.clone());
        Ok(live)
    }

    fn place(&self, axis: u16) -> MutexGuard<'_, Place> {
        locked(&self.places[usize::from(axis)])
    }

    /// The lease of an axis that is armed here, whether it is still ours or not.
    fn armed(&self, axis: u16) -> Option<Arc<Lease>> {
        let place = self.place(axis);
        place.lease.clone().filter(|_| place.armed)
    }

    /// Lends the lease of an axis: that which is held here, or one for so long.
    fn with_lease<T>(
        &self,
        axis: u16,
        what: impl FnOnce(&Lease) -> Result<T, Refused>,
    ) -> Result<T, Refused> {
        let lease = self.take(&mut self.place(axis), axis)?;
        let done = what(&lease);
        drop(lease);
        let given_back = self.give_back(&mut self.place(axis));
        done.and_then(|done| given_back.map(|()| done))
    }

    fn take(&self, place: &mut Place, axis: u16) -> Result<Arc<Lease>, Refused> {
        if let Some(lease) = &place.lease {
            match lease.check() {
                Ok(()) => return Ok(Arc::clone(lease)),
                // Who has armed it is to hear that it was taken away.
                Err(why) if place.armed => return Err(why),
                Err(_) => {}
            }
        }
        let lease = Arc::new(self.live()?.take(axis)?);
        place.lease = Some(Arc::clone(&lease));
        Ok(lease)
    }

    /// Gives the lease back that nobody here uses any more.
    fn give_back(&self, place: &mut Place) -> Result<(), Refused> {
        let unused = |lease: &Arc<Lease>| !place.armed && Arc::strong_count(lease) == 1;
        if !place.lease.as_ref().is_some_and(unused) {
            return Ok(());
        }
        place.lease.take().map_or(Ok(()), |lease| lease.give_back())
    }

    /// Takes an axis and lets its motion through.
    fn arm(&self, axis: u16) -> Result<(), Refused> {
        let mut place = self.place(axis);
        let is_ours = place.lease.as_ref().is_some_and(|lease| lease.check().is_ok());
        if place.armed && is_ours {
            return Ok(());
        }
        place.armed = false;
        let lease = self.take(&mut place, axis)?;
        let armed = lease.run("arm", Arguments::default(), ANSWER_MAX);
        drop(lease);
        place.armed = armed.is_ok();
        armed.or_else(|why| self.give_back(&mut place).and(Err(why)))
    }

    /// Lets motion through no longer, and gives the axis back.
    fn disarm(&self, axis: u16) -> Result<(), Refused> {
        let mut place = self.place(axis);
        if !std::mem::take(&mut place.armed) {
            return Ok(());
        }
        if let Some(lease) = place.lease.clone() {
            lease.check()?;
            if Arc::strong_count(&lease) > 2 {
                // A setting is under way by it, and gives it back.
                return lease.run("disarm", Arguments::default(), ANSWER_MAX);
            }
        }
        self.give_back(&mut place)
    }

    fn parameters(&self, axis: u16) -> Result<&[ParameterInfo], Refused> {
        let kept = &self.parameters[usize::from(axis)];
        if let Some(parameters) = kept.get() {
            return Ok(parameters);
        }
        let asked = self.gateway.parameters(axis)?;
        Ok(kept.get_or_init(|| asked))
    }

    /// Stops axes, whoever commands them; the first error, after every one was tried.
    fn stop(gateway: &Gateway, axes: Vec<u16>) -> Result<(), Refused> {
        let order = StopOrder { axes: Some(axes), reason: String::new() };
        let stopped = gateway.stop(&order)?.axes;
        stopped.into_iter().find_map(|axis| axis.error).map_or(Ok(()), Err)
    }
}

fn locked<T>(what: &Mutex<T>) -> MutexGuard<'_, T> {
    what.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What only who opens a link has.
pub fn cannot(py: Python<'_>, what: &str, hint: &str) -> PyErr {
    usage(py, "E257", &format!("{what} is nothing that a server does"), hint)
}

#[pymethods]
impl Link {
    /// Where the server is.
    #[getter]
    fn url(&self) -> String {
        self.0.gateway.url().to_owned()
    }

    /// Every axis, in order.
    fn axes(&self, py: Python<'_>) -> PyResult<Vec<Axis>> {
        let joined = self.0.ours(py)?;
        Ok(joined.bench.axes.iter().map(|info| Axis::new(joined, info.clone())).collect())
    }

    /// The axis of that number, if there is but one.
    fn axis(&self, py: Python<'_>, number: u32) -> PyResult<Axis> {
        self.named(py, &number.to_string())
    }

    /// The axis of that name, or `LINK#NUMBER`.
    fn named(&self, py: Python<'_>, name: &str) -> PyResult<Axis> {
        let joined = self.0.ours(py)?;
        let mut found = pick(&joined.bench, name).map_err(|refused| told(py, &refused))?;
        match (found.pop(), found.len()) {
            (Some(info), 0) => Ok(Axis::new(joined, info)),
            _ => Err(usage(py, "E212", &format!("{name:?} is not one axis"), "name one")),
        }
    }

    /// Stops every axis, whoever commands it; nothing is locked.
    fn stop_all(&self, py: Python<'_>) -> PyResult<()> {
        let joined = self.0.ours(py)?;
        let axes = joined.bench.axes.iter().map(|axis| axis.id).collect();
        py.detach(|| Joined::stop(&joined.gateway, axes)).map_err(|refused| told(py, &refused))
    }

    fn events(&self, py: Python<'_>) -> PyResult<()> {
        Err(cannot(
            py,
            "listening to events",
            "watch signals, or ask `axis.state()` and `axis.faults()` again",
        ))
    }

    #[getter]
    fn simulation(&self, py: Python<'_>) -> PyResult<()> {
        let hint = "meddle with its simulated drives on its page, or open `sim:` in this program";
        Err(cannot(py, "lending its simulation", hint))
    }

    fn losses(&self, py: Python<'_>) -> PyResult<()> {
        Err(cannot(py, "telling a wire's losses", "its page counts what each link lost"))
    }

    fn trace(&self, py: Python<'_>) -> PyResult<()> {
        let hint = "its page shows frames, explained; or open the link in this program, trace=True";
        Err(cannot(py, "lending its frames", hint))
    }
}
