//! Profile position, velocity and torque, and homing.

use super::*;
use crate::plant::TICK_S;

/// Torque given up for each rad/s beyond the speed limit, share of the rated torque.
const OVERSPEED_GAIN: f64 = 0.05;

impl<const N: usize> MotionAxis<N> {
    /// A set-point is handed over by the rising edge of bit 4.
    pub(super) fn handle_new_point<T: MotionSettings>(&mut self, scene: &mut MotionContext<'_, T>) {
        let settings = scene.settings;
        let base = match settings.relative_to() {
            _ if self.controlword & RELATIVE == 0 => 0.0,
            1 => self.user_coordinate(scene.shaft.setpoint().position),
            2 => self.user_coordinate(scene.shaft.position()),
            _ => self.commanded.unwrap_or(self.user_coordinate(scene.shaft.setpoint().position)),
        };
        let mut limits = settings.profile();
        limits.velocity = limits.velocity.min(settings.velocity_max());
        let requested = settings.target_position() + base;
        let target = self.clamp_to_limits(requested, scene);
        let point = ProfilePoint {
            target,
            limits,
            changes_in_passing: self.controlword & CHANGE_IN_PASSING != 0,
        };
        self.acknowledged = true;
        if self.controlword & CHANGE_AT_ONCE != 0 {
            self.queued_points.clear();
            self.commanded = Some(target);
            self.start_point(point, scene);
        } else if self.current_point.is_none() && !self.is_halted() {
            self.commanded = Some(target);
            self.start_point(point, scene);
        } else if self.queued_points.push(point) {
            self.commanded = Some(target);
        }
        self.free_acknowledge();
    }

    /// Bit 12 falls when bit 4 is low and another set-point has room.
    pub(super) const fn free_acknowledge(&mut self) {
        if self.controlword & NEW_POINT == 0 && !self.queued_points.is_full() {
            self.acknowledged = false;
        }
        self.set_flags(BIT_12, self.acknowledged);
    }

    fn start_point<T: MotionSettings>(
        &mut self,
        point: ProfilePoint,
        scene: &mut MotionContext<'_, T>,
    ) {
        self.current_point = Some(point);
        self.passes_through = false;
        self.target_timer.reset();
        self.set_flags(REACHED, false);
        if !self.is_halted() {
            scene.shaft.set_limits(point.limits);
            scene.shaft.move_to(point.target + self.origin);
        }
    }

    /// The position cut to the limits of 607Dh.
    #[inline]
    pub(super) fn clamp_to_limits<T: MotionSettings>(
        &mut self,
        target: f64,
        scene: &MotionContext<'_, T>,
    ) -> f64 {
        let Some((min, greatest)) = scene.settings.position_limits() else { return target };
        let cut = target.max(min).min(greatest);
        self.limited = cut != target;
        cut
    }

    pub(super) fn tick_position<T: MotionSettings>(
        &mut self,
        dirty: bool,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        if self.stop_at_limit_switch(scene) {
            self.current_point = None;
            self.queued_points.clear();
            self.free_acknowledge();
        }
        if self.current_point.is_some() {
            self.set_flags(REACHED, false);
        }
        match self.current_point {
            // After a halt it goes on.
            Some(point) if dirty && !self.passes_through => {
                scene.shaft.set_limits(point.limits);
                scene.shaft.move_to(point.target + self.origin);
            }
            Some(point) => self.advance_points(point, scene),
            None => scene.shaft.settle_position(),
        }
        let arrived = self.check_arrival(scene);
        if self.check_following_error(scene) { Some(MotionEvent::FollowingError) } else { arrived }
    }

    fn advance_points<T: MotionSettings>(
        &mut self,
        point: ProfilePoint,
        scene: &mut MotionContext<'_, T>,
    ) {
        let next = self.queued_points.peek();
        if self.passes_through {
            let at = self.user_coordinate(scene.shaft.setpoint().position);
            let is_passed =
                |next: ProfilePoint| (point.target - at) * (next.target - point.target) <= 0.0;
            if next.is_none_or(is_passed) {
                self.load_next_point(scene);
            }
        } else if scene.shaft.has_arrived() {
            self.current_point = None;
            self.load_next_point(scene);
        } else if let Some(next) = next.filter(|next| next.changes_in_passing) {
            let at = self.user_coordinate(scene.shaft.setpoint().position);
            if (next.target - point.target) * (point.target - at) > 0.0 {
                self.passes_through = true;
                scene.shaft.move_to(next.target + self.origin);
            }
        }
    }

    fn load_next_point<T: MotionSettings>(&mut self, scene: &mut MotionContext<'_, T>) {
        if let Some(next) = self.queued_points.pop() {
            self.start_point(next, scene);
        }
        self.free_acknowledge();
    }

    /// Bit 10: the target was reached and the motor has been there long enough.
    fn check_arrival<T: MotionSettings>(
        &mut self,
        scene: &MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        let target = self.commanded.filter(|_| self.current_point.is_none())?;
        let distance = self.user_coordinate(scene.shaft.position()) - target;
        let there = self.target_timer.within(distance, scene.settings.position_window());
        let was = self.flags & REACHED != 0;
        self.set_flags(REACHED, there);
        (there && !was).then_some(MotionEvent::Arrived)
    }

    /// Bit 13: too far behind for too long.
    #[inline]
    pub(super) fn check_following_error<T: MotionSettings>(
        &mut self,
        scene: &MotionContext<'_, T>,
    ) -> bool {
        let window = scene.settings.following_window();
        let distance = scene.shaft.setpoint().position - scene.shaft.position();
        let behind = self.following_timer.beyond(distance, window);
        self.set_flags(BIT_13, behind);
        behind
    }

    /// On its way into a limit switch it stops hard.
    fn stop_at_limit_switch<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> bool {
        let toward = scene.shaft.setpoint().velocity;
        let blocked = scene.is_blocked(toward);
        if blocked {
            self.brake(Braking::Hard, scene);
        }
        // It may roll back a little, still on the switch.
        self.limited = blocked || (self.limited && (scene.positive || scene.negative));
        blocked
    }

    pub(super) fn tick_velocity<T: MotionSettings>(
        &mut self,
        dirty: bool,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        let settings = scene.settings;
        let (requested, top) = (settings.target_velocity(), settings.velocity_max());
        let target = requested.clamp(-top, top);
        let blocked = scene.is_blocked(target);
        if blocked {
            self.stop_at_limit_switch(scene);
        } else if dirty || self.limited {
            scene.shaft.set_limits(Limits { velocity: top, ..settings.profile() });
            scene.shaft.set_velocity(target);
        }
        self.limited = blocked || target != requested;
        let speed = scene.shaft.velocity();
        let reached = self.target_timer.within(speed - requested, settings.velocity_window());
        let moves = self.standstill_timer.beyond(speed, settings.standstill());
        self.set_flags(REACHED, reached);
        self.set_flags(BIT_12, !moves);
        None
    }

    /// Profile torque: along the slope, less what would make it faster than allowed.
    pub(super) fn tick_torque<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        let settings = scene.settings;
        let (backward, forward) = settings.torque_limits();
        let target = settings.target_torque().max(-backward).min(forward);
        let slope = settings.torque_slope() * TICK_S;
        let step = if slope > 0.0 { slope } else { f64::INFINITY };
        self.torque += (target - self.torque).clamp(-step, step);
        self.apply_torque(self.torque, scene);
        self.set_flags(REACHED, self.torque == target);
        None
    }

    /// Drives a torque, within the speed limit and not into a limit switch.
    pub(super) fn apply_torque<T: MotionSettings>(
        &mut self,
        torque: f64,
        scene: &mut MotionContext<'_, T>,
    ) {
        let (top, speed) = (scene.settings.velocity_max(), scene.shaft.velocity());
        let (back, ahead) =
            (if scene.negative { 0.0 } else { top }, if scene.positive { 0.0 } else { top });
        let max = (ahead - speed) * OVERSPEED_GAIN;
        let min = (-back - speed) * OVERSPEED_GAIN;
        let allowed = torque.min(max).max(min);
        self.limited = allowed != torque;
        scene.shaft.apply_torque(allowed);
    }

    pub(super) fn tick_homing<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        if self.homing.is_running() {
            match self.homing.tick(scene) {
                Some(HomingResult::HomePosition(zero)) => {
                    self.homed = true;
                    self.origin = zero + scene.settings.homing().offset;
                }
                Some(HomingResult::NotFound) => self.homing_failed = true,
                None => {}
            }
        }
        let runs = self.homing.is_running();
        let was = self.flags & BIT_12 != 0;
        self.set_flags(REACHED, !runs && is_at_rest(scene.shaft));
        self.set_flags(BIT_12, self.homed && !runs);
        self.set_flags(BIT_13, self.homing_failed);
        if !runs {
            scene.shaft.settle_position();
        }
        (self.homed && !was).then_some(MotionEvent::Arrived)
    }
}
