//! Acts on simulated drives.

use polepair::simulate::{ACTS, ActKind, ActValue, SimulatedMotor, Simulation, act_of_value};
use polepair_drives::surroundings::{Act, GroundTruth};

use crate::message::{GatewayError, PanelView, SimulationActionInfo};

/// Keys of a panel that are looked for.
const KEYS_MAX: u8 = 16;
/// Prefix of the act that presses a key, before the key's number.
const KEY: &str = "key-";

/// The error for a real drive, which has no acts.
pub(super) fn not_simulated_error() -> GatewayError {
    GatewayError::new("gateway.simulated", "this is not a simulated drive")
        .hint("only simulated drives have acts")
}

/// A drive of a simulation.
#[derive(Clone, Debug)]
pub(super) struct SimulatedDrive {
    simulation: Simulation,
    motor: SimulatedMotor,
    /// Keys of its panel.
    keys: u8,
}

impl SimulatedDrive {
    /// The drive of that address, or of that place, on a link of a simulation or behind a relay on it.
    pub fn find(simulation: &Simulation, link: usize, number: u32, index: usize) -> Option<Self> {
        let motor = simulation.description().motor_of_axis(link, number, index)?;
        // Releasing a key that is not pressed does nothing, and shows whether it exists.
        let keys = (0..KEYS_MAX)
            .take_while(|n| simulation.act_on_motor(motor, Act::Key(*n, false)))
            .count() as u8;
        Some(Self { simulation: simulation.clone(), motor, keys })
    }

    /// Acts of the drive.
    pub fn acts(&self) -> Vec<SimulationActionInfo> {
        let plain = ACTS.iter().filter(|kind| !is_numbered(kind.word));
        let keys = ACTS.iter().filter(|kind| kind.word.starts_with(KEY));
        plain
            .map(|kind| action_info(kind.word.to_owned(), kind))
            .chain(keys.flat_map(|kind| self.keys().map(move |key| action_info(key, kind))))
            .collect()
    }

    fn keys(&self) -> impl Iterator<Item = String> {
        (0..self.keys).map(|n| format!("{KEY}{n}"))
    }

    /// Panel of the drive, where it has one.
    pub fn panel(&self) -> Option<PanelView> {
        let shows = self.simulation.panel(self.motor.link, self.motor.drive)?;
        Some(PanelView { shows, keys: self.keys().collect() })
    }

    /// True state of its motor.
    pub fn truth(&self) -> Option<GroundTruth> {
        self.simulation.motor_truth(self.motor)
    }

    /// Does something to it.
    pub fn apply_action(&self, act: &str, value: Option<f64>) -> Result<(), GatewayError> {
        // A place without a number is none.
        let is_place = ACTS.iter().any(|kind| kind.word == act && kind.value == ActValue::Place);
        let value = if is_place { Some(value.unwrap_or(f64::NAN)) } else { value };
        let act_of_drive = act_of_value(act, value)
            .map_err(|error| request_error(error.to_string()).hint(error.hint()))?;
        if self.simulation.act_on_motor(self.motor, act_of_drive) {
            return Ok(());
        }
        Err(request_error(format!("this drive has nothing for `{act}`")))
    }
}

fn is_numbered(word: &str) -> bool {
    word.ends_with('N')
}

fn action_info(act: String, kind: &ActKind) -> SimulationActionInfo {
    SimulationActionInfo {
        act,
        about: kind.about.to_owned(),
        unit: kind.value.unit().map(str::to_owned),
        flag: kind.value == ActValue::Flag,
    }
}

fn request_error(what: String) -> GatewayError {
    GatewayError::new("gateway.request", what)
}
