//! A protocol that the core does not know: its folder, and its line in `visit_test_protocols`, are all it takes.

use polepair_core::axis::{AxisCommands, AxisRequests, Command, Verb};
use polepair_core::error::Outcome;
use polepair_core::lane::{BoxedDriver, Lane};
use polepair_core::medium::{Can, Frame};
use polepair_core::profile::ParameterId;
use polepair_core::proto::{HostOptions, Protocol};
use polepair_core::station::{AxisIndex, LineEvent, Station, Ticket, Timed};
use polepair_core::time::Instant;

use crate::toy;

/// Visits each protocol of this test with a drive for it.
trait TestProtocolVisitor {
    fn visit_protocol<P: Protocol<Medium = Can>>(&mut self, device: &mut dyn Station<Can>);
}

/// The list: a protocol is one line.
fn visit_test_protocols(visitor: &mut impl TestProtocolVisitor) {
    visitor.visit_protocol::<toy::Toy>(&mut toy::ToyDevice::new(ADDRESS));
}

const ADDRESS: u8 = 5;
const AXIS: AxisIndex = AxisIndex(0);

/// One host and one drive on a bus.
struct Bench<'a, P: Protocol<Medium = Can>> {
    lane: Lane<Can, P::Host>,
    device: &'a mut dyn Station<Can>,
    now: Instant,
}

impl<'a, P: Protocol<Medium = Can>> Bench<'a, P> {
    fn new(device: &'a mut dyn Station<Can>) -> Self {
        let driver: BoxedDriver<_, _> =
            Box::new(P::create_driver(P::generic_profile(), ADDRESS.into()));
        let options = HostOptions::new(P::DEFAULT_RATE);
        let mut lane = Lane::new(P::create_host(&options, &[ADDRESS.into()]), [driver]);
        let now = Instant::ZERO.plus_ms(100);
        lane.handle_line(now, LineEvent::Up);
        Self { lane, device, now }
    }

    /// Lets frames pass until a request has ended, at most for a second.
    fn finish(&mut self) -> Option<(Ticket, Outcome)> {
        for _ in 0..1000 {
            self.now = self.now.plus_ms(1);
            self.lane.handle_timeout(self.now);
            let mut frame = Frame::default();
            while self.lane.poll_transmit(self.now, &mut frame).is_some() {
                self.device.handle_input(self.now, &frame);
            }
            while self.device.poll_transmit(self.now, &mut frame).is_some() {
                self.lane.handle_input(self.now, &frame);
            }
            if let Some(end) = self.lane.poll_outcome() {
                return Some(end);
            }
        }
        None
    }

    fn command(&mut self, command: Command) -> Option<(Ticket, Outcome)> {
        self.lane.command(self.now, Ticket(1), AXIS, command).expect("a command");
        self.finish()
    }

    fn read(&mut self, parameter: ParameterId) -> Option<(Ticket, Outcome)> {
        self.lane.read_parameter(self.now, Ticket(2), AXIS, parameter).expect("a request");
        self.finish()
    }
}

/// Turns the motor of each protocol, and stops it.
struct TurnAndStop(usize);

impl TestProtocolVisitor for TurnAndStop {
    fn visit_protocol<P: Protocol<Medium = Can>>(&mut self, device: &mut dyn Station<Can>) {
        let mut bench = Bench::<P>::new(device);
        let actual = P::generic_profile().find_parameter("actual speed").expect("a parameter");
        let turn = Command {
            velocity: Some(10.0 * std::f64::consts::TAU / 60.0),
            ..Command::new(Verb::Velocity)
        };
        assert!(bench.lane.command(bench.now, Ticket(0), AXIS, turn).is_err(), "it is not armed");
        bench.lane.set_armed(AXIS, true);
        assert!(matches!(bench.command(turn), Some((Ticket(1), Outcome::Done(_)))));
        assert_eq!(bench.read(actual), Some((Ticket(2), Outcome::Done(10))));
        assert!(matches!(bench.command(Command::new(Verb::Stop)), Some((_, Outcome::Done(_)))));
        assert_eq!(bench.read(actual), Some((Ticket(2), Outcome::Done(0))));
        self.0 += 1;
    }
}

#[test]
fn a_protocol_that_the_core_does_not_know_turns_a_motor() {
    let mut turned = TurnAndStop(0);
    visit_test_protocols(&mut turned);
    assert_eq!(turned.0, 1);
}
