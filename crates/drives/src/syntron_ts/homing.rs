//! Decodes the homing method in Fn_200 (TS manual V2 §2.6.1).
//!
//! The word is `D*10000 + C*1000 + B*100 + A` in decimal digits; A has two digits `[I]`.

/// Action after the zero is found, digits A.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AfterHoming {
    /// Overshoot, then come back onto the zero.
    Align,
    /// Run a path, 1 to 32.
    Path(u8),
    /// Stop at once where it is.
    Stop,
    /// A number that the manual does not name: taken as `Align` `[I]`.
    Unknown(u8),
}

/// Kind of zero, digit C.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum HomingMark {
    /// An edge of the home switch.
    HomeSwitch,
    /// The limit switch that lies in the direction of the search.
    LimitSwitch,
    /// The encoder's Z pulse.
    ZPulse,
    /// The torque limit: a mechanical stop.
    Torque,
}

/// Condition that starts homing, digit D.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum HomingStart {
    /// Never.
    Never,
    /// Homing starts as soon as the motor is powered.
    AtEnable,
    /// Homing starts by the trigger, while the motor is powered.
    ByTrigger,
    /// A digit that the manual does not name: never.
    Unknown(u8),
}

/// A way of homing.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct HomingMethod {
    /// Action at the zero.
    pub after: AfterHoming,
    /// Go on slowly to the next Z pulse; only where the mark is a switch.
    pub z_search: bool,
    /// Kind of zero.
    pub mark: HomingMark,
    /// +1 forward (CCW), -1 reverse (CW).
    pub direction: f64,
    /// Condition that starts it.
    pub start: HomingStart,
}

impl HomingMethod {
    /// From Fn_200. `None` where digit C is not one of the eight ways.
    #[must_use]
    pub fn decode(word: u16) -> Option<Self> {
        let (mark, direction) = decode_mark(word / 1000 % 10)?;
        let switch = matches!(mark, HomingMark::HomeSwitch | HomingMark::LimitSwitch);
        Some(Self {
            after: decode_after((word % 100) as u8),
            z_search: switch && word / 100 % 10 == 1,
            mark,
            direction,
            start: decode_start((word / 10_000) as u8),
        })
    }
}

const fn decode_after(digits: u8) -> AfterHoming {
    match digits {
        0 => AfterHoming::Align,
        1..=32 => AfterHoming::Path(digits),
        33 => AfterHoming::Stop,
        other => AfterHoming::Unknown(other),
    }
}

const fn decode_mark(digit: u16) -> Option<(HomingMark, f64)> {
    Some(match digit {
        0 => (HomingMark::HomeSwitch, -1.0),
        1 => (HomingMark::HomeSwitch, 1.0),
        2 => (HomingMark::LimitSwitch, -1.0),
        3 => (HomingMark::LimitSwitch, 1.0),
        4 => (HomingMark::ZPulse, -1.0),
        5 => (HomingMark::ZPulse, 1.0),
        6 => (HomingMark::Torque, -1.0),
        7 => (HomingMark::Torque, 1.0),
        _ => return None,
    })
}

const fn decode_start(digit: u8) -> HomingStart {
    match digit {
        0 => HomingStart::Never,
        1 => HomingStart::AtEnable,
        2 => HomingStart::ByTrigger,
        other => HomingStart::Unknown(other),
    }
}
