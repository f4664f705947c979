//! Drives that a scan finds.

use polepair_core::profile::Profile;

use crate::axis::DeviceDetail;
use crate::identification::Identification;

/// A drive that answered.
#[derive(Clone, Debug)]
pub struct DetectedDrive {
    /// Address of the drive.
    pub number: u32,
    /// The word of the protocol that it answered to.
    pub protocol: &'static str,
    /// Profile of the product, or the protocol's generic profile.
    pub profile: &'static Profile,
    /// Source of the identification, with the firmware if known.
    pub identified: Identification,
    /// Set when more came back than was asked for: two drives may have this address.
    pub clash: Option<String>,
    /// True if it replies at every address, as modules on USB do.
    pub ignores_address: bool,
    /// Device information: see [`LocalAxis::device_details`](crate::LocalAxis::device_details).
    pub details: Vec<DeviceDetail>,
}
