//! A simulated wire that is cut or silent from its n-th frame on, and records the frames that passed.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use polepair::simulate::Simulation;
use polepair::wire::AnyLink;
use polepair::{Connector, LocalAxis};
use polepair_core::medium::{Can, Medium};
use polepair_core::time::Instant;
use polepair_drives::surroundings::GroundTruth;
use polepair_link::{LinkError, LinkIo, LinkWaker, Received};

/// Time after which a returning wire works: less than a stop is repeated for.
const RECOVERY_TIME: Duration = Duration::from_millis(1200);

/// A wire that is well again after this has lost one frame, or a few that went out together.
const GLITCH_TIME: Duration = Duration::from_millis(1);

/// Fault of a wire.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct WireFault {
    /// At which frame of the host's, counted from 1.
    pub at: usize,
    pub mode: FailureMode,
    /// After how long it is well again, if ever.
    pub recovers_after: Option<Duration>,
}

/// Failure of a wire.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum FailureMode {
    /// The system reports the link as gone, and the frame was not sent.
    CutBefore,
    /// The frame was sent, then the system reports the link as gone.
    CutAfter,
    /// Frames of the host are lost.
    HostMuted,
    /// Frames of drives are lost.
    DrivesMuted,
}

impl WireFault {
    /// Returns whether it costs one frame, or a few that went out together.
    pub fn is_glitch(&self) -> bool {
        self.recovers_after == Some(GLITCH_TIME)
    }

    /// Returns whether that is one of the host's, and no more is wrong.
    pub fn is_one_frame_lost(&self) -> bool {
        self.is_glitch() && self.mode == FailureMode::HostMuted
    }

    /// Every fault at a frame.
    pub fn all_at(at: usize) -> impl Iterator<Item = Self> {
        let hows = [
            FailureMode::CutBefore,
            FailureMode::CutAfter,
            FailureMode::HostMuted,
            FailureMode::DrivesMuted,
        ];
        let each = hows.into_iter().flat_map(|how| [(how, None), (how, Some(RECOVERY_TIME))]);
        let lost = [
            (FailureMode::HostMuted, Some(GLITCH_TIME)),
            (FailureMode::DrivesMuted, Some(GLITCH_TIME)),
        ];
        each.chain(lost).map(move |(how, back)| Self { at, mode: how, recovers_after: back })
    }
}

/// A wire, and what passes on it. Clones are the same wire.
#[derive(Clone)]
pub struct RecordedWire(Arc<WireShared>);

/// Preparation of the drives before frames count.
type PrepareFn = Box<dyn Fn(&[LocalAxis]) + Send + Sync>;

struct WireShared {
    /// The protocol's word, and the drives' addresses.
    drives: (&'static str, &'static [u32]),
    fault: Option<WireFault>,
    prepare: PrepareFn,
    /// The verb has the wire: frames count.
    counting: AtomicBool,
    log: Mutex<WireLog>,
}

#[derive(Default)]
struct WireLog {
    frames: usize,
    since: Option<Instant>,
    simulation: Option<Simulation>,
    drives: Vec<DriveHistory>,
}

/// History of a drive.
#[derive(Clone, Debug)]
pub struct DriveHistory {
    pub before: GroundTruth,
    pub after: GroundTruth,
    /// The greatest speed, rad/s.
    pub top_speed: f64,
    pub was_enabled: bool,
    /// Requests executed that powered the motor or gave it somewhere to go.
    pub starts: u64,
}

/// Observations of a verb's wire and drives at its end.
pub struct WireObservation {
    pub frames: usize,
    pub drives: Vec<DriveHistory>,
}

impl RecordedWire {
    /// Creates the wire of drives of a protocol, which are prepared before frames count.
    pub fn new(
        drives: (&'static str, &'static [u32]),
        fault: Option<WireFault>,
        prepare: impl Fn(&[LocalAxis]) + Send + Sync + 'static,
    ) -> Self {
        let (prepare, counts) = (Box::new(prepare), AtomicBool::new(false));
        Self(Arc::new(WireShared {
            drives,
            fault,
            prepare,
            counting: counts,
            log: Mutex::default(),
        }))
    }

    /// Itself in the place of a simulated wire's end, once the drives are prepared.
    pub fn wrap_link(&self, end: AnyLink, simulation: &Simulation) -> AnyLink {
        let (mine, theirs) = match end {
            AnyLink::Serial(link) => {
                let link: Arc<dyn LinkIo<_>> = Arc::from(link);
                let end =
                    |link| AnyLink::Serial(Box::new(FailingLink { link, wire: self.clone() }));
                (end(Arc::clone(&link)), end(link))
            }
            AnyLink::Can(link) => {
                let link: Arc<dyn LinkIo<_>> = Arc::from(link);
                (self.failing_end(Arc::clone(&link)), self.failing_end(link))
            }
        };
        self.lock_log().simulation = Some(simulation.clone());
        let (protocol, numbers) = self.0.drives;
        let link = Connector::default().connect_over(mine, protocol, numbers, "");
        let link = link.expect("the drives answer");
        (self.0.prepare)(link.axes());
        drop(link);
        simulation.advance(Duration::from_millis(500));
        let truths =
            (0..numbers.len()).map(|n| simulation.truth(0, n).expect("a drive")).map(|truth| {
                DriveHistory {
                    before: truth,
                    after: truth,
                    top_speed: 0.0,
                    was_enabled: false,
                    starts: 0,
                }
            });
        self.lock_log().drives = truths.collect();
        self.0.counting.store(true, Ordering::SeqCst);
        theirs
    }

    fn failing_end(&self, link: Arc<dyn LinkIo<Can>>) -> AnyLink {
        AnyLink::Can(Box::new(FailingLink { link, wire: self.clone() }))
    }

    /// State of all drives at this time after the verb's end.
    pub fn observe(&self, later: Duration) -> WireObservation {
        self.record_truth();
        let simulation = self.lock_log().simulation.clone();
        simulation.iter().for_each(|simulation| simulation.advance(later));
        self.record_truth();
        let log = self.lock_log();
        WireObservation { frames: log.frames, drives: log.drives.clone() }
    }

    fn lock_log(&self) -> MutexGuard<'_, WireLog> {
        self.0.log.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Looks at the drives themselves.
    fn record_truth(&self) {
        let mut log = self.lock_log();
        let Some(simulation) = log.simulation.clone() else { return };
        for (n, drive) in log.drives.iter_mut().enumerate() {
            let Some(truth) = simulation.truth(0, n) else { continue };
            drive.after = truth;
            drive.top_speed = drive.top_speed.max(truth.velocity.abs());
            drive.was_enabled |= truth.enabled && !drive.before.enabled;
            drive.starts = truth.starts - drive.before.starts;
        }
    }

    /// Counts a frame of the host, and returns the fault of the wire from there on.
    fn count_frame(&self, now: Instant) -> Option<FailureMode> {
        if !self.0.counting.load(Ordering::SeqCst) {
            return None;
        }
        self.record_truth();
        {
            let mut log = self.lock_log();
            log.frames += 1;
            if self.0.fault.is_some_and(|fault| fault.at == log.frames) {
                log.since = Some(now);
                // This very frame may still pass.
                return self.0.fault.map(|fault| fault.mode);
            }
        }
        self.active_fault(now)
    }

    /// Present fault of the wire.
    fn active_fault(&self, now: Instant) -> Option<FailureMode> {
        let (since, fault) = (self.lock_log().since?, self.0.fault?);
        let is_back = fault.recovers_after.is_some_and(|back| now >= since + back);
        (!is_back).then_some(fault.mode)
    }
}

struct FailingLink<M: Medium> {
    link: Arc<dyn LinkIo<M>>,
    wire: RecordedWire,
}

impl<M: Medium> FailingLink<M> {
    fn gone_error(&self) -> LinkError {
        LinkError::gone(&self.link.describe())
    }
}

impl<M: Medium> LinkIo<M> for FailingLink<M> {
    fn now(&self) -> Instant {
        self.link.now()
    }

    fn send(&self, unit: &M::Unit) -> Result<(), LinkError> {
        let before = self.wire.active_fault(self.now()).is_some();
        match self.wire.count_frame(self.now()) {
            None | Some(FailureMode::DrivesMuted) => self.link.send(unit),
            Some(FailureMode::HostMuted) => Ok(()),
            Some(FailureMode::CutAfter) if !before => self.link.send(unit),
            Some(FailureMode::CutBefore | FailureMode::CutAfter) => Err(self.gone_error()),
        }
    }

    fn receive(&self, buffer: &mut M::Out, until: Instant) -> Result<Received, LinkError> {
        loop {
            if matches!(
                self.wire.active_fault(self.now()),
                Some(FailureMode::CutBefore | FailureMode::CutAfter)
            ) {
                return Err(self.gone_error());
            }
            let received = self.link.receive(buffer, until)?;
            let deaf = self.wire.active_fault(self.now()) == Some(FailureMode::DrivesMuted);
            if !(deaf && matches!(received, Received::Bytes { .. })) {
                return Ok(received);
            }
        }
    }

    fn set_line(&self, line: M::Line) -> Result<(), LinkError> {
        self.link.set_line(line)
    }

    fn waker(&self) -> LinkWaker {
        self.link.waker()
    }

    fn is_real_time(&self) -> bool {
        self.link.is_real_time()
    }

    fn describe(&self) -> String {
        self.link.describe()
    }

    fn reopen(&self) -> Result<Box<dyn LinkIo<M>>, LinkError> {
        match self.wire.active_fault(self.now()) {
            Some(FailureMode::CutBefore | FailureMode::CutAfter) => Err(self.gone_error()),
            _ => Ok(Box::new(Self { link: Arc::clone(&self.link), wire: self.wire.clone() })),
        }
    }
}
