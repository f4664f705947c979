//! Compares what a verb claims with the plant, at the instant of the claim: invariant I15.
//!
//! | claim | must hold |
//! |---|---|
//! | arrived | the shaft is at the target, as far as the target is known in the plant |
//! | stopped | the shaft turns slower than 1 rpm |
//! | disabled | the power stage is off |
//! | homed | the drive was started since the command |
//! | refused, not ready | no motion was started |

use polepair_core::axis::{Command, Verb};
use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::{Profile, RelativeBase, Signal};
use polepair_drives::surroundings::GroundTruth;

use super::OpenAction;

/// A shaft that was stopped turns slower, rad/s: 1 rpm.
const STOPPED_SPEED: f64 = 0.105;
/// Speed limit of standstill for a shaft that its loops hold, rad/s: 5 rpm.
const SETTLING_SPEED: f64 = 0.52;
/// A shaft that arrived may be so far from its target, rad: the window of its drive, and the way of the last
/// reading.
const ARRIVED_DISTANCE: f64 = 0.15;
/// A motor that turns slower than this rests, rad/s.
const REST_SPEED: f64 = 0.05;

/// Witness of the end of a drive's last motion, rad of the shaft.
#[derive(Clone, Copy, Debug, Default)]
pub struct ClaimWitness {
    target: Option<f64>,
    /// The target of the move that is under way.
    pending: Option<f64>,
    /// True if a motion was requested since the last stop, so that the motor may turn by the time the next command is
    /// executed.
    may_turn: bool,
    /// The drive reports whether its motor has power.
    has_switch: bool,
}

impl ClaimWitness {
    /// A verb is asked. `offset` is the reported position minus the true one, while it is known.
    pub fn record_command(
        &mut self,
        profile: &Profile,
        command: &Command,
        truth: &GroundTruth,
        offset: Option<f64>,
    ) {
        self.has_switch = profile.signal(Signal::Enabled).is_some();
        let rests = truth.velocity.abs() < REST_SPEED && !self.may_turn;
        self.pending = match command.verb {
            Verb::MoveTo => command.target.zip(offset).map(|(target, offset)| target - offset),
            // From the actual position, where that is what the drive counts from.
            Verb::MoveBy if profile.motion.relative_from == RelativeBase::Actual && rests => {
                command.target.map(|target| truth.position + target)
            }
            verb if verb.needs_arming() || verb.is_stop() => None,
            _ => return,
        };
        self.may_turn |= command.verb.needs_arming();
        if !command.verb.is_move() {
            self.target = None;
        }
    }

    /// Nothing that was known holds any more.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Checks the claim of a verb that has ended. While it was open, `copies` frames of the host were received twice,
    /// each of which may have been executed again.
    pub fn check(
        &mut self,
        verb: Verb,
        outcome: Outcome,
        open: &OpenAction,
        after: &GroundTruth,
        copies: u64,
    ) -> Result<(), String> {
        let done = matches!(outcome, Outcome::Done(_));
        if verb.is_move() {
            self.target = match outcome {
                Outcome::Done(_) => self.pending.take(),
                Outcome::NotDone(_) => self.target,
                _ => None,
            };
        }
        if done && (verb.is_stop() || verb == Verb::Reached) {
            self.may_turn = false;
        }
        let before = &open.truth_before;
        let wrong = match verb {
            Verb::Stop | Verb::QuickStop if done && turns(after) => {
                format!("stopped, but the shaft turns at {:.2} rad/s", after.velocity)
            }
            // A stepper module has no switch: its driver stays on at rest.
            Verb::Disable if done && after.enabled && self.has_switch => {
                "disabled, but the motor has power".into()
            }
            Verb::Home if done && after.starts == before.starts => {
                "homed, but nothing was started".into()
            }
            Verb::Reached if done => match self.target {
                Some(target) if (after.position - target).abs() > ARRIVED_DISTANCE => format!(
                    "arrived at {target:.3} rad, but the shaft is at {:.3} rad",
                    after.position
                ),
                _ => return Ok(()),
            },
            _ if verb.is_move()
                && refused(outcome)
                && !open.doubtful
                && after.unrepeatable > before.unrepeatable + copies =>
            {
                format!("{} ended as {outcome:?}, but was executed", verb.name())
            }
            _ => return Ok(()),
        };
        Err(format!("{} claims: {wrong}", verb.name()))
    }
}

/// Returns whether a shaft turns. One whose loops hold it settles for some milliseconds.
fn turns(truth: &GroundTruth) -> bool {
    let held = truth.setpoint.is_some_and(|setpoint| setpoint.velocity.abs() <= STOPPED_SPEED);
    truth.velocity.abs() > if held { SETTLING_SPEED } else { STOPPED_SPEED }
}

/// Returns whether an outcome means that nothing was executed.
fn refused(outcome: Outcome) -> bool {
    matches!(
        outcome,
        Outcome::NotDone(Failure::Refused { .. } | Failure::NotReady { .. } | Failure::Silent)
    )
}
