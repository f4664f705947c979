//! Whether a drive's own watchdog works: the motor turns, the host falls silent, and the drive is asked
//! whether it stands.

use super::{Check, watchdog_if_any};
use crate::axis::{Axis, OWED_MAX, WatchdogState, stop_owed};
use crate::error::{Error, Exit, MAY_TURN};
use polepair_core::axis::Verb;
use polepair_core::profile::{AxisKind, ParameterId, Persistence, Signal, Watchdog};
use std::fmt;
use std::time::Duration;

/// How long the motor may take until it is seen to turn.
const TURNS_WITHIN: Duration = Duration::from_secs(3);
/// How long it may take to brake from so slow a speed.
const BRAKES_WITHIN: Duration = Duration::from_secs(2);
/// How long a host's heartbeat goes on after the program's last question.
const LEASE: Duration = Duration::from_secs(1);
/// How long it is spoken to before that ends: longer than a heartbeat's usual period.
const WATCHED_FOR: Duration = Duration::from_millis(500);
/// Between two looks whether it turns.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// The longest watchdog that is waited for.
const AFTER_MAX: Duration = Duration::from_secs(60);

/// The speed at which [`prove_watchdog`] turns an axis: slow, and not too slow for any drive.
#[must_use]
pub const fn proving_speed(kind: AxisKind) -> &'static str {
    match kind {
        AxisKind::Linear => "5 mm/s",
        AxisKind::Rotary | AxisKind::Ratio => "60 rpm",
    }
}

/// Who has a watchdog proven. A closure that takes checks is one that never ends it.
pub trait Witness {
    /// Takes what was found, as soon as it is.
    fn hear(&mut self, check: Check);

    /// Whether it is to end now: the motor is then stopped at once. It is asked all the time.
    fn ends(&self) -> bool {
        false
    }

    /// A stop was not confirmed, and is said again unless this is false. `turns` is false where the motor
    /// was seen to stand, or was never told to turn.
    fn again(&mut self, axis: &Axis, turns: bool) -> bool {
        let _ = (axis, turns);
        true
    }
}

impl<F: FnMut(Check)> Witness for F {
    fn hear(&mut self, check: Check) {
        self(check);
    }
}

/// Why nothing was proven.
#[derive(Clone, PartialEq, Debug)]
pub struct Unproven {
    /// What went wrong; [`Error::Interrupted`] where the witness ended it.
    pub error: Box<Error>,
    /// The motor was told to turn.
    pub moved: bool,
    /// It was not seen to stand since.
    pub may_turn: bool,
}

impl From<Error> for Unproven {
    fn from(error: Error) -> Self {
        Self { may_turn: error.may_turn(), moved: false, error: error.into() }
    }
}

impl fmt::Display for Unproven {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.error.sentence())?;
        if self.may_turn { write!(f, "; {MAY_TURN}") } else { Ok(()) }
    }
}

impl std::error::Error for Unproven {}

/// Turns the motor at [`proving_speed`], says nothing for as long as the drive's watchdog and the way
/// to rest take, and asks then whether it stands. With `after` the watchdog is set to that first, and put
/// back at the end, unless the motor may still turn: it may be what stops it. The motor is stopped and
/// switched off in any case, a stop that is lost is said again for [`OWED_MAX`]. It must be free to turn:
/// this moves it.
///
/// # Errors
/// [`Unproven`]: by blame, and what the motor may do.
pub fn prove_watchdog(
    axis: &Axis,
    after: Option<Duration>,
    witness: &mut dyn Witness,
) -> Result<(), Unproven> {
    let Some(after) = after else { return prove(axis, watchdog_if_any(axis)?, witness) };
    if let Watchdog::None | Watchdog::Fixed { .. } = axis.profile().watchdog {
        return Ok(axis.set_watchdog(Some(after)).map(drop)?);
    }
    // Its firmware may have none, whatever its profile says.
    if watchdog_if_any(axis)? == WatchdogState::None {
        return prove(axis, WatchdogState::None, witness);
    }
    let before = axis.watchdog_setting()?;
    go_on(axis, witness)?;
    let proven = match axis.set_watchdog(Some(after)) {
        Ok(state) => prove(axis, state, witness),
        // It takes no such time: nothing was sent.
        Err(error) if error.exit() == Exit::Usage => return Err(error.into()),
        Err(error) => Err(error.into()),
    };
    let may_turn = proven.as_ref().is_err_and(|unproven| unproven.may_turn);
    witness.hear(match may_turn {
        false => put_back(axis, before),
        // It may be what stops a motor that was not seen to stand.
        true => {
            let said = "its watchdog stays set: the motor was not seen to stand";
            Check::look(&axis.label(), said, "`polepair watchdog URL off`, or a time")
        }
    });
    proven
}

/// Sets the watchdog to what it was, where that is known.
fn put_back(axis: &Axis, before: Option<Vec<(ParameterId, i64)>>) -> Check {
    let about = axis.label();
    let Some(before) = before else {
        let said = "its watchdog stays set: the drive does not tell how it was set before";
        return Check::look(&about, said, "`polepair watchdog URL off`, or a time");
    };
    let kept = |id: &ParameterId| {
        let parameter = axis.profile().parameter(*id);
        parameter.is_some_and(|found| found.persistence == Persistence::Always)
    };
    let memory = match before.iter().any(|(id, _)| kept(id)) {
        true => ", in its permanent memory",
        false => "",
    };
    let put = || axis.put_back(&before).and_then(|()| axis.watchdog());
    let put = match put() {
        // Who ends the proof has it put back, too.
        Err(Error::Interrupted { .. }) => put(),
        done => done,
    };
    match put {
        Ok(state) => {
            let state = axis.watchdog_in_words(state);
            Check::ok(&about, format!("its watchdog is set as before{memory}: {state}"))
        }
        Err(error) => Check::wrong(
            &about,
            error.exit(),
            format!("its watchdog could not be set as before{memory}: {error}"),
            "`polepair watchdog URL` shows how it is set, and sets it",
        ),
    }
}

/// What was seen of a motor whose host fell silent.
enum Seen {
    /// It had not turned before.
    NeverTurning,
    Standing,
    Turning,
}

fn prove(axis: &Axis, state: WatchdogState, witness: &mut dyn Witness) -> Result<(), Unproven> {
    let about = axis.label();
    let after = match state {
        WatchdogState::On(after) if after <= AFTER_MAX => after,
        other => {
            let said = format!("its watchdog is {other}: nothing was proven, and nothing moved");
            let remedy = match other {
                WatchdogState::None => "an emergency stop that needs no computer",
                _ => "--prove-watchdog=500ms sets it first",
            };
            witness.hear(Check::wrong(&about, Exit::Negative, said, remedy));
            return Ok(());
        }
    };
    let beats = matches!(axis.profile().watchdog, Watchdog::Heartbeat { .. });
    if beats && !axis.connection().with(|axes, _| axes.keeps_alive()) {
        let said = "it watches a heartbeat, and this connection sends none: nothing was proven";
        let remedy = "add heartbeat=100 to the connection";
        witness.hear(Check::wrong(&about, Exit::Negative, said, remedy));
        return Ok(());
    }
    if !axis.tells(Signal::Velocity)? {
        let said = "it does not tell its speed: nothing was proven, and nothing moved";
        let remedy = "look at the shaft while a program is ended";
        witness.hear(Check::wrong(&about, Exit::Negative, said, remedy));
        return Ok(());
    }
    let silence = after + BRAKES_WITHIN + if beats { LEASE } else { Duration::ZERO };
    go_on(axis, witness)?;
    axis.take_arming()?;
    let mut motor = Motor { axis, moved: false, over: false };
    let seen = motor.powered().and_then(|()| motor.watched(silence, witness));
    let moved = motor.moved;
    let stands = matches!(seen, Ok(Seen::Standing));
    let released = motor.released(stands, witness);
    let may_turn = moved && !(stands || released.stands);
    let unproven = |error: Error| {
        let may_turn = may_turn || !moved && error.may_turn();
        Err(Unproven { error: error.into(), moved, may_turn })
    };
    let seen = match (seen, &released.ended) {
        (Ok(seen), _) => seen,
        // Whoever ended it is told that the motor was not stopped.
        (Err(Error::Interrupted { .. }), Err(stop)) => return unproven(stop.clone()),
        (Err(error), _) => return unproven(error),
    };
    let seconds = silence.as_secs_f64();
    witness.hear(match seen {
        Seen::NeverTurning => {
            let said = "the motor did not turn: nothing was proven";
            Check::wrong(&about, Exit::Negative, said, "`polepair spin` tells why")
        }
        Seen::Standing => Check::ok(
            &about,
            format!("its watchdog works: it stood when it was asked after {seconds} s of silence"),
        ),
        Seen::Turning => Check::wrong(
            &about,
            Exit::Negative,
            format!("its watchdog did not stop it: it turned after {seconds} s of silence"),
            "an emergency stop that needs no computer; whether this firmware has a watchdog",
        ),
    });
    match released.ended {
        // A drive that its watchdog has stopped may have a fault from it, which is no news.
        Err(error) if stands && !is_of_the_wire(&error) => Ok(()),
        Err(error) => unproven(error),
        Ok(()) => Ok(()),
    }
}

fn is_of_the_wire(error: &Error) -> bool {
    matches!(error.exit(), Exit::NoReply | Exit::Corrupt | Exit::Adapter)
}

/// Goes on unless somebody wants it to end.
fn go_on(axis: &Axis, witness: &dyn Witness) -> Result<(), Error> {
    match witness.ends() {
        false => Ok(()),
        true => Err(Error::Interrupted { what: format!("{}: proving its watchdog", axis.label()) }),
    }
}

/// Waits, unless somebody wants it to end.
fn pass(axis: &Axis, span: Duration, witness: &dyn Witness) -> Result<(), Error> {
    let now = || axis.connection().now();
    let end = now() + span;
    loop {
        go_on(axis, witness)?;
        let left = end.since(now());
        if left.is_zero() {
            return Ok(());
        }
        axis.sleep(left.min(LOOK_EVERY));
    }
}

/// Whether it is seen to turn, by asking.
fn turns(axis: &Axis) -> Result<bool, Error> {
    axis.signals(&[Signal::Velocity])?;
    Ok(axis.turns() == Some(true))
}

/// An armed motor. Whatever ends the proof stops it, a panic too.
struct Motor<'a> {
    axis: &'a Axis,
    /// It was told to turn, whether that was heard or not.
    moved: bool,
    over: bool,
}

/// How a motor was stopped and switched off.
struct Released {
    ended: Result<(), Error>,
    /// It was seen to stand.
    stands: bool,
}

impl Motor<'_> {
    fn powered(&self) -> Result<(), Error> {
        match self.axis.profile().plan(Verb::Enable) {
            Some(_) => self.axis.enable(),
            None => Ok(()),
        }
    }

    /// Has it turn, and looks what it does after so long a silence.
    fn watched(&mut self, silence: Duration, witness: &dyn Witness) -> Result<Seen, Error> {
        let axis = self.axis;
        let now = || axis.connection().now();
        go_on(axis, witness)?;
        self.moved = true;
        axis.velocity(proving_speed(axis.profile().axis))?;
        let end = now() + TURNS_WITHIN;
        while !turns(axis)? {
            if now() >= end {
                return Ok(Seen::NeverTurning);
            }
            pass(axis, LOOK_EVERY, witness)?;
        }
        // A watch begins with the first word, or heartbeat, behind its setting.
        let end = now() + WATCHED_FOR;
        while now() < end {
            turns(axis)?;
            pass(axis, LOOK_EVERY, witness)?;
        }
        pass(axis, silence, witness)?;
        turns(axis)?;
        Ok(if axis.turns() == Some(false) { Seen::Standing } else { Seen::Turning })
    }

    /// Stops it, switches it off and disarms it.
    fn released(mut self, stands: bool, witness: &mut dyn Witness) -> Released {
        let turns = self.moved && !stands;
        self.end(&mut |axis| witness.again(axis, turns))
    }

    fn end(&mut self, again: &mut dyn FnMut(&Axis) -> bool) -> Released {
        self.over = true;
        let axis = self.axis;
        let one = std::slice::from_ref(axis);
        let stopped = stop_owed(one, OWED_MAX, |axis, _| again(axis));
        let stopped: Result<(), Error> = stopped.into_iter().collect();
        // Also after a stop that failed: a motor without power at least does not drive.
        let has_switch = axis.profile().plan(Verb::Disable).is_some();
        let off = if has_switch { axis.disable() } else { Ok(()) };
        axis.arm(false);
        let is_off = has_switch && off.is_ok();
        let coasted = || axis.signals(&[Signal::Velocity]).is_ok() && axis.turns() == Some(false);
        let stands = stopped.is_ok() || is_off && coasted();
        Released { ended: stopped.and(off), stands }
    }
}

impl Drop for Motor<'_> {
    fn drop(&mut self) {
        if !self.over {
            self.end(&mut |_| true);
        }
    }
}
