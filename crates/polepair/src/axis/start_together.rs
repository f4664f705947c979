//! Moves of several axes that start on one signal.

use super::{LocalAxis, RunningRequest};
use crate::error::Error;
use polepair_core::axis::{Command, Verb};

/// Starts moves of several axes of one wire together: each drive is made ready, then one signal on
/// the bus (SYNC) sets all of them going. Returns as soon as they go. The axes must be armed.
///
/// ```
/// use polepair_core::axis::{Command, Verb};
/// let link = polepair::connect_local("sim:cia402:1,2?time=virtual")?;
/// let armed = [link.axes()[0].armed()?, link.axes()[1].armed()?];
/// let to = |rad| Command { target: Some(rad), ..Command::new(Verb::MoveTo) };
/// let moves = [(link.axes()[0].clone(), to(1.0)), (link.axes()[1].clone(), to(-1.0))];
/// polepair::start_together(&moves)?;
/// for axis in &armed {
///     axis.wait(std::time::Duration::from_secs(10))?;
/// }
/// # Ok::<(), polepair::Error>(())
/// ```
///
/// # Errors
/// [`Error::Unsupported`] for a drive that cannot wait for a signal, or a command that is no move to
/// or by: nothing was sent. Others by blame; nothing moves before the signal, and prepared moves
/// are then taken back by a stop.
pub fn start_together(moves: &[(LocalAxis, Command)]) -> Result<(), Error> {
    let prepared = prepare_commands(moves)?;
    let Some((first, _)) = prepared.first() else { return Ok(()) };
    let started = run_all(&prepared).and_then(|()| first.run(Command::new(Verb::Begin)));
    if let Err(error) = started {
        // What waits for a signal must not go off at the next one.
        for verb in [Verb::Unfollow, Verb::Stop] {
            let each: Vec<_> =
                prepared.iter().map(|(axis, _)| (*axis, Command::new(verb))).collect();
            let _ = run_all(&each);
        }
        return Err(error);
    }
    let started_at: Vec<_> =
        prepared.iter().map(|(axis, _)| (*axis, Command::new(Verb::Begun))).collect();
    run_all(&started_at)
}

/// Checks moves that are to [start together](start_together), before the motors have power. Nothing of
/// them is sent; where a scale depends on parameters of a drive that were not read yet, those are read.
///
/// # Errors
/// [`Error::Unsupported`] as [`start_together`] itself would give.
pub fn check_together(moves: &[(LocalAxis, Command)]) -> Result<(), Error> {
    prepare_commands(moves)?
        .into_iter()
        .try_for_each(|(axis, command)| axis.rehearse(command).map(drop))
}

/// The commands that make each drive ready.
fn prepare_commands(moves: &[(LocalAxis, Command)]) -> Result<Vec<(&LocalAxis, Command)>, Error> {
    check_one_wire(moves.iter().map(|(axis, _)| axis))?;
    let prepared = moves.iter().map(|(axis, command)| {
        let verb = match command.verb {
            Verb::MoveTo => Verb::PrepareTo,
            Verb::MoveBy => Verb::PrepareBy,
            other => {
                let what = format!("`{}` cannot wait for a signal", other.name());
                return Err(Error::usage("E218", what, "only moves to, or by, start together"));
            }
        };
        require_plan(axis, verb).map(|()| (axis, Command { verb, ..*command }))
    });
    prepared.collect()
}

/// Checks that the profile has steps for a verb.
pub(super) fn require_plan(axis: &LocalAxis, verb: Verb) -> Result<(), Error> {
    match axis.profile.plan(verb) {
        Some(_) => Ok(()),
        None => Err(axis.unsupported_error(verb.name(), polepair_core::error::Unsupported::NoPlan)),
    }
}

/// Runs a command on each axis, all at once, to their ends; the first error counts.
pub(super) fn run_all(commands: &[(&LocalAxis, Command)]) -> Result<(), Error> {
    let started: Vec<Result<RunningRequest, Error>> =
        commands.iter().map(|(axis, command)| axis.start(*command)).collect();
    // Each is waited for, whatever became of the others.
    let ended: Vec<Result<(), Error>> = started
        .into_iter()
        .map(|started| started.and_then(|mut running| running.finish().map(drop)))
        .collect();
    ended.into_iter().collect()
}

/// Axes that obey one signal: one at least, on one connection.
pub(super) fn check_one_wire<'a>(axes: impl Iterator<Item = &'a LocalAxis>) -> Result<(), Error> {
    let axes: Vec<&LocalAxis> = axes.collect();
    let Some(first) = axes.first() else {
        return Err(Error::usage("E245", "there is no axis", "name one: URL#1"));
    };
    if axes.iter().all(|axis| axis.connection.is_same(&first.connection)) {
        return Ok(());
    }
    let what = "axes that start on one signal must be on one wire";
    Err(Error::usage("E245", what, "command the axes of each link separately"))
}
