//! Modes in which the host makes the way: cyclic synchronous position, velocity and torque.

use super::*;

impl<const N: usize> Axis<N> {
    /// The next position of the host's way.
    #[inline]
    pub(super) fn aim<S: Shaft, T: Settings>(&mut self, scene: &mut Scene<'_, S, T>) {
        let target = self.within(scene.settings.target_position(), scene);
        let blocked = scene.blocked(target - self.cycle.at());
        self.limited |= blocked;
        let target = if blocked { self.cycle.at() } else { target };
        self.cycle.aim(target, scene.settings.cycle_ms());
    }

    #[inline]
    pub(super) fn cyclic_position<S: Shaft, T: Settings>(
        &mut self,
        scene: &mut Scene<'_, S, T>,
    ) -> Option<Event> {
        if self.cycle.is_over() {
            self.aim(scene);
        }
        let (velocity, _) = scene.settings.offsets();
        let mut setpoint = self.cycle.step(scene.settings.velocity_max(), velocity);
        setpoint.position += self.origin;
        scene.shaft.follow(setpoint);
        self.set(BIT_12, true);
        self.is_behind(scene).then_some(Event::FollowingError)
    }

    pub(super) fn cyclic_velocity<S: Shaft, T: Settings>(
        &mut self,
        scene: &mut Scene<'_, S, T>,
    ) -> Option<Event> {
        let (settings, top) = (scene.settings, scene.settings.velocity_max());
        let asked = settings.target_velocity() + settings.offsets().0;
        let target = asked.clamp(-top, top);
        let blocked = scene.blocked(target);
        self.limited = blocked || target != asked;
        scene.shaft.manner(Limits::trapezoid(top, 0.0));
        scene.shaft.turn(if blocked { 0.0 } else { target });
        self.set(BIT_12, true);
        None
    }

    pub(super) fn cyclic_torque<S: Shaft, T: Settings>(
        &mut self,
        scene: &mut Scene<'_, S, T>,
    ) -> Option<Event> {
        let settings = scene.settings;
        let max = settings.torque_max();
        self.torque = (settings.target_torque() + settings.offsets().1).clamp(-max, max);
        self.push(self.torque, scene);
        self.set(BIT_12, true);
        None
    }
}
