//! Coupling: an axis follows another one of its bus, by a gear's ratio or a cam's table.
//!
//! The drives do it by themselves. The host sets them up, the master first: a follower that began before it has
//! received the master's position would jump to it.

use super::LocalAxis;
use super::start_together::{check_one_wire, require_plan};
use crate::error::{Error, Exit};
use crate::quantity;
use crate::url::AxisNumber;
use polepair_core::axis::{Command, Verb};
use polepair_core::cam_table::{CamTable, POINTS_MAX, STEP_POWER_MAX};
use polepair_core::error::Unsupported;
use polepair_core::profile::{CouplingParameters, ParameterId, Signal};
use polepair_core::program::{MemoryBlock, TransferKind};
use polepair_core::units::{Quantity, Unit};
use polepair_link::clock;
use std::f64::consts::TAU;
use std::ops::RangeInclusive;
use std::time::Duration;

/// Time in which the follower must have received the master's position.
const RECEIVED_WITHIN: Duration = Duration::from_millis(500);
const RECEIVED_POLL: Duration = Duration::from_millis(5);
/// The follower has received the master's position if it differs by no more, turns and counts.
const SAME_TURNS: f64 = 0.5 / 360.0;
const SAME_COUNTS: f64 = 4.0;
/// Time in which a master sends, whatever its slow loop is: some of its periods.
const LISTEN: Duration = Duration::from_millis(50);
/// Distance from the master's position of what is written over an older one, counts.
const ELSEWHERE: i32 = 1 << 30;
/// Numerator and denominator of a ratio at most (16 bits with a sign).
const RATIO_PART_MAX: i64 = 0x7FFF;

/// Ratio of a gear: turns of the follower's motor to turns of the master's.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct GearRatio {
    /// Turns of the follower; a negative number turns the other way.
    pub follower: i32,
    /// Turns of the master, from 1.
    pub master: i32,
}

impl GearRatio {
    fn error(self, why: &str, hint: &str) -> Error {
        let what = format!("a ratio of {}:{}: {why}", self.follower, self.master);
        Error::usage("E217", what, hint)
    }
}

/// A cam: positions of the follower over positions of the master.
#[derive(Clone, PartialEq, Debug)]
pub struct Cam {
    /// Points, ascending by the master's position. In between, straight lines.
    pub points: Vec<CamPoint>,
    /// Addresses of the follower's memory that nothing else uses; `None` for the memory that the drives of this
    /// protocol have at least.
    pub memory: Option<RangeInclusive<u16>>,
    /// Accept a table whose layout no public source states. What is inferred wrongly may move the motor otherwise
    /// than the table has it.
    pub accept_inferred: bool,
}

/// A point of a cam.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct CamPoint {
    /// Position of the master, turns of its motor.
    pub master: f64,
    /// Position of the follower, turns of its motor.
    pub follower: f64,
}

impl CamPoint {
    /// Parses a table of points: a line with the unit of each column, `master [deg],follower [deg]`, and a line of
    /// two numbers for each point. Empty lines and what follows `#` are left out.
    ///
    /// ```
    /// let points = polepair::CamPoint::parse_table("master [turn],follower [deg]\n0,0\n1,90\n")?;
    /// assert_eq!(points[1], polepair::CamPoint { master: 1.0, follower: 0.25 });
    /// # Ok::<(), polepair::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Usage`] `E217` with the line.
    pub fn parse_table(text: &str) -> Result<Vec<Self>, Error> {
        let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default().trim());
        let mut lines = (1..).zip(lines).filter(|(_, line)| !line.is_empty());
        let head = lines.next().and_then(|(_, head)| parse_columns(head, parse_turn_unit));
        let Some([master, follower]) = head else {
            let what = "the first line does not name two columns with their units".to_owned();
            return Err(Error::usage("E217", what, "such as `master [deg],follower [deg]`"));
        };
        let points = lines.map(|(number, line)| {
            let [at, position] = parse_columns(line, parse_number).ok_or_else(|| {
                let what = format!("line {number}: `{line}` is not a point");
                Error::usage("E217", what, "positions of the master and of the follower: `90,45`")
            })?;
            Ok(Self { master: at * master, follower: position * follower })
        });
        points.collect()
    }
}

/// Two cells of a line.
fn parse_columns(line: &str, parse: impl Fn(&str) -> Option<f64>) -> Option<[f64; 2]> {
    let (first, second) = line.split_once([',', ';', '\t'])?;
    Some([parse(first.trim())?, parse(second.trim())?])
}

fn parse_number(cell: &str) -> Option<f64> {
    cell.parse::<f64>().ok().filter(|value| value.is_finite())
}

/// Turns in the unit of a column's head: `master [deg]` or `master deg`.
fn parse_turn_unit(head: &str) -> Option<f64> {
    let unit = head.trim_end_matches(']').rsplit(['[', ' ']).next()?;
    let measure = quantity::parse(&format!("1 {unit}")).ok()?;
    let is_turning = measure.quantity == Some(Quantity::Position) && !measure.linear;
    is_turning.then_some(measure.si / TAU)
}

/// A cam that fits into the follower's memory.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct CamPlan {
    start: u16,
    first_master: i32,
    step_power: u32,
    points: Vec<i32>,
}

impl CamPlan {
    /// Counts of the master from one point to the next.
    #[must_use]
    pub const fn step(&self) -> u32 {
        1 << self.step_power
    }

    /// Number of points.
    #[must_use]
    pub fn points(&self) -> usize {
        self.points.len()
    }

    /// Addresses of the table.
    #[must_use]
    pub fn memory(&self) -> RangeInclusive<u16> {
        self.start..=self.start + (CamTable::len_for(self.points.len()) - 1) as u16
    }

    fn block(&self) -> MemoryBlock {
        let Self { first_master, step_power, ref points, .. } = *self;
        let words = CamTable { first_master, step_power, points }.words().collect();
        MemoryBlock { start: self.start, words }
    }
}

impl LocalAxis {
    /// Has the axis follow another one of its wire by a ratio, until it is stopped or gets another motion. It must be
    /// armed and powered, and the master at rest. It is stopped first.
    ///
    /// ```
    /// let link = polepair::connect_local("sim:tmlcan:1,2?time=virtual")?;
    /// let [master, follower] = link.axes() else { panic!("two axes") };
    /// let (leading, following) = (master.armed()?, follower.armed()?);
    /// following.follow_gear(master, polepair::GearRatio { follower: 1, master: 3 })?;
    /// leading.move_to("3 turn")?;
    /// leading.wait(std::time::Duration::from_secs(60))?;
    /// link.sleep(std::time::Duration::from_millis(300));
    /// let position = follower.get("actual position")?;
    /// assert!((position.value - 1.0).abs() < 0.01, "{position}");
    /// following.uncouple(master)?;
    /// # Ok::<(), polepair::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Usage`] `E245` for axes that cannot be coupled, `E217` for a ratio that the drive cannot have: nothing
    /// was sent. [`Error::Unsupported`]; `E602` if another axis sends to this one already, `E101` if the follower does
    /// not receive the master's position: it was not coupled. Others by source.
    pub fn follow_gear(&self, master: &Self, ratio: GearRatio) -> Result<(), Error> {
        let parameters = self.check_coupling(master, Verb::FollowGear)?;
        let [numerator, denominator] = self.ratio_in_counts(master, ratio)?;
        let raw_ratio = (numerator as f64 / denominator as f64 * 65_536.0).round() as i64;
        self.follow(master, Verb::FollowGear, || {
            self.write(parameters.numerator, numerator, false)?;
            self.write(parameters.denominator, denominator, false)?;
            self.write(parameters.ratio, raw_ratio, false)
        })
    }

    /// Checks a cam against the master's and the follower's counts and the follower's memory. Nothing is written.
    ///
    /// # Errors
    /// As [`follow_gear`](Self::follow_gear); [`Error::Usage`] `E217` for a table that does not fit, `E222` if the
    /// layout is inferred and that is not accepted.
    pub fn plan_cam(&self, master: &Self, cam: &Cam) -> Result<CamPlan, Error> {
        self.check_coupling(master, Verb::FollowCam)?;
        if !cam.accept_inferred {
            let what = format!(
                "{}: no public source has the layout of this drive's cam tables, and Polepair's is inferred",
                self.label()
            );
            let hint = "--inferred uses it (`inferred` in a program): first with a motor that nothing \
                        depends on";
            return Err(Error::usage("E222", what, hint));
        }
        let points = check_points(&cam.points)?;
        let (master_counts, own_counts) = (master.counts_per_turn()?, self.counts_per_turn()?);
        let usual = self.data_logger().ok().map(|(logger, _)| logger.memory.clone());
        let memory = cam.memory.clone().or(usual).ok_or_else(|| {
            Error::usage("E217", format!("{}: no memory is named", self.label()), "name it")
        })?;
        let room = memory.len().saturating_sub(CamTable::len_for(0)) / 2;
        let room = room.min(POINTS_MAX.into());
        let first = (points[0].master * master_counts).round();
        let way = points[points.len() - 1].master * master_counts - first;
        let step_power = (0..=STEP_POWER_MAX)
            .find(|power| way / f64::from(1_u32 << power) + 1.0 <= room as f64)
            .ok_or_else(|| {
                let what = format!(
                    "{}: a cam over {way:.0} counts of the master does not fit into {} words",
                    self.label(),
                    memory.len()
                );
                let hint =
                    "make it shorter, or name more of the drive's memory: --buffer 0x8270-0xBFFF";
                Error::usage("E217", what, hint)
            })?;
        let step = f64::from(1_u32 << step_power);
        let count = (way / step).ceil() as usize + 1;
        let places = (0..count).map(|n| (first + n as f64 * step) / master_counts);
        let counts = places.map(|place| (interpolate(points, place) * own_counts).round() as i32);
        let (points, first_master) = (counts.collect(), first as i32);
        Ok(CamPlan { start: *memory.start(), first_master, step_power, points })
    }

    /// Has the axis follow another one of its wire by the table of a cam, from where both are: the follower moves by
    /// the differences of the table. Otherwise as [`follow_gear`](Self::follow_gear).
    ///
    /// # Errors
    /// As [`follow_gear`](Self::follow_gear); `E602` while a program of the drive runs.
    pub fn follow_cam(&self, master: &Self, plan: &CamPlan) -> Result<(), Error> {
        let parameters = self.check_coupling(master, Verb::FollowCam)?;
        self.follow(master, Verb::FollowCam, || {
            let what = "writing the cam's table";
            self.run_transfer(what, TransferKind::WriteData, &[plan.block()], |_| ())?;
            // The variable is signed.
            self.write(parameters.cam, plan.start.cast_signed().into(), false)
        })
    }

    /// Ends a coupling: stops this axis, which holds its position then, and the master's messages. The master must be
    /// at rest: its drive ends its messages with an update, which would repeat a motion.
    ///
    /// # Errors
    /// [`Error`] by source. The follower is stopped first.
    pub fn uncouple(&self, master: &Self) -> Result<(), Error> {
        self.check_pair(master)?;
        require_plan(master, Verb::WithholdPosition)?;
        self.run(Command::new(Verb::Stop))?;
        master.run(Command::new(Verb::WithholdPosition)).map(drop)
    }

    /// Starts the master's messages, checks that they arrive, sets up the follower, and couples it.
    fn follow(
        &self,
        master: &Self,
        verb: Verb,
        set_up: impl FnOnce() -> Result<(), Error>,
    ) -> Result<(), Error> {
        let parameters = master.coupling_parameters(Verb::SendPosition)?;
        // A follower of an earlier coupling would obey what the checks below write.
        self.run(Command::new(Verb::Stop))?;
        if self.receives_position()? {
            // This master sends from an earlier coupling, or another one does.
            master.run(Command::new(Verb::WithholdPosition))?;
            if self.receives_position()? {
                return Err(self.other_master_error());
            }
        }
        master.write(parameters.follower, self.number.into(), false)?;
        master.run(Command::new(Verb::SendPosition))?;
        let coupled = self
            .await_master_position(master)
            .and_then(|()| set_up())
            .and_then(|()| self.run(Command::new(verb)).map(drop));
        if coupled.is_err() {
            // The error is the answer; a master that goes on to send moves nothing by itself.
            let _ = master.run(Command::new(Verb::WithholdPosition));
        }
        coupled
    }

    /// Waits until this axis has received the position that the master has.
    fn await_master_position(&self, master: &Self) -> Result<(), Error> {
        let received_in = self.coupling_parameters(Verb::FollowGear)?.master_position;
        let position = master.position_parameter()?;
        let tolerance = (SAME_TURNS * master.counts_per_turn()?).max(SAME_COUNTS);
        let end = self.connection.now() + clock::scale_timeout(RECEIVED_WITHIN);
        // A place where the master is not: the position that this axis then has was received, and is not an older one.
        let elsewhere = i64::from((master.read(position)? as i32).wrapping_add(ELSEWHERE));
        self.write(received_in, elsewhere, false)?;
        loop {
            let (sent, received) = (master.read(position)?, self.read(received_in)?);
            debug_assert!(tolerance > 0.0);
            if (sent - received).abs() as f64 <= tolerance {
                return Ok(());
            }
            if self.connection.now() > end {
                let has = if received == elsewhere {
                    "nothing".to_owned()
                } else {
                    format!("{received} counts")
                };
                let (own, other) = (self.label(), master.label());
                return Err(Error::MotionEnded {
                    code: "E101",
                    what: format!(
                        "{own} does not receive the position of {other}: it received {has}, and \
                         {other} is at {sent} counts"
                    ),
                    why: "The axes were not coupled, and no motor was moved.".to_owned(),
                    hint: "both drives must be on one CAN bus, with a terminator at each end; on RS-485 \
                           no drive sends by itself"
                        .to_owned(),
                    exit: Exit::Negative,
                });
            }
            self.sleep(RECEIVED_POLL);
        }
    }

    /// Returns whether some axis sends its position to this one.
    fn receives_position(&self) -> Result<bool, Error> {
        let received_in = self.coupling_parameters(Verb::FollowGear)?.master_position;
        let marker = i64::from((self.read(received_in)? as i32).wrapping_add(ELSEWHERE));
        self.write(received_in, marker, false)?;
        self.sleep(LISTEN);
        Ok(self.read(received_in)? != marker)
    }

    fn other_master_error(&self) -> Error {
        Error::MotionEnded {
            code: "E602",
            what: format!("{}: another axis sends its position to it", self.label()),
            why: "Two masters disturb each other, and the bus. The axes were not coupled."
                .to_owned(),
            hint: "end the other coupling first: `polepair uncouple`".to_owned(),
            exit: Exit::Refused,
        }
    }

    /// Checks that two axes can be coupled, without a word on the wire.
    fn check_coupling(&self, master: &Self, verb: Verb) -> Result<CouplingParameters, Error> {
        self.check_pair(master)?;
        require_plan(self, verb)?;
        require_plan(master, Verb::SendPosition)?;
        self.coupling_parameters(verb)
    }

    fn check_pair(&self, master: &Self) -> Result<(), Error> {
        check_one_wire([self, master].into_iter())?;
        for axis in [self, master] {
            if AxisNumber(axis.number).is_group() {
                let what = format!("{} cannot be coupled as a group", axis.label());
                return Err(Error::usage("E245", what, "name one axis"));
            }
        }
        if self.number == master.number {
            let what = format!("{} cannot follow itself", self.label());
            return Err(Error::usage("E245", what, "name another axis as the master"));
        }
        Ok(())
    }

    fn coupling_parameters(&self, verb: Verb) -> Result<CouplingParameters, Error> {
        let found = self.profile.motion.coupling;
        found.ok_or_else(|| self.unsupported_error(verb.name(), Unsupported::NoPlan))
    }

    fn position_parameter(&self) -> Result<ParameterId, Error> {
        let source = self.profile.signal(Signal::Position);
        source
            .map(|source| source.parameter)
            .ok_or_else(|| self.unsupported_error("coupling", Unsupported::NoSuchParameter))
    }

    /// Counts of the position for a turn of the motor.
    fn counts_per_turn(&self) -> Result<f64, Error> {
        let id = self.position_parameter()?;
        let unit = self.required_parameter(id)?.unit;
        let is_turning = unit != Unit::None && !unit.is_linear();
        // A count in rad, as the drive's own scale has it: the mounting in a machine does not matter here.
        self.value(id, 1)?;
        let count = self.connection.with_axes(|axes, _| axes.to_si(self.index, id, 1));
        let count = count.filter(|count| is_turning && *count > 0.0 && count.is_finite());
        count.map(|count| TAU / count).ok_or_else(|| {
            let what = format!("{}: its counts for a turn are not known", self.label());
            Error::usage("E217", what, "give the drive's set-up archive: ?setup=FILE")
        })
    }

    /// The ratio in counts, reduced.
    fn ratio_in_counts(&self, master: &Self, ratio: GearRatio) -> Result<[i64; 2], Error> {
        let (own, other) = (self.counts_per_turn()?, master.counts_per_turn()?);
        let numerator = i64::from(ratio.follower) * own.round() as i64;
        let denominator = i64::from(ratio.master) * other.round() as i64;
        if numerator == 0 || denominator <= 0 {
            let hint = "turns of the follower to turns of the master, such as 1:3 or -2:1";
            return Err(ratio.error("it is no gear", hint));
        }
        let divisor = greatest_common_divisor(numerator.abs(), denominator);
        let [numerator, denominator] = [numerator / divisor, denominator / divisor];
        if numerator.abs() > RATIO_PART_MAX || denominator > RATIO_PART_MAX {
            let why = format!("{numerator}:{denominator} in counts is too fine for the drive");
            return Err(ratio.error(&why, "choose smaller numbers: each is at most 32767"));
        }
        Ok([numerator, denominator])
    }
}

const fn greatest_common_divisor(a: i64, b: i64) -> i64 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

fn check_points(points: &[CamPoint]) -> Result<&[CamPoint], Error> {
    let is_ascending = points.windows(2).all(|pair| pair[0].master < pair[1].master);
    let is_finite =
        points.iter().all(|point| point.master.is_finite() && point.follower.is_finite());
    if points.len() >= 2 && is_ascending && is_finite {
        return Ok(points);
    }
    let what = format!("{} points are no cam", points.len());
    Err(Error::usage("E217", what, "two points at least, the master's positions ascending"))
}

/// The follower's position for the master's, on straight lines between the points.
fn interpolate(points: &[CamPoint], at: f64) -> f64 {
    let behind = points.partition_point(|point| point.master <= at).clamp(1, points.len() - 1);
    let [from, to] = [points[behind - 1], points[behind]];
    let share = ((at - from.master) / (to.master - from.master)).clamp(0.0, 1.0);
    from.follower + share * (to.follower - from.follower)
}
