//! The wires of a connection string, determined before anything is opened.

use super::options::wire_options;
use super::rack::{find_link, host_links, missing_connect_error, seed_of};
use super::{Connector, simulate};
use crate::error::Error;
use crate::registry::ProtocolInfo;
use crate::simulate::RackDescription;
use crate::spelling;
use crate::url::{AxisNumber, LinkTarget, Url};
use polepair_core::medium::MediumKind;
use polepair_sim::rack::RackLink;
use std::ops::RangeInclusive;
use std::path::Path;

/// A part of a link that is opened by itself: one wire, or one simulation with all of its wires.
#[derive(Clone, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub struct LinkPart {
    /// The connection string that opens it alone.
    pub url: String,
    /// Medium of the wire; `None` for a simulation.
    pub medium: Option<MediumKind>,
}

impl Connector {
    /// The parts of a connection string that can be opened separately: each link of a rack file with
    /// `connect`, else the string itself. Errors in the string or its files are reported; nothing is
    /// opened.
    ///
    /// # Errors
    /// [`Error::Usage`] and [`Error::File`], as in [`connect`](Self::connect).
    pub fn parts(&self, text: &str) -> Result<Vec<LinkPart>, Error> {
        let url = self.url(text)?;
        match &url.target {
            LinkTarget::Sim { .. } => Ok(whole_part(None, text)),
            LinkTarget::Rack { file } => {
                let description = simulate::rack_of_file(Path::new(file), seed_of(&url)?)?;
                let only = url.key("link").map(|name| find_link(&description, name)).transpose()?;
                let links = host_links(&description, only);
                if links.iter().all(|n| description.wires[*n].connect.is_none()) {
                    return Ok(whole_part(None, text));
                }
                let parts: Vec<LinkPart> = links
                    .into_iter()
                    .filter_map(|n| part_of_link(&url, &description, n).transpose())
                    .collect::<Result<_, _>>()?;
                let wires = || description.wires.iter().flat_map(|wire| wire.axis_names());
                match url.names.iter().find(|name| wires().all(|known| known != *name)) {
                    Some(name) => {
                        let near = spelling::suggestion(name, wires().map(String::as_str));
                        Err(Error::usage("E212", format!("the rack has no axis {name}{near}"), ""))
                    }
                    None => Ok(parts),
                }
            }
            _ => {
                let protocol = self.check_url(&url)?;
                Ok(whole_part(Some(protocol.medium), text))
            }
        }
    }

    /// Protocol of the string, if it is valid as far as that can be checked before the link is opened.
    fn check_url(&self, url: &Url) -> Result<ProtocolInfo, Error> {
        let protocol = url.protocol_info()?;
        url.axes.iter().try_for_each(|axis| protocol.check_address(*axis))?;
        wire_options(url, &protocol)?;
        self.chosen_profile(url, &protocol)?;
        Ok(protocol)
    }
}

fn whole_part(medium: Option<MediumKind>, text: &str) -> Vec<LinkPart> {
    vec![LinkPart { url: text.to_owned(), medium }]
}

/// One link of a rack, where the string means any axis of it.
fn part_of_link(
    url: &Url,
    description: &RackDescription,
    n: usize,
) -> Result<Option<LinkPart>, Error> {
    let (rack, wire) = (&description.rack.links[n], &description.wires[n]);
    if wire.connect.is_none() {
        return Err(missing_connect_error(description, n));
    }
    let protocols = description.protocols_on(n);
    let Some(first) = protocols.first() else { return Ok(None) };
    let here: Vec<usize> = std::iter::once(n).chain(description.links_behind(n)).collect();
    let mut part = url.clone();
    part.axes.retain(|axis| {
        AxisNumber(*axis).is_group()
            || is_drive_number(axis, &here, &first.addresses, &description.rack.links)
    });
    part.names.retain(|name| {
        here.iter().any(|n| description.wires[*n].axis_names().any(|known| known == name))
    });
    let every = url.axes.is_empty() && url.names.is_empty();
    if !every && part.axes.is_empty() && part.names.is_empty() {
        return Ok(None);
    }
    if part.key("link").is_none() {
        part.keys.push(("link".to_owned(), rack.name.clone()));
    }
    Ok(Some(LinkPart { url: part.to_string(), medium: Some(first.medium) }))
}

fn is_drive_number(
    number: &u32,
    here: &[usize],
    first_addresses: &RangeInclusive<u32>,
    description_rack_links: &[RackLink],
) -> bool {
    let lowest = *first_addresses.start();
    let drives = here.iter().flat_map(|n| &description_rack_links[*n].drives);
    drives.into_iter().any(|drive| drive.address.unwrap_or(lowest) == *number)
}
