//! Cyclic set-points for several axes of one wire.
//!
//! Why: CANOPEN-10.

use super::failure::RequestKind;
use super::start_together::{check_one_wire, require_plan, run_all};
use super::streaming::SETTLING_MAX;
use super::{LocalAxis, STOP_RETRY_MAX, StopOptions, StopResult, stop_axes};
use crate::error::Error;
use polepair_core::axis::{Axes, Command, Verb};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::plan::{Argument, Operand, Step};
use polepair_core::profile::Signal;
use polepair_core::station::Ticket;
use polepair_core::stream::cyclic::{
    self, BoundsViolation, CYCLES_MAX, CycleStatistics, LOAD_MAX_PERCENT, SetpointBounds,
    SetpointKind, SetpointTracker,
};
use std::time::Duration;

/// Interval of handing over set-points; a lane holds hundreds of cycles.
const FEED_INTERVAL: Duration = Duration::from_millis(20);
/// From rest to the greatest speed in less than this is no motion, but a mistake in the path, where
/// the drive names no greatest acceleration, s \[I\].
const FULL_SPEED_S: f64 = 0.010;

/// Axes that were made ready to follow set-points on one beat: powered where they stand, and watching
/// this host. Dropping it stops and disables them and restores their settings; errors are then lost,
/// so call [`release`](Self::release) to get them.
///
/// The beat is this computer's: it is as regular as its scheduler permits. [`CycleStatistics`] measures the regularity.
///
/// ```
/// use polepair::CyclicAxes;
/// use polepair_core::stream::cyclic::SetpointKind;
/// use std::time::Duration;
/// let link = polepair::connect_local("sim:cia402:1,2?time=virtual")?;
/// let following = CyclicAxes::begin(link.axes(), SetpointKind::Velocity, Duration::from_millis(4))?;
/// let ramp = |k: i32| f64::from(k.min(200 - k)) * 0.02;
/// let speeds: Vec<f64> = (0..=200).flat_map(|k| [ramp(k), -ramp(k)]).collect();
/// following.check(&speeds)?;
/// let account = following.stream(speeds, |_| {})?;
/// assert_eq!((account.cycles, account.missed_cycles), (201, 0));
/// following.release()?;
/// # Ok::<(), polepair::Error>(())
/// ```
#[derive(Debug)]
#[must_use = "the axes are disabled when this is dropped"]
pub struct CyclicAxes {
    axes: Vec<LocalAxis>,
    setpoint: SetpointKind,
    period: Duration,
    bounds: Vec<SetpointBounds>,
    released: bool,
}

impl CyclicAxes {
    /// Arms and powers the axes, which must be on one wire, for set-points of that kind and period.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217` for a period that a drive cannot count; [`Error::Unsupported`] for
    /// drives without such a mode, and when a cycle would take more than 80 % of the bus. Others by
    /// blame. Prepared axes are then restored.
    pub fn begin(
        axes: &[LocalAxis],
        setpoint: SetpointKind,
        period: Duration,
    ) -> Result<Self, Error> {
        Self::inspect_axes(axes, setpoint, period)?.power_up()
    }

    /// [`begin`](Self::begin) with a whole path, as in [`check`](Self::check): the limits and the actual positions are
    /// checked before any axis is powered.
    ///
    /// # Errors
    /// As [`begin`](Self::begin) and [`check`](Self::check); `E222` if the path does not begin at the
    /// actual position of an axis. No drive was changed then.
    pub fn begin_with_path(
        axes: &[LocalAxis],
        setpoint: SetpointKind,
        period: Duration,
        setpoints: &[f64],
    ) -> Result<Self, Error> {
        let looked_at = Self::inspect_axes(axes, setpoint, period)?;
        looked_at.check(setpoints)?;
        looked_at.check_start_positions(setpoints)?;
        looked_at.power_up()
    }

    /// Checks that need no change of the drives.
    fn inspect_axes(
        axes: &[LocalAxis],
        setpoint: SetpointKind,
        period: Duration,
    ) -> Result<Self, Error> {
        debug_assert!(!axes.is_empty(), "checked by the caller's own list");
        let verb = follow_verb(setpoint);
        check_one_wire(axes.iter())?;
        axes.iter().try_for_each(LocalAxis::check_unmounted)?;
        axes.iter().try_for_each(|axis| require_plan(axis, verb))?;
        axes.iter().try_for_each(|axis| check_period(axis, verb, period))?;
        // From the drives, not from the file: their own limits are what they will enforce.
        let bounds = axes.iter().map(read_bounds).collect::<Result<_, _>>()?;
        // There is nothing to take back yet.
        Ok(Self { axes: axes.to_vec(), setpoint, period, bounds, released: true })
    }

    fn power_up(mut self) -> Result<Self, Error> {
        // Remembered, so that a failure leaves the axes as they were found.
        let enabled = self.axes.iter().map(is_enabled).collect::<Result<Vec<bool>, Error>>()?;
        self.axes.iter().for_each(|axis| axis.arm(true));
        self.released = false;
        let period = Some(self.period.as_secs_f64());
        let command = Command { period, ..Command::new(follow_verb(self.setpoint)) };
        let prepared =
            // The load is known only now: it depends on which objects each drive could map.
            run_all(&self.command_for_each(command)).and_then(|()| self.check_bus_load());
        match prepared {
            Ok(()) => Ok(self),
            Err(error) => {
                self.undo_preparation(&enabled);
                Err(if enabled.contains(&true) { with_mapping_hint(error) } else { error })
            }
        }
    }

    /// Restores the settings. An axis that had power before keeps it: nothing has moved it.
    fn undo_preparation(&mut self, enabled: &[bool]) {
        self.released = true;
        let powered = self.axes.iter().zip(enabled).filter(|(_, enabled)| !**enabled);
        let disable = Command::new(Verb::Disable);
        // The error of the preparation is the one that is returned.
        // Power first: an axis that still follows and loses its mapping would hold its last set-point.
        let _ = run_all(&powered.map(|(axis, _)| (axis, disable)).collect::<Vec<_>>());
        let _ = run_all(&self.command_for_each(Command::new(Verb::Unfollow)));
        self.axes.iter().for_each(|axis| axis.arm(false));
    }

    /// Compares the first position of each axis with its actual position.
    fn check_start_positions(&self, setpoints: &[f64]) -> Result<(), Error> {
        if self.setpoint != SetpointKind::Position {
            return Ok(());
        }
        for ((axis, bounds), begins) in self.axes.iter().zip(&self.bounds).zip(setpoints) {
            axis.check_start_position(*begins, bounds.max_start_offset(self.period.as_secs_f64()))?;
        }
        Ok(())
    }

    fn command_for_each(&self, command: Command) -> Vec<(&LocalAxis, Command)> {
        self.axes.iter().map(|axis| (axis, command)).collect()
    }

    /// Share of the bus that a cycle takes at most; `None` on a link that has no bit rate of its own.
    #[must_use]
    pub fn load(&self) -> Option<f64> {
        let indices: Vec<_> = self.axes.iter().map(|axis| axis.index).collect();
        let ns = self.axes[0].connection.with_axes(|axes, _| axes.cycle_ns(&indices))?;
        let load = Duration::from_nanos(ns).as_secs_f64() / self.period.as_secs_f64();
        // Zero on links without a bit rate of their own, such as a simulated wire.
        (ns > 0).then_some(load)
    }

    fn check_bus_load(&self) -> Result<(), Error> {
        let max = LOAD_MAX_PERCENT as f64 / 100.0;
        let Some(load) = self.load().filter(|load| *load > max) else { return Ok(()) };
        let shortest = (self.period.as_secs_f64() * load / max * 1e3).ceil();
        let count = self.axes.len();
        let what = format!(
            "set-points for {count} axes every {} ms take {:.0} % of the bus; {LOAD_MAX_PERCENT} % \
             can be planned for",
            self.period.as_secs_f64() * 1e3,
            load * 100.0
        );
        let hint = format!("choose a period of {shortest} ms or more, or a higher bit rate");
        Err(Error::Unsupported { what, why: Unsupported::Forbidden("bus load"), hint })
    }

    /// Limits of the set-points of each axis, by the drives' own limits.
    #[must_use]
    pub fn bounds(&self) -> &[SetpointBounds] {
        &self.bounds
    }

    /// Holds a whole path to the limits before any of it is sent: set-points in SI, those of a cycle
    /// side by side in the order of the axes. It may begin anywhere; where the axes stand is looked
    /// at when it is streamed.
    ///
    /// # Errors
    /// [`Error::Usage`] `E216` with cycle, axis and limit.
    pub fn check(&self, setpoints: &[f64]) -> Result<(), Error> {
        let (count, period) = (self.axes.len(), self.period.as_secs_f64());
        let mut trends: Vec<SetpointTracker> = (0..count)
            .map(|n| SetpointTracker::at_rest(self.start_setpoint(n, setpoints)))
            .collect();
        for (k, si) in setpoints.iter().enumerate() {
            let n = k % count;
            trends[n].accept(&self.bounds[n], self.setpoint, *si, period).map_err(
                |excess: BoundsViolation| {
                    let (cycle, axis) = (k / count + 1, self.axes[n].label());
                    let what = format!("{axis}, cycle {cycle} ({si:.6}): {}", excess.hint());
                    Error::usage("E216", what, "nothing was moved")
                },
            )?;
        }
        match trends.iter().position(|trend| !trend.may_end(self.setpoint)) {
            Some(n) => {
                let what = format!("{}: the path does not end at rest", self.axes[n].label());
                Err(Error::usage("E216", what, "end with zero; nothing was moved"))
            }
            None => Ok(()),
        }
    }

    fn start_setpoint(&self, n: usize, setpoints: &[f64]) -> f64 {
        match self.setpoint {
            SetpointKind::Position => setpoints.get(n).copied().unwrap_or(0.0),
            SetpointKind::Velocity | SetpointKind::Torque => 0.0,
        }
    }

    /// Sends the set-points to the drives, those of a cycle in the order of the axes, and waits for the
    /// end. `progress` is called from time to time.
    ///
    /// # Errors
    /// [`Error`] by source. After any error, and after [`Error::Interrupted`], all axes were stopped on one
    /// signal and disarmed.
    pub fn stream(
        &self,
        setpoints: impl IntoIterator<Item = f64>,
        mut progress: impl FnMut(&CycleStatistics),
    ) -> Result<CycleStatistics, Error> {
        const WHAT: &str = "following set-points";
        let first = &self.axes[0];
        let indices: Vec<_> = self.axes.iter().map(|axis| axis.index).collect();
        let following = cyclic::CyclicConfig {
            axes: &indices,
            bounds: &self.bounds,
            setpoint: self.setpoint,
            period: self.period,
            timeout_scale: first.connection.timeout_scale(),
        };
        let submitted =
            first.connection.submit(|axes, now, ticket| axes.start_cyclic(now, ticket, &following));
        let mut running = first.running(WHAT, RequestKind::Command, submitted)?;
        let ticket = running.pending.ticket();
        // Whole cycles only: an axis without its set-point in a cycle would follow an old one.
        let (mut rest, chunk_len) = (setpoints.into_iter().fuse(), CYCLES_MAX * self.axes.len());
        let mut chunk: Vec<f64> = Vec::with_capacity(chunk_len);
        let mut fed = false;
        let ended = loop {
            chunk.extend(rest.by_ref().take(chunk_len - chunk.len()));
            let last = chunk.len() < chunk_len;
            if !fed {
                match first.connection.with_axes(|axes, _| feed_chunk(axes, &ticket, &chunk, last))
                {
                    Some(cycles) => drop(chunk.drain(..cycles * self.axes.len())),
                    // The lane has given the stream up; its own error is the reason.
                    None => break running.finish(),
                }
                fed = last && chunk.len() < self.axes.len();
            }
            if let Some(account) = self.cycle_statistics() {
                progress(&account);
            }
            match running.wait(FEED_INTERVAL) {
                Ok(None) => {}
                Ok(Some(cycles)) => break Ok(cycles),
                Err(error) => break Err(error),
            }
        };
        // The last cycle only gives the time for a measurement; an axis may never have moved.
        let arrived = ended.and_then(|_| match self.setpoint {
            SetpointKind::Position => self.axes.iter().try_for_each(|axis| axis.wait(SETTLING_MAX)),
            SetpointKind::Velocity | SetpointKind::Torque => Ok(()),
        });
        match arrived {
            Ok(()) => Ok(self.cycle_statistics().unwrap_or_default()),
            Err(error) => {
                // Also after an error of one axis alone: the others must not go on without it.
                let _ = run_all(&self.command_for_each(Command::new(Verb::Stop)));
                Err(error)
            }
        }
    }

    /// Statistics of the present, or the last, stream.
    #[must_use]
    pub fn cycle_statistics(&self) -> Option<CycleStatistics> {
        let index = self.axes[0].index;
        self.axes[0].connection.with_axes(|axes, _| axes.cycle_statistics(index).cloned())
    }

    /// Stops, disables and disarms, and restores the settings of the drives.
    ///
    /// # Errors
    /// [`Error`] by blame; everything was tried though something failed.
    pub fn release(mut self) -> Result<(), Error> {
        self.stop_and_disarm()
    }

    fn stop_and_disarm(&mut self) -> Result<(), Error> {
        self.released = true;
        let options = StopOptions { power_off: true, ..StopOptions::default() };
        // The stop is watched to standstill before the mapping goes, because without it the axes hear no set-
        // point.
        let stopped = stop_axes(&self.axes, options, STOP_RETRY_MAX, |_, _| true);
        let stopped = stopped.into_iter().try_for_each(StopResult::into_result);
        // Though a stop failed: the drives keep no mapping of a host that has gone.
        let ended = run_all(&self.command_for_each(Command::new(Verb::Unfollow)));
        self.axes.iter().for_each(|axis| axis.arm(false));
        stopped.and(ended)
    }
}

fn feed_chunk(axes: &mut dyn Axes, ticket: &Ticket, chunk: &[f64], last: bool) -> Option<usize> {
    axes.feed_cycles(*ticket, chunk, last)
}

impl Drop for CyclicAxes {
    fn drop(&mut self) {
        if !self.released {
            let _ = self.stop_and_disarm();
        }
    }
}

/// Returns whether the motor has power, as far as the drive reports it.
pub(super) fn is_enabled(axis: &LocalAxis) -> Result<bool, Error> {
    if axis.provides_signal(Signal::Enabled)? {
        Ok(axis.signals(&[Signal::Enabled])?.iter().any(|reading| reading.raw != 0))
    } else {
        Ok(false)
    }
}

/// Adds a hint to the error of an enabled drive that refuses its preparation.
pub(super) fn with_mapping_hint(error: Error) -> Error {
    match error {
        Error::Failed { what, execution, outcome, received, may_turn, hint }
            if matches!(outcome.failure(), Some(Failure::Refused { .. })) =>
        {
            let first = "disable the axis first: this drive maps its PDOs only while it is \
                         pre-operational, which an enabled drive is not made";
            let hint = if hint.is_empty() { first.to_owned() } else { format!("{first}; {hint}") };
            Error::Failed { what, execution, outcome, received, may_turn, hint }
        }
        other => other,
    }
}

const fn follow_verb(setpoint: SetpointKind) -> Verb {
    match setpoint {
        SetpointKind::Position => Verb::FollowPosition,
        SetpointKind::Velocity => Verb::FollowVelocity,
        SetpointKind::Torque => Verb::FollowTorque,
    }
}

impl LocalAxis {
    /// Refuses a path that begins more than `max` away from the actual position, both in SI.
    ///
    /// # Errors
    /// [`Error::Unsupported`] `E222`; errors of reading the position.
    pub(super) fn check_start_position(&self, begins: f64, max: f64) -> Result<(), Error> {
        let actual = self.signals(&[Signal::Position])?[0].value;
        // Where the scale is not known, the lane compares raw values.
        if !actual.is_finite() || (begins - actual).abs() <= max {
            return Ok(());
        }
        let (actual, begins) = (self.limit_text(actual), self.limit_text(begins));
        Err(Error::Unsupported {
            what: format!("{} is at {actual}, but the path begins at {begins}", self.label()),
            why: Unsupported::Forbidden(
                "the path does not begin at the actual position of the \
             axis",
            ),
            hint: "move to the start of the path first, or begin the path at the actual \
             position"
                .to_owned(),
        })
    }

    fn limit_text(&self, si: f64) -> String {
        self.format_signal(Signal::Position, si)
    }

    /// A signal's SI value in the unit that people read it in.
    fn format_signal(&self, signal: Signal, si: f64) -> String {
        let Some(source) = self.profile.signal(signal) else { return format!("{si}") };
        let unit = self.unit(source.parameter);
        // Adding zero turns -0 into 0.
        let shown = (si / unit.si_factor() * 1e3).round() / 1e3 + 0.0;
        format!("{shown} {}", unit.symbol()).trim_end().to_owned()
    }
}

/// A period that the drive would round is another period.
fn check_period(axis: &LocalAxis, verb: Verb, period: Duration) -> Result<(), Error> {
    let steps = axis.profile.plan(verb).map_or(&[][..], |plan| plan.steps);
    let seconds = period.as_secs_f64();
    for step in steps {
        let Step::Write(id, Operand::Argument(Argument::Period)) = *step else { continue };
        let (back, parameter) = axis.connection.with_axes(|axes, _| {
            let raw = axes.to_raw(axis.index, id, seconds);
            (raw.and_then(|raw| axes.to_si(axis.index, id, raw)), axis.parameter(id))
        });
        let (Some(back), Some(parameter)) = (back, parameter) else { continue };
        debug_assert!(parameter.scale.factor != 0.0, "profiles are checked when they are built");
        let raw = back / parameter.unit.si_factor() / parameter.scale.factor;
        let allowed = (parameter.min.max(1) as f64..=parameter.max as f64).contains(&raw.round());
        if (back - seconds).abs() > 1e-9 || !allowed {
            let what = format!("a period of {} ms is none for {}", seconds * 1e3, axis.label());
            let hint = format!(
                "`{}` counts in {} {}, {} at most",
                parameter.name,
                parameter.scale.factor,
                parameter.unit.symbol(),
                parameter.max
            );
            return Err(Error::usage("E217", what, hint));
        }
    }
    Ok(())
}

/// Limits that the drive reports; zero is none.
fn read_bounds(axis: &LocalAxis) -> Result<SetpointBounds, Error> {
    let velocity = least_limit(
        positive(limit_of("max profile velocity", axis)?),
        positive(limit_of("max motor speed", axis)?),
    );
    let acceleration = positive(limit_of("max acceleration", axis)?);
    let range = limit_of("position limit min", axis)?.zip(limit_of("position limit max", axis)?);
    Ok(SetpointBounds {
        position: range.filter(|(min_value, max_value)| min_value < max_value),
        velocity,
        // Without any limit a wrong column of a file would be followed with full current.
        acceleration: acceleration.or(velocity.map(|velocity| velocity / FULL_SPEED_S)),
        torque: positive(limit_of("max torque", axis)?),
    })
}

fn least_limit(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    }
}

fn positive(value: Option<f64>) -> Option<f64> {
    value.filter(|value| *value > 0.0)
}

fn limit_of(name: &str, axis: &LocalAxis) -> Result<Option<f64>, Error> {
    read_limit(axis, name)
}

/// A limit in SI; `None` where the drive has none such.
fn read_limit(axis: &LocalAxis, name: &str) -> Result<Option<f64>, Error> {
    let Some(id) = axis.profile.find_parameter(name) else { return Ok(None) };
    match axis.read(id).and_then(|raw| axis.value(id, raw)) {
        Ok(value) => Ok(Some(value.value * value.unit.si_factor()).filter(|si| si.is_finite())),
        Err(Error::Failed { outcome: Outcome::NotDone(Failure::Refused { .. }), .. }) => Ok(None),
        Err(error) => Err(error),
    }
}
