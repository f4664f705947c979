//! Whether a drive's own watchdog works: the motor turns, the host falls silent, and the drive is asked
//! whether it stands.

use super::Check;
use crate::axis::{Axis, WatchdogState};
use crate::error::{Error, Exit};
use polepair_core::profile::{AxisKind, ParameterId, Persistence, Signal, Watchdog};
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

/// Turns the motor at [`proving_speed`], says nothing for as long as the drive's watchdog and the way
/// to rest take, and asks then whether it stands. With `after` the watchdog is set to that first, and put
/// back at the end. The motor is stopped and switched off in any case. It must be free to turn: this
/// moves it.
///
/// # Errors
/// [`Error`] by blame: nothing is proven then.
pub fn prove_watchdog(
    axis: &Axis,
    after: Option<Duration>,
    hear: &mut dyn FnMut(Check),
) -> Result<(), Error> {
    let Some(after) = after else { return prove(axis, axis.watchdog()?, hear) };
    if let Watchdog::None | Watchdog::Fixed { .. } = axis.profile().watchdog {
        return axis.set_watchdog(Some(after)).map(drop);
    }
    let before = axis.watchdog_setting()?;
    let proven = axis.set_watchdog(Some(after)).and_then(|state| prove(axis, state, hear));
    hear(match &proven {
        Ok(()) => put_back(axis, before),
        // It may be what stops a motor that was not seen to stand.
        Err(_) => {
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
    match axis.put_back(&before).and_then(|()| axis.watchdog()) {
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

fn prove(axis: &Axis, state: WatchdogState, hear: &mut dyn FnMut(Check)) -> Result<(), Error> {
    let about = axis.label();
    let after = match state {
        WatchdogState::On(after) if after <= AFTER_MAX => after,
        other => {
            let said = format!("its watchdog is {other}: nothing was proven, and nothing moved");
            hear(Check::wrong(
                &about,
                Exit::Negative,
                said,
                "--prove-watchdog=500ms sets it first",
            ));
            return Ok(());
        }
    };
    let beats = matches!(axis.profile().watchdog, Watchdog::Heartbeat { .. });
    if beats && !axis.connection().with(|axes, _| axes.keeps_alive()) {
        let said = "it watches a heartbeat, and this connection sends none: nothing was proven";
        hear(Check::wrong(&about, Exit::Negative, said, "add heartbeat=100 to the connection"));
        return Ok(());
    }
    if !axis.tells(Signal::Velocity)? {
        let said = "it does not tell its speed: nothing was proven, and nothing moved";
        hear(Check::wrong(
            &about,
            Exit::Negative,
            said,
            "look at the shaft while a program is ended",
        ));
        return Ok(());
    }
    let armed = axis.armed()?;
    axis.velocity(proving_speed(axis.profile().axis))?;
    if !seen_to_turn(axis)? {
        armed.release()?;
        let said = "the motor did not turn: nothing was proven";
        hear(Check::wrong(&about, Exit::Negative, said, "`polepair spin` tells why"));
        return Ok(());
    }
    // A watch begins with the first word, or heartbeat, behind its setting.
    let end = axis.connection().now() + WATCHED_FOR;
    while axis.connection().now() < end {
        axis.signals(&[Signal::Velocity])?;
        axis.sleep(LOOK_EVERY);
    }
    let silence = after + BRAKES_WITHIN + if beats { LEASE } else { Duration::ZERO };
    axis.sleep(silence);
    axis.signals(&[Signal::Velocity])?;
    let stands = axis.turns() == Some(false);
    let released = armed.release();
    let seconds = silence.as_secs_f64();
    hear(match stands {
        true => Check::ok(
            &about,
            format!("its watchdog works: it stood when it was asked after {seconds} s of silence"),
        ),
        false => Check::wrong(
            &about,
            Exit::Negative,
            format!("its watchdog did not stop it: it turned after {seconds} s of silence"),
            "an emergency stop that needs no computer; whether this firmware has a watchdog",
        ),
    });
    // A drive that its watchdog has stopped may have a fault from it, which is no news.
    if stands { Ok(()) } else { released }
}

fn seen_to_turn(axis: &Axis) -> Result<bool, Error> {
    let end = axis.connection().now() + TURNS_WITHIN;
    while axis.connection().now() < end {
        axis.signals(&[Signal::Velocity])?;
        if axis.turns() == Some(true) {
            return Ok(true);
        }
        axis.sleep(LOOK_EVERY);
    }
    Ok(false)
}
