//! More connections than the system lets a process have.

use std::net::TcpStream;

use serde_json::json;

use super::site::{Folder, Site};

/// Files that the server may have open, and connections that want in.
const FILES: u32 = 300;
const CONNECTIONS: usize = 600;

/// Threat 11: clients that only open sockets make room, clients with a token stay.
#[test]
fn idle_sockets_beyond_the_limit_keep_no_client_out() {
    let folder = Folder::new();
    let site = Site::limited(&folder, &["sim:tmcl"], &format!("-n {FILES}"));
    let mut first = site.live();
    let idle: Vec<TcpStream> = (0..CONNECTIONS).map(|_| site.connect()).collect();
    assert!(site.get("/api/v1/bench").contains("tmcm"), "who has a token gets in");
    first.send(&json!({ "type": "stop", "axes": [0] }));
    let stopped = first.next("stopped");
    assert_eq!(stopped["axes"][0]["id"], 0, "{stopped}");
    let metrics = site.get("/metrics");
    let open = metrics.lines().find(|line| line.starts_with("polepair_connections "));
    let open = open.and_then(|line| line.rsplit(' ').next()?.parse::<usize>().ok());
    assert!(open.is_some_and(|open| open < FILES as usize), "{open:?}");
    drop(idle);
}
