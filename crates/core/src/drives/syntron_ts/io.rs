//! Eight inputs, four outputs (TS manual V2 §2.3), and what each is for.
//!
//! The manual does not say which line does what, only that input functions can be chosen (two equal
//! ones are ERR_Id). The functions are data, with a default order of our own `[I]`.

/// Number of inputs.
pub const INPUTS: usize = 8;

/// What an input is for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Purpose {
    /// Nothing.
    Spare,
    /// Powers the motor.
    ServoOn,
    /// Clears the alarm.
    AlarmClear,
    /// Starts the path of Fn_20B while Fn_20A is 0.
    PathTrigger,
    /// Starts homing while Fn_20A is 0.
    HomingTrigger,
    /// Home switch.
    Home,
    /// Negative limit switch, CWL.
    ReverseLimit,
    /// Positive limit switch, CCWL.
    ForwardLimit,
}

impl Purpose {
    const ALL: [Self; 8] = [
        Self::Spare,
        Self::ServoOn,
        Self::AlarmClear,
        Self::PathTrigger,
        Self::HomingTrigger,
        Self::Home,
        Self::ReverseLimit,
        Self::ForwardLimit,
    ];

    /// The purposes of all inputs, a digit each: `12345670` is the default.
    #[must_use]
    pub fn of_digits(text: &str) -> Option<[Self; INPUTS]> {
        let mut purposes = [Self::Spare; INPUTS];
        if text.len() != INPUTS {
            return None;
        }
        for (purpose, digit) in purposes.iter_mut().zip(text.bytes()) {
            *purpose = *Self::ALL.get(usize::from(digit.checked_sub(b'0')?))?;
        }
        Some(purposes)
    }
}

/// The default order `[I]`.
pub const PURPOSES: [Purpose; INPUTS] = [
    Purpose::ServoOn,
    Purpose::AlarmClear,
    Purpose::PathTrigger,
    Purpose::HomingTrigger,
    Purpose::Home,
    Purpose::ReverseLimit,
    Purpose::ForwardLimit,
    Purpose::Spare,
];

/// True when two inputs have the same purpose: ERR_Id.
#[must_use]
pub fn collide(purposes: &[Purpose; INPUTS]) -> bool {
    let used = |p: &&Purpose| **p != Purpose::Spare;
    purposes.iter().filter(used).any(|p| purposes.iter().filter(|q| *q == p).count() > 1)
}

/// The lines as they are, and the switches that the shaft closes.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Lines {
    /// What each input is for.
    pub purposes: [Purpose; INPUTS],
    /// Inputs that something outside closes.
    pub driven: [bool; INPUTS],
    /// Shaft position of the home switch, closed from there on forward, rad.
    pub home_at: Option<f64>,
    /// Shaft position of the positive limit, closed from there on forward, rad.
    pub forward_at: Option<f64>,
    /// Shaft position of the negative limit, closed from there on in reverse, rad.
    pub reverse_at: Option<f64>,
}

impl Lines {
    /// Whether the input of that purpose is closed with the shaft at `position` (rad).
    #[must_use]
    pub fn closed(&self, purpose: Purpose, position: f64) -> bool {
        let wired = self.purposes.iter().position(|p| *p == purpose);
        wired.is_some_and(|at| self.input(at, position))
    }

    /// All inputs, the first in bit 0.
    #[must_use]
    pub fn bits(&self, position: f64) -> u8 {
        (0..INPUTS).fold(0, |bits, at| bits | u8::from(self.input(at, position)) << at)
    }

    fn input(&self, at: usize, position: f64) -> bool {
        let by_shaft = match self.purposes[at] {
            Purpose::Home => self.home_at.is_some_and(|edge| position >= edge),
            Purpose::ForwardLimit => self.forward_at.is_some_and(|edge| position >= edge),
            Purpose::ReverseLimit => self.reverse_at.is_some_and(|edge| position <= edge),
            _ => false,
        };
        by_shaft || self.driven[at]
    }
}
