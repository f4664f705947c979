//! A machine by the names of its `polepair.toml`.

use crate::run;

use std::path::PathBuf;

use run::{Ran, command, ran};

const RACK: &str = "\
[[link]]
name = 'cell'
kind = 'can'
[[link.drive]]
name = 'x'
profile = 'tmcm-171'
address = 3
lead = '5 mm'
limits = { position = ['-20 mm', '20 mm'], velocity = '40 mm/s' }
[[link.drive]]
name = 'y'
profile = 'tmcm-171'
address = 4
lead = '5 mm'
direction = 'inverted'
";

/// A folder with that file, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = format!("polepair-cli-rack-{}-{name}", std::process::id());
        let folder = std::env::temp_dir().join(folder);
        std::fs::create_dir_all(&folder).expect("a folder");
        std::fs::write(folder.join("polepair.toml"), RACK).expect("a file");
        Self(folder)
    }

    fn polepair(&self, arguments: &[&str]) -> Ran {
        ran(command(arguments).current_dir(&self.0).output().expect("it runs"))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn named_axes_move_in_the_machines_units() {
    let folder = Folder::new("moves");
    let moved = folder.polepair(&["move", "@cell?time=virtual#x,y", "10mm"]);
    assert_eq!(moved.code, 0, "{}", moved.err);
    assert_eq!(moved.out.matches("position = 10 mm").count(), 2, "{}", moved.out);
    assert!(moved.err.contains("is simulated"), "{}", moved.err);
    // The one that may is not started when another may not.
    let refused = folder.polepair(&["move", "@cell?time=virtual#y,x", "25mm", "-v"]);
    assert_eq!(refused.code, 2, "{}", refused.err);
    assert!(refused.err.contains("E223") && refused.err.contains("polepair.toml:9"));
    assert!(!refused.err.contains("MVP"), "{}", refused.err);
    let watched = folder.polepair(&["watch", "@cell?time=virtual#x", "velocity", "--for", "10ms"]);
    assert!(watched.out.contains("velocity [mm/s]"), "{}", watched.out);
}

#[test]
fn a_held_speed_ends_before_the_axis_does() {
    let folder = Folder::new("spins");
    let held = folder.polepair(&["spin", "@cell#x", "40mm/s", "--for", "60s"]);
    assert_eq!(held.code, 1, "{}", held.err);
    assert!(held.err.contains("E105") && held.err.contains("-20 mm to 20 mm"), "{}", held.err);
    let left = folder.polepair(&["spin", "@cell?time=virtual#x", "10mm/s", "--detach"]);
    assert_eq!(left.code, 2, "{}", left.err);
    let fast = folder.polepair(&["spin", "@cell?time=virtual#x", "50mm/s"]);
    assert!(fast.code == 2 && fast.err.contains("its limit, 40 mm/s"), "{}", fast.err);
}

#[test]
fn a_bus_is_asked_for_each_protocol_once() {
    let folder = Folder::new("scan");
    let ran = folder.polepair(&["scan", "canopen,canopen+udp://239.74.163.77:43177"]);
    assert!(ran.code == 2 && ran.err.contains("given twice"), "{}", ran.err);
}
