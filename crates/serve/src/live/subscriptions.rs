//! Subscriptions of one viewer: telemetry channels and frames. Only the writer uses them, one message at a
//! time. Data wait in the bounded queues of the bench, so a slow viewer loses the oldest and is informed.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use tokio::time::{Interval, MissedTickBehavior, interval};
use tokio_tungstenite::tungstenite::Message;

use super::{error_message, to_json};
use crate::bench::{Bench, ChannelRequest, FrameSubscription, SampleGap, TelemetryChannel};
use crate::message::telemetry::{Sample, encode};
use crate::message::{GatewayError, SampleSource, ServerMessage};
use crate::metrics::Metrics;

/// Channels of one viewer.
const CHANNELS_MAX: usize = 64;
/// Frames of a message.
const FRAMES_MAX: usize = 250;
/// Messages of frames in a round.
const BATCHES_MAX: usize = 8;
/// Interval of sending new samples: 30 a second are smooth to the eye.
const SEND_INTERVAL: Duration = Duration::from_millis(33);

/// A change of subscriptions.
pub(super) enum SubscriptionRequest {
    Subscribe(u16, ChannelRequest),
    Unsubscribe(u16),
    /// Subscribes to frames of a filter.
    StartFrames(Option<String>),
    StopFrames,
    /// The fields of a frame.
    Explain(u64),
}

/// Subscriptions of a viewer. Dropping them ends all.
#[derive(Debug, Default)]
pub(super) struct Subscriptions {
    channels: BTreeMap<u16, ChannelSubscription>,
    frames: Option<FrameSubscription>,
}

/// A channel, and the state that was sent to the viewer.
#[derive(Debug)]
struct ChannelSubscription {
    channel: TelemetryChannel,
    source: Option<SampleSource>,
}

impl Subscriptions {
    /// Changes subscriptions, and returns the messages about it.
    pub fn handle_request(
        &mut self,
        bench: &Bench,
        subscription: SubscriptionRequest,
    ) -> Option<ServerMessage> {
        let (done, about, subject) = match subscription {
            SubscriptionRequest::Subscribe(number, request) => {
                (self.subscribe(bench, number, request), "subscribe", Some(number))
            }
            SubscriptionRequest::Unsubscribe(number) => {
                self.channels.remove(&number);
                return None;
            }
            SubscriptionRequest::StartFrames(filter) => {
                match self.start_frames(bench, filter.as_deref()) {
                    Ok(()) => return Some(ServerMessage::Frames { items: Vec::new(), lost: 0 }),
                    Err(refused) => (Err(refused), "frames", None),
                }
            }
            SubscriptionRequest::StopFrames => {
                self.frames = None;
                return None;
            }
            SubscriptionRequest::Explain(n) => match bench.explain_frame(n) {
                Ok(fields) => return Some(ServerMessage::Explained { n, fields }),
                Err(refused) => (Err(refused), "explain", None),
            },
        };
        done.err().map(|refused| error_message(refused, Some(about), subject))
    }

    /// Sends a channel from now on, instead of the one with its number.
    fn subscribe(
        &mut self,
        bench: &Bench,
        number: u16,
        request: ChannelRequest,
    ) -> Result<(), GatewayError> {
        if self.channels.len() >= CHANNELS_MAX && !self.channels.contains_key(&number) {
            let what = format!("a viewer has at most {CHANNELS_MAX} channels");
            return Err(GatewayError::new("gateway.limit", what).hint("unsubscribe from one"));
        }
        self.channels.insert(
            number,
            ChannelSubscription { channel: bench.open_channel(request)?, source: None },
        );
        Ok(())
    }

    /// Sends frames that a filter wants; no others, where some were sent before.
    fn start_frames(&mut self, bench: &Bench, filter: Option<&str>) -> Result<(), GatewayError> {
        match &mut self.frames {
            Some(frames) => frames.set_filter(filter)?,
            none => *none = Some(bench.subscribe_frames(filter)?),
        }
        Ok(())
    }

    fn is_empty(&self) -> bool {
        self.channels.is_empty() && self.frames.is_none()
    }
}

/// Goes round the subscriptions. Each message can be preceded by more urgent ones.
pub(super) struct SubscriptionRound {
    interval: Interval,
    ready: VecDeque<Message>,
    samples: Vec<Sample>,
    /// The channel, or the next one, whose turn it is; `None` once all had theirs.
    next_channel: Option<u16>,
    /// Messages of frames that may still be sent.
    batches: usize,
}

impl Default for SubscriptionRound {
    fn default() -> Self {
        let mut next = interval(SEND_INTERVAL);
        next.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (ready, samples) = (VecDeque::new(), Vec::new());
        Self { interval: next, ready, samples, next_channel: None, batches: 0 }
    }
}

impl SubscriptionRound {
    /// The next message. Where it is waited for no longer, nothing is lost.
    pub async fn next_message(
        &mut self,
        watched: &mut Subscriptions,
        metrics: &Metrics,
    ) -> Message {
        loop {
            if let Some(message) = self.ready.pop_front() {
                return message;
            }
            if self.queue_channel(watched, metrics) || self.queue_frames(watched, metrics) {
                continue;
            }
            if watched.is_empty() {
                // Until that changes there is no message.
                std::future::pending::<()>().await;
            }
            self.interval.tick().await;
            (self.next_channel, self.batches) = (Some(0), BATCHES_MAX);
        }
    }

    /// Makes the messages of the next channel. False when all had their turn.
    fn queue_channel(&mut self, watched: &mut Subscriptions, metrics: &Metrics) -> bool {
        let Some(from) = self.next_channel.take() else { return false };
        let Some((number, channel_subscription)) = watched.channels.range_mut(from..).next() else {
            return false;
        };
        self.next_channel = number.checked_add(1);
        let lost = channel_subscription.queue_messages(*number, &mut self.samples, &mut self.ready);
        metrics.dropped.inc_by(lost);
        true
    }

    /// Makes a message of frames. False when none are left, or too many.
    fn queue_frames(&mut self, watched: &mut Subscriptions, metrics: &Metrics) -> bool {
        if self.batches == 0 {
            return false;
        }
        self.batches -= 1;
        let taken = watched.frames.as_mut().map(|frames| frames.drain(FRAMES_MAX));
        let Some((items, lost)) = taken.filter(|(items, lost)| !items.is_empty() || *lost > 0)
        else {
            return false;
        };
        metrics.dropped.inc_by(lost);
        self.ready.push_back(Message::Text(to_json(&ServerMessage::Frames { items, lost })));
        true
    }
}

impl ChannelSubscription {
    /// Queues the source, if it is new, the gap, and the samples. Returns the number of lost samples.
    fn queue_messages(
        &mut self,
        number: u16,
        samples: &mut Vec<Sample>,
        ready: &mut VecDeque<Message>,
    ) -> u64 {
        let source = self.channel.source();
        if self.source.replace(source) != Some(source) {
            let (hz, unit) = (self.channel.hz(), self.channel.unit().to_owned());
            let message = ServerMessage::Subscribed { channel: number, hz, source, unit };
            ready.push_back(Message::Text(to_json(&message)));
        }
        samples.clear();
        let gap = self.channel.drain_into(samples);
        if let Some(SampleGap { from_us, to_us, lost }) = gap {
            let message = ServerMessage::Gap { channel: number, from_us, to_us, lost };
            ready.push_back(Message::Text(to_json(&message)));
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
