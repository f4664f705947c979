//! Detects whether a motor turns, and waits for its standstill.

use super::*;

impl LocalAxis {
    /// Whether the last velocity that was read is more than what the drive's stop takes for standing;
    /// `None` where none was read.
    #[must_use]
    pub fn is_turning(&self) -> Option<bool> {
        self.is_turning_in(&self.state())
    }

    pub(in crate::axis) fn is_turning_in(&self, state: &AxisStatus) -> Option<bool> {
        let reading = state.reading(Signal::Velocity);
        reading.at?;
        let id = self.profile.signal(Signal::Velocity)?.parameter;
        let speed = self.parameter(id)?.encoding.number(reading.raw).abs();
        let slow = self.tolerance().and_then(|tolerance| tolerance.standstill);
        Some(speed > slow.unwrap_or(0.0))
    }

    /// Waits until its motor, which another verb brings to rest, is seen to stand.
    pub(crate) fn wait_standstill(&self, stopped: Result<(), Error>) -> Result<Standstill, Error> {
        stopped?;
        let is_group = AxisNumber(self.number).is_group();
        let wait_max = self.connection.scale_timeout(STANDSTILL_WAIT_MAX);
        let end = self.connection.now() + wait_max;
        let mut stopping = StopSequence::observe_executed(self);
        let mut left = wait_max;
        while !left.is_zero() && !stopping.has_ended() {
            stopping.wait(self, left.min(RESEND_AFTER));
            left = end.since(self.connection.now());
            if stopping.trouble().is_some() && !stopping.has_ended() && !left.is_zero() {
                stopping = StopSequence::begin(self);
            }
        }
        let (turns, trouble) = (stopping.is_seen_turning(), stopping.trouble().cloned());
        match (stopping.progress, trouble) {
            (StopProgress::Standstill, _) => Ok(Standstill::Observed),
            (StopProgress::Unobservable, _) => Ok(self.unobserved()),
            (StopProgress::Failed(error), _) | (_, Some(error)) => Err(error),
            // Drives of a group rarely report the same.
            _ if is_group && !turns => Ok(self.unobserved()),
            _ => Err(self.not_at_rest_error(wait_max)),
        }
    }

    /// What is known of a motor whose standstill nothing shows: of one drive that it acknowledged the stop, of
    /// a group nothing.
    pub(in crate::axis) fn unobserved(&self) -> Standstill {
        match AxisNumber(self.number).is_group() {
            true => Standstill::Unconfirmed,
            false => Standstill::Unobservable,
        }
    }

    /// Time limit of the motor's standstill after a stop.
    pub(crate) fn standstill_timeout(&self) -> Duration {
        let steps = self.profile.plan(Verb::Stop).map_or(&[][..], |plan| plan.steps);
        let waits = steps.iter().filter_map(|step| match step {
            Step::Until { within_ms, .. } | Step::Standstill { within_ms } => {
                Some(Duration::from_millis((*within_ms).into()))
            }
            _ => None,
        });
        waits.fold(self.connection.scale_timeout(STANDSTILL_WAIT_MAX), Duration::max)
    }

    /// The motor still turns after this time.
    pub(crate) fn not_at_rest_error(&self, after: Duration) -> Error {
        let what = format!("is not at standstill after {} s", after.as_secs());
        self.still_turning_error(&what, "give its ramp more time, or cut its power")
    }

    /// The speed means standstill, but two positions differ.
    pub(super) fn speed_mismatch_error(
        &self,
        speed: i64,
        (id, from, to): (ParameterId, i64, i64),
        over: Duration,
    ) -> Error {
        let reported =
            |id, raw| match self.raw_to_si(id, raw).and_then(|_| self.value(id, raw).ok()) {
                Some(value) => value.to_string(),
                None => raw.to_string(),
            };
        let velocity = self.profile.signal(Signal::Velocity);
        let speed = velocity.map_or_else(String::new, |source| reported(source.parameter, speed));
        let (from, to, ms) = (reported(id, from), reported(id, to), over.as_millis());
        let what = format!(
            "reports a speed of {speed}, but its position went from {from} to {to} in {ms} ms"
        );
        self.still_turning_error(&what, "cut its power; then check why its speed is not measured")
    }

    pub(super) fn still_turning_error(&self, what: &str, hint: &str) -> Error {
        Error::Failed {
            what: format!("{} received a stop, but {what}", self.label()),
            execution: String::new(),
            outcome: Outcome::Unknown(Failure::NotReached),
            may_turn: true,
            received: Box::default(),
            hint: hint.to_owned(),
        }
    }

    pub(super) fn raw_to_si(&self, id: ParameterId, raw: i64) -> Option<f64> {
        self.connection.with_axes(|axes, _| axes.to_si(self.index, id, raw))
    }

    /// Whether a motor went further in that time than one that holds its place, or turns at that speed.
    pub(super) fn has_drifted(
        &self,
        id: ParameterId,
        (from, to): (i64, i64),
        over: Duration,
        speed: f64,
    ) -> bool {
        let holds = match self.parameter(id).map(|parameter| parameter.unit) {
            Some(Unit::Millimetre) => HOLDING_SPEED_M,
            _ => HOLDING_SPEED_RAD,
        };
        let execution = self
            .raw_to_si(id, from)
            .zip(self.raw_to_si(id, to))
            .map(|(from, to)| (to - from).abs());
        execution.is_none_or(|went| went > holds.max(speed) * over.as_secs_f64())
    }

    /// The nth parameter that the scale of this one depends on, while that is not known.
    pub(super) fn unread_factor(&self, id: ParameterId, nth: usize) -> Option<ParameterId> {
        let factors = self.parameter(id)?.scale.inputs(self.profile);
        factors.filter(|_| self.raw_to_si(id, 0).is_none()).nth(nth)
    }

    /// How positions and speeds of this axis are compared.
    pub(super) fn tolerance(&self) -> Option<Tolerance> {
        self.connection.with_axes(|axes, _| axes.tolerance(self.index))
    }

    /// The greatest speed that means standstill, rad/s or m/s.
    pub(super) fn standstill_speed(&self) -> Option<f64> {
        let speed = self.profile.signal(Signal::Velocity)?.parameter;
        let one = self.raw_to_si(speed, self.parameter(speed)?.encoding.raw(1.0)?)?;
        Some((self.tolerance()?.standstill? * one).abs())
    }
}
