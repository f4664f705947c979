//! The WebSocket: a task that renews leases, receives data, and ends when the server is gone.

mod cache;
mod lease_requests;
mod socket_task;

use std::future::poll_fn;
use std::sync::Arc;
use std::sync::atomic::{AtomicU16, Ordering};
use std::task::{Poll, Waker};
use std::time::Duration;

use polepair_core::time::Instant;
use polepair_messages::telemetry::Sample;
use polepair_messages::{
    AxisInfo, AxisState, AxisStopReport, CommandRequest, FrameItem, LeaseAction, LinkView,
    MotionLock, SampleSource,
};
use tokio::sync::{mpsc, oneshot};
use tokio::time::timeout;

use crate::dialer::Dialer;
use crate::failure::{action_error, query_error, server_lost};
use crate::{Gateway, GatewayError};
pub(crate) use cache::{FrameBuffer, LiveCache, SampleBuffer};

/// Time limit of the server's reply to a lease or a subscription. An axis that is busy delays it.
const REPLY_MAX: Duration = Duration::from_secs(15);
/// Queue length of requests.
const REQUESTS_MAX: usize = 256;

/// A lasting connection for leases and telemetry. Cheap to clone; leases and subscriptions end with the
/// last clone.
#[derive(Debug, Clone)]
pub struct LiveConnection(Arc<LiveInner>);

#[derive(Debug)]
struct LiveInner {
    gateway: Gateway,
    requests: mpsc::Sender<LiveRequest>,
    cache: Arc<LiveCache>,
    channels: AtomicU16,
}

/// A request to the task, with the receiver of its result.
#[derive(Debug)]
pub(crate) enum LiveRequest {
    Command {
        axis: u16,
        request: CommandRequest,
        reply: ResponseSender<()>,
    },
    Lease {
        axis: u16,
        act: LeaseAction,
        epoch: u64,
        reply: ResponseSender<u64>,
    },
    Subscribe {
        channel: u16,
        spec: ChannelSpec,
        buffer: Arc<SampleBuffer>,
        reply: ResponseSender<ChannelInfo>,
    },
    Frames {
        filter: Option<String>,
        buffer: Arc<FrameBuffer>,
    },
}

impl LiveRequest {
    /// Reports to the caller that it was not sent.
    fn fail(self, why: GatewayError) {
        // The receiver may have been dropped.
        match self {
            Self::Command { reply, .. } => drop(reply.send(Err(why))),
            Self::Lease { reply, .. } => drop(reply.send(Err(why))),
            Self::Subscribe { reply, .. } => drop(reply.send(Err(why))),
            Self::Frames { buffer, .. } => buffer.fail(why),
        }
    }
}

pub(crate) type ResponseSender<T> = oneshot::Sender<Result<T, GatewayError>>;

/// Channel to watch, with its interval.
#[derive(Debug, Clone)]
pub(crate) struct ChannelSpec {
    pub axis: u16,
    pub signal: Option<String>,
    pub parameter: Option<String>,
    pub hz: f64,
}

/// The server's description of a subscription.
#[derive(Debug, Clone)]
pub(crate) struct ChannelInfo {
    pub hz: f64,
    pub source: SampleSource,
    pub unit: String,
}

impl LiveConnection {
    pub(crate) async fn open(gateway: Gateway, wire: Dialer) -> Result<Self, GatewayError> {
        let (request_sender, requests) = mpsc::channel(REQUESTS_MAX);
        let known = socket_task::spawn_task(&wire, requests).await?;
        let channels = AtomicU16::new(0);
        Ok(Self(Arc::new(LiveInner { gateway, requests: request_sender, cache: known, channels })))
    }

    /// The server.
    #[must_use]
    pub fn gateway(&self) -> &Gateway {
        &self.0.gateway
    }

    /// Name of this client in leases and in the journal.
    #[must_use]
    pub fn session(&self) -> &str {
        &self.0.cache.session
    }

    /// Checks that the server is connected.
    ///
    /// # Errors
    /// The reason if not.
    pub fn check(&self) -> Result<(), GatewayError> {
        self.cache().check_connected()
    }

    /// Time since the last message of the server, which is polled twice a second.
    #[must_use]
    pub fn silence(&self) -> Duration {
        self.cache().silence()
    }

    /// Watches a signal, or a parameter, at this rate or the highest possible.
    ///
    /// # Errors
    /// The error of the server.
    pub fn subscribe(
        &self,
        axis: u16,
        signal: Option<&str>,
        parameter: Option<&str>,
        hz: f64,
    ) -> Result<SampleStream, GatewayError> {
        let channel = self.0.channels.fetch_add(1, Ordering::Relaxed);
        let (signal, parameter) = (signal.map(str::to_owned), parameter.map(str::to_owned));
        let what = ChannelSpec { axis, signal, parameter, hz };
        let sample_buffer = Arc::<SampleBuffer>::default();
        let (reply_sender, receiver) = oneshot::channel();
        self.send_request(LiveRequest::Subscribe {
            channel,
            spec: what,
            buffer: Arc::clone(&sample_buffer),
            reply: reply_sender,
        })?;
        let about = self.await_reply(receiver).map_err(query_error)?;
        Ok(SampleStream { live: self.clone(), axis, buffer: sample_buffer, info: about })
    }

    /// Subscribes to frames on the server's links that match a filter in the analyser's language. A new
    /// subscription replaces the earlier one.
    ///
    /// # Errors
    /// `E313` without a server.
    pub fn subscribe_frames(&self, filter: Option<&str>) -> Result<FrameStream, GatewayError> {
        let (filter, frame_buffer) = (filter.map(str::to_owned), Arc::<FrameBuffer>::default());
        self.send_request(LiveRequest::Frames { filter, buffer: Arc::clone(&frame_buffer) })?;
        Ok(FrameStream { live: self.clone(), buffer: frame_buffer })
    }

    /// The last state of an axis that the server sent, with the present age of its values; `None` before the
    /// first one. Nothing is requested.
    ///
    /// # Errors
    /// `E313` without a server.
    pub fn state(&self, axis: u16) -> Result<Option<AxisState>, GatewayError> {
        self.cache().check_connected()?;
        Ok(self.cache().state(axis))
    }

    /// Checks that the server is connected and has the link of an axis.
    ///
    /// # Errors
    /// `E313` names the missing link.
    pub fn check_link(&self, axis: u16) -> Result<(), GatewayError> {
        self.cache().check_link(axis)
    }

    /// The links of the server, by its last message.
    #[must_use]
    pub fn links(&self) -> Vec<LinkView> {
        self.cache().links()
    }

    /// Axes of the server from index `first` on: some join later.
    #[must_use]
    pub fn axes_from(&self, first: usize) -> Vec<AxisInfo> {
        self.cache().axes_from(first)
    }

    /// The lock of motion, if any.
    #[must_use]
    pub fn motion_lock(&self) -> Option<MotionLock> {
        self.cache().motion_lock()
    }

    /// Progress of the last stop of an axis since the connection, with its time.
    #[must_use]
    pub fn last_stop(&self, axis: u16) -> Option<(AxisStopReport, Instant)> {
        self.cache().last_stop(axis)
    }

    pub(crate) fn cache(&self) -> &LiveCache {
        &self.0.cache
    }

    pub(crate) fn send_request(&self, request: LiveRequest) -> Result<(), GatewayError> {
        let sent = self.gateway().block_on(self.0.requests.send(request));
        sent.map_err(|_| GatewayError { executed: Some(false), ..self.cache().disconnect_reason() })
    }

    pub(crate) fn request_lease(
        &self,
        axis: u16,
        act: LeaseAction,
        epoch: u64,
    ) -> Result<u64, GatewayError> {
        let (reply_sender, receiver) = oneshot::channel();
        self.send_request(LiveRequest::Lease { axis, act, epoch, reply: reply_sender })?;
        self.await_reply(receiver)
    }

    /// Gives a lease back without waiting. One that was given back already is not ours any more.
    pub(crate) fn release_lease(&self, axis: u16, epoch: u64) {
        if self.cache().end_lease(axis, epoch) {
            let (reply_sender, _) = oneshot::channel();
            // If the release cannot be sent, the lease is not renewed, and ends by itself.
            let _ = self.0.requests.try_send(LiveRequest::Lease {
                axis,
                act: LeaseAction::Drop,
                epoch,
                reply: reply_sender,
            });
        }
    }

    fn await_reply<T>(
        &self,
        reply: oneshot::Receiver<Result<T, GatewayError>>,
    ) -> Result<T, GatewayError> {
        // A late reply finds no waiter and is dropped.
        let result = self.gateway().block_on(async { timeout(REPLY_MAX, reply).await });
        result
            .ok()
            .and_then(Result::ok)
            .unwrap_or_else(|| Err(action_error(server_lost("no answer came"))))
    }
}

/// A stream of frames, until it is dropped.
#[derive(Debug)]
pub struct FrameStream {
    live: LiveConnection,
    buffer: Arc<FrameBuffer>,
}

impl FrameStream {
    /// Takes the frames since the last call, and the number of frames lost so far.
    ///
    /// # Errors
    /// `E313` without a server; `gateway.request` for an invalid filter.
    pub fn drain(&self) -> Result<(Vec<FrameItem>, u64), GatewayError> {
        self.live.cache().check_connected()?;
        self.buffer.drain()
    }
}

/// Something that is watched, until this is dropped.
#[derive(Debug)]
pub struct SampleStream {
    live: LiveConnection,
    axis: u16,
    buffer: Arc<SampleBuffer>,
    info: ChannelInfo,
}

impl SampleStream {
    /// Highest rate of samples.
    #[must_use]
    pub const fn hz(&self) -> f64 {
        self.info.hz
    }

    /// Source of the samples: sent by the drive, or polled.
    #[must_use]
    pub const fn source(&self) -> SampleSource {
        self.info.source
    }

    /// SI unit of the samples; empty without one.
    #[must_use]
    pub fn unit(&self) -> &str {
        &self.info.unit
    }

    /// The last sample, unless it is older than `within`.
    ///
    /// # Errors
    /// `E313` without a server, or without the axis' link.
    pub fn last(&self, within: Duration) -> Result<Option<Sample>, GatewayError> {
        self.live.cache().check_link(self.axis)?;
        Ok(self.buffer.last(within))
    }

    /// True when there is a sample that was not drained, or the server or the axis' link is gone; else
    /// `waker` is woken once there is.
    pub fn poll_ready(&self, waker: &Waker) -> bool {
        self.is_ready(&self.live.gateway().detached_waker(waker))
    }

    fn is_ready(&self, waker: &Waker) -> bool {
        // Registered before the check, so that an end in between is not missed.
        self.buffer.poll_ready(waker) || self.live.cache().check_link(self.axis).is_err()
    }

    /// Waits for a sample, at most for this time.
    pub fn wait(&self, within: Duration) {
        let ready =
            poll_fn(
                |context| {
                    if self.is_ready(context.waker()) { Poll::Ready(()) } else { Poll::Pending }
                },
            );
        // After a timeout there is nothing to drain.
        let _ = self.live.gateway().block_on(async { timeout(within, ready).await });
    }

    /// Takes the samples since the last call, and the number of samples lost so far.
    ///
    /// # Errors
    /// `E313` without a server, or without the axis' link.
    pub fn drain(&self) -> Result<(Vec<Sample>, u64), GatewayError> {
        self.live.cache().check_link(self.axis)?;
        Ok(self.buffer.drain())
    }
}
