//! An incremental encoder with an index pulse.

use core::f64::consts::TAU;

/// An incremental encoder on the shaft.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Encoder {
    counts_per_turn: u32,
    inverted: bool,
    /// Counts that were missed while it was broken, less those before zeroing.
    offset: i64,
    frozen: Option<i64>,
}

impl Encoder {
    /// An encoder that reads 0 at shaft position 0. `counts_per_turn` 0 counts as 1.
    #[must_use]
    pub const fn new(counts_per_turn: u32) -> Self {
        let counts_per_turn = if counts_per_turn == 0 { 1 } else { counts_per_turn };
        Self { counts_per_turn, inverted: false, offset: 0, frozen: None }
    }

    /// Counts of a whole turn.
    #[must_use]
    pub const fn counts_per_turn(&self) -> u32 {
        self.counts_per_turn
    }

    /// Counts of a radian, with the sign of the direction.
    #[must_use]
    pub fn counts_per_rad(&self) -> f64 {
        let counts = f64::from(self.counts_per_turn) / TAU;
        if self.inverted { -counts } else { counts }
    }

    /// Changes resolution and direction; the count at shaft `position` (rad) stays the same.
    pub fn reconfigure(&mut self, position: f64, counts_per_turn: u32, inverted: bool) {
        // The drive's position register does not jump when its resolution is set anew.
        let reading = self.count(position);
        self.counts_per_turn = counts_per_turn.max(1);
        self.inverted = inverted;
        self.preset(position, reading);
    }

    /// The count at shaft `position` (rad).
    #[must_use]
    pub fn count(&self, position: f64) -> i64 {
        self.frozen.unwrap_or_else(|| self.true_count(position).wrapping_add(self.offset))
    }

    /// Makes it read `count` at shaft `position` (rad).
    pub fn preset(&mut self, position: f64, count: i64) {
        self.offset = count.wrapping_sub(self.true_count(position));
        // A broken encoder reads what it was preset to, and stays there.
        if self.frozen.is_some() {
            self.frozen = Some(count);
        }
    }

    /// The shaft position (rad) of `count`, as far as the counter knows.
    #[must_use]
    pub fn position_of(&self, count: i64) -> f64 {
        count.wrapping_sub(self.offset) as f64 / self.counts_per_rad()
    }

    /// Breaks it, so that it stops counting at shaft `position` (rad), or repairs it, so that it counts on from there.
    pub fn set_broken(&mut self, position: f64, broken: bool) {
        match (self.frozen, broken) {
            (None, true) => self.frozen = Some(self.count(position)),
            (Some(count), false) => {
                self.frozen = None;
                // Movement while it was broken is lost: counting goes on from the frozen value.
                self.preset(position, count);
            }
            _ => {}
        }
    }

    /// True while it does not count.
    #[must_use]
    pub const fn is_broken(&self) -> bool {
        self.frozen.is_some()
    }

    /// Returns whether the index pulse, once per turn at whole turns of the shaft, lies between two shaft positions
    /// (rad).
    #[must_use]
    pub fn index_between(&self, before: f64, after: f64) -> bool {
        self.frozen.is_none() && libm::floor(before / TAU) != libm::floor(after / TAU)
    }

    fn true_count(&self, position: f64) -> i64 {
        libm::floor(position * self.counts_per_rad() + 1e-6) as i64
    }
}
