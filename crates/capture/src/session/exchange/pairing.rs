//! Requests under way, and the frames that settle them.

mod whose;

use core::fmt::Write as _;
use std::collections::VecDeque;

use polepair_core::explain::{Awaits, Owed, Raw, Talk};

use super::{AXES_MAX, odd};
use crate::explained::Explained;
use crate::session::{Exchange, Heard, Name, Notice, Odd, Oddity, Outcome, Quality, name};
use crate::stamp::Stamp;

/// Requests of a link that are remembered, settled or not.
const REQUESTS_MAX: usize = 64;
/// Operations whose names are at hand.
const OPS_MAX: usize = 64;
/// Shorter times to answer than this are not insisted on, ns: adapters and operating systems are
/// slower than drives.
const LIMIT_MIN: u64 = 100_000_000;
/// Time to answer where no profile says one, ns.
const LIMIT_UNKNOWN: u64 = 1_000_000_000;
/// A request that is still open after so many times its limit will not be answered …
const PATIENCE: u64 = 3;
/// … nor so long after it, ns; hosts that ask again do it within that time.
const PATIENCE_MIN: u64 = 3_500_000_000;
/// Repetitions that belong to one request; more are questions to nobody.
const RETRIES_MAX: u16 = 3;
/// Requests before the first answer that nobody asked for is one: an earlier one may have been
/// asked before the capture began.
const FIRST_REQUESTS: u32 = 2;

/// Requests and answers of one link.
#[derive(Debug, Default)]
pub(super) struct Pairing {
    /// The newest is the last.
    requests: VecDeque<Request>,
    ops: Vec<Name>,
    /// For each axis the last request that told how it answers.
    forms: Vec<(u32, Bytes)>,
    /// When the next request is given up at the latest.
    due: Option<Stamp>,
    /// Axes that left a request unanswered since this was asked.
    given_up: Vec<u32>,
    /// The frame that was answered last, and by which.
    paired: (u64, u64),
    asked: u32,
    began: Option<Stamp>,
    now: Option<Stamp>,
    acks: u64,
    answers: u64,
    /// The longest that an answer which came in time took, ns, and the shortest.
    slowest: u64,
    fastest: Option<u64>,
    /// What it took lately, as a mean that forgets.
    lately: Option<u64>,
    /// Requests that did not wait for the answer to the one before, to the same axis.
    unwaited: u64,
}

/// A frame that is kept.
#[derive(Debug, Default)]
struct Bytes {
    bytes: Vec<u8>,
    id: Option<u32>,
    extended: bool,
}

impl Bytes {
    fn raw(&self) -> Raw<'_> {
        Raw { bytes: &self.bytes, id: self.id, extended: self.extended }
    }

    fn keep(&mut self, raw: &Raw<'_>) {
        self.bytes.clear();
        self.bytes.extend_from_slice(raw.bytes);
        (self.id, self.extended) = (raw.id, raw.extended);
    }
}

#[derive(Debug)]
struct Request {
    told: Exchange,
    frame: Bytes,
    awaits: Awaits,
    acks: u8,
    answers: u8,
    /// When it was sent last.
    last: Option<Stamp>,
    limit: u64,
    state: State,
    /// Something that is no frame came where its answer was due.
    spoiled: bool,
    /// The bytes that settled it.
    answer: Vec<u8>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// Something that it is owed may still come.
    Open,
    /// It has what it was owed.
    Settled,
    /// It was told that nothing came.
    GivenUp,
}

/// What an answer was.
#[derive(Clone, Copy, Debug)]
pub(super) struct Settled {
    /// Somebody asked for it.
    pub asked: bool,
    /// How far its values can be trusted.
    pub quality: Quality,
}

impl Request {
    fn sure(&self) -> bool {
        let sure = |owed| matches!(owed, Owed::Exactly(_));
        sure(self.awaits.answers) || sure(self.awaits.acks)
    }

    fn is_late(&self, now: Option<Stamp>) -> bool {
        matches!((now, self.last), (Some(now), Some(last)) if now.since(last) > self.limit)
    }

    fn patience(&self) -> u64 {
        PATIENCE_MIN.max(PATIENCE * self.limit)
    }

    fn owes_answer(&self) -> bool {
        self.state == State::Open && self.awaits.answers != Owed::Nothing
    }

    /// `GAP to axis 1`.
    fn name(&self) -> String {
        let mut text = String::from(self.told.op);
        // Writing into a String cannot fail.
        let _ = match self.told.axis {
            Some(axis) => write!(text, " to axis {axis}"),
            None => write!(text, " to everybody"),
        };
        text
    }
}

impl Pairing {
    /// The last request, while nothing answered it.
    pub fn open(&self) -> Option<Raw<'_>> {
        let last = self.requests.back()?;
        (last.state == State::Open).then(|| last.frame.raw())
    }

    /// The request that told how an axis answers.
    pub fn form(&self, axis: Option<u32>) -> Option<Raw<'_>> {
        let axis = axis?;
        self.forms.iter().find(|(of, _)| *of == axis).map(|(_, frame)| frame.raw())
    }

    /// The frame that frame `number` answers.
    pub fn answered_by(&self, number: u64) -> Option<u64> {
        (self.paired.1 == number && self.paired.0 > 0).then_some(self.paired.0)
    }

    /// Axes that left requests unanswered since this was called last.
    pub fn given_up(&mut self) -> impl Iterator<Item = u32> + '_ {
        self.given_up.drain(..)
    }

    /// Takes a request.
    pub fn ask(
        &mut self,
        awaits: Awaits,
        heard: &Heard<'_>,
        said: &Explained,
        notices: &mut Vec<Notice>,
    ) {
        self.begin(heard.time);
        self.asked = self.asked.saturating_add(1);
        if self.repeats(heard, said.axis, notices) {
            return;
        }
        let before = self.requests.iter().rfind(|request| request.told.axis == said.axis);
        self.unwaited += u64::from(before.is_some_and(Request::owes_answer));
        self.overtake(awaits, heard, said.axis, notices);
        let mut request = self.room(notices);
        let op = self.op(&said.kind);
        request.told = Exchange {
            axis: said.axis,
            op,
            asked: (heard.number, heard.time),
            answered: None,
            outcome: Outcome::Unanswered,
            retries: 0,
        };
        request.frame.keep(&heard.raw);
        request.awaits = awaits;
        (request.acks, request.answers, request.spoiled) = (0, 0, false);
        request.last = heard.time;
        request.limit = heard.profile.map_or(LIMIT_UNKNOWN, |profile| {
            LIMIT_MIN.max(u64::from(profile.reply_timeout_ms) * 1_000_000)
        });
        request.state = if awaits == Awaits::NOTHING { State::Settled } else { State::Open };
        self.wait_for(&request);
        self.requests.push_back(request);
    }

    /// The same bytes again, before their answer.
    fn repeats(&mut self, heard: &Heard<'_>, axis: Option<u32>, notices: &mut Vec<Notice>) -> bool {
        let same = |request: &Request| {
            request.state == State::Open && request.sure() && request.frame.raw() == heard.raw
        };
        let Some(at) = self.requests.iter().rposition(same) else { return false };
        // To a host whose answer was spoiled it is a new request, as after one whose check failed, and
        // to one that asked the axis something else meanwhile, and was answered.
        let went_on = |later: &Request| later.told.axis == axis && later.state == State::Settled;
        let went_on = self.requests.iter().skip(at + 1).any(went_on);
        let request = &self.requests[at];
        if request.told.retries == RETRIES_MAX || request.spoiled || went_on {
            self.give_up(at, heard.time, notices);
            return false;
        }
        let request = &mut self.requests[at];
        request.told.retries = request.told.retries.saturating_add(1);
        request.last = heard.time;
        let text = format!(
            "{} sent again before an answer, for the {} time",
            request.name(),
            ordinal(request.told.retries)
        );
        notices.push(odd(Oddity::Retry, axis, text));
        true
    }

    /// A new request to an axis ends the wait for the one before, on lines where one thing is said
    /// at a time. What went to the axis and is settled need not be remembered any longer.
    fn overtake(
        &mut self,
        awaits: Awaits,
        heard: &Heard<'_>,
        axis: Option<u32>,
        notices: &mut Vec<Notice>,
    ) {
        let turns = heard.raw.id.is_none();
        let acked = awaits.acks != Owed::Nothing;
        for at in (0..self.requests.len()).rev() {
            let request = &self.requests[at];
            let same_axis = request.told.axis == axis;
            let unacked = turns && acked && request.acks == 0 && self.acks > 0;
            match request.state {
                State::Open if unacked && request.awaits.acks == Owed::Exactly(1) => {
                    self.unacknowledged(at, heard.time, notices);
                }
                State::Open if turns && !acked && same_axis => {
                    self.give_up(at, heard.time, notices);
                }
                State::Settled if same_axis => drop(self.requests.remove(at)),
                _ => {}
            }
        }
    }

    /// The next message came before the acknowledgement of this one.
    fn unacknowledged(&mut self, at: usize, now: Option<Stamp>, notices: &mut Vec<Notice>) {
        let request = &mut self.requests[at];
        if request.awaits.answers == Owed::Nothing {
            return self.give_up(at, now, notices);
        }
        // Its answer may still come.
        request.awaits.acks = Owed::Nothing;
        let text = format!("{}: not acknowledged", request.name());
        notices.push(odd(Oddity::MissingAck, request.told.axis, text));
    }

    /// Takes an acknowledgement: of the oldest message that waits for one.
    pub fn acknowledge(&mut self, heard: &Heard<'_>, notices: &mut Vec<Notice>) -> Quality {
        self.begin(heard.time);
        self.acks += 1;
        let waits = |request: &&mut Request| {
            request.state == State::Open
                && request.awaits.acks != Owed::Nothing
                && request.acks == 0
        };
        let Some(request) = self.requests.iter_mut().find(waits) else {
            if let Some(request) = self.acknowledged(heard.time) {
                let text = format!("{}: acknowledged twice", request.name());
                notices.push(odd(Oddity::DuplicateReply, request.told.axis, text));
            } else if self.settled_beginning(heard.time) {
                let text = "an acknowledgement that no message waits for".to_owned();
                notices.push(odd(Oddity::ForeignReply, None, text));
            }
            return Quality::Good;
        };
        request.acks = 1;
        if request.awaits.answers == Owed::Nothing {
            let late = request.is_late(heard.time);
            request.state = State::Settled;
            request.told.answered = Some((heard.number, heard.time));
            request.told.outcome = if late { Outcome::Late } else { Outcome::Done };
            notices.push(Notice::Exchange(request.told));
        }
        Quality::Good
    }

    /// The last message, if it was acknowledged a moment ago: a device that says so again means it.
    fn acknowledged(&self, now: Option<Stamp>) -> Option<&Request> {
        let last = self.requests.back().filter(|request| request.acks > 0)?;
        let soon = now.zip(last.last).is_none_or(|(now, sent)| now.since(sent) <= last.limit);
        soon.then_some(last)
    }

    /// Takes an answer, or what may have been told unasked.
    pub fn answer(
        &mut self,
        tells: bool,
        heard: &Heard<'_>,
        said: &Explained,
        notices: &mut Vec<Notice>,
    ) -> Settled {
        self.begin(heard.time);
        let fits = |request: &Request| heard.dissector.answers(&heard.raw, &request.frame.raw());
        let open = self.candidate(heard);
        if let Some(at) = open {
            self.answers += 1;
            self.overtaken(at, heard, notices);
            let quality = self.settle(at, heard, notices);
            return Settled { asked: true, quality };
        }
        let again = |request: &Request| fits(request) && self.may_come_again(request, heard);
        // What was given up a moment ago is still owed; what has its answer is not.
        let owed = |request: &Request| {
            let waited = request.last.zip(heard.time).map_or(0, |(last, now)| now.since(last));
            request.state == State::GivenUp && waited <= request.patience() && fits(request)
        };
        let owed = self.requests.iter().rposition(owed);
        let known = owed.or_else(|| self.requests.iter().rposition(again));
        let mut quality = Quality::Good;
        match known {
            Some(at) if self.requests[at].state == State::GivenUp || !tells => {
                quality = self.again(at, heard, notices);
            }
            None if !tells && self.settled_beginning(heard.time) => {
                let axis = said.axis.map_or(String::new(), |axis| format!(" of axis {axis}"));
                let text = format!("an answer{axis} ({}) that nobody asked for", said.kind);
                notices.push(odd(Oddity::ForeignReply, said.axis, text));
            }
            _ => {}
        }
        Settled { asked: known.is_some(), quality }
    }

    /// An axis answers in order: what it was asked before, and could be answered so too, is lost.
    fn overtaken(&mut self, at: usize, heard: &Heard<'_>, notices: &mut Vec<Notice>) {
        for earlier in 0..at {
            let request = &self.requests[earlier];
            let same = request.told.axis == self.requests[at].told.axis;
            let fits = || heard.dissector.answers(&heard.raw, &request.frame.raw());
            if same && request.owes_answer() && fits() {
                self.give_up(earlier, heard.time, notices);
            }
        }
    }

    /// Whether an answer can belong to what is not waited for any more: soon after it, and where one
    /// thing is said at a time, before anything else was asked.
    fn may_come_again(&self, request: &Request, heard: &Heard<'_>) -> bool {
        if request.state == State::GivenUp {
            return true;
        }
        let answered = request.told.answered.map_or(request.last, |(_, time)| time);
        let soon = |(now, then): (Stamp, Stamp)| now.since(then) <= request.limit;
        let turns = heard.raw.id.is_none() && request.awaits.acks == Owed::Nothing;
        let newest = self.requests.back().is_some_and(|last| core::ptr::eq(last, request));
        heard.time.zip(answered).is_none_or(soon) && (newest || !turns)
    }

    /// An answer to what waits for it.
    fn settle(&mut self, at: usize, heard: &Heard<'_>, notices: &mut Vec<Notice>) -> Quality {
        self.paired = (self.requests[at].told.asked.0, heard.number);
        let request = &mut self.requests[at];
        if request.awaits.acks == Owed::Exactly(1) && request.acks == 0 && self.acks > 0 {
            let text = format!("{}: answered, but not acknowledged", request.name());
            notices.push(odd(Oddity::MissingAck, request.told.axis, text));
        }
        request.acks = request.acks.max(1);
        request.answers = request.answers.saturating_add(1);
        request.told.answered = Some((heard.number, heard.time));
        request.answer.clear();
        request.answer.extend_from_slice(heard.raw.bytes);
        if matches!(request.awaits.answers, Owed::Exactly(count) if request.answers < count) {
            return Quality::Good;
        }
        request.state = State::Settled;
        let refused = heard.dissector.refuses(&heard.raw, &request.frame.raw());
        let late = request.is_late(heard.time);
        if !late {
            let took = request.told.latency().unwrap_or(0);
            self.slowest = self.slowest.max(took);
            self.fastest = Some(self.fastest.map_or(took, |fastest| fastest.min(took)));
            self.lately = Some(self.lately.map_or(took, |lately| lately - lately / 8 + took / 8));
        }
        request.told.outcome = match refused {
            Some(_) => Outcome::Refused,
            None if late => Outcome::Late,
            None => Outcome::Done,
        };
        if let Some(why) = refused {
            let text = format!("{}: {why}", request.name());
            notices.push(odd(Oddity::Refused, request.told.axis, text));
        }
        if late {
            let limit = request.limit / 1_000_000;
            let took = request.told.latency().unwrap_or(0) / 1_000_000;
            let text = format!("{}: answered after {took} ms, {limit} allowed", request.name());
            notices.push(odd(Oddity::LateReply, request.told.axis, text));
        }
        notices.push(Notice::Exchange(request.told));
        if refused.is_none() && heard.dissector.forms(&request.frame.raw()) {
            self.form_by(at);
        }
        if late { Quality::Stale } else { Quality::Good }
    }

    /// Another answer to what was settled or given up.
    fn again(&mut self, at: usize, heard: &Heard<'_>, notices: &mut Vec<Notice>) -> Quality {
        let request = &self.requests[at];
        let axis = request.told.axis;
        let talk = Talk { form: self.form(axis), profile: heard.profile, ..Talk::default() };
        if heard.dissector.restarted(&heard.raw, &request.frame.raw(), &talk) {
            let text = format!(
                "{}: answered as from power-up, so the drive has started again",
                request.name()
            );
            notices.push(odd(Oddity::Restart, axis, text));
            self.forms.retain(|(of, _)| Some(*of) != axis);
            return Quality::Good;
        }
        let request = &mut self.requests[at];
        let whose = request.name();
        if request.state == State::GivenUp {
            request.state = State::Settled;
            let text = format!("{whose}: answered after it had been given up");
            notices.push(odd(Oddity::LateReply, axis, text));
            return Quality::Stale;
        }
        let expected = match request.awaits.answers {
            Owed::Perhaps => return Quality::Good,
            Owed::Exactly(count) => u16::from(count),
            Owed::Nothing => 0,
        };
        let before = u16::from(request.answers);
        request.answers = request.answers.saturating_add(1);
        let (kind, text) = if expected == 0 {
            (Oddity::ForeignReply, format!("{whose}: answered, though nobody should"))
        } else if before < expected.saturating_mul(1 + request.told.retries) {
            (Oddity::LateReply, format!("{whose}: answered once more, to its repetition"))
        } else if request.answer == heard.raw.bytes {
            (Oddity::DuplicateReply, format!("{whose}: the same answer twice"))
        } else {
            let text = format!("{whose}: two different answers, so two devices have one address");
            (Oddity::DuplicateAddress, text)
        };
        notices.push(odd(kind, axis, text));
        if kind == Oddity::DuplicateReply { Quality::Good } else { Quality::Stale }
    }

    /// Something whose check fails came where an answer was due.
    pub fn broken(&mut self, heard: &Heard<'_>, notices: &mut Vec<Notice>) {
        let Some(at) = self.requests.iter().rposition(Request::owes_answer) else { return };
        let last = at + 1 == self.requests.len();
        // Behind a relay several may wait: whose it was cannot be told.
        let alone = self.requests.iter().filter(|request| request.owes_answer()).count() == 1;
        let request = &mut self.requests[at];
        if !last || (request.awaits.acks != Owed::Nothing && !(alone && request.acks > 0)) {
            return;
        }
        request.state = State::Settled;
        request.told.answered = Some((heard.number, heard.time));
        request.told.outcome = Outcome::Broken;
        notices.push(Notice::Exchange(request.told));
        // A good answer may yet come to a repetition of it, as to a new request.
        self.requests.remove(at);
    }

    /// Bytes that are no frame came from a drive: the answer that is due may have been among them, and
    /// may yet come whole.
    pub fn spoil(&mut self) {
        let last = self.requests.back_mut().filter(|request| request.owes_answer());
        last.into_iter().for_each(|request| request.spoiled = true);
    }

    /// Time goes on.
    pub fn pass(&mut self, now: Stamp, notices: &mut Vec<Notice>) {
        self.now = Some(now);
        if self.due.is_none_or(|due| now < due) {
            return;
        }
        self.due = None;
        for at in 0..self.requests.len() {
            let request = &self.requests[at];
            let waited = request.last.map_or(0, |last| now.since(last));
            if request.state == State::Open && waited > request.patience() {
                self.give_up(at, Some(now), notices);
            }
            self.due = earlier(self.due, due(&self.requests[at]));
        }
    }

    /// The capture ends: what is due by then did not come, the rest is nobody's fault.
    pub fn end(&mut self, notices: &mut Vec<Notice>) {
        for at in 0..self.requests.len() {
            let request = &mut self.requests[at];
            if request.state != State::Open || !request.sure() {
                continue;
            }
            if request.is_late(self.now) {
                self.give_up(at, self.now, notices);
            } else {
                request.told.outcome = Outcome::Unknown;
                notices.push(Notice::Exchange(request.told));
            }
        }
        self.requests.clear();
    }

    fn give_up(&mut self, at: usize, now: Option<Stamp>, notices: &mut Vec<Notice>) {
        let acks = self.acks;
        let request = &mut self.requests[at];
        request.state = State::GivenUp;
        // A tool between host and drive may keep acknowledgements to itself.
        let unheard = acks == 0 && self.answers > 0 && request.awaits.answers == Owed::Nothing;
        if !request.sure() || unheard {
            return;
        }
        if request.spoiled {
            // That its answer was spoiled was told.
            request.told.outcome = Outcome::Broken;
            return notices.push(Notice::Exchange(request.told));
        }
        let due = request.last.map(|last| Stamp(last.0.saturating_add(request.limit)));
        let time = due.map(|due| now.map_or(due, |now| now.min(due)));
        let mut text = match (request.awaits.answers, request.answers) {
            (Owed::Nothing, _) => format!("{}: not acknowledged", request.name()),
            (Owed::Exactly(count), got @ 1..) => {
                format!("{}: {got} of {count} answers", request.name())
            }
            _ => format!("{}: no answer", request.name()),
        };
        if request.told.retries > 0 {
            let _ = write!(text, ", though sent {} times", request.told.retries + 1);
        }
        let kind = match (request.awaits.answers, request.answers) {
            (Owed::Nothing, _) if acks > 0 => Oddity::MissingAck,
            (_, 1..) => Oddity::Incomplete,
            _ => Oddity::Unanswered,
        };
        let axis = request.told.axis;
        notices.push(Notice::Exchange(request.told));
        notices.push(Notice::Odd(Odd { kind, axis, time, text }));
        if self.given_up.len() < AXES_MAX {
            let times = 1 + usize::from(self.requests[at].told.retries);
            self.given_up.extend(axis.into_iter().cycle().take(times));
        }
    }

    /// How the axis answers from now on.
    fn form_by(&mut self, at: usize) {
        let request = &self.requests[at];
        let Some(axis) = request.told.axis else { return };
        let slot = self.forms.iter().position(|(of, _)| *of == axis);
        let slot = slot.unwrap_or_else(|| {
            if self.forms.len() == AXES_MAX {
                self.forms.remove(0);
            }
            self.forms.push((axis, Bytes::default()));
            self.forms.len() - 1
        });
        self.forms[slot].1.keep(&request.frame.raw());
    }

    /// Room for another request; the oldest goes.
    fn room(&mut self, notices: &mut Vec<Notice>) -> Request {
        if self.requests.len() == REQUESTS_MAX {
            let settled = self.requests.iter().position(|request| request.state != State::Open);
            let at = settled.unwrap_or(0);
            if settled.is_none() {
                let now = self.requests[at].last;
                self.give_up(at, now, notices);
            }
            if let Some(request) = self.requests.remove(at) {
                return request;
            }
        }
        Request {
            told: Exchange {
                axis: None,
                op: "",
                asked: (0, None),
                answered: None,
                outcome: Outcome::Unanswered,
                retries: 0,
            },
            frame: Bytes::default(),
            awaits: Awaits::NOTHING,
            acks: 0,
            answers: 0,
            last: None,
            limit: 0,
            state: State::Settled,
            spoiled: false,
            answer: Vec::new(),
        }
    }

    fn wait_for(&mut self, request: &Request) {
        self.due = earlier(self.due, due(request));
    }

    fn begin(&mut self, now: Option<Stamp>) {
        self.began = self.began.or(now);
    }

    /// What nobody is seen to have asked for was not asked before the capture began.
    fn settled_beginning(&self, now: Option<Stamp>) -> bool {
        let past = |now: Stamp, began: Stamp| now.since(began) > LIMIT_MIN;
        let later = now.zip(self.began).is_none_or(|(now, began)| past(now, began));
        later && self.asked >= FIRST_REQUESTS
    }

    fn op(&mut self, kind: &str) -> Name {
        if let Some(known) = self.ops.iter().find(|op| **op == kind) {
            return known;
        }
        let op = name(kind);
        if self.ops.len() < OPS_MAX {
            self.ops.push(op);
        }
        op
    }
}

fn due(request: &Request) -> Option<Stamp> {
    let open = request.state == State::Open;
    let last = request.last.filter(|_| open)?;
    Some(Stamp(last.0.saturating_add(request.patience() + 1)))
}

fn earlier(one: Option<Stamp>, other: Option<Stamp>) -> Option<Stamp> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.min(other)),
        (one, other) => one.or(other),
    }
}

fn ordinal(number: u16) -> String {
    match number {
        1 => "first".to_owned(),
        2 => "second".to_owned(),
        3 => "third".to_owned(),
        number => format!("{number}th"),
    }
}
