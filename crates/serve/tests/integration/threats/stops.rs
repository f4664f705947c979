//! T18: a stop is executed, whatever was sent before it and however it is written.

use serde_json::{Value, json};

use super::JSON;
use crate::site::{Site, now_ms};

/// A site whose axis 0 turns under the operator's lease, with its epoch.
fn turning(verb_id: &str) -> (Site, u64) {
    let site = Site::new();
    let lease = site.post("POST /api/v1/axes/0/lease", "operator", "{}").json();
    let epoch = lease["epoch"].as_u64().unwrap();
    for (verb, arguments, id) in
        [("arm", json!({}), "first"), ("velocity", json!({ "velocity": 10.0 }), verb_id)]
    {
        let outcome = command(&site, 0, epoch, id, verb, &arguments);
        assert_eq!(outcome["outcome"], "done", "{outcome}");
    }
    (site, epoch)
}

fn command(site: &Site, axis: u16, epoch: u64, id: &str, verb: &str, arguments: &Value) -> Value {
    let body = json!({ "id": id, "issued_ms": now_ms(), "ttl_ms": 10_000, "epoch": epoch,
                       "verb": verb, "arguments": arguments });
    site.post(&format!("POST /api/v1/axes/{axis}/commands"), "operator", &body.to_string()).json()
}

fn speed(site: &Site, axis: usize) -> f64 {
    site.server.as_ref().unwrap().bench().truth(axis as u16).unwrap().velocity.abs()
}

#[test]
fn t18_a_stop_with_a_known_id_is_executed() {
    for id in ["2", "first", "new"] {
        let (site, epoch) = turning("2");
        let stopped = command(&site, 0, epoch, id, "stop", &json!({}));
        assert_eq!((&stopped["outcome"], &stopped["replayed"]), (&json!("done"), &json!(false)));
        assert!(speed(&site, 0) < 0.1, "{id}: {}", speed(&site, 0));
        let again = command(&site, 0, epoch, id, "stop", &json!({}));
        assert_eq!(again["replayed"], false, "{again}");
        let reports = site.journal();
        let stops =
            reports.iter().filter(|r| r["detail"]["verb"] == "stop" && r["detail"]["id"] == id);
        assert_eq!(stops.count(), 2, "both are recorded");
        site.end();
    }
}

#[test]
fn t18_a_known_id_with_another_command_is_refused() {
    let (site, epoch) = turning("2");
    for (axis, verb, arguments) in [
        (0, "velocity", json!({ "velocity": 20.0 })),
        (0, "torque", json!({ "torque": 0.1 })),
        (1, "velocity", json!({ "velocity": 10.0 })),
    ] {
        let refused = command(&site, axis, epoch, "2", verb, &arguments);
        assert_eq!(refused["error"]["code"], "gateway.request", "{refused}");
    }
    let same = command(&site, 0, epoch, "2", "velocity", &json!({ "velocity": 10.0 }));
    assert_eq!((&same["outcome"], &same["replayed"]), (&json!("done"), &json!(true)));
    site.end();
}

#[test]
fn t18_what_can_be_read_of_a_stop_is_stopped() {
    for (body, refused) in [
        (r#"{"axes":[0,99]}"#, "axis 99"),
        (r#"{"axes":[70000,0]}"#, "axis 70000"),
        (r#"{"axes":[0.0,null]}"#, "axis null"),
        (r#"{"axes":[0],"all":true}"#, "all"),
        (r#"{"axes":0}"#, ""),
        ("{}", ""),
        ("", ""),
    ] {
        let (site, _) = turning("2");
        let answer = site.post("POST /api/v1/stop", "operator", body);
        assert_eq!(answer.status, 200, "{body}: {answer:?}");
        assert!(speed(&site, 0) < 0.1, "{body}: {}", speed(&site, 0));
        let report = answer.json();
        let messages = report["refused"].to_string();
        assert_eq!(report["refused"].is_null(), refused.is_empty(), "{body}: {report}");
        assert!(messages.contains(refused), "{body}: {messages}");
        site.end();
    }
    let (site, _) = turning("2");
    for body in [r#"{"axes":[99]}"#, r#"{"axes":[2,"x"]}"#, r#"{"axes":"every"}"#] {
        let answer = site.post("POST /api/v1/stop", "operator", body);
        assert_eq!((answer.status, answer.code().as_str()), (404, "gateway.missing"), "{body}");
    }
    assert!(speed(&site, 0) > 0.1, "none of these names it");
    site.end();
}

/// A page behind a proxy that asks for HTTP Basic, however often it was refused before.
#[test]
fn t18_a_page_with_another_authorization_stops() {
    let (site, _) = turning("2");
    let heads = format!(
        "{JSON}Cookie: {}\r\nOrigin: http://{}\r\nAuthorization: Basic dXNlcjpwYXNz\r\n",
        site.cookie(),
        site.address
    );
    for _ in 0..10 {
        let answer = site.send("POST /api/v1/stop", &heads, r#"{"axes":[0]}"#);
        assert_eq!(answer.status, 200, "{answer:?}");
    }
    assert!(speed(&site, 0) < 0.1);
    site.end();
}

/// A command whose record would be lost is refused; a stop is executed.
#[cfg(unix)]
#[test]
fn t14_motion_needs_the_journal_at_its_place() {
    for replaced in [false, true] {
        let (site, epoch) = turning("2");
        let journal = site.folder.join("journal.jsonl");
        std::fs::rename(&journal, site.folder.join("moved")).unwrap();
        if replaced {
            std::fs::write(&journal, "").unwrap();
        }
        let refused = command(&site, 0, epoch, "3", "velocity", &json!({ "velocity": 20.0 }));
        assert_eq!(refused["error"]["code"], "gateway.journal", "{refused}");
        let lease = site.post("POST /api/v1/axes/1/lease", "operator", "{}");
        assert_eq!((lease.status, lease.code().as_str()), (503, "gateway.journal"), "{lease:?}");
        let stopped = site.post("POST /api/v1/stop", "operator", r#"{"axes":[0]}"#);
        assert_eq!(stopped.status, 200, "{stopped:?}");
        assert!(speed(&site, 0) < 0.1);
        std::fs::rename(site.folder.join("moved"), &journal).unwrap();
        let lease = site.post("POST /api/v1/axes/1/lease", "operator", "{}");
        assert_eq!(lease.status, 200, "it is back: {lease:?}");
        site.end();
    }
}
