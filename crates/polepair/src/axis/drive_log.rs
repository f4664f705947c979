//! Recording in the drive: its data logger samples variables in the control loop, all at one instant, into the
//! drive's memory.

use super::LocalAxis;
use crate::amount::Amount;
use crate::error::{Error, Exit};
use crate::url::AxisNumber;
use polepair_core::data_logger::{DataLogger, LogHead, LoggerLoop};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::profile::{Encoding, ParameterId};
use polepair_core::program::{MemoryBlock, TransferKind};
use polepair_core::proto;
use polepair_core::units::Unit;
use polepair_link::clock;
use std::ops::{ControlFlow, RangeInclusive};
use std::time::Duration;

const WHAT: &str = "recording in the drive";
/// Loops from one point to the next at most (header of TML_LIB: a value between 1 and 7FFFh).
const PERIOD_MAX: u128 = 0x7FFF;
/// Pause between two questions how many points are still to come.
const POLL_PAUSE: Duration = Duration::from_millis(50);
/// Pause between two readings of the condition of a start.
const CONDITION_PAUSE: Duration = Duration::from_millis(1);
/// Time that a recording may take beyond its own, besides as much again.
const LATE_MAX: Duration = Duration::from_secs(2);

/// A recording in the drive's memory.
#[derive(Clone, PartialEq, Debug)]
pub struct DriveLogRequest {
    /// Variables to record, in this order.
    pub variables: Vec<ParameterId>,
    /// Time from one point to the next: a multiple of a control loop's period.
    pub interval: Duration,
    /// Length of the recording.
    pub span: Duration,
    /// Condition of the start; `None` starts at once.
    pub start_when: Option<DriveLogCondition>,
    /// Addresses of the drive's memory that nothing else uses; `None` for the memory that the drives of this
    /// protocol have at least.
    pub memory: Option<RangeInclusive<u16>>,
    /// Accept a buffer whose layout no public source states. What is inferred wrongly may overwrite other memory of
    /// a real drive.
    pub accept_inferred: bool,
}

/// A recording that fits into the drive's memory.
#[derive(Clone, Debug)]
pub struct DriveLogPlan {
    sampling_loop: LoggerLoop,
    period: u16,
    points: u16,
    buffer: u16,
    addresses: Vec<u16>,
    variables: Vec<ParameterId>,
    start_when: Option<DriveLogCondition>,
}

/// State of a recording.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DriveLogProgress {
    /// Points taken, or words read.
    pub done: usize,
    /// Points or words in all.
    pub total: usize,
    /// Work of this moment.
    pub stage: DriveLogStage,
}

/// Stages of a recording.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum DriveLogStage {
    /// The condition of the start is not true yet.
    Waiting,
    /// The drive takes points.
    Recording,
    /// The buffer is read.
    Reading,
}

/// A condition on a variable: `actual position > 1 turn`. This program asks the drive for the value until it is true,
/// so a state that is shorter than a question may be missed.
#[derive(Clone, PartialEq, Debug)]
pub struct DriveLogCondition {
    id: ParameterId,
    comparison: Comparison,
    value: f64,
    /// The text of the condition.
    text: String,
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum Comparison {
    Above,
    AtLeast,
    Below,
    AtMost,
    Equal,
    Different,
}

/// Comparisons as they are written, the longer ones first.
const COMPARISONS: [(&str, Comparison); 7] = [
    (">=", Comparison::AtLeast),
    ("<=", Comparison::AtMost),
    ("!=", Comparison::Different),
    ("==", Comparison::Equal),
    (">", Comparison::Above),
    ("<", Comparison::Below),
    ("=", Comparison::Equal),
];

/// A variable's values in a recording.
#[derive(Clone, PartialEq, Debug)]
pub struct LoggedVariable {
    /// The variable.
    pub id: ParameterId,
    /// Name that the drive's profile gives it.
    pub name: &'static str,
    /// Unit of the values.
    pub unit: Unit,
    /// True if the values are the drive's own numbers, without a unit.
    pub is_raw: bool,
    /// A value for each point.
    pub values: Vec<f64>,
}

/// Facts about the recorder of an axis' drive.
#[derive(Clone, PartialEq, Debug)]
pub struct DriveLogFacts {
    /// Points a second, the most first: of each loop, and of a half, a fifth and a tenth of it.
    pub rates: Vec<f64>,
    /// Words of memory that the drives of the protocol have at least.
    pub words: usize,
    /// True if no public source has the layout of that memory.
    pub is_layout_inferred: bool,
}

impl DriveLogFacts {
    /// Points of `words` words each that fit.
    #[must_use]
    pub fn points(&self, words: usize) -> u32 {
        let head = usize::from(LogHead::len_for(words as u16));
        (self.words.saturating_sub(head) / words.max(1)) as u32
    }
}

/// Variables that a drive has recorded.
#[derive(Clone, PartialEq, Debug)]
pub struct DriveLog {
    /// Time from one point to the next.
    pub interval: Duration,
    /// The variables, each with as many values.
    pub variables: Vec<LoggedVariable>,
}

impl DriveLogRequest {
    /// A recording of `rate` points a second, `seconds` long, at once and in the usual memory.
    ///
    /// # Errors
    /// [`Error::Usage`] `E216` for numbers that are no times.
    pub fn at_rate(variables: Vec<ParameterId>, rate: f64, seconds: f64) -> Result<Self, Error> {
        // To the nanosecond, so that 3 kHz is no multiple of a loop by rounding.
        let interval = positive_time((1e9 / rate).round() / 1e9);
        let (Some(interval), Some(span)) = (interval, positive_time(seconds)) else {
            let what = format!("rate {rate} and seconds {seconds}: no recording");
            return Err(Error::usage("E216", what, "both are more than 0"));
        };
        let (start_when, memory, accept_inferred) = (None, None, false);
        Ok(Self { variables, interval, span, start_when, memory, accept_inferred })
    }
}

fn positive_time(seconds: f64) -> Option<Duration> {
    Duration::try_from_secs_f64(seconds).ok().filter(|time| !time.is_zero())
}

impl LoggedVariable {
    /// The symbol of the SI unit of [`si_values`](Self::si_values); empty for the drive's own numbers.
    #[must_use]
    pub fn si_symbol(&self) -> &'static str {
        if self.is_raw { "" } else { self.unit.si_symbol() }
    }

    /// The values in SI, or the drive's own numbers where they have no unit.
    pub fn si_values(&self) -> impl Iterator<Item = f64> {
        let factor = if self.is_raw { 1.0 } else { self.unit.si_factor() };
        self.values.iter().map(move |value| value * factor)
    }
}

impl DriveLogPlan {
    /// Time from one point to the next.
    #[must_use]
    pub fn interval(&self) -> Duration {
        Duration::from_micros(self.sampling_loop.period_us.into()) * self.period.into()
    }

    /// Number of points.
    #[must_use]
    pub const fn points(&self) -> u16 {
        self.points
    }

    /// Addresses of the buffer, head included.
    #[must_use]
    pub fn buffer(&self) -> RangeInclusive<u16> {
        let words = usize::from(self.points) * self.addresses.len();
        let len = usize::from(LogHead::len_for(self.addresses.len() as u16)) + words;
        self.buffer..=self.buffer + (len - 1) as u16
    }

    /// Name of the control loop that samples.
    #[must_use]
    pub const fn loop_name(&self) -> &'static str {
        self.sampling_loop.name
    }
}

impl DriveLogCondition {
    /// The text of the condition.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    fn holds(&self, value: f64) -> bool {
        match self.comparison {
            Comparison::Above => value > self.value,
            Comparison::AtLeast => value >= self.value,
            Comparison::Below => value < self.value,
            Comparison::AtMost => value <= self.value,
            // Both come from raw values of the same scale.
            Comparison::Equal => value.total_cmp(&self.value).is_eq(),
            Comparison::Different => value.total_cmp(&self.value).is_ne(),
        }
    }
}

impl LocalAxis {
    /// Facts about the recorder of this axis' drive. Nothing is sent.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a drive without a data logger and for a group.
    pub fn drive_log_facts(&self) -> Result<DriveLogFacts, Error> {
        let (logger, _) = self.data_logger()?;
        let loops = logger.loops.iter().map(|it| 1e6 / f64::from(it.period_us));
        let mut rates: Vec<f64> =
            loops.flat_map(|rate| [1.0, 2.0, 5.0, 10.0].map(|part| rate / part)).collect();
        rates.sort_by(|a, b| b.total_cmp(a));
        rates.dedup();
        let words = logger.memory.len();
        Ok(DriveLogFacts { rates, words, is_layout_inferred: logger.is_layout_inferred })
    }

    /// Checks a recording against the drive's loops and memory. Nothing is sent.
    ///
    /// ```
    /// use polepair::DriveLogRequest;
    /// use std::{ops::ControlFlow, time::Duration};
    /// let link = polepair::connect_local("sim:tml?time=virtual")?;
    /// let axis = link.axis(1)?;
    /// let plan = axis.plan_drive_log(&DriveLogRequest {
    ///     variables: vec![axis.find("position error")?, axis.find("actual position")?],
    ///     interval: Duration::from_millis(1),
    ///     span: Duration::from_millis(200),
    ///     start_when: Some(axis.parse_log_condition("position error < 1 turn")?),
    ///     memory: None,
    ///     accept_inferred: true,
    /// })?;
    /// let log = axis.record_in_drive(&plan, |_| ControlFlow::Continue(()))?;
    /// assert_eq!(log.variables[1].values.len(), 200);
    /// # Ok::<(), polepair::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a drive without a data logger and for a group; [`Error::Usage`] `E216` for what
    /// does not fit, `E222` if the layout is inferred and that is not accepted.
    pub fn plan_drive_log(&self, request: &DriveLogRequest) -> Result<DriveLogPlan, Error> {
        let (logger, _) = self.data_logger()?;
        if logger.is_layout_inferred && !request.accept_inferred {
            let what = format!(
                "{}: no public source has the layout of this drive's log buffer, and Polepair's is \
                 inferred",
                self.label()
            );
            let hint = "--inferred uses it (`inferred` in a program): first with a motor that nothing \
                        depends on, and with memory that holds no program or cam";
            return Err(Error::usage("E222", what, hint));
        }
        let mut addresses = Vec::new();
        for id in &request.variables {
            addresses.extend(self.word_addresses(*id)?);
        }
        if addresses.is_empty() {
            return Err(self.log_error("no variable is named", "name at least one"));
        }
        let (sampling_loop, period) = self.sampling_loop(logger, request.interval)?;
        let points = request.span.as_nanos().div_ceil(request.interval.as_nanos().max(1)).max(1);
        let memory = request.memory.clone().unwrap_or_else(|| logger.memory.clone());
        let (start, words) = (*memory.start(), addresses.len());
        if !start.is_multiple_of(logger.alignment) {
            let hint = format!("the buffer starts at a multiple of {}", logger.alignment);
            return Err(self.log_error(&format!("a buffer at 0x{start:04X}"), &hint));
        }
        let head = usize::from(LogHead::len_for(words as u16));
        let room = memory.len().saturating_sub(head) / words;
        let Some(points) = u16::try_from(points).ok().filter(|points| usize::from(*points) <= room)
        else {
            let interval = request.interval.as_secs_f64();
            let longest = 1e3 * interval * room as f64;
            let slowest = room as f64 / request.span.as_secs_f64();
            let hint = format!(
                "this rate fits for {longest:.0} ms, this time at {slowest:.0} Hz; if the drive has \
                 more memory, name it: --buffer 0x8270-0xBFFF"
            );
            let what = format!("{points} points of {words} words: the buffer has room for {room}");
            return Err(self.log_error(&what, &hint));
        };
        let variables = request.variables.clone();
        let start_when = request.start_when.clone();
        let buffer = start;
        Ok(DriveLogPlan { sampling_loop, period, points, buffer, addresses, variables, start_when })
    }

    /// Parses the condition of a start: a variable, a comparison and a value, `actual position > 1 turn`.
    ///
    /// # Errors
    /// [`Error::Usage`] `E217` for another text, `E213` for an unknown variable; others by source.
    pub fn parse_log_condition(&self, text: &str) -> Result<DriveLogCondition, Error> {
        let parts = COMPARISONS.iter().find_map(|(word, comparison)| {
            let (name, value) = text.split_once(word)?;
            Some((name.trim(), *comparison, value.trim()))
        });
        let Some((name, comparison, value)) = parts else {
            let what = format!("`{text}` is no condition");
            return Err(Error::usage("E217", what, "such as `actual position > 1 turn`"));
        };
        let id = self.find(name)?;
        let raw = self.raw_within_limits(id, &Amount::from(value))?;
        let value = self.value(id, raw)?.value;
        Ok(DriveLogCondition { id, comparison, value, text: text.to_owned() })
    }

    /// Records in the drive's memory and reads the points. No motion is started, and the motor may turn. `show` can
    /// end the recording, whose points so far are returned.
    ///
    /// # Errors
    /// [`Error`] by source; `E602` while the drive's logger or program runs, `E101` if the points do not come in time.
    /// After an error the logger was stopped, as far as the drive could be reached.
    pub fn record_in_drive(
        &self,
        plan: &DriveLogPlan,
        mut show: impl FnMut(DriveLogProgress) -> ControlFlow<()>,
    ) -> Result<DriveLog, Error> {
        self.set_up_drive_log(plan.buffer, plan.points, plan.period, &plan.addresses)?;
        if self.await_condition(plan, &mut show)?.is_break() {
            return self.read_points(plan, 0, show);
        }
        let recorded = self
            .start_drive_log(plan.buffer, plan.sampling_loop.bits)
            .and_then(|()| self.await_points(plan, &mut show));
        // Whatever happened, the drive must not go on writing to its memory.
        let stopped = self.stop_drive_log();
        let points = recorded?;
        stopped?;
        self.read_points(plan, points, show)
    }

    /// Writes the head of a log buffer: what [`start_drive_log`](Self::start_drive_log) then records.
    ///
    /// # Errors
    /// [`Error`] by source; `E602` while the logger or a program of the drive runs.
    pub fn set_up_drive_log(
        &self,
        buffer: u16,
        points: u16,
        period: u16,
        addresses: &[u16],
    ) -> Result<(), Error> {
        if self.is_drive_log_running()? {
            let what = format!("{}: the drive's logger is running", self.label());
            let hint = "wait for its end, or stop it: `polepair send URL STOPLOG`";
            return Err(logger_error("E602", Exit::Refused, what, "", hint));
        }
        let words = LogHead { points, period, addresses }.words().collect();
        let head = [MemoryBlock { start: buffer, words }];
        let what = "setting up the drive's logger";
        self.run_transfer(what, TransferKind::WriteData, &head, |_| ()).map(drop)
    }

    /// Starts the drive's logger with the buffer that was set up, in the loop of these bits.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn start_drive_log(&self, buffer: u16, loop_bits: u16) -> Result<(), Error> {
        let (_, pointer) = self.data_logger()?;
        self.write(pointer, buffer.into(), false)?;
        self.write(pointer, i64::from(buffer | loop_bits), false)
    }

    /// Stops the drive's logger. Points that were taken stay in its memory.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn stop_drive_log(&self) -> Result<(), Error> {
        let (logger, pointer) = self.data_logger()?;
        let raw = self.read(pointer)?;
        self.write(pointer, raw & !i64::from(logger.loop_bits), false)
    }

    /// Number of points that are still to come in a log buffer.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn drive_log_points_left(&self, buffer: u16) -> Result<u16, Error> {
        Ok(self.read_words(buffer + LogHead::POINTS_LEFT, 1, |_| ())?[0])
    }

    /// Reads `count` words of a log buffer's points, which have `width` words each.
    ///
    /// # Errors
    /// [`Error`] by source.
    pub fn read_drive_log(&self, buffer: u16, width: u16, count: usize) -> Result<Vec<u16>, Error> {
        self.read_words(buffer.saturating_add(LogHead::len_for(width)), count, |_| ())
    }

    fn is_drive_log_running(&self) -> Result<bool, Error> {
        let (logger, pointer) = self.data_logger()?;
        let raw = self.read(pointer)? as u16;
        if raw & logger.loop_bits == 0 {
            return Ok(false);
        }
        Ok(self.drive_log_points_left(raw & !(logger.alignment - 1))? > 0)
    }

    /// The recorder of this axis' drives, and the parameter that starts it.
    pub(super) fn data_logger(&self) -> Result<(&'static DataLogger, ParameterId), Error> {
        let dissector = proto::find_dissector(self.protocol);
        let logger = dissector.and_then(|dissector| dissector.data_logger());
        let found = logger.and_then(|it| {
            let by_name = self.profile.find_parameter(it.pointer);
            Some((it, by_name.or_else(|| self.find(it.pointer_address).ok())?))
        });
        let found = found.filter(|_| !AxisNumber(self.number).is_group());
        found.ok_or_else(|| self.unsupported_error(WHAT, Unsupported::NoPlan))
    }

    /// Addresses of a variable's words, the low one first.
    fn word_addresses(&self, id: ParameterId) -> Result<impl Iterator<Item = u16> + use<>, Error> {
        let parameter = self.required_parameter(id)?;
        let words = u16::from(parameter.encoding.size()).div_ceil(2);
        if parameter.space != 0 || !(1..=2).contains(&words) {
            let what = format!("`{}` is no variable of 16 or 32 bits", parameter.name);
            return Err(self.log_error(&what, "name a variable of the drive"));
        }
        let first = parameter.index;
        Ok(first..first + words)
    }

    /// The slowest loop that makes the interval, and its number of loops.
    fn sampling_loop(
        &self,
        logger: &DataLogger,
        interval: Duration,
    ) -> Result<(LoggerLoop, u16), Error> {
        let ns = interval.as_nanos();
        let loops = |it: &LoggerLoop| {
            let period = u128::from(it.period_us) * 1000;
            let count = ns / period;
            let is_exact = ns.is_multiple_of(period) && (1..=PERIOD_MAX).contains(&count);
            is_exact.then_some((*it, count as u16))
        };
        logger.loops.iter().find_map(loops).ok_or_else(|| {
            let periods: Vec<String> = logger
                .loops
                .iter()
                .map(|it| format!("{} ms ({} loop)", f64::from(it.period_us) / 1e3, it.name))
                .collect();
            let hint = format!("a point is taken every so many loops of {}", periods.join(" or "));
            self.log_error(&format!("a point every {interval:?}"), &hint)
        })
    }

    fn log_error(&self, what: &str, hint: &str) -> Error {
        Error::usage("E216", format!("{}: {WHAT}: {what}", self.label()), hint)
    }

    /// Waits until the condition of the start is true.
    fn await_condition(
        &self,
        plan: &DriveLogPlan,
        show: &mut impl FnMut(DriveLogProgress) -> ControlFlow<()>,
    ) -> Result<ControlFlow<()>, Error> {
        let Some(condition) = &plan.start_when else { return Ok(ControlFlow::Continue(())) };
        let (total, stage) = (plan.points.into(), DriveLogStage::Waiting);
        loop {
            let raw = self.read(condition.id)?;
            if condition.holds(self.value(condition.id, raw)?.value) {
                return Ok(ControlFlow::Continue(()));
            }
            let go_on = show(DriveLogProgress { done: 0, total, stage });
            if go_on.is_break() {
                return Ok(go_on);
            }
            self.sleep(CONDITION_PAUSE);
        }
    }

    /// Waits for the points of a started recording, and returns their number.
    fn await_points(
        &self,
        plan: &DriveLogPlan,
        show: &mut impl FnMut(DriveLogProgress) -> ControlFlow<()>,
    ) -> Result<u16, Error> {
        let span = plan.interval() * plan.points.into();
        let end = self.connection.now() + clock::scale_timeout(2 * span + LATE_MAX);
        loop {
            let left = self.drive_log_points_left(plan.buffer)?;
            let taken =
                plan.points.checked_sub(left).ok_or_else(|| self.foreign_log_error(left))?;
            let (done, total) = (taken.into(), plan.points.into());
            let go_on = show(DriveLogProgress { done, total, stage: DriveLogStage::Recording });
            if left == 0 || go_on.is_break() {
                return Ok(taken);
            }
            if self.connection.now() > end {
                let what = format!(
                    "{}: the drive has recorded {taken} of {} points in twice their time",
                    self.label(),
                    plan.points
                );
                let why = "The drive's memory shows the number of points still to come. If it stays, \
                           this firmware's buffer has another layout.";
                let hint =
                    "read the buffer: `polepair program save URL buffer.sw --at 0x8270 --words 16`";
                return Err(logger_error("E101", Exit::Negative, what, why, hint));
            }
            self.sleep(POLL_PAUSE.min(span));
        }
    }

    fn foreign_log_error(&self, left: u16) -> Error {
        let what = format!("{}: the log buffer reports {left} points to come", self.label());
        let hint = "another program uses the drive's logger or this memory";
        logger_error("E602", Exit::Refused, what, "", hint)
    }

    fn read_points(
        &self,
        plan: &DriveLogPlan,
        points: u16,
        mut show: impl FnMut(DriveLogProgress) -> ControlFlow<()>,
    ) -> Result<DriveLog, Error> {
        let width = plan.addresses.len();
        let count = usize::from(points) * width;
        let data = plan.buffer + LogHead::len_for(width as u16);
        let mut read = || {
            self.read_words(data, count, |done| {
                // The points are taken: an interrupt ends the program, and here loses nothing.
                let _ =
                    show(DriveLogProgress { done, total: count, stage: DriveLogStage::Reading });
            })
        };
        // A stop goes before everything, and ends a transfer. The points are still there.
        let words =
            read().or_else(|error| if is_cancelled(&error) { read() } else { Err(error) })?;
        let mut variables = Vec::new();
        let mut first = 0;
        for id in &plan.variables {
            let parameter = self.required_parameter(*id)?;
            let size = usize::from(parameter.encoding.size()).div_ceil(2);
            let raws = words
                .chunks_exact(width)
                .map(|point| raw_from_words(parameter.encoding, &point[first..first + size]));
            let values = raws.map(|raw| self.value(*id, raw)).collect::<Result<Vec<_>, Error>>()?;
            variables.push(LoggedVariable {
                id: *id,
                name: parameter.name,
                unit: values.first().map_or(parameter.unit, |value| value.unit),
                is_raw: values.first().is_some_and(|value| value.is_raw),
                values: values.iter().map(|value| value.value).collect(),
            });
            first += size;
        }
        Ok(DriveLog { interval: plan.interval(), variables })
    }

    fn read_words(
        &self,
        start: u16,
        count: usize,
        mut show: impl FnMut(usize),
    ) -> Result<Vec<u16>, Error> {
        if count == 0 {
            return Ok(Vec::new());
        }
        let read = self.upload(start, count, |progress| show(progress.done))?;
        let piece = read.pieces().first().filter(|piece| piece.words.len() == count);
        piece.map(|piece| piece.words.clone()).ok_or_else(|| self.foreign_log_error(0))
    }
}

/// Returns whether a stop or another command of this axis ended a request.
fn is_cancelled(error: &Error) -> bool {
    matches!(error, Error::Failed { outcome: Outcome::NotDone(Failure::Cancelled), .. })
}

fn logger_error(code: &'static str, exit: Exit, what: String, why: &str, hint: &str) -> Error {
    Error::MotionEnded { code, what, why: why.to_owned(), hint: hint.to_owned(), exit }
}

/// The raw value of a variable's words, the low one first.
fn raw_from_words(encoding: Encoding, words: &[u16]) -> i64 {
    match *words {
        [low] if encoding.is_signed() => low.cast_signed().into(),
        [low] => low.into(),
        [low, high] => {
            let bits = u32::from(low) | u32::from(high) << 16;
            if encoding.is_signed() { bits.cast_signed().into() } else { bits.into() }
        }
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::raw_from_words;
    use polepair_core::profile::Encoding;

    #[test]
    fn words_become_the_values_that_their_encodings_mean() {
        assert_eq!(raw_from_words(Encoding::I16, &[0xFFFF]), -1);
        assert_eq!(raw_from_words(Encoding::U16, &[0xFFFF]), 65_535);
        assert_eq!(raw_from_words(Encoding::I32, &[0xFFFE, 0xFFFF]), -2);
        assert_eq!(raw_from_words(Encoding::U32, &[1, 0x8000]), 0x8000_0001);
        assert_eq!(raw_from_words(Encoding::Fixed, &[0x8000, 0xFFFF]), -32_768);
    }
}
