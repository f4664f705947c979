//! What CANopen nodes say to one another on one bus: service data in several frames as one transfer,
//! process data by the mapping that the capture itself shows, and the states of nodes.
//!
//! ```text
//!   services   whose an identifier is: by default, or as the capture moved it
//!    ├ sdo     transfers, one at a time on each channel
//!    ├ pdo     what PDOs carry; mapping, where each value lies; meaning, what it is
//!    ├ nodes   NMT states, boot-up, heartbeat, guarding; who has whose number
//!    ├ emcy    faults
//!    ├ power   the states of a CiA 402 drive
//!    └ sync    the beat
//! ```

mod mapping;
mod meaning;
mod pdo;
mod services;

use core::fmt::Write as _;
use std::collections::HashMap;

use polepair_core::explain::{Context, Dissector as _, Sink as _};
use polepair_core::profile::Profile;
use polepair_core::proto::canopen::CanopenDissector;
use polepair_core::proto::canopen::explain::say;

use super::{Follower, Heard, Notice, Odd, Oddity, Quality, Signal};
use crate::explained::Explained;
pub use mapping::{Mapping, Place};
use meaning::Book;
use pdo::{Beside, Pdos};
use services::{Service, Services};

/// Follows the CANopen of one bus.
#[derive(Debug, Default)]
pub(super) struct Canopen {
    services: Services,
    pdos: Pdos,
    profile: Option<&'static Profile>,
    values: HashMap<polepair_core::proto::canopen::sdo::Object, i64>,
}

impl Follower for Canopen {
    fn take(&mut self, heard: &Heard<'_>, said: &mut Explained, notices: &mut Vec<Notice>) {
        let Some(id) = heard.raw.id.filter(|_| !heard.echo) else { return };
        self.name_by(heard.profile);
        match self.services.of(id, heard.raw.extended, &mut self.pdos) {
            Service::Pdo(at) if !heard.remote => self.process(at.into(), heard, said, notices),
            _ => {}
        }
    }

    fn end(&mut self, _notices: &mut Vec<Notice>) {}
}

impl Canopen {
    /// The names that count from now on.
    fn name_by(&mut self, profile: Option<&'static Profile>) {
        let same = match (self.profile, profile) {
            (Some(one), Some(other)) => core::ptr::eq(one, other),
            (one, other) => one.is_none() && other.is_none(),
        };
        if !same {
            self.profile = profile;
            self.pdos.all.iter_mut().for_each(pdo::Pdo::forget);
        }
    }

    /// Reads process data by their mapping.
    fn process(
        &mut self,
        at: usize,
        heard: &Heard<'_>,
        said: &mut Explained,
        notices: &mut Vec<Notice>,
    ) {
        let bytes = heard.raw.bytes;
        let Ok(len @ 0..=8) = u8::try_from(bytes.len()) else { return };
        let pdo = &mut self.pdos.all[at];
        let beside =
            Beside { book: Book { profile: self.profile, values: &self.values }, drive: false };
        let (node, data) = (u32::from(pdo.node), word(bytes));
        let Some(mapping) = pdo.mapping(len, &beside) else { return };
        if len < mapping.bytes() {
            return;
        }
        let quality = mapping.quality();
        mapping.signals(data, |place, exact, value| {
            let Place { name, unit, .. } = *place;
            let exact = Some(exact);
            let signal = Signal { axis: node, name, value, exact, unit, quality, request: None };
            notices.push(Notice::Signal(signal));
        });
        say_process(pdo, heard, data, self.profile, said);
    }
}

/// Says what process data are, object by object.
fn say_process(
    pdo: &pdo::Pdo,
    heard: &Heard<'_>,
    data: u64,
    profile: Option<&'static Profile>,
    said: &mut Explained,
) {
    let Some(mapping) = pdo.last_mapping() else { return };
    said.clear();
    let id = pdo.default_cob().map(|cob| u32::from(cob.id()));
    let context = Context { profile, id, ..Context::default() };
    CanopenDissector.explain(heard.raw.bytes, &context, said);
    said.axis(pdo.node.into());
    said.kind(&pdo.name());
    said.text.truncate(said.text.find(" (").unwrap_or(said.text.len()));
    let _ = write!(
        said.text,
        " ({}",
        if mapping.quality() == Quality::Good { "" } else { "if mapped as usual: " }
    );
    for (at, (entry, field)) in mapping.entries().iter().enumerate() {
        let raw = match say::signed(entry.object, profile) {
            true => field.signed(data),
            false => field.unsigned(data).cast_signed(),
        };
        said.text.push_str(if at > 0 { "; " } else { "" });
        let _ = say::value(entry.object, raw, profile, &mut said.text);
    }
    said.text.push(')');
}

/// Up to eight bytes as a number, the first lowest.
fn word(bytes: &[u8]) -> u64 {
    let mut all = [0; 8];
    all.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
    u64::from_le_bytes(all)
}

/// Something that a healthy bus does not do.
fn odd(kind: Oddity, node: u8, text: String) -> Notice {
    Notice::Odd(Odd { kind, axis: Some(node.into()), time: None, text })
}
