//! Protocols of links, determined without opening them.

use super::rack::{find_link, host_links};
use super::{Connector, describe_rack};
use crate::error::Error;
use crate::simulate;
use crate::url::LinkTarget;
use polepair_core::medium::MediumKind;
use std::path::Path;

impl Connector {
    /// The words of the protocols that are spoken on a link, without opening it.
    ///
    /// # Errors
    /// [`Error::Usage`], and [`Error::File`] of a rack.
    pub fn protocols(&self, text: &str) -> Result<Vec<&'static str>, Error> {
        let mut words = Vec::new();
        for word in self.wire_protocols(text)?.into_iter().flat_map(|(_, names)| names) {
            if !words.contains(&word) {
                words.push(word);
            }
        }
        Ok(words)
    }

    /// The wires that would be opened: the medium of each, and the words of its protocols.
    ///
    /// # Errors
    /// As [`protocols`](Self::protocols).
    pub fn wire_protocols(
        &self,
        text: &str,
    ) -> Result<Vec<(MediumKind, Vec<&'static str>)>, Error> {
        let urls = self.protocol_urls(text)?;
        let (description, only) = match &urls[0].target {
            LinkTarget::Sim { what } => (describe_rack(&urls[0], what, 1)?, None),
            LinkTarget::Rack { file } => {
                let description = simulate::rack_of_file(Path::new(file), 1)?;
                let only = urls[0].key("link").map(|name| find_link(&description, name));
                (description, only.transpose()?)
            }
            _ => {
                let words = urls
                    .iter()
                    .map(|url| Ok(url.protocol_info()?.name))
                    .collect::<Result<_, Error>>();
                return Ok(vec![(urls[0].protocol_info()?.medium, words?)]);
            }
        };
        let wires = host_links(&description, only).into_iter().filter_map(|n| {
            let protocols = description.protocols_on(n);
            let words = protocols.iter().map(|protocol| protocol.name).collect();
            Some((protocols.first()?.medium, words))
        });
        Ok(wires.collect())
    }
}
