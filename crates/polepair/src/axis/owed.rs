//! Stops that are said until they are confirmed.

use super::{Axis, Running};
use crate::error::Error;
use polepair_core::axis::{Command, Verb};
use polepair_core::error::Failure;
use polepair_core::time::Instant;
use std::time::Duration;

/// How long a stop that nobody confirmed is said again by those who end a motion and then go.
pub const OWED_MAX: Duration = Duration::from_secs(10);
/// Pause before it is said again.
const AGAIN: Duration = Duration::from_millis(250);

/// Stops axes that somebody here has set in motion, and tells how each stop ended: all are sent
/// before the first is waited for. One that was lost with its wire, or in silence, is said again for
/// `within` at most, and `again` is told of it each time; `false` from it ends that. An axis whose
/// profile has no stop is passed over.
///
/// ```
/// use polepair::axis::{OWED_MAX, stop_owed};
/// let link = polepair::connect("sim:tmcl?axes=2&time=virtual")?;
/// let ended = stop_owed(link.axes(), OWED_MAX, |_, _| true);
/// assert!(ended.iter().all(Result::is_ok));
/// # Ok::<(), polepair::Error>(())
/// ```
pub fn stop_owed(
    axes: &[Axis],
    within: Duration,
    mut again: impl FnMut(&Axis, &Error) -> bool,
) -> Vec<Result<(), Error>> {
    let Some(first) = axes.first() else { return Vec::new() };
    let until = first.connection.now() + within;
    let mut ended: Vec<Option<Result<(), Error>>> = axes.iter().map(|_| None).collect();
    loop {
        let owed = |ended: &Option<Result<(), Error>>| ended.as_ref().is_none_or(is_lost);
        // Every stop is sent before the first is waited for.
        let owing =
            axes.iter().zip(&mut ended).filter(|(axis, ended)| has_stop(axis) && owed(ended));
        let begun: Vec<_> = owing
            .map(|(axis, ended)| (axis, ended, axis.start(Command::new(Verb::Stop))))
            .collect();
        let carried_out: Vec<_> = begun
            .into_iter()
            .map(|(axis, ended, run)| (axis, ended, run.and_then(finish)))
            .collect();
        // All brake meanwhile.
        for (axis, ended, stopped) in carried_out {
            *ended = Some(axis.see_standing(stopped).map(drop));
        }
        let lost = axes.iter().zip(&ended).filter(|(axis, ended)| has_stop(axis) && owed(ended));
        let told = lost.map(|(axis, ended)| match ended {
            Some(Err(error)) => again(axis, error),
            _ => true,
        });
        let told: Vec<bool> = told.collect();
        if told.is_empty() || !told.iter().all(|go_on| *go_on) || first.connection.now() >= until {
            return ended.into_iter().map(|ended| ended.unwrap_or(Ok(()))).collect();
        }
        first.sleep(AGAIN);
    }
}

impl Axis {
    /// Ends what a program of the drive does, as [`abort`](Self::abort), and says it again as
    /// [`stop_owed`] does.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn abort_owed(
        &self,
        within: Duration,
        mut again: impl FnMut(&Self, &Error) -> bool,
    ) -> Result<(), Error> {
        let until = self.connection.now() + within;
        loop {
            let ended = self.abort();
            let owed = is_lost(&ended) && self.connection.now() < until;
            match &ended {
                Err(error) if owed && again(self, error) => self.sleep(AGAIN),
                _ => return ended,
            }
        }
    }
}

fn has_stop(axis: &Axis) -> bool {
    axis.profile.plan(Verb::Stop).is_some()
}

/// Waits for its end: who is told to go stops first what he has set in motion.
fn finish(mut running: Running) -> Result<(), Error> {
    loop {
        match running.until(Instant::FAR) {
            Ok(None) | Err(Error::Interrupted { .. }) => {}
            Ok(Some(_)) => return Ok(()),
            Err(error) => return Err(error),
        }
    }
}

/// Whether a stop that is said again may still arrive. A drive that refused it has heard it.
fn is_lost(ended: &Result<(), Error>) -> bool {
    let Err(Error::Failed { outcome, .. }) = ended else { return false };
    matches!(outcome.failure(), Some(Failure::Silent | Failure::Misbehaved | Failure::LinkDown))
}
