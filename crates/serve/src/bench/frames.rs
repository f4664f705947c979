//! Live frames, decoded on their own thread for viewers. Without a viewer, the tap stores nothing.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError, Weak};
use std::time::Duration;

use polepair_capture::{CaptureDecoder, DecodedFrame, FrameFilter, Timestamp};
use polepair_core::explain::Direction as Said;
use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::time::Instant;
use polepair_link::clock;
use polepair_link::tap::{Tap, TapDirection};

use super::Bench;
use super::context::BenchContext;
use super::frame_view::{explained_fields, frame_item};
use super::lock::lock_unpoisoned;
use super::wire::BenchWire;
use crate::message::{ExplainedField, FrameItem, GatewayError};

/// Units that wait to be explained; the oldest go when there are more.
const UNITS_MAX: usize = 1 << 15;
/// Frames whose fields are kept.
const EXPLAINED_MAX: usize = 8192;
/// Limit of the frames that wait for one viewer.
const WAITING_MAX: usize = 4096;
/// Limit of simultaneous viewers of frames.
const VIEWERS_MAX: usize = 256;
/// Between two looks whether the bench closes.
const CLOSE_CHECK_INTERVAL: Duration = Duration::from_millis(100);

/// Frames of the taps, and their subscribers.
#[derive(Default)]
pub(super) struct FrameTraffic {
    tapped: Mutex<TappedUnits>,
    wakeup: Condvar,
    subscriber_count: AtomicUsize,
    subscribers: Mutex<Vec<Weak<Mutex<FrameQueue>>>>,
    /// Decoders that wires get instead of theirs.
    new_decoders: Mutex<Vec<(usize, CaptureDecoder)>>,
    recent_fields: Mutex<VecDeque<(u64, Vec<ExplainedField>)>>,
}

#[derive(Default)]
struct TappedUnits {
    units: VecDeque<TappedUnit>,
    lost: u64,
}

struct TappedUnit {
    wire: usize,
    at: Instant,
    direction: TapDirection,
    data: UnitData,
}

enum UnitData {
    Bytes(Vec<u8>),
    Frame(Frame),
}

/// The tap of one wire.
pub(super) struct TrafficTap {
    wire: usize,
    traffic: Arc<FrameTraffic>,
}

/// Frames that a viewer watches. Dropping it ends the subscription.
pub struct FrameSubscription {
    queue: Arc<Mutex<FrameQueue>>,
    traffic: Arc<FrameTraffic>,
}

struct FrameQueue {
    filter: Option<FrameFilter>,
    items: VecDeque<FrameItem>,
    lost: u64,
}

impl std::fmt::Debug for FrameSubscription {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} frames", lock_unpoisoned(&self.queue).items.len())
    }
}

impl Bench {
    /// Watches the frames that pass from now on, those that a filter wants.
    ///
    /// # Errors
    /// `gateway.request` for a text that is no filter, `gateway.limit` when too many watch.
    pub fn subscribe_frames(
        &self,
        filter: Option<&str>,
    ) -> Result<FrameSubscription, GatewayError> {
        let filter = parse_optional_filter(filter)?;
        let traffic = Arc::clone(&self.0.traffic);
        let mut viewers = lock_unpoisoned(&traffic.subscribers);
        viewers.retain(|viewer| viewer.strong_count() > 0);
        if viewers.len() >= VIEWERS_MAX {
            let what = format!("{VIEWERS_MAX} clients already receive frames");
            return Err(GatewayError::new("gateway.limit", what).hint("close another page"));
        }
        let waiting = FrameQueue { filter, items: VecDeque::new(), lost: 0 };
        let waiting = Arc::new(Mutex::new(waiting));
        viewers.push(Arc::downgrade(&waiting));
        traffic.subscriber_count.fetch_add(1, Ordering::SeqCst);
        drop(viewers);
        Ok(FrameSubscription { queue: waiting, traffic })
    }

    /// The fields of a frame that passed not long ago.
    ///
    /// # Errors
    /// `gateway.missing` for one that is kept no more, or never was.
    pub fn explain_frame(&self, n: u64) -> Result<Vec<ExplainedField>, GatewayError> {
        let explained = lock_unpoisoned(&self.0.traffic.recent_fields);
        let at = explained.binary_search_by_key(&n, |(number, _)| *number).ok();
        at.map(|at| explained[at].1.clone()).ok_or_else(|| {
            GatewayError::new("gateway.missing", format!("frame {n} is no longer stored"))
                .hint("pause the list first")
        })
    }
}

/// A filter, if there is one.
fn parse_optional_filter(filter: Option<&str>) -> Result<Option<FrameFilter>, GatewayError> {
    filter.filter(|text| !text.trim().is_empty()).map(parse_filter).transpose()
}

/// A filter of the analyser's language.
pub(super) fn parse_filter(text: &str) -> Result<FrameFilter, GatewayError> {
    FrameFilter::parse(text).map_err(|error| {
        let near = error.nearest.as_ref().map(|near| format!("is `{near}` meant?"));
        GatewayError::new(
            "gateway.request",
            format!("at {}: {}", error.position + 1, error.message),
        )
        .hint(near.unwrap_or_else(|| "such as `axis = 2 and not ok`".to_owned()))
    })
}

impl FrameSubscription {
    /// Watches those that another filter wants, from now on.
    ///
    /// # Errors
    /// `gateway.request` for a text that is no filter: all stays as it was.
    pub fn set_filter(&mut self, filter: Option<&str>) -> Result<(), GatewayError> {
        let filter = parse_optional_filter(filter)?;
        *lock_unpoisoned(&self.queue) = FrameQueue { filter, items: VecDeque::new(), lost: 0 };
        Ok(())
    }

    /// Takes at most `max` frames. The number is that of frames dropped before the first of them.
    pub fn drain(&mut self, max: usize) -> (Vec<FrameItem>, u64) {
        let mut waiting = lock_unpoisoned(&self.queue);
        let count = max.min(waiting.items.len());
        (waiting.items.drain(..count).collect(), std::mem::take(&mut waiting.lost))
    }
}

impl Drop for FrameSubscription {
    fn drop(&mut self) {
        self.traffic.subscriber_count.fetch_sub(1, Ordering::SeqCst);
    }
}

impl FrameTraffic {
    /// The tap of a wire.
    pub fn tap(self: &Arc<Self>, wire: usize) -> TrafficTap {
        TrafficTap { wire, traffic: Arc::clone(self) }
    }

    /// Explains the frames of a wire by another decoder from now on.
    pub fn replace_decoder(&self, wire: usize, decoder: CaptureDecoder) {
        lock_unpoisoned(&self.new_decoders).push((wire, decoder));
    }

    fn record(
        &self,
        wire: usize,
        at: Instant,
        direction: TapDirection,
        what: impl FnOnce() -> UnitData,
    ) {
        if self.subscriber_count.load(Ordering::Relaxed) == 0 {
            return;
        }
        // This is on the way to the wire: nothing is allocated, and no thread woken, under the lock.
        let unit = TappedUnit { wire, at, direction, data: what() };
        let first = {
            let mut tapped = lock_unpoisoned(&self.tapped);
            if tapped.units.len() == UNITS_MAX {
                tapped.units.pop_front();
                tapped.lost += 1;
            }
            tapped.units.push_back(unit);
            tapped.units.len() == 1
        };
        if first {
            self.wakeup.notify_one();
        }
    }

    fn wait_for_units(&self, at_most: Duration) -> TappedUnits {
        let tapped = lock_unpoisoned(&self.tapped);
        let mut tapped = if !tapped.units.is_empty() {
            tapped
        } else if !at_most.is_zero() {
            let waited = self.wakeup.wait_timeout(tapped, at_most);
            waited.unwrap_or_else(PoisonError::into_inner).0
        } else {
            tapped
        };
        std::mem::take(&mut tapped)
    }

    fn publish(&self, event: &DecodedFrame<'_>, item: &FrameItem) {
        let viewers: Vec<_> =
            lock_unpoisoned(&self.subscribers).iter().filter_map(Weak::upgrade).collect();
        for viewer in viewers {
            let mut waiting = lock_unpoisoned(&viewer);
            let wanted = waiting.filter.as_mut().is_none_or(|filter| filter.matches(event));
            if !wanted {
                continue;
            }
            if waiting.items.len() == WAITING_MAX {
                waiting.items.pop_front();
                waiting.lost += 1;
            }
            waiting.items.push_back(item.clone());
        }
        let mut explained = lock_unpoisoned(&self.recent_fields);
        if explained.len() == EXPLAINED_MAX {
            explained.pop_front();
        }
        explained.push_back((item.n, explained_fields(event)));
    }
}

impl Tap<Stream> for TrafficTap {
    fn record_unit(&mut self, at: Instant, direction: TapDirection, bytes: &[u8]) {
        self.traffic.record(self.wire, at, direction, || UnitData::Bytes(bytes.to_vec()));
    }
}

impl Tap<Can> for TrafficTap {
    fn record_unit(&mut self, at: Instant, direction: TapDirection, frame: &Frame) {
        self.traffic.record(self.wire, at, direction, || UnitData::Frame(*frame));
    }
}

/// Decoder of frames, with one for each wire.
pub(super) struct TrafficDecoder {
    pub traffic: Arc<FrameTraffic>,
    pub context: Arc<BenchContext>,
    pub decoders: Vec<CaptureDecoder>,
    pub wires: Vec<Arc<BenchWire>>,
    pub count: u64,
}

impl TrafficDecoder {
    /// Explains until the bench closes.
    pub fn run(mut self) {
        polepair_link::lower_priority();
        while !self.context.is_closing() {
            self.decode_tapped(CLOSE_CHECK_INTERVAL);
        }
    }

    /// Decodes tapped frames; waits for one at most this long.
    pub fn decode_tapped(&mut self, at_most: Duration) {
        let TappedUnits { units, lost } = self.traffic.wait_for_units(at_most);
        for (wire, decoder) in lock_unpoisoned(&self.traffic.new_decoders).drain(..) {
            self.decoders[wire] = decoder;
        }
        if lost > 0 {
            let viewers = lock_unpoisoned(&self.traffic.subscribers);
            let all = viewers.iter().filter_map(Weak::upgrade);
            all.for_each(|viewer| lock_unpoisoned(&viewer).lost += lost);
        }
        for unit in units {
            self.decode_unit(&unit);
        }
    }

    fn decode_unit(&mut self, unit: &TappedUnit) {
        let Self { traffic, decoders, wires, count, .. } = self;
        let Some(decoder) = decoders.get_mut(unit.wire) else { return };
        let direction = match unit.direction {
            TapDirection::ToDrive => Said::ToDrive,
            TapDirection::ToHost => Said::ToHost,
        };
        let since = unit.at.since(wires[unit.wire].time_origin());
        let (time, t_us) =
            (Some(Timestamp(clock::wall_ns(unit.at))), since.as_nanos() as f64 / 1e3);
        let mut show = |event: &DecodedFrame<'_>| {
            let item = FrameItem { t_us, ..frame_item(*count, unit.wire as u16, event) };
            *count += 1;
            traffic.publish(event, &item);
        };
        let link = format!("{}", unit.wire);
        match &unit.data {
            UnitData::Bytes(bytes) => {
                decoder.decode_bytes(time, &link, Some(direction), bytes, &mut show)
            }
            UnitData::Frame(frame) => {
                decoder.decode_frame(time, &link, Some(direction), frame, &mut show)
            }
        }
    }
}
