//! What CANopen nodes say to one another on one bus: service data in several frames as one transfer,
//! process data by the mapping that the capture itself shows, and the states of nodes.
//!
//! ```text
//!   services   whose an identifier is: by default, or as the capture moved it
//!    ├ sdo     transfers, one at a time on each channel
//!    ├ pdo     what PDOs carry; mapping, where each value lies; meaning, what it is; wording;
//!    │         process, all of these put together
//!    ├ node    NMT state and presence, by beat (heartbeat) and guard; who shares a number
//!    ├ emcy    faults
//!    ├ power   the states of a CiA 402 drive
//!    ├ sync    the beat of the bus
//!    ├ lss     layer setting
//!    ├ product which drive a node says that it is
//!    └ learn   what the values of objects teach about all of these
//! ```

mod beat;
mod boot;
mod emcy;
mod guard;
mod learn;
mod lss;
mod mapping;
mod meaning;
mod node;
mod pdo;
mod power;
mod process;
mod product;
mod say;
mod sdo;
mod services;
mod sync;
#[cfg(test)]
mod tests;
mod wording;

use std::sync::Arc;

use polepair_core::medium::Frame;
use polepair_core::profile::Profile;
use polepair_core::proto::canopen::NODE_MAX;
use polepair_core::proto::canopen::cob;
use polepair_core::proto::canopen::emcy::Emergency;
use polepair_core::proto::canopen::heartbeat::Heartbeat;
use polepair_core::proto::canopen::nmt::{Command, Order, State};
use polepair_core::proto::canopen::sdo::Object;
use polepair_core::proto::canopen::sync::Sync;

use super::{Follower, Heard, Notice, Odd, Oddity};
use crate::explained::Explained;
use crate::stamp::Stamp;
use lss::Lss;
pub use mapping::{Mapping, Place};
use meaning::Book;
use node::Node;
use pdo::{Beside, Pdos};
pub use process::Process;
use sdo::Channel;
use services::{Service, Services};
use sync::Beats;
pub(crate) use wording::Wording;

/// Channels of service data on one bus: one a node, and those that the capture makes.
const CHANNELS_MAX: usize = 3 * NODE_MAX as usize;
/// A node-ID is an index into the table of nodes.
const NODES: usize = NODE_MAX as usize + 1;

/// Follows the CANopen of one bus.
#[derive(Debug)]
pub(super) struct Canopen {
    services: Services,
    pdos: Pdos,
    channels: Vec<Channel>,
    servers: Vec<learn::Server>,
    nodes: Vec<Option<Box<Node>>>,
    sync: Beats,
    lss: Lss,
    /// The drive whose names are used where a node does not tell that it is another.
    profile: Option<&'static Profile>,
    /// The same, where a person said so.
    stated: Option<&'static Profile>,
    /// When the capture began, and when somebody spoke last.
    began: Option<Stamp>,
    latest: Option<Stamp>,
    /// Nothing is due before.
    due: Stamp,
    /// Requests are heard on this bus.
    followed: bool,
    /// Everybody was ordered to start again.
    reset: bool,
    /// When a master said something last: a request, an order, a beat, process data to a node.
    commanded: Option<Stamp>,
}

/// Period of a node's heartbeat.
const HEARTBEAT_TIME: Object = Object::new(0x1017, 0);
const NEVER: Stamp = Stamp(u64::MAX);

impl Default for Canopen {
    fn default() -> Self {
        Self {
            services: Services::default(),
            pdos: Pdos::default(),
            channels: (0..=NODE_MAX).map(|node| Channel::new(node, None)).collect(),
            servers: Vec::new(),
            nodes: (0..NODES).map(|_| None).collect(),
            sync: Beats::default(),
            lss: Lss::default(),
            profile: None,
            stated: None,
            began: None,
            latest: None,
            due: NEVER,
            followed: false,
            reset: false,
            commanded: None,
        }
    }
}

impl Follower for Canopen {
    fn take(&mut self, heard: &Heard<'_>, said: &mut Explained, notices: &mut Vec<Notice>) {
        let Some(id) = heard.raw.id.filter(|_| !heard.echo) else { return };
        if self.began.is_none() {
            self.began = heard.time;
            self.channels.iter_mut().for_each(|channel| channel.since(heard.time));
        }
        self.name_by(heard.profile, heard.stated);
        let bytes = heard.raw.bytes;
        let service = self.services.of(id, heard.raw.extended, &mut self.pdos);
        if self.is_masters(service) {
            self.commanded = heard.time.max(self.commanded);
        }
        if heard.left && !matches!(service, Service::Pdo(_)) && !said.is_bare() {
            say::by_default(bytes, heard.raw.id, self.profile, said);
        }
        match service {
            Service::Pdo(_) if heard.remote => {}
            Service::Pdo(at) => self.process(at.into(), heard, said, notices),
            Service::State(node) => self.state(node, heard, notices),
            _ if heard.remote => {}
            Service::Request(at) => self.request(at.into(), heard, said, notices),
            Service::Reply(at) => self.reply(at.into(), heard, said, notices),
            Service::Nmt => self.order(bytes, heard.time, notices),
            Service::Emcy(node) => self.emergency(node, heard, said, notices),
            Service::Sync => {
                if let Ok(Sync { counter }) = Sync::parse(bytes) {
                    self.sync.take(counter, heard.time, notices);
                }
            }
            Service::Lss(asks) => self.layer(asks, heard, notices),
            Service::Unknown | Service::Nobody => {}
        }
        self.latest = heard.time.max(self.latest);
    }

    fn pass(&mut self, now: Stamp, notices: &mut Vec<Notice>) {
        if now > self.due {
            self.overdue(now, notices);
        }
    }

    fn settled(&mut self, frame: &Frame, now: Stamp) -> Option<&Arc<Process>> {
        let Service::Pdo(at) = self.services.known(frame.id) else { return None };
        if now > self.due || self.began.is_none() {
            return None;
        }
        let pdo = &self.pdos.all[usize::from(at)];
        let process = pdo.settled(frame.len)?;
        let node = self.nodes[usize::from(pdo.node)].as_deref_mut()?;
        if pdo.told {
            let free = node.may_process();
            let data = u64::from_le_bytes(frame.data);
            (free && process.is_settled(data, &mut node.power)).then_some(())?;
        } else {
            self.commanded = Some(now).max(self.commanded);
        }
        self.latest = Some(now).max(self.latest);
        Some(process)
    }

    fn repeats(&self, id: u32) -> bool {
        use Service::{Nmt, Request, State, Sync};
        // Also where one was moved to an answer's place: the dissector looks at no request.
        matches!(self.services.known(id), Nmt | Sync | State(_) | Request(_))
    }

    fn claims(&self, id: u32, extended: bool) -> bool {
        self.services.claims(id, extended)
    }

    fn end(&mut self, notices: &mut Vec<Notice>) {
        self.channels.iter_mut().for_each(|channel| channel.end(notices));
        self.lss.end(notices);
        self.nodes.iter_mut().flatten().for_each(|node| node.confirm(None, notices));
    }
}

impl Canopen {
    /// The names that count from now on.
    fn name_by(&mut self, profile: Option<&'static Profile>, stated: bool) {
        self.stated = profile.filter(|_| stated);
        let same = match (self.profile, profile) {
            (Some(one), Some(other)) => core::ptr::eq(one, other),
            (one, other) => one.is_none() && other.is_none(),
        };
        if !same {
            self.profile = profile;
            self.pdos.all.iter_mut().for_each(pdo::Pdo::forget);
        }
    }

    /// The drive whose names a node has.
    fn profile_of(&self, id: u8) -> Option<&'static Profile> {
        let node = self.nodes[usize::from(id & NODE_MAX)].as_deref();
        node.map_or(self.profile, |node| node.product.names(self.profile))
    }

    /// The same, and whether the frame was explained by other names.
    fn names_of(&self, id: u8) -> (Option<&'static Profile>, bool) {
        let profile = self.profile_of(id);
        let place = |profile: Option<&'static Profile>| profile.map(core::ptr::from_ref);
        (profile, place(profile) != place(self.profile))
    }

    fn is_masters(&self, service: Service) -> bool {
        match service {
            Service::Nmt | Service::Sync | Service::Request(_) | Service::Lss(true) => true,
            Service::Pdo(at) => !self.pdos.all[usize::from(at)].told,
            _ => false,
        }
    }

    fn node(&mut self, node: u8) -> &mut Node {
        let place = &mut self.nodes[usize::from(node & NODE_MAX)];
        place.get_or_insert_with(|| Box::new(Node::new(node, self.reset)))
    }

    /// Something is due then.
    fn expect(&mut self, due: Option<Stamp>) {
        self.due = due.map_or(self.due, |due| self.due.min(due));
    }

    /// Looks who did not do what was due.
    fn overdue(&mut self, now: Stamp, notices: &mut Vec<Notice>) {
        for at in 0..self.channels.len() {
            let before = notices.len();
            self.channels[at].pass(now, notices);
            self.hush(at, before, Some(now), notices);
        }
        self.lss.pass(now, notices);
        for node in self.nodes.iter_mut().flatten() {
            if node.guard.due().is_some_and(|due| due < now) {
                node.unguarded(notices);
            }
            node.confirm(Some(now), notices);
        }
        self.silences(now, notices);
        self.due = NEVER;
        let channels = self.channels.iter().filter_map(Channel::due);
        let nodes = self.nodes.iter().flatten();
        let nodes =
            nodes.flat_map(|node| [node.beat.due(), node.guard.due(), node.boots.due()]).flatten();
        self.due = channels.chain(nodes).chain(self.lss.due()).min().unwrap_or(NEVER);
    }

    /// Looks whose heartbeat stays out. Where nobody at all spoke, several are not silent: the
    /// capture paused, or the bus was down.
    fn silences(&mut self, now: Stamp, notices: &mut Vec<Notice>) {
        let missed = |node: &Node| node.beat.due().filter(|due| *due < now);
        let missing = self.nodes.iter().flatten().filter_map(|node| missed(node));
        let (count, first) = missing.fold((0, NEVER), |(n, first), due| (n + 1, first.min(due)));
        let paused = count > 1 && self.latest.is_some_and(|latest| latest < first);
        if let (true, Some(latest)) = (paused, self.latest) {
            let ms = now.since(latest) / 1_000_000;
            let text = format!("nobody said anything for {ms} ms, {count} heartbeats stayed out");
            let (kind, axis, time) = (Oddity::Silent, None, Some(latest));
            notices.push(Notice::Odd(Odd { kind, axis, time, text }));
        }
        for node in self.nodes.iter_mut().flatten() {
            if paused {
                node.beat.off();
            } else {
                node.silent(now, self.commanded, notices);
            }
        }
    }

    /// Who looks who is there is not told that nobody is, and who asks on is told once.
    /// That a request was not answered waits for an answer that is only late.
    fn hush(
        &mut self,
        channel: usize,
        before: usize,
        now: Option<Stamp>,
        notices: &mut Vec<Notice>,
    ) {
        if notices.len() == before {
            return;
        }
        let node = self.channels[channel].node;
        let mut at = before;
        while at < notices.len() {
            let given_up = match &notices[at] {
                Notice::Odd(odd) if sdo::is_unanswered(odd) => Some(true),
                Notice::Odd(Odd { kind: Oddity::Retry, .. }) => Some(false),
                _ => None,
            };
            match given_up {
                Some(given_up) if !self.node(node).unanswered(given_up) => {
                    notices.remove(at);
                }
                _ => at += 1,
            }
        }
        self.channels[channel].hold(before, now, notices);
        let due = self.channels[channel].due();
        self.expect(due);
    }

    /// The master orders something of one node, or of all that are known.
    fn order(&mut self, bytes: &[u8], now: Option<Stamp>, notices: &mut Vec<Notice>) {
        let Ok(Order { command, node }) = Order::parse(bytes) else { return };
        if matches!(command, Command::Other(_)) {
            return;
        }
        self.sync.restart();
        if node != 0 {
            self.node(node);
        }
        for known in self.nodes.iter_mut().flatten().filter(|n| node == 0 || n.id == node) {
            known.order(command, now, notices);
        }
        if matches!(command, Command::ResetNode | Command::ResetCommunication) {
            self.reset |= node == 0;
            let meant = |channel: &&mut Channel| node == 0 || channel.node == node;
            self.channels.iter_mut().filter(meant).for_each(|it| it.reset(now, notices));
        }
    }

    /// Boot-up, heartbeat, or guarding.
    fn state(&mut self, id: u8, heard: &Heard<'_>, notices: &mut Vec<Notice>) {
        let at = (heard.number, heard.time);
        if heard.remote {
            let node = self.node(id);
            node.guarded(at, notices);
            let due = node.guard.due();
            return self.expect(due);
        }
        let Ok(Heartbeat { state, toggle }) = Heartbeat::parse(heard.raw.bytes) else { return };
        let beginning = self.channels[usize::from(id)].is_setting(HEARTBEAT_TIME, heard.time);
        let node = self.node(id);
        if state == State::BootUp {
            let started = node.boot(heard.time, beginning, notices);
            let due = node.boots.due();
            self.expect(due);
            if started {
                self.restart(id, heard.time, notices);
            }
        } else if node.guard.answer(id, toggle, at, notices) {
            node.answered(notices);
            node.state_told(state, heard.time, notices);
        } else {
            node.tell(state, heard.time, notices);
            let due = node.beat.due();
            self.expect(due);
        }
    }

    /// A node has started: what it was told may be forgotten, what was under way is.
    fn restart(&mut self, id: u8, now: Option<Stamp>, notices: &mut Vec<Notice>) {
        self.pdos.of(id).for_each(pdo::Pdo::restart);
        let meant = |channel: &&mut Channel| channel.node == id;
        self.channels.iter_mut().filter(meant).for_each(|channel| channel.reset(now, notices));
    }

    fn emergency(
        &mut self,
        id: u8,
        heard: &Heard<'_>,
        said: &mut Explained,
        notices: &mut Vec<Notice>,
    ) {
        let bytes = heard.raw.bytes;
        let default = u32::from(cob::EMCY | u16::from(id));
        let (profile, renamed) = self.names_of(id);
        if renamed || heard.raw.id != Some(default) {
            say::by_default(bytes, Some(default), profile, said);
        }
        let Ok(emergency) = Emergency::parse(bytes) else { return };
        let words = emcy::Words::of(emergency.code.into(), bytes.len() == 2, profile);
        if words.inferred {
            say::inferred(&words, said);
        }
        let node = self.node(id);
        // Who starts says that there is no fault, before or behind its boot-up.
        node.hear(emergency.code != 0, notices);
        node.faults.take(id, &emergency, words, heard.time, notices);
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
        let (id, told) = (self.pdos.all[at].node, self.pdos.all[at].told);
        self.node(id);
        let profile = self.profile_of(id);
        let Some(node) = self.nodes[usize::from(id)].as_deref_mut() else { return };
        if told {
            node.processes(heard.time, notices);
        }
        let pdo = &mut self.pdos.all[at];
        let book = Book { profile, values: &node.values };
        pdo.map(len, &Beside { book, drive: node.drive, bare: said.is_bare() });
        pdo.measure(len, notices);
        say::process(pdo, bytes, heard.raw.id, profile, said);
        let Some(process) = pdo.last().filter(|it| len >= it.mapping().bytes()) else { return };
        let data = word(bytes);
        process.mapping().signals(data, |place, exact, value| {
            if process.watches(place) {
                node.power.take(id, place.object, exact, &mut node.faults, profile, notices);
            }
            notices.push(process.signal(place, exact, value));
        });
    }

    fn request(
        &mut self,
        at: usize,
        heard: &Heard<'_>,
        said: &mut Explained,
        notices: &mut Vec<Notice>,
    ) {
        let Some(bytes) = service(heard.raw.bytes) else { return };
        let (before, place) = (notices.len(), (heard.number, heard.time));
        self.followed = true;
        let part = self.channels[at].request(bytes, place, notices);
        let channel = &self.channels[at];
        let (profile, renamed) = self.names_of(channel.node);
        let usual = u32::from(cob::SDO_REQUEST | u16::from(channel.node));
        let moved = renamed || heard.raw.id != Some(usual);
        say::part(channel, part, heard.raw.bytes, (false, moved), profile, said);
        let due = channel.due();
        self.expect(due);
        self.settle(at, notices);
        self.hush(at, before, heard.time, notices);
    }

    fn reply(
        &mut self,
        at: usize,
        heard: &Heard<'_>,
        said: &mut Explained,
        notices: &mut Vec<Notice>,
    ) {
        let Some(bytes) = service(heard.raw.bytes) else { return };
        let place = (heard.number, heard.time);
        let id = self.channels[at].node;
        self.node(id).answered(notices);
        let channel = &mut self.channels[at];
        let part = channel.reply(bytes, place, self.followed, notices);
        let (two, due) = (channel.is_answered_by_two(), channel.due());
        let (profile, renamed) = self.names_of(id);
        let moved = renamed || heard.raw.id != Some(u32::from(cob::SDO_REPLY | u16::from(id)));
        say::part(&self.channels[at], part, heard.raw.bytes, (true, moved), profile, said);
        self.expect(due);
        if two {
            self.node(id).double("its requests are answered twice", notices);
        }
        self.settle(at, notices);
    }

    /// The master or a device speaks of node-IDs and bit rates.
    fn layer(&mut self, asks: bool, heard: &Heard<'_>, notices: &mut Vec<Notice>) {
        let at = (heard.number, heard.time);
        let Some(bytes) = service(heard.raw.bytes).filter(|_| heard.raw.bytes.len() == 8) else {
            return;
        };
        match asks {
            true => self.lss.request(bytes, at, notices),
            false => self.lss.reply(bytes, at, notices),
        }
        let due = self.lss.due();
        self.expect(due);
    }

    /// What a transfer brought is known from now on.
    fn settle(&mut self, at: usize, notices: &mut Vec<Notice>) {
        let id = self.channels[at].node;
        if let Some(settled) = self.channels[at].settled() {
            self.learn(id, &settled, notices);
        }
    }
}

/// Up to eight bytes as a number, the first lowest.
fn word(bytes: &[u8]) -> u64 {
    let mut all = [0; 8];
    all.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
    u64::from_le_bytes(all)
}

/// Service data of eight bytes, or of seven where the last does not count.
fn service(bytes: &[u8]) -> Option<[u8; 8]> {
    matches!(bytes.len(), 7 | 8).then(|| word(bytes).to_le_bytes())
}

/// Something that a healthy bus does not do.
fn odd(kind: Oddity, node: u8, text: String) -> Notice {
    odd_at(kind, node, None, text)
}

/// The same, seen later than it was.
fn odd_at(kind: Oddity, node: u8, time: Option<Stamp>, text: String) -> Notice {
    Notice::Odd(Odd { kind, axis: Some(node.into()), time, text })
}
