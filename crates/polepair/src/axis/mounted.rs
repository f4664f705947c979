//! An axis with its mounting: scale, direction and limits are applied before a byte is sent.

use super::LocalAxis;
use crate::error::Error;
use crate::identification::Identification;
use crate::mounting::{ARGUMENTS, MotionRole, ResolvedMounting, destination, is_ramp_time};
use crate::toml_file::{FileLocation, Located};
use crate::url::AxisNumber;
use polepair_core::axis::{AxisStatus, Command, Reading, Verb};
use polepair_core::plan::{Argument, Operand, Step};
use polepair_core::profile::{Access, Parameter, ParameterId, Signal, SignalSource};
use polepair_core::stream::{PathKind, Point};
use polepair_core::units::Unit;
use std::collections::BTreeSet;
use std::time::Duration;

/// Points of a path that is checked as a whole before it begins.
const PATH_POINTS_MAX: usize = 1_000_000;
/// Tolerance of a limit, as a share of it: rounding in the conversion of units.
const ROUNDING: f64 = 1e-9;

impl LocalAxis {
    /// The unit that a parameter's value is shown in: the profile's or, for what concerns the
    /// motion of an axis that a file mounts, the machine's.
    #[must_use]
    pub fn unit(&self, id: ParameterId) -> Unit {
        if self.is_unscaled(id) {
            return Unit::None;
        }
        let unit = self.parameter(id).map_or(Unit::None, |parameter| parameter.unit);
        let role = self.own_mounting().and_then(|mounted| Some((mounted, mounted.role(id)?)));
        role.map_or(unit, |(mounted, role)| mounted.unit(role, unit))
    }

    /// Asks for what scales the arguments of a command and not every drive has. What turns out not to
    /// be there has no unit, though the caller gave one.
    pub(super) fn check_scales(&self, command: &Command) -> Result<(), Error> {
        for (id, parameter) in self.optionally_scaled(command) {
            self.read_unread_factors(parameter)?;
            if let Some(what) = self.unit_problem(id) {
                return Err(Error::usage("E217", what, "give the drive's own number, raw"));
            }
        }
        Ok(())
    }

    /// Returns whether [`prepare`](Self::prepare) asks the drive for what scales the command's arguments. Who must not
    /// wait prepares it elsewhere.
    #[must_use]
    pub fn has_unread_scales(&self, command: &Command) -> bool {
        self.optionally_scaled(command).any(|(_, parameter)| !self.knows_factors(parameter))
    }

    /// The parameters that the arguments of a command go to, where what scales them is not in every
    /// drive, and is not known to be missing.
    fn optionally_scaled(
        &self,
        command: &Command,
    ) -> impl Iterator<Item = (ParameterId, &'static Parameter)> {
        let given = ARGUMENTS.into_iter().filter(|which| command.argument(*which).is_some());
        let ids =
            given.filter_map(|which| destination(self.profile, command.verb, which).flatten());
        let scaled = ids.filter_map(|id| Some((id, self.parameter(id)?)));
        scaled.filter(|(id, parameter)| !self.is_unscaled(*id) && !parameter.scale.is_constant())
    }

    /// Reads optional parameters that scale values, so that units are known without further requests.
    ///
    /// # Errors
    /// A lost link. Refusals are reported when the value is needed.
    pub(crate) fn read_optional_scales(&self) -> Result<(), Error> {
        if !matches!(self.identified, Identification::Queried { .. }) {
            return Ok(());
        }
        let scales = self.profile.parameters.iter().map(|parameter| parameter.scale);
        let factors = scales.flat_map(|scale| scale.inputs(self.profile));
        let optional = factors.filter(|factor| self.profile.optional.contains(factor));
        for factor in optional.collect::<BTreeSet<ParameterId>>() {
            match self.read_optional(factor) {
                Err(error @ Error::Link(_)) => return Err(error),
                // One refusal of many is normal here, and a drive that is busy would refuse them all.
                Err(_) => return Ok(()),
                Ok(_) => {}
            }
        }
        Ok(())
    }

    /// SI unit of a signal, as people write it: `rad/s`, or `m/s` of a linear axis. Empty for flags and codes, and
    /// where it is unknown.
    #[must_use]
    pub fn signal_unit(&self, signal: Signal) -> &'static str {
        let source = self.profile.signal(signal).filter(|_| signal.is_measured());
        source.map_or("", |source| self.unit(source.parameter).si_symbol())
    }

    /// Returns whether a rack file limits the position.
    #[must_use]
    pub fn has_position_limits(&self) -> bool {
        self.own_mounting().is_some_and(|mounted| mounted.mounting.position.is_some())
    }

    /// The reason why the motion must be stopped: within `ahead` the axis will leave the position limits of
    /// a rack file. Callers that hold a speed or torque on an axis with [limits](Self::has_position_limits)
    /// call this periodically.
    ///
    /// # Errors
    /// Errors of reading position and velocity: stop the axis then too.
    pub fn predict_limit_violation(&self, ahead: Duration) -> Result<Option<String>, Error> {
        let ends = self.own_mounting().and_then(|mounted| mounted.mounting.position.as_ref());
        let Some(ends) = ends else { return Ok(None) };
        let position = self.read_position()?;
        // Without a speed only the position itself can be held against the limits.
        let velocity = if self.provides_signal(Signal::Velocity)? {
            self.signals(&[Signal::Velocity])?[0].value
        } else {
            0.0
        };
        let (low, high) = ends.value;
        // Straight on: within a poll's time a motor changes its speed by less than the margin of its ramp.
        let then = position + velocity * ahead.as_secs_f64();
        // Outside but on its way back in is permitted, otherwise an axis could never be brought back.
        let out = (then > high && velocity >= 0.0) || (then < low && velocity <= 0.0);
        Ok(out.then(|| {
            format!(
                "{}: at {} it is about to leave its limits, {}",
                self.label(),
                self.position_at_text(position),
                self.format_limits(ends)
            )
        }))
    }

    fn position_at_text(&self, position: f64) -> String {
        self.format_value(MotionRole::Position, position)
    }

    /// Refuses what knows nothing of scales and limits.
    pub(super) fn check_unmounted(&self) -> Result<(), Error> {
        let Some(mounted) = self.mounted.as_deref() else { return Ok(()) };
        let what = "cyclic set-points do not observe its scale and limits";
        Err(self.limit_error(
            what,
            &mounted.mounting.location,
            "use the drive's own connection string",
        ))
    }

    /// Mounting of the axis itself; a group has no scale of its own.
    pub(super) fn own_mounting(&self) -> Option<&ResolvedMounting> {
        let mounted = self.mounted.as_deref()?;
        (!AxisNumber(self.number).is_group()).then_some(mounted)
    }

    /// Factor of a parameter's value on its way to the drive.
    pub(crate) fn factor(&self, id: ParameterId) -> f64 {
        let Some(mounted) = self.own_mounting() else { return 1.0 };
        // Shown as the drive's own number, it is that number: neither gear nor direction may change it.
        if self.is_unscaled(id) {
            return 1.0;
        }
        let unit = self.parameter(id).map_or(Unit::None, |parameter| parameter.unit);
        mounted.role(id).map_or(1.0, |role| mounted.factor(role, unit))
    }

    /// The state with the motion's values as the machine has them.
    pub(super) fn to_machine_scale(&self, mut state: AxisStatus) -> AxisStatus {
        if self.own_mounting().is_none() {
            return state;
        }
        for signal in Signal::ALL {
            state.set_reading(signal, self.reading_in_machine_scale(signal, state.reading(signal)));
        }
        state
    }

    /// Converts a reading of one signal to the machine's scale.
    pub(crate) fn reading_in_machine_scale(&self, signal: Signal, read: Reading) -> Reading {
        match self.profile.signal(signal).filter(|source| is_value(source)) {
            Some(source) => Reading { value: read.value / self.factor(source.parameter), ..read },
            None => read,
        }
    }

    /// The unit of an argument with its mounting.
    pub(super) fn mounted_unit(&self, verb: Verb, which: Argument, unit: Unit) -> Unit {
        let role =
            self.own_mounting().and_then(|mounted| Some((mounted, self.motion_role(verb, which)?)));
        role.map_or(unit, |(mounted, role)| mounted.unit(role, unit))
    }

    fn motion_role(&self, verb: Verb, which: Argument) -> Option<MotionRole> {
        MotionRole::of_argument(verb, which, self.destination(verb, which).flatten())
    }

    /// The command as the drive is to have it, when the limits let it through.
    pub(super) fn apply_mounting(&self, mut command: Command) -> Result<Command, Error> {
        let Some(all) = self.mounted.as_deref() else { return Ok(command) };
        let moves = command.verb.needs_arming() && command.verb != Verb::Enable;
        let Some(mounted) = self.own_mounting() else {
            return if moves { Err(self.group_error(&all.mounting.location)) } else { Ok(command) };
        };
        if moves {
            debug_assert!(command.verb.needs_arming());
            self.check_position_limits(&command)?;
            // Still in the machine's units; the conversion below comes after every check.
            command.velocity = self.limited_speed(&command)?;
            if let (Some(most), Some(torque)) = (&mounted.mounting.torque, command.torque) {
                self.check_magnitude(MotionRole::Torque, torque, most)?;
            }
        }
        for which in ARGUMENTS {
            let (Some(value), Some(role)) =
                (command.argument(which), self.motion_role(command.verb, which))
            else {
                continue;
            };
            let written = self.destination(command.verb, which).flatten();
            let unit = if is_ramp_time(self.profile, command.verb, which) && !command.raw {
                Unit::RpmPerSecond
            } else {
                written.map_or(Unit::None, |parameter| parameter.unit)
            };
            let id = destination(self.profile, command.verb, which).flatten();
            if id.is_some_and(|id| self.is_unscaled(id)) {
                continue;
            }
            let value = Some(value * mounted.factor(role, unit));
            match which {
                Argument::Target => command.target = value,
                Argument::Velocity => command.velocity = value,
                Argument::Acceleration => command.acceleration = value,
                Argument::Deceleration => command.deceleration = value,
                Argument::Torque => command.torque = value,
                Argument::JerkTime | Argument::Period | Argument::Path => {}
            }
        }
        Ok(command)
    }

    /// Refuses what would end, or goes on, outside the position's limits.
    fn check_position_limits(&self, command: &Command) -> Result<(), Error> {
        if command.verb == Verb::RunPath {
            return self.check_unlimited_path();
        }
        let ends = self.own_mounting().and_then(|mounted| mounted.mounting.position.as_ref());
        let Some(ends) = ends else { return Ok(()) };
        let position = self.profile.signal(Signal::Position).map(|source| source.parameter);
        if position.is_some_and(|id| self.is_unscaled(id)) {
            let what = "its positions have no unit, so its limits cannot be checked";
            let hint = "give the drive its encoder's resolution, or take the limits away";
            return Err(self.limit_error(what, &ends.location, hint));
        }
        // NaN lies within no limits, so a missing target is refused and never passes as zero.
        let target = command.target.unwrap_or(f64::NAN);
        match command.verb {
            Verb::MoveTo | Verb::CurveTo | Verb::PrepareTo => self.check_position(target, ends),
            Verb::MoveBy | Verb::CurveBy | Verb::PrepareBy => {
                // Read now: the position of the last reading may be seconds old.
                self.check_position(self.read_position()? + target, ends)
            }
            Verb::MoveOn => {
                let what = "its last target is unknown, so its limits cannot be checked";
                Err(self.limit_error(
                    what,
                    &ends.location,
                    "move relative to the actual position: --rel alone",
                ))
            }
            Verb::Velocity | Verb::Torque => {
                // As above: refused below.
                let way = command.velocity.or(command.torque).unwrap_or(f64::NAN);
                let (low, high) = ends.value;
                let position = self.read_position()?;
                let out = (position >= high && way > 0.0) || (position <= low && way < 0.0);
                if out || way.is_nan() {
                    let at = self.format_value(MotionRole::Position, position);
                    let what = format!("at {at} it would leave {}", self.format_limits(ends));
                    Err(self.limit_error(&what, &ends.location, "turn it the other way"))
                } else {
                    Ok(())
                }
            }
            // Its position means nothing before.
            _ => Ok(()),
        }
    }

    /// Refuses a stored path where the machine has limits: the drive follows its own table.
    fn check_unlimited_path(&self) -> Result<(), Error> {
        let Some(mounting) = self.own_mounting().map(|mounted| &mounted.mounting) else {
            return Ok(());
        };
        let position = mounting.position.as_ref().map(|limit| &limit.location);
        match position.or(mounting.velocity.as_ref().map(|limit| &limit.location)) {
            None => Ok(()),
            Some(location) => {
                let what = "the drive follows its stored paths, so its limits cannot be checked";
                Err(self.limit_error(
                    what,
                    location,
                    "remove the limits of that axis, or use `move`",
                ))
            }
        }
    }

    /// The speed to be sent: what the caller gives, if the limit lets it; where he gives none, the
    /// limit itself if the drive would go faster by itself.
    fn limited_speed(&self, command: &Command) -> Result<Option<f64>, Error> {
        let most = self.own_mounting().and_then(|mounted| mounted.mounting.velocity.as_ref());
        let Some(most) = most else { return Ok(command.velocity) };
        if let Some(speed) = command.velocity {
            self.check_magnitude(MotionRole::Speed, speed, most)?;
            return Ok(Some(speed));
        }
        match command.verb {
            verb if verb.is_move() || matches!(verb, Verb::PrepareTo | Verb::PrepareBy) => {
                // A drive moves at a speed of its own where the caller gives none, and that one may be above the
                // limit.
                self.limited_move_speed(verb, most)
            }
            _ => Ok(None),
        }
    }

    fn limited_move_speed(&self, verb: Verb, most: &Located<f64>) -> Result<Option<f64>, Error> {
        let steps = self.profile.plan(verb).map_or(&[][..], |plan| plan.steps);
        let Some(destination) = destination(self.profile, verb, Argument::Velocity) else {
            let what = "its moves use the drive's own speed, so its limit cannot be checked";
            return Err(self.limit_error(
                what,
                &most.location,
                "remove that limit, or use a drive whose moves have a speed",
            ));
        };
        let written = steps.iter().any(
            |step| matches!(step, Step::Write(id, Operand::OptionalArgument(_)) if Some(*id) == destination),
        );
        let Some(id) = destination.filter(|_| written) else { return Ok(Some(most.value)) };
        let constant = steps.iter().find_map(|step| match *step {
            Step::Write(other, Operand::Constant(raw)) if other == id => Some(raw),
            _ => None,
        });
        let readable = self.parameter(id).is_some_and(|p| p.access != Access::Write);
        let raw = match constant {
            Some(raw) => raw,
            None if readable => self.read(id)?,
            None => return Ok(Some(most.value)),
        };
        let value = self.value(id, raw)?;
        let own = value.value.abs() * value.unit.si_factor();
        // What is not known is not slow.
        Ok(if own <= most.value { None } else { Some(most.value) })
    }

    /// Refuses a raw value for what starts or changes motion, where the limits do not let it.
    pub(super) fn check_write(&self, id: ParameterId, raw: i64) -> Result<(), Error> {
        let Some(mounted) = self.own_mounting() else { return Ok(()) };
        let mounting = &mounted.mounting;
        let Some(parameter) = self.parameter(id) else { return Ok(()) };
        let role = mounted.role(id);
        match (role, &mounting.position) {
            (Some(MotionRole::Position), Some(ends)) if self.is_target(id) => {
                self.check_position(self.si_value(id, raw)?, ends)?;
            }
            (Some(MotionRole::Position | MotionRole::Speed | MotionRole::Acceleration), _)
            | (_, None) => {}
            (_, Some(ends)) if parameter.moves && raw != 0 => {
                let what = format!("what `{}` starts cannot be kept within limits", parameter.name);
                return Err(self.limit_error(&what, &ends.location, "use the verbs of motion"));
            }
            _ => {}
        }
        match (role, &mounting.velocity, &mounting.torque) {
            (Some(MotionRole::Velocity | MotionRole::Speed), Some(most), _) => {
                self.check_magnitude(MotionRole::Speed, self.si_value(id, raw)?, most)
            }
            (Some(MotionRole::Torque), _, Some(most)) if parameter.access != Access::Read => {
                self.check_magnitude(MotionRole::Torque, self.si_value(id, raw)?, most)
            }
            _ => Ok(()),
        }
    }

    fn si_value(&self, id: ParameterId, raw: i64) -> Result<f64, Error> {
        self.value(id, raw).map(|value| value.value * value.unit.si_factor())
    }

    /// Returns whether some verb writes its target there.
    fn is_target(&self, id: ParameterId) -> bool {
        let mut verbs = Verb::ALL.into_iter().filter(|verb| verb.is_move());
        verbs.any(|verb| destination(self.profile, verb, Argument::Target) == Some(Some(id)))
    }

    /// Points as the drive is to have them. With limits, all are looked at before the first is sent,
    /// and the ways between them.
    pub(super) fn apply_mounting_to_path<'a>(
        &self,
        kind: PathKind,
        points: impl Iterator<Item = Point> + 'a,
    ) -> Result<Box<dyn Iterator<Item = Point> + 'a>, Error> {
        let Some(all) = self.mounted.as_deref() else { return Ok(Box::new(points)) };
        let Some(mounted) = self.own_mounting() else {
            return Err(self.group_error(&all.mounting.location));
        };
        let mounting = &mounted.mounting;
        let factor =
            self.profile.signal(Signal::Position).map_or(1.0, |s| self.factor(s.parameter));
        let of_drive = move |point: Point| Point {
            position: point.position * factor,
            velocity: point.velocity * factor,
            time: point.time,
        };
        if mounting.position.is_none() && mounting.velocity.is_none() {
            return Ok(Box::new(points.map(of_drive)));
        }
        // One more than allowed, so that an endless iterator ends here as well.
        let path: Vec<Point> = points.take(PATH_POINTS_MAX + 1).collect();
        if path.len() > PATH_POINTS_MAX {
            let what = format!(
                "a path is checked as a whole; this one has more than {PATH_POINTS_MAX} points"
            );
            return Err(self.limit_error(&what, &mounting.location, "send it in parts"));
        }
        // The first piece begins where the axis is, not where the file assumes it.
        let mut before = Point { position: self.read_position()?, velocity: 0.0, time: 0.0 };
        for point in &path {
            // Between two points a cubic may leave the limits though both ends are within them.
            let piece = PathSegment::new(kind, &before, point);
            if let Some(ends) = &mounting.position {
                piece
                    .extreme_positions()
                    .try_for_each(|position| self.check_position(position, ends))?;
            }
            if let Some(most) = &mounting.velocity {
                piece
                    .extreme_speeds()
                    .try_for_each(|speed| self.check_magnitude(MotionRole::Speed, speed, most))?;
            }
            before = *point;
        }
        Ok(Box::new(path.into_iter().map(of_drive)))
    }

    /// Reads the position.
    fn read_position(&self) -> Result<f64, Error> {
        let position = self.signals(&[Signal::Position])?[0].value;
        if position.is_finite() {
            return Ok(position);
        }
        let location = self.mounted.as_deref().map(|mounted| &mounted.mounting.location);
        let place_text = location.map_or_else(String::new, |location| format!(" ({location})"));
        let what = format!(
            "{}: its position is unknown, so its limits cannot be checked{place_text}",
            self.label()
        );
        Err(Error::usage("E223", what, "read it: `polepair get URL all` shows the reason"))
    }

    fn check_position(&self, position: f64, ends: &Located<(f64, f64)>) -> Result<(), Error> {
        let (low, high) = ends.value;
        debug_assert!(low <= high, "checked when the file was read");
        let slack = ROUNDING * (high - low);
        if (low - slack..=high + slack).contains(&position) {
            return Ok(());
        }
        let at = self.format_value(MotionRole::Position, position);
        self.refuse_limit(
            &format!("{at} is beyond its limits, {}", self.format_limits(ends)),
            &ends.location,
        )
    }

    fn check_magnitude(
        &self,
        role: MotionRole,
        value: f64,
        most: &Located<f64>,
    ) -> Result<(), Error> {
        if value.abs() <= most.value * (1.0 + ROUNDING) {
            return Ok(());
        }
        let (value, limit) = (self.format_value(role, value), self.format_value(role, most.value));
        self.refuse_limit(&format!("{value} is more than its limit, {limit}"), &most.location)
    }

    fn refuse_limit(&self, what: &str, location: &FileLocation) -> Result<(), Error> {
        Err(self.limit_error(
            what,
            location,
            "ask for less, or change the limit if the machine allows more",
        ))
    }

    fn limit_error(&self, what: &str, location: &FileLocation, hint: &str) -> Error {
        Error::usage("E223", format!("{}: {what} ({location})", self.label()), hint)
    }

    fn group_error(&self, location: &FileLocation) -> Error {
        let what = "the drives of a group have scales and limits of their own";
        self.limit_error(what, location, "name each axis; a stop may go to a group")
    }

    fn format_limits(&self, ends: &Located<(f64, f64)>) -> String {
        let (low, high) = ends.value;
        format!(
            "{} to {}",
            self.format_value(MotionRole::Position, low),
            self.format_value(MotionRole::Position, high)
        )
    }

    /// An SI value as this axis shows such values.
    fn format_value(&self, role: MotionRole, si: f64) -> String {
        let linear =
            self.own_mounting().is_some_and(|mounted| mounted.mounting.is_linear(self.profile));
        let unit = match (role, linear) {
            (MotionRole::Position, true) => Unit::Millimetre,
            (MotionRole::Position, false) => Unit::Degree,
            (MotionRole::Torque, _) => {
                self.unit_of(Verb::Torque, Argument::Torque).unwrap_or(Unit::None)
            }
            (_, true) => Unit::MillimetrePerSecond,
            (_, false) => Unit::Rpm,
        };
        let number = (si / unit.si_factor() * 1e4).round() / 1e4;
        format!("{number} {}", unit.symbol()).trim_end().to_owned()
    }
}

/// Returns whether a signal is a value of its parameter and no bits of it.
fn is_value(source: &SignalSource) -> bool {
    !source.is_flag() && source.mask == -1
}

/// The way from one point of a path to the next: a cubic where velocities are given, else straight.
struct PathSegment {
    /// Derivative by the share of the time, highest power first.
    slope: [f64; 3],
    start: f64,
    time: f64,
}

impl PathSegment {
    fn new(kind: PathKind, from: &Point, to: &Point) -> Self {
        let (way, time) = (to.position - from.position, to.time);
        let (v0, v1) = (from.velocity * time, to.velocity * time);
        let slope = match kind {
            PathKind::Pvt => [3.0 * (v0 + v1) - 6.0 * way, 6.0 * way - 4.0 * v0 - 2.0 * v1, v0],
            PathKind::Pt => [0.0, 0.0, way],
        };
        Self { slope, start: from.position, time }
    }

    /// The position after a share of the time.
    fn position_at(&self, share: f64) -> f64 {
        let [a, b, c] = self.slope;
        self.start + ((a / 3.0 * share + b / 2.0) * share + c) * share
    }

    /// Positions of its ends and of its turning points.
    fn extreme_positions(&self) -> impl Iterator<Item = f64> {
        let [a, b, c] = self.slope;
        // NaN without a turning point; the range below lets no NaN through.
        let root = (b * b - 4.0 * a * c).sqrt();
        let turns = if a == 0.0 {
            [-c / b, f64::NAN]
        } else {
            [(-b + root) / (2.0 * a), (-b - root) / (2.0 * a)]
        };
        let between = turns.into_iter().filter(|share| (0.0..1.0).contains(share));
        [0.0, 1.0].into_iter().chain(between).map(|share| self.position_at(share))
    }

    /// Speeds at both ends, and the highest between them.
    fn extreme_speeds(&self) -> impl Iterator<Item = f64> {
        let [a, b, c] = self.slope;
        let fastest = Some(-b / (2.0 * a)).filter(|share| (0.0..1.0).contains(share));
        let all = [0.0, 1.0].into_iter().chain(fastest);
        all.map(move |share| ((a * share + b) * share + c) / self.time)
    }
}
