//! Parameters that a random world may write: they store the value, and nothing else about the drive
//! changes.
//!
//! They are found by a test on a separate drive: two values are written and read back, the drive loses its
//! supply, and must still reply.

use std::collections::HashMap;
use std::sync::{Mutex, OnceLock};

use polepair_core::axis::{Axes, Command, Verb};
use polepair_core::error::Outcome;
use polepair_core::medium::{CanLine, MediumKind};
use polepair_core::plan::{Compare, Step};
use polepair_core::profile::{Access, ParameterId, Persistence, Profile};
use polepair_core::proto::{HostOptions, SerialStandard};
use polepair_core::station::{AxisIndex, Ticket};
use polepair_drives::surroundings::Act;

use crate::host::{self, HostProtocol};
use crate::rack::RackDrive;
use crate::serial_line::SerialWireConfig;
use crate::world::{NodeId, WireId, World};

/// Parameters that are kept per product.
const INERT_MAX: usize = 12;
/// Parameters of a product that are tried.
const TRIALS_MAX: usize = 60;
/// Verbs of a trial.
const TRIAL_VERBS: [Verb; 7] = [
    Verb::Enable,
    Verb::MoveBy,
    Verb::MoveTo,
    Verb::Velocity,
    Verb::Home,
    Verb::Stop,
    Verb::Disable,
];
/// Silence after which a drive counts as quiet, ms.
const QUIET_MS: u32 = 100;
/// The only axis of a trial.
const AXIS: AxisIndex = AxisIndex(0);

/// A parameter that keeps what is written, within a few steps of the value from the factory.
#[derive(Clone, Copy, Debug)]
pub struct InertParameter {
    pub id: ParameterId,
    pub min: i64,
    pub max: i64,
    /// The values within that some plan requires.
    pub required: &'static [i64],
}

type InertCache = HashMap<(&'static str, MediumKind, &'static str), &'static [InertParameter]>;

/// The inert parameters of a product on a protocol; found once per process.
pub fn inert_parameters(
    protocol: &HostProtocol,
    profile: &'static Profile,
) -> &'static [InertParameter] {
    static KNOWN: OnceLock<Mutex<InertCache>> = OnceLock::new();
    let mut known = KNOWN.get_or_init(Mutex::default).lock().unwrap_or_else(|e| e.into_inner());
    known
        .entry((protocol.name, protocol.medium, profile.name))
        .or_insert_with(|| find_inert(protocol, profile).leak())
}

fn find_inert(protocol: &HostProtocol, profile: &'static Profile) -> Vec<InertParameter> {
    let ids = (0..profile.parameters.len()).filter_map(|n| u16::try_from(n).ok()).map(ParameterId);
    let candidates = ids.filter(|id| {
        profile.parameter(*id).is_some_and(|p| {
            p.access == Access::ReadWrite
                && !p.moves
                && p.persistence != Persistence::Always
                && p.max.saturating_sub(p.min) >= 3
        })
    });
    candidates
        .filter(|id| !is_planned(profile, *id) && !scales_others(profile, *id))
        .take(TRIALS_MAX)
        .filter_map(|id| try_parameter(protocol, profile, id))
        .take(INERT_MAX)
        .collect()
}

/// Returns whether some plan of the product writes the parameter: then it is not ours alone.
fn is_planned(profile: &Profile, id: ParameterId) -> bool {
    let steps = profile.plans.iter().flat_map(|plan| plan.steps.iter().chain(plan.undo));
    profile.ram.is_some_and(|ram| ram.parameter == id)
        || steps.into_iter().any(|step| match *step {
            Step::Write(to, _)
            | Step::Ensure(to, _)
            | Step::WriteBits { id: to, .. }
            | Step::Copy { to, .. } => to == id,
            Step::WriteTogether(writes) => writes.iter().any(|(to, _)| *to == id),
            _ => false,
        })
}

/// Returns whether other values change their unit with the parameter.
fn scales_others(profile: &'static Profile, id: ParameterId) -> bool {
    profile.parameters.iter().any(|other| other.scale.inputs(profile).any(|input| input == id))
}

fn try_parameter(
    protocol: &HostProtocol,
    profile: &'static Profile,
    id: ParameterId,
) -> Option<InertParameter> {
    let parameter = profile.parameter(id)?;
    let mut parameter_trial = ParameterTrial::new(protocol, profile)?;
    let usual = parameter_trial.read(id)?;
    let (min, max) =
        (parameter.min.max(usual.saturating_sub(20)), parameter.max.min(usual.saturating_add(20)));
    for value in [max, min, usual] {
        parameter_trial.write(id, value)?;
        (parameter_trial.read(id)? == value && parameter_trial.is_quiet()).then_some(())?;
    }
    // A drive may change a flag of it by itself as it moves.
    let flags = (min..=max).rev().find(|raw| (raw + 1).count_ones() == 1).unwrap_or(max);
    parameter_trial.write(id, flags)?;
    parameter_trial.run_motion();
    (parameter_trial.read(id)? == flags).then_some(())?;
    parameter_trial.write(id, max)?;
    parameter_trial.power_cycle();
    parameter_trial.read(id)?;
    (max - min >= 2).then(|| InertParameter {
        id,
        min,
        max,
        required: required_values(profile, id, min, max),
    })
}

/// The values without which some plan of the product does not begin: a drive's mode.
fn required_values(profile: &Profile, id: ParameterId, min: i64, max: i64) -> &'static [i64] {
    let steps = profile.plans.iter().flat_map(|plan| plan.steps);
    let tests: Vec<_> = steps
        .filter_map(|step| match *step {
            Step::Require { read, test, .. } if read == id => Some(test),
            _ => None,
        })
        .filter(|test| matches!(test.compare, Compare::Equal | Compare::Among))
        .collect();
    (min..=max).filter(|raw| tests.iter().any(|test| test.passes(*raw))).collect::<Vec<_>>().leak()
}

/// One host and one drive on a wire that works.
struct ParameterTrial {
    world: World,
    wire: WireId,
    host: NodeId,
    drive: NodeId,
}

impl ParameterTrial {
    fn new(protocol: &HostProtocol, profile: &'static Profile) -> Option<Self> {
        let mut world = World::new(0);
        let wire = match protocol.medium {
            MediumKind::Serial => world.add_serial(SerialWireConfig::RS232),
            MediumKind::Can => world.add_can(CanLine { bit_rate: protocol.baud }),
        };
        let mut spec = RackDrive::new(profile, protocol.name);
        spec.address = Some(protocol.first_address);
        let drive = spec.build(&mut world, wire, false).ok()?;
        let options = host_options(protocol, false, false);
        let host = world.add_node(host::host_lane(
            protocol.name,
            protocol.medium,
            options,
            &[(profile, protocol.first_address)],
        )?);
        world.plug_host(wire, host, 0);
        world.run_until(world.now().plus_ms(2_000));
        Some(Self { world, wire, host, drive })
    }

    fn read(&mut self, id: ParameterId) -> Option<i64> {
        self.execute(|axes, now| axes.read_parameter(now, Ticket(0), AXIS, id).ok())
    }

    fn write(&mut self, id: ParameterId, raw: i64) -> Option<i64> {
        self.execute(|axes, now| axes.write_parameter(now, Ticket(0), AXIS, id, raw, false).ok())
    }

    fn execute(
        &mut self,
        submit: impl FnOnce(&mut dyn Axes, polepair_core::time::Instant) -> Option<()>,
    ) -> Option<i64> {
        self.world
            .with_node(self.host, |node, now| node.axes().and_then(|axes| submit(axes, now)))?;
        let until = self.world.now().plus_ms(2_000);
        while self.world.now() < until {
            let outcome = self.world.with_node(self.host, |n, _| n.axes()?.poll_outcome());
            match outcome {
                Some((_, Outcome::Done(raw))) => return Some(raw),
                Some(_) => return None,
                None => drop(self.world.step()?),
            }
        }
        None
    }

    /// Returns whether the drive sends nothing unsolicited: such frames could fill a bus.
    fn is_quiet(&mut self) -> bool {
        let before = last_sent_tag(&self.world, self.wire, self.drive);
        self.world.run_until(self.world.now().plus_ms(QUIET_MS));
        last_sent_tag(&self.world, self.wire, self.drive) == before
    }

    /// Has the drive do whatever it does as it comes from the factory.
    fn run_motion(&mut self) {
        for verb in TRIAL_VERBS {
            let (target, velocity) = (Some(1.0), Some(1.0));
            let command = Command { target, velocity, ..Command::new(verb) };
            self.execute(|axes, now| {
                axes.set_armed(AXIS, true);
                axes.command(now, Ticket(0), AXIS, command).ok()
            });
        }
    }

    fn power_cycle(&mut self) {
        self.world
            .with_node(self.drive, |n, now| n.surroundings().map(|b| b.act(now, Act::PowerCycle)));
        self.world.run_until(self.world.now().plus_ms(2_000));
    }
}

fn last_sent_tag(world: &World, wire: WireId, drive: NodeId) -> u32 {
    match world.medium(wire) {
        MediumKind::Serial => world.serial_status(wire, drive).last_sent.tag,
        MediumKind::Can => world.can_status(wire, drive).map_or(0, |s| s.last_sent.tag),
    }
}

/// Options of a swarm's hosts. An echo there is on a bus only.
pub fn host_options(protocol: &HostProtocol, bus: bool, echo: bool) -> HostOptions {
    let wire = bus.then_some(SerialStandard::Rs485);
    HostOptions { echo, standard: wire, ..HostOptions::new(protocol.baud) }
}
