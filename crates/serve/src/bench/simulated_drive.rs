//! What can be done to a simulated drive from outside its wire.

use polepair::simulate::Simulation;
use polepair_core::drives::bench::{Act, GroundTruth};

use crate::message::{GatewayError, PanelView, SimulationActionInfo};

/// Keys of a panel that are looked for.
const KEYS_MAX: u8 = 16;
/// What an act that presses a key is called, before the key's number.
const KEY: &str = "key-";

/// A drive of a simulation.
#[derive(Clone, Debug)]
pub(super) struct SimulatedDrive {
    simulation: Simulation,
    link: usize,
    drive: usize,
    /// Keys of its panel.
    keys: u8,
}

/// What makes an act of a value.
type ActionConstructor = fn(f64) -> Act;

/// Every act: its word, what it does, the unit of its value, where it takes one.
const ACTS: [(&str, &str, Option<&str>, ActionConstructor); 8] = [
    ("load", "A constant torque on the shaft; negative brakes forward motion", Some("N·m"), {
        Act::Load
    }),
    ("jam", "Holds the shaft still (1), or lets it go (0)", Some(""), |value| {
        Act::Jam(value != 0.0)
    }),
    ("supply", "The supply voltage", Some("V"), Act::Supply),
    ("ambient", "The air's temperature", Some("°C"), Act::Ambient),
    ("encoder", "The encoder stops counting (1), or counts again (0)", Some(""), |value| {
        Act::EncoderBroken(value != 0.0)
    }),
    ("hall", "The hall sensors give nonsense (1), or work again (0)", Some(""), |value| {
        Act::HallBroken(value != 0.0)
    }),
    ("fault", "Raises the fault of that code", Some(""), |value| Act::Fault(value as u32)),
    ("power-cycle", "Takes the supply away and brings it back", None, |_| Act::PowerCycle),
];

impl SimulatedDrive {
    /// The drive of that address, or of that place, on a link of a simulation or behind a relay on it.
    pub fn find(simulation: &Simulation, link: usize, number: u32, index: usize) -> Option<Self> {
        let description = simulation.description();
        let links = &description.rack.links;
        let reached = |n: &usize| *n == link || description.relay_link(*n) == Some(link);
        let all: Vec<(usize, usize, Option<u32>)> = (0..links.len())
            .filter(reached)
            .flat_map(|n| links[n].drives.iter().enumerate().map(move |(d, drive)| (n, d, drive)))
            .map(|(n, d, drive)| (n, d, drive.address))
            .collect();
        let by_address = all.iter().find(|(_, _, address)| *address == Some(number));
        let &(link, drive, _) = by_address.or_else(|| all.get(index))?;
        // To let go of a key that nobody holds does nothing, and tells whether there is one.
        let has = |n: &u8| simulation.act(link, drive, Act::Key(*n, false));
        let keys = (0..KEYS_MAX).take_while(has).count() as u8;
        Some(Self { simulation: simulation.clone(), link, drive, keys })
    }

    /// What can be done to it.
    pub fn acts(&self) -> Vec<SimulationActionInfo> {
        let info = |(act, about, unit, _): &(&str, &str, Option<&str>, ActionConstructor)| {
            SimulationActionInfo {
                act: (*act).to_owned(),
                about: (*about).to_owned(),
                unit: unit.map(str::to_owned),
            }
        };
        let key = |act: String| SimulationActionInfo {
            act,
            about: "Holds this key of the panel (1), or lets it go (0)".to_owned(),
            unit: Some(String::new()),
        };
        ACTS.iter().map(info).chain(self.keys().map(key)).collect()
    }

    fn keys(&self) -> impl Iterator<Item = String> {
        (0..self.keys).map(|n| format!("{KEY}{n}"))
    }

    /// Its panel, where it has one.
    pub fn panel(&self) -> Option<PanelView> {
        let shows = self.simulation.panel(self.link, self.drive)?;
        Some(PanelView { shows, keys: self.keys().collect() })
    }

    /// What is true of its motor.
    pub fn truth(&self) -> Option<GroundTruth> {
        self.simulation.truth(self.link, self.drive)
    }

    /// Does something to it.
    pub fn apply_action(&self, act: &str, value: Option<f64>) -> Result<(), GatewayError> {
        if value.is_some_and(|value| !value.is_finite()) {
            return Err(request_error("a value is a finite number".to_owned()));
        }
        let act_of_drive = self.parse_action(act, value)?;
        if self.simulation.act(self.link, self.drive, act_of_drive) {
            return Ok(());
        }
        Err(request_error(format!("this drive has nothing for `{act}`")))
    }

    fn parse_action(&self, act: &str, value: Option<f64>) -> Result<Act, GatewayError> {
        let needed = || value.ok_or_else(|| request_error(format!("`{act}` takes a value")));
        let key = act.strip_prefix(KEY).and_then(|n| n.parse().ok());
        if let Some(key) = key.filter(|key| *key < self.keys) {
            return Ok(Act::Key(key, needed()? != 0.0));
        }
        match ACTS.iter().find(|(word, ..)| *word == act) {
            Some((_, _, Some(_), make)) => Ok(make(needed()?)),
            Some((_, _, None, make)) => Ok(make(0.0)),
            None => {
                let words: Vec<String> = self.acts().into_iter().map(|info| info.act).collect();
                let hint = format!("there is {}", words.join(", "));
                Err(request_error(format!("nothing is called `{act}`")).hint(hint))
            }
        }
    }
}

fn request_error(what: String) -> GatewayError {
    GatewayError::new("gateway.request", what)
}
