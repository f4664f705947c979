//! Scopes: the requests that each allows, stated here once more and independent of the server's own table.

use std::net::TcpStream;

use polepair_serve::{AccessRule, ApiRoute, ROUTES, ServerOptions};
use serde_json::json;
use tungstenite::{Message, WebSocket};

use super::site::{Site, folder, options, send_message};
use super::{filled, marked};

/// Pings in which a refusal comes that comes at all.
const PATIENCE: usize = 1000;

const WORDS: [&str; 5] = ["read", "stop", "move", "configure", "raw"];

/// A site that grants these scopes at most, with a token for each scope alone and one to look on
/// besides.
fn site(scopes: &str) -> Site {
    let folder = folder();
    drop(Site::with(options(folder.clone())));
    let token = |n: usize, scopes: &str, name: &str| {
        format!("{}{n:02x} {scopes} {name}\n", "ab".repeat(31))
    };
    let lines = WORDS.iter().enumerate().map(|(n, word)| {
        let both = if *word == "read" { "read".to_owned() } else { format!("read,{word}") };
        token(n, word, word) + &token(n + 16, &both, &format!("live-{word}"))
    });
    std::fs::write(folder.join("tokens"), lines.collect::<String>()).unwrap();
    Site::with(ServerOptions { scopes: scopes.parse().unwrap(), ..options(folder) })
}

/// Returns the scopes that may use a route.
fn may(route: &ApiRoute) -> &'static [&'static str] {
    match (route.method, route.path) {
        ("GET", _) | (_, "/api/v1/captures" | "/api/v1/axes/{id}/paths") => &["read"],
        (_, "/api/v1/stop") => &["stop"],
        (_, "/api/v1/release" | "/api/v1/axes/{id}/commands" | "/api/v1/axes/{id}/drive-log") => {
            &["move"]
        }
        (_, "/api/v1/dismiss" | "/api/v1/axes/{id}/dismiss") => &["move"],
        (_, "/api/v1/axes/{id}/raw") => &["raw"],
        (_, path) if path.starts_with("/api/v1/axes/{id}/lease") => &["move", "configure", "raw"],
        (_, "/api/v1/axes/{id}/parameters" | "/api/v1/axes/{id}/watchdog") => &["configure"],
        (_, path) if path.starts_with("/api/v1/simulation/") => &["configure"],
        (_, "/api/v1/search") => &["configure"],
        (_, path) if path.starts_with("/api/v1/links/{id}/look") => &["configure"],
        other => panic!("{other:?} is new: say here who may"),
    }
}

/// Returns whether a request is refused because of its scope alone.
fn is_denied(site: &Site, route: &ApiRoute, who: &str) -> bool {
    let line = format!("{} {}", route.method, filled(route.path));
    // A request that passes the guard is refused for its wrong body.
    let heads = format!("{}{}", site.bearer(who), marked(route));
    site.send(&line, &heads, "{\"nonsense\":").status == 403
}

#[test]
fn t10_a_scope_grants_nothing_else() {
    let site = site("read,stop,move,configure,raw");
    for route in ROUTES.iter().filter(|route| route.access != AccessRule::Public) {
        for word in WORDS {
            let denied = is_denied(&site, route, word);
            assert_eq!(denied, !may(route).contains(&word), "{route:?} as {word}");
        }
    }
    site.end();
}

#[test]
fn t10_a_token_grants_no_more_than_its_server() {
    let site = site("read");
    for route in ROUTES.iter().filter(|route| route.access != AccessRule::Public) {
        for word in WORDS {
            let reads = word == "read" && may(route).contains(&"read");
            assert_eq!(is_denied(&site, route, word), !reads, "{route:?} as {word}");
        }
    }
    site.end();
}

/// Returns whether a refusal because of a missing scope comes before the reply to a ping.
fn is_denied_by_now(socket: &mut WebSocket<TcpStream>) -> bool {
    send_message(socket, &json!({ "type": "ping", "client_ms": 0 }));
    let mut denied = false;
    loop {
        let Message::Text(text) = socket.read().unwrap() else { continue };
        denied |= text.contains("\"gateway.scope\"");
        if text.contains("\"type\":\"pong\"") {
            return denied;
        }
    }
}

#[test]
fn t10_the_websocket_asks_for_the_same_scopes() {
    let site = site("read,stop,move,configure,raw");
    let command = json!({ "type": "command", "axis": 0, "id": "x", "issued_ms": 0, "epoch": 0,
                          "verb": "arm" });
    let lines: [(_, &[&str]); 6] = [
        (json!({ "type": "unsubscribe", "channel": 1 }), &WORDS),
        (json!({ "type": "explain", "n": 0 }), &WORDS),
        (command, &["move"]),
        (json!({ "type": "lease", "axis": 9, "act": "take" }), &["move", "configure", "raw"]),
        (json!({ "type": "stop", "axes": [] }), &["stop"]),
        (json!({ "type": "release" }), &["move"]),
    ];
    for word in WORDS {
        let mut socket = site.live_as(&format!("live-{word}"));
        for (message, may) in &lines {
            send_message(&mut socket, message);
            let expected = !may.contains(&word);
            // A reply to a later message may overtake a refusal.
            let pings = if expected { PATIENCE } else { 3 };
            let denied = (0..pings).any(|_| is_denied_by_now(&mut socket));
            assert_eq!(denied, expected, "{message} as {word}");
        }
    }
    site.end();
}
