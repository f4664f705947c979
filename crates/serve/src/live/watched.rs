//! What one viewer watches: channels of telemetry, and frames. It is the writer's alone, which takes
//! from it one message at a time. What waits, waits in the bench's bounded queues: who is too slow
//! loses the oldest there, and is told.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use tokio::time::{Interval, MissedTickBehavior, interval};
use tokio_tungstenite::tungstenite::Message;

use super::{text, told};
use crate::bench::{Bench, Channel, Frames, Gap, Wish};
use crate::message::telemetry::{Sample, encode};
use crate::message::{Refused, ServerMessage, Source};
use crate::metrics::Metrics;

/// Channels of one viewer.
const CHANNELS_MAX: usize = 64;
/// Frames of a message.
const FRAMES_MAX: usize = 250;
/// Messages of frames in a round.
const BATCHES_MAX: usize = 8;
/// How often what came is sent.
const ROUND: Duration = Duration::from_millis(33);

/// What a viewer wants to see, or no longer.
pub(super) enum Look {
    Subscribe(u16, Wish),
    Unsubscribe(u16),
    /// That a filter wants.
    Frames(Option<String>),
    NoFrames,
    /// The fields of a frame.
    Explain(u64),
}

/// What a viewer watches. Dropped, nothing of it is watched any more.
#[derive(Debug, Default)]
pub(super) struct Watched {
    channels: BTreeMap<u16, Told>,
    frames: Option<Frames>,
}

/// A channel, and what the viewer was told of it.
#[derive(Debug)]
struct Told {
    channel: Channel,
    source: Option<Source>,
}

impl Watched {
    /// Changes what is watched, and tells what there is to be told of that.
    pub fn look(&mut self, bench: &Bench, look: Look) -> Option<ServerMessage> {
        let (done, about, subject) = match look {
            Look::Subscribe(number, wish) => {
                (self.subscribe(bench, number, wish), "subscribe", Some(number))
            }
            Look::Unsubscribe(number) => {
                self.channels.remove(&number);
                return None;
            }
            Look::Frames(filter) => (self.frames(bench, filter.as_deref()), "frames", None),
            Look::NoFrames => {
                self.frames = None;
                return None;
            }
            Look::Explain(n) => match bench.explain(n) {
                Ok(fields) => return Some(ServerMessage::Explained { n, fields }),
                Err(refused) => (Err(refused), "explain", None),
            },
        };
        done.err().map(|refused| told(refused, Some(about), subject))
    }

    /// Sends a channel from now on, instead of what had its number.
    fn subscribe(&mut self, bench: &Bench, number: u16, wish: Wish) -> Result<(), Refused> {
        if self.channels.len() >= CHANNELS_MAX && !self.channels.contains_key(&number) {
            let what = format!("a viewer has at most {CHANNELS_MAX} channels");
            return Err(Refused::new("gateway.limit", what).hint("unsubscribe from one"));
        }
        self.channels.insert(number, Told { channel: bench.watch(wish)?, source: None });
        Ok(())
    }

    /// Sends frames that a filter wants; no others, where some were sent before.
    fn frames(&mut self, bench: &Bench, filter: Option<&str>) -> Result<(), Refused> {
        match &mut self.frames {
            Some(frames) => frames.choose(filter)?,
            none => *none = Some(bench.frames(filter)?),
        }
        Ok(())
    }

    fn is_empty(&self) -> bool {
        self.channels.is_empty() && self.frames.is_none()
    }
}

/// Goes round what is watched. Each message can be preceded by whatever is more urgent.
pub(super) struct Round {
    next: Interval,
    ready: VecDeque<Message>,
    samples: Vec<Sample>,
    /// The channel, or the next one, whose turn it is; `None` once all had theirs.
    channel: Option<u16>,
    /// Messages of frames that may still be sent.
    batches: usize,
}

impl Default for Round {
    fn default() -> Self {
        let mut next = interval(ROUND);
        next.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (ready, samples) = (VecDeque::new(), Vec::new());
        Self { next, ready, samples, channel: None, batches: 0 }
    }
}

impl Round {
    /// The next message. Where it is waited for no longer, nothing is lost.
    pub async fn message(&mut self, watched: &mut Watched, metrics: &Metrics) -> Message {
        loop {
            if let Some(message) = self.ready.pop_front() {
                return message;
            }
            if self.channel(watched, metrics) || self.frames(watched, metrics) {
                continue;
            }
            if watched.is_empty() {
                // Until that changes there is nothing to say.
                std::future::pending::<()>().await;
            }
            self.next.tick().await;
            (self.channel, self.batches) = (Some(0), BATCHES_MAX);
        }
    }

    /// Makes the messages of the next channel. False when all had their turn.
    fn channel(&mut self, watched: &mut Watched, metrics: &Metrics) -> bool {
        let Some(from) = self.channel.take() else { return false };
        let Some((number, told)) = watched.channels.range_mut(from..).next() else { return false };
        self.channel = number.checked_add(1);
        let lost = told.say(*number, &mut self.samples, &mut self.ready);
        metrics.dropped.inc_by(lost);
        true
    }

    /// Makes a message of frames. False when none are left, or too many.
    fn frames(&mut self, watched: &mut Watched, metrics: &Metrics) -> bool {
        if self.batches == 0 {
            return false;
        }
        self.batches -= 1;
        let taken = watched.frames.as_mut().map(|frames| frames.take(FRAMES_MAX));
        let Some((items, lost)) = taken.filter(|(items, lost)| !items.is_empty() || *lost > 0)
        else {
            return false;
        };
        metrics.dropped.inc_by(lost);
        self.ready.push_back(Message::Text(text(&ServerMessage::Frames { items, lost })));
        true
    }
}

impl Told {
    /// Where it comes from, if that is new; what was lost; what came. Returns how many were lost.
    fn say(
        &mut self,
        number: u16,
        samples: &mut Vec<Sample>,
        ready: &mut VecDeque<Message>,
    ) -> u64 {
        let source = self.channel.source();
        if self.source.replace(source) != Some(source) {
            let (hz, unit) = (self.channel.hz(), self.channel.unit().to_owned());
            let told = ServerMessage::Subscribed { channel: number, hz, source, unit };
            ready.push_back(Message::Text(text(&told)));
        }
        samples.clear();
        let gap = self.channel.take(samples);
        if let Some(Gap { from_us, to_us, lost }) = gap {
            let told = ServerMessage::Gap { channel: number, from_us, to_us, lost };
            ready.push_back(Message::Text(text(&told)));
        }
        let mut rest = &samples[..];
        while !rest.is_empty() {
            let (bytes, count) = encode(number, self.channel.lost(), rest);
            ready.push_back(Message::Binary(bytes.into()));
            rest = &rest[count..];
        }
        gap.map_or(0, |gap| gap.lost)
    }
}
