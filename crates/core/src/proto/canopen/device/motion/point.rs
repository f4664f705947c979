//! Queue of set-points of profile position mode.

use crate::plant::Limits;

/// Target and profile of a move.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ProfilePoint {
    /// User's coordinate, rad.
    pub target: f64,
    /// Speed and ramps.
    pub limits: Limits,
    /// The next one is taken over in passing, at speed (controlword bit 9).
    pub changes_in_passing: bool,
}

/// Up to `N` points that wait for the one that runs.
#[derive(Clone, Debug)]
pub struct PointQueue<const N: usize> {
    ring: [ProfilePoint; N],
    first: usize,
    len: usize,
}

impl<const N: usize> PointQueue<N> {
    /// None.
    #[must_use]
    pub const fn new() -> Self {
        let nowhere = ProfilePoint {
            target: 0.0,
            limits: Limits::trapezoid(0.0, 0.0),
            changes_in_passing: false,
        };
        Self { ring: [nowhere; N], first: 0, len: 0 }
    }

    /// Notes one more. False when there is no room: it is lost.
    pub fn push(&mut self, point: ProfilePoint) -> bool {
        let has_room = !self.is_full();
        if has_room {
            self.ring[(self.first + self.len) % N] = point;
            self.len += 1;
        }
        has_room
    }

    /// The oldest.
    pub fn pop(&mut self) -> Option<ProfilePoint> {
        let point = self.peek()?;
        self.first = (self.first + 1) % N;
        self.len -= 1;
        Some(point)
    }

    /// The oldest, which stays.
    #[must_use]
    pub fn peek(&self) -> Option<ProfilePoint> {
        (self.len > 0).then(|| self.ring[self.first])
    }

    /// Forgets all.
    pub const fn clear(&mut self) {
        self.len = 0;
    }

    /// No more can be noted.
    #[must_use]
    pub const fn is_full(&self) -> bool {
        self.len == N
    }
}
