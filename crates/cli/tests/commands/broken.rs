//! Wrong configuration files: a stop needs none of them.
#![cfg(unix)]

use crate::run;

use polepair_test_support::wait_for;
use run::{Ran, Served, command, ran};
use std::path::{Path, PathBuf};

/// A folder with a broken `polepair.toml` and a configuration with a broken profile.
struct Broken(PathBuf);

impl Broken {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("polepair-{name}-{}", std::process::id()));
        let profiles = folder.join("config/polepair/profiles");
        std::fs::create_dir_all(&profiles).unwrap();
        std::fs::write(folder.join("polepair.toml"), "[links\narm = 3\n").unwrap();
        std::fs::write(profiles.join("mine.toml"), "name = \"mine\"\nprotcol = 1\n").unwrap();
        std::fs::write(folder.join("bad.eds"), "nothing\n").unwrap();
        Self(folder)
    }

    fn run(&self, arguments: &[&str]) -> Ran {
        let config: &Path = &self.0.join("config");
        let mut command = command(arguments);
        command.current_dir(&self.0).env("XDG_CONFIG_HOME", config);
        ran(command.output().expect("the binary runs"))
    }
}

impl Drop for Broken {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn a_command_that_needs_nothing_of_a_broken_file_is_not_refused() {
    let broken = Broken::new("broken");
    for arguments in [
        &["stop", "sim:tmcl"][..],
        &["disable", "sim:tmcl"],
        &["info", "sim:tmcl"],
        &["stop", "sim:tmcl", "--profile", "bad.eds"],
    ] {
        let ran = broken.run(arguments);
        let about = format!("{arguments:?}: {}", ran.err);
        assert_eq!(ran.code, 0, "{about}");
        for file in ["polepair.toml", "mine.toml"] {
            let reported = ran.err.lines().filter(|line| line.contains(file)).count();
            assert_eq!(reported, 1, "{about}");
        }
    }
}

#[test]
fn a_name_that_a_broken_file_could_define_is_refused_with_its_fault() {
    let broken = Broken::new("named");
    let ran = broken.run(&["stop", "@arm"]);
    assert!(ran.code == 2 && ran.err.contains("polepair.toml:1:"), "{}", ran.err);
    let ran = broken.run(&["info", "sim:tmcl?profile=mine"]);
    assert!(ran.code == 2 && ran.err.contains("mine.toml:2:"), "{}", ran.err);
    // A stop identifies the drive by its replies.
    let ran = broken.run(&["disable", "sim:tmcl?profile=mine"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
}

#[test]
fn an_unknown_profile_blocks_no_stop() {
    run::expect_silence();
    let broken = Broken::new("unknown");
    for drive in ["tmcl:1", "modbus-rtu:1", "tmcl+can:1", "cia402:5"] {
        let sim = Served::with(&[drive, "--tcp", "127.0.0.1:0"]);
        let (link, axes) = sim.url.split_once('#').expect("axes");
        let with = if link.contains('?') { '&' } else { '?' };
        let one = format!("{link}{with}profile=feeder#{axes}");
        let stopped = |verb, url: &str| {
            let ran = broken.run(&[verb, url]);
            let about = format!("{verb} {url}: {}", ran.err);
            assert_eq!(ran.err.matches("warning: profile=feeder: ").count(), 1, "{about}");
            if ran.code == 0 { Ok(()) } else { Err(about) }
        };
        for verb in ["stop", "disable"] {
            run::expecting_replies(|| stopped(verb, &one)).unwrap();
        }
        // Without axes, each address has 20 ms to reply in, which a busy machine may exceed.
        let everybody = format!("{link}{with}profile=feeder&timeout=10");
        wait_for("the drive is found and stopped", || stopped("stop", &everybody));
    }
    let ran = broken.run(&["info", "sim:tmcl?profile=feeder"]);
    assert!(ran.code == 2 && ran.err.contains("error[E213]"), "{}", ran.err);
    // A drive with another protocol.
    let ran = broken.run(&["stop", "sim:tmcl?profile=ts-rtu"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
}
