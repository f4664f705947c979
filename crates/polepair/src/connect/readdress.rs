//! Changes the address or host address of drives while their link is open.

use crate::axis::LocalAxis;
use crate::error::Error;
use crate::url::Url;
use polepair_core::profile::{AddressRole, ParameterId};

impl LocalAxis {
    /// Change of the drive's address by a write of a parameter, if it has one. This axis then reaches no drive:
    /// [`Url::readdressed`] has the new address.
    ///
    /// ```
    /// use polepair_core::profile::AddressRole;
    /// let link = polepair::connect_local("sim:tmcl?time=virtual")?;
    /// let axis = &link.axes()[0];
    /// assert_eq!(axis.readdress_effect(axis.find("module address")?, 7)?, Some(AddressRole::Drive));
    /// // 2 is whom the module answers: it could not be asked any more. Nothing is sent.
    /// assert_eq!(axis.set_raw("module address", 2).unwrap_err().code(), "E222");
    /// # Ok::<(), polepair::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Unsupported`] `E222` for an address at which the drive could not be reached any more.
    pub fn readdress_effect(
        &self,
        id: ParameterId,
        raw: i64,
    ) -> Result<Option<AddressRole>, Error> {
        let readdressed =
            self.connection.with_axes(|axes, _| axes.address_change(self.index, id, raw));
        let name = self.profile.parameter(id).map_or("it", |parameter| parameter.name);
        readdressed
            .map_err(|why| self.unsupported_error(&format!("setting `{name}` to {raw}"), why))
    }
}

impl Url {
    /// The string that reaches a drive of this one, which had the number `axis`, once it has another
    /// address or answers another host.
    ///
    /// ```
    /// use polepair_core::profile::AddressRole::{Host, Drive};
    /// let url: polepair::url::Url = "tmcl+serial:///dev/ttyUSB0#1,3".parse()?;
    /// assert_eq!(url.readdressed(1, Drive, 7).to_string(), "tmcl+serial:///dev/ttyUSB0#7,3");
    /// let moved = url.readdressed(1, Host, 9);
    /// assert_eq!(moved.to_string(), "tmcl+serial:///dev/ttyUSB0?host=9#1,3");
    /// # Ok::<(), polepair::Error>(())
    /// ```
    #[must_use]
    pub fn readdressed(&self, axis: u32, what: AddressRole, address: u32) -> Self {
        let mut url = self.clone();
        match what {
            AddressRole::Drive | AddressRole::DriveAfterRestart if url.axes.is_empty() => {
                url.axes = vec![address];
            }
            AddressRole::Drive | AddressRole::DriveAfterRestart => {
                let numbers = url.axes.iter_mut().filter(|number| **number == axis);
                numbers.for_each(|number| *number = address);
            }
            AddressRole::Host => {
                url.keys.retain(|(key, _)| key != "host");
                url.keys.push(("host".to_owned(), address.to_string()));
            }
        }
        url
    }
}
