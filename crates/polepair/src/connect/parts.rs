//! What a connection string opens, wire by wire, before anything is opened.

use super::options::wire_options;
use super::rack::{link_of, not_told, own_links, seed_of};
use super::{Connector, simulate};
use crate::error::Error;
use crate::registry::Spoken;
use crate::simulate::Description;
use crate::url::{Number, Target, Url};
use crate::words;
use polepair_core::medium::MediumKind;
use std::path::Path;

/// What is opened by itself: one wire, or one simulation with all of its wires.
#[derive(Clone, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub struct Part {
    /// The connection string that opens it alone.
    pub url: String,
    /// What its wire carries; `None` where it is simulated.
    pub medium: Option<MediumKind>,
}

impl Connector {
    /// The parts of a connection string that can be opened each by itself: each link of a rack file that
    /// says where its links are, else the string itself. What is wrong with the string, or with a file
    /// that it names, is told; nothing is opened.
    ///
    /// # Errors
    /// [`Error::Usage`] and [`Error::File`], as [`connect`](Self::connect) has them.
    pub fn parts(&self, text: &str) -> Result<Vec<Part>, Error> {
        let url = self.url(text)?;
        let whole = |medium| vec![Part { url: text.to_owned(), medium }];
        match &url.target {
            Target::Sim { .. } => Ok(whole(None)),
            Target::Rack { file } => {
                let description = simulate::rack_of_file(Path::new(file), seed_of(&url)?)?;
                let only = url.key("link").map(|name| link_of(&description, name)).transpose()?;
                let links = own_links(&description, only);
                if links.iter().all(|n| description.wires[*n].connect.is_none()) {
                    return Ok(whole(None));
                }
                let of = |n| link(&url, &description, n).transpose();
                let parts: Vec<Part> =
                    links.into_iter().filter_map(of).collect::<Result<_, _>>()?;
                let wires = || description.wires.iter().flat_map(|wire| &wire.names);
                match url.names.iter().find(|name| wires().all(|known| known != *name)) {
                    Some(name) => {
                        let near = words::hint(name, wires().map(String::as_str));
                        Err(Error::usage("E212", format!("the rack has no axis {name}{near}"), ""))
                    }
                    None => Ok(parts),
                }
            }
            _ => {
                let spoken = self.checked(&url)?;
                Ok(whole(Some(spoken.medium)))
            }
        }
    }

    /// What is spoken there, where the string is right as far as that is known before the link is opened.
    fn checked(&self, url: &Url) -> Result<Spoken, Error> {
        let spoken = url.spoken()?;
        url.axes.iter().try_for_each(|axis| spoken.check(*axis))?;
        wire_options(url, &spoken)?;
        self.chosen_profile(url, &spoken)?;
        Ok(spoken)
    }
}

/// One link of a rack, where the string means any axis of it.
fn link(url: &Url, description: &Description, n: usize) -> Result<Option<Part>, Error> {
    let (rack, wire) = (&description.rack.links[n], &description.wires[n]);
    if wire.connect.is_none() {
        return Err(not_told(description, n));
    }
    let spoken = description.spoken_on(n);
    let Some(first) = spoken.first() else { return Ok(None) };
    let here: Vec<usize> = std::iter::once(n).chain(description.behind(n)).collect();
    let numbers = |number: &u32| {
        let lowest = *first.addresses.start();
        let drives = here.iter().flat_map(|n| &description.rack.links[*n].drives);
        drives.into_iter().any(|drive| drive.address.unwrap_or(lowest) == *number)
    };
    let mut part = url.clone();
    part.axes.retain(|axis| Number(*axis).is_group() || numbers(axis));
    part.names.retain(|name| here.iter().any(|n| description.wires[*n].names.contains(name)));
    let every = url.axes.is_empty() && url.names.is_empty();
    if !every && part.axes.is_empty() && part.names.is_empty() {
        return Ok(None);
    }
    if part.key("link").is_none() {
        part.keys.push(("link".to_owned(), rack.name.clone()));
    }
    Ok(Some(Part { url: part.to_string(), medium: Some(first.medium) }))
}
