//! A simulated wire that is cut or silent from its n-th frame on, and what passed on it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use polepair::simulate::Simulation;
use polepair::wire::AnyLink;
use polepair::{Axis, Connector};
use polepair_core::drives::bench::Truth;
use polepair_core::medium::Medium;
use polepair_core::time::Instant;
use polepair_link::{Link, LinkError, Received, Waker};

/// After so long a wire that comes back is well: less than a stop is said again for.
const BACK: Duration = Duration::from_millis(1200);

/// A wire that is well again after this has lost one frame, or a few that went out together.
const MOMENT: Duration = Duration::from_millis(1);

/// What happens to a wire.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Fault {
    /// At which frame of the host's, counted from 1.
    pub at: usize,
    pub how: How,
    /// After how long it is well again, if ever.
    pub back: Option<Duration>,
}

/// How a wire fails.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum How {
    /// The system says that it is gone, and the frame was not sent.
    CutBefore,
    /// The frame was sent, then the system says that it is gone.
    CutBehind,
    /// Nothing that the host says arrives.
    Mute,
    /// Nothing that drives say arrives.
    Deaf,
}

impl Fault {
    /// Whether it costs one frame, or a few that went out together.
    pub fn is_moment(&self) -> bool {
        self.back == Some(MOMENT)
    }

    /// Whether that is one of the host's, and no more is wrong.
    pub fn is_one_frame_lost(&self) -> bool {
        self.is_moment() && self.how == How::Mute
    }

    /// Every fault at a frame.
    pub fn each(at: usize) -> impl Iterator<Item = Self> {
        let hows = [How::CutBefore, How::CutBehind, How::Mute, How::Deaf];
        let each = hows.into_iter().flat_map(|how| [(how, None), (how, Some(BACK))]);
        let lost = [(How::Mute, Some(MOMENT)), (How::Deaf, Some(MOMENT))];
        each.chain(lost).map(move |(how, back)| Self { at, how, back })
    }
}

/// A wire, and what passes on it. Clones are the same wire.
#[derive(Clone)]
pub struct Wire(Arc<Shared>);

/// What is done with the drives before frames count.
type Prepare = Box<dyn Fn(&[Axis]) + Send + Sync>;

struct Shared {
    /// The protocol's word, and the drives' addresses.
    drives: (&'static str, &'static [u32]),
    fault: Option<Fault>,
    prepare: Prepare,
    /// The verb has the wire: frames count.
    counts: AtomicBool,
    log: Mutex<Log>,
}

#[derive(Default)]
struct Log {
    frames: usize,
    since: Option<Instant>,
    simulation: Option<Simulation>,
    drives: Vec<Drive>,
}

/// What happened to a drive.
#[derive(Clone, Debug)]
pub struct Drive {
    pub before: Truth,
    pub after: Truth,
    /// The greatest speed, rad/s.
    pub greatest: f64,
    pub was_enabled: bool,
    /// Requests executed that powered the motor or gave it somewhere to go.
    pub starts: u64,
}

/// What a verb's wire and drives tell when it has ended.
pub struct Witness {
    pub frames: usize,
    pub drives: Vec<Drive>,
}

impl Wire {
    /// Of drives that speak a protocol, which are prepared before frames count.
    pub fn new(
        drives: (&'static str, &'static [u32]),
        fault: Option<Fault>,
        prepare: impl Fn(&[Axis]) + Send + Sync + 'static,
    ) -> Self {
        let (prepare, counts) = (Box::new(prepare), AtomicBool::new(false));
        Self(Arc::new(Shared { drives, fault, prepare, counts, log: Mutex::default() }))
    }

    /// Itself in the place of a simulated wire's end, once the drives are prepared.
    pub fn between(&self, end: AnyLink, simulation: &Simulation) -> AnyLink {
        let (mine, theirs) = match end {
            AnyLink::Serial(link) => {
                let link: Arc<dyn Link<_>> = Arc::from(link);
                let end = |link| AnyLink::Serial(Box::new(End { link, wire: self.clone() }));
                (end(Arc::clone(&link)), end(link))
            }
            AnyLink::Can(link) => {
                let link: Arc<dyn Link<_>> = Arc::from(link);
                let end = |link| AnyLink::Can(Box::new(End { link, wire: self.clone() }));
                (end(Arc::clone(&link)), end(link))
            }
        };
        self.log().simulation = Some(simulation.clone());
        let (protocol, numbers) = self.0.drives;
        let link = Connector::default().connect_over(mine, protocol, numbers, "");
        let link = link.expect("the drives answer");
        (self.0.prepare)(link.axes());
        drop(link);
        simulation.pass(Duration::from_millis(500));
        let of = |n| simulation.truth(0, n).expect("a drive");
        let truths = (0..numbers.len()).map(of).map(|truth| Drive {
            before: truth,
            after: truth,
            greatest: 0.0,
            was_enabled: false,
            starts: 0,
        });
        self.log().drives = truths.collect();
        self.0.counts.store(true, Ordering::SeqCst);
        theirs
    }

    /// What became of all, so long after the verb's end.
    pub fn witness(&self, later: Duration) -> Witness {
        self.look();
        let simulation = self.log().simulation.clone();
        simulation.iter().for_each(|simulation| simulation.pass(later));
        self.look();
        let log = self.log();
        Witness { frames: log.frames, drives: log.drives.clone() }
    }

    fn log(&self) -> MutexGuard<'_, Log> {
        self.0.log.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Looks at the drives themselves.
    fn look(&self) {
        let mut log = self.log();
        let Some(simulation) = log.simulation.clone() else { return };
        for (n, drive) in log.drives.iter_mut().enumerate() {
            let Some(truth) = simulation.truth(0, n) else { continue };
            drive.after = truth;
            drive.greatest = drive.greatest.max(truth.velocity.abs());
            drive.was_enabled |= truth.enabled && !drive.before.enabled;
            drive.starts = truth.starts - drive.before.starts;
        }
    }

    /// Counts a frame of the host's, and tells what happens to the wire from there on.
    fn frame(&self, now: Instant) -> Option<How> {
        if !self.0.counts.load(Ordering::SeqCst) {
            return None;
        }
        self.look();
        {
            let mut log = self.log();
            log.frames += 1;
            if self.0.fault.is_some_and(|fault| fault.at == log.frames) {
                log.since = Some(now);
                // This very frame may still pass.
                return self.0.fault.map(|fault| fault.how);
            }
        }
        self.ill(now)
    }

    /// What is wrong with the wire now.
    fn ill(&self, now: Instant) -> Option<How> {
        let (since, fault) = (self.log().since?, self.0.fault?);
        let is_back = fault.back.is_some_and(|back| now >= since + back);
        (!is_back).then_some(fault.how)
    }
}

struct End<M: Medium> {
    link: Arc<dyn Link<M>>,
    wire: Wire,
}

impl<M: Medium> End<M> {
    fn gone(&self) -> LinkError {
        LinkError::gone(&self.link.describe())
    }
}

impl<M: Medium> Link<M> for End<M> {
    fn now(&self) -> Instant {
        self.link.now()
    }

    fn send(&self, unit: &M::Unit) -> Result<(), LinkError> {
        let before = self.wire.ill(self.now()).is_some();
        match self.wire.frame(self.now()) {
            None | Some(How::Deaf) => self.link.send(unit),
            Some(How::Mute) => Ok(()),
            Some(How::CutBehind) if !before => self.link.send(unit),
            Some(How::CutBefore | How::CutBehind) => Err(self.gone()),
        }
    }

    fn receive(&self, buffer: &mut M::Out, until: Instant) -> Result<Received, LinkError> {
        loop {
            if matches!(self.wire.ill(self.now()), Some(How::CutBefore | How::CutBehind)) {
                return Err(self.gone());
            }
            let received = self.link.receive(buffer, until)?;
            let deaf = self.wire.ill(self.now()) == Some(How::Deaf);
            if !(deaf && matches!(received, Received::Bytes { .. })) {
                return Ok(received);
            }
        }
    }

    fn set_line(&self, line: M::Line) -> Result<(), LinkError> {
        self.link.set_line(line)
    }

    fn waker(&self) -> Waker {
        self.link.waker()
    }

    fn runs_by_itself(&self) -> bool {
        self.link.runs_by_itself()
    }

    fn describe(&self) -> String {
        self.link.describe()
    }

    fn reopen(&self) -> Result<Box<dyn Link<M>>, LinkError> {
        match self.wire.ill(self.now()) {
            Some(How::CutBefore | How::CutBehind) => Err(self.gone()),
            _ => Ok(Box::new(Self { link: Arc::clone(&self.link), wire: self.wire.clone() })),
        }
    }
}
