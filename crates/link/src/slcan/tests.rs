use std::collections::VecDeque;
use std::sync::Arc;
use std::thread;

use polepair_core::medium::{CanLine, Frame, Medium, Stream};
use polepair_core::station::LineEvent;

use super::codec::{
    AdapterReply, ErrorState, LINE_MAX, LineEnd, LineSplitter, StatusFlags, parse_bit_rate,
    parse_frame,
};
use super::server::SlcanSession;
use super::*;
use crate::clock;
use crate::hex::TextWriter;
use crate::hub::{Hub, HubSession, SessionAction, SessionOutput};
use crate::pty::Pty;

const LINE: CanLine = CanLine { bit_rate: 500_000 };

fn extended(id: u32, data: &[u8]) -> Frame {
    Frame { id, extended: true, ..Frame::standard(0, data) }
}

fn write_line(frame: &Frame, stamp: Option<u16>) -> String {
    let mut out = [0; LINE_MAX];
    let len = codec::write_frame(frame, stamp, &mut out);
    String::from_utf8(out[..len].to_vec()).unwrap()
}

/// Lawicel CAN232 manual, commands t, T, r, R, and the traffic of the kernel's slcan driver.
#[test]
fn frames_are_written_and_read_as_the_manual_prints_them() {
    let full = [1, 2, 3, 4, 5, 6, 7, 0x88];
    let remote = |id, extended, len| Frame { id, extended, remote: true, len, data: [0; 8] };
    let cases = [
        (Frame::standard(0x100, &[0x11, 0x33]), None, "t10021133\r"),
        (Frame::standard(0x7FF, &[]), None, "t7FF0\r"),
        (extended(0x1F33_4455, &full), None, "T1F33445580102030405060788\r"),
        (extended(1, &full), Some(59_999), "T0000000180102030405060788EA5F\r"),
        (remote(0x123, false, 2), None, "r1232\r"),
        (remote(0x1ABC, true, 8), Some(7), "R00001ABC80007\r"),
    ];
    for (frame, stamp, text) in cases {
        assert_eq!(write_line(&frame, stamp), text);
        assert_eq!(parse_frame(&text.as_bytes()[..text.len() - 1]), Some((frame, stamp)));
    }
    let wrong = ["", "t", "t8000", "t1239", "t12311", "t1231223", "T200000000", "r123211", "x1230"];
    for wrong in wrong {
        assert_eq!(parse_frame(wrong.as_bytes()), None, "{wrong}");
    }
}

#[test]
fn bit_rates_are_the_manuals_or_exact_registers() {
    let command = |rate| {
        let mut out = [0; LINE_MAX];
        let len = codec::write_bit_rate(rate, &mut out)?;
        Some(String::from_utf8(out[..len - 1].to_vec()).unwrap())
    };
    assert_eq!(command(10_000).as_deref(), Some("S0"));
    assert_eq!(command(500_000).as_deref(), Some("S6"));
    assert_eq!(command(1_000_000).as_deref(), Some("S8"));
    assert_eq!(command(333_333), None);
    assert_eq!(command(0), None);
    for rate in [5_000, 40_000, 80_000, 160_000, 200_000, 400_000] {
        let command = command(rate).unwrap();
        assert!(command.starts_with('s'), "{command}");
        assert_eq!(parse_bit_rate(command.as_bytes()), Some(rate), "{command}");
    }
    // CAN232 manual, command s.
    assert_eq!(parse_bit_rate(b"s031C"), Some(125_000));
    assert_eq!(parse_bit_rate(b"S9"), None);
    assert_eq!(parse_bit_rate(b"sw100005"), None);
}

#[test]
fn states_are_read_in_the_kernels_dialect() {
    for (text, answer) in [
        ("sa000000", AdapterReply::State(ErrorState::Active)),
        ("sw100005", AdapterReply::State(ErrorState::Warning)),
        ("sp130020", AdapterReply::State(ErrorState::Passive)),
        ("sb255255", AdapterReply::State(ErrorState::BusOff)),
        ("sw10005", AdapterReply::Unknown),
        ("e1a", AdapterReply::BusError),
        ("e2as", AdapterReply::BusError),
        ("e2a", AdapterReply::Unknown),
        ("F04", AdapterReply::Flags(StatusFlags(4))),
        ("F4", AdapterReply::Unknown),
        ("F0G", AdapterReply::Unknown),
        ("V1013", AdapterReply::Info),
        ("Z", AdapterReply::Done),
        ("hello", AdapterReply::Unknown),
    ] {
        assert_eq!(AdapterReply::parse(text.as_bytes()), answer, "{text}");
    }
}

fn frames_in(bytes: &[u8]) -> (Vec<u32>, u32) {
    let (mut lines, mut ids, mut spoilt) = (LineSplitter::default(), Vec::new(), 0);
    for &byte in bytes {
        match lines.push(byte) {
            Some(LineEnd::Line) => match AdapterReply::parse(lines.line()) {
                AdapterReply::Frame(frame) => ids.push(frame.id),
                AdapterReply::Unknown => spoilt += 1,
                _ => {}
            },
            Some(LineEnd::Malformed) => spoilt += 1,
            Some(LineEnd::Bell) | None => {}
        }
    }
    (ids, spoilt)
}

#[test]
fn junk_costs_the_line_that_contains_it() {
    assert_eq!(frames_in(b"t1110\rt\xFF220\rt3330\r"), (vec![0x111, 0x333], 1));
    assert_eq!(frames_in(b"t1110t2220\r"), (vec![0x222], 1));
    assert_eq!(frames_in(b"\xFEt0000\r\nt1110\r\n"), (vec![0x111], 1));
    let long = [vec![b'x'; 5000], b"\rt1110\r".to_vec()].concat();
    assert_eq!(frames_in(&long), (vec![0x111], 1));
    assert_eq!(frames_in(b"t11\x07t2220\r"), (vec![0x222], 0));
}

/// An adapter on a pseudo-terminal: replies to every command, and records the commands.
fn scripted_adapter() -> (String, thread::JoinHandle<Vec<u8>>) {
    let pty = Pty::open(None).unwrap();
    let path = pty.path().to_owned();
    let thread = thread::spawn(move || {
        let (mut output, mut from) = (Vec::new(), 0);
        let mut buffer = Stream::buffer();
        let end = clock::now().plus_ms(5000);
        while clock::now() < end && !output.ends_with(b"O\rt1231AB\rF\rC\r") {
            let received = pty.receive(&mut buffer, clock::now().plus_ms(100)).unwrap();
            let Received::Bytes { len, .. } = received else { continue };
            output.extend_from_slice(&buffer[..len]);
            while let Some(at) = output[from..].iter().position(|&byte| byte == b'\r') {
                let line = &output[from..from + at];
                pty.send(b"\r").unwrap();
                if line == b"O" {
                    pty.send(b"sb255255\rt7FF211\rT1ABCDEF0255AA12\x07").unwrap();
                    pty.send(b"34\rT1ABCDEF0255AA1234\re1a\rsa000000\r").unwrap();
                }
                from += at + 1;
            }
        }
        output
    });
    (path, thread)
}

#[test]
fn an_adapter_is_set_up_used_and_closed() {
    let (path, adapter) = scripted_adapter();
    let link = open_serial(&path, 0, LINE).unwrap();
    let mut frame = Frame::default();
    let mut next = || link.receive(&mut frame, clock::now().plus_ms(2000)).unwrap();
    assert!(matches!(next(), Received::Line { event: LineEvent::BusOff, .. }));
    assert!(matches!(next(), Received::Bytes { len: 1, .. }));
    assert!(matches!(next(), Received::Line { event: LineEvent::Up, .. }));
    assert_eq!(frame, extended(0x1ABC_DEF0, &[0x55, 0xAA]));
    let losses = Losses { malformed: 2, errors: 1, refused: 1, ..Losses::default() };
    assert_eq!(link.losses(), losses);
    link.send(&Frame::standard(0x123, &[0xAB])).unwrap();
    drop(link);
    let received = adapter.join().unwrap();
    assert_eq!(String::from_utf8(received).unwrap(), "\rC\rS6\rO\rt1231AB\rF\rC\r");
}

/// A scripted adapter in time of its own: no machine is too slow for it.
struct AdapterScript {
    /// The reply to a line, and the time until it comes.
    reply: fn(&[u8]) -> &'static [u8],
    delay_ms: u32,
    state: Mutex<ScriptState>,
}

#[derive(Default)]
struct ScriptState {
    now: Instant,
    sent: Vec<u8>,
    replies: VecDeque<(Instant, &'static [u8])>,
}

impl AdapterScript {
    fn new(delay_ms: u32, reply: fn(&[u8]) -> &'static [u8]) -> Arc<Self> {
        Arc::new(Self { reply, delay_ms, state: Mutex::default() })
    }

    fn sent(&self) -> Vec<u8> {
        self.state.lock().unwrap().sent.clone()
    }
}

struct AdapterEnd(Arc<AdapterScript>);

impl LinkIo<Stream> for AdapterEnd {
    fn now(&self) -> Instant {
        self.0.state.lock().unwrap().now
    }
    fn send(&self, unit: &[u8]) -> Result<(), LinkError> {
        let mut state = self.0.state.lock().unwrap();
        state.sent.extend_from_slice(unit);
        for line in unit.split_inclusive(|&byte| byte == b'\r') {
            let last = state.replies.back().map_or(state.now, |(at, _)| *at);
            let reply = (self.0.reply)(line.trim_ascii_end());
            state.replies.push_back((last.plus_ms(self.0.delay_ms), reply));
        }
        Ok(())
    }
    fn receive(&self, buffer: &mut [u8], until: Instant) -> Result<Received, LinkError> {
        let mut state = self.0.state.lock().unwrap();
        match state.replies.front().copied().filter(|(at, _)| *at <= until) {
            Some((at, reply)) => {
                state.replies.pop_front();
                state.now = state.now.max(at);
                buffer[..reply.len()].copy_from_slice(reply);
                Ok(Received::Bytes { len: reply.len(), at })
            }
            None => {
                state.now = state.now.max(until);
                Ok(Received::TimedOut)
            }
        }
    }
    fn set_line(&self, _line: SerialLine) -> Result<(), LinkError> {
        Ok(())
    }
    fn waker(&self) -> LinkWaker {
        LinkWaker::new().expect("a waker")
    }
    fn is_real_time(&self) -> bool {
        false
    }
    fn describe(&self) -> String {
        "script".to_owned()
    }
}

/// An adapter that was closed just before: its reply to that comes now, and it refuses to close once more.
#[test]
fn late_replies_to_an_earlier_program_belong_to_no_request() {
    let adapter = AdapterScript::new(2, |line| match line {
        b"" => b"\r\r",
        b"C" => b"\x07",
        _ => b"\r",
    });
    drop(SlcanLink::open(Box::new(AdapterEnd(Arc::clone(&adapter))), LINE).unwrap());
    assert_eq!(adapter.sent(), b"\rC\rS6\rO\rC\r");
}

/// Each reply comes in the time of the next command: the adapter is set up once more, with a longer silence before.
#[test]
fn a_slow_adapter_gets_a_second_attempt() {
    let adapter = AdapterScript::new(100, |line| if line == b"C" { b"\x07" } else { b"\r" });
    drop(SlcanLink::open(Box::new(AdapterEnd(Arc::clone(&adapter))), LINE).unwrap());
    assert_eq!(adapter.sent(), b"\rC\rS6\r\rC\rS6\rO\rC\r");
}

#[test]
fn an_adapter_that_refuses_the_bit_rate_is_no_link() {
    let adapter = AdapterScript::new(2, |line| if line == b"S6" { b"\x07" } else { b"\r" });
    let open = |line| SlcanLink::open(Box::new(AdapterEnd(Arc::clone(&adapter))), line);
    let error = open(LINE).unwrap_err();
    assert_eq!(error.cause(), Cause::Unsuitable);
    assert!(error.hint().contains("500000"), "{}", error.hint());
    let error = open(CanLine { bit_rate: 333_333 }).unwrap_err();
    assert!(error.hint().contains("8 MHz"), "{}", error.hint());
}

#[test]
fn a_silent_adapter_is_opened_all_the_same() {
    let pty = Arc::new(Pty::open(None).unwrap());
    let link = open_serial(pty.path(), 0, LINE).unwrap();
    pty.send(b"t1110\r").unwrap();
    let mut frame = Frame::default();
    let received = link.receive(&mut frame, clock::now().plus_ms(2000)).unwrap();
    assert!(matches!(received, Received::Bytes { .. }), "{received:?}");
    assert_eq!(frame.id, 0x111);
}

/// Two programs on adapters of one bus, and the device on it.
#[test]
fn clients_of_a_bus_hear_each_other_and_the_drives() {
    let bus = listen("0", LINE).unwrap();
    let address = bus.address().unwrap().to_string();
    thread::scope(|scope| {
        let drives = scope.spawn(|| {
            let mut messages = Vec::new();
            let mut frame = Frame::default();
            while messages.len() < 2 {
                match bus.receive(&mut frame, clock::now().plus_ms(3000)).unwrap() {
                    Received::Bytes { .. } => messages.push(frame),
                    other => panic!("{other:?}"),
                }
                bus.send(&Frame::standard(frame.id as u16 + 1, b"drive")).unwrap();
            }
            // Until both clients have left.
            let _ = bus.receive(&mut frame, clock::now().plus_ms(200));
            messages
        });
        let (one, other) = (open_tcp(&address, LINE).unwrap(), open_tcp(&address, LINE).unwrap());
        let next = |link: &SlcanLink| {
            let mut frame = Frame::default();
            let received = link.receive(&mut frame, clock::now().plus_ms(2000)).unwrap();
            assert!(matches!(received, Received::Bytes { .. }), "{received:?}");
            frame
        };
        let (first, second) = (Frame::standard(0x100, b"one"), extended(0x200, b"other"));
        let answer = |id| Frame::standard(id, b"drive");
        one.send(&first).unwrap();
        assert_eq!((next(&one), next(&other), next(&other)), (answer(0x101), first, answer(0x101)));
        other.send(&second).unwrap();
        assert_eq!((next(&other), next(&one), next(&one)), (answer(0x201), second, answer(0x201)));
        drop((one, other));
        assert_eq!(drives.join().unwrap(), [first, second]);
    });
}

fn send_text(adapter: &mut SlcanSession, text: &str) -> (String, Vec<SessionAction>) {
    let (mut bytes, mut came) = (Vec::new(), Vec::new());
    for &byte in text.as_bytes() {
        let mut buffer = [0; crate::hub::OUTPUT_MAX];
        let mut answer = SessionOutput(TextWriter::new(&mut buffer));
        let action = adapter.handle_byte(byte, &mut answer);
        let len = answer.0.len;
        bytes.extend_from_slice(&buffer[..len]);
        came.extend((action != SessionAction::Nothing).then_some(action));
    }
    (String::from_utf8(bytes).unwrap(), came)
}

/// CAN232 manual, "available commands".
#[test]
fn an_adapter_answers_as_the_manual_says() {
    let mut adapter = SlcanSession::new(LINE);
    let cases = [
        ("\r", "\r"),
        ("t1230\r", "\x07"),
        ("C\r", "\x07"),
        ("S9\r", "\x07"),
        ("S6\r", "\r"),
        ("Z1\r", "\r"),
        ("O\r", "\r"),
        ("O\r", "\x07"),
        ("S6\r", "\x07"),
        ("t1230\r", "z\r"),
        ("T000001230\r", "Z\r"),
        ("t123\r", "\x07"),
        ("V\r", "V1013\r"),
        ("N\r", "NPLPR\r"),
        ("F\r", "F00\r"),
        ("C\r", "\r"),
        ("s031C\r", "\r"),
        ("L\r", "\r"),
        ("F\r", "FA4\r"),
        ("t1230\r", "\x07"),
        ("W2\r", "\x07"),
    ];
    for (command, answer) in cases {
        assert_eq!(send_text(&mut adapter, command).0, answer, "{command:?}");
    }
}

#[test]
fn an_adapter_of_another_bit_rate_neither_receives_nor_is_received() {
    let mut adapter = SlcanSession::new(LINE);
    let shown = |adapter: &SlcanSession| {
        let mut buffer = [0; crate::hub::OUTPUT_MAX];
        let mut saying = SessionOutput(TextWriter::new(&mut buffer));
        adapter.clone().write_frame(
            &Frame::standard(0x123, &[]),
            Instant(61_234_000_000),
            &mut saying,
        );
        let len = saying.0.len;
        String::from_utf8(buffer[..len].to_vec()).unwrap()
    };
    assert_eq!(shown(&adapter), "", "closed");
    send_text(&mut adapter, "S6\rZ1\rO\r");
    assert_eq!(shown(&adapter), "t123004D2\r");
    send_text(&mut adapter, "C\rS5\rO\r");
    assert_eq!(shown(&adapter), "", "out of tune");
    assert_eq!(send_text(&mut adapter, "t1230\r").1, [SessionAction::Refused]);
}

/// A client with the wrong bit rate sees errors in its adapter's flags.
#[test]
fn an_adapter_of_another_bit_rate_tells_of_errors() {
    let bus = listen("0", LINE).unwrap();
    let address = bus.address().unwrap().to_string();
    thread::scope(|scope| {
        let helper = scope.spawn(|| {
            let losses = [250_000, 500_000].map(|bit_rate| {
                let link = open_tcp(&address, CanLine { bit_rate }).unwrap();
                link.send(&Frame::standard(0x123, &[])).unwrap();
                let end = clock::now().plus_ms(5_000);
                while link.flags_pending.load(Ordering::Relaxed) > 0 && clock::now() < end {
                    let _ = link.receive(&mut Frame::default(), clock::now().plus_ms(5)).unwrap();
                }
                link.losses()
            });
            assert_eq!(losses[0], Losses { errors: 1, ..Losses::default() });
            assert_eq!(losses[1], Losses::default());
        });
        while !helper.is_finished() {
            let _ = bus.receive(&mut Frame::default(), clock::now().plus_ms(5)).unwrap();
        }
        helper.join().unwrap();
    });
}

/// The adapter goes and comes back under the same name, as serial ports do.
#[test]
fn an_unplugged_adapter_is_reported_and_opened_again() {
    let alias = std::env::temp_dir().join(format!("polepair-slcan-{}", std::process::id()));
    let adapter = || serve_pty(Pty::open(Some(&alias)).unwrap(), LINE).unwrap();
    let serve = |adapter: &Hub<SlcanSession>, ms| {
        let mut frame = Frame::default();
        let received = adapter.receive(&mut frame, clock::now().plus_ms(ms)).unwrap();
        matches!(received, Received::Bytes { .. }).then_some(frame)
    };
    thread::scope(|scope| {
        let bus = adapter();
        let opened = scope.spawn(|| open_serial(alias.to_str().unwrap(), 0, LINE).unwrap());
        while !opened.is_finished() {
            serve(&bus, 5);
        }
        let link = opened.join().unwrap();
        let lost = scope.spawn(move || {
            let ended = link.receive(&mut Frame::default(), Instant::FAR_FUTURE);
            (ended, link)
        });
        drop(bus);
        let (ended, link) = lost.join().unwrap();
        assert!(ended.unwrap_err().is_gone());
        assert!(link.send(&Frame::standard(1, &[])).unwrap_err().is_gone());
        assert!(link.reopen().is_err(), "nothing is there");

        let bus = adapter();
        let again = scope.spawn(move || link.reopen().unwrap());
        while !again.is_finished() {
            serve(&bus, 5);
        }
        let again = again.join().unwrap();
        again.send(&Frame::standard(0x7, &[7])).unwrap();
        assert_eq!(serve(&bus, 2000), Some(Frame::standard(0x7, &[7])));
    });
}

/// A client that does not read does not block others; its losses are counted.
#[test]
fn a_client_that_does_not_read_loses_frames_and_no_other_does() {
    let bus = listen("0", LINE).unwrap();
    let address = bus.address().unwrap().to_string();
    let on_event = |ms| bus.receive(&mut Frame::default(), clock::now().plus_ms(ms)).unwrap();
    thread::scope(|scope| {
        let open = || {
            let opened = scope.spawn(|| open_tcp(&address, LINE).unwrap());
            while !opened.is_finished() {
                on_event(2);
            }
            opened.join().unwrap()
        };
        let (deaf, awake) = (open(), open());
        let frame = Frame { extended: true, ..Frame::standard(0x123, &[0; 8]) };
        let mut received = Frame::default();
        let began = clock::now();
        while bus.losses().overrun == 0 {
            bus.send(&frame).unwrap();
            awake.receive(&mut received, clock::now().plus_ms(1000)).unwrap();
            assert_eq!(received, frame);
            assert!(clock::now().since(began).as_secs() < 20);
        }
        drop(deaf);
    });
}

/// Anything may come from either end; it is refused, never worse, and a good line after it works.
#[test]
fn garbage_does_no_harm() {
    let mut seed = 0x9E37_79B9_7F4A_7C15_u64;
    let mut random = || {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        seed
    };
    let alphabet = b"tTrRSsOLCZVNFse0123456789abcdefABCDEF\r\x07\n\xFF\0 ";
    for _ in 0..2_000 {
        let mut adapter = SlcanSession::new(LINE);
        send_text(&mut adapter, "S6\rO\r");
        let mut lines = LineSplitter::default();
        for _ in 0..random() % 200 {
            let byte = alphabet[random() as usize % alphabet.len()];
            let mut buffer = [0; crate::hub::OUTPUT_MAX];
            let mut answer = SessionOutput(TextWriter::new(&mut buffer));
            if let SessionAction::Frame(frame) = adapter.handle_byte(byte, &mut answer) {
                assert!(frame.len <= 8 && frame.id <= 0x1FFF_FFFF);
            }
            if lines.push(byte) == Some(LineEnd::Line) {
                let _ = AdapterReply::parse(lines.line());
            }
        }
        send_text(&mut adapter, "\rC\rS6\rO\r");
        let frame = Frame::standard(0x123, &[0xAB]);
        assert_eq!(send_text(&mut adapter, "t1231AB\r").1, [SessionAction::Frame(frame)]);
    }
}
