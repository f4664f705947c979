//! The drive on a CAN bus.

use super::drive::Drive;
use super::objects::PDOS;
use crate::surroundings::{Act, GroundTruth, SurroundingsControl};
use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::proto::canopen::device::{CanEndpoint, Quirks};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::{Instant, earliest};

/// A simulated CiA 402 drive.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Device {
    end: CanEndpoint<PDOS>,
    drive: Drive,
}

impl Device {
    /// A drive after power-up.
    #[must_use]
    pub fn new(drive: Drive) -> Self {
        Self::with_quirks(drive, Quirks::STRICT)
    }

    /// [`new`](Self::new) with deviations from the standard.
    #[must_use]
    pub fn with_quirks(mut drive: Drive, quirks: Quirks) -> Self {
        Self { end: CanEndpoint::new(quirks, &mut drive), drive }
    }

    /// The drive behind the bus.
    #[must_use]
    pub const fn drive(&self) -> &Drive {
        &self.drive
    }
}

impl Timed for Device {
    fn handle_timeout(&mut self, now: Instant) {
        self.drive.advance(now);
        self.end.handle_timeout(now, &mut self.drive);
    }

    #[inline]
    fn poll_timeout(&self) -> Option<Instant> {
        earliest(self.end.poll_timeout(), self.drive.next_due())
    }
}

impl crate::SimulatedDevice for Device {
    fn can_station(&mut self) -> Option<&mut dyn Station<Can>> {
        Some(self)
    }
}

impl Station<Can> for Device {
    #[inline]
    fn handle_input(&mut self, now: Instant, unit: &Frame) {
        self.drive.advance(now);
        self.end.handle_input(now, unit, &mut self.drive);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.drive.advance(now);
        self.end.handle_line(now, event, &mut self.drive);
    }

    #[inline]
    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        self.end.poll_transmit(now, out, &mut self.drive)
    }

    fn line(&self) -> CanLine {
        self.end.line()
    }
}

impl SurroundingsControl for Device {
    fn ground_truth(&mut self, now: Instant) -> GroundTruth {
        self.drive.ground_truth(now)
    }

    fn act(&mut self, now: Instant, act: Act) -> bool {
        let done = self.drive.act(now, act);
        if act == Act::PowerCycle {
            self.end.power_cycle(now, &mut self.drive);
        }
        done
    }

    fn take_notice(&mut self) -> Option<&'static str> {
        self.drive.take_notice()
    }
}
