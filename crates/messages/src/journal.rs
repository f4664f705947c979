//! A record of the journal.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One record of the journal: an act, written before it is done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JournalRecord {
    /// From 0, without gaps.
    pub n: u64,
    /// When.
    pub ms: f64,
    /// The session; `server` for actions of the server itself.
    pub who: String,
    /// Action of the record.
    pub deed: JournalAction,
    /// The axis that it concerns.
    #[schema(required)]
    pub axis: Option<u16>,
    /// The rest: verb, arguments, old and new values, outcome.
    #[schema(value_type = Object)]
    pub detail: serde_json::Value,
    /// BLAKE3 of the record before's hash and of this record without its hash, in hexadecimal.
    pub hash: String,
}

/// Action that a record of the journal documents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JournalAction {
    /// The server started; the detail has its links and scopes.
    Started,
    /// The server ended by itself.
    Ended,
    /// A link could not be opened, or was opened later; the detail has the link and the reason.
    Link,
    /// A login, or a failed one.
    Login,
    /// An axis got an owner.
    Lease,
    /// An axis got another owner against the first one's will.
    TakeOver,
    /// A lease ended: given back, expired, revoked.
    LeaseEnded,
    /// A command goes out.
    Command,
    /// The result of a command, a write or a stop.
    Outcome,
    /// Parameters are written.
    Parameters,
    /// A stop goes out.
    Stop,
    /// A stop became pending; the detail has the reason, link and number.
    StopPending,
    /// A pending stop ended; the detail has the confirmation, or the client and reason of the dismissal.
    StopEnded,
    /// Motion is allowed again.
    Release,
    /// A scan of a link started.
    Look,
    /// Drives that were found become axes.
    TakeIn,
    /// A drive was set to monitor this server's heartbeat; the detail has the earlier and the new watchdog
    /// setting.
    Watchdog,
    /// A simulated drive or its time is meddled with.
    Simulation,
    /// Records that could not be written; the detail has their number and the reason.
    Missing,
}
