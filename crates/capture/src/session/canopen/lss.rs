//! Layer setting: what is said to all devices of a bus at once, of which one or none answers
//! (CiA 305). Requests that only together ask something, such as the four numbers that select a
//! device, are one exchange.
//!
//! Silence answers some: whoever looks which devices there are hears nothing where there is none. A
//! setting is owed an answer.

use polepair_core::proto::canopen::explain::{lss_answers, lss_kind};
use polepair_core::proto::canopen::lss::{Reply, Request};

use super::sdo::{At, FLASH_TIMEOUT_NS, TIMEOUT_NS};
use crate::session::{Exchange, Name, Notice, Odd, Oddity, Outcome};
use crate::stamp::Stamp;

/// The layer setting of one bus.
#[derive(Debug, Default)]
pub(super) struct Lss {
    open: Option<Asked>,
    /// What was answered last, and with what.
    settled: Option<(Asked, [u8; 8])>,
    /// What was given up.
    given_up: Option<Asked>,
    /// A request was heard: what is answered now was not asked before the capture.
    followed: bool,
}

/// What is asked.
#[derive(Clone, Copy, Debug)]
struct Asked {
    request: [u8; 8],
    op: Name,
    /// Its first frame, and its last.
    first: At,
    last: At,
    owed: Owed,
    retries: u16,
}

/// What a request is owed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Owed {
    /// Nothing: it is an order, or more of it comes.
    Nothing,
    /// An answer where there is such a device; silence says that there is none.
    Perhaps,
    /// An answer.
    Answer,
}

impl Owed {
    const fn of(request: Request) -> Self {
        match request {
            Request::SwitchGlobal(_) | Request::ActivateBitTiming(_) | Request::Other(_) => {
                Self::Nothing
            }
            Request::SwitchSelective(..)
            | Request::Identify(..)
            | Request::IdentifyUnconfigured
            | Request::FastScan { .. } => Self::Perhaps,
            Request::SetNode(_)
            | Request::SetBitTiming(..)
            | Request::Store
            | Request::Inquire(_)
            | Request::InquireNode => Self::Answer,
        }
    }
}

impl Asked {
    fn patience(&self) -> u64 {
        match Request::parse(&self.request) {
            Ok(Request::Store) => FLASH_TIMEOUT_NS,
            _ => TIMEOUT_NS,
        }
    }

    fn exchange(&self, answered: Option<At>, outcome: Outcome) -> Notice {
        let Self { op, first: asked, retries, .. } = *self;
        Notice::Exchange(Exchange { axis: None, op, asked, answered, outcome, retries })
    }
}

impl Lss {
    /// Takes eight bytes from the master.
    pub fn request(&mut self, bytes: [u8; 8], at: At, notices: &mut Vec<Notice>) {
        let Ok(request) = Request::parse(&bytes) else { return };
        (self.followed, self.settled) = (true, None);
        let op = lss_kind(request);
        let before = self.open.take();
        if let Some(mut open) = before {
            let more = open.op == op && open.owed == Owed::Perhaps && is_part(request);
            let again = open.owed == Owed::Answer && open.request == bytes;
            if more || again {
                (open.request, open.last) = (bytes, at);
                open.retries += u16::from(again);
                self.open = Some(open);
                if again {
                    notices.push(odd(Oddity::Retry, format!("{op} sent again before an answer")));
                }
                return;
            }
            self.give_up(open, " before the next request", notices);
        }
        let owed = Owed::of(request);
        let asked = Asked { request: bytes, op, first: at, last: at, owed, retries: 0 };
        match owed {
            Owed::Nothing => notices.push(asked.exchange(None, Outcome::Done)),
            _ => self.open = Some(asked),
        }
    }

    /// Takes eight bytes from a device.
    pub fn reply(&mut self, bytes: [u8; 8], at: At, notices: &mut Vec<Notice>) {
        let fits = |asked: &Asked| lss_answers(&bytes, &asked.request);
        if let Some(asked) = self.open.take_if(|asked| fits(asked)) {
            self.settled = Some((asked, bytes));
            let refused = refusal(bytes);
            if let Some(error) = refused {
                let text = format!("{} was refused, error {error}", asked.op);
                notices.push(odd(Oddity::Refused, text));
            }
            let outcome = if refused.is_some() { Outcome::Refused } else { Outcome::Done };
            return notices.push(asked.exchange(Some(at), outcome));
        }
        if let Some(asked) = self.given_up.take_if(|asked| fits(asked)) {
            let ms = at.1.zip(asked.last.1).map_or(0, |(now, then)| now.since(then) / 1_000_000);
            let text = format!("{}: the answer came {ms} ms after its request", asked.op);
            return notices.push(odd(Oddity::LateReply, text));
        }
        match &self.settled {
            // Whoever fits answers, and those that do are as many as there are.
            Some((asked, _)) if fits(asked) && asked.owed == Owed::Perhaps => {}
            Some((asked, before)) if fits(asked) && *before == bytes => {
                let text = format!("{}: the same answer twice", asked.op);
                notices.push(odd(Oddity::DuplicateReply, text));
            }
            Some((asked, _)) if fits(asked) => {
                let text = format!("{}: two devices are in configuration at once", asked.op);
                notices.push(odd(Oddity::DuplicateAddress, text));
            }
            _ if self.followed => {
                let text = "an answer to layer setting that nobody asked for".to_owned();
                notices.push(odd(Oddity::ForeignReply, text));
            }
            _ => {}
        }
    }

    /// When silence is an answer, or misses one.
    pub fn due(&self) -> Option<Stamp> {
        let open = self.open.as_ref()?;
        Some(Stamp(open.last.1?.0.saturating_add(open.patience())))
    }

    /// Time went on to `now`.
    pub fn pass(&mut self, now: Stamp, notices: &mut Vec<Notice>) {
        if self.due().is_some_and(|due| due < now)
            && let Some(open) = self.open.take()
        {
            let ms = open.patience() / 1_000_000;
            self.give_up(open, &format!(" within {ms} ms"), notices);
        }
    }

    /// The capture ends: who was not given the time to answer is not accused.
    pub fn end(&mut self, notices: &mut Vec<Notice>) {
        notices.extend(self.open.take().map(|open| open.exchange(None, Outcome::Unknown)));
    }

    fn give_up(&mut self, asked: Asked, why: &str, notices: &mut Vec<Notice>) {
        if asked.owed == Owed::Answer {
            notices.push(asked.exchange(None, Outcome::Unanswered));
            let text = format!("{} was not answered{why}", asked.op);
            let time = asked.last.1;
            let kind = Oddity::Unanswered;
            notices.push(Notice::Odd(Odd { kind, axis: None, time, text }));
            self.given_up = Some(asked);
        } else {
            notices.push(asked.exchange(None, Outcome::Done));
        }
    }
}

/// Whether a request goes on with what one of its kind began.
const fn is_part(request: Request) -> bool {
    use polepair_core::proto::canopen::lss::{Bound, Number};
    match request {
        Request::SwitchSelective(number, _) => !matches!(number, Number::Vendor),
        Request::Identify(bound, _) => !matches!(bound, Bound::Vendor),
        _ => false,
    }
}

/// The error of an answer that refuses.
fn refusal(bytes: [u8; 8]) -> Option<u8> {
    match Reply::parse(&bytes) {
        Ok(
            Reply::SetNode(error @ 1.., _)
            | Reply::SetBitTiming(error @ 1.., _)
            | Reply::Store(error @ 1.., _),
        ) => Some(error),
        _ => None,
    }
}

fn odd(kind: Oddity, text: String) -> Notice {
    Notice::Odd(Odd { kind, axis: None, time: None, text })
}
