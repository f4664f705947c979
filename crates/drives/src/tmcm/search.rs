//! The reference search (RFS): the sequence of switches (TMCL reference, axis parameter 193).

/// A switch of a motor.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SwitchKind {
    /// Left stop switch.
    Left,
    /// Right stop switch.
    Right,
    /// Home switch.
    Home,
}

/// A part of a search.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum SearchStep {
    /// Turns at the search speed until the switch closes; where the stop switch of that direction closes
    /// first, it turns round, if it may.
    Find {
        /// Switch that is searched.
        switch: SwitchKind,
        /// To the right.
        forward: bool,
        /// Turns round at the stop switch.
        turns_round: bool,
    },
    /// Turns at the switch speed until the switch opens: the place is exact.
    Leave {
        /// Switch that is left.
        switch: SwitchKind,
        /// To the right.
        forward: bool,
    },
    /// Goes to the place that was found last, and calls it zero.
    Finish,
}

/// A search under way.
#[derive(Clone, Copy, Debug)]
pub struct Search {
    steps: [SearchStep; STEPS_MAX],
    /// The present step.
    pub at: usize,
    /// The present step has found its edge, and the motor brakes.
    pub is_braking: bool,
    /// True once it has reversed at the stop switch.
    pub turned: bool,
    /// Position at which the last switch opened, rad of the field.
    pub edge: f64,
    /// Position at which the right stop switch opened.
    pub right_edge: Option<f64>,
    /// The level of the home switch is inverted.
    pub inverts_home: bool,
}

const STEPS_MAX: usize = 5;

impl Search {
    /// The search of that mode; `None` for one that there is not. \[I\] 3 and 4 look at the switch from both
    /// sides: the switches of the bench open where they close.
    #[must_use]
    pub fn new(mode: i32) -> Option<Self> {
        use SearchStep::{Finish, Leave};
        let mirrored = mode & 64 != 0;
        let stop =
            |right: bool| if right == mirrored { SwitchKind::Left } else { SwitchKind::Right };
        let near = [
            find_step(stop(false), mirrored, false),
            Leave { switch: stop(false), forward: !mirrored },
        ];
        let far = [
            find_step(stop(true), !mirrored, false),
            Leave { switch: stop(true), forward: mirrored },
        ];
        let home = |forward, turns_round| {
            // Always left to the same side, so that the zero does not depend on where the search began.
            let opened = Leave { switch: SwitchKind::Home, forward: false };
            [find_step(SwitchKind::Home, forward, turns_round), opened, Finish, Finish, Finish]
        };
        let steps = match mode & 63 {
            1 | 4 => [near[0], near[1], Finish, Finish, Finish],
            2 | 3 => [far[0], far[1], near[0], near[1], Finish],
            5 => home(false, true),
            6 => home(true, true),
            7 => home(true, false),
            8 => home(false, false),
            _ => return None,
        };
        Some(Self {
            steps,
            at: 0,
            is_braking: false,
            turned: false,
            edge: 0.0,
            right_edge: None,
            inverts_home: mode & 128 != 0,
        })
    }

    /// The present step.
    #[must_use]
    pub fn step(&self) -> SearchStep {
        self.steps.get(self.at).copied().unwrap_or(SearchStep::Finish)
    }

    /// Goes on to the next step.
    pub const fn advance(&mut self) {
        debug_assert!(self.at < STEPS_MAX, "a search ends with its last step");
        self.at += 1;
        self.is_braking = false;
        self.turned = false;
    }
}

fn find_step(switch: SwitchKind, forward: bool, turns_round: bool) -> SearchStep {
    SearchStep::Find { switch, forward, turns_round }
}
