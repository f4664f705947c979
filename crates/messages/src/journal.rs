//! A record of the journal.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One record of the journal: what was about to be done, written before it was done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JournalRecord {
    /// From 0, without gaps.
    pub n: u64,
    /// When.
    pub ms: f64,
    /// The session; `server` for what nobody asked for.
    pub who: String,
    /// What.
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

/// What a record of the journal is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JournalAction {
    /// The server began; the detail says with which links and scopes.
    Started,
    /// The server ended by itself.
    Ended,
    /// A link could not be opened, or was opened later: the detail says which, and why not.
    Link,
    /// Somebody came in, or failed to.
    Login,
    /// An axis got an owner.
    Lease,
    /// An axis got another owner against the first one's will.
    TakeOver,
    /// A lease ended: given back, expired, revoked.
    LeaseEnded,
    /// A command goes out.
    Command,
    /// What came of a command, a write or a stop.
    Outcome,
    /// Parameters are written.
    Parameters,
    /// A stop goes out.
    Stop,
    /// An axis is owed a stop from now on: the detail says why, by which link and number it is found.
    StopOwed,
    /// It is owed none any more: the detail says how that is known, or who dismissed it and why.
    StopEnded,
    /// Motion is let again.
    Release,
    /// Somebody looks for drives on a link.
    Look,
    /// Drives that were found become axes.
    TakeIn,
    /// A drive was had to watch this server's heartbeat: the detail says how its watchdog was, and is.
    Watchdog,
    /// A simulated drive or its time is meddled with.
    Simulation,
    /// What was done here and could not be written: the detail says how many records, and why.
    Missing,
}
