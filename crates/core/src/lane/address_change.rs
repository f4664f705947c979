//! Writes that change an address: the checks before a byte is sent.

use super::Lane;
use crate::error::Unsupported;
use crate::medium::Medium;
use crate::profile::{AddressRole, Parameter};
use crate::proto::drive_address;
use crate::station::{AxisIndex, Host};

const HOST_ADDRESS: &str = "that is the address of this host, which the drives answer: a drive that has it \
                    could not be asked any more";
const ADDRESS_TAKEN: &str =
    "another drive of this link has that address: both would answer at once";
const DRIVE_ADDRESS: &str =
    "a drive of this link has that address: answers would look like requests to it";

impl<M: Medium, H: Host<M>> Lane<M, H> {
    /// Changes of the drive's address by a write, in force at once. Refuses an address at which the drive could not be
    /// reached any more, or which another one has.
    pub(super) fn check_address_change(
        &self,
        axis: AxisIndex,
        parameter: &Parameter,
        raw: i64,
    ) -> Result<Option<AddressRole>, Unsupported> {
        let driver = &self.slot(axis)?.driver;
        let Some(readdress) = driver.address_role(parameter) else { return Ok(None) };
        let Ok(address) = u32::try_from(raw) else { return Ok(Some(readdress)) };
        // The address belongs to the drive: all of its axes change together.
        let own = drive_address(driver.address());
        let drives = || self.slots.iter().map(|slot| drive_address(slot.driver.address()));
        let has = |address: u32| drives().any(|other| other == address);
        match readdress {
            AddressRole::Drive | AddressRole::DriveAfterRestart
                if Some(address) == self.host.own_address() =>
            {
                Err(Unsupported::Forbidden(HOST_ADDRESS))
            }
            AddressRole::Drive | AddressRole::DriveAfterRestart
                if address != own && has(address) =>
            {
                Err(Unsupported::Forbidden(ADDRESS_TAKEN))
            }
            AddressRole::Host if has(address) => Err(Unsupported::Forbidden(DRIVE_ADDRESS)),
            _ => Ok(Some(readdress)),
        }
    }
}
