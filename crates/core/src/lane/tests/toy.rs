//! A drive of six registers, whose answers the test decides.

use super::*;

#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct ToyRequest {
    pub(super) write: bool,
    pub(super) index: u16,
    pub(super) value: i64,
    pub(super) class: RequestClass,
}

impl Request for ToyRequest {
    fn class(&self) -> RequestClass {
        self.class
    }
}

pub(super) struct ToyDriver;

impl RequestEncoder for ToyDriver {
    type Request = ToyRequest;

    fn read_request(&self, parameter: &Parameter) -> Result<ToyRequest, Unsupported> {
        Ok(ToyRequest {
            write: false,
            index: parameter.index,
            value: 0,
            class: RequestClass::Idempotent,
        })
    }

    fn write_request(
        &self,
        parameter: &Parameter,
        value: i64,
        class: RequestClass,
    ) -> Result<ToyRequest, Unsupported> {
        Ok(ToyRequest { write: true, index: parameter.index, value, class })
    }

    fn function_request(&self, _: u8, _: u16, _: i64) -> Result<ToyRequest, Unsupported> {
        Err(Unsupported::NoPlan)
    }

    fn parse_request(&self, text: &str) -> Result<ToyRequest, Unsupported> {
        let stop = ToyRequest { write: true, index: SPEED.0, value: 0, class: RequestClass::Stop };
        (text == "stop").then_some(stop).ok_or(Unsupported::BadText)
    }

    fn decode_request(&self, _: &RawFrame<'_>) -> Result<ToyRequest, Unsupported> {
        Err(Unsupported::BadBytes)
    }
}

impl AnswerDecoder for ToyDriver {
    type Answer = i64;

    fn decode_answer(&mut self, _: Option<&Parameter>, answer: &i64) -> Result<i64, Failure> {
        Ok(*answer)
    }
}

impl WriteRules for ToyDriver {}

impl Driver for ToyDriver {
    fn profile(&self) -> &'static Profile {
        &PROFILE
    }

    fn address(&self) -> u32 {
        1
    }
}

/// A host and the drive behind it in one: `lose` names requests whose answer is lost.
#[derive(Default)]
pub(super) struct ToyHost {
    pub(super) registers: [i64; 6],
    pub(super) log: Vec<ToyRequest>,
    pub(super) lose: Vec<usize>,
    /// Requests, by their number, that get another's answer.
    pub(super) wrong_answers: Vec<(usize, i64)>,
    pub(super) refuse: Option<u16>,
    pub(super) forbids: Option<u16>,
    /// Number of replies at each quarantine.
    pub(super) quarantines: Vec<usize>,
    pub(super) out: Option<(Ticket, ToyRequest)>,
    /// The wire has to be silent for a while: nothing is sent.
    pub(super) silenced: bool,
    pub(super) events: EventRing<i64, 4>,
}

impl Timed for ToyHost {
    fn handle_timeout(&mut self, _: Instant) {}
    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
}

impl Station<Stream> for ToyHost {
    fn handle_input(&mut self, _: Instant, _: &[u8]) {
        let Some((ticket, request)) = self.out.take() else { return };
        let lost = self.lose.contains(&self.log.len());
        let mistaken = self.wrong_answers.iter().find(|(at, _)| *at == self.log.len());
        self.log.push(request);
        let register = &mut self.registers[usize::from(request.index)];
        let answer = if self.refuse == Some(request.index) {
            Err(Failure::Refused { code: 4 })
        } else {
            if request.write {
                *register = request.value;
            }
            match (lost, mistaken) {
                (true, _) => Err(Failure::Silent),
                (false, Some((_, answer))) => Ok(*answer),
                (false, None) => Ok(*register),
            }
        };
        self.events.push(EventSubject::Request(ticket), answer);
    }
    fn handle_line(&mut self, _: Instant, _: LineEvent) {
        self.out = None;
    }
    fn poll_transmit(&mut self, _: Instant, _: &mut [u8]) -> Option<usize> {
        self.out.filter(|_| !self.silenced).map(|_| 1)
    }
    fn line(&self) -> SerialLine {
        SerialLine::new_8n1(9600)
    }
}

impl HostWire for ToyHost {}

impl HostData for ToyHost {}

impl Host<Stream> for ToyHost {
    type Request = ToyRequest;

    type Answer = i64;

    fn submit(
        &mut self,
        _: Instant,
        ticket: Ticket,
        request: ToyRequest,
    ) -> Result<(), ToyRequest> {
        if self.out.is_some() {
            return Err(request);
        }
        if self.forbids == Some(request.index) {
            let failure = Failure::NotReady { hint: "never" };
            self.events.push(EventSubject::Request(ticket), Err(failure));
            return Ok(());
        }
        self.out = Some((ticket, request));
        Ok(())
    }

    fn recall(&mut self, _: &ToyRequest) -> Option<Ticket> {
        let (ticket, _) = self
            .out
            .take_if(|(_, request)| self.silenced && request.class != RequestClass::Stop)?;
        Some(ticket)
    }

    fn poll_event(&mut self) -> Option<&HostEvent<i64>> {
        self.events.next()
    }

    fn quarantine_drive(&mut self, _: Instant, address: u32) {
        assert_eq!(address, ToyDriver.address());
        self.quarantines.push(self.log.len());
    }

    fn encode_request(&self, request: &ToyRequest, out: &mut [u8]) -> usize {
        out[0] = request.index as u8;
        1
    }

    fn counters(&self) -> Counters {
        Counters::default()
    }
}
