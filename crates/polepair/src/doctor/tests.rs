use super::{CheckResult, DoctorOptions, Grade, check_link};
use crate::Connector;
use crate::error::Exit;
use crate::wire::SharedLink;
use polepair_link::LinkIo as _;

fn checks(url: &str) -> Vec<CheckResult> {
    let mut checks = Vec::new();
    check_link(&Connector::default(), url, DoctorOptions::default(), &mut |check| {
        checks.push(check)
    })
    .expect("a string that can be read");
    checks
}

fn about<'a>(checks: &'a [CheckResult], about: &str) -> &'a CheckResult {
    checks.iter().find(|check| check.about == about).unwrap_or_else(|| panic!("{checks:?}"))
}

#[test]
fn a_sound_line_is_sound() {
    let found = checks("sim:tmcl?time=virtual");
    assert!(found.iter().all(|check| check.grade != Grade::Wrong), "{found:?}");
    assert!(about(&found, "echo").found.contains("do not return"));
    assert!(about(&found, "axis 1").found.contains("answers"));
}

#[test]
fn an_echo_is_reported_and_overcome() {
    let mut found = Vec::new();
    let connector = Connector::default();
    let url = connector.url("sim:tmcl?time=virtual&echo=yes").expect("a string");
    let (mut lines, _simulation) = connector.open_lines(&url).expect("a line");
    // The string lacks the property of the adapter.
    lines[0].options.echo = false;
    let on_event = &mut |check| found.push(check);
    super::check_line(&connector, &url, &mut lines[0], true, &mut false, on_event).expect("a line");
    assert_eq!(about(&found, "echo").grade, Grade::Wrong, "{found:?}");
    assert!(about(&found, "echo").remedy.contains("echo=yes"));
    assert!(found.iter().any(|check| check.found.contains("answers:")), "{found:?}");
}

#[test]
fn a_drive_in_a_mode_of_text_is_reported_with_the_way_back() {
    let mut found = Vec::new();
    let connector = Connector::default();
    let url = connector.url("sim:tmcm-1140?time=virtual").expect("a string");
    let (mut lines, _simulation) = connector.open_lines(&url).expect("a line");
    let SharedLink::Serial(link) = lines[0].link.clone() else { panic!("a serial line") };
    // Request 139 enters the mode.
    link.send(&[1, 139, 0, 0, 0, 0, 0, 0, 140]).expect("a link");
    let on_event = &mut |check| found.push(check);
    super::check_line(&connector, &url, &mut lines[0], true, &mut false, on_event).expect("a line");
    let told = found.iter().find(|check| check.found.contains("ASCII mode")).expect("told");
    assert!(told.about == "axis 1" && told.remedy.contains("`ABIN`"), "{told:?}");
    link.send(b"ABIN\r").expect("a link");
    assert!(found.iter().all(|check| check.about != "echo"), "{found:?}");
}

#[test]
fn a_port_that_is_not_there_is_reported_with_its_exit_code() {
    let found = checks("tmcl+serial:///dev/no-such-port");
    assert_eq!((found.len(), found[0].exit), (1, Exit::Adapter), "{found:?}");
}

#[test]
#[cfg(unix)]
fn a_bus_on_the_network_has_no_cable() {
    let found = checks("canopen+udp://239.74.163.9:47119?timeout=20ms#5");
    assert!(!about(&found, "port").found.contains("nobody else"), "{found:?}");
    assert!(about(&found, "traffic").remedy.contains("multicast"), "{found:?}");
    assert!(found.iter().all(|check| !check.remedy.contains("120 ohm")), "{found:?}");
}

#[test]
fn a_bus_is_listened_to() {
    let found = checks("sim:tmcl+can?time=virtual");
    assert!(about(&found, "bit rate").found.contains("bit/s"), "{found:?}");
    assert!(about(&found, "traffic").remedy.contains("120 ohm"));
}
