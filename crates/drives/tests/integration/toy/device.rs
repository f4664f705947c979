//! The obeying end: a motor that turns at once.

use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::Instant;

use super::wire::ToyMessage;
use super::{ACTUAL, COMMANDED};

/// A drive.
pub struct ToyDevice {
    address: u8,
    speed: i32,
    reply: Option<Frame>,
}

impl ToyDevice {
    pub fn new(address: u8) -> Self {
        Self { address, speed: 0, reply: None }
    }
}

impl Timed for ToyDevice {
    fn handle_timeout(&mut self, _now: Instant) {}

    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
}

impl Station<Can> for ToyDevice {
    fn handle_input(&mut self, _now: Instant, frame: &Frame) {
        let request = ToyMessage::parse_request(frame).filter(|r| r.address == self.address);
        let Some(request) = request else { return };
        let register = u16::from(request.register);
        if request.writes && register == COMMANDED {
            self.speed = request.value;
        }
        let value = if [COMMANDED, ACTUAL].contains(&register) { self.speed } else { 0 };
        self.reply = Some(ToyMessage { value, ..request }.reply());
    }

    fn handle_line(&mut self, _now: Instant, _event: LineEvent) {}

    fn poll_transmit(&mut self, _now: Instant, out: &mut Frame) -> Option<usize> {
        *out = self.reply.take()?;
        Some(1)
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: 125_000 }
    }
}
