//! Frames as they pass: explained on a thread of their own, for those who watch. While nobody does,
//! a tap keeps nothing.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError, Weak};
use std::time::Duration;

use polepair_capture::{Decoder, Event, Filter, Stamp};
use polepair_core::explain::Direction as Said;
use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::time::Instant;
use polepair_link::clock;
use polepair_link::tap::{Direction, Tap};

use super::Bench;
use super::explained::{fields, item};
use super::shared::{Shared, held};
use super::wire::Wire;
use crate::message::{ExplainedField, FrameItem, Refused};

/// Units that wait to be explained; the oldest go when there are more.
const HEARD_MAX: usize = 1 << 15;
/// Frames whose fields are kept.
const EXPLAINED_MAX: usize = 8192;
/// Frames that wait for one who watches.
const WAITING_MAX: usize = 4096;
/// Who may watch frames at once.
const VIEWERS_MAX: usize = 256;
/// Between two looks whether the bench closes.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// What taps heard, and who wants to see it.
#[derive(Default)]
pub(super) struct Traffic {
    heard: Mutex<Heard>,
    called: Condvar,
    watching: AtomicUsize,
    viewers: Mutex<Vec<Weak<Mutex<Waiting>>>>,
    /// Decoders that wires get instead of theirs.
    decoders: Mutex<Vec<(usize, Decoder)>>,
    explained: Mutex<VecDeque<(u64, Vec<ExplainedField>)>>,
}

#[derive(Default)]
struct Heard {
    units: VecDeque<Unit>,
    lost: u64,
}

struct Unit {
    wire: usize,
    at: Instant,
    direction: Direction,
    what: What,
}

enum What {
    Bytes(Vec<u8>),
    Frame(Frame),
}

/// The tap of one wire.
pub(super) struct Ear {
    wire: usize,
    traffic: Arc<Traffic>,
}

/// The frames that somebody watches. Dropped, they are watched no more.
pub struct Frames {
    waiting: Arc<Mutex<Waiting>>,
    traffic: Arc<Traffic>,
}

struct Waiting {
    filter: Option<Filter>,
    items: VecDeque<FrameItem>,
    lost: u64,
}

impl std::fmt::Debug for Frames {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} frames", held(&self.waiting).items.len())
    }
}

impl Bench {
    /// Watches the frames that pass from now on, those that a filter wants.
    ///
    /// # Errors
    /// `gateway.request` for what is no filter, `gateway.limit` when too many watch.
    pub fn frames(&self, filter: Option<&str>) -> Result<Frames, Refused> {
        let filter = wanted(filter)?;
        let traffic = Arc::clone(&self.0.traffic);
        let mut viewers = held(&traffic.viewers);
        viewers.retain(|viewer| viewer.strong_count() > 0);
        if viewers.len() >= VIEWERS_MAX {
            let what = format!("{VIEWERS_MAX} watch frames already");
            return Err(Refused::new("gateway.limit", what).hint("close another page"));
        }
        let waiting = Waiting { filter, items: VecDeque::new(), lost: 0 };
        let waiting = Arc::new(Mutex::new(waiting));
        viewers.push(Arc::downgrade(&waiting));
        traffic.watching.fetch_add(1, Ordering::SeqCst);
        drop(viewers);
        Ok(Frames { waiting, traffic })
    }

    /// The fields of a frame that passed not long ago.
    ///
    /// # Errors
    /// `gateway.missing` for one that is kept no more, or never was.
    pub fn explain(&self, n: u64) -> Result<Vec<ExplainedField>, Refused> {
        let explained = held(&self.0.traffic.explained);
        let at = explained.binary_search_by_key(&n, |(number, _)| *number).ok();
        at.map(|at| explained[at].1.clone()).ok_or_else(|| {
            Refused::new("gateway.missing", format!("frame {n} is kept no more"))
                .hint("freeze the list first")
        })
    }
}

/// A filter, if there is one.
fn wanted(filter: Option<&str>) -> Result<Option<Filter>, Refused> {
    filter.filter(|text| !text.trim().is_empty()).map(parsed).transpose()
}

/// A filter of the analyser's language.
pub(super) fn parsed(text: &str) -> Result<Filter, Refused> {
    Filter::parse(text).map_err(|error| {
        let near = error.nearest.as_ref().map(|near| format!("is `{near}` meant?"));
        Refused::new("gateway.request", format!("at {}: {}", error.at + 1, error.what))
            .hint(near.unwrap_or_else(|| "such as `axis = 2 and not ok`".to_owned()))
    })
}

impl Frames {
    /// Watches those that another filter wants, from now on.
    ///
    /// # Errors
    /// `gateway.request` for what is no filter: all stays as it was.
    pub fn choose(&mut self, filter: Option<&str>) -> Result<(), Refused> {
        let filter = wanted(filter)?;
        *held(&self.waiting) = Waiting { filter, items: VecDeque::new(), lost: 0 };
        Ok(())
    }

    /// Takes at most so many frames, and tells how many were dropped before the first of them.
    pub fn take(&mut self, most: usize) -> (Vec<FrameItem>, u64) {
        let mut waiting = held(&self.waiting);
        let count = most.min(waiting.items.len());
        (waiting.items.drain(..count).collect(), std::mem::take(&mut waiting.lost))
    }
}

impl Drop for Frames {
    fn drop(&mut self) {
        self.traffic.watching.fetch_sub(1, Ordering::SeqCst);
    }
}

impl Traffic {
    /// The tap of a wire.
    pub fn ear(self: &Arc<Self>, wire: usize) -> Ear {
        Ear { wire, traffic: Arc::clone(self) }
    }

    /// Explains the frames of a wire by another decoder from now on.
    pub fn explain_by(&self, wire: usize, decoder: Decoder) {
        held(&self.decoders).push((wire, decoder));
    }

    fn hear(&self, wire: usize, at: Instant, direction: Direction, what: impl FnOnce() -> What) {
        if self.watching.load(Ordering::Relaxed) == 0 {
            return;
        }
        // This is on the way to the wire: nothing is made, and nobody woken, under the lock.
        let unit = Unit { wire, at, direction, what: what() };
        let first = {
            let mut heard = held(&self.heard);
            if heard.units.len() == HEARD_MAX {
                heard.units.pop_front();
                heard.lost += 1;
            }
            heard.units.push_back(unit);
            heard.units.len() == 1
        };
        if first {
            self.called.notify_one();
        }
    }

    fn wait(&self, at_most: Duration) -> Heard {
        let heard = held(&self.heard);
        let mut heard = match heard.units.is_empty() {
            true if !at_most.is_zero() => {
                let waited = self.called.wait_timeout(heard, at_most);
                waited.unwrap_or_else(PoisonError::into_inner).0
            }
            _ => heard,
        };
        std::mem::take(&mut heard)
    }

    fn show(&self, event: &Event<'_>, item: &FrameItem) {
        let viewers: Vec<_> = held(&self.viewers).iter().filter_map(Weak::upgrade).collect();
        for viewer in viewers {
            let mut waiting = held(&viewer);
            let wanted = waiting.filter.as_mut().is_none_or(|filter| filter.wants(event));
            if !wanted {
                continue;
            }
            if waiting.items.len() == WAITING_MAX {
                waiting.items.pop_front();
                waiting.lost += 1;
            }
            waiting.items.push_back(item.clone());
        }
        let mut explained = held(&self.explained);
        if explained.len() == EXPLAINED_MAX {
            explained.pop_front();
        }
        explained.push_back((item.n, fields(event)));
    }
}

impl Tap<Stream> for Ear {
    fn unit(&mut self, at: Instant, direction: Direction, bytes: &[u8]) {
        self.traffic.hear(self.wire, at, direction, || What::Bytes(bytes.to_vec()));
    }
}

impl Tap<Can> for Ear {
    fn unit(&mut self, at: Instant, direction: Direction, frame: &Frame) {
        self.traffic.hear(self.wire, at, direction, || What::Frame(*frame));
    }
}

/// What explains frames: a decoder for each wire.
pub(super) struct Reader {
    pub traffic: Arc<Traffic>,
    pub shared: Arc<Shared>,
    pub decoders: Vec<Decoder>,
    pub wires: Vec<Arc<Wire>>,
    pub count: u64,
}

impl Reader {
    /// Explains until the bench closes.
    pub fn run(mut self) {
        polepair_link::stand_back();
        while !self.shared.is_closing() {
            self.turn(LOOK_EVERY);
        }
    }

    /// Explains what was heard; waits for something at most so long.
    pub fn turn(&mut self, at_most: Duration) {
        let Heard { units, lost } = self.traffic.wait(at_most);
        for (wire, decoder) in held(&self.traffic.decoders).drain(..) {
            self.decoders[wire] = decoder;
        }
        if lost > 0 {
            let viewers = held(&self.traffic.viewers);
            let all = viewers.iter().filter_map(Weak::upgrade);
            all.for_each(|viewer| held(&viewer).lost += lost);
        }
        for unit in units {
            self.explain(&unit);
        }
    }

    fn explain(&mut self, unit: &Unit) {
        let Self { traffic, decoders, wires, count, .. } = self;
        let Some(decoder) = decoders.get_mut(unit.wire) else { return };
        let said = match unit.direction {
            Direction::ToDrive => Said::ToDrive,
            Direction::ToHost => Said::ToHost,
        };
        let since = unit.at.since(wires[unit.wire].zero());
        let (time, t_us) = (Some(Stamp(clock::wall_ns(unit.at))), since.as_nanos() as f64 / 1e3);
        let mut show = |event: &Event<'_>| {
            let item = FrameItem { t_us, ..item(*count, unit.wire as u16, event) };
            *count += 1;
            traffic.show(event, &item);
        };
        let link = format!("{}", unit.wire);
        match &unit.what {
            What::Bytes(bytes) => decoder.chunk(time, &link, Some(said), bytes, &mut show),
            What::Frame(frame) => decoder.frame(time, &link, Some(said), frame, &mut show),
        }
    }
}
