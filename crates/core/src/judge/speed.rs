//! Judges whether a motor that was to turn at a speed has done so.

use core::f64::consts::PI;

/// Slower than this means standstill, rad/s: 0.5 rpm.
pub const STANDSTILL_ROTARY: f64 = 0.5 * PI / 30.0;
/// Standstill of a linear axis, m/s: 0.1 mm/s.
pub const STANDSTILL_LINEAR: f64 = 1e-4;

/// The set-point counts as reached within this share of it.
const REACHED_SHARE: f64 = 0.05;
/// And within this, rad/s, at least: 2 rpm, the resolution of many drives.
const REACHED_MIN: f64 = 2.0 * PI / 30.0;
/// A motor that has passed this share of its set-point turns, however slow that is.
const TURNING_SHARE: f64 = 0.5;
/// Largest reported speed of a motor that is held, as a multiple of standstill.
const NOISE_SHARE: f64 = 20.0;
/// A position has to change by more, rad or m: a motor that is held twitches.
const MOVED_ROTARY: f64 = PI / 180.0;
const MOVED_LINEAR: f64 = 1e-4;
/// Or by more than the way at the set-point in this time, s, which is less where that is slow.
const MOVED_TIME: f64 = 0.1;

/// Verdict on a motion at a speed.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum SpeedVerdict {
    /// The drive reports neither speed nor position.
    Unknown,
    /// The motor was never seen to turn.
    NeverTurned,
    /// The axis turned, at most at this speed, and did not reach its set-point.
    Slower(f64),
    /// The axis reached its set-point, or turned where no set-point is known.
    Reached,
}

/// The judge of one motion at a speed. All values are SI: rad/s and rad, or m/s and m.
#[derive(Clone, Copy, Debug)]
pub struct SpeedJudge {
    /// Commanded speed, if it is known.
    setpoint: Option<f64>,
    linear: bool,
    fastest: Option<f64>,
    first: Option<f64>,
    way: Option<f64>,
    /// True if it was reported near its set-point once, and turned as well.
    was_near: bool,
}

impl SpeedJudge {
    /// A judge of a motion that was just started.
    #[must_use]
    pub const fn new(setpoint: Option<f64>, linear: bool) -> Self {
        Self { setpoint, linear, fastest: None, first: None, way: None, was_near: false }
    }

    /// Takes a speed and a position, as far as the drive reports them.
    pub fn observe(&mut self, speed: Option<f64>, position: Option<f64>) {
        if let Some(speed) = speed.filter(|speed| speed.is_finite()) {
            let speed = speed.abs();
            self.fastest = Some(self.fastest.map_or(speed, |fastest| fastest.max(speed)));
            let setpoint = self.setpoint.map(f64::abs);
            self.was_near |= setpoint.is_some_and(|setpoint| {
                let least = if self.linear { 0.0 } else { REACHED_MIN };
                (speed - setpoint).abs() <= (setpoint * REACHED_SHARE).max(least)
            });
        }
        if let Some(position) = position.filter(|position| position.is_finite()) {
            let first = *self.first.get_or_insert(position);
            let way = (position - first).abs();
            self.way = Some(self.way.map_or(way, |farthest| farthest.max(way)));
        }
    }

    /// Returns whether the motor was seen to turn.
    #[must_use]
    pub fn has_turned(&self) -> bool {
        let (slow, moved) = if self.linear {
            (STANDSTILL_LINEAR, MOVED_LINEAR)
        } else {
            (STANDSTILL_ROTARY, MOVED_ROTARY)
        };
        let slow = self.setpoint.map_or(slow, |setpoint| slow.min(setpoint.abs() * TURNING_SHARE));
        let moved = self.setpoint.map_or(moved, |setpoint| moved.min(setpoint.abs() * MOVED_TIME));
        let fast = self.fastest.map(|fastest| fastest > slow);
        let far = self.way.map(|way| way > moved);
        // A position that was read once, or is as old as the start, shows no travel; a high speed is no noise.
        let much = self.setpoint.map_or(f64::INFINITY, |setpoint| setpoint.abs() * TURNING_SHARE);
        if self.fastest.is_some_and(|fastest| fastest >= much.max(NOISE_SHARE * slow)) {
            return true;
        }
        // If both are measured, both have to show it.
        fast.or(far) == Some(true) && far.or(fast) == Some(true)
    }

    /// Returns whether a motor was seen at half of its set-point at least: a ramp may end after the motion does.
    #[must_use]
    pub fn has_come_near(&self) -> bool {
        match self.verdict() {
            SpeedVerdict::Reached | SpeedVerdict::Unknown => true,
            SpeedVerdict::NeverTurned => false,
            SpeedVerdict::Slower(fastest) => {
                self.setpoint.is_none_or(|setpoint| fastest >= setpoint.abs() * TURNING_SHARE)
            }
        }
    }

    /// The present verdict.
    #[must_use]
    pub fn verdict(&self) -> SpeedVerdict {
        match (self.fastest, self.way) {
            (None, None) => SpeedVerdict::Unknown,
            _ if !self.has_turned() => SpeedVerdict::NeverTurned,
            (Some(fastest), _) if !self.was_near && self.setpoint.is_some() => {
                SpeedVerdict::Slower(fastest)
            }
            _ => SpeedVerdict::Reached,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RPM: f64 = PI / 30.0;

    fn judged(setpoint: f64, speeds: &[f64]) -> SpeedVerdict {
        let mut judge = SpeedJudge::new(Some(setpoint * RPM), false);
        speeds.iter().for_each(|speed| judge.observe(Some(speed * RPM), None));
        judge.verdict()
    }

    #[test]
    fn a_speed_counts_when_it_was_reached_once() {
        assert_eq!(judged(300.0, &[0.0, 150.0, 290.0, 10.0]), SpeedVerdict::Reached);
        assert_eq!(judged(-300.0, &[0.0, -299.0]), SpeedVerdict::Reached);
        assert_eq!(judged(300.0, &[0.0, 0.4, 0.0]), SpeedVerdict::NeverTurned);
        assert_eq!(judged(300.0, &[0.0, 220.0]), SpeedVerdict::Slower(220.0 * RPM));
        // Slower than what else means standstill.
        assert_eq!(judged(0.2, &[0.0, 0.19]), SpeedVerdict::Reached);
        assert_eq!(judged(1.0, &[0.0, 0.0]), SpeedVerdict::NeverTurned);
    }

    #[test]
    fn the_position_may_show_later_than_the_speed_that_it_turns() {
        let mut judge = SpeedJudge::new(Some(300.0 * RPM), false);
        judge.observe(Some(20.0 * RPM), Some(0.0));
        assert_eq!(judge.verdict(), SpeedVerdict::NeverTurned);
        judge.observe(Some(300.0 * RPM), Some(0.0));
        assert_eq!(judge.verdict(), SpeedVerdict::Reached);
    }

    #[test]
    fn a_ramp_that_is_cut_short_came_near_and_a_motor_that_twitched_did_not() {
        for (fastest, near) in [(6.0, false), (149.0, false), (151.0, true), (300.0, true)] {
            let mut judge = SpeedJudge::new(Some(300.0 * RPM), false);
            judge.observe(Some(fastest * RPM), Some(0.0));
            judge.observe(Some(fastest * RPM), Some(0.5));
            assert_eq!(judge.has_come_near(), near, "{fastest}");
        }
    }

    #[test]
    fn a_position_shows_a_motion_of_a_drive_without_speed() {
        let mut judge = SpeedJudge::new(Some(10.0), false);
        assert_eq!(judge.verdict(), SpeedVerdict::Unknown);
        judge.observe(None, Some(1.0));
        assert_eq!(judge.verdict(), SpeedVerdict::NeverTurned);
        judge.observe(None, Some(1.5));
        assert_eq!(judge.verdict(), SpeedVerdict::Reached);
        // A limit holds it: its speed is noise.
        let mut judge = SpeedJudge::new(Some(300.0 * RPM), false);
        judge.observe(Some(2.8 * RPM), Some(0.0));
        judge.observe(Some(-RPM), Some(0.001));
        assert_eq!(judge.verdict(), SpeedVerdict::NeverTurned);
    }
}
