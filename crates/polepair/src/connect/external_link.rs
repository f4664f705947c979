//! Links that the calling program provides.

use super::{Connector, LocalLink};
use crate::error::Error;
use crate::url::{self, LinkTarget, Url};
use crate::wire::AnyLink;

impl Connector {
    /// Identifies the drives on a link that the caller opened: any adapter becomes one that polepair can use.
    /// `protocol`, `axes` and `query` (`profile=tmcm-171&timeout=50`) are parts of a connection string.
    ///
    /// ```
    /// let connector = polepair::Connector::default();
    /// let wire = connector.open("sim:tmcl+can:3?time=virtual")?.remove(0);
    /// let link = connector.connect_over(wire, "tmcl", &[3], "")?;
    /// assert_eq!(link.axis(3)?.profile().name, "tmcm-171");
    /// # Ok::<(), polepair::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`connect_local`](super::connect_local).
    pub fn connect_over(
        &self,
        link: AnyLink,
        protocol: &str,
        axes: &[u32],
        query: &str,
    ) -> Result<LocalLink, Error> {
        let url = Url {
            protocol: protocol.to_owned(),
            target: LinkTarget::External { name: link.describe(), medium: link.medium() },
            keys: url::parse_keys(query)?,
            axes: axes.to_vec(),
            names: Vec::new(),
        };
        url.check_keys()?;
        let line = self.open_line(&url, Some(self.wrap_and_tap(0, link, None)))?;
        self.assemble_link(url, &[line], None, true)
    }
}
