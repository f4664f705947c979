//! A node that is lost in the middle of a long transfer, in segments and in blocks, both ways.

use polepair_core::station::HostData;
use std::time::Duration;

use super::*;

const NODE: u8 = 2;
/// The object that takes and gives any number of bytes, and how many it gives.
const STREAM: ObjectIndex = ObjectIndex::new(0x2F01, 2);
const LENGTH: ObjectIndex = ObjectIndex::new(0x2F01, 1);
const SIZE: u32 = 3_000;

/// Loss of the node in the middle of a transfer.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Loss {
    /// The connector is pulled, and put in again at the end.
    Pulled,
    /// The supply is lost for a moment.
    Powered,
}

/// One node, and a host that asks for more than a lane does.
struct HostAndNode {
    bench: Bench,
    bare: Bare,
    node: NodeId,
}

impl HostAndNode {
    fn new(seed: u64) -> Self {
        let mut world = World::new(seed);
        let wire = world.add_can(CanLine { bit_rate: BIT_RATE });
        let bare = Bare::new();
        let node = world.add_node(Box::new(CanStationNode(bare.clone())));
        world.plug_host(wire, node, 0);
        let drives = vec![drive(cia402(), NODE.into()).build(&mut world, wire, false).unwrap()];
        let (random, profiles, ends) = (Random::new(seed), vec![cia402()], Vec::new());
        let mut bench =
            Bench { world, random, wire, host: node, drives, profiles, tickets: 0, ends };
        bench.pass(50);
        let mut fixture = Self { bench, bare, node };
        let length = HostRequest::Write {
            node: NODE,
            object: LENGTH,
            bits: SIZE.into(),
            len: 4,
            class: RequestClass::ReadBack,
        };
        assert!(fixture.run_request(length).is_ok());
        fixture
    }

    fn begin(&mut self, request: HostRequest) -> Ticket {
        self.bench.tickets += 1;
        let ticket = Ticket(self.bench.tickets);
        let bare = &self.bare;
        let taken = self
            .bench
            .world
            .with_node(self.node, |_, now| bare.host().submit(now, ticket, request));
        taken.expect("the node is idle");
        ticket
    }

    /// Runs until the transfer ends. Returns its result, and the bytes that were read.
    fn finish(&mut self, ticket: Ticket, until: Instant) -> Option<Result<Answer, Failure>> {
        while self.bench.world.now() < until {
            let mut bytes = [0; 100];
            let bare = &self.bare;
            let end = self.bench.world.with_node(self.node, |_, _| {
                let mut host = bare.host();
                let _ = host.poll_bytes(ticket, &mut bytes);
                let _ = host.feed_bytes(ticket, &bytes);
                let mut ends = std::iter::from_fn(|| host.poll_event().copied());
                ends.find_map(|(to, result)| {
                    (to == EventSubject::Request(ticket)).then_some(result)
                })
            });
            if end.is_some() {
                return end;
            }
            self.bench.world.step();
        }
        None
    }

    fn run_request(&mut self, request: HostRequest) -> Result<Answer, Failure> {
        let ticket = self.begin(request);
        let until = self.bench.world.now().plus_ms(20_000);
        self.finish(ticket, until).expect("every ticket ends")
    }

    fn lose(&mut self, loss: Loss) {
        match loss {
            Loss::Pulled => self.bench.pull(0, true),
            Loss::Powered => self.bench.act(0, Act::PowerCycle),
        }
    }
}

fn upload(block: bool) -> HostRequest {
    HostRequest::Upload { node: NODE, object: STREAM, block, max: 0 }
}

fn download(block: bool) -> HostRequest {
    HostRequest::Download { node: NODE, object: STREAM, block, size: SIZE }
}

/// The node is lost somewhere within the transfer; the ticket ends, the next request is
/// answered, and the same transfer goes through.
fn lost_in_the_middle(request: HostRequest) {
    seeds(|seed| {
        let mut fixture = HostAndNode::new(seed);
        // How long it takes when nothing goes wrong.
        let started_at = fixture.bench.world.now();
        let whole = Ok(Answer::Transferred(SIZE));
        assert_eq!(fixture.run_request(request), whole);
        let took = fixture.bench.world.now().since(started_at).as_nanos() as u64;
        for loss in [Loss::Pulled, Loss::Powered] {
            if loss == Loss::Powered {
                let length = HostRequest::Write {
                    node: NODE,
                    object: LENGTH,
                    bits: SIZE.into(),
                    len: 4,
                    class: RequestClass::ReadBack,
                };
                assert!(fixture.run_request(length).is_ok());
            }
            let ticket = fixture.begin(request);
            let middle = fixture
                .bench
                .world
                .now()
                .plus_ns(took / 20 + fixture.bench.random.below(took * 9 / 10));
            assert_eq!(fixture.finish(ticket, middle), None, "{loss:?}");
            fixture.lose(loss);
            let lost = fixture.bench.world.now();
            let until = lost.plus_ms(20 * TIMEOUT_MS);
            let ended = fixture.finish(ticket, until);
            let waited = fixture.bench.world.now().since(lost).as_millis() as u32;
            assert!(
                matches!(ended, Some(Err(Failure::Silent | Failure::Refused { .. }))),
                "{loss:?}: {ended:?}"
            );
            assert!(waited <= 4 * TIMEOUT_MS, "{loss:?}: {waited} ms");
            fixture.bench.pull(0, false);
            fixture.bench.pass(10);
            // Its server is free: for something short, and for the same again.
            let answer = fixture.run_request(HostRequest::Read { node: NODE, object: LENGTH });
            assert!(matches!(answer, Ok(Answer::Value { .. })), "{loss:?}: {answer:?}");
            if loss == Loss::Pulled {
                assert_eq!(fixture.run_request(request), whole, "{loss:?}");
            }
        }
    });
}

#[test]
fn node_lost_in_the_middle_of_an_upload_in_segments() {
    lost_in_the_middle(upload(false));
}

#[test]
fn node_lost_in_the_middle_of_a_download_in_segments() {
    lost_in_the_middle(download(false));
}

#[test]
fn node_lost_in_the_middle_of_an_upload_in_blocks() {
    lost_in_the_middle(upload(true));
}

#[test]
fn node_lost_in_the_middle_of_a_download_in_blocks() {
    lost_in_the_middle(download(true));
}

/// The program dies in the middle; another one, which knows nothing of it, is answered.
#[test]
fn host_lost_in_the_middle_leaves_a_server_that_answers_the_next() {
    seeds(|seed| {
        for request in [upload(false), download(false), upload(true), download(true)] {
            let mut fixture = HostAndNode::new(seed);
            let ticket = fixture.begin(request);
            let middle =
                fixture.bench.world.now().plus_ns(1 + fixture.bench.random.below(20_000_000));
            assert_eq!(fixture.finish(ticket, middle), None);
            *fixture.bare.host() = CanHost::new(&HostOptions::new(BIT_RATE));
            fixture.bench.pass(5);
            let answer = fixture.run_request(HostRequest::Read { node: NODE, object: LENGTH });
            assert!(matches!(answer, Ok(Answer::Value { .. })), "{request:?}: {answer:?}");
            assert_eq!(fixture.run_request(request), Ok(Answer::Transferred(SIZE)), "{request:?}");
        }
    });
}

/// Blocks keep pace with the wire and leave none of it unused.
#[test]
fn a_download_in_blocks_takes_no_longer_than_its_frames() {
    let mut fixture = HostAndNode::new(1);
    let started_at = fixture.bench.world.now();
    assert_eq!(fixture.run_request(download(true)), Ok(Answer::Transferred(SIZE)));
    let took = fixture.bench.world.now().since(started_at);
    // Segments, with as many stuff bits as there can be, and a millisecond for each end of a block.
    let segments = u64::from(SIZE.div_ceil(7));
    let max = Duration::from_nanos(segments * 135 * 1_000_000_000 / u64::from(BIT_RATE))
        + Duration::from_millis(1 + segments / 127);
    println!("{SIZE} bytes in {took:?}, at most {max:?}");
    assert!(took < max, "{took:?} and not {max:?}");
}
