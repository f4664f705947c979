//! Searches of ports of unknown protocol and rate: `/api/v1/search`, and `search` on the WebSocket.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{GatewayError, ScanState};

/// Which ports are searched.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SearchRequest {
    /// Ports of the server's machine, such as `/dev/ttyUSB0`. Without any, all that no link uses.
    #[serde(default)]
    pub ports: Vec<String>,
}

/// A search under way, or the last one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SearchView {
    /// The session that wanted it.
    pub by: String,
    /// When it began.
    pub began_ms: f64,
    /// State of the search.
    pub state: ScanState,
    /// The present attempt, such as `/dev/ttyUSB0: modbus-rtu at 19200 baud`. Empty before the first and after the
    /// last.
    pub step: String,
    /// Attempts that were made.
    pub done: u32,
    /// Attempts in all.
    pub of: u32,
    /// Found drives. Sent at the end.
    pub found: Vec<SearchedDrive>,
    /// Ports on which none was found. Sent at the end.
    pub silent: Vec<SearchedPort>,
    /// Why it failed; `null` where it did not.
    #[schema(required)]
    pub error: Option<GatewayError>,
}

/// A drive that replied.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SearchedDrive {
    /// Connection string of the drive: `tmcl+serial:///dev/ttyUSB0:9600#1`.
    pub url: String,
    /// The profile's word.
    pub profile: String,
    /// The product's full name.
    pub drive: String,
    /// Device information: name, versions, motors; may be empty.
    pub reported: String,
}

/// A port on which no drive was found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SearchedPort {
    /// The port.
    pub port: String,
    /// Why it could not be asked; `null` if it was.
    #[schema(required)]
    pub error: Option<String>,
    /// Attempts: protocols, rates and addresses.
    pub tried: String,
    /// Attempts to which something replied that was no valid frame.
    pub damaged: Vec<String>,
}
