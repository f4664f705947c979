//! Clients that want more than their share: each limit has a test of its own.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use polepair_serve::BODY_MAX;
use polepair_test_support::{Deadline, WAIT_MAX};
use serde_json::json;
use tungstenite::protocol::frame::Frame;
use tungstenite::protocol::frame::coding::{Data, OpCode};
use tungstenite::{Message, WebSocket};

use super::JSON;
use super::site::{Site, folder, next, options, send_message};

/// Longest time of a stop beside a flood, ms: a busy machine adds to it, and the flood has no end.
const STOP_MS_MAX: f64 = 10_000.0;

#[test]
fn t11_bodies_are_bounded() {
    let site = Site::new();
    let big = format!("{}{JSON}", site.bearer("operator"));
    let body = format!("{{\"reason\":\"{}\"}}", "x".repeat(BODY_MAX));
    let answer = site.send("POST /api/v1/stop", &big, &body);
    assert_eq!(answer.status, 413, "{}", answer.head);
    let deep = "[".repeat(100_000);
    assert_eq!(site.post("POST /api/v1/stop", "operator", &deep).status, 400);
    assert_eq!(site.post("POST /api/v1/stop", "operator", "{}").status, 200);
    site.end();
}

#[test]
fn t11_heads_are_bounded() {
    let site = Site::new();
    let heads = format!("{}X: {}\r\n", site.bearer("operator"), "y".repeat(100_000));
    let answer = site.get("/api/v1/bench", &heads);
    assert!([0, 431].contains(&answer.status), "{}", answer.head);
    site.end();
}

/// Returns whether the connection is closed within 5 s, longer on a busy machine.
fn is_closed(mut stream: TcpStream) -> bool {
    stream.set_read_timeout(Some(WAIT_MAX)).unwrap();
    stream.read_to_end(&mut Vec::new()).is_ok()
}

#[test]
fn t11_who_says_nothing_or_little_is_closed() {
    let site = Site::new();
    let mut slow = site.connect();
    slow.write_all(b"GET /api/v1/bench HTTP/1.1\r\nHost: ").unwrap();
    let idle = site.connect();
    assert!(is_closed(slow), "half a head");
    assert!(is_closed(idle), "nothing at all");
    site.end();
}

#[test]
fn t11_who_does_not_greet_an_encrypted_server_is_closed() {
    let site = Site::with(polepair_serve::ServerOptions { tls: true, ..options(folder()) });
    let mut half = site.connect();
    half.write_all(&[22, 3, 1, 1]).unwrap();
    let idle = site.connect();
    assert!(is_closed(half), "the beginning of a greeting");
    assert!(is_closed(idle), "none");
    site.end();
}

/// Returns whether the server disconnects this viewer after a bounded number of messages.
fn is_ended(mut viewer: WebSocket<TcpStream>) -> bool {
    let deadline = Deadline::new("the server ends this viewer");
    while !deadline.has_passed() {
        if viewer.read().is_err() {
            return true;
        }
    }
    false
}

#[test]
fn t11_messages_are_bounded() {
    let site = Site::new();
    let mut ann = site.live_as("operator");
    ann.send(Message::text("x".repeat(70_000))).unwrap();
    assert!(is_ended(ann), "a message beyond 64 KiB");
    let mut bob = site.live_as("operator");
    let piece = |code, last| Frame::message("x".repeat(40_000), OpCode::Data(code), last);
    bob.send(Message::Frame(piece(Data::Text, false))).unwrap();
    bob.send(Message::Frame(piece(Data::Continue, true))).unwrap();
    assert!(is_ended(bob), "one of two frames below 64 KiB");
    site.end();
}

/// The limit is 2,000 a second: further messages wait in the socket, and only their sender is delayed.
#[test]
fn t11_messages_are_taken_one_after_the_other() {
    const PINGS: u32 = 3000;
    let site = Site::new();
    let mut ann = site.live_as("operator");
    next(&mut ann, "welcome");
    let ping = json!({ "type": "ping", "client_ms": 0 });
    let since = Instant::now();
    (0..PINGS).for_each(|_| send_message(&mut ann, &ping));
    for _ in 0..PINGS {
        next(&mut ann, "pong");
    }
    // 200 in each tenth of a second, the first at once. A slow machine takes longer, none less.
    let min = Duration::from_millis(100) * (PINGS / 200 - 1) - Duration::from_millis(100);
    assert!(since.elapsed() >= min, "{:?} and not {min:?}", since.elapsed());
    site.end();
}

/// Frames that ask only whether we are there are messages like any other.
#[test]
fn t11_frames_of_control_are_taken_one_after_the_other() {
    const PINGS: u32 = 3000;
    let site = Site::new();
    let mut ann = site.live_as("operator");
    next(&mut ann, "welcome");
    let since = Instant::now();
    for n in 0..PINGS {
        let frame = if n % 2 == 0 { Message::Ping } else { Message::Pong };
        ann.send(frame(Vec::new().into())).unwrap();
    }
    send_message(&mut ann, &json!({ "type": "ping", "client_ms": 0 }));
    next(&mut ann, "pong");
    let min = Duration::from_millis(100) * (PINGS / 200 - 1) - Duration::from_millis(100);
    assert!(since.elapsed() >= min, "{:?} and not {min:?}", since.elapsed());
    site.end();
}

#[test]
fn t11_a_stop_gets_through_idle_sockets_and_a_flood() {
    let site = Site::new();
    let idle: Vec<TcpStream> = (0..400).map(|_| site.connect()).collect();
    let mut flood = site.live_as("operator");
    let flooding = std::thread::spawn(move || {
        let ping = json!({ "type": "ping", "client_ms": 0 }).to_string();
        // It never reads.
        while flood.send(Message::text(ping.clone())).is_ok() {}
    });
    let mut viewer = site.live_as("viewer");
    next(&mut viewer, "welcome");
    let mut took: Vec<f64> = (0..50)
        .map(|_| {
            let since = Instant::now();
            send_message(&mut viewer, &json!({ "type": "stop", "axes": [0] }));
            next(&mut viewer, "stopped");
            since.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    took.sort_by(f64::total_cmp);
    println!("stop to `stopped`: median {:.2} ms, worst {:.2} ms", took[25], took[49]);
    // A machine that does nothing else takes less than one; waiting for the flood has no end.
    assert!(took[25] < STOP_MS_MAX, "{took:?}");
    site.end();
    flooding.join().unwrap();
    drop(idle);
}

/// A limit on messages does not count the frames within one: frames have a limit of their own, and
/// a client that floods with them is closed while others stop.
#[test]
fn t11_a_message_has_not_any_number_of_frames() {
    let site = Site::new();
    let piece = |code, text: &str, last| {
        Message::Frame(Frame::message(text.to_owned(), OpCode::Data(code), last))
    };
    let mut ann = site.live_as("operator");
    next(&mut ann, "welcome");
    let ping = json!({ "type": "ping", "client_ms": 0 }).to_string();
    let (first, rest) = ping.split_at(1);
    ann.send(piece(Data::Text, first, false)).unwrap();
    for one in rest.chars() {
        ann.send(piece(Data::Continue, &one.to_string(), false)).unwrap();
    }
    ann.send(piece(Data::Continue, "", true)).unwrap();
    next(&mut ann, "pong");
    let floods: Vec<_> = (0..2).map(|_| site.live_as("operator")).collect();
    let floods = floods.into_iter().map(|mut flood| {
        std::thread::spawn(move || {
            flood.send(piece(Data::Text, "", false)).unwrap();
            let deadline = Deadline::new("the server closes this connection");
            while flood.send(piece(Data::Continue, "", false)).is_ok() {
                deadline.check(|| "it takes more".to_owned());
            }
        })
    });
    let floods: Vec<_> = floods.collect();
    let mut took: Vec<f64> = (0..21)
        .map(|_| {
            let since = Instant::now();
            send_message(&mut ann, &json!({ "type": "stop", "axes": [0] }));
            next(&mut ann, "stopped");
            since.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    took.sort_by(f64::total_cmp);
    // By the median: a busy machine may let one of them wait.
    assert!(took[10] < STOP_MS_MAX, "{took:?}");
    floods.into_iter().for_each(|flood| flood.join().unwrap());
    site.end();
}
