//! Drives that speak at 9600 again, and a host that has its line's rate back.

use polepair_core::axis::Axes;
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::medium::MediumKind;
use polepair_core::proto::{HostOptions, SerialStandard};
use polepair_core::station::{AxisIndex, Ticket};
use polepair_core::time::Instant;
use polepair_drives::surroundings::Act;
use polepair_drives::technosoft::{Device, Technosoft};
use polepair_drives::{DeviceOptions, Family};
use polepair_sim::fault::SerialFaults;
use polepair_sim::host;
use polepair_sim::node::{DriveNode, SERIAL_PORT};
use polepair_sim::random::Ppm;
use polepair_sim::serial_line::SerialWireConfig;
use polepair_sim::world::{NodeId, WireId, World};

const AXIS: AxisIndex = AxisIndex(0);

struct Bench {
    world: World,
    host: NodeId,
    drives: Vec<NodeId>,
    wire: WireId,
    tickets: u32,
}

impl Bench {
    fn new(serial: SerialWireConfig, options: HostOptions, axes: &[u32]) -> Self {
        let mut world = World::new(1);
        let wire = world.add_serial(serial);
        let profile = Technosoft::profiles()[0];
        let named: Vec<_> = axes.iter().map(|axis| (profile, *axis)).collect();
        let host =
            world.add_node(host::host_lane("tml", MediumKind::Serial, options, &named).unwrap());
        world.plug_host(wire, host, 0);
        let standard =
            if options.standard == Some(SerialStandard::Rs485) { "rs485" } else { "rs232" };
        let mut drives = Vec::new();
        for axis in axes {
            let options = DeviceOptions {
                address: Some(*axis),
                wires: &["tml"],
                standard: None,
                untimed: false,
                seed: 1,
                extra: &[("wire", standard)],
            };
            let device: Device = Technosoft::create_device(profile, &options).unwrap();
            let drive = world.add_node(Box::new(DriveNode(device)));
            world.plug_drive(wire, drive, SERIAL_PORT);
            drives.push(drive);
        }
        world.run_until(Instant::ZERO.plus_ms(50));
        Self { world, host, drives, wire, tickets: 0 }
    }

    fn run(
        &mut self,
        start: impl FnOnce(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported>,
    ) -> Outcome {
        self.tickets += 1;
        let ticket = Ticket(self.tickets);
        self.world.with_node(self.host, |node, now| {
            let axes = node.axes().unwrap();
            axes.set_armed(AXIS, true);
            start(axes, now, ticket).unwrap();
        });
        let limit = self.world.now().plus_ms(60_000);
        while self.world.now() < limit {
            self.world.step();
            let axes =
                |node: &mut dyn polepair_sim::node::SimNode, _| node.axes().unwrap().poll_outcome();
            if let Some((ended, outcome)) = self.world.with_node(self.host, axes) {
                assert_eq!(ended, ticket);
                return outcome;
            }
        }
        panic!("nothing ended")
    }

    fn gain(&mut self) -> Outcome {
        let id = Technosoft::profiles()[0].find_parameter("KPP").unwrap();
        self.run(|axes, now, ticket| axes.read_parameter(now, ticket, AXIS, id))
    }

    fn raw(&mut self, text: &str) -> Outcome {
        self.run(|axes, now, ticket| axes.send_text(now, ticket, AXIS, text))
    }

    fn port_baud(&mut self) -> u32 {
        self.world.inspect(self.host, |node, _| node.stream(0).unwrap().line().baud)
    }

    fn power_cycle(&mut self) {
        let drive = self.drives[0];
        assert!(
            self.world.with_node(drive, |node, now| node
                .surroundings()
                .unwrap()
                .act(now, Act::PowerCycle))
        );
    }

    fn baud(&mut self, drive: usize) -> u32 {
        let drive = self.drives[drive];
        self.world.inspect(drive, |node, _| node.stream(SERIAL_PORT).unwrap().line().baud)
    }
}

#[test]
fn a_fresh_drive_is_brought_to_the_lines_rate_and_back_to_it() {
    for rate in [19_200, 38_400, 57_600, 115_200] {
        let mut bench = Bench::new(SerialWireConfig::RS232, HostOptions::new(rate), &[1]);
        assert_eq!(bench.baud(0), 9600);
        assert_eq!(bench.gain(), Outcome::Done(288), "{rate}: it was just switched on");
        assert_eq!(bench.baud(0), rate);
        assert!(matches!(bench.raw("RESET"), Outcome::Done(_)), "{rate}");
        let acknowledged = bench.world.now().plus_ms(5);
        bench.world.run_until(acknowledged);
        assert_eq!(bench.baud(0), 9600, "{rate}: as after every reset");
        assert_eq!(bench.gain(), Outcome::Done(288), "{rate}");
        assert_eq!(bench.baud(0), rate);
        let before = bench.world.with_node(bench.host, |node, _| node.axes().unwrap().counters());
        assert_eq!(before.silent, 0, "{rate}: nobody was told of silence");
        bench.power_cycle();
        assert_eq!(bench.gain(), Outcome::Done(288), "{rate}: after a power cut");
        assert_eq!(bench.baud(0), rate);
    }
}

#[test]
fn where_several_drives_share_a_line_none_is_set_to_another_rate() {
    let options =
        HostOptions { standard: Some(SerialStandard::Rs485), ..HostOptions::new(115_200) };
    let mut bench = Bench::new(SerialWireConfig::RS485, options, &[1, 2]);
    assert_eq!(bench.gain(), Outcome::NotDone(Failure::Silent));
    assert_eq!((bench.baud(0), bench.baud(1)), (9600, 9600));
}

#[test]
fn the_host_follows_a_rate_that_it_sets_and_a_reset() {
    for opened in [9600, 38_400] {
        let mut bench = Bench::new(SerialWireConfig::RS232, HostOptions::new(opened), &[1]);
        assert_eq!(bench.gain(), Outcome::Done(288));
        for (code, rate) in [(4, 115_200), (1, 19_200), (0, 9600), (3, 57_600)] {
            assert!(matches!(bench.raw(&format!("SCIBR {code}")), Outcome::Done(_)), "{rate}");
            assert_eq!(bench.gain(), Outcome::Done(288), "{opened}, then {rate}");
            assert_eq!((bench.baud(0), bench.port_baud()), (rate, rate));
        }
        assert!(matches!(bench.raw("RESET"), Outcome::Done(_)));
        assert_eq!(bench.gain(), Outcome::Done(288), "{opened}: as the line was opened");
        assert_eq!((bench.baud(0), bench.port_baud()), (opened, opened));
        assert!(matches!(bench.raw("SCIBR 2"), Outcome::Done(_)));
        bench.power_cycle();
        assert_eq!(bench.gain(), Outcome::Done(288), "after a power cut");
        assert_eq!((bench.baud(0), bench.port_baud()), (38_400, 38_400));
    }
}

#[test]
fn a_drive_is_found_again_whose_new_rate_was_not_acknowledged() {
    let every = Ppm(1_000_000);
    let no_reply = SerialFaults { lose_reply: every, ..SerialFaults::NONE };
    let no_request = SerialFaults { lose_request: every, ..SerialFaults::NONE };
    let cases = [
        (9600, no_reply, 19_200),
        (9600, no_request, 9600),
        (57_600, no_reply, 19_200),
        (57_600, no_request, 57_600),
    ];
    for (opened, faults, rate) in cases {
        let mut bench = Bench::new(SerialWireConfig::RS232, HostOptions::new(opened), &[1]);
        assert_eq!(bench.gain(), Outcome::Done(288));
        *bench.world.serial_faults(bench.wire).unwrap() = faults;
        assert_eq!(bench.raw("SCIBR 1"), Outcome::Unknown(Failure::Silent), "{opened}");
        *bench.world.serial_faults(bench.wire).unwrap() = SerialFaults::NONE;
        assert_eq!(bench.gain(), Outcome::Done(288), "{opened}, then {rate}");
        assert_eq!((bench.baud(0), bench.port_baud()), (rate, rate), "{opened}");
    }
}
