//! Messages between the gateway and its clients: every body of the REST interface, every message of the WebSocket,
//! typed once.
//!
//! **Binding** for the server, the page and other clients, because the OpenAPI description and the
//! page's types are made from it:
//!
//! - Names of fields and tags, all in `snake_case`; an `Option` may be `null`, and a client may
//!   leave it out.
//! - Quantities are SI, with the unit's word beside them. A value that is not known (a scale that was
//!   never read) is `null`, never `NaN`.
//! - `…_ms` without more is a time since 1970 in milliseconds, for people and for the age of commands;
//!   `…_us` counts from the server's start, which [`Welcome::t0_ms`] places in that time.
//! - An axis is its index in [`BenchView::axes`], a link its index in [`BenchView::links`]; both stay
//!   the same while the server runs. Drives that are taken in later come behind all others.
//! - A reply that is an error is [`ErrorBody`] on every path. [`GatewayError::executed`] states whether a drive may
//!   have executed the request.
//! - Epochs of leases only ever rise, over restarts too; 0 means no lease.
//! - [`telemetry`] is the one binary message.
#![forbid(unsafe_code)]

mod axis;
mod bench;
mod capture;
mod command;
mod error;
mod handshake;
mod journal;
mod live;
mod paths;
mod scan;
pub mod scope;
mod search;
pub mod telemetry;
#[cfg(test)]
mod tests;

pub use axis::{
    ActiveFault, AxisState, DeviceDetailView, DriveLogVariable, DriveLogView, LeaseView, PanelView,
    ParameterChange, ParameterInfo, ParameterInput, ParameterReading, PendingStopView, ProgramLine,
    ProgramState, ProgramView, RecordDriveLog, SetWatchdog, SignalValue, StopCause, WatchdogMode,
    WatchdogView, WriteParameters,
};
pub use bench::{
    AbsentAxis, ArgumentInfo, AxisInfo, BenchView, Clash, DriveLogInfo, LimitInfo, LinkCounter,
    LinkState, LinkView, MotionLock, SignalInfo, SimulationActionInfo, VerbInfo,
};
pub use capture::{CapturePage, ExplainedField, FrameDirection, FrameItem, OpenedCapture};
pub use command::{
    AcquireLease, AxisStopReport, CommandArguments, CommandOutcome, CommandRequest, DEFAULT_TTL_MS,
    DismissAbsent, DismissReason, DismissStop, LeaseEpoch, LeaseGrant, Login, OutcomeKind, Proof,
    RawRequest, SessionInfo, SetTimeScale, SimulationAction, StopClass, StopReport, StopRequest,
    UnreachedTarget,
};
pub use error::{ErrorBody, GatewayError};
#[cfg(feature = "tls")]
pub use handshake::certificate_fingerprint;
pub use handshake::{PORT, PROOF_BYTES, WEBSOCKET_PROTOCOL, parse_hex, token_proof};
pub use journal::{JournalAction, JournalRecord};
pub use live::{ClientMessage, LeaseAction, SampleSource, ServerMessage, Welcome};
pub use paths::{
    PathChangeMessage, PathFindingMessage, PathPlan, PathRow, PathTableMessage, PlanPaths,
    PreviewPointMessage,
};
pub use scan::{
    AddDrives, AddedAxes, DriveAddress, FoundDrive, ProbedAxis, ScanRequest, ScanState, ScanView,
};
pub use scope::{Scope, Scopes};
pub use search::{SearchRequest, SearchView, SearchedDrive, SearchedPort};
