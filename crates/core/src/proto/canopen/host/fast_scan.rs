//! The layer setting master: one service at a time, and the search for a device without node-ID, bit
//! by bit (CiA 305, fast scan).

use crate::error::Failure;
use crate::medium::Frame;
use crate::proto::canopen::ask::Answer;
use crate::proto::canopen::lss::{FAST_SCAN_BEGIN, Number, Reply, Request};
use crate::station::Ticket;
use crate::time::{Instant, earliest};

/// Silence that is a device's "no", ms.
const SILENCE_MS: u32 = 25;

/// What begins a scan: whoever has no node-ID answers.
pub const BEGIN: Request = Request::FastScan {
    number: 0,
    bit: FAST_SCAN_BEGIN,
    sub: Number::Vendor,
    next: Number::Vendor,
};

type Ended = (Ticket, Result<Answer, Failure>);

#[derive(Debug, Default)]
pub struct Lss {
    pending: Option<(Ticket, Task)>,
    unsent: bool,
    deadline: Option<Instant>,
}

#[derive(Clone, Copy, Debug)]
enum Task {
    Ask(Request),
    Scan(Scan),
}

/// How far a scan is.
#[derive(Clone, Copy, Debug)]
struct Scan {
    found: [u32; 4],
    at: usize,
    /// The bit in question; [`FAST_SCAN_BEGIN`] before the first. After the last one the number as a
    /// whole is asked, with bit 0 again.
    bit: u8,
    whole: bool,
    heard: bool,
}

impl Lss {
    pub fn is_idle(&self) -> bool {
        self.pending.is_none()
    }

    /// Takes a service, or a scan without one.
    pub fn submit(&mut self, ticket: Ticket, request: Option<Request>) -> Result<(), ()> {
        if !self.is_idle() {
            return Err(());
        }
        let scan = Scan { found: [0; 4], at: 0, bit: FAST_SCAN_BEGIN, whole: false, heard: false };
        self.pending = Some((ticket, request.map_or(Task::Scan(scan), Task::Ask)));
        self.unsent = true;
        Ok(())
    }

    pub fn cancel(&mut self) -> Option<(Ticket, ())> {
        self.unsent = false;
        self.deadline = None;
        self.pending.take().map(|(ticket, _)| (ticket, ()))
    }

    pub fn deadline(&self) -> Option<Instant> {
        earliest(self.deadline, None)
    }

    pub fn transmit(&mut self, now: Instant, timeout_ns: u64) -> Option<Frame> {
        let (_, task) = self.pending.as_mut().filter(|_| self.unsent)?;
        self.unsent = false;
        let (request, wait) = match task {
            Task::Ask(request) => (*request, timeout_ns),
            Task::Scan(scan) => {
                scan.heard = false;
                (scan.question(), u64::from(SILENCE_MS) * 1_000_000)
            }
        };
        self.deadline = Some(now.plus_ns(wait));
        Some(request.emit())
    }

    /// Ends what nobody answers, once it is sent.
    pub fn unanswered(&mut self) -> Option<Ended> {
        let Some((ticket, Task::Ask(request))) = self.pending else { return None };
        let last = Number::Serial;
        let silent = match request {
            Request::SwitchGlobal(_) | Request::ActivateBitTiming(_) | Request::Other(_) => true,
            Request::SwitchSelective(number, _) => number != last,
            _ => false,
        };
        if !silent {
            return None;
        }
        self.cancel();
        Some((ticket, Ok(Answer::Sent)))
    }

    pub fn reply(&mut self, now: Instant, reply: Reply) -> Option<Ended> {
        let (ticket, task) = self.pending.as_mut().filter(|_| !self.unsent)?;
        match task {
            Task::Ask(request) if answers(request, &reply) => {
                let ended = (*ticket, Ok(Answer::Lss(reply)));
                self.cancel();
                Some(ended)
            }
            // Several devices may answer; the question is over when its time is, so that none of
            // them is taken for an answer to the next.
            Task::Scan(scan) => {
                scan.heard |= reply == Reply::Identified;
                let _ = now;
                None
            }
            Task::Ask(_) => None,
        }
    }

    pub fn handle_timeout(&mut self, now: Instant) -> Option<Ended> {
        if self.deadline.is_none_or(|deadline| deadline > now) {
            return None;
        }
        let (ticket, task) = self.pending.as_mut()?;
        let ticket = *ticket;
        let ended = match task {
            Task::Ask(_) => Some(Err(Failure::Silent)),
            Task::Scan(scan) => scan.advance(),
        };
        self.deadline = None;
        match ended {
            Some(result) => {
                self.cancel();
                Some((ticket, result))
            }
            None => {
                self.unsent = true;
                None
            }
        }
    }
}

impl Scan {
    fn question(&self) -> Request {
        let (sub, next) = (Number::ALL[self.at], Number::ALL[(self.at + 1) % 4]);
        match self.bit {
            FAST_SCAN_BEGIN => BEGIN,
            bit => Request::FastScan {
                number: self.found[self.at],
                bit,
                sub,
                next: if self.whole { next } else { sub },
            },
        }
    }

    /// What silence, or an answer before it, leads to.
    fn advance(&mut self) -> Option<Result<Answer, Failure>> {
        match (self.bit, self.whole) {
            (FAST_SCAN_BEGIN, _) if self.heard => self.bit = 31,
            // A number that nobody has as a whole: two devices answered for each other's bits.
            (FAST_SCAN_BEGIN, _) => return Some(Err(Failure::Silent)),
            (_, true) if !self.heard => return Some(Err(Failure::Misbehaved)),
            (_, true) if self.at == 3 => return Some(Ok(Answer::Identity(self.found))),
            (_, true) => (self.at, self.bit, self.whole) = (self.at + 1, 31, false),
            (bit, false) => {
                if !self.heard {
                    self.found[self.at] |= 1 << bit;
                }
                match bit {
                    0 => self.whole = true,
                    bit => self.bit = bit - 1,
                }
            }
        }
        None
    }
}

/// Whether a reply is of the service that was asked.
fn answers(request: &Request, reply: &Reply) -> bool {
    match (request, reply) {
        (Request::SwitchSelective(..), Reply::Selected)
        | (Request::SetNode(_), Reply::SetNode(..))
        | (Request::SetBitTiming(..), Reply::SetBitTiming(..))
        | (Request::Store, Reply::Store(..))
        | (Request::InquireNode, Reply::Node(_))
        | (Request::Identify(..) | Request::FastScan { .. }, Reply::Identified)
        | (Request::IdentifyUnconfigured, Reply::Unconfigured) => true,
        (Request::Inquire(asked), Reply::Number(told, _)) => asked == told,
        _ => false,
    }
}
