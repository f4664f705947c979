//! Contouring: `SEG` segments through which a position, speed, torque or voltage reference moves.
//!
//! Source: the labelled frames (`SEG time, step`, `MODE PC`, `SC`, `TC`, `VC`) and MSR bit 10, "a contour
//! segment is due". \[I\] One segment waits while another runs; the step is added to the reference in
//! each slow loop of the segment's time; a segment of time 0 ends the contour. Out of segments a
//! position contour that still moves stops quickly, and the other references stay as they are.

use super::addresses;
use super::drive::Drive;
use super::execute::ExecuteError;
use super::motion::ControlLoop;
use super::units;
use polepair_core::plant::{Goal, Limits, Setpoint, TICK_S};
use polepair_core::proto::tml::wire::{Instruction, operand_address};

/// One segment.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Segment {
    /// Rest of the segment, slow loop periods.
    periods: f64,
    /// Added to the reference in each period, in its internal units.
    step: f64,
}

/// The segments of a contour.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Contour {
    current: Option<Segment>,
    next: Option<Segment>,
    /// The reference of speed, torque and voltage contours, internal units.
    reference: f64,
}

impl Contour {
    /// No segment.
    pub const EMPTY: Self = Self { current: None, next: None, reference: 0.0 };

    /// Returns whether `SEG` has to wait.
    pub const fn is_full(&self) -> bool {
        self.next.is_some()
    }
}

impl Drive {
    /// 7800 and 7Cxx: the next segment.
    pub fn execute_segment(&mut self, i: &Instruction) -> Result<(), ExecuteError> {
        let (time, step) = match i.opcode & 0xFC00 {
            0x7800 if i.opcode == 0x7800 => (i.word(0), i.long(1).cast_signed()),
            0x7C00 => {
                let time = self.memory.word(operand_address(i.opcode));
                (time, self.memory.long(i.word(0)))
            }
            _ => return Err(ExecuteError::Unknown),
        };
        if self.contour.is_full() {
            return Err(ExecuteError::NotPossible);
        }
        let step = f64::from(step) / 65536.0;
        self.contour.next = Some(Segment { periods: f64::from(time), step });
        self.mark_stale();
        Ok(())
    }

    /// UPD in a contouring mode: the first segment begins where the reference is.
    pub fn begin_contour(&mut self, outer: ControlLoop) {
        self.contour.current = None;
        self.contour.reference = match outer {
            ControlLoop::Speed => {
                self.shaft.scale.counts_of_speed(self.shaft.servo.setpoint().velocity)
            }
            _ => 0.0,
        };
    }

    /// Moves the reference on by a tick.
    pub fn tick_contour(&mut self, outer: ControlLoop) {
        let periods = TICK_S / self.shaft.scale.slow_s;
        if self.contour.current.is_none() {
            let Some(next) = self.contour.next.take() else { return };
            self.contour.current = Some(next);
            self.mark_stale();
        }
        let Some(segment) = &mut self.contour.current else { return };
        let share = periods.min(segment.periods);
        segment.periods -= share;
        let (step, ended) = (segment.step, segment.periods <= 1e-9);
        let way = step * share;
        match outer {
            ControlLoop::Position => {
                let scale = &self.shaft.scale;
                let (by, velocity) = (way / scale.per_rad, scale.speed_of_counts(step));
                let position = self.shaft.servo.setpoint().position + by;
                let velocity = if share > 0.0 { velocity } else { 0.0 };
                self.shaft.servo.follow(Setpoint { position, velocity, acceleration: 0.0 });
            }
            _ => {
                self.contour.reference += way;
                self.follow_contour(outer);
            }
        }
        if ended {
            self.contour.current = None;
            self.finish_segment(outer, if share > 0.0 { step } else { 0.0 });
        }
    }

    /// A segment is over: without a next one the contour is complete.
    fn finish_segment(&mut self, outer: ControlLoop, step: f64) {
        if self.contour.next.is_some() {
            return;
        }
        if outer == ControlLoop::Position && step != 0.0 {
            self.quick_stop();
        } else {
            self.complete_motion();
        }
    }

    fn follow_contour(&mut self, outer: ControlLoop) {
        let reference = self.contour.reference;
        self.memory.set_fixed(addresses::TREF, reference);
        match outer {
            ControlLoop::Speed => {
                let speed = self.shaft.scale.speed_of_counts(reference);
                self.shaft.servo.set_limits(Limits::trapezoid(speed.abs(), 0.0));
                self.shaft.servo.set_goal(Goal::Velocity(speed));
            }
            ControlLoop::Torque => self.drive_current(units::amperes_of_units(reference as i16)),
            _ => self.drive_voltage(reference.clamp(-32_768.0, 32_767.0) / 32_767.0),
        }
    }

    /// MSR bit 10: a segment is due.
    pub const fn is_segment_due(&self) -> bool {
        self.contour.current.is_some() && self.contour.next.is_none()
    }
}
