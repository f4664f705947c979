//! Answers on CAN that belong to requests: where identifiers and checksums leave doubt, a protocol
//! that finds them is spoken.

use std::collections::{BTreeMap, VecDeque};

use polepair_core::explain::{Dissector, Raw};

use super::AXES_MAX;
use crate::decoder::Event;
use crate::stamp::Stamp;

/// Requests that are remembered.
const REQUESTS_MAX: usize = 16;
/// An answer comes within this time, ns.
const SOON: u64 = 200_000_000;
/// Pairs of an axis that cannot be an accident: mapped values that repeat each other with the
/// letters of a command in them, again and again, are none.
pub(super) const PROOF: u64 = 3;

/// Requests and the answers that were found to them.
#[derive(Clone, Debug, Default)]
pub(super) struct Pairs {
    requests: VecDeque<Asked>,
    /// Pairs found.
    pub found: u64,
    axes: BTreeMap<u32, u64>,
}

#[derive(Clone, Copy, Debug)]
struct Asked {
    data: [u8; 8],
    len: u8,
    id: u32,
    extended: bool,
    time: Option<Stamp>,
}

impl Asked {
    fn raw(&self) -> Raw<'_> {
        let bytes = &self.data[..usize::from(self.len)];
        Raw { bytes, id: Some(self.id), extended: self.extended }
    }
}

impl Pairs {
    /// Takes a whole frame.
    pub fn take(&mut self, dissector: &dyn Dissector, event: &Event<'_>) {
        let (Some(id), len @ 0..=8) = (event.id, event.bytes.len()) else { return };
        let raw = Raw { bytes: event.bytes, id: Some(id), extended: event.extended };
        if dissector.asks(&raw) {
            if self.requests.len() == REQUESTS_MAX {
                self.requests.pop_front();
            }
            let mut data = [0; 8];
            data[..len].copy_from_slice(event.bytes);
            let (extended, time) = (event.extended, event.time);
            self.requests.push_back(Asked { data, len: len as u8, id, extended, time });
            return;
        }
        let soon = |asked: &Asked| {
            asked.time.zip(event.time).is_none_or(|(then, now)| now.since(then) <= SOON)
        };
        let fits = |asked: &Asked| soon(asked) && dissector.answers(&raw, &asked.raw());
        let Some(at) = self.requests.iter().position(fits) else { return };
        self.requests.remove(at);
        self.found += 1;
        if let Some(axis) = event.explained.axis
            && (self.axes.len() < AXES_MAX || self.axes.contains_key(&axis))
        {
            *self.axes.entry(axis).or_default() += 1;
        }
    }

    /// The axes that are proven by them.
    pub fn proven(&self) -> impl Iterator<Item = u32> + '_ {
        self.axes.iter().filter(|(_, pairs)| **pairs >= PROOF).map(|(axis, _)| *axis)
    }
}
