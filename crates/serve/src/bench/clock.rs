//! The bench's time: the machine's, or that of a simulation in virtual time.

use std::time::Duration;

use polepair::simulate::{Simulation, SimulationPace};
use polepair_core::time::Instant;
use polepair_link::clock;

/// Longest step of virtual time between two looks.
pub(super) const STEP: Duration = Duration::from_millis(1);

/// Clock of a bench.
#[derive(Clone, Debug)]
pub(super) enum BenchClock {
    /// The machine's clock; threads look after the wires.
    Real,
    /// Virtual time: nothing happens but in [`Bench::advance_time`](super::Bench::advance_time).
    Virtual(Simulation),
}

impl BenchClock {
    /// Creates a clock of the simulations' virtual time, or of real time without them.
    pub fn from_simulations<'a>(mut simulations: impl Iterator<Item = &'a Simulation>) -> Self {
        let found = simulations.find(|simulation| simulation.pace() == SimulationPace::Virtual);
        found.map_or(Self::Real, |simulation| Self::Virtual(simulation.clone()))
    }

    /// Now.
    pub fn now(&self) -> Instant {
        match self {
            Self::Real => clock::now(),
            Self::Virtual(simulation) => simulation.now(),
        }
    }

    /// Milliseconds since 1970.
    pub fn wall_ms(at: Instant) -> f64 {
        clock::wall_ns(at) as f64 / 1e6
    }

    /// Returns whether threads look after the wires.
    pub const fn is_real(&self) -> bool {
        matches!(self, Self::Real)
    }
}
