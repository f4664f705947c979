//! An axis of a running server is an axis of a C program.

use std::path::PathBuf;
use std::process::Command;

use polepair::Connector;
use polepair_serve::{GatewayServer, ServerOptions};
use polepair_test_support::c_program::{root, run, test_folder};
use polepair_test_support::wait_until;

use crate::programs::LIBRARY;

/// Two modules at addresses 1 and 3.
const DRIVES: &str = "sim:tmcl:1,3";

fn example(name: &str) -> Command {
    let source = root().join("examples/c").join(name).with_extension("c");
    Command::new(LIBRARY.build("gcc", &source, &["-std=c11"]))
}

#[test]
fn axes_of_a_server_are_read_written_watched_and_turned() {
    let folder = test_folder("served");
    let options = ServerOptions {
        bind: "127.0.0.1:0".parse().expect("an address"),
        folder: folder.clone(),
        ..ServerOptions::in_folder(PathBuf::new())
    };
    let server = GatewayServer::start(&options, &[DRIVES.into()], Connector::default());
    let server = server.expect("a server");
    let tokens = folder.join("tokens");
    let url = |axes: &str| {
        format!("ws://127.0.0.1:{}?token-file={}{axes}", server.address().port(), tokens.display())
    };

    let text = run(example("parameters").arg(url("#1")).arg("max current"));
    assert!(text.contains("max current = 10 A (on the wire 100)"), "{text}");
    assert!(text.contains("E216"), "{text}");

    let text = run(example("watch").arg(url("")).arg("5"));
    assert!(text.contains("axis 1") && text.contains("axis 3"), "{text}");
    assert_eq!(text.matches("position 0.0000").count(), 10, "{text}");

    let text = run(example("spin").arg(url("#3")).arg("60 rpm").arg("2"));
    let last = text.trim_end().rsplit('\n').next().and_then(|line| line.strip_suffix(" rpm"));
    let speed: f64 = last.and_then(|number| number.parse().ok()).expect("a speed");
    assert!((speed - 60.0).abs() < 3.0, "{text}");
    let is_off = || {
        let state = server.bench().axis_state(1).expect("the second axis");
        state.enabled == Some(false) && state.moving == Some(false) && !state.armed
    };
    wait_until("the axis is switched off and at rest", is_off);
}
