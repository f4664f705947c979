use std::thread;

use polepair_core::medium::Frame;

use super::codec::{ClientRequest, ELEMENT_MAX, ElementEnd, ElementSplitter, ServerReply};
use super::*;
use crate::clock;

fn extended(id: u32, data: &[u8]) -> Frame {
    Frame { id, extended: true, ..Frame::standard(0, data) }
}

fn text(write: impl Fn(&mut TextWriter<'_>)) -> String {
    let mut buffer = [0; ELEMENT_MAX];
    let mut text = TextWriter::new(&mut buffer);
    write(&mut text);
    let len = text.len;
    String::from_utf8(buffer[..len].to_vec()).unwrap()
}

fn split_elements(bytes: &[u8]) -> Vec<Option<String>> {
    let mut elements = ElementSplitter::default();
    let mut ends = Vec::new();
    for &byte in bytes {
        match elements.push(byte) {
            Some(ElementEnd::Element) => {
                ends.push(Some(String::from_utf8(elements.text().to_vec()).unwrap()));
            }
            Some(ElementEnd::Malformed) => ends.push(None),
            None => {}
        }
    }
    ends
}

/// The examples of the project's `doc/protocol.md`.
#[test]
fn frames_are_written_and_read_as_the_protocol_prints_them() {
    let sent = [
        (Frame::standard(0x123, &[]), "< send 123 0 >"),
        (extended(0x1AAA_AAAA, &[0x01, 0xF1]), "< send 1AAAAAAA 2 1 F1 >"),
    ];
    for (frame, element) in sent {
        assert_eq!(text(|to| assert!(codec::write_send(&frame, to))), element);
        let inside = &element.as_bytes()[1..element.len() - 1];
        assert_eq!(ClientRequest::parse(inside), ClientRequest::Send(frame));
        assert_eq!(ClientRequest::parse(&inside.to_ascii_lowercase()), ClientRequest::Send(frame));
    }
    let frame = Frame::standard(0x123, &[0x1A, 0x22, 0x03, 0x44]);
    let output = "< frame 123 23.424242 1A220344 >";
    assert_eq!(text(|to| codec::write_frame(&frame, 23_424_242, to)), output);
    assert_eq!(ServerReply::parse(b" frame 123 23.424242 1A220344 "), ServerReply::Frame(frame));
    assert_eq!(ServerReply::parse(b" frame 123 23.424242 1A 22 03 44 "), ServerReply::Frame(frame));
    let empty = Frame::standard(0x7FF, &[]);
    assert_eq!(text(|to| codec::write_frame(&empty, 7, to)), "< frame 7FF 0.000007  >");
    assert_eq!(ServerReply::parse(b" frame 7FF 0.000007  "), ServerReply::Frame(empty));
    let remote = Frame { remote: true, ..empty };
    assert!(text(|to| codec::write_frame(&remote, 7, to)).is_empty());
    assert!(text(|to| assert!(!codec::write_send(&remote, to))).is_empty());
}

#[test]
fn a_line_that_is_no_frame_is_refused() {
    let requests = ["send 123 9 1 2 3 4 5 6 7 8 9", "send 123 1", "send 800 0", "send 20000000 0"];
    for wrong in requests.into_iter().chain(["send 123 1 100", "send xyz 0", "open", "", "send"]) {
        assert_eq!(ClientRequest::parse(wrong.as_bytes()), ClientRequest::Unknown, "{wrong}");
    }
    for wrong in ["frame 123 1.0 123", "frame 123 1.0 112233445566778899", "frame 123", "oops"] {
        assert_eq!(ServerReply::parse(wrong.as_bytes()), ServerReply::Unknown, "{wrong}");
    }
    assert_eq!(ServerReply::parse(b" error 040 1.5 "), ServerReply::ErrorFrame(0x40));
    assert_eq!(
        ServerReply::parse(b" error could not open bus "),
        ServerReply::Error(b" could not open bus")
    );
}

#[test]
fn junk_costs_the_element_that_contains_it() {
    let some = |text: &str| Some(text.to_owned());
    assert_eq!(split_elements(b"xx< hi >\n< ok ><a>"), [some(" hi "), some(" ok "), some("a")]);
    assert_eq!(split_elements(b"< frame 12< ok >"), [None, some(" ok ")]);
    assert_eq!(split_elements(b"< \xFF ok >< ok >"), [None, some(" ok ")]);
    let long = [b"<".to_vec(), vec![b'x'; 5000], b">< ok >".to_vec()].concat();
    assert_eq!(split_elements(&long), [None, some(" ok ")]);
}

#[cfg(unix)]
#[test]
fn clients_of_a_server_hear_each_other_and_the_drives() {
    let bus = listen("0", "can0").unwrap();
    let address = bus.address().unwrap().to_string();
    thread::scope(|scope| {
        let drives = scope.spawn(|| {
            let mut frame = Frame::default();
            let received = bus.receive(&mut frame, clock::now().plus_ms(3000)).unwrap();
            assert!(matches!(received, Received::Bytes { .. }), "{received:?}");
            bus.send(&Frame::standard(0x321, b"drive")).unwrap();
            let _ = bus.receive(&mut Frame::default(), clock::now().plus_ms(300));
            frame
        });
        let error = connect(&address, "can7").unwrap_err();
        assert_eq!(error.cause(), Cause::NotFound);
        assert!(error.hint().contains("could not open bus"), "{}", error.hint());
        let (one, other) = (connect(&address, "can0").unwrap(), connect(&address, "can0").unwrap());
        let next = |link: &SocketcandLink| {
            let mut frame = Frame::default();
            let received = link.receive(&mut frame, clock::now().plus_ms(2000)).unwrap();
            assert!(matches!(received, Received::Bytes { .. }), "{received:?}");
            frame
        };
        let (sent, answer) = (extended(0x1FFF_FFFF, b"one"), Frame::standard(0x321, b"drive"));
        one.send(&sent).unwrap();
        assert_eq!((next(&one), next(&other), next(&other)), (answer, sent, answer));
        let remote = Frame { remote: true, ..answer };
        assert_eq!(one.send(&remote).unwrap_err().cause(), Cause::Unsuitable);
        assert_eq!(drives.join().unwrap(), sent);
    });
}

/// A scripted client in BCM mode, the mode after opening a bus: `doc/protocol.md`, mode BCM.
#[cfg(unix)]
#[test]
fn a_client_hears_what_it_has_subscribed_to() {
    use super::server::{SUBSCRIPTIONS_MAX, SocketcandSession};
    use crate::hub::{HubSession, OUTPUT_MAX, SessionOutput};
    let mut daemon = SocketcandSession::new("can0");
    let say = |daemon: &mut SocketcandSession, words: &str| {
        let mut output = String::new();
        for byte in words.bytes() {
            output += &text(|to| {
                let mut buffer = [0; OUTPUT_MAX];
                let mut answer = SessionOutput(TextWriter::new(&mut buffer));
                daemon.clone().handle_byte(byte, &mut answer);
                let len = answer.0.len;
                to.push_bytes(&buffer[..len]);
            });
            daemon.handle_byte(byte, &mut SessionOutput(TextWriter::new(&mut [0; OUTPUT_MAX])));
        }
        output
    };
    let receives = |daemon: &mut SocketcandSession, ms: u64, frame: Frame| {
        let mut buffer = [0; OUTPUT_MAX];
        let mut saying = SessionOutput(TextWriter::new(&mut buffer));
        daemon.write_frame(&frame, Instant(ms * 1_000_000), &mut saying);
        saying.0.len > 0
    };
    let frame = |id, data: &[u8]| Frame::standard(id, data);
    assert!(!receives(&mut daemon, 0, frame(0x123, &[1])));
    assert_eq!(say(&mut daemon, "< open can0 >< subscribe 0 0 123 >"), "< ok >");
    assert!(receives(&mut daemon, 0, frame(0x123, &[1])));
    assert!(receives(&mut daemon, 0, frame(0x123, &[1])));
    assert!(!receives(&mut daemon, 0, frame(0x124, &[1])));
    assert!(!receives(&mut daemon, 0, extended(0x123, &[1])));
    // Changes in the first byte, in place of every frame; then no more often than 1.5 s.
    assert_eq!(say(&mut daemon, "< filter 0 0 123 1 FF >"), "");
    assert!(receives(&mut daemon, 1, frame(0x123, &[1, 1])));
    assert!(!receives(&mut daemon, 2, frame(0x123, &[1, 2])));
    assert!(receives(&mut daemon, 3, frame(0x123, &[2, 2])));
    assert_eq!(say(&mut daemon, "< filter 1 500000 123 8 FF 00 F8 00 00 00 00 00 >"), "");
    assert!(receives(&mut daemon, 10, frame(0x123, &[0, 0, 8])));
    assert!(!receives(&mut daemon, 1509, frame(0x123, &[1, 0, 8])));
    assert!(!receives(&mut daemon, 1510, frame(0x123, &[0, 7, 15])));
    assert!(receives(&mut daemon, 1510, frame(0x123, &[0, 7, 16])));
    assert_eq!(say(&mut daemon, "< subscribe 0 0 00000123 >< unsubscribe 123 >"), "");
    assert!(!receives(&mut daemon, 9000, frame(0x123, &[9])));
    assert!(receives(&mut daemon, 9000, extended(0x123, &[9])));
    for wrong in ["subscribe 0 123", "subscribe x 0 123", "filter 0 0 123 2 FF", "unsubscribe"] {
        assert_eq!(say(&mut daemon, &format!("< {wrong} >")), "< error unknown command >");
    }
    for id in 0..SUBSCRIPTIONS_MAX {
        let full = say(&mut daemon, &format!("< subscribe 0 0 {id:X} >"));
        assert_eq!(full.is_empty(), id + 1 < SUBSCRIPTIONS_MAX, "{id}: {full}");
    }
    assert_eq!(say(&mut daemon, "< rawmode >< bcmmode >"), "< ok >< ok >");
    assert!(!receives(&mut daemon, 9000, extended(0x123, &[9])));
}

/// Anything may come from either end; it is refused, never worse, and a good element after it works.
#[test]
fn garbage_does_no_harm() {
    let mut seed = 0x9E37_79B9_7F4A_7C15_u64;
    let mut random = || {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        seed as usize
    };
    let words = ["<", ">", " ", "send", "frame", "error", "123", "1FFFFFFF", "8", "FF", "1.5", "x"];
    for _ in 0..20_000 {
        let mut text = String::new();
        for _ in 0..random() % 40 {
            text.push_str(words[random() % words.len()]);
            text.push_str(&" ".repeat(random() % 2));
        }
        let mut bytes = text.into_bytes();
        if let Some(at) = random().checked_rem(bytes.len()) {
            bytes[at] = random() as u8;
        }
        bytes.extend(b"< ok >");
        let mut elements = ElementSplitter::default();
        let mut last = None;
        for byte in bytes {
            last = elements.push(byte);
            if last == Some(ElementEnd::Element) {
                if let ClientRequest::Send(frame) = ClientRequest::parse(elements.text()) {
                    assert!(frame.len <= 8 && frame.id <= 0x1FFF_FFFF);
                }
                let _ = ServerReply::parse(elements.text());
            }
        }
        assert_eq!(
            (last, ServerReply::parse(elements.text())),
            (Some(ElementEnd::Element), ServerReply::Ok)
        );
    }
}
