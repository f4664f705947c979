//! Scans of an open link: `/api/v1/links/{id}/look`, and `look` on the WebSocket.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::GatewayError;

/// Which addresses are to be asked.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ScanRequest {
    /// From this address on; with `last` alone `null` all that the link's protocols have.
    #[serde(default)]
    pub first: Option<u32>,
    /// To this one; `first` alone where it is `null`.
    #[serde(default)]
    pub last: Option<u32>,
}

/// A look for drives on a link: under way, or the last one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ScanView {
    /// On which link.
    pub link: u16,
    /// The session that wanted it.
    pub by: String,
    /// When it began.
    pub began_ms: f64,
    /// State of the scan.
    pub state: ScanState,
    /// The address that is asked now; `null` before the first and after the last.
    #[schema(required)]
    pub number: Option<u32>,
    /// Addresses of this protocol that were asked.
    pub done: u32,
    /// Addresses of this protocol in all.
    pub of: u32,
    /// Found drives that were not axes at the start. Sent at the end.
    pub found: Vec<FoundDrive>,
    /// Axes of the link, and whether they replied. Sent at the end.
    pub axes: Vec<ProbedAxis>,
    /// Attempts, in sentences.
    pub tried: Vec<String>,
    /// Addresses that were not asked because it was broken off.
    pub unasked: u32,
    /// A CANopen device without node-ID answered. Known when it has ended.
    #[serde(default)]
    pub has_unconfigured: bool,
    /// Why it failed; `null` where it did not.
    #[schema(required)]
    pub error: Option<GatewayError>,
}

/// State of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ScanState {
    /// Addresses are being asked.
    UnderWay,
    /// All were asked.
    Done,
    /// A client cancelled it, or stopped an axis of the link.
    BrokenOff,
    /// The link was lost, or was not free for a moment.
    Failed,
}

/// A drive that answered.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FoundDrive {
    /// Address of the drive.
    pub number: u32,
    /// The protocol's word.
    pub protocol: String,
    /// The profile's word.
    pub profile: String,
    /// The product's full name.
    pub drive: String,
    /// Source of the identification, with the firmware if known.
    pub known: String,
    /// Device information: name, versions, motors; may be empty.
    pub reported: String,
    /// The device with the same address or identifier, in a sentence; `null` if there is none.
    #[schema(required)]
    pub clash: Option<String>,
    /// The axis that it is since it was taken in.
    #[schema(required)]
    pub axis: Option<u16>,
}

/// An axis that was asked whether it is there.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ProbedAxis {
    /// Index among the axes.
    pub axis: u16,
    /// True if it replied.
    pub answers: bool,
    /// Why another drive may have its address, in a sentence; `null` where nothing shows that.
    #[schema(required)]
    pub clash: Option<String>,
}

/// Which of the drives that were found become axes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct AddDrives {
    /// These; all that are no axes yet where none is named.
    #[serde(default)]
    pub drives: Vec<DriveAddress>,
}

/// A drive by its address.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct DriveAddress {
    /// The protocol's word.
    pub protocol: String,
    /// Address of the drive.
    pub number: u32,
}

/// Drives that became axes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct AddedAxes {
    /// Their indices among the axes, in the order in which they were found.
    pub axes: Vec<u16>,
}
