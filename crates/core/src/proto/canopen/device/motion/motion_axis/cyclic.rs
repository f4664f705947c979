//! Cyclic synchronous position, velocity and torque, and interpolated position.

use super::*;

impl<const N: usize> MotionAxis<N> {
    /// The next position of the host's way.
    #[inline]
    pub(super) fn aim_interpolator<T: MotionSettings>(
        &mut self,
        target: f64,
        scene: &mut MotionContext<'_, T>,
    ) {
        let target = self.clamp_to_limits(target, scene);
        let blocked = scene.is_blocked(target - self.interpolator.position());
        self.limited |= blocked;
        let target = if blocked { self.interpolator.position() } else { target };
        self.interpolator.set_target(target, scene.settings.cycle_ms());
    }

    #[inline]
    pub(super) fn tick_cyclic_position<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        let offsets = scene.settings.offsets();
        if self.interpolator.is_over() {
            self.aim_interpolator(scene.settings.target_position() + offsets.position, scene);
        }
        scene.shaft.offset_torque(offsets.torque);
        self.follow_interpolator(offsets.velocity, scene)
    }

    /// Interpolated position: the way from record to record, while bit 4 is set (CiA 402-2, interpolated position).
    pub(super) fn tick_interpolated<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        if !self.is_interpolating() {
            self.set_flags(BIT_12 | REACHED, false);
            scene.shaft.settle_position();
            return None;
        }
        let target = scene.settings.interpolation_target();
        if self.interpolator.is_over() {
            self.aim_interpolator(target, scene);
        }
        let event = self.follow_interpolator(0.0, scene);
        let distance = self.user_coordinate(scene.shaft.position()) - target;
        let there = self.target_timer.within(distance, scene.settings.position_window());
        self.set_flags(REACHED, there);
        event
    }

    /// One tick of the way to the present target, with bit 12 for it.
    #[inline]
    fn follow_interpolator<T: MotionSettings>(
        &mut self,
        velocity_offset: f64,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        let mut setpoint = self.interpolator.step(scene.settings.velocity_max(), velocity_offset);
        setpoint.position += self.origin;
        scene.shaft.follow_setpoint(setpoint);
        self.set_flags(BIT_12, true);
        self.check_following_error(scene).then_some(MotionEvent::FollowingError)
    }

    pub(super) fn tick_cyclic_velocity<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        let (settings, top) = (scene.settings, scene.settings.velocity_max());
        let offsets = settings.offsets();
        let requested = settings.target_velocity() + offsets.velocity;
        let target = requested.clamp(-top, top);
        let blocked = scene.is_blocked(target);
        self.limited = blocked || target != requested;
        scene.shaft.set_limits(Limits::trapezoid(top, 0.0));
        scene.shaft.offset_torque(offsets.torque);
        scene.shaft.set_velocity(if blocked { 0.0 } else { target });
        self.set_flags(BIT_12, true);
        None
    }

    pub(super) fn tick_cyclic_torque<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        let settings = scene.settings;
        let (backward, forward) = settings.torque_limits();
        let requested = settings.target_torque() + settings.offsets().torque;
        self.torque = requested.max(-backward).min(forward);
        self.apply_torque(self.torque, scene);
        self.set_flags(BIT_12, true);
        None
    }
}
