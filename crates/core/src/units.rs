//! Units: the meaning of a wire number, and its value in SI.

use core::f64::consts::PI;

/// Physical quantity.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum Quantity {
    /// A number, a code, a bit field: nothing to convert.
    Plain,
    /// Position of the axis: rad, m or 1, as the axis is rotary, linear or a ratio.
    Position,
    /// First derivative of the position.
    Velocity,
    /// Second derivative of the position.
    Acceleration,
    /// Torque, N·m.
    Torque,
    /// Electric current, A.
    Current,
    /// Voltage, V.
    Voltage,
    /// Temperature, °C (the one quantity that is not in SI: users state motor temperatures in °C).
    Temperature,
    /// Time, s.
    Time,
    /// A share of a whole, 1 = all of it.
    Ratio,
    /// Bits per second.
    BitRate,
}

/// The unit in which a profile states a parameter.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum Unit {
    /// No unit.
    None,
    /// Degrees of the motor shaft.
    Degree,
    /// Turns of the motor shaft.
    Turn,
    /// Radians.
    Radian,
    /// Millimetres.
    Millimetre,
    /// Turns per minute.
    Rpm,
    /// Turns per minute gained each second.
    RpmPerSecond,
    /// Millimetres per second.
    MillimetrePerSecond,
    /// Millimetres per second gained each second.
    MillimetrePerSecondSquared,
    /// Newton metres.
    NewtonMetre,
    /// Amperes.
    Ampere,
    /// Volts.
    Volt,
    /// Degrees Celsius.
    Celsius,
    /// Milliseconds.
    Millisecond,
    /// Seconds.
    Second,
    /// Hundredths.
    Percent,
    /// Bits per second.
    Baud,
}

impl Unit {
    /// Every unit, for tables and parsers.
    pub const ALL: [Self; 17] = [
        Self::None,
        Self::Degree,
        Self::Turn,
        Self::Radian,
        Self::Millimetre,
        Self::Rpm,
        Self::RpmPerSecond,
        Self::MillimetrePerSecond,
        Self::MillimetrePerSecondSquared,
        Self::NewtonMetre,
        Self::Ampere,
        Self::Volt,
        Self::Celsius,
        Self::Millisecond,
        Self::Second,
        Self::Percent,
        Self::Baud,
    ];

    /// Symbol of the unit; empty for none.
    #[must_use]
    pub const fn symbol(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Degree => "deg",
            Self::Turn => "turn",
            Self::Radian => "rad",
            Self::Millimetre => "mm",
            Self::Rpm => "rpm",
            Self::RpmPerSecond => "rpm/s",
            Self::MillimetrePerSecond => "mm/s",
            Self::MillimetrePerSecondSquared => "mm/s2",
            Self::NewtonMetre => "Nm",
            Self::Ampere => "A",
            Self::Volt => "V",
            Self::Celsius => "degC",
            Self::Millisecond => "ms",
            Self::Second => "s",
            Self::Percent => "%",
            Self::Baud => "baud",
        }
    }

    /// Quantity of the unit.
    #[must_use]
    pub const fn quantity(self) -> Quantity {
        match self {
            Self::None => Quantity::Plain,
            Self::Degree | Self::Turn | Self::Radian | Self::Millimetre => Quantity::Position,
            Self::Rpm | Self::MillimetrePerSecond => Quantity::Velocity,
            Self::RpmPerSecond | Self::MillimetrePerSecondSquared => Quantity::Acceleration,
            Self::NewtonMetre => Quantity::Torque,
            Self::Ampere => Quantity::Current,
            Self::Volt => Quantity::Voltage,
            Self::Celsius => Quantity::Temperature,
            Self::Millisecond | Self::Second => Quantity::Time,
            Self::Percent => Quantity::Ratio,
            Self::Baud => Quantity::BitRate,
        }
    }

    /// True for units of linear motion: m, m/s, m/s².
    #[must_use]
    pub const fn is_linear(self) -> bool {
        matches!(
            self,
            Self::Millimetre | Self::MillimetrePerSecond | Self::MillimetrePerSecondSquared
        )
    }

    /// SI value of one of it.
    #[must_use]
    pub const fn si_factor(self) -> f64 {
        match self {
            Self::Degree => PI / 180.0,
            Self::Turn => 2.0 * PI,
            Self::Millimetre
            | Self::MillimetrePerSecond
            | Self::MillimetrePerSecondSquared
            | Self::Millisecond => 1e-3,
            Self::Rpm | Self::RpmPerSecond => 2.0 * PI / 60.0,
            Self::Percent => 1e-2,
            _ => 1.0,
        }
    }

    /// Symbol of the SI unit of the same quantity; empty for none. Temperatures stay in degrees Celsius.
    #[must_use]
    pub const fn si_symbol(self) -> &'static str {
        match self {
            Self::None | Self::Percent => "",
            Self::Degree | Self::Turn | Self::Radian => "rad",
            Self::Rpm => "rad/s",
            Self::RpmPerSecond => "rad/s²",
            Self::Millimetre => "m",
            Self::MillimetrePerSecond => "m/s",
            Self::MillimetrePerSecondSquared => "m/s²",
            Self::NewtonMetre => "N·m",
            Self::Ampere => "A",
            Self::Volt => "V",
            Self::Celsius => "°C",
            Self::Millisecond | Self::Second => "s",
            Self::Baud => "bit/s",
        }
    }
}

/// The nearest whole number to `value`, halves away from zero. Values beyond the range become its end,
/// NaN becomes 0.
///
/// ```
/// use polepair_core::units::nearest;
/// assert_eq!([2.5, -2.5, 0.499_999_999_999_999_94].map(nearest), [3, -3, 0]);
/// assert_eq!([f64::INFINITY, f64::NAN].map(nearest), [i64::MAX, 0]);
/// ```
#[inline]
#[must_use]
pub const fn nearest(value: f64) -> i64 {
    // A little less than a half, which as a sum with the number below 0.5 would round up to 1.
    const HALF: f64 = 0.5 - f64::EPSILON / 4.0;
    (value + HALF.copysign(value)) as i64
}
