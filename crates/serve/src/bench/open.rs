//! Opening: connection strings to links, wires and axes, in the order in which the bench counts them.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use polepair::simulate::Simulation;
use polepair::wire::OpenWire;
use polepair::{Axis, Connector};
use polepair_capture::{Decoder, Rules};
use polepair_core::drives;
use polepair_core::medium::MediumKind;

use super::Seat;
use super::clock::Clock;
use super::describe::axis_info;
use super::desk::Desk;
use super::frames::Traffic;
use super::look::Search;
use super::simulated::Drive;
use super::wire::Wire;
use crate::message::{Counter, LinkState, LinkView, Refused};

/// Axes of a bench.
pub(super) const AXES_MAX: usize = 256;

/// A link of the bench: one wire, whatever its connection string opens besides.
pub(super) struct Link {
    pub id: u16,
    pub url: String,
    pub wire: Arc<Wire>,
    pub desk: Arc<Desk>,
    pub open: OpenWire,
    /// Its simulation, and the link's number there.
    pub simulation: Option<(Simulation, usize)>,
    /// Looks for drives there.
    pub search: Arc<Search>,
    /// Keeps the link open.
    link: polepair::Link,
}

/// A bench that was opened.
pub(super) struct Opened {
    pub links: Vec<Link>,
    /// What each connection string opened, with the number of its first axis.
    pub roots: Vec<(u16, polepair::Link)>,
    pub axes: Vec<Seat>,
    pub clock: Clock,
}

/// Opens every connection string, or the rack that there is without any.
pub(super) fn open(
    urls: &[String],
    connector: &Connector,
    traffic: &Arc<Traffic>,
) -> Result<Opened, Refused> {
    let rack = rack();
    let urls = if urls.is_empty() { &rack } else { urls };
    let (mut links, mut axes, mut roots) = (Vec::new(), Vec::new(), Vec::new());
    for url in urls {
        let (first, ears) = (links.len(), Arc::clone(traffic));
        let tapped = connector.clone().with_taps(move |wire| ears.ear(first + wire));
        let opened = tapped.connect(url)?;
        let in_turn = wires(&opened).enumerate().all(|(n, of)| opened.wire_of(&of[0]) == Some(n));
        if !in_turn {
            let what = format!("{url} names no axis of a wire before one of which it does");
            let hint = "name an axis of each wire before it after `#`, or none";
            return Err(Refused::new("gateway.request", what).hint(hint));
        }
        let base = axes.len() as u16;
        take((url, connector), &opened, &mut links, &mut axes);
        roots.push((base, opened));
    }
    if axes.len() > AXES_MAX {
        let what = format!("{} axes are more than a bench holds, {AXES_MAX}", axes.len());
        return Err(Refused::new("gateway.request", what));
    }
    let clock = Clock::of(links.iter().filter_map(|link| Some(&link.simulation.as_ref()?.0)));
    let is_virtual = |link: &Link| match &link.simulation {
        Some((simulation, _)) => simulation.pace() == polepair::simulate::Pace::Virtual,
        None => false,
    };
    if !clock.is_real() && !links.iter().all(is_virtual) {
        let what = "some links are in virtual time, others are not";
        return Err(
            Refused::new("gateway.request", what).hint("say time=virtual on all, or on none")
        );
    }
    Ok(Opened { links, roots, axes, clock })
}

/// One drive of each family, on the wire that it usually has.
fn rack() -> Vec<String> {
    let mut families: Vec<&str> = Vec::new();
    let mut urls = Vec::new();
    for profile in drives::profiles() {
        if !families.contains(&profile.family) {
            families.push(profile.family);
            urls.push(format!("sim:{}", profile.name));
        }
    }
    urls
}

/// The axes of each wire that has any.
fn wires(opened: &polepair::Link) -> impl Iterator<Item = &[Axis]> {
    opened.axes().chunk_by(|one, other| one.connection().is(other.connection()))
}

/// The wires of an opened link, with their axes.
fn take(
    (url, connector): (&str, &Connector),
    opened: &polepair::Link,
    links: &mut Vec<Link>,
    seats: &mut Vec<Seat>,
) {
    let root = Arc::new(Mutex::new(opened.clone()));
    let own = own_links(opened.simulation());
    for (n, (axes, open)) in wires(opened).zip(opened.wires()).enumerate() {
        let id = links.len() as u16;
        let simulation = opened.simulation().cloned().zip(own.get(n).copied());
        let mut ids = Vec::new();
        for (place, axis) in axes.iter().enumerate() {
            let seat_id = seats.len() as u16;
            let drive = simulation.as_ref().and_then(|(simulation, link)| {
                Drive::find(simulation, *link, axis.number(), place)
            });
            let info = axis_info(seat_id, id, axis, drive.as_ref());
            seats.push(Seat { link: links.len(), place, info, drive });
            ids.push((seat_id, axis.clone()));
        }
        let wire = Arc::new(Wire::new(ids));
        let desk = Arc::new(Desk::new(&wire));
        let search = Arc::new(Search::new(id, connector.clone(), &root, n));
        let (url, open, link) = (url.to_owned(), open.clone(), opened.clone());
        links.push(Link { id, url, wire, desk, open, simulation, search, link });
    }
}

/// The links of a simulation that a host has an end of: what a relay brings it to is none.
fn own_links(simulation: Option<&Simulation>) -> Vec<usize> {
    let Some(simulation) = simulation else { return Vec::new() };
    let description = simulation.description();
    (0..simulation.links()).filter(|n| description.relay_to(*n).is_none()).collect()
}

impl Link {
    /// Its first axis, which stands for the wire.
    fn axis(&self) -> Option<&Axis> {
        self.wire.axes.first().map(|(_, axis)| axis)
    }

    /// What explains its frames.
    pub fn decoder(&self) -> Decoder {
        let axes = self.wire.axes.iter().map(|(_, axis)| axis);
        let several = axes.filter(|_| self.open.protocols.len() > 1);
        let stated = several.map(|axis| format!("{}@{}", axis.protocol(), axis.number()));
        let all = self.open.protocols.iter().map(|word| (*word).to_owned());
        let rules = stated.chain(all).collect::<Vec<_>>().join(",");
        let profile = self.axis().map(Axis::profile);
        Decoder::new(Rules::parse(&rules).unwrap_or_default()).with_profile(profile)
    }

    /// The share of the time so far in which it was busy, where that is known.
    pub fn load(&self) -> Option<f64> {
        let (simulation, link) = self.simulation.as_ref()?;
        simulation.load(*link).map(|(_, load)| load)
    }

    /// All but whether it works.
    pub fn told(&self) -> LinkView {
        let medium = match self.open.medium {
            MediumKind::Serial => "serial",
            MediumKind::Can => "can",
        };
        LinkView {
            id: self.id,
            url: self.url.clone(),
            medium: medium.to_owned(),
            simulated: self.simulation.is_some(),
            state: LinkState::Open,
            reason: None,
            load: None,
            counters: self.axis().map_or_else(Vec::new, |axis| self.counters(axis)),
        }
    }

    fn counters(&self, axis: &Axis) -> Vec<Counter> {
        let c = self.link.counters(axis);
        let counts = [
            ("sent", c.sent),
            ("received", c.answered),
            ("retries", c.resent),
            ("silent", c.silent),
            ("errors", c.corrupt + c.foreign + c.late),
            ("echoed", c.echoed),
            ("skipped", c.skipped),
        ];
        counts.map(|(name, count)| Counter { name: name.to_owned(), count }).into()
    }
}

/// How many times faster than real motors the simulated ones live.
pub(super) fn time_scale(links: &[Link]) -> Option<f64> {
    let mut simulations = links.iter().filter_map(|link| link.simulation.as_ref());
    simulations.next().map(|(simulation, _)| simulation.scale())
}

/// Sets it, for all of them.
pub(super) fn set_time_scale(
    links: &[Link],
    scale: f64,
) -> impl FnOnce() -> Result<(), Refused> + Send + 'static {
    let simulations = links.iter().filter_map(|link| Some(link.simulation.as_ref()?.0.clone()));
    let simulations: Vec<Simulation> = simulations.collect();
    move || Ok(simulations.iter().try_for_each(|simulation| simulation.set_scale(scale))?)
}

/// Lets virtual time pass, once for each simulation: links of one share its world.
pub(super) fn pass(links: &[Link], span: Duration) {
    for (simulation, n) in links.iter().filter_map(|link| link.simulation.as_ref()) {
        if own_links(Some(simulation)).first() == Some(n) {
            simulation.pass(span);
        }
    }
}
