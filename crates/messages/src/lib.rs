//! What goes over the wire between the gateway and whoever uses it: every body of the REST
//! interface, every message of the WebSocket, typed once.
//!
//! **Binding** for the server, the page and other clients, because the OpenAPI description and the
//! page's types are made from it:
//!
//! - Names of fields and tags, all in `snake_case`; what is `Option` may be `null`, and a client may
//!   leave it out.
//! - Quantities are SI, with the unit's word beside them. A value that is not known (a scale that was
//!   never read) is `null`, never `NaN`.
//! - `…_ms` without more is a time since 1970 in milliseconds, for people and for the age of commands;
//!   `…_us` counts from the server's start, which [`Welcome::t0_ms`] places in that time.
//! - An axis is its index in [`BenchView::axes`], a link its index in [`BenchView::links`]; both stay
//!   the same while the server runs. Drives that are taken in later come behind all others.
//! - An answer that is an error is [`ErrorBody`], whatever the path. [`Refused::executed`] says whether
//!   a drive may have done it.
//! - Epochs of leases only ever rise, over restarts too; 0 is nobody's.
//! - [`telemetry`] is the one binary message.
#![forbid(unsafe_code)]

mod axis;
mod bench;
mod capture;
mod command;
mod journal;
mod live;
mod look;
mod meeting;
mod refused;
pub mod scope;
pub mod telemetry;
#[cfg(test)]
mod tests;

pub use axis::{
    AxisState, Change, FaultTold, Given, LeaseTold, OwedWhy, PanelView, ParameterInfo,
    ParameterRead, SetWatchdog, SignalValue, StopOwed, WatchdogSet, WatchdogTold, WriteParameters,
};
pub use bench::{
    AbsentAxis, ActInfo, ArgumentInfo, AxisInfo, BenchView, Clash, Counter, LimitInfo, LinkState,
    LinkView, LockTold, SignalInfo, VerbInfo,
};
pub use capture::{CaptureOpened, CapturePage, ExplainedField, FrameDirection, FrameItem};
pub use command::{
    Act, Arguments, AxisStopped, CommandOrder, DismissAbsent, DismissReason, DismissStop, Ended,
    Epoch, LeaseGranted, Login, Outcome, Pace, Proof, RawOrder, Session, StopClass, StopOrder,
    Stopped, TTL_MS, TakeLease, Unreached,
};
pub use journal::{Deed, JournalRecord};
pub use live::{ClientMessage, LeaseAct, ServerMessage, Source, Welcome};
pub use look::{AskedAxis, DriveAt, FoundDrive, LookOrder, LookState, LookView, TakeIn, TakenIn};
pub use meeting::{PORT, PROOF_BYTES, PROTOCOL, fingerprint, of_digits, proof};
pub use refused::{ErrorBody, Refused};
pub use scope::{Scope, Scopes};
