//! Eight inputs and four outputs (TS manual V2 §2.3), with their functions.
//!
//! The manual states that input functions can be assigned (two equal ones are ERR_Id), but not the default.
//! The default order here is `[I]`.

/// Number of inputs.
pub const INPUTS: usize = 8;

/// Function of an input.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum InputPurpose {
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

impl InputPurpose {
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
pub const PURPOSES: [InputPurpose; INPUTS] = [
    InputPurpose::ServoOn,
    InputPurpose::AlarmClear,
    InputPurpose::PathTrigger,
    InputPurpose::HomingTrigger,
    InputPurpose::Home,
    InputPurpose::ReverseLimit,
    InputPurpose::ForwardLimit,
    InputPurpose::Spare,
];

/// Way beyond the home switch after which a search turns round, as it does at a limit switch: three turns `[I]`.
/// Without an end, an axis beyond its switch would be searched for ever.
const SEARCH_RAD: f64 = 3.0 * core::f64::consts::TAU;

/// True when two inputs have the same purpose: ERR_Id.
#[must_use]
pub fn has_duplicates(purposes: &[InputPurpose; INPUTS]) -> bool {
    purposes
        .iter()
        .filter(|p| **p != InputPurpose::Spare)
        .any(|p| purposes.iter().filter(|q| *q == p).count() > 1)
}

/// The lines as they are, and the switches that the shaft closes.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct InputLines {
    purposes: [InputPurpose; INPUTS],
    /// Input of each purpose, counted from 1; 0 is none.
    inputs_by_purpose: [u8; InputPurpose::ALL.len()],
    /// Inputs that something outside closes.
    pub forced_closed: [bool; INPUTS],
    /// Shaft position of the home switch, closed from there on forward, rad.
    pub home_at: Option<f64>,
    /// Shaft position of the positive limit, closed from there on forward, rad.
    pub forward_at: Option<f64>,
    /// Shaft position of the negative limit, closed from there on in reverse, rad.
    pub reverse_at: Option<f64>,
}

impl InputLines {
    /// Nothing is closed from outside, and the home switch alone is there, at that shaft position
    /// (rad).
    #[must_use]
    pub fn new(purposes: [InputPurpose; INPUTS], home_at: f64) -> Self {
        let mut lines = Self {
            purposes,
            inputs_by_purpose: [0; InputPurpose::ALL.len()],
            forced_closed: [false; INPUTS],
            home_at: Some(home_at),
            forward_at: None,
            reverse_at: None,
        };
        lines.assign(purposes);
        lines
    }

    /// Function of each input.
    #[must_use]
    pub const fn purposes(&self) -> &[InputPurpose; INPUTS] {
        &self.purposes
    }

    /// Assigns functions to the inputs. Of two inputs with one function, the first counts.
    pub fn assign(&mut self, purposes: [InputPurpose; INPUTS]) {
        self.purposes = purposes;
        self.inputs_by_purpose = [0; InputPurpose::ALL.len()];
        for at in (0..INPUTS).rev() {
            self.inputs_by_purpose[purposes[at] as usize] = at as u8 + 1;
        }
    }

    /// Returns whether the input of that function is closed with the shaft at `position` (rad).
    #[inline]
    #[must_use]
    pub fn is_closed(&self, purpose: InputPurpose, position: f64) -> bool {
        let index = usize::from(self.inputs_by_purpose[purpose as usize]);
        let driven = self.forced_closed.get(index.wrapping_sub(1));
        driven.is_some_and(|driven| *driven || self.is_closed_by_shaft(purpose, position))
    }

    /// Returns whether a search of the home switch that goes `toward` (1 or -1) is at the end of its way at
    /// `position` (rad): the switch lies behind it.
    #[must_use]
    pub fn is_search_end(&self, toward: f64, position: f64) -> bool {
        self.home_at.is_some_and(|edge| (position - edge) * toward > SEARCH_RAD)
    }

    /// All inputs, the first in bit 0.
    #[must_use]
    pub fn bits(&self, position: f64) -> u8 {
        (0..INPUTS).fold(0, |bits, at| bits | u8::from(self.is_input_closed(at, position)) << at)
    }

    fn is_input_closed(&self, at: usize, position: f64) -> bool {
        self.forced_closed[at] || self.is_closed_by_shaft(self.purposes[at], position)
    }

    #[inline]
    fn is_closed_by_shaft(&self, purpose: InputPurpose, position: f64) -> bool {
        match purpose {
            InputPurpose::Home => self.home_at.is_some_and(|edge| position >= edge),
            InputPurpose::ForwardLimit => self.forward_at.is_some_and(|edge| position >= edge),
            InputPurpose::ReverseLimit => self.reverse_at.is_some_and(|edge| position <= edge),
            _ => false,
        }
    }
}
