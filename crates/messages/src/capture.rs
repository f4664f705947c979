//! Frames, live or of an uploaded capture.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A frame, explained in a line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FrameItem {
    /// Number of the frame, from 0; `explain` asks by it.
    pub n: u64,
    /// When: since the server's start, in a capture since its first frame.
    pub t_us: f64,
    /// The link; in a capture an index into [`OpenedCapture::links`].
    pub link: u16,
    /// Sender of the frame; `null` if unknown.
    #[schema(required)]
    pub dir: Option<FrameDirection>,
    /// Bytes of the frame in hexadecimal; on CAN `30B#5443` as in candump's log.
    pub raw: String,
    /// Meaning of the frame.
    pub text: String,
    /// The protocol's word; empty where none fits.
    pub protocol: String,
    /// The address that it concerns.
    #[schema(required)]
    pub axis: Option<u32>,
    /// True if it follows its protocol.
    pub ok: bool,
}

/// Sender of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrameDirection {
    /// The host, to a drive.
    Tx,
    /// A drive, to the host.
    Rx,
}

/// A field of a frame.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ExplainedField {
    /// First byte of the field, from 0.
    pub from: u16,
    /// The byte after its last; `from` for a field of the CAN identifier.
    pub to: u16,
    /// The protocol's name for it.
    pub name: String,
    /// Value of the field as text.
    pub value: String,
    /// Meaning of the value; empty without a name for it.
    pub meaning: String,
}

/// A capture that was taken in: `POST /api/v1/captures`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct OpenedCapture {
    /// For [`CapturePage`]s; good until the server ends or newer captures push it out.
    pub id: String,
    /// The file's name, as it was given.
    pub name: String,
    /// The format that it was found to have.
    pub format: String,
    /// Links of the capture.
    pub links: Vec<String>,
    /// Summary of the capture, as `polepair summary` prints it.
    pub summary: String,
    /// Parts that could not be read or are doubtful, as `polepair decode` prints them.
    pub remarks: Vec<String>,
    /// First frames of the capture.
    pub page: CapturePage,
}

/// Some frames of a capture: `GET /api/v1/captures/{id}?from&count&filter`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CapturePage {
    /// The capture.
    pub id: String,
    /// Number of the first frame that was looked at.
    pub from: u64,
    /// Number of the first frame of the next page; `null` at the end.
    #[schema(required)]
    pub next: Option<u64>,
    /// Frames in the whole capture.
    pub total: u64,
    /// Frames that pass the filter.
    pub items: Vec<FrameItem>,
}
