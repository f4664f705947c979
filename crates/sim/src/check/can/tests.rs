//! Excuses of the checker of a bus.

use polepair_core::medium::{CanLine, MediumKind};
use polepair_core::profile::ParameterId;
use polepair_core::proto::HostOptions;
use polepair_core::station::{AxisIndex, Ticket};
use polepair_core::time::Instant;

use super::CanChecker;
use crate::can_bus::CanFaults;
use crate::host;
use crate::rack::RackDrive;
use crate::random::{Ppm, Random};
use crate::world::World;

const BIT_RATE: u32 = 500_000;

/// Swarm can:6630, 9527, 15050: after a second copy of a reply each answer is taken for the next
/// question's, and a second copy within that shifts it by two.
#[test]
fn copies_within_what_copies_have_shifted_are_copies_too() {
    let profile =
        polepair_drives::profiles().iter().find(|p| p.name == "tmcm-171").expect("a module");
    let mut world = World::new(5);
    let wire = world.add_can(CanLine { bit_rate: BIT_RATE });
    let mut spec = RackDrive::new(profile, "tmcl");
    spec.address = Some(1);
    spec.build(&mut world, wire, false).expect("a module");
    let options = HostOptions::new(BIT_RATE);
    let lane = host::host_lane("tmcl", MediumKind::Can, options, &[(*profile, 1)]).expect("a lane");
    let node = world.add_node(lane);
    world.plug_host(wire, node, 0);
    let mut watch = CanChecker::new(node, wire, BIT_RATE);
    *world.can_faults(wire).expect("a bus") =
        CanFaults { error: Ppm(100_000), last_bit: Ppm(60_000), ..CanFaults::default() };
    let ids: Vec<ParameterId> = (0..profile.parameters.len() as u16).map(ParameterId).collect();
    let named = |name| {
        *ids.iter().find(|id| profile.parameters[usize::from(id.0)].name == name).expect(name)
    };
    let requests = [named("target velocity"), named("target position"), named("actual velocity")];
    let mut random = Random::new(8);
    let end = Instant::ZERO.plus_ms(6_000);
    let mut tickets = 0;
    while world.now() < end {
        let axis = AxisIndex(0);
        while world.inspect(node, |n, _| n.axes().and_then(|axes| axes.poll_outcome())).is_some() {}
        // Two wait at any time, so that the host never rests.
        for _ in 0..2 {
            tickets += 1;
            let id = random.pick(&requests);
            world.with_node(node, |n, now| {
                n.axes().map(|a| a.read_parameter(now, Ticket(tickets), axis, id))
            });
        }
        world.step();
        assert_eq!(watch.check_event(&mut world, &[]), None);
    }
    assert!(watch.copies_taken > 100, "{}", watch.copies_taken);
}
