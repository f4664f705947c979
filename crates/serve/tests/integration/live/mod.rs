//! Messages to viewers over the WebSocket of a real server: telemetry, frames, and that one who is slow
//! or gone takes nothing from the others.

use crate::site;
use polepair_test_support::{Deadline, wait_until};

use std::net::TcpStream;

use serde_json::{Value, json};
use site::{Site, memory, next, samples, send_message};
use tungstenite::{Message, WebSocket};

type Socket = WebSocket<TcpStream>;

fn next_samples(socket: &mut Socket) -> (u16, Vec<(u64, f64)>) {
    loop {
        if let Message::Binary(bytes) = socket.read().unwrap() {
            return samples(&bytes);
        }
    }
}

fn subscribe(socket: &mut Socket, channel: u16, axis: u16, signal: &str) {
    let hz = 100;
    send_message(
        socket,
        &json!({ "type": "subscribe", "channel": channel, "axis": axis, "signal": signal, "hz": hz }),
    );
}

/// Value of a counter of the server.
fn counted(site: &Site, name: &str) -> u64 {
    let text = site.get("/metrics", &site.bearer("viewer")).body;
    let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    line.unwrap_or_else(|| panic!("{name} in {text}")).parse().unwrap()
}

#[test]
fn values_arrive_in_order_until_they_are_not_wanted() {
    let site = Site::new();
    let mut ann = site.live_as("viewer");
    next(&mut ann, "welcome");
    subscribe(&mut ann, 7, 1, "velocity");
    let report = next(&mut ann, "subscribed");
    assert_eq!((&report["channel"], &report["unit"]), (&json!(7), &json!("rad/s")), "{report}");
    assert!(report["hz"].as_f64().unwrap() > 0.0 && report["source"] == "polled", "{report}");
    let mut all: Vec<(u64, f64)> = Vec::new();
    while all.len() < 50 {
        let (channel, rows) = next_samples(&mut ann);
        assert_eq!(channel, 7);
        all.extend(rows);
    }
    assert!(all.windows(2).all(|pair| pair[0].0 < pair[1].0), "{all:?}");
    assert!(all.iter().all(|(_, value)| value.is_finite()));
    subscribe(&mut ann, 8, 0, "smell");
    let wrong = next(&mut ann, "error");
    assert_eq!((&wrong["about"], &wrong["subject"]), (&json!("subscribe"), &json!(8)));
    send_message(&mut ann, &json!({ "type": "unsubscribe", "channel": 7 }));
    // What was on its way may still come; after two answers nothing is.
    for client_ms in [1, 2] {
        send_message(&mut ann, &json!({ "type": "ping", "client_ms": client_ms }));
        next(&mut ann, "pong");
    }
    subscribe(&mut ann, 9, 0, "position");
    assert_eq!(next(&mut ann, "subscribed")["channel"], 9);
    assert_eq!(next_samples(&mut ann).0, 9);
    site.end();
}

#[test]
fn frames_arrive_filtered_and_are_taken_apart() {
    let site = Site::new();
    let mut ann = site.live_as("viewer");
    next(&mut ann, "welcome");
    send_message(&mut ann, &json!({ "type": "frames", "on": true, "filter": "axis = " }));
    assert_eq!(next(&mut ann, "error")["about"], "frames");
    send_message(&mut ann, &json!({ "type": "frames", "on": true, "filter": "protocol = tmcl" }));
    assert_eq!(next(&mut ann, "frames")["items"], json!([]), "the filter is answered first");
    let frames = next(&mut ann, "frames");
    let item = &frames["items"][0];
    assert_eq!((&item["protocol"], &item["ok"]), (&json!("tmcl"), &json!(true)), "{item}");
    send_message(&mut ann, &json!({ "type": "explain", "n": item["n"] }));
    let explained = next(&mut ann, "explained");
    assert_eq!(explained["n"], item["n"]);
    let fields = explained["fields"].as_array().unwrap();
    assert!(fields.len() > 3 && fields.iter().all(|field| field["name"] != ""), "{explained}");
    send_message(&mut ann, &json!({ "type": "explain", "n": u64::MAX }));
    assert_eq!(next(&mut ann, "error")["error"]["code"], "gateway.missing");
    site.end();
}

#[test]
fn a_stop_overtakes_earlier_messages_of_its_viewer() {
    let site = Site::new();
    let mut ann = site.live_as("operator");
    next(&mut ann, "welcome");
    // All of it is sent together and read together, the stop behind it.
    let lines = [
        json!({ "type": "lease", "axis": 0, "act": "take" }),
        json!({ "type": "release" }),
        json!({ "type": "stop", "reason": "enough" }),
    ];
    for value in lines {
        ann.write(Message::text(value.to_string())).unwrap();
    }
    ann.flush().unwrap();
    for about in ["lease", "release"] {
        let refused = next(&mut ann, "error");
        assert_eq!(
            (&refused["about"], &refused["error"]["code"]),
            (&json!(about), &json!("gateway.expired"))
        );
    }
    let bench = site.get("/api/v1/bench", &site.bearer("viewer")).json();
    assert_eq!(bench["lock"]["reason"], "enough", "what was said before it does not release it");
    send_message(&mut ann, &json!({ "type": "release" }));
    next(&mut ann, "unlocked");
    site.end();
}

#[test]
fn viewers_see_the_motors_stop_when_the_server_ends() {
    let mut site = Site::new();
    let mut ann = site.live_as("operator");
    next(&mut ann, "welcome");
    send_message(&mut ann, &json!({ "type": "lease", "axis": 0, "act": "take" }));
    let epoch = next(&mut ann, "leased")["epoch"].clone();
    for (verb, arguments) in
        [("arm", json!({})), ("enable", json!({})), ("velocity", json!({ "velocity": 20.0 }))]
    {
        send_message(
            &mut ann,
            &json!({ "type": "command", "axis": 0, "id": verb, "issued_ms": site::now_ms(),
                "ttl_ms": 5000, "epoch": epoch, "verb": verb, "arguments": arguments }),
        );
        let outcome = next(&mut ann, "outcome");
        assert_eq!(outcome["outcome"], "done", "{outcome}");
    }
    let server = site.server.take();
    let ends = std::thread::spawn(move || drop(server));
    let mut received = Vec::new();
    while let Ok(message) = ann.read() {
        if let Message::Text(text) = message {
            received.push(serde_json::from_str::<Value>(&text).unwrap());
        }
    }
    ends.join().unwrap();
    let ended =
        |value: &Value| value["type"] == "axis" && value["id"] == 0 && value["lease"].is_null();
    assert!(received.iter().any(ended), "the lease's end: {received:?}");
    let class = |value: &Value| value["axes"][0]["class"].as_str().map(str::to_owned);
    let mut stops = received.iter().filter(|value| value["type"] == "stopped").filter_map(class);
    assert_eq!(stops.next_back().as_deref(), Some("standing"), "{received:?}");
    site.end();
}

#[test]
fn a_viewer_that_reads_nothing_is_closed_and_another_goes_on() {
    let site = Site::new();
    let (mut deaf, mut ann) = (site.live_as("viewer"), site.live_as("viewer"));
    for socket in [&mut deaf, &mut ann] {
        next(socket, "welcome");
        subscribe(socket, 1, 0, "velocity");
        send_message(socket, &json!({ "type": "frames", "on": true }));
        next(socket, "subscribed");
    }
    let deadline = Deadline::new("the deaf viewer is closed");
    let mut last = 0;
    while counted(&site, "polepair_viewers") > 1 {
        deadline.check(|| "it is still there".to_owned());
        let (_, rows) = next_samples(&mut ann);
        assert!(rows[0].0 > last);
        last = rows[rows.len() - 1].0;
    }
    send_message(&mut ann, &json!({ "type": "ping", "client_ms": 1 }));
    next(&mut ann, "pong");
    site.end();
}

/// A viewer that leaves without a message.
fn visit(site: &Site) -> Value {
    let mut ann = site.live_as("viewer");
    let welcome = next(&mut ann, "welcome");
    subscribe(&mut ann, 1, 0, "velocity");
    send_message(&mut ann, &json!({ "type": "frames", "on": true }));
    next(&mut ann, "subscribed");
    welcome
}

fn all_gone(site: &Site) {
    wait_until("all viewers are gone", || counted(site, "polepair_viewers") == 0);
}

#[test]
fn a_thousand_visits_leave_nothing_behind() {
    if !site::is_alone("live::a_thousand_visits_leave_nothing_behind") {
        return;
    }
    let site = Site::new();
    (0..100).for_each(|_| drop(visit(&site)));
    all_gone(&site);
    let before = memory();
    for n in 0..1000 {
        visit(&site);
        // Few may watch frames at once: who went must have given that back.
        if n % 128 == 127 {
            all_gone(&site);
        }
    }
    all_gone(&site);
    let bench = site.server.as_ref().unwrap().bench();
    let places: Vec<_> = (0..256).map(|_| bench.subscribe_frames(None)).collect();
    assert!(places.iter().all(Result::is_ok), "a place to watch frames is still taken");
    let grown = memory().saturating_sub(before);
    assert!(grown < 16 << 20, "{grown} bytes more");
    drop(places);
    site.end();
}

#[test]
fn a_capture_is_taken_in_paged_and_taken_apart() {
    let site = Site::new();
    let line = |n: usize| format!("({n}.000000) can0 60{}#4041600000000000\n", n % 8);
    let log: String = (0..300).map(line).collect();
    let heads = format!(
        "{}Content-Type: application/octet-stream\r\nX-Polepair: 1\r\n",
        site.bearer("viewer")
    );
    let opened = site.send("POST /api/v1/captures?name=bus.log", &heads, &log);
    assert_eq!(opened.status, 200, "{opened:?}");
    let opened = opened.json();
    assert_eq!((&opened["name"], &opened["page"]["total"]), (&json!("bus.log"), &json!(300)));
    let request =
        |path: &str| site.get(&format!("/api/v1/captures/{path}"), &site.bearer("viewer"));
    let id = opened["id"].as_str().unwrap();
    let page = request(&format!("{id}?from=290&count=5")).json();
    assert_eq!((page["items"].as_array().unwrap().len(), &page["next"]), (5, &json!(295)));
    // One that was shown, and one that has to be looked for again once others were shown.
    let fields = request(&format!("{id}/frames/290"));
    assert!(fields.json().as_array().unwrap().len() > 2, "{fields:?}");
    assert_eq!(request(&format!("{id}/frames/300")).status, 404);
    assert_eq!(request("capture-9?from=0").code(), "gateway.missing");
    let nothing = site.send("POST /api/v1/captures", &heads, "nonsense");
    assert_eq!(nothing.code(), "E510");
    let long = "x".repeat((64 << 20) + 1);
    assert_eq!(site.send("POST /api/v1/captures", &heads, &long).status, 413);
    site.end();
}
