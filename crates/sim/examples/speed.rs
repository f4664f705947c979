//! Speed of a world: every drive of the registry's first two protocols on a link of its own,
//! polled back to back at 115200 baud, and the same through two bare stations.
//!
//! `cargo run --release -p polepair-sim --example speed [SECONDS]`

use polepair_core::axis::Command;
use polepair_core::axis::Verb;
use polepair_core::profile::{ParameterId, Signal};
use polepair_core::proto::HostOptions;
use polepair_core::station::{AxisIndex, Ticket};
use polepair_core::time::Instant;
use polepair_sim::host;
use polepair_sim::rack::RackDrive;
use polepair_sim::serial_line::SerialWireConfig;
use polepair_sim::world::{NodeId, World};

const AXIS: AxisIndex = AxisIndex(0);
const BAUD: u32 = 115_200;
const RACK: [(&str, &str); 2] = [("tmcl", "tmcm-171"), ("modbus-rtu", "syntron-ts")];

fn main() {
    let seconds = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(60);
    for rack in [&RACK[..1], &RACK[1..], &RACK[..]] {
        let mut world = World::new(1);
        let mut hosts = Vec::new();
        for (protocol, product) in rack {
            hosts.extend(add_host_and_drive(&mut world, protocol, product));
        }
        hosts.iter().for_each(|(host, parameter)| submit_read(&mut world, *host, *parameter));
        run(&mut world, &hosts, Instant::ZERO.plus_ms(2_000));
        let (events, started_at) = (world.events(), std::time::Instant::now());
        let end = world.now().plus_ms(seconds * 1_000);
        let polls = run(&mut world, &hosts, end);
        let took = started_at.elapsed().as_secs_f64();
        let names: Vec<_> = rack.iter().map(|(_, product)| *product).collect();
        println!(
            "{:24} {seconds} s in {took:.3} s: {:.0} x real time, {:.0} polls/s each, {:.1} M events/s",
            names.join(" + "),
            f64::from(seconds) / took,
            polls as f64 / f64::from(seconds) / hosts.len().max(1) as f64,
            (world.events() - events) as f64 / took / 1e6,
        );
    }
}

/// A host and its drive on a wire, the motor powered; and the parameter to poll.
fn add_host_and_drive(
    world: &mut World,
    protocol: &str,
    product: &str,
) -> Option<(NodeId, ParameterId)> {
    let host_protocol = host::protocols().into_iter().find(|p| p.name == protocol)?;
    let profile = polepair_drives::profiles().iter().copied().find(|p| p.name == product)?;
    let wire = world.add_serial(SerialWireConfig { baud: Some(BAUD), ..SerialWireConfig::RS232 });
    let mut spec = RackDrive::new(profile, protocol);
    spec.address = Some(host_protocol.first_address);
    spec.build(world, wire, false).ok()?;
    let options = HostOptions::new(BAUD);
    let host = world.add_node(host::host_lane(
        protocol,
        host_protocol.medium,
        options,
        &[(profile, host_protocol.first_address)],
    )?);
    world.plug_host(wire, host, 0);
    world.with_node(host, |node, now| {
        let axes = node.axes()?;
        axes.set_armed(AXIS, true);
        axes.command(now, Ticket(1), AXIS, Command::new(Verb::Enable)).ok()
    });
    Some((host, profile.signal(Signal::Position)?.parameter))
}

/// Polls every host again as soon as it has answered. Returns the number of answers.
fn run(world: &mut World, hosts: &[(NodeId, ParameterId)], until: Instant) -> u64 {
    let mut polls = 0;
    while world.next_event().is_some_and(|at| at <= until) {
        world.step();
        for (host, parameter) in hosts {
            let ended = world.inspect(*host, |n, _| n.axes().and_then(|axes| axes.poll_outcome()));
            if ended.is_some_and(|(Ticket(ticket), _)| ticket == 0) {
                polls += 1;
                submit_read(world, *host, *parameter);
            }
        }
    }
    polls
}

fn submit_read(world: &mut World, host: NodeId, parameter: ParameterId) {
    world.with_node(host, |node, now| {
        node.axes().map(|axes| axes.read_parameter(now, Ticket(0), AXIS, parameter).is_ok())
    });
}
