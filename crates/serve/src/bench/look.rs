//! Looking for drives on a wire that is open, and taking in those that were found. The eyes of the
//! wire look, one address in each of their rounds; its hand says whether it may begin.
//!
//! Why: GW-6, GW-7.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock};
use std::time::Duration;

use polepair::scan::{Found, Look, Numbers, Progress, Scan};
use polepair::{Axis, Connector};
use polepair_core::time::Instant;
use serde_json::json;
use tokio::sync::oneshot;

use super::clock::Clock;
use super::describe::axis_info;
use super::lease::Session;
use super::open::{AXES_MAX, Link};
use super::reply::Reply;
use super::shared::{Event, SERVER, Shared, held};
use super::simulated::Drive;
use super::wire::{Order, Wire};
use super::{Bench, Seat};
use crate::message::{
    AskedAxis, Deed, DriveAt, FoundDrive, LookOrder, LookState, LookView, Refused, TakeIn, TakenIn,
};

/// How often it is told how far a look is.
const TELL_EVERY: Duration = Duration::from_millis(100);

/// Whether somebody looks for drives on a wire; whoever stops something there ends that first.
#[derive(Default)]
pub(super) struct Looking {
    on: AtomicBool,
    broken: AtomicBool,
}

impl Looking {
    /// From now on: no axis of the wire is given to anybody until the end.
    pub fn begin(&self) {
        self.broken.store(false, Ordering::SeqCst);
        self.on.store(true, Ordering::SeqCst);
    }

    pub fn end(&self) {
        self.on.store(false, Ordering::SeqCst);
    }

    pub fn is_on(&self) -> bool {
        self.on.load(Ordering::SeqCst)
    }

    /// Ends it as soon as what was asked last is answered, or is not.
    pub fn break_off(&self) {
        self.broken.store(true, Ordering::SeqCst);
    }

    pub fn is_broken(&self) -> bool {
        self.broken.load(Ordering::SeqCst)
    }
}

/// What is known of looks on one wire.
pub(super) struct Search {
    link: u16,
    connector: Connector,
    /// What the connection string opened, with all that was taken in since, and which wire of that it
    /// is; nothing before it was opened.
    root: OnceLock<(Arc<Mutex<polepair::Link>>, usize)>,
    ordered: Mutex<Option<Numbers>>,
    /// The look under way, or the last.
    told: Mutex<Option<LookView>>,
    found: Mutex<Vec<Found>>,
}

impl Search {
    pub fn new(link: u16, connector: Connector) -> Self {
        let (ordered, told, found) = (Mutex::default(), Mutex::default(), Mutex::default());
        Self { link, connector, root: OnceLock::new(), ordered, told, found }
    }

    /// Its link is open: the wire of that place.
    pub fn opened(&self, root: &Arc<Mutex<polepair::Link>>, place: usize) {
        // Nobody opens a link twice.
        let _ = self.root.set((Arc::clone(root), place));
    }

    /// What the connection string opened, and which wire of that it is.
    pub fn root(&self) -> Result<(MutexGuard<'_, polepair::Link>, usize), Refused> {
        let (root, place) = self.root.get().ok_or_else(|| refused("the link is not open"))?;
        Ok((held(root), *place))
    }

    /// With which names and profiles drives are looked for.
    pub fn connector(&self) -> &Connector {
        &self.connector
    }

    /// The last look.
    pub fn told(&self) -> Option<LookView> {
        held(&self.told).clone()
    }

    /// Notes that somebody looks from now on, for the eyes to do it.
    fn begin(&self, shared: &Shared, session: &Session, numbers: Numbers) -> LookView {
        let view = LookView {
            link: self.link,
            by: session.to_string(),
            began_ms: Clock::ms(shared.now()),
            state: LookState::UnderWay,
            number: None,
            done: 0,
            of: 0,
            found: Vec::new(),
            axes: Vec::new(),
            tried: Vec::new(),
            unasked: 0,
            error: None,
        };
        held(&self.found).clear();
        let mut told = held(&self.told);
        *told = Some(view.clone());
        *held(&self.ordered) = Some(numbers);
        shared.tell(Event::Look(view.clone()));
        view
    }

    /// Changes what is told, and tells it: in this order, whoever else does.
    fn change(&self, shared: &Shared, change: impl FnOnce(&mut LookView)) {
        let mut told = held(&self.told);
        let Some(view) = told.as_mut() else { return };
        change(view);
        shared.tell(Event::Look(view.clone()));
    }
}

/// What looks on one wire.
pub(super) struct Searcher {
    search: Arc<Search>,
    wire: Arc<Wire>,
    shared: Arc<Shared>,
    look: Option<Look>,
    told: Instant,
}

impl Searcher {
    pub fn new(link: &Link, shared: &Arc<Shared>) -> Self {
        let (search, wire) = (Arc::clone(&link.search), Arc::clone(&link.wire));
        Self { search, wire, shared: Arc::clone(shared), look: None, told: Instant::ZERO }
    }

    /// Asks the next address. False when nobody looks for drives here.
    pub fn step(&mut self) -> bool {
        if !self.wire.looking.is_on() {
            return false;
        }
        let look = match self.look.take() {
            Some(look) => look,
            None => {
                let Some(numbers) = held(&self.search.ordered).take() else { return false };
                let root = self.search.root().map(|(root, place)| (root.clone(), place));
                let look = root.and_then(|(root, place)| {
                    Ok(Look::on(&self.search.connector, &root, place, numbers)?)
                });
                match look {
                    Ok(look) => look,
                    Err(error) => {
                        self.end(Scan::default(), Some(error));
                        return true;
                    }
                }
            }
        };
        self.go_on(look);
        true
    }

    fn go_on(&mut self, mut look: Look) {
        let (wire, shared) = (Arc::clone(&self.wire), Arc::clone(&self.shared));
        let broken = || wire.looking.is_broken() || shared.is_closing();
        if broken() {
            look.break_off();
        }
        let asked = look.next(&broken).and_then(|at| {
            let Some(at) = at else { return Ok(false) };
            self.tell(at);
            look.ask(&broken).map(|()| true)
        });
        match asked {
            Ok(true) => self.look = Some(look),
            Ok(false) => self.end(look.finish(), None),
            Err(error) => self.end(look.finish(), Some(error.into())),
        }
    }

    fn tell(&mut self, at: Progress) {
        let now = self.shared.now();
        if now.since(self.told) < TELL_EVERY {
            return;
        }
        self.told = now;
        self.search.change(&self.shared, |view| {
            view.number = Some(at.number);
            (view.done, view.of) = (at.done as u32, at.of as u32);
        });
    }

    fn end(&self, scan: Scan, error: Option<Refused>) {
        let broken = self.wire.looking.is_broken() || scan.unasked > 0;
        let state = match (&error, broken) {
            (Some(_), _) => LookState::Failed,
            (None, true) => LookState::BrokenOff,
            (None, false) => LookState::Done,
        };
        let found: Vec<FoundDrive> = scan.found.iter().map(|one| self.seen(one)).collect();
        let axes = self.search.root().map_or_else(|_| Vec::new(), |(root, _)| root.axes().to_vec());
        let asked = scan.axes.iter().filter_map(|one| {
            let axis = self.axis_of(axes.get(one.place)?)?;
            Some(AskedAxis { axis, answers: one.answers, clash: one.clash.clone() })
        });
        let asked: Vec<AskedAxis> = asked.collect();
        let silent: Vec<u16> = asked.iter().filter(|one| !one.answers).map(|o| o.axis).collect();
        let numbers: Vec<u32> = found.iter().map(|one| one.number).collect();
        let detail = json!({
            "link": self.search.link, "state": state, "found": numbers, "silent": silent,
        });
        *held(&self.search.found) = scan.found;
        // Who is told of the end may take an axis at once.
        self.wire.looking.end();
        self.shared.noted(&SERVER.into(), Deed::Look, None, detail);
        self.search.change(&self.shared, |view| {
            (view.state, view.number, view.error) = (state, None, error);
            view.done = view.of;
            (view.found, view.axes, view.tried) = (found, asked, scan.tried);
            view.unasked = scan.unasked as u32;
            // Before that is told: who hears it may look again.
            self.shared.looking.store(false, Ordering::SeqCst);
        });
    }

    fn seen(&self, found: &Found) -> FoundDrive {
        FoundDrive {
            number: found.number,
            protocol: found.protocol.to_owned(),
            profile: found.profile.name.to_owned(),
            drive: found.profile.title.to_owned(),
            known: found.identified.to_string(),
            clash: found.clash.clone(),
            axis: None,
        }
    }

    /// Which axis of the bench that is.
    fn axis_of(&self, axis: &Axis) -> Option<u16> {
        let same = |(_, known): &&(u16, Axis)| {
            known.number() == axis.number() && known.protocol() == axis.protocol()
        };
        self.wire.axes.iter().find(same).map(|(id, _)| *id)
    }
}

impl Bench {
    /// Looks for drives on a link, by reads only. It is told when it has begun; [`Event::Look`] tells
    /// how far it is, and its end.
    ///
    /// Refused with `gateway.look` while a look is under way on this bench, or an axis of the link is
    /// commanded, armed, powered, turning or being stopped.
    pub fn look(&self, link: u16, session: &Session, order: LookOrder) -> Reply<LookView> {
        let (tell, told) = oneshot::channel();
        let asked = self.link(link).and_then(|link| {
            let numbers = numbers(&order)?;
            let said = link.wire.announced()?;
            if self.0.shared.looking.swap(true, Ordering::SeqCst) {
                let what = "somebody looks for drives on this bench already";
                return Err(refused(what).hint("wait for its end, or break it off"));
            }
            let (search, wire) = (Arc::clone(&link.search), Arc::clone(&link.wire));
            let (shared, who) = (Arc::clone(&self.0.shared), session.clone());
            let begin = move |may: Result<(), Refused>| {
                let begun = may.map(|()| search.begin(&shared, &who, numbers));
                if begun.is_err() {
                    shared.looking.store(false, Ordering::SeqCst);
                }
                // Who has gone does not want to know.
                let _ = tell.send(begun);
            };
            let then = move |kept: Result<(), Refused>| match kept {
                Ok(()) => wire.order_announced(said, Order::Look(Box::new(begin))),
                Err(refused) => begin(Err(refused)),
            };
            let what = (session, Deed::Look, None);
            let detail = json!({ "link": link.id, "first": order.first, "last": order.last });
            self.0.shared.notes.announce(what, detail, self.0.shared.now(), Box::new(then));
            Ok(())
        });
        Reply::of(told, asked)
    }

    /// The look on a link that is under way, or the last.
    ///
    /// # Errors
    /// `gateway.missing` where there was none, or no such link.
    pub fn look_told(&self, link: u16) -> Result<LookView, Refused> {
        let nobody = || Refused::new("gateway.missing", "nobody looked for drives on this link");
        self.link(link)?.search.told().ok_or_else(nobody)
    }

    /// Breaks a look off: no address is asked after the one that is being asked.
    ///
    /// # Errors
    /// `gateway.missing` where nobody looks.
    pub fn break_look_off(&self, link: u16, session: &Session) -> Result<(), Refused> {
        let id = link;
        let link = self.link(id)?;
        if !link.wire.looking.is_on() {
            let what = "nobody looks for drives on this link now";
            return Err(Refused::new("gateway.missing", what));
        }
        link.wire.looking.break_off();
        let detail = json!({ "link": id, "broken_off": true });
        self.0.shared.noted(session, Deed::Look, None, detail);
        Ok(())
    }

    /// Makes axes of drives that the last look on a link found. What all other axes are doing goes on.
    ///
    /// The reply is `gateway.missing` for what was not found, `gateway.look` for a drive that clashes
    /// with another, while somebody looks, and where there is no room; else as
    /// [`polepair::Link::take_in`]. No drive is taken in then.
    pub fn take_in(&self, link: u16, session: &Session, take: &TakeIn) -> Reply<TakenIn> {
        let (n, bench) = (usize::from(link), self.clone());
        let found = self.link(link).and_then(|link| {
            if link.wire.looking.is_on() {
                return Err(refused("the look is under way still").hint("wait for its end"));
            }
            chosen(link, take)
        });
        let found = match found {
            Ok(found) if found.is_empty() => return Reply::ready(Ok(TakenIn { axes: Vec::new() })),
            Ok(found) => found,
            Err(refused) => return Reply::ready(Err(refused)),
        };
        let numbers: Vec<u32> = found.iter().map(|one| one.number).collect();
        let detail = json!({ "link": link, "drives": numbers });
        let (tell, told) = oneshot::channel();
        let (desk, who) = (Arc::clone(&self.0.links[n].desk), session.clone());
        // Limits may have to be asked of the drive: that is for the wire's desk.
        let then = move |kept: Result<(), Refused>| match kept {
            Ok(()) => desk.ask(tell, move || {
                let taken = bench.take_these(n, &found);
                let detail = match &taken {
                    Ok(taken) => json!({ "link": link, "axes": taken.axes }),
                    Err(refused) => json!({ "link": link, "error": refused }),
                };
                bench.0.shared.noted(&who, Deed::Outcome, None, detail);
                taken
            }),
            // Who has gone does not want to know.
            Err(refused) => drop(tell.send(Err(refused))),
        };
        let what = (session, Deed::TakeIn, None);
        self.0.shared.notes.announce(what, detail, self.0.shared.now(), Box::new(then));
        Reply::of(told, Ok(()))
    }

    /// Makes axes of drives that were found. At the wire's desk.
    pub(super) fn take_these(&self, n: usize, found: &[Found]) -> Result<TakenIn, Refused> {
        let link = &self.0.links[n];
        let _one_at_a_time = held(&self.0.growing);
        if link.wire.looking.is_on() {
            return Err(refused("somebody looks for drives there again").hint("wait for its end"));
        }
        if self.0.axes.len() + found.len() > AXES_MAX {
            return Err(refused(format!("a bench holds {AXES_MAX} axes")));
        }
        let (all, before) = {
            let (mut root, place) = link.search.root()?;
            let before = root.axes().len();
            *root = root.take_in(place, found)?;
            (root.clone(), before)
        };
        let base = self.0.axes.len() as u16;
        let mut ids = Vec::new();
        for axis in &all.axes()[before..] {
            ids.extend(self.add(n, axis));
        }
        self.0.traffic.explain_by(n, link.decoder());
        link.search.change(&self.0.shared, |view| {
            for (found, id) in found.iter().zip(&ids) {
                let its = |one: &&mut FoundDrive| {
                    one.number == found.number && one.protocol == found.protocol
                };
                view.found.iter_mut().filter(its).for_each(|one| one.axis = Some(*id));
            }
        });
        self.0.shared.tell(Event::Bench);
        if let Err(error) = self.hear(base, before, &all) {
            tracing::warn!(%error, "what drives say unasked that were taken in is not heard");
        }
        Ok(TakenIn { axes: ids })
    }

    /// One more axis on a link: who looks after it finds it there before anybody can ask for it.
    pub(super) fn add(&self, n: usize, axis: &Axis) -> Option<u16> {
        let link = &self.0.links[n];
        let Link { wire, id, .. } = link;
        let (seat, place) = (self.0.axes.len() as u16, wire.axes.len());
        let drive = link
            .simulation()
            .and_then(|(simulation, link)| Drive::find(simulation, *link, axis.number(), place));
        let info = axis_info(seat, *id, axis, drive.as_ref());
        self.0.telemetry.grow();
        wire.join(seat, axis.clone())?;
        self.0.axes.push(Seat { link: n, place, info, drive })?;
        wire.call();
        Some(seat)
    }

    fn link(&self, id: u16) -> Result<&Link, Refused> {
        self.0.links.get(usize::from(id)).ok_or_else(|| {
            Refused::new("gateway.missing", format!("the bench has no link {id}"))
                .hint("links count from 0, in the order of the bench's list")
        })
    }
}

/// The drives that are meant, and may be taken in.
fn chosen(link: &Link, take: &TakeIn) -> Result<Vec<Found>, Refused> {
    let found = held(&link.search.found).clone();
    let told = link.search.told().map(|view| view.found).unwrap_or_default();
    let at = |one: &Found| DriveAt { protocol: one.protocol.to_owned(), number: one.number };
    let axis = |one: &Found| {
        let same = |told: &&FoundDrive| told.number == one.number && told.protocol == one.protocol;
        told.iter().find(same).and_then(|told| told.axis)
    };
    if let Some(missing) = take.drives.iter().find(|d| !found.iter().any(|f| at(f) == **d)) {
        let what = format!("no drive was found at {} {}", missing.protocol, missing.number);
        return Err(Refused::new("gateway.missing", what).hint("look for drives first"));
    }
    let every = take.drives.is_empty();
    let mut chosen = Vec::new();
    for one in &found {
        let named = take.drives.contains(&at(one));
        let fits = axis(one).is_none() && one.clash.is_none();
        match (&one.clash, axis(one)) {
            _ if every && fits => {}
            _ if !named => continue,
            (_, Some(axis)) => {
                return Err(refused(format!("that drive is axis {axis} already")));
            }
            (Some(clash), _) => {
                let what = format!("what is said to {} may reach two drives: {clash}", one.number);
                return Err(refused(what).hint("give each an address of its own, and look again"));
            }
            (None, None) => {}
        }
        chosen.push(one.clone());
    }
    Ok(chosen)
}

/// The addresses that are meant.
fn numbers(order: &LookOrder) -> Result<Numbers, Refused> {
    match (order.first, order.last) {
        (None, None) => Ok(Numbers::ALL),
        (Some(first), last) if last.is_none_or(|last| first <= last) => {
            Ok(Numbers::from(first..=last.unwrap_or(first)))
        }
        _ => Err(Refused::new("gateway.request", "addresses are asked from `first` to `last`")),
    }
}

pub(super) fn refused(what: impl Into<String>) -> Refused {
    Refused::new("gateway.look", what)
}
