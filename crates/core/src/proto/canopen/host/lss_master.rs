//! The LSS master: one service at a time, and the search for a device without node-ID, bit by bit (CiA 305,
//! fast scan).

use crate::error::Failure;
use crate::medium::Frame;
use crate::proto::canopen::host_request::Answer;
use crate::proto::canopen::lss::{
    FAST_SCAN_BEGIN, IdentifyBound, IdentityNumber, LssReply, LssRequest,
};
use crate::station::Ticket;
use crate::time::{Instant, earliest};

/// Silence that is a device's "no", ms.
// CiA 305 states no time. Most questions of a scan end in silence, so each of them is short.
const SILENCE_MS: u32 = 25;

const NOTHING_SCANNED: &str = "no fast scan found a device before";

/// The first request of a scan: all nodes without node-ID reply.
pub const BEGIN_REQUEST: LssRequest = LssRequest::FastScan {
    number: 0,
    bit: FAST_SCAN_BEGIN,
    sub: IdentityNumber::Vendor,
    next: IdentityNumber::Vendor,
};

type FinishedTicket = (Ticket, Result<Answer, Failure>);

#[derive(Debug)]
pub struct LssMaster {
    /// Time to wait for replies to one question, ns.
    silence_ns: u64,
    pending: Option<(Ticket, LssTask)>,
    unsent: bool,
    deadline: Option<Instant>,
    /// The identity that the last scan found, if it found one.
    scanned: Option<[u32; 4]>,
}

#[derive(Clone, Copy, Debug)]
enum LssTask {
    Request(LssRequest),
    Scan(FastScan),
}

/// State of a scan.
#[derive(Clone, Copy, Debug)]
struct FastScan {
    found: [u32; 4],
    number_index: usize,
    question: ScanQuestion,
    answered: bool,
}

/// Question of a scan.
#[derive(Clone, Copy, Debug)]
enum ScanQuestion {
    /// Is there a node without node-ID?
    Begin,
    /// Is this bit of the number 0, after the bits found before it?
    Bit(u8),
    /// Is this the whole number? Without it, a late reply to a question about a bit would confirm a
    /// number that no node has.
    Confirm,
    /// Is this the whole number? A node that replies compares the next number from now on, or is in LSS
    /// configuration after the last one.
    Next,
}

impl LssMaster {
    /// Creates a master whose waits are `timeout_scale` times as long.
    pub fn new(timeout_scale: u32) -> Self {
        let silence_ns = u64::from(SILENCE_MS) * u64::from(timeout_scale) * 1_000_000;
        Self { silence_ns, pending: None, unsent: false, deadline: None, scanned: None }
    }

    pub fn is_idle(&self) -> bool {
        self.pending.is_none()
    }

    /// Returns whether a scan is running, whose requests any number of devices may answer.
    pub fn is_scanning(&self) -> bool {
        matches!(self.pending, Some((_, LssTask::Scan(_))))
    }

    /// Takes a service, or a scan without one.
    pub fn submit(&mut self, ticket: Ticket, request: Option<LssRequest>) -> Result<(), ()> {
        if !self.is_idle() {
            return Err(());
        }
        let scan = FastScan {
            found: [0; 4],
            number_index: 0,
            question: ScanQuestion::Begin,
            answered: false,
        };
        if request.is_none() {
            // An identity of the scan before must not be read as that of this one.
            self.scanned = None;
        }
        self.pending = Some((ticket, request.map_or(LssTask::Scan(scan), LssTask::Request)));
        self.unsent = true;
        Ok(())
    }

    /// A number of the device that the last scan found.
    pub fn last_scanned(&self, number: IdentityNumber) -> Result<Answer, Failure> {
        let found = self.scanned.ok_or(Failure::NotReady { hint: NOTHING_SCANNED })?;
        Ok(Answer::Lss(LssReply::Number(number, found[number as usize])))
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
            LssTask::Request(request) => (*request, timeout_ns),
            LssTask::Scan(scan) => {
                debug_assert!(scan.number_index < 4);
                scan.answered = false;
                (scan.next_request(), self.silence_ns)
            }
        };
        self.deadline = Some(now.plus_ns(wait));
        Some(request.emit())
    }

    /// Ends a request without reply, once it is sent.
    pub fn finish_unanswered(&mut self) -> Option<FinishedTicket> {
        let Some((ticket, LssTask::Request(request))) = self.pending else { return None };
        let silent = match request {
            LssRequest::SwitchGlobal(_)
            | LssRequest::ActivateBitTiming(_)
            | LssRequest::Other(_) => true,
            // Only the last of the four numbers selects a device, and is answered (CiA 305).
            LssRequest::SwitchSelective(number, _) => number != IdentityNumber::Serial,
            LssRequest::Identify(bound, _) => bound != IdentifyBound::SerialHigh,
            _ => false,
        };
        if !silent {
            return None;
        }
        self.cancel();
        Some((ticket, Ok(Answer::Sent)))
    }

    pub fn handle_reply(&mut self, now: Instant, reply: LssReply) -> Option<FinishedTicket> {
        let (ticket, task) = self.pending.as_mut().filter(|_| !self.unsent)?;
        match task {
            LssTask::Request(request) if is_answer(request, &reply) => {
                let ended = (*ticket, Ok(Answer::Lss(reply)));
                self.cancel();
                Some(ended)
            }
            // Several devices may answer; the question is over when its time is, so that none of
            // them is taken for an answer to the next.
            LssTask::Scan(scan) => {
                scan.answered |= reply == LssReply::Identified;
                let _ = now;
                None
            }
            LssTask::Request(_) => None,
        }
    }

    pub fn handle_timeout(&mut self, now: Instant) -> Option<FinishedTicket> {
        if self.deadline.is_none_or(|deadline| deadline > now) {
            return None;
        }
        let (ticket, task) = self.pending.as_mut()?;
        let ticket = *ticket;
        let ended = match task {
            LssTask::Request(_) => Some(Err(Failure::Silent)),
            LssTask::Scan(scan) => scan.advance(),
        };
        self.deadline = None;
        match ended {
            Some(result) => {
                if let Ok(Answer::Identity(found)) = result {
                    self.scanned = Some(found);
                }
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

impl FastScan {
    fn next_request(&self) -> LssRequest {
        let sub = IdentityNumber::ALL[self.number_index];
        let (bit, next) = match self.question {
            ScanQuestion::Begin => return BEGIN_REQUEST,
            ScanQuestion::Bit(bit) => (bit, sub),
            ScanQuestion::Confirm => (0, sub),
            ScanQuestion::Next => (0, IdentityNumber::ALL[(self.number_index + 1) % 4]),
        };
        LssRequest::FastScan { number: self.found[self.number_index], bit, sub, next }
    }

    /// Continues with the next question; the result once there is none.
    fn advance(&mut self) -> Option<Result<Answer, Failure>> {
        self.question = match (self.question, self.answered) {
            (ScanQuestion::Begin, true) => ScanQuestion::Bit(31),
            (ScanQuestion::Begin, false) => return Some(Err(Failure::Silent)),
            (ScanQuestion::Bit(bit), answered) => {
                if !answered {
                    debug_assert!(bit < 32, "a number has 32 bits");
                    self.found[self.number_index] |= 1 << bit;
                }
                bit.checked_sub(1).map_or(ScanQuestion::Confirm, ScanQuestion::Bit)
            }
            (ScanQuestion::Confirm, true) => ScanQuestion::Next,
            (ScanQuestion::Next, true) if self.number_index == 3 => {
                return Some(Ok(Answer::Identity(self.found)));
            }
            (ScanQuestion::Next, true) => {
                debug_assert!(self.number_index < 3, "an identity has four numbers");
                self.number_index += 1;
                ScanQuestion::Bit(31)
            }
            // No node has the whole number: two nodes replied for each other's bits, or one too late.
            (ScanQuestion::Confirm | ScanQuestion::Next, false) => {
                return Some(Err(Failure::Misbehaved));
            }
        };
        None
    }
}

/// Returns whether a reply is of the requested service.
fn is_answer(request: &LssRequest, reply: &LssReply) -> bool {
    match (request, reply) {
        (LssRequest::SwitchSelective(..), LssReply::Selected)
        | (LssRequest::SetNode(_), LssReply::SetNode(..))
        | (LssRequest::SetBitTiming(..), LssReply::SetBitTiming(..))
        | (LssRequest::Store, LssReply::Store(..))
        | (LssRequest::InquireNode, LssReply::Node(_))
        | (LssRequest::Identify(..) | LssRequest::FastScan { .. }, LssReply::Identified)
        | (LssRequest::IdentifyUnconfigured, LssReply::Unconfigured) => true,
        (LssRequest::Inquire(identity_number), LssReply::Number(report, _)) => {
            identity_number == report
        }
        _ => false,
    }
}
