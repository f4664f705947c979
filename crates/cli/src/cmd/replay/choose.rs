//! Which frames of a capture are sent, onto which wire, and what they may do there.

use polepair_capture::{CAN_FD, Event, Filter};
use polepair_core::drives;
use polepair_core::explain::{Act, Awaits, Direction, Dissector, Effect, Raw, Talk, Turn};
use polepair_core::medium::{Frame, MediumKind};
use polepair_core::profile::Profile;
use polepair_core::proto;

use crate::ears::Unit;

/// Identifiers of frames end here; above are a controller's reports of errors.
const ID_MAX: u32 = 0x1FFF_FFFF;

/// Whose frames are sent.
#[derive(Clone, Copy, PartialEq, Eq, Debug, clap::ValueEnum)]
pub enum Whose {
    /// The host's
    Tx,
    /// The drives'
    Rx,
    /// All, also those of which nobody tells who sent them
    Both,
}

/// A wire, and the link of the capture that is played there.
#[derive(Clone, Debug)]
pub struct Route {
    /// The capture's name for it; `None` is whatever link there is.
    pub link: Option<String>,
    pub medium: MediumKind,
}

/// A frame that is to be sent.
pub struct Item {
    pub wire: usize,
    /// Nanoseconds since the first one that is sent.
    pub at: u64,
    pub unit: Unit,
    pub axis: Option<u32>,
    pub effect: Effect,
    /// Who knows its answer, if it has one.
    pub answered: Option<&'static dyn Dissector>,
}

/// Why a frame is not sent.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Left {
    /// Of another direction, or the host's own heard back.
    Other,
    /// Nobody tells who sent it.
    Unknown,
    /// The filter does not want it.
    Filtered,
    /// It is of a link that is played nowhere.
    Elsewhere,
    /// The wire has no such frames: CAN FD, or bytes on a bus.
    Unfit,
    /// A controller's report, which nobody sent.
    Report,
}

/// Chooses frames.
#[derive(Clone, Debug)]
pub struct Choice {
    pub whose: Whose,
    pub filter: Option<Filter>,
    pub routes: Vec<Route>,
    pub profile: Option<&'static Profile>,
    /// The last request of serial links that nothing followed yet.
    open: Vec<(String, Vec<u8>)>,
    first: Option<u64>,
    last: u64,
}

impl Choice {
    pub fn new(whose: Whose, filter: Option<Filter>, routes: Vec<Route>) -> Self {
        Self { whose, filter, routes, profile: None, open: Vec::new(), first: None, last: 0 }
    }

    /// What is sent of a frame, or why nothing is.
    pub fn take(&mut self, event: &Event<'_>) -> Result<Item, Left> {
        // Asked of every frame: times of a filter count from the first.
        let wanted = self.filter.as_mut().is_none_or(|filter| filter.wants(event));
        let dissector = event.protocol.and_then(proto::dissector);
        let raw = Raw { bytes: event.bytes, id: event.id, extended: event.extended };
        let speaker = self.speaker(event, &raw, dissector);
        let played = |route: &Route| route.link.as_deref().is_none_or(|link| link == event.link);
        let wire = self.routes.iter().position(played).ok_or(Left::Elsewhere)?;
        if event.id.is_some_and(|id| id > ID_MAX) {
            return Err(Left::Report);
        }
        let medium = if event.id.is_some() { MediumKind::Can } else { MediumKind::Serial };
        if medium != self.routes[wire].medium || event.explained.kind == CAN_FD {
            return Err(Left::Unfit);
        }
        match (self.whose, speaker) {
            _ if event.echo => return Err(Left::Other),
            (Whose::Both, _) => {}
            (_, None) => return Err(Left::Unknown),
            (Whose::Tx, Some(Direction::ToDrive)) | (Whose::Rx, Some(Direction::ToHost)) => {}
            _ => return Err(Left::Other),
        }
        if !wanted {
            return Err(Left::Filtered);
        }
        Ok(Item {
            wire,
            at: self.moment(event),
            unit: unit(event),
            axis: event.explained.axis,
            effect: self.effect(event, &raw, dissector),
            answered: dissector.filter(|dissector| awaits(*dissector, &raw)),
        })
    }

    /// Who sent it: the capture says, or else the frame.
    fn speaker(
        &mut self,
        event: &Event<'_>,
        raw: &Raw<'_>,
        dissector: Option<&'static dyn Dissector>,
    ) -> Option<Direction> {
        let at = self.open.iter().position(|(link, _)| link == event.link);
        let open = at.map(|at| Raw { bytes: &self.open[at].1, ..Raw::default() });
        let open = open.filter(|open| raw.id.is_none() && !open.bytes.is_empty());
        let by_itself = || dissector?.speaker(raw, open);
        let speaker = event.direction.or_else(by_itself);
        if raw.id.is_none() {
            let at = at.unwrap_or_else(|| {
                self.open.push((event.link.to_owned(), Vec::new()));
                self.open.len() - 1
            });
            self.open[at].1.clear();
            if speaker == Some(Direction::ToDrive) {
                self.open[at].1.extend_from_slice(raw.bytes);
            }
        }
        speaker
    }

    /// Its time since the first one; where it has none, or an earlier one, that of the last.
    fn moment(&mut self, event: &Event<'_>) -> u64 {
        if let Some(time) = event.time {
            let first = *self.first.get_or_insert(time.0);
            self.last = self.last.max(time.0.saturating_sub(first));
        }
        self.last
    }

    fn effect(
        &self,
        event: &Event<'_>,
        raw: &Raw<'_>,
        dissector: Option<&'static dyn Dissector>,
    ) -> Effect {
        let Some(dissector) = dissector else { return Effect::UNKNOWN };
        if event.remote {
            return Effect::NOTHING;
        }
        let speaks = |p: &&Profile| dissector.language().starts_with(p.protocol);
        match self.profile.filter(speaks) {
            Some(stated) => dissector.effect(raw, Some(stated)),
            // A usual drive's table warns of what it knows; it vouches for no other drive.
            None => {
                dissector.effect(raw, None).and(dissector.effect(raw, drives::assumed(dissector)))
            }
        }
    }
}

/// Whether a request is owed an answer.
fn awaits(dissector: &dyn Dissector, raw: &Raw<'_>) -> bool {
    let talk = Talk { direction: Some(Direction::ToDrive), ..Talk::default() };
    match dissector.turn(raw, &talk) {
        Turn::Asks(awaits) => awaits != Awaits::NOTHING,
        _ => dissector.asks(raw),
    }
}

fn unit(event: &Event<'_>) -> Unit {
    let Some(id) = event.id else { return Unit::Bytes(event.bytes.to_vec()) };
    let mut frame =
        Frame { id, extended: event.extended, remote: event.remote, ..Frame::default() };
    let bytes = &event.bytes[..event.bytes.len().min(8)];
    frame.len = if event.remote { event.wanted } else { bytes.len() as u8 };
    frame.data[..bytes.len()].copy_from_slice(bytes);
    Unit::Frame(frame)
}

/// One word for what a frame may do.
pub const fn word(effect: Effect) -> &'static str {
    match (effect.keeps, effect.act) {
        (true, _) => "keeps",
        (false, Act::Nothing) => "asks",
        (false, Act::Sets) => "sets",
        (false, Act::Moves) => "moves",
        (false, Act::Unknown) => "?",
    }
}
