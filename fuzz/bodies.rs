//! Use of the input by each fuzz target: shared by cargo-fuzz (`fuzz_targets/`, `make soak`) and
//! by the seeded form of the same (`crates/cli/tests/commands/fuzz.rs`, `make test`).
//!
//! Nothing panics, nothing goes on without end, and a cut never reaches beyond its input.

use std::time::Duration;

use polepair_capture::{CaptureDecoder, DecodedFrame, ProtocolDetector, Rules};
use polepair_core::axis::{Command, Verb};
use polepair_core::error::WireError;
use polepair_core::explain::{
    Context, Direction, EncodeOptions, ExplainSink, Field, FrameBoundary,
};
use polepair_core::medium::{Frame, MediumKind, STREAM_UNIT_MAX};
use polepair_core::profile::{Access, ParameterId, Profile};
use polepair_core::proto::{self, HostOptions};
use polepair_core::station::{AxisIndex, LineEvent, Ticket};
use polepair_core::time::Instant;
use polepair_serve::bench::{self, Bench, PendingReply};
use polepair_serve::message::{ClientMessage, GatewayError, StopRequest};
use polepair_sim::host::{self, HostProtocol};
use polepair_sim::node::SimNode;
use polepair_sim::rack::RackDrive;

/// A target: its name, its body, and inputs to begin with.
pub type Target = (&'static str, fn(&[u8]), &'static [&'static [u8]]);

/// Every target.
pub const TARGETS: [Target; 11] = [
    ("deframe", deframe, FRAMES),
    ("can", can, FRAMES),
    (
        "text",
        text,
        &[b"\x00ROR 0, 350", b"\x01write Fn_33 200", b"\x03CPOS=-1000L; UPD", b"\x03C\xC3\xA9"],
    ),
    ("host", host_input, FRAMES),
    ("device", device_input, FRAMES),
    ("capture", capture, CAPTURES),
    ("url", url, URLS),
    ("profile", profile, PROFILES),
    ("setup", setup, &[b"PK\x05\x06\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0", b"PK\x03\x04"]),
    ("session", session, SESSIONS),
    ("gateway", gateway, GATEWAYS),
];

const FRAMES: &[&[u8]] = &[
    b"\x00\x01\x01\x00\x00\x00\x00\x01\x5E\x61",
    b"\x01\x02\x01\x64\x06\x00\x00\x02\xC7\x36",
    b"\x02\x01\x06\x00\x33\x00\xC8\x78\x53",
    b"\x03\x01\x03\x02\xFF\x38\xF8\x66",
    b"\x04:01030002000CEE\r\n",
    b"\x06\x04\x10\x00\x01\xC4\xD9",
    b"\x07\x4F\x08\x0F\xF1\xD8\x01\x35\x31\x34\x4C\xC7",
];

const CAPTURES: &[&[u8]] = &[
    b"(1700000000.000500) ttyUSB0 > 01 01 00 00 00 00 01 5E 61\n(1700000000.02) ttyUSB0 < 02 01 64",
    b"(1700000000.000500) can0 30B#5443000000000005\n(1.0) can0 0400A05E#R\n# said\n",
    b"ttyS0 < 010302FF38F866\n> 01 06 00 33 00 C8 78 53\n",
];

const URLS: &[&[u8]] = &[
    b"tmcl+serial:///dev/ttyUSB0:9600#1,2,g3",
    b"tml+tcp://10.0.0.5:10001?wire=rs485&host=255#255,1",
    b"technocan+slcan:///dev/ttyACM0?bitrate=500000#5",
    b"sim:tmcl?axes=3&seed=1",
    b"tmlcan+socketcand://host:29536/can0#g1+2",
];

const PROFILES: &[&[u8]] = &[
    b"name = \"d\"\nprotocol = \"modbus\"\n[[parameter]]\nname = \"a\"\nindex = 0x10\nmin = -5\nmax = 7\n",
    b"name = \"d\"\nextends = \"tmcm-171\"\n[plans.stop]\nsteps = [\"send 3 0 0\", \"until a == 0 within 1 s\"]\n",
    b"name = \"d\"\nprotocol = \"tmcl\"\n[[fault]]\ncode = 0x1\nname = \"x\"\n[[signal]]\nname = \"position\"\n",
];

/// See [`session`]: a protocol, whether its line has a baud rate, then one thing after the other.
const SESSIONS: &[&[u8]] = &[
    b"\x00\x00\x00\x01\x06\x14\x05\x09\x02\x01\x64\x06\x00\x00\x00\x07\x74",
    b"\x01\x00\x03\x01\x02\x05\x06\x18\x05\x00\x02\x02\x06\x1E",
    b"\x02\x01\x00\x00\x06\x16\x05\x07\x01\x03\x02\xFF\x38\xF8\x66\x01\x02\x01\x00",
    b"\x04\x00\x00\x02\x05\x01\x4F\x07\x00\x06\x19\x07\x01\x00\x03",
    b"\x07\x01\x00\x05\x06\x16\x05\x0A\x81\x05\x4F\x00\x10\x00\x92\x01\x02\x00",
];

const GATEWAYS: &[&[u8]] = &[
    br#"{"type":"lease","axis":0,"act":"take"}
{"type":"command","axis":0,"id":"a","issued_ms":0,"epoch":1,"verb":"arm"}
{"type":"command","axis":0,"id":"b","issued_ms":0,"epoch":1,"verb":"enable"}
{"type":"command","axis":0,"id":"c","issued_ms":0,"epoch":1,"verb":"velocity","arguments":{"velocity":20}}
{"type":"lease","axis":0,"act":"renew","epoch":1}
{"type":"stop","axes":[0],"reason":"x"}"#,
    br#"{"type":"subscribe","channel":1,"axis":1,"signal":"velocity","hz":100}
{"type":"subscribe","channel":2,"axis":0,"parameter":"max current","hz":5}
{"type":"frames","on":true,"filter":"protocol = tmcl and axis != 2"}
{"type":"stop"}
{"type":"release"}
{"type":"ping","client_ms":1.5}"#,
    br#"{"type":"lease","axis":1,"act":"take_over"}
{"type":"command","axis":1,"id":"m","issued_ms":-900,"ttl_ms":1e3,"epoch":1,"verb":"move-by","arguments":{"target":1e9}}
{"type":"lease","axis":1,"act":"drop","epoch":1}
{"type":"unsubscribe","channel":1}
{"type":"explain","n":0}"#,
];

/// Steps that anything may take before it counts as going on without end.
const STEPS_MAX: usize = 20_000;
const AXIS: AxisIndex = AxisIndex(0);

/// Takes what explaining says and checks that fields lie within the frame.
struct Checked(usize);

impl ExplainSink for Checked {
    fn kind(&mut self, _: &str) {}
    fn axis(&mut self, _: u32) {}
    fn field(&mut self, field: Field<'_>) {
        assert!(
            field.start <= field.end && usize::from(field.end) <= self.0,
            "{field:?} of {}",
            self.0
        );
    }
    fn text(&mut self, _: &str) {}
    fn error(&mut self, _: WireError) {}
}

/// The first byte chooses, the rest is the input.
fn choose<'a, T: Copy>(data: &'a [u8], choices: &[T]) -> Option<(T, &'a [u8])> {
    let (first, rest) = data.split_first()?;
    Some((*choices.get(usize::from(*first) % choices.len().max(1))?, rest))
}

fn direction(byte: u8) -> Option<Direction> {
    [None, Some(Direction::ToDrive), Some(Direction::ToHost)][usize::from(byte % 3)]
}

/// Cuts a stream into frames and explains each, in every direction, ended or not.
pub fn deframe(data: &[u8]) {
    let Some((dissector, bytes)) = choose(data, proto::dissectors()) else { return };
    for way in 0..6 {
        let (direction, ended) = (direction(way), way >= 3);
        let mut rest = bytes;
        while !rest.is_empty() {
            let context = Context { direction, ..Context::default() };
            dissector.explain(rest, &context, &mut Checked(rest.len()));
            rest = match dissector.find_frame(rest, direction, ended) {
                FrameBoundary::Frame(n) | FrameBoundary::Corrupt(n) | FrameBoundary::Skip(n) => {
                    assert!((1..=rest.len()).contains(&n), "{n} of {}", rest.len());
                    &rest[n..]
                }
                FrameBoundary::Incomplete => break,
            };
        }
    }
}

/// Explains a CAN frame by every protocol.
pub fn can(data: &[u8]) {
    let Some((head, bytes)) = data.split_at_checked(5) else { return };
    let extended = head[0] & 1 != 0;
    let mask = if extended { 0x1FFF_FFFF } else { 0x7FF };
    let id = u32::from_le_bytes([head[1], head[2], head[3], head[4]]) & mask;
    let bytes = &bytes[..bytes.len().min(8)];
    for dissector in proto::dissectors() {
        let context = Context {
            id: Some(id),
            extended,
            direction: direction(head[0] >> 1),
            ..Context::default()
        };
        dissector.explain(bytes, &context, &mut Checked(bytes.len()));
        let _ = dissector.claims_id(id, extended);
    }
}

/// Encodes a text; what comes of it is a frame that explains without an error.
pub fn text(data: &[u8]) {
    let Some((dissector, bytes)) = choose(data, proto::dissectors()) else { return };
    let Ok(said) = std::str::from_utf8(bytes) else { return };
    let mut out = [0; 600];
    if let Ok(encoded) = dissector.encode(said, &EncodeOptions::default(), &mut out) {
        assert!(encoded.len <= out.len());
    }
    let _ = dissector.code_meaning(said.len() as u32);
}

/// Everything serial that has a host, with a product that speaks it.
fn pairs() -> Vec<(HostProtocol, &'static Profile)> {
    let serial = host::protocols().into_iter().filter(|p| p.medium == MediumKind::Serial);
    let with = |spoken: HostProtocol| {
        let product = polepair_drives::profiles().iter().find(|p| p.protocol == spoken.profile);
        product.map(|profile| (spoken, *profile))
    };
    serial.filter_map(with).collect()
}

/// Lets a node speak and time pass, at most for this time.
fn run(
    node: &mut dyn SimNode,
    now: &mut Instant,
    end: Instant,
    mut done: impl FnMut(&mut dyn SimNode) -> bool,
) {
    let mut buffer = [0; STREAM_UNIT_MAX];
    for step in 0.. {
        assert!(step < STEPS_MAX, "goes on without end");
        while node.stream(0).and_then(|s| s.poll_transmit(*now, &mut buffer)).is_some() {}
        if done(node) || *now >= end {
            return;
        }
        let due = node.poll_timeout().unwrap_or(end).max(now.plus_ns(1_000));
        *now = due.min(end);
        node.handle_timeout(*now);
    }
}

/// A host that has asked something hears the input; its request ends.
pub fn host_input(data: &[u8]) {
    let Some(((spoken, profile), bytes)) = choose(data, &pairs()) else { return };
    let options = HostOptions::new(0);
    let axes = [(profile, spoken.first_address)];
    let Some(mut node) = host::host_lane(spoken.name, spoken.medium, options, &axes) else {
        return;
    };
    let mut now = Instant::ZERO;
    let readable = profile.parameters.iter().position(|p| p.access != Access::Write);
    let id = ParameterId(readable.unwrap_or(0) as u16);
    let lane = node.axes().expect("a lane");
    lane.read_parameter(now, Ticket(1), AXIS, id).expect("a readable parameter");
    let soon = now.plus_ms(1);
    run(&mut *node, &mut now, soon, |_| false);
    for piece in bytes.chunks(1 + bytes.len() % 7) {
        node.stream(0).expect("a serial station").handle_input(now, piece);
    }
    let (end, mut ended) = (now.plus_ms(60_000), false);
    run(&mut *node, &mut now, end, |node| {
        ended |= node.axes().is_some_and(|axes| axes.poll_outcome().is_some());
        ended
    });
    assert!(ended, "a read never ends");
}

/// A drive hears the input.
pub fn device_input(data: &[u8]) {
    let Some(((spoken, profile), bytes)) = choose(data, &pairs()) else { return };
    let mut spec = RackDrive::new(profile, spoken.name);
    spec.address = Some(spoken.first_address);
    let Some(mut node) = spec.device(false).ok() else { return };
    let mut now = Instant::ZERO;
    for piece in bytes.chunks(1 + bytes.len() % 7) {
        node.stream(0).expect("a serial station").handle_input(now, piece);
        let soon = now.plus_ms(1);
        run(&mut *node, &mut now, soon, |_| false);
    }
    let end = now.plus_ms(50);
    run(&mut *node, &mut now, end, |_| false);
}

/// Reads a capture, in pieces, judged and not.
pub fn capture(data: &[u8]) {
    let mut judge = ProtocolDetector::new();
    judge.feed(data);
    let (_, judged) = judge.decide();
    for mut decoder in [judged, CaptureDecoder::new(Rules::default())] {
        let mut bytes = 0;
        let mut count = |event: &DecodedFrame<'_>| bytes += event.bytes.len();
        for piece in data.chunks(1 + data.len() % 31) {
            decoder.feed(piece, &mut count);
        }
        decoder.finish(&mut count);
        let packed = data.starts_with(&[0x1F, 0x8B]) || data.get(2..4) == Some(&[0x2F, 0xFD]);
        // Frames of Modbus ASCII that are written as characters get their end of line.
        let ends = 2 * data.iter().filter(|byte| **byte == b':').count();
        assert!(packed || bytes <= data.len() + ends, "more came out than went in");
        assert!(decoder.statistics().damage.len() as u64 <= decoder.statistics().damaged);
    }
}

/// Reads a connection string; what it prints it reads again.
pub fn url(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Ok(url) = text.parse::<polepair::url::Url>() else { return };
    assert_eq!(url.to_string().parse(), Ok(url));
}

/// Reads a profile. One that is good is kept for good, up to a number of them.
pub fn profile(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Err(error) = polepair::profile::parse("fuzz.toml", text) {
        assert!(!error.to_string().is_empty());
    }
}

/// Reads a set-up archive.
pub fn setup(data: &[u8]) {
    let name = format!("polepair-fuzz-{}.t.zip", std::process::id());
    let path = std::env::temp_dir().join(name);
    std::fs::write(&path, data).expect("a temporary file");
    let read = polepair::load_profile(&path);
    std::fs::remove_file(&path).expect("a temporary file");
    if let Err(error) = read {
        assert!(!error.to_string().is_empty());
    }
}

/// A host with its requests in [`session`], which are kept until they end.
struct Spoke {
    node: Box<dyn SimNode>,
    profile: &'static Profile,
    now: Instant,
    open: Vec<Ticket>,
    /// Bytes that the host sent last.
    said: Vec<u8>,
}

/// Requests in one session at most.
const REQUESTS_MAX: u32 = 64;
/// When every request has ended, the last plan's longest step included, ms.
const ENDED_MS: u32 = 3_600_000;

impl Spoke {
    /// Sends what there is to send, and hears what ended.
    fn pump(&mut self) {
        let (mut bytes, mut frame) = ([0; STREAM_UNIT_MAX], Frame::default());
        for step in 0.. {
            assert!(step < STEPS_MAX, "sends without end");
            if let Some(station) = self.node.stream(0) {
                let Some(len) = station.poll_transmit(self.now, &mut bytes) else { break };
                self.said = bytes[..len].to_vec();
            } else {
                let Some(station) = self.node.can(0) else { return };
                if station.poll_transmit(self.now, &mut frame).is_none() {
                    break;
                }
                self.said = [&frame.id.to_be_bytes()[2..], frame.bytes()].concat();
            }
        }
        let axes = self.node.axes().expect("a lane");
        while let Some((ticket, _)) = axes.poll_outcome() {
            let at = self.open.iter().position(|open| *open == ticket);
            self.open.swap_remove(at.expect("an end without a request, or a second one"));
        }
    }

    /// Lets time pass.
    fn pass(&mut self, end: Instant, mut is_over: impl FnMut(&Self) -> bool) {
        for step in 0.. {
            assert!(step < STEPS_MAX, "goes on without end");
            self.pump();
            if self.now >= end || is_over(self) {
                return;
            }
            let due = self.node.poll_timeout().unwrap_or(end).max(self.now.plus_ns(1_000));
            self.now = due.min(end);
            self.node.handle_timeout(self.now);
        }
    }

    /// Bytes of a line; on a bus an identifier's two bytes and the data of a frame.
    fn hear(&mut self, bytes: &[u8]) {
        if let Some(station) = self.node.stream(0) {
            return station.handle_input(self.now, bytes);
        }
        let Some((&[high, low], data)) = bytes.split_first_chunk() else { return };
        let frame = Frame::standard(u16::from_be_bytes([high, low]), data);
        if let Some(station) = self.node.can(0) {
            station.handle_input(self.now, &frame);
        }
    }

    fn line(&mut self, event: LineEvent) {
        if let Some(station) = self.node.stream(0) {
            station.handle_line(self.now, event);
        } else if let Some(station) = self.node.can(0) {
            station.handle_line(self.now, event);
        }
    }

    /// One request, as two bytes choose it.
    fn ask(&mut self, number: u32, what: u8, which: u8) {
        let ticket = Ticket(number);
        let (now, count) = (self.now, self.profile.parameters.len().max(1));
        let id = ParameterId((usize::from(which) % count) as u16);
        let verb = Verb::ALL[usize::from(which) % Verb::ALL.len()];
        let value = Some(f64::from(which as i8));
        let command =
            Command { target: value, velocity: value, torque: value, ..Command::new(verb) };
        let axes = self.node.axes().expect("a lane");
        let taken = match what {
            0 => axes.read_parameter(now, ticket, AXIS, id),
            1 => axes.write_parameter(now, ticket, AXIS, id, i64::from(which), false),
            _ => axes.command(now, ticket, AXIS, command),
        };
        if taken.is_ok() {
            self.open.push(ticket);
        }
    }
}

/// A whole session: requests, bytes, time, and a wire that goes away and comes back, in any order. Every
/// request that was taken ends once, and nothing else ends.
pub fn session(data: &[u8]) {
    let with = |spoken: HostProtocol| {
        let product = polepair_drives::profiles().iter().find(|p| p.protocol == spoken.profile);
        product.map(|profile| (spoken, *profile))
    };
    let hosts: Vec<_> = host::protocols().into_iter().filter_map(with).collect();
    let Some(((spoken, profile), rest)) = choose(data, &hosts) else { return };
    let Some((timed, rest)) = choose(rest, &[0, spoken.baud]) else { return };
    let axes = [(profile, spoken.first_address)];
    let node = host::host_lane(spoken.name, spoken.medium, HostOptions::new(timed), &axes);
    let Some(node) = node else { return };
    let (now, open, said) = (Instant::ZERO, Vec::new(), Vec::new());
    let mut spoke = Spoke { node, profile, now, open, said };
    let (mut rest, mut requests) = (rest.iter().copied(), 0);
    while let (Some(what), Some(which)) = (rest.next(), rest.next()) {
        match what % 8 {
            0..=2 if requests < REQUESTS_MAX => {
                requests += 1;
                spoke.ask(requests, what % 8, which);
            }
            3 => spoke.node.axes().expect("a lane").set_armed(AXIS, which % 2 == 1),
            5 if which == 0 => {
                let again = spoke.said.clone();
                spoke.hear(&again);
            }
            4 | 5 => {
                let bytes: Vec<u8> = rest.by_ref().take(usize::from(which)).collect();
                spoke.hear(&bytes);
            }
            6 => {
                let end = spoke.now.plus_ns(1 << (which % 34));
                spoke.pass(end, |_| false);
            }
            7 => spoke.line(
                [LineEvent::Down, LineEvent::Up, LineEvent::Break, LineEvent::BusOff]
                    [usize::from(which % 4)],
            ),
            _ => {}
        }
        spoke.pump();
    }
    spoke.line(LineEvent::Up);
    let end = spoke.now.plus_ms(ENDED_MS);
    spoke.pass(end, |spoke| spoke.open.is_empty());
    assert!(spoke.open.is_empty(), "{} of {:?} never end", spoke.open.len(), spoken.name);
}

/// Waits until it was answered.
fn heard<T>(bench: &Bench, mut reply: PendingReply<T>) -> Result<T, GatewayError> {
    for _ in 0..3_000 {
        if let Some(answer) = reply.try_recv() {
            return answer;
        }
        bench.advance_time(Duration::from_millis(10));
    }
    panic!("no answer within thirty seconds");
}

/// Lines are what a client says on its WebSocket: what can be read is done to a bench of two simulated
/// drives. All of it is answered, and at the end a stop of everything leaves both motors standing.
pub fn gateway(data: &[u8]) {
    let lines = data.split(|byte| *byte == b'\n').take(32);
    let said: Vec<ClientMessage> =
        lines.filter_map(|line| serde_json::from_slice(line).ok()).collect();
    if said.is_empty() {
        return;
    }
    for message in &said {
        let text = serde_json::to_string(message).expect("it can be said again");
        serde_json::from_str::<ClientMessage>(&text).expect("and is read again");
    }
    let urls = ["sim:tmcl?axes=2&time=virtual".to_owned()];
    let bench = Bench::open(&urls, bench::BenchOptions::default()).expect("a bench");
    let session = "fuzz".into();
    let (mut channels, mut watched) = (Vec::new(), None);
    for message in said {
        match message {
            ClientMessage::Lease { axis, act, epoch } => {
                let _ = heard(&bench, bench.request_lease(axis, &session, act, epoch));
            }
            ClientMessage::Command { axis, mut command } => {
                command.issued_ms += bench.now_ms();
                let id = command.id.clone();
                let told = heard(&bench, bench.command(axis, &session, command));
                assert!(
                    told.is_ok_and(|outcome| outcome.id == id),
                    "a command always has an outcome"
                );
            }
            ClientMessage::Stop(request) => {
                let _ = heard(&bench, bench.stop(&session, &request));
            }
            ClientMessage::Dismiss { axis, dismiss } => {
                let _ = heard(&bench, bench.dismiss(axis, &session, dismiss));
            }
            ClientMessage::Release => {
                let _ = heard(&bench, bench.release(&session, bench.lock_count()));
            }
            ClientMessage::Subscribe { axis, signal, parameter, hz, .. } => {
                channels.extend(bench.subscribe(axis, signal.as_deref(), parameter.as_deref(), hz));
            }
            ClientMessage::Frames { filter, .. } => {
                watched = bench.subscribe_frames(filter.as_deref()).ok()
            }
            ClientMessage::Explain { n } => drop(bench.explain_frame(n)),
            ClientMessage::Unsubscribe { .. } | ClientMessage::Ping { .. } => {}
        }
        bench.advance_time(Duration::from_millis(20));
        for channel in &mut channels {
            channel.drain_into(&mut Vec::new());
        }
        watched.iter_mut().for_each(|frames| drop(frames.drain(100)));
    }
    let everything = StopRequest::default();
    heard(&bench, bench.stop(&session, &everything)).expect("it is stopped");
    for axis in 0..2 {
        let truth = bench.truth(axis).expect("a motor");
        assert!(truth.velocity.abs() < 0.5, "axis {axis} turns after a stop: {truth:?}");
    }
    bench.shutdown();
}
