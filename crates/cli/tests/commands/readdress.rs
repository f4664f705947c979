//! Drives that get another address, or answer another host.
#![cfg(unix)]

use crate::run;

use run::{Served, ok, polepair};

#[test]
fn the_hosts_own_address_is_refused_before_it_is_written() {
    let sim = Served::new("tmcl:1");
    let ran = polepair(&["set", &sim.url, "module address=2", "-v"]);
    assert_eq!(ran.code, 2, "{}", ran.err);
    assert!(ran.err.contains("error[E222]") && ran.err.contains("of this host"), "{}", ran.err);
    assert!(!ran.err.contains("SGP"), "{}", ran.err);
    assert_eq!(ok(&["get", &sim.url, "module address"]), "module address = 1\n");
    // What answers the module itself would look like requests to it.
    let ran = polepair(&["set", &sim.url, "host address=1"]);
    assert!(ran.code == 2 && ran.err.contains("error[E222]"), "{}", ran.err);
    sim.end();
}

#[test]
fn a_new_address_is_read_back_where_the_drive_then_is() {
    let sim = Served::new("tmcl:1,3");
    let one = format!("{}#1", sim.link());
    let ran = polepair(&["set", &one, "module address=3"]);
    assert!(ran.code == 2 && ran.err.contains("already has address 3"), "{}", ran.err);
    let ran = polepair(&["set", &sim.url, "module address=7"]);
    assert!(ran.code == 2 && ran.err.contains("error[E242]"), "{}", ran.err);

    let ran = polepair(&["set", &one, "module address=7"]);
    assert_eq!((ran.code, ran.out.as_str()), (0, "module address = 7\n"), "{}", ran.err);
    let new = format!("{}#7", sim.link());
    assert!(ran.err.contains(&format!("axis 1 is axis 7 from now on: {new}\n")), "{}", ran.err);
    assert_eq!(ok(&["get", &new, "module address"]), "module address = 7\n");
    sim.end();
}

#[test]
fn a_new_host_address_is_read_back_by_that_host() {
    let sim = Served::new("tmcl:1");
    let ran = polepair(&["set", &sim.url, "host address=9"]);
    assert_eq!((ran.code, ran.out.as_str()), (0, "host address = 9\n"), "{}", ran.err);
    let new = ran.err.lines().find_map(|line| line.split_once("from now on: ")).expect("a URL").1;
    assert!(new.contains("host=9"), "{new}");
    assert_eq!(ok(&["get", new, "host address"]), "host address = 9\n");
    sim.end();
}
