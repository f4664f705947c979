//! The messages of the WebSocket: JSON texts with a `type`.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    AxisState, BenchView, CommandOutcome, CommandRequest, DismissStop, ExplainedField, FrameItem,
    GatewayError, MotionLock, ScanView, SearchView, StopReport, StopRequest,
};
use crate::scope::Scope;

/// Client to server.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ClientMessage {
    /// Send this signal or parameter from now on, as binary [`telemetry`](super::telemetry). A channel
    /// that is in use is subscribed anew.
    Subscribe {
        /// The client's number for it.
        channel: u16,
        /// Id of the axis.
        axis: u16,
        /// A signal's word; else `parameter` is there.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        signal: Option<String>,
        /// A parameter's name.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        parameter: Option<String>,
        /// Requested rate; the reply has the actual one.
        hz: f64,
    },
    /// No more.
    Unsubscribe {
        /// The client's number for it.
        channel: u16,
    },
    /// Send frames from now on, or no more.
    Frames {
        /// True to begin, false to end.
        on: bool,
        /// Which, in the analyser's language; `null` for all.
        #[serde(default)]
        filter: Option<String>,
    },
    /// Take a frame apart.
    Explain {
        /// Number of the frame.
        n: u64,
    },
    /// Move, arm, clear.
    Command {
        /// Which axis.
        axis: u16,
        /// The command.
        #[serde(flatten)]
        command: CommandRequest,
    },
    /// Something about a lease.
    Lease {
        /// Id of the axis.
        axis: u16,
        /// Action on the lease.
        act: LeaseAction,
        /// Epoch of the lease that is renewed or dropped.
        #[serde(default)]
        epoch: u64,
    },
    /// Stop.
    Stop(StopRequest),
    /// Owe an axis its stop no more.
    Dismiss {
        /// Which axis.
        axis: u16,
        /// Why.
        #[serde(flatten)]
        dismiss: DismissStop,
    },
    /// Let motion again.
    Release,
    /// Are you there?
    Ping {
        /// Comes back as it is.
        client_ms: f64,
    },
}

/// Action on a lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LeaseAction {
    /// Acquire it, if no other client has it.
    Take,
    /// Take it over from any client.
    TakeOver,
    /// To keep it.
    Renew,
    /// To give it back.
    Drop,
}

/// Server to client.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ServerMessage {
    /// The first message.
    Welcome(Welcome),
    /// The bench changed: always the whole of it. Also the second message.
    Bench(BenchView),
    /// An axis changed: all of its state, at most ten times a second. Each axis once after `bench`.
    Axis(AxisState),
    /// The answer to `subscribe`, before the first sample. Comes again when the source changes.
    Subscribed {
        /// The client's number for it.
        channel: u16,
        /// Highest rate of the samples, Hz.
        hz: f64,
        /// Source of the samples.
        source: SampleSource,
        /// SI unit; empty without one.
        unit: String,
    },
    /// Samples that the client did not get.
    Gap {
        /// The client's number for it.
        channel: u16,
        /// First sample lost.
        from_us: u64,
        /// Last sample lost.
        to_us: u64,
        /// Number of lost messages.
        lost: u64,
    },
    /// The answer to `command`.
    Outcome(CommandOutcome),
    /// The answer to `lease`.
    Leased {
        /// Id of the axis.
        axis: u16,
        /// Epoch that commands must carry.
        epoch: u64,
        /// When it ends unless it is renewed; `null` when it was given back.
        #[schema(required)]
        expires_ms: Option<f64>,
    },
    /// Axes were stopped by any client. Repeated for an axis whose class changes.
    Stopped(StopReport),
    /// The reply to `dismiss`: the axis has no pending stop.
    Dismissed {
        /// Which axis.
        axis: u16,
    },
    /// Motion is locked.
    Locked(MotionLock),
    /// Motion is allowed again.
    Unlocked,
    /// Progress of a scan, at most ten times a second; its end is always sent.
    Look(ScanView),
    /// Progress of a search of ports, at most ten times a second; its end is always sent.
    Search(SearchView),
    /// Frames. A message without frames answers `frames`: those that follow pass the new filter.
    Frames {
        /// Frames in order.
        items: Vec<FrameItem>,
        /// Frames that were dropped before the first of them because the client was slow.
        lost: u64,
    },
    /// The answer to `explain`.
    Explained {
        /// The frame's number.
        n: u64,
        /// Fields of the frame, in order.
        fields: Vec<ExplainedField>,
    },
    /// The answer to `ping`.
    Pong {
        /// Time of the request, repeated.
        client_ms: f64,
        /// The server's time.
        server_ms: f64,
    },
    /// A message that could not be carried out, and that is no command.
    Error {
        /// Why.
        error: GatewayError,
        /// `type` of the message; `null` where it could not be read.
        #[schema(required)]
        about: Option<String>,
        /// The channel of a `subscribe`, the axis of a `lease` or a `dismiss`.
        #[schema(required)]
        subject: Option<u16>,
    },
}

/// The identity of the client, and the relation of the clocks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Welcome {
    /// The server's time now.
    pub server_ms: f64,
    /// When `…_us` began.
    pub t0_ms: f64,
    /// The client's name for leases and the journal.
    pub session: String,
    /// Scopes of the connection.
    pub scopes: Vec<Scope>,
    /// Duration of a lease that is not renewed.
    pub lease_ms: u32,
}

/// Source of a channel's samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SampleSource {
    /// The drive sends them by itself.
    Pushed,
    /// The server asks for each.
    Polled,
}
