//! One test for each threat to a gateway that moves motors, by a real server and raw clients. Each
//! fails when its guard is taken away. docs/reference/gateway.md has them by the same numbers.

mod hogs;
mod raw;
mod scopes;
mod stops;
mod tls;

use crate::{authority, site};

use polepair::Connector;
use polepair_link::clock;
use polepair_serve::{AccessRule, ApiRoute, GatewayServer, ROUTES, ServerOptions, TRIES_MAX};
use serde_json::{Value, json};
use site::{Site, folder, next, now_ms, options, send_message};

const JSON: &str = "Content-Type: application/json\r\nX-Polepair: 1\r\n";

/// A route's path with something put in.
fn filled(path: &str) -> String {
    let numbers = path.replace("{id}", "0").replace("{link}", "0").replace("{drive}", "0");
    numbers.replace("{n}", "0").replace("{name}", "max%20current").replace("{challenge}", "0")
}

/// The headers with which it takes a body.
fn marked(route: &ApiRoute) -> String {
    let kind = if route.accepts_file { "octet-stream" } else { "json" };
    format!("Content-Type: application/{kind}\r\nX-Polepair: 1\r\n")
}

#[test]
fn t01_pages_of_other_sites_command_nothing() {
    let site = Site::new();
    let (cookie, bearer) = (site.cookie(), site.bearer("operator"));
    let port = site.address.port();
    let foreign = ["http://evil.test", "null", "http://127.0.0.1:1", "https://127.0.0.1", ""];
    let ours = format!("http://127.0.0.1:{port}");
    for who in [format!("Cookie: {cookie}\r\n"), bearer] {
        for origin in foreign {
            let heads = format!("{who}{JSON}Origin: {origin}\r\n");
            assert_eq!(site.send("POST /api/v1/stop", &heads, "{}").status, 403, "{origin}");
        }
        let form =
            format!("{who}Content-Type: application/x-www-form-urlencoded\r\nOrigin: {ours}\r\n");
        assert_eq!(site.send("POST /api/v1/stop", &form, "axes=").status, 403);
        let plain = format!("{who}Content-Type: text/plain\r\nX-Polepair: 1\r\n");
        assert_eq!(site.send("POST /api/v1/stop", &plain, "{}").status, 403);
        let unmarked = format!("{who}Content-Type: application/json\r\n");
        assert_eq!(site.send("POST /api/v1/stop", &unmarked, "{}").status, 403);
        let preflight = format!("{who}Origin: http://evil.test\r\n");
        assert_eq!(site.send("OPTIONS /api/v1/stop", &preflight, "").status, 403);
    }
    assert!(site.server.as_ref().unwrap().bench().snapshot().lock.is_none(), "nothing stopped");
    for origin in foreign {
        let heads = [("Cookie", cookie.clone()), ("Origin", origin.to_owned())];
        assert_eq!(site.live(&heads).err(), Some(403), "{origin}");
    }
    assert_eq!(site.live(&[("Cookie", cookie.clone())]).err(), Some(403), "no origin");
    assert!(site.live(&[("Cookie", cookie.clone()), ("Origin", ours.clone())]).is_ok());
    let page = format!("Cookie: {cookie}\r\n{JSON}Origin: {ours}\r\n");
    let stopped = site.send("POST /api/v1/stop", &page, "{}");
    assert_eq!(stopped.status, 200, "{stopped:?}");
    assert!(!stopped.head.contains("access-control-"), "{stopped:?}");
    site.end();
}

#[test]
fn t02_names_that_others_made_up_do_not_reach_it() {
    let site = Site::new();
    let bearer = site.bearer("operator");
    let port = site.address.port();
    let request = |host: &str| {
        let host = if host.is_empty() { String::new() } else { format!("Host: {host}\r\n") };
        let line = "GET /api/v1/bench HTTP/1.1\r\n";
        site.say(&format!("{line}{host}{bearer}Connection: close\r\n\r\n")).status
    };
    for host in ["evil.test", "127.0.0.1", "127.0.0.1:1", "127.0.0.1.evil.test"] {
        assert_eq!(request(host), 421, "{host}");
    }
    assert_eq!(request(&format!("evil.test:{port}")), 421);
    assert!([400, 421].contains(&request("")), "no host at all");
    assert_eq!(request(&format!("127.0.0.1:{port}\r\nHost: evil.test")), 421, "two hosts");
    for host in ["127.0.0.1", "localhost", "[::1]"] {
        assert_eq!(request(&format!("{host}:{port}")), 200, "{host}");
    }
    site.end();
}

/// A reverse proxy and a tunnel call the server by a host and port of their own.
#[test]
fn t02_stated_names_and_origins_count_to_the_letter() {
    let site = Site::with(ServerOptions {
        host_names: vec!["bench.example".into(), "localhost:8080".into()],
        origins: vec!["https://bench.example".into()],
        ..options(folder())
    });
    let bearer = site.bearer("operator");
    let request = |host: &str, origin: &str| {
        let line = "POST /api/v1/stop HTTP/1.1\r\n";
        let origin =
            if origin.is_empty() { String::new() } else { format!("Origin: {origin}\r\n") };
        site.say(&format!(
            "{line}Host: {host}\r\n{bearer}{JSON}{origin}Connection: close\r\nContent-Length: \
             2\r\n\r\n{{}}"
        ))
    };
    for (host, origin) in [
        ("bench.example", ""),
        ("bench.example", "https://bench.example"),
        ("bench.example", "http://bench.example"),
        ("localhost:8080", "http://localhost:8080"),
    ] {
        assert_eq!(request(host, origin).status, 200, "{host} {origin}");
    }
    let answer = request("localhost:8081", "");
    assert_eq!((answer.status, &*answer.code()), (421, "gateway.host"));
    let error = &answer.json()["error"];
    assert_eq!(error["message"], "this server does not accept the host name localhost:8081");
    assert!(error["hint"].as_str().is_some_and(|hint| hint.contains("--name localhost:8081")));
    let answer = request("bench.example", "https://bench.example:444");
    assert_eq!((answer.status, &*answer.code()), (403, "gateway.origin"));
    let hint = answer.json()["error"]["hint"].as_str().map(str::to_owned);
    assert!(hint.is_some_and(|hint| hint.contains("--origin https://bench.example:444")));
    site.end();
}

#[test]
fn t03_nothing_answers_without_a_token() {
    let site = Site::new();
    let wrong = format!("Authorization: Bearer {}\r\n", "0".repeat(64));
    for route in ROUTES.iter().filter(|route| route.access != AccessRule::Public) {
        let line = format!("{} {}", route.method, filled(route.path));
        let answer = site.send(&line, &marked(route), "{}");
        assert_eq!(answer.status, 401, "{route:?}");
        assert_eq!(answer.code(), "gateway.token", "{route:?}");
    }
    let answer = site.send("GET /api/v1/bench", &wrong, "");
    assert_eq!(answer.status, 401);
    for path in ["/", "/index.html", "/assets/index.js", "/nothing", "/api", "/api/v1/nothing"] {
        assert_eq!(site.get(path, "").status, 401, "{path}");
        assert_eq!(site.get(path, "Accept: text/html\r\n").status, 401, "{path}");
    }
    assert_eq!(site.send("HEAD /api/v1/bench", "", "").status, 401);
    assert_eq!(site.live(&[]).err(), Some(401), "the WebSocket");
    let once = site.get(&format!("/?once={}", "0".repeat(64)), "");
    assert!(once.status == 401 && !once.head.contains("set-cookie"), "{once:?}");
    site.end();
}

#[test]
fn t04_elsewhere_only_encrypted_and_no_guessing() {
    let start = |bind: &str| {
        let bind = bind.parse().unwrap();
        let options = polepair_serve::ServerOptions { bind, ..options(folder()) };
        GatewayServer::start(&options, &["sim:tmcl".into()], Connector::default())
    };
    for bind in ["0.0.0.0:0", "[::]:0"] {
        let refusal = start(bind).unwrap_err();
        assert_eq!((refusal.code, refusal.exit as u8), ("E252", 2));
    }
    let site = Site::new();
    let mut statuses = Vec::new();
    for n in 0..100 {
        let login = json!({ "token": format!("{n:064x}") }).to_string();
        statuses.push(site.send("POST /api/v1/login", JSON, &login).status);
    }
    assert!(statuses[..TRIES_MAX].iter().all(|status| *status == 401), "{statuses:?}");
    assert!(statuses[TRIES_MAX..].iter().all(|status| *status == 429), "{statuses:?}");
    let right = json!({ "token": site.token("operator") }).to_string();
    assert_eq!(site.send("POST /api/v1/login", JSON, &right).status, 429);
    assert_eq!(site.post("POST /api/v1/stop", "operator", "{}").status, 200, "stops get through");
    let failed = site.journal().iter().filter(|r| r["detail"]["ok"] == json!(false)).count();
    assert_eq!(failed, TRIES_MAX, "guesses do not fill the journal");
    site.end();
}

#[test]
fn t05_no_address_is_trusted_and_no_proxys_word() {
    let site = Site::new();
    for n in 0..=TRIES_MAX {
        let heads = format!(
            "X-Forwarded-For: 10.0.0.{n}\r\nForwarded: for=10.0.0.{n}\r\nX-Real-IP: 127.0.0.1\r\n"
        );
        assert_eq!(site.get("/api/v1/bench", &heads).status, 401);
        let login = json!({ "token": format!("{n:064x}") }).to_string();
        let status = site.send("POST /api/v1/login", &format!("{JSON}{heads}"), &login).status;
        assert_eq!(status, if n < TRIES_MAX { 401 } else { 429 }, "try {n}");
    }
    let host = format!("{}X-Forwarded-Host: evil.test\r\n", site.bearer("operator"));
    assert_eq!(site.get("/api/v1/bench", &host).status, 200);
    site.end();
}

#[test]
fn t06_tokens_do_not_leak() {
    let site = Site::new();
    let url = site.server.as_ref().unwrap().url().to_owned();
    let once = url.split("once=").nth(1).unwrap().to_owned();
    let head = site.send(&format!("HEAD /?once={once}"), "", "");
    assert!(!head.head.contains("set-cookie"), "a look ahead does not use it up");
    let first = site.get(&format!("/?once={once}"), "");
    assert_eq!(first.status, 303);
    assert!(first.head.contains("location: /\r\n"), "{first:?}");
    for word in ["httponly", "samesite=strict", "path=/"] {
        assert!(first.head.contains(word), "{word} in {first:?}");
    }
    assert_eq!(site.get(&format!("/?once={once}"), "").status, 401, "good once");
    let cookie = first.head.split("set-cookie: ").nth(1).unwrap().split(';').next().unwrap();
    let page = site.get("/", &format!("Cookie: {cookie}\r\nAccept: text/html\r\n"));
    assert_eq!(page.status, 200);
    for answer in [&page, &site.get("/", ""), &site.get("/api/v1/bench", &site.bearer("viewer"))] {
        for head in [
            "content-security-policy: default-src 'self'",
            "frame-ancestors 'none'",
            "referrer-policy: no-referrer",
            "x-content-type-options: nosniff",
            "x-frame-options: deny",
            "cross-origin-opener-policy: same-origin",
            "cross-origin-resource-policy: same-origin",
        ] {
            assert!(answer.head.contains(head), "{head} in {answer:?}");
        }
        assert!(!answer.head.contains("unsafe-inline"), "{answer:?}");
    }
    let debug = format!("{:?}", site.server);
    let journal = std::fs::read_to_string(site.folder.join("journal.jsonl")).unwrap();
    let value = cookie.split('=').nth(1).unwrap();
    for secret in [&site.token("operator"), &site.token("viewer"), &once, value] {
        assert!(!journal.contains(secret) && !debug.contains(secret));
    }
    let metrics = site.get("/metrics", &site.bearer("viewer"));
    assert!(metrics.status == 200 && metrics.body.contains("polepair_http_answers_total"));
    assert!(!metrics.body.contains(&once));
    let sessions = std::fs::read_to_string(site.folder.join("sessions")).unwrap();
    for secret in [&site.token("operator"), &once, value] {
        assert!(!sessions.contains(secret), "digests alone");
    }
    site.end();
}

#[test]
fn t06_a_browser_outlives_the_servers_restart_and_not_its_token() {
    let site = Site::new();
    let cookie = format!("Cookie: {}\r\n", site.cookie());
    let (folder, bind) = (site.folder.clone(), site.address);
    let start = || Site::with(ServerOptions { bind, ..options(folder.clone()) });
    assert_eq!(site.get("/api/v1/bench", &cookie).status, 200);
    drop(site);
    let site = start();
    assert_eq!(site.get("/api/v1/bench", &cookie).status, 200);
    let live = [("Cookie", cookie.trim()[8..].to_owned()), ("Origin", format!("http://{bind}"))];
    assert!(site.live(&live).is_ok(), "it watches and stops at once");
    let request = format!("{cookie}Content-Type: application/json\r\nX-Polepair: 1\r\n");
    assert_eq!(site.send("POST /api/v1/stop", &request, "{}").status, 200);
    let foreign = format!("{request}Origin: http://evil.test\r\n");
    assert_eq!(site.send("POST /api/v1/stop", &foreign, "{}").code(), "gateway.origin");
    drop(site);
    std::fs::remove_file(folder.join("tokens")).unwrap();
    let site = start();
    assert_eq!(site.get("/api/v1/bench", &cookie).code(), "gateway.token");
    assert_eq!(site.live(&live).err(), Some(401));
    site.end();
}

#[test]
fn t07_one_commands_an_axis_and_anybody_may_stop_it() {
    let site = Site::new();
    let (mut ann, mut bob) = (site.live_as("operator"), site.live_as("operator"));
    send_message(&mut ann, &json!({ "type": "lease", "axis": 0, "act": "take" }));
    let epoch = next(&mut ann, "leased")["epoch"].as_u64().unwrap();
    send_message(&mut bob, &json!({ "type": "lease", "axis": 0, "act": "take" }));
    assert_eq!(next(&mut bob, "error")["error"]["code"], "gateway.lease");
    let arm = |id: &str, epoch: u64| {
        json!({ "type": "command", "axis": 0, "id": id, "issued_ms": now_ms(), "ttl_ms": 5000,
                "epoch": epoch, "verb": "arm" })
    };
    send_message(&mut bob, &arm("bob-1", epoch));
    assert_eq!(next(&mut bob, "outcome")["error"]["code"], "gateway.lease", "not his");
    let write = |epoch: u64| {
        let body = json!({ "values": { "max current": 1 }, "epoch": epoch }).to_string();
        site.post("POST /api/v1/axes/0/parameters", "operator", &body)
    };
    assert_eq!(write(epoch).status, 200, "ann's page, by REST");
    assert_eq!(write(epoch + 1).code(), "gateway.lease");
    send_message(&mut bob, &json!({ "type": "lease", "axis": 0, "act": "take_over" }));
    let mut newer = next(&mut bob, "leased")["epoch"].as_u64().unwrap();
    assert!(newer > epoch);
    send_message(&mut ann, &arm("ann-1", epoch));
    assert_eq!(next(&mut ann, "outcome")["error"]["code"], "gateway.lease", "an older epoch");
    assert!(site.journal().iter().any(|record| record["deed"] == "take_over"));
    send_message(&mut bob, &json!({ "type": "lease", "axis": 0, "act": "drop", "epoch": newer }));
    next(&mut bob, "leased");
    send_message(&mut bob, &json!({ "type": "lease", "axis": 0, "act": "take" }));
    let own = std::mem::replace(&mut newer, next(&mut bob, "leased")["epoch"].as_u64().unwrap());
    send_message(&mut bob, &arm("bob-late", own));
    assert_eq!(next(&mut bob, "outcome")["error"]["code"], "gateway.lease", "his own older epoch");
    let mut viewer = site.live_as("viewer");
    next(&mut viewer, "welcome");
    send_message(&mut viewer, &json!({ "type": "stop" }));
    next(&mut viewer, "locked");
    send_message(&mut bob, &arm("bob-2", newer));
    assert_eq!(next(&mut bob, "outcome")["outcome"], "not_done", "locked, and the lease is gone");
    send_message(&mut viewer, &json!({ "type": "release" }));
    assert_eq!(next(&mut viewer, "error")["error"]["code"], "gateway.scope");
    send_message(&mut bob, &json!({ "type": "lease", "axis": 0, "act": "take" }));
    let last = next(&mut bob, "leased")["epoch"].as_u64().unwrap();
    send_message(&mut bob, &arm("bob-3", last));
    assert_eq!(
        next(&mut bob, "outcome")["error"]["code"],
        "gateway.locked",
        "a lease unlocks nothing"
    );
    send_message(&mut bob, &json!({ "type": "release" }));
    next(&mut bob, "unlocked");
    send_message(&mut bob, &arm("bob-4", newer));
    let ended = next(&mut bob, "outcome");
    assert_eq!(ended["error"]["code"], "gateway.lease", "the stop ended it");
    site.end();
}

#[test]
fn t08_a_late_or_repeated_command_is_not_executed() {
    let site = Site::new();
    let mut ann = site.live_as("operator");
    send_message(&mut ann, &json!({ "type": "lease", "axis": 0, "act": "take" }));
    let epoch = next(&mut ann, "leased")["epoch"].as_u64().unwrap();
    let arm = |id: &str, issued_ms: f64| {
        json!({ "type": "command", "axis": 0, "id": id, "issued_ms": issued_ms, "ttl_ms": 1000,
                "epoch": epoch, "verb": "arm" })
    };
    send_message(&mut ann, &arm("late", now_ms() - 1500.0 * f64::from(clock::timeout_scale())));
    let late = next(&mut ann, "outcome");
    assert_eq!(
        (&late["outcome"], &late["error"]["code"]),
        (&json!("not_done"), &json!("gateway.expired"))
    );
    assert!(!site.server.as_ref().unwrap().bench().axis_state(0).unwrap().armed);
    let twice = arm("twice", now_ms());
    send_message(&mut ann, &twice);
    let first = next(&mut ann, "outcome");
    send_message(&mut ann, &twice);
    let second = next(&mut ann, "outcome");
    assert_eq!((&first["replayed"], &second["replayed"]), (&json!(false), &json!(true)));
    assert_eq!(first["outcome"], second["outcome"]);
    let reports = site.journal();
    let sent = reports.iter().filter(|r| r["deed"] == "command" && r["detail"]["id"] == "twice");
    assert_eq!(sent.count(), 1);
    site.end();
}

#[test]
fn t09_the_gateway_itself_holds_limits_and_has_no_back_door() {
    let site = Site::new();
    let bench = site.get("/api/v1/bench", &site.bearer("operator")).json();
    let scopes = bench["scopes"].as_array().unwrap();
    assert!(!scopes.contains(&json!("raw")), "{scopes:?}");
    assert_eq!(site.post("POST /api/v1/axes/0/raw", "operator", "{}").status, 403);
    for path in ["/api/v1/raw", "/api/v1/firmware"] {
        assert_eq!(site.post(&format!("POST {path}"), "operator", "{}").status, 404, "{path}");
    }
    let lease = site.post("POST /api/v1/axes/0/lease", "operator", "{}").json();
    for (name, value, code) in [
        ("max current", json!(1e9), "E216"),
        ("max current", json!("1; GAP 1"), "E217"),
        ("target position", json!(1), "E219"),
        ("no such\r\nthing", json!(1), "E213"),
    ] {
        let body = json!({ "values": { name: value }, "epoch": lease["epoch"] }).to_string();
        let answer = site.post("POST /api/v1/axes/0/parameters", "operator", &body);
        assert_eq!(answer.code(), code, "{name}: {answer:?}");
        assert_eq!(answer.json()["error"]["executed"], json!(false), "{name}");
    }
    site.end();
}

#[test]
fn t12_paths_lead_nowhere_else() {
    let site = Site::new();
    let bearer = site.bearer("operator");
    for path in [
        "/../../../../etc/passwd",
        "/..%2f..%2f..%2fetc/passwd",
        "/assets/../../Cargo.toml",
        "/%2e%2e/Cargo.toml",
        "//etc/passwd",
        "/tokens",
        "/api/v1/axes/0/parameters/..%2f..%2ftokens",
        "/api/v1/axes/65536",
        "/api/v1/axes/-1",
        "/api/v1/axes/%00",
    ] {
        let answer = site.get(path, &bearer);
        assert!([400, 404].contains(&answer.status), "{path}: {answer:?}");
        assert!(!answer.body.contains("root:") && !answer.body.contains("[package]"), "{path}");
    }
    site.end();
}

#[test]
fn t13_the_page_loads_nothing_from_elsewhere() {
    let site = Site::new();
    let page = site.get("/", &site.bearer("viewer"));
    assert_eq!(page.status, 200);
    let policy =
        page.head.lines().find(|line| line.starts_with("content-security-policy")).unwrap();
    for word in ["http:", "https:", "*", "unsafe", "ws:"] {
        assert!(!policy.contains(word), "{policy}");
    }
    for reference in ["src=\"http", "href=\"http", "src=\"//", "href=\"//", "@import"] {
        assert!(!page.body.contains(reference), "{reference}");
    }
    site.end();
}

#[test]
fn t14_what_was_done_is_written_and_cannot_be_changed_unseen() {
    let site = Site::new();
    let mut ann = site.live_as("operator");
    let session = next(&mut ann, "welcome")["session"].clone();
    send_message(&mut ann, &json!({ "type": "lease", "axis": 0, "act": "take" }));
    let epoch = next(&mut ann, "leased")["epoch"].clone();
    send_message(
        &mut ann,
        &json!({ "type": "command", "axis": 0, "id": "one", "issued_ms": now_ms(),
        "ttl_ms": 5000, "epoch": epoch, "verb": "arm" }),
    );
    next(&mut ann, "outcome");
    let records = site.get("/api/v1/journal?count=1000", &site.bearer("viewer")).json();
    let records = records.as_array().unwrap().clone();
    let deeds: Vec<&str> = records.iter().map(|record| record["deed"].as_str().unwrap()).collect();
    let at = |action: &str| deeds.iter().position(|d| *d == action);
    assert!(at("started") < at("lease") && at("lease") < at("command"), "{deeds:?}");
    assert!(at("command") < at("outcome") && at("command").is_some(), "{deeds:?}");
    assert_eq!(records[at("command").unwrap()]["who"], session);
    let file = site.folder.join("journal.jsonl");
    let verified = polepair_serve::journal::verify(&file).unwrap().unwrap();
    assert!(verified.records >= records.len() as u64);
    let mut bytes = std::fs::read(&file).unwrap();
    let index = bytes.iter().position(|byte| *byte == b'\n').unwrap() + 40;
    bytes[index] ^= 1;
    let copy = site.folder.join("copy.jsonl");
    std::fs::write(&copy, bytes).unwrap();
    let broken = polepair_serve::journal::verify(&copy).unwrap().unwrap_err();
    assert_eq!(broken.record, 1);
    // A changed record with a hash that fits breaks the chain behind it.
    let text = std::fs::read_to_string(&file).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let hash = |line: &str| blake3::Hash::from_hex(&line[line.len() - 66..][..64]).unwrap();
    let (output, _) = lines[1].rsplit_once(",\"hash\":").unwrap();
    let message = format!("{}}}", output.replacen("\"axis\":0", "\"axis\":1", 1));
    assert!(!lines[1].starts_with(&message[..message.len() - 1]), "it is changed");
    let mut hasher = blake3::Hasher::new();
    hasher.update(hash(lines[0]).as_bytes()).update(message.as_bytes());
    let forged =
        format!("{},\"hash\":\"{}\"}}", &message[..message.len() - 1], hasher.finalize().to_hex());
    std::fs::write(&copy, text.replacen(lines[1], &forged, 1)).unwrap();
    let broken = polepair_serve::journal::verify(&copy).unwrap().unwrap_err();
    assert_eq!(broken.record, 2);
    site.end();
}

#[cfg(unix)]
#[test]
fn t15_others_on_this_machine_read_nothing() {
    use std::os::unix::fs::PermissionsExt as _;
    let site = Site::new();
    let mode =
        |path: &std::path::Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
    assert_eq!(mode(&site.folder), 0o700);
    site.cookie();
    for name in ["tokens", "journal.jsonl", "sessions"] {
        assert_eq!(mode(&site.folder.join(name)), 0o600, "{name}");
    }
    let folder = site.folder.clone();
    drop(site);
    let tokens = folder.join("tokens");
    std::fs::set_permissions(&tokens, std::fs::Permissions::from_mode(0o644)).unwrap();
    let refused =
        GatewayServer::start(&options(folder.clone()), &[], Connector::default()).unwrap_err();
    assert_eq!(refused.code, "E305");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn t17_reading_changes_nothing() {
    let site = Site::new();
    let (before, written) = (site.state(), site.journal().len());
    let bearer = site.bearer("operator");
    for route in ROUTES.iter().filter(|route| route.method == "GET") {
        let answer = site.get(&filled(route.path), &bearer);
        assert!(answer.status < 500, "{route:?}: {answer:?}");
        assert_eq!(
            site.send(&format!("HEAD {}", filled(route.path)), &bearer, "").status,
            answer.status
        );
    }
    for route in ROUTES.iter().filter(|route| route.method != "GET") {
        // What changes something does not do so when it is merely looked at.
        let status = site.get(&filled(route.path), &bearer).status;
        let also_read = ROUTES.iter().any(|r| r.method == "GET" && r.path == route.path);
        assert_eq!(status == 405, !also_read, "{route:?}: {status}");
    }
    assert_eq!(site.state(), before);
    assert_eq!(site.journal().len(), written);
    site.end();
}

#[test]
fn a_server_that_is_killed_leaves_a_journal_that_goes_on() {
    let site = Site::new();
    let folder = site.folder.clone();
    drop(site);
    let file = folder.join("journal.jsonl");
    let whole = std::fs::read(&file).unwrap();
    std::fs::write(&file, &whole[..whole.len() - 10]).unwrap();
    let site = Site::with(options(folder));
    assert!(site.server.as_ref().unwrap().truncated_bytes() > 0);
    let last: Value = site.journal().pop().unwrap();
    assert!(last["deed"] == "started" && last["detail"]["cut"].as_u64().unwrap() > 0, "{last}");
    assert!(polepair_serve::journal::verify(&file).unwrap().is_ok());
    site.end();
}
