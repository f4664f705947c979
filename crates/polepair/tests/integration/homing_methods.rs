//! Every homing method of CiA 402 ends in a rack whose home switch fits it.

use polepair::connect_local;

/// Switches of the rack in rad: limits at a turn, and the home switch that a method looks for.
fn home_switch(method: i64) -> &'static str {
    match method {
        // A negative home switch: closed below.
        5 | 6 | 21 | 22 => "home = -1000.0\nhome_until = -2.0",
        // A home switch on the way.
        7..=14 | 23..=30 => "home = 2.0\nhome_until = 3.0",
        _ => "home = 3.1",
    }
}

#[test]
fn every_homing_method_ends_in_a_rack() {
    let methods = (1..=14).chain(17..=30).chain([33, 34, 35, 37]);
    for method in methods {
        let rack = format!(
            "[[link]]\nkind = 'can'\n[[link.drive]]\nname = 'x'\nprofile = 'cia402'\naddress = 5\n\
             limit_low = -6.3\nlimit_high = 6.3\n{}\n",
            home_switch(method)
        );
        let file = std::env::temp_dir()
            .join(format!("polepair-home-{}-{method}.toml", std::process::id()));
        std::fs::write(&file, rack).expect("a rack file");
        let link = connect_local(&format!("sim:{}?time=virtual#x", file.display())).expect("opens");
        std::fs::remove_file(&file).expect("it is read");
        let axis = &link.axes()[0];
        axis.set_raw("homing method", method).expect("a method");
        axis.arm(true);
        axis.enable().expect("enabled");
        axis.home().unwrap_or_else(|error| panic!("method {method}: {error}"));
    }
}
