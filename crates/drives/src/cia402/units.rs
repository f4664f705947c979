//! The units of a CiA 402 drive, computed from its own objects (CiA 402-2, factor group; CiA 303-2 for the
//! codes of units).
//!
//! A turn is one of the shaft behind the gear, as the feed constant counts them. From first to last:
//!
//! - position: 60A8h, else 6092h, else 608Fh with 6091h and, on older drives, 6093h;
//! - velocity: 60A9h, else units of position per second, with 6096h or, on older drives, 6094h;
//! - acceleration: 60AAh, else units of position per second squared, with 6097h.
//!
//! A zero counts as absent, and 1/1 as the factory's "not set" where another object gives the unit.
//! Objects that contradict each other give no unit (CANOPEN-15).

use core::f64::consts::TAU;

use polepair_core::profile::{NoScale, ObjectKey, ScaleRule, ScaleRuleValue};

/// Turns from raw positions.
pub static POSITION: ScaleRule = ScaleRule {
    name: "cia402-position",
    objects: &[SI_POSITION, INCREMENTS, REVOLUTIONS, GEAR.0, GEAR.1, FEED.0, FEED.1, P.0, P.1],
    words: WORDS,
    full_steps: None,
    compute: |read, _| Ok(position(&Objects(read))?.into_turns()),
};

/// Turns per minute from raw velocities.
pub static VELOCITY: ScaleRule = ScaleRule {
    name: "cia402-velocity",
    objects: &[
        SI_POSITION,
        SI_VELOCITY,
        INCREMENTS,
        REVOLUTIONS,
        GEAR.0,
        GEAR.1,
        FEED.0,
        FEED.1,
        P.0,
        P.1,
        V.0,
        V.1,
        VELOCITY_1.0,
        VELOCITY_1.1,
        VELOCITY_2.0,
        VELOCITY_2.1,
        POLARITY,
    ],
    words: WORDS,
    full_steps: None,
    compute: |read, signed| velocity(&Objects(read), signed),
};

/// Turns per minute gained each second from raw accelerations.
pub static ACCELERATION: ScaleRule = ScaleRule {
    name: "cia402-acceleration",
    objects: &[
        SI_POSITION,
        SI_VELOCITY,
        SI_ACCELERATION,
        INCREMENTS,
        REVOLUTIONS,
        GEAR.0,
        GEAR.1,
        FEED.0,
        FEED.1,
        P.0,
        P.1,
        V.0,
        V.1,
        VELOCITY_2.0,
        VELOCITY_2.1,
        A.0,
        A.1,
    ],
    words: WORDS,
    full_steps: None,
    compute: |read, _| acceleration(&Objects(read)),
};

type Ratio = (ObjectKey, ObjectKey);

const fn ratio(index: u16) -> Ratio {
    ((index, 1), (index, 2))
}

const POLARITY: ObjectKey = (0x607E, 0);
const INCREMENTS: ObjectKey = (0x608F, 1);
const REVOLUTIONS: ObjectKey = (0x608F, 2);
const GEAR: Ratio = ratio(0x6091);
const FEED: Ratio = ratio(0x6092);
/// Position factor: increments of one unit of position.
const P: Ratio = ratio(0x6093);
/// Velocity encoder factor: increments per second of one unit of velocity.
const V: Ratio = ratio(0x6094);
const VELOCITY_1: Ratio = ratio(0x6095);
/// Velocity factor: units of velocity of one unit of position per second.
const VELOCITY_2: Ratio = ratio(0x6096);
/// Acceleration factor.
const A: Ratio = ratio(0x6097);
const WORDS: &[ObjectKey] = &[SI_POSITION, SI_VELOCITY, SI_ACCELERATION];
const SI_POSITION: ObjectKey = (0x60A8, 0);
const SI_VELOCITY: ObjectKey = (0x60A9, 0);
const SI_ACCELERATION: ObjectKey = (0x60AA, 0);

/// Relative difference up to which two units count as the same: 6283 units a turn are milliradians.
const SAME: f64 = 1e-3;

/// Objects of the drive; zero is absent.
struct Objects<'a>(&'a dyn Fn(ObjectKey) -> Option<i64>);

impl Objects<'_> {
    fn number(&self, key: ObjectKey) -> Option<f64> {
        // Some of these are signed in some drives; no unit is negative.
        (self.0)(key).map(|raw| raw as f64).filter(|value| *value > 0.0)
    }

    /// A numerator and what divides it, which is 1 where the drive has none.
    fn ratio(&self, (over, under): Ratio) -> Option<f64> {
        Some(self.number(over)? / self.number(under).unwrap_or(1.0))
    }

    /// A ratio other than the factory's 1/1.
    fn set_ratio(&self, which: Ratio) -> Option<f64> {
        self.ratio(which).filter(|ratio| *ratio != 1.0)
    }

    /// Increments of a turn of the shaft behind the gear.
    fn increments_per_turn(&self) -> Option<f64> {
        let motor = self.ratio((INCREMENTS, REVOLUTIONS))?;
        Some(motor * self.ratio(GEAR).unwrap_or(1.0))
    }

    fn si_unit(&self, key: ObjectKey) -> Option<SiUnit> {
        (self.0)(key).map(|raw| raw as u32).filter(|word| *word != 0).map(SiUnit)
    }
}

/// The word of 60A8h, 60A9h or 60AAh: power of ten, numerator, denominator, its second half.
#[derive(Clone, Copy)]
struct SiUnit(u32);

/// Physical quantity of a numerator.
#[derive(Clone, Copy)]
enum Length {
    /// Turns.
    Turns(f64),
    /// Increments of the encoder.
    Increments(f64),
    /// Metres.
    Metres(f64),
}

impl SiUnit {
    fn power_of_ten(self) -> f64 {
        libm::pow(10.0, f64::from((self.0 >> 24) as u8 as i8))
    }

    /// Codes of CiA 303-2, and what makers add to them for revolutions, increments, inches and feet.
    fn numerator(self) -> Option<Length> {
        match (self.0 >> 16) as u8 {
            0x01 => self.metre_length(1.0),
            0x10 => self.turn_length(TAU),
            0x40 => self.turn_length(400.0),
            0x41 => self.turn_length(360.0),
            0x42 => self.turn_length(360.0 * 60.0),
            0x43 => self.turn_length(360.0 * 3600.0),
            0xB4 => self.turn_length(1.0),
            0xB5 => Some(Length::Increments(self.power_of_ten())),
            0xC1 => self.metre_length(0.0254),
            0xC2 => self.metre_length(0.3048),
            _ => None,
        }
    }

    fn metre_length(&self, metres: f64) -> Option<Length> {
        Some(Length::Metres(self.power_of_ten() * metres))
    }

    fn turn_length(&self, part: f64) -> Option<Length> {
        Some(Length::Turns(self.power_of_ten() / part))
    }

    /// Seconds of the denominator, where it is a time.
    fn seconds(self) -> Option<f64> {
        if self.0 as u8 == 0 { time((self.0 >> 8) as u8) } else { None }
    }

    /// Seconds squared of the denominator: a square of its own, or two times.
    fn seconds_squared(self) -> Option<f64> {
        match ((self.0 >> 8) as u8, self.0 as u8) {
            (0x57, 0) => Some(1.0),
            (first, second) => Some(time(first)? * time(second)?),
        }
    }
}

const fn time(code: u8) -> Option<f64> {
    match code {
        0x03 => Some(1.0),
        0x47 => Some(60.0),
        0x48 => Some(3600.0),
        _ => None,
    }
}

/// Units of position in a turn, and the objects that define them.
struct PositionScale {
    units_per_turn: f64,
    /// Metres of a turn, where positions are lengths.
    metres_per_turn: Option<f64>,
    from: &'static [ObjectKey],
}

impl PositionScale {
    fn into_turns(self) -> ScaleRuleValue {
        ScaleRuleValue { factor: 1.0 / self.units_per_turn, from: self.from }
    }
}

fn agree(a: f64, b: f64) -> bool {
    (a - b).abs() <= SAME * b.abs()
}

const NO_INCREMENTS: NoScale =
    NoScale("the drive does not say how many units a turn has (60A8h, 6092h, 608Fh)");

fn position(objects: &Objects<'_>) -> Result<PositionScale, NoScale> {
    const FROM_SI: &[ObjectKey] = &[SI_POSITION];
    const FROM_LENGTH: &[ObjectKey] = &[SI_POSITION, FEED.0, FEED.1];
    const FROM_INCREMENTS: &[ObjectKey] = &[SI_POSITION, INCREMENTS, REVOLUTIONS, GEAR.0, GEAR.1];
    const FROM_FEED: &[ObjectKey] = &[FEED.0, FEED.1];
    const FROM_ENCODER: &[ObjectKey] = &[INCREMENTS, REVOLUTIONS, GEAR.0, GEAR.1];
    const FROM_FACTOR: &[ObjectKey] = &[P.0, P.1, INCREMENTS, REVOLUTIONS, GEAR.0, GEAR.1];
    let feed = objects.ratio(FEED);
    if let Some(si) = objects.si_unit(SI_POSITION) {
        if si.0 & 0xFFFF != 0 {
            return Err(NoScale(
                "60A8h gives positions a unit that is none of a length or an angle",
            ));
        }
        let (units, from) = match si.numerator() {
            Some(Length::Turns(turns)) => (1.0 / turns, FROM_SI),
            Some(Length::Increments(count)) => {
                (objects.increments_per_turn().ok_or(NO_INCREMENTS)? / count, FROM_INCREMENTS)
            }
            Some(Length::Metres(metres)) => {
                let why =
                    "60A8h gives positions in metres, and 6092h does not say how far a turn goes";
                let units_per_turn = objects.set_ratio(FEED).ok_or(NoScale(why))?;
                let metres_per_turn = Some(units_per_turn * metres);
                return Ok(PositionScale { units_per_turn, metres_per_turn, from: FROM_LENGTH });
            }
            None => return Err(NoScale("60A8h gives positions a unit that is not known")),
        };
        return match objects.set_ratio(FEED) {
            Some(feed) if !agree(feed, units) => {
                Err(NoScale("60A8h and 6092h contradict each other"))
            }
            _ => rotary_scale(units, from),
        };
    }
    let increments = objects.increments_per_turn();
    let by_factor = objects.ratio(P).zip(increments).map(|(factor, turn)| turn / factor);
    match (feed, by_factor) {
        (Some(feed), Some(units)) if !agree(feed, units) => {
            Err(NoScale("6092h and 6093h with 608Fh and 6091h contradict each other"))
        }
        (Some(feed), _) => rotary_scale(feed, FROM_FEED),
        (None, Some(units)) => rotary_scale(units, FROM_FACTOR),
        (None, None) => rotary_scale(increments.ok_or(NO_INCREMENTS)?, FROM_ENCODER),
    }
}

fn rotary_scale(units_per_turn: f64, from: &'static [(u16, u8)]) -> Result<PositionScale, NoScale> {
    Ok(PositionScale { units_per_turn, metres_per_turn: None, from })
}

/// Turns of one unit that is no length of the position.
fn turns_of(objects: &Objects<'_>, length: Length) -> Result<f64, NoScale> {
    match length {
        Length::Turns(turns) => Ok(turns),
        Length::Increments(count) => {
            Ok(count / objects.increments_per_turn().ok_or(NO_INCREMENTS)?)
        }
        Length::Metres(metres) => {
            let why =
                "the drive counts metres, and 60A8h with 6092h do not say how far a turn goes";
            let of_turn = position(objects)?.metres_per_turn.ok_or(NoScale(why))?;
            Ok(metres / of_turn)
        }
    }
}

fn velocity(objects: &Objects<'_>, signed: bool) -> Result<ScaleRuleValue, NoScale> {
    const FROM_SI: &[ObjectKey] = &[SI_VELOCITY];
    const FROM_ENCODER: &[ObjectKey] = &[V.0, V.1, INCREMENTS, REVOLUTIONS, GEAR.0, GEAR.1];
    const FROM_FACTOR: &[ObjectKey] = &[VELOCITY_2.0, VELOCITY_2.1];
    let factor = objects.set_ratio(VELOCITY_2);
    let (rpm, from) = if let Some(si) = objects.si_unit(SI_VELOCITY) {
        let unknown = NoScale("60A9h gives velocities a unit that is not known");
        let (length, seconds) = si.numerator().zip(si.seconds()).ok_or(unknown)?;
        let rpm = 60.0 * turns_of(objects, length)? / seconds;
        if let Some((factor, scale)) = factor.zip(position(objects).ok())
            && !agree(60.0 / (scale.units_per_turn * factor), rpm)
        {
            return Err(NoScale("60A9h and 6096h contradict each other"));
        }
        (rpm, FROM_SI)
    } else if objects.set_ratio(VELOCITY_1).is_some() {
        return Err(NoScale("6095h gives velocities a unit that is not known"));
    } else {
        match (objects.set_ratio(V), factor) {
            (Some(_), Some(_)) => return Err(NoScale("6094h and 6096h contradict each other")),
            (Some(encoder), None) => {
                let turn = objects.increments_per_turn().ok_or(NO_INCREMENTS)?;
                (60.0 * encoder / turn, FROM_ENCODER)
            }
            (None, Some(factor)) => {
                (60.0 / (position(objects)?.units_per_turn * factor), FROM_FACTOR)
            }
            (None, None) => {
                let scale = position(objects)?;
                (60.0 / scale.units_per_turn, scale.from)
            }
        }
    };
    // One of the two turned round: a positive velocity would take the position down.
    let polarity = (objects.0)(POLARITY).unwrap_or(0);
    let turned = signed && (polarity & 0x80 != 0) != (polarity & 0x40 != 0);
    Ok(ScaleRuleValue { factor: if turned { -rpm } else { rpm }, from })
}

fn acceleration(objects: &Objects<'_>) -> Result<ScaleRuleValue, NoScale> {
    const FROM_SI: &[ObjectKey] = &[SI_ACCELERATION];
    const FROM_FACTOR: &[ObjectKey] = &[A.0, A.1];
    if let Some(si) = objects.si_unit(SI_ACCELERATION) {
        let unknown = NoScale("60AAh gives accelerations a unit that is not known");
        let (length, squared) = si.numerator().zip(si.seconds_squared()).ok_or(unknown)?;
        let factor = 60.0 * turns_of(objects, length)? / squared;
        return Ok(ScaleRuleValue { factor, from: FROM_SI });
    }
    if objects.si_unit(SI_VELOCITY).is_some() {
        return Err(NoScale(
            "60A9h gives velocities a unit, and no object gives accelerations one",
        ));
    }
    let older = objects.set_ratio(P).is_some() || objects.set_ratio(V).is_some();
    let velocity_factor = objects.set_ratio(V).or(objects.set_ratio(VELOCITY_2));
    match objects.set_ratio(A) {
        Some(factor) if older => {
            let turn = objects.increments_per_turn().ok_or(NO_INCREMENTS)?;
            Ok(ScaleRuleValue { factor: 60.0 * factor / turn, from: FROM_FACTOR })
        }
        Some(factor) if velocity_factor.is_some() => {
            let units = position(objects)?.units_per_turn;
            Ok(ScaleRuleValue { factor: 60.0 / (units * factor), from: FROM_FACTOR })
        }
        Some(_) => Err(NoScale("6097h gives accelerations a unit that is not known")),
        None if velocity_factor.is_some() => {
            Err(NoScale("6094h or 6096h scales velocities, and no object scales accelerations"))
        }
        None => {
            let scale = position(objects)?;
            Ok(ScaleRuleValue { factor: 60.0 / scale.units_per_turn, from: scale.from })
        }
    }
}
