//! Modes in which the drive makes the way itself: profile position, velocity and torque, homing.

use super::*;
use crate::plant::TICK_S;

/// Torque given up for each rad/s beyond the speed limit, share of the rated torque.
const OVERSPEED_GAIN: f64 = 0.05;

impl<const N: usize> Axis<N> {
    /// A set-point is handed over by the rising edge of bit 4.
    pub(super) fn new_point<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) {
        let settings = scene.settings;
        let base = match settings.relative_to() {
            _ if self.control & RELATIVE == 0 => 0.0,
            1 => self.user(scene.shaft.setpoint().position),
            2 => self.user(scene.shaft.position()),
            _ => self.commanded.unwrap_or(self.user(scene.shaft.setpoint().position)),
        };
        let mut limits = settings.profile();
        limits.velocity = limits.velocity.min(settings.velocity_max());
        let asked = settings.target_position() + base;
        let target = self.within(asked, scene);
        let point = Point { target, limits, passing: self.control & PASSING != 0 };
        self.acknowledged = true;
        if self.control & AT_ONCE != 0 {
            self.points.clear();
            self.commanded = Some(target);
            self.start(point, scene);
        } else if self.running.is_none() && !self.is_halted() {
            self.commanded = Some(target);
            self.start(point, scene);
        } else if self.points.push(point) {
            self.commanded = Some(target);
        }
        self.free_acknowledge();
    }

    /// Bit 12 falls when bit 4 is low and another set-point has room.
    pub(super) const fn free_acknowledge(&mut self) {
        if self.control & NEW_POINT == 0 && !self.points.is_full() {
            self.acknowledged = false;
        }
        self.set(BIT_12, self.acknowledged);
    }

    fn start<S: Shaft, T: Settings>(&mut self, point: Point, scene: &mut Scene<'_, S, T>) {
        self.running = Some(point);
        self.through = false;
        self.window.reset();
        self.set(REACHED, false);
        if !self.is_halted() {
            scene.shaft.manner(point.limits);
            scene.shaft.go(point.target + self.origin);
        }
    }

    /// The position cut to the limits of 607Dh.
    #[inline]
    pub(super) fn within<S, T: Settings>(&mut self, target: f64, scene: &Scene<'_, S, T>) -> f64 {
        let Some((least, greatest)) = scene.settings.position_limits() else { return target };
        let cut = target.max(least).min(greatest);
        self.limited = cut != target;
        cut
    }

    pub(super) fn position<S: Shaft, T: Settings>(
        &mut self,
        dirty: bool,
        scene: &mut Scene<'_, S, T>,
    ) -> Option<Event> {
        if self.is_at_limit(scene) {
            self.running = None;
            self.points.clear();
            self.free_acknowledge();
        }
        if self.running.is_some() {
            self.set(REACHED, false);
        }
        match self.running {
            // After a halt it goes on.
            Some(point) if dirty && !self.through => {
                scene.shaft.manner(point.limits);
                scene.shaft.go(point.target + self.origin);
            }
            Some(point) => self.go_on(point, scene),
            None => scene.shaft.settle(),
        }
        let arrived = self.tell_arrival(scene);
        if self.is_behind(scene) { Some(Event::FollowingError) } else { arrived }
    }

    fn go_on<S: Shaft, T: Settings>(&mut self, point: Point, scene: &mut Scene<'_, S, T>) {
        let next = self.points.first();
        if self.through {
            let at = self.user(scene.shaft.setpoint().position);
            let is_passed = |next: Point| (point.target - at) * (next.target - point.target) <= 0.0;
            if next.is_none_or(is_passed) {
                self.load(scene);
            }
        } else if scene.shaft.arrived() {
            self.running = None;
            self.load(scene);
        } else if let Some(next) = next.filter(|next| next.passing) {
            let at = self.user(scene.shaft.setpoint().position);
            if (next.target - point.target) * (point.target - at) > 0.0 {
                self.through = true;
                scene.shaft.go(next.target + self.origin);
            }
        }
    }

    fn load<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) {
        if let Some(next) = self.points.pop() {
            self.start(next, scene);
        }
        self.free_acknowledge();
    }

    /// Bit 10: the target was reached and the motor has been there long enough.
    fn tell_arrival<S: Shaft, T: Settings>(&mut self, scene: &Scene<'_, S, T>) -> Option<Event> {
        let target = self.commanded.filter(|_| self.running.is_none())?;
        let distance = self.user(scene.shaft.position()) - target;
        let there = self.window.within(distance, scene.settings.position_window());
        let was = self.flags & REACHED != 0;
        self.set(REACHED, there);
        (there && !was).then_some(Event::Arrived)
    }

    /// Bit 13: too far behind for too long.
    #[inline]
    pub(super) fn is_behind<S: Shaft, T: Settings>(&mut self, scene: &Scene<'_, S, T>) -> bool {
        let window = scene.settings.following_window();
        let distance = scene.shaft.setpoint().position - scene.shaft.position();
        let behind = self.behind.beyond(distance, window);
        self.set(BIT_13, behind);
        behind
    }

    /// On its way into a limit switch it stops hard.
    fn is_at_limit<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) -> bool {
        let toward = scene.shaft.setpoint().velocity;
        let blocked = scene.blocked(toward);
        if blocked {
            self.brake(Braking::Hard, scene);
        }
        // It may roll back a little, still on the switch.
        self.limited = blocked || (self.limited && (scene.positive || scene.negative));
        blocked
    }

    pub(super) fn velocity<S: Shaft, T: Settings>(
        &mut self,
        dirty: bool,
        scene: &mut Scene<'_, S, T>,
    ) -> Option<Event> {
        let settings = scene.settings;
        let (asked, top) = (settings.target_velocity(), settings.velocity_max());
        let target = asked.clamp(-top, top);
        let blocked = scene.blocked(target);
        if blocked {
            self.is_at_limit(scene);
        } else if dirty || self.limited {
            scene.shaft.manner(Limits { velocity: top, ..settings.profile() });
            scene.shaft.turn(target);
        }
        self.limited = blocked || target != asked;
        let speed = scene.shaft.velocity();
        let reached = self.window.within(speed - asked, settings.velocity_window());
        let moves = self.slow.beyond(speed, settings.standstill());
        self.set(REACHED, reached);
        self.set(BIT_12, !moves);
        None
    }

    /// Profile torque: along the slope, less what would make it faster than allowed.
    pub(super) fn drive<S: Shaft, T: Settings>(
        &mut self,
        scene: &mut Scene<'_, S, T>,
    ) -> Option<Event> {
        let settings = scene.settings;
        let max = settings.torque_max();
        let target = settings.target_torque().clamp(-max, max);
        let slope = settings.torque_slope() * TICK_S;
        let step = if slope > 0.0 { slope } else { f64::INFINITY };
        self.torque += (target - self.torque).clamp(-step, step);
        self.push(self.torque, scene);
        self.set(REACHED, self.torque == target);
        None
    }

    /// Drives a torque, within the speed limit and not into a limit switch.
    pub(super) fn push<S: Shaft, T: Settings>(&mut self, torque: f64, scene: &mut Scene<'_, S, T>) {
        let (top, speed) = (scene.settings.velocity_max(), scene.shaft.velocity());
        let (back, ahead) =
            (if scene.negative { 0.0 } else { top }, if scene.positive { 0.0 } else { top });
        let most = (ahead - speed) * OVERSPEED_GAIN;
        let least = (-back - speed) * OVERSPEED_GAIN;
        let allowed = torque.min(most).max(least);
        self.limited = allowed != torque;
        scene.shaft.push(allowed);
    }

    pub(super) fn home<S: Shaft, T: Settings>(
        &mut self,
        scene: &mut Scene<'_, S, T>,
    ) -> Option<Event> {
        if self.homing.runs() {
            match self.homing.tick(scene) {
                Some(Found::Zero(zero)) => {
                    self.homed = true;
                    self.origin = zero + scene.settings.homing().offset;
                }
                Some(Found::Nothing) => self.homing_failed = true,
                None => {}
            }
        }
        let runs = self.homing.runs();
        let was = self.flags & BIT_12 != 0;
        self.set(REACHED, !runs && at_rest(scene.shaft));
        self.set(BIT_12, self.homed && !runs);
        self.set(BIT_13, self.homing_failed);
        if !runs {
            scene.shaft.settle();
        }
        (self.homed && !was).then_some(Event::Arrived)
    }
}
