//! Requests in a protocol's own text: who may, once, and never past the lock.

use polepair_serve::ServerOptions;
use polepair_test_support::wait_until;
use serde_json::{Value, json};

use super::site::{Answer, Site, folder, now_ms, options};

/// A site whose file has a token for raw requests, and that grants these scopes at most.
fn site(scopes: &str) -> Site {
    let folder = folder();
    drop(Site::with(options(folder.clone())));
    let file = folder.join("tokens");
    let mut tokens = std::fs::read_to_string(&file).unwrap();
    tokens += &format!("{} read,stop,move,raw expert\n", "cd".repeat(32));
    std::fs::write(&file, tokens).unwrap();
    Site::with(ServerOptions { scopes: scopes.parse().unwrap(), ..options(folder) })
}

fn lease(site: &Site) -> Value {
    site.post("POST /api/v1/axes/0/lease", "expert", "{}").json()["epoch"].clone()
}

fn say(site: &Site, id: &str, epoch: &Value, text: &str) -> Answer {
    let value =
        json!({ "id": id, "issued_ms": now_ms(), "ttl_ms": 5000, "epoch": epoch, "text": text });
    site.post("POST /api/v1/axes/0/raw", "expert", &value.to_string())
}

#[test]
fn t09_raw_requests_need_a_token_and_a_server_that_say_so() {
    let closed = site("read,stop,move,configure");
    let epoch = lease(&closed);
    assert_eq!(say(&closed, "a", &epoch, "GAP 1, 0").code(), "gateway.scope");
    closed.end();
    let open = site("read,stop,move,configure,raw");
    assert_eq!(say(&open, "a", &json!(0), "GAP 1, 0").code(), "gateway.lease");
    let epoch = lease(&open);
    let answer = say(&open, "b", &epoch, "GAP 1, 0").json();
    assert_eq!((&answer["outcome"], &answer["value"]), (&json!("done"), &json!(0)), "{answer}");
    let wrong = say(&open, "c", &epoch, "GAP 1, 0; MVP ABS").json();
    assert_eq!(wrong["error"]["executed"], json!(false), "{wrong}");
    open.end();
}

#[test]
fn t09_a_raw_request_is_sent_once_and_its_motion_ends_with_the_lease() {
    let site = site("read,stop,move,configure,raw");
    let bench = site.server.as_ref().unwrap().bench();
    let epoch = lease(&site);
    let refused = say(&site, "unarmed", &epoch, "ROR 0, 500").json();
    assert_eq!(refused["outcome"], "not_done", "{refused}");
    let renewed = || {
        let answer = site.post(
            "POST /api/v1/axes/0/lease/renew",
            "expert",
            &json!({ "epoch": epoch }).to_string(),
        );
        assert_eq!(answer.status, 200, "{answer:?}");
    };
    renewed();
    let arm = json!({ "id": "arm", "issued_ms": now_ms(), "ttl_ms": 5000, "epoch": epoch,
                      "verb": "arm" });
    site.post("POST /api/v1/axes/0/commands", "expert", &arm.to_string());
    renewed();
    let first = say(&site, "spin", &epoch, "ROR 0, 500").json();
    assert_eq!((&first["outcome"], &first["replayed"]), (&json!("done"), &json!(false)), "{first}");
    let again = say(&site, "spin", &epoch, "ROR 0, 500").json();
    assert_eq!((&again["outcome"], &again["replayed"]), (&json!("done"), &json!(true)));
    let reports = site.journal();
    let lines = reports.iter().filter(|r| r["deed"] == "command" && r["detail"]["id"] == "spin");
    assert_eq!(lines.count(), 1);
    let speed = || bench.truth(0).unwrap().velocity.abs();
    wait_until("it turns", || {
        renewed();
        speed() > 1.0
    });
    // The lease is not renewed.
    wait_until("it stands", || speed() < 1e-3);
    site.post("POST /api/v1/stop", "expert", "{}");
    let locked = say(&site, "after", &lease(&site), "ROR 0, 500");
    assert_eq!(locked.code(), "gateway.locked");
    assert!(speed() < 1e-3);
    site.end();
}
