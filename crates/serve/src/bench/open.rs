//! Opens connection strings as links, wires and axes, in the order of their numbers.

use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use polepair::connect::LinkPart;
use polepair::simulate::Simulation;
use polepair::wire::OpenWire;
use polepair::{Connector, Error, LocalAxis};
use polepair_capture::{CaptureDecoder, Rules};
use polepair_core::medium::MediumKind;
use polepair_core::proto::drive_address;
use polepair_link::Cause;

use super::clock::BenchClock;
use super::describe::axis_info;
use super::frames::FrameTraffic;
use super::link_scan::LinkScan;
use super::lock::lock_unpoisoned;
use super::request_worker::RequestWorker;
use super::simulated_drive::SimulatedDrive;
use super::thread_error::thread_error;
use super::wire::BenchWire;
use super::{AXES_MAX, AxisEntry};
use crate::message::{AbsentAxis, GatewayError, LinkCounter, LinkState, LinkView};

/// A link of the bench: one wire, whatever its connection string opens besides.
pub(super) struct BenchLink {
    pub id: u16,
    pub url: String,
    pub wire: Arc<BenchWire>,
    pub request_worker: Arc<RequestWorker>,
    /// Looks for drives there.
    pub scan: Arc<LinkScan>,
    medium: MediumKind,
    opened: OnceLock<OpenedLink>,
    /// Axes that were not there when it was opened.
    absent: Mutex<Vec<AbsentAxis>>,
}

/// State of an opened link.
struct OpenedLink {
    wire: OpenWire,
    /// Simulation, and the link's number in it.
    simulation: Option<(Simulation, usize)>,
    /// Keeps the link open.
    link: polepair::LocalLink,
}

/// A bench that was opened.
pub(super) struct OpenedBench {
    pub links: Vec<BenchLink>,
    /// Opened link of each connection string, with the number of its first axis.
    pub roots: Vec<(u16, polepair::LocalLink)>,
    pub axes: Vec<AxisEntry>,
    pub clock: BenchClock,
    /// Links that could not be opened, and why.
    pub failed: Vec<(u16, GatewayError)>,
}

/// Opens the links of the connection strings, or the default rack without any. A fault in a
/// string ends it before anything is opened. A link that cannot be opened is kept in its place, unless
/// none can and none will by itself.
pub(super) fn open_links(
    urls: &[String],
    connector: &Connector,
    traffic: &Arc<FrameTraffic>,
) -> Result<OpenedBench, GatewayError> {
    let rack = rack();
    let urls = if urls.is_empty() { &rack } else { urls };
    let mut parts: Vec<LinkPart> = Vec::new();
    for url in urls {
        parts.extend(connector.parts(url)?);
    }
    let tried = open_parts(&parts, connector, traffic)?;
    let failed = || tried.iter().filter_map(|tried| tried.as_ref().err());
    if failed().count() == tried.len()
        && !failed().any(is_transient)
        && let Some(error) = failed().next()
    {
        return Err(error.clone().into());
    }
    let (mut links, mut axes) = (Vec::new(), Vec::new());
    let (mut roots, mut dead) = (Vec::new(), Vec::new());
    for (part, tried) in parts.iter().zip(tried) {
        let id = links.len() as u16;
        match tried {
            Ok((opened, absent)) => {
                roots.push((axes.len() as u16, opened.clone()));
                add_wires(&part.url, connector, &opened, &mut links, &mut axes);
                links[usize::from(id)].set_absent(absent);
            }
            Err(error) => {
                let medium = part.medium.unwrap_or(MediumKind::Serial);
                links.push(BenchLink::new(id, &part.url, medium, connector, Vec::new()));
                dead.push((id, error.into()));
            }
        }
    }
    if axes.len() > AXES_MAX {
        let what = format!("{} axes are more than a bench holds, {AXES_MAX}", axes.len());
        return Err(GatewayError::new("gateway.request", what));
    }
    let clock =
        BenchClock::from_simulations(links.iter().filter_map(|link| Some(&link.simulation()?.0)));
    if !clock.is_real() && !links.iter().all(is_virtual_link) {
        let what = "some links are in virtual time, others are not";
        return Err(GatewayError::new("gateway.request", what).hint(
            "use time=virtual on all links, or on \
             none",
        ));
    }
    Ok(OpenedBench { links, roots, axes, clock, failed: dead })
}

fn is_virtual_link(link: &BenchLink) -> bool {
    match link.simulation() {
        Some((simulation, _)) => simulation.pace() == polepair::simulate::SimulationPace::Virtual,
        None => false,
    }
}

/// A link with those of its axes that are there, and the others.
type PresentLink = (polepair::LocalLink, Vec<(u32, Error)>);

/// Opens simulations one after the other, because their names depend on the order; and then all else at once, so that
/// a host that does not answer keeps no motor of another from being stopped.
fn open_parts(
    parts: &[LinkPart],
    connector: &Connector,
    traffic: &Arc<FrameTraffic>,
) -> Result<Vec<Result<PresentLink, Error>>, GatewayError> {
    let (mut count, mut firsts, mut simulated) = (0, Vec::new(), Vec::new());
    for part in parts {
        firsts.push(count);
        if part.medium.is_some() {
            count += 1;
            simulated.push(None);
            continue;
        }
        let opened = tapped_connector(connector, traffic, count).connect_local(&part.url)?;
        let in_turn =
            axes_by_wire(&opened).enumerate().all(|(n, of)| opened.wire_index(&of[0]) == Some(n));
        if !in_turn {
            let what = format!("{} names no axis of a wire before one of which it does", part.url);
            let hint = "name an axis of each wire before it after `#`, or none";
            return Err(GatewayError::new("gateway.request", what).hint(hint));
        }
        count += axes_by_wire(&opened).count();
        simulated.push(Some(opened));
    }
    std::thread::scope(|scope| {
        let opening = parts.iter().zip(firsts).zip(simulated).map(|((part, first), simulated)| {
            std::thread::Builder::new().spawn_scoped(scope, move || match simulated {
                Some(opened) => Ok((opened, Vec::new())),
                None => tapped_connector(connector, traffic, first).connect_present(&part.url),
            })
        });
        let opening: Vec<_> = opening.collect::<Result<_, _>>().map_err(|e| thread_error(&e))?;
        let tried = opening.into_iter().map(|opening| match opening.join() {
            // Contradictions in the options are reported before anything is served.
            Ok(Err(error)) if is_usage_error(&error) => Err(error.into()),
            Ok(tried) => Ok(tried),
            Err(panic) => std::panic::resume_unwind(panic),
        });
        tried.collect()
    })
}

/// A connector whose taps are those of the bench's links from that one on.
pub(super) fn tapped_connector(
    connector: &Connector,
    traffic: &Arc<FrameTraffic>,
    first: usize,
) -> Connector {
    let frame_traffic = Arc::clone(traffic);
    connector.clone().with_taps(move |wire| frame_traffic.tap(first + wire))
}

/// Returns whether it is the caller's mistake, whatever becomes of ports and drives.
pub(super) const fn is_usage_error(error: &Error) -> bool {
    matches!(error, Error::Usage { .. } | Error::Unsupported { .. } | Error::Interrupted { .. })
}

/// Returns whether a link that could not be opened may be there later, without anybody changing a file or a connection
/// string.
fn is_transient(error: &Error) -> bool {
    match error {
        Error::Link(error) => error.cause() != Cause::Unsuitable,
        Error::Failed { .. } => true,
        _ => false,
    }
}

/// One drive of each family, on the wire that it usually has.
fn rack() -> Vec<String> {
    let mut families: Vec<&str> = Vec::new();
    let mut urls = Vec::new();
    for profile in polepair_drives::profiles() {
        if !families.contains(&profile.family) {
            families.push(profile.family);
            urls.push(format!("sim:{}", profile.name));
        }
    }
    urls
}

/// The axes of each wire that has any.
fn axes_by_wire(opened: &polepair::LocalLink) -> impl Iterator<Item = &[LocalAxis]> {
    opened.axes().chunk_by(|one, other| one.connection().is_same(other.connection()))
}

/// The wires of an opened link, with their axes.
fn add_wires(
    url: &str,
    connector: &Connector,
    opened: &polepair::LocalLink,
    links: &mut Vec<BenchLink>,
    seats: &mut Vec<AxisEntry>,
) {
    let root = Arc::new(Mutex::new(opened.clone()));
    let own = own_links(opened.simulation());
    for (n, (axes, open)) in axes_by_wire(opened).zip(opened.wires()).enumerate() {
        let id = links.len() as u16;
        let simulation = opened.simulation().cloned().zip(own.get(n).copied());
        let mut ids = Vec::new();
        for (index, axis) in axes.iter().enumerate() {
            let seat_id = seats.len() as u16;
            let drive = simulation.as_ref().and_then(|(simulation, link)| {
                SimulatedDrive::find(simulation, *link, axis.number(), index)
            });
            let info = axis_info(seat_id, id, axis, drive.as_ref());
            seats.push(AxisEntry { link: links.len(), local_index: index, info, drive });
            ids.push((seat_id, axis.clone()));
        }
        let link = BenchLink::new(id, url, open.medium, connector, ids);
        link.scan.set_opened(&root, n);
        link.set_opened(OpenedLink { wire: open.clone(), simulation, link: opened.clone() });
        links.push(link);
    }
}

/// The links of a simulation that a host has an end of: what a relay brings it to is none.
fn own_links(simulation: Option<&Simulation>) -> Vec<usize> {
    let Some(simulation) = simulation else { return Vec::new() };
    let description = simulation.description();
    (0..simulation.links()).filter(|n| description.relay_link(*n).is_none()).collect()
}

impl BenchLink {
    fn new(
        id: u16,
        url: &str,
        medium: MediumKind,
        connector: &Connector,
        axes: Vec<(u16, LocalAxis)>,
    ) -> Self {
        let wire = Arc::new(BenchWire::new(axes));
        let request_worker = Arc::new(RequestWorker::new(&wire));
        let scan = Arc::new(LinkScan::new(id, connector.clone()));
        let (opened, absent) = (OnceLock::new(), Mutex::default());
        Self { id, url: url.to_owned(), wire, request_worker, scan, medium, opened, absent }
    }

    /// Returns whether the drive of that number is one of its axes.
    pub fn has_axis(&self, number: u32) -> bool {
        self.wire.axes.iter().any(|(_, axis)| axis.number() == number)
    }

    fn set_opened(&self, opened: OpenedLink) {
        // A link is opened once.
        let _ = self.opened.set(opened);
    }

    fn set_absent(&self, absent: Vec<(u32, Error)>) {
        *lock_unpoisoned(&self.absent) = absent
            .into_iter()
            .map(|(number, error)| AbsentAxis { number, error: error.into() })
            .collect();
    }

    /// Absent axes of the link.
    pub fn absent(&self) -> Vec<AbsentAxis> {
        lock_unpoisoned(&self.absent).clone()
    }

    /// One of them is there.
    pub fn remove_absent(&self, number: u32) {
        lock_unpoisoned(&self.absent).retain(|axis| axis.number != number);
    }

    /// Sets a link that was opened later, as one wire. Its axes join later.
    pub fn set_opened_later(&self, opened: &polepair::LocalLink, absent: Vec<(u32, Error)>) {
        self.scan.set_opened(&Arc::new(Mutex::new(opened.clone())), 0);
        self.set_absent(absent);
        if let Some(open) = opened.wires().first() {
            self.set_opened(OpenedLink {
                wire: open.clone(),
                simulation: None,
                link: opened.clone(),
            });
        }
    }

    /// Returns whether it was opened, however it is now.
    pub fn was_opened(&self) -> bool {
        self.opened.get().is_some()
    }

    /// Simulation, and the link's number in it.
    pub fn simulation(&self) -> Option<&(Simulation, usize)> {
        self.opened.get()?.simulation.as_ref()
    }

    /// First axis, for properties of the wire.
    fn first_axis(&self) -> Option<&LocalAxis> {
        self.wire.axes.first().map(|(_, axis)| axis)
    }

    /// Decoder of its frames.
    pub fn decoder(&self) -> CaptureDecoder {
        let axes = self.wire.axes.iter().map(|(_, axis)| axis);
        let protocols = self.opened.get().map_or(&[][..], |opened| &opened.wire.protocols);
        let several = axes.filter(|_| protocols.len() > 1);
        let stated = several.map(|axis| format!("{}@{}", axis.protocol(), axis.number()));
        let all = protocols.iter().map(|word| (*word).to_owned());
        let rules: Vec<String> = stated.chain(all).collect();
        let rules = Rules::for_protocols(rules.iter().map(String::as_str));
        let axes = self.wire.axes.iter().map(|(_, axis)| axis);
        let drives = axes.map(|axis| (drive_address(axis.number()), axis.profile())).collect();
        CaptureDecoder::new(rules).with_drive_profiles(drives)
    }

    /// The share of the time so far in which it was busy, where that is known.
    pub fn load(&self) -> Option<f64> {
        let (simulation, link) = self.simulation()?;
        simulation.load(*link).map(|(_, load)| load)
    }

    /// All but the debts of the server before.
    pub fn view(&self) -> LinkView {
        let medium = match self.medium {
            MediumKind::Serial => "serial",
            MediumKind::Can => "can",
        };
        let lost = self.wire.link_error();
        LinkView {
            id: self.id,
            url: self.url.clone(),
            medium: medium.to_owned(),
            simulated: self.simulation().is_some(),
            state: match &lost {
                None => LinkState::Open,
                Some(_) if self.was_opened() => LinkState::Lost,
                Some(_) => LinkState::NotOpen,
            },
            since_ms: lost.as_ref().map(|(since, _)| BenchClock::wall_ms(*since)),
            error: lost.map(|(_, error)| error),
            absent: self.absent(),
            pending_stops: Vec::new(),
            load: self.load(),
            counters: self.counters(),
        }
    }

    fn counters(&self) -> Vec<LinkCounter> {
        let (Some(axis), Some(opened)) = (self.first_axis(), self.opened.get()) else {
            return Vec::new();
        };
        let c = opened.link.counters(axis);
        let counts = [
            ("sent", c.sent),
            ("received", c.answered),
            ("retries", c.resent),
            ("silent", c.silent),
            ("errors", c.corrupt + c.foreign + c.late),
            ("echoed", c.echoed),
            ("skipped", c.skipped),
        ];
        counts.map(|(name, count)| LinkCounter { name: name.to_owned(), count }).into()
    }
}

/// Number of times faster than real motors the simulated ones live.
pub(super) fn time_scale(links: &[BenchLink]) -> Option<f64> {
    let mut simulations = links.iter().filter_map(BenchLink::simulation);
    simulations.next().map(|(simulation, _)| simulation.scale())
}

/// Sets it, for all of them.
pub(super) fn set_time_scale(
    links: &[BenchLink],
    scale: f64,
) -> impl FnOnce() -> Result<(), GatewayError> + Send + 'static {
    let simulations = links.iter().filter_map(|link| Some(link.simulation()?.0.clone()));
    let simulations: Vec<Simulation> = simulations.collect();
    move || Ok(simulations.iter().try_for_each(|simulation| simulation.set_scale(scale))?)
}

/// Lets virtual time pass, once for each simulation: links of one share its world.
pub(super) fn advance_time(links: &[BenchLink], span: Duration) {
    for (simulation, n) in links.iter().filter_map(BenchLink::simulation) {
        if own_links(Some(simulation)).first() == Some(n) {
            simulation.advance(span);
        }
    }
}
