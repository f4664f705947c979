//! Links that are dead when a server starts: the motors of the others can be stopped, and the axes of
//! the dead ones join when their links open.

use polepair_link::tcp::TcpServer;
use polepair_test_support::wait_until;
use serde_json::{Value, json};

use super::site::{Folder, Site};
use super::wire::Drive;
use crate::run::{self, Served};

/// Returns an address on which no server listens.
fn free() -> String {
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    free.to_string()
}

fn state_of(bench: &Value, link: usize) -> &str {
    bench["links"][link]["state"].as_str().unwrap()
}

/// Ends the lock that a stop of everything leaves.
fn release(live: &mut super::site::Live) {
    live.send(&json!({ "type": "release" }));
    live.next("unlocked");
}

#[test]
fn a_dead_link_keeps_no_motor_of_the_others_from_being_stopped_and_joins_when_it_opens() {
    let (folder, address) = (Folder::new(), free());
    let dead = format!("tmcl+tcp://{address}#1");
    // The dead one comes first: its number is its own, its axes come last.
    let site = Site::new(&folder, &[&dead, "sim:tmcl:1"]);
    let mut live = site.live();
    let link = &live.bench["links"][0];
    assert_eq!((state_of(&live.bench, 0), state_of(&live.bench, 1)), ("not_open", "open"));
    assert_eq!((&link["url"], &link["medium"]), (&json!(dead), &json!("serial")), "{link}");
    assert_eq!((&link["error"]["code"], link["id"].as_u64()), (&json!("E314"), Some(0)), "{link}");
    assert!(!link["error"]["hint"].as_str().unwrap().is_empty(), "{link}");
    assert!(link["since_ms"].as_f64().is_some_and(|ms| ms > 1.6e12), "{link}");
    let axes = live.bench["axes"].as_array().unwrap().clone();
    assert_eq!((axes.len(), &axes[0]["link"]), (1, &json!(1)));
    live.spin(0, 20.0);
    let stopped = site.run(&["stop"]);
    assert_eq!(stopped.code, 7, "{stopped:?}");
    let output = &stopped.err;
    assert!(output.contains("axis 1 of link 1 is stopped"), "{output}");
    assert!(output.contains(&format!("no motor of link 0 received a stop: {dead}")), "{output}");
    assert!(output.contains("cut the supply of motors that turn there"), "{output}");
    let seen = site.run(&["monitor", "--once"]);
    assert!(seen.out.contains("LINK 0 IS NOT OPEN for"), "{seen:?}");
    assert!(seen.out.contains("(E314)") && seen.out.contains(&dead), "{seen:?}");
    let records = folder.journal();
    let link = records.iter().find(|record| record["deed"] == "link").expect("a record");
    assert_eq!(link["detail"]["error"]["code"], "E314", "{link}");

    let drive = Served::with(&["tmcl:1", "--tcp", &address]);
    let bench = live.until("bench", |bench| state_of(bench, 0) == "open");
    let axes = bench["axes"].as_array().unwrap();
    let of = |n: usize| (axes[n]["id"].as_u64(), axes[n]["link"].as_u64());
    assert_eq!((axes.len(), of(0), of(1)), (2, (Some(0), Some(1)), (Some(1), Some(0))));
    assert_eq!(bench["links"][0]["error"], Value::Null);
    // Who stopped everything meant these as well.
    live.until("stopped", |value| value["axes"][0]["id"] == 1);
    live.until("axis", |state| state["id"] == 1 && state["pending_stop"].is_null());
    release(&mut live);
    live.spin(1, 20.0);
    let stopped = site.run(&["stop"]);
    assert_eq!(stopped.code, 0, "{stopped:?}");
    assert!(!stopped.err.contains("link 0 was told"), "{stopped:?}");
    let is_open = |record: &&Value| record["deed"] == "link" && record["detail"]["open"] == true;
    let records = folder.journal();
    let joined = records.iter().find(is_open).expect("a record");
    assert_eq!(joined["detail"]["axes"], json!([1]), "{joined}");
    drop((site, drive));
}

#[test]
fn a_pending_stop_of_the_previous_server_is_sent_when_its_dead_link_opens() {
    let folder = Folder::new();
    let end = TcpServer::bind("127.0.0.1:0").unwrap();
    let address = end.address().to_string();
    let url = format!("tmcl+tcp://{address}#1");
    let mut drive = Drive::on(Box::new(end), "tmcl:1");
    let urls = ["sim:tmcl:1", url.as_str()];
    let mut site = Site::new(&folder, &urls);
    let mut live = site.live();
    live.spin(1, 20.0);
    drive.unplug();
    live.until("bench", |bench| state_of(bench, 1) == "lost");
    live.until("axis", |state| state["id"] == 1 && !state["pending_stop"].is_null());
    // A record is flushed to the operating system before it is reported.
    site.signal("KILL");
    drop(site);
    assert!(drive.truth().velocity.abs() > 10.0, "nobody reached it");

    let mut site = Site::new(&folder, &urls);
    let mut live = site.live();
    let link = &live.bench["links"][1];
    assert_eq!(
        (state_of(&live.bench, 1), &link["pending_stops"]),
        ("not_open", &json!([1])),
        "{link}"
    );
    let seen = site.run(&["monitor", "--once"]);
    assert!(seen.out.contains("AXIS 1 OF LINK 1 MAY BE TURNING, CUT ITS SUPPLY"), "{seen:?}");
    // It ends before the link is back: the debt outlives that, too.
    assert_eq!(site.signal("TERM"), Some(7), "one was not seen standing");
    let text = site.output();
    assert!(text.contains(&format!("axis 1 of {url} received a stop")), "{text}");
    assert!(drive.truth().velocity.abs() > 10.0, "nobody reached it");

    let site = Site::new(&folder, &urls);
    live = site.live();
    drive.plug(Box::new(TcpServer::bind(&address).unwrap()));
    let bench = live.until("bench", |bench| state_of(bench, 1) == "open");
    assert_eq!(bench["axes"][1]["link"], 1, "{bench}");
    drive.wait_standstill();
    live.until("axis", |state| state["id"] == 1 && state["pending_stop"].is_null());
    let ended = |record: &Value| record["deed"] == "stop_ended" && record["detail"]["link"] == url;
    wait_until("its end is written", || folder.journal().iter().any(ended));
    assert_eq!(bench["links"][1]["pending_stops"], json!([]), "{bench}");
}

fn dismissing(words: &str) -> [&str; 6] {
    ["dismiss", words, "--reason", "drive-gone", "--note", "scrapped"]
}

/// Without this, a drive that was removed for good would be reported for ever.
#[test]
fn a_pending_stop_of_the_previous_server_for_a_missing_drive_can_be_dismissed() {
    let folder = Folder::new();
    let end = TcpServer::bind("127.0.0.1:0").unwrap();
    let address = end.address().to_string();
    let url = format!("tmcl+tcp://{address}#1");
    let mut drive = Drive::on(Box::new(end), "tmcl:1");
    let mut site = Site::new(&folder, &["sim:tmcl:1", &url]);
    let mut live = site.live();
    live.spin(1, 20.0);
    drive.unplug();
    live.until("axis", |state| state["id"] == 1 && !state["pending_stop"].is_null());
    site.signal("KILL");
    drop(site);

    // Each server after it has it still: one that has the link, and one that has it not.
    let mut site = Site::new(&folder, &["sim:tmcl:1", &url]);
    live = site.live();
    assert_eq!(live.bench["links"][1]["pending_stops"], json!([1]), "{}", live.bench);
    for wrong in ["1#2", "0#1,2", "1#1,2", "0#7", "tmcl+tcp://127.0.0.1:1#1"] {
        let ran = site.run(&dismissing(wrong));
        assert_ne!(ran.code, 0, "{wrong}: {ran:?}");
    }
    let ran = site.run(&dismissing("1#1"));
    assert_eq!(ran.code, 0, "{ran:?}");
    assert!(ran.err.contains(&format!("axis 1 of {url} has no pending stop any more")), "{ran:?}");
    live.until("bench", |bench| bench["links"][1]["pending_stops"] == json!([]));
    let ran = site.run(&dismissing(&format!("{url}#1")));
    assert_eq!(ran.code, 2, "no stop is pending now: {ran:?}");
    let records = folder.journal();
    let ended = records.iter().rfind(|record| record["deed"] == "stop_ended").expect("a record");
    assert_eq!(ended["detail"]["note"], "scrapped", "{ended}");
    assert_eq!(site.signal("TERM"), Some(0), "{}", site.output());

    let mut site = Site::new(&folder, &["sim:tmcl:1"]);
    assert_eq!(site.signal("TERM"), Some(0));
    assert!(!site.output().contains("received a stop"), "{}", site.output());
}

#[test]
fn a_connection_string_that_is_wrong_ends_a_server_before_anything_is_opened() {
    let (folder, end) = (Folder::new(), std::net::TcpListener::bind("127.0.0.1:0").unwrap());
    let good = format!("tmcl+tcp://{}#1", end.local_addr().unwrap());
    end.set_nonblocking(true).unwrap();
    let state = folder.path("state");
    for wrong in ["tmcl+tpc://10.0.0.5", "tmcl+tcp://127.0.0.1:1?profile=nobody#1", "sim:nothing"] {
        let ran =
            run::polepair(&["serve", "--bind", "127.0.0.1:0", "--state", &state, &good, wrong]);
        assert_ne!(ran.code, 0, "{wrong}: {ran:?}");
        assert!(end.accept().is_err(), "{wrong}: nobody connected before that was told");
    }
}

#[test]
fn a_server_of_dead_links_alone_starts_and_waits_for_them() {
    let (folder, address) = (Folder::new(), free());
    let missing = format!("tmcl+serial://{}#1", folder.path("line"));
    let site = Site::new(&folder, &[&missing, &format!("tmcl+tcp://{address}#1")]);
    let mut live = site.live();
    let code = |n: usize| live.bench["links"][n]["error"]["code"].clone();
    assert_eq!((code(0), code(1)), (json!("E311"), json!("E314")));
    let drive = Served::with(&["tmcl:1", "--tcp", &address]);
    live.until("bench", |bench| state_of(bench, 1) == "open" && state_of(bench, 0) == "not_open");
    live.spin(0, 20.0);
    drop(drive);
}

#[test]
fn a_rack_with_a_dead_link_serves_its_other_links() {
    let (folder, address) = (Folder::new(), free());
    let drive = Served::with(&["tmcl:1", "--tcp", "127.0.0.1:0"]);
    let here = drive.url.split("//").nth(1).unwrap().split(['?', '#']).next().unwrap().to_owned();
    let link = |name: &str, address: &str| {
        format!(
            "[[link]]\nname = \"{name}\"\nprotocol = \"tmcl\"\nconnect = \"tcp://{address}\"\n\
             [[link.drive]]\nprofile = \"tmcm-171\"\naddress = 1\n"
        )
    };
    let file = folder.path("cell.toml");
    std::fs::write(&file, link("gone", &address) + &link("here", &here)).unwrap();
    let site = Site::new(&folder, &[&format!("rack:{file}")]);
    let mut live = site.live();
    assert_eq!((state_of(&live.bench, 0), state_of(&live.bench, 1)), ("not_open", "open"));
    let url = live.bench["links"][0]["url"].as_str().unwrap();
    assert!(url.ends_with("?link=gone"), "{url}");
    live.spin(0, 20.0);
    live.send(&json!({ "type": "stop" }));
    live.until("stopped", |value| value["axes"][0]["class"] == "standing");
}

#[test]
fn a_drive_that_does_not_answer_keeps_no_other_of_its_line_from_being_served() {
    run::expect_silence();
    let folder = Folder::new();
    let drive = Served::with(&["tmcl:1", "--tcp", "127.0.0.1:0"]);
    let url = format!("{}#1,3", drive.url.split('#').next().unwrap());
    let site = Site::new(&folder, &[&url]);
    let mut live = site.live();
    let link = &live.bench["links"][0];
    assert_eq!((state_of(&live.bench, 0), &link["absent"][0]["number"]), ("open", &json!(3)));
    assert_eq!(link["absent"][0]["error"]["code"], "E401", "{link}");
    live.spin(0, 20.0);
}
