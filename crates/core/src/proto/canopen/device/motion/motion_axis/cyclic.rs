//! Cyclic synchronous position, velocity and torque.

use super::*;

impl<const N: usize> MotionAxis<N> {
    /// The next position of the host's way.
    #[inline]
    pub(super) fn aim_interpolator<T: MotionSettings>(&mut self, scene: &mut MotionContext<'_, T>) {
        let target = self.clamp_to_limits(scene.settings.target_position(), scene);
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
        if self.interpolator.is_over() {
            self.aim_interpolator(scene);
        }
        let (velocity, _) = scene.settings.offsets();
        let mut setpoint = self.interpolator.step(scene.settings.velocity_max(), velocity);
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
        let requested = settings.target_velocity() + settings.offsets().0;
        let target = requested.clamp(-top, top);
        let blocked = scene.is_blocked(target);
        self.limited = blocked || target != requested;
        scene.shaft.set_limits(Limits::trapezoid(top, 0.0));
        scene.shaft.set_velocity(if blocked { 0.0 } else { target });
        self.set_flags(BIT_12, true);
        None
    }

    pub(super) fn tick_cyclic_torque<T: MotionSettings>(
        &mut self,
        scene: &mut MotionContext<'_, T>,
    ) -> Option<MotionEvent> {
        let settings = scene.settings;
        let max = settings.torque_max();
        self.torque = (settings.target_torque() + settings.offsets().1).clamp(-max, max);
        self.apply_torque(self.torque, scene);
        self.set_flags(BIT_12, true);
        None
    }
}
