//! Drives, and the core below them, build for a processor without an operating system.

use std::process::Command;

const TARGET: &str = "thumbv6m-none-eabi";

#[test]
fn drives_build_without_an_operating_system() {
    let sysroot = Command::new("rustc").args(["--print", "sysroot"]).output();
    let sysroot = sysroot.expect("rustc is there: it built this").stdout;
    let sysroot = String::from_utf8(sysroot).expect("a path in UTF-8");
    if !std::path::Path::new(sysroot.trim()).join("lib/rustlib").join(TARGET).exists() {
        eprintln!("skipped: the target {TARGET} is not installed (rustup target add {TARGET})");
        return;
    }
    let manifest = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
    let folder = concat!(env!("CARGO_TARGET_TMPDIR"), "/bare-metal");
    let built = Command::new(env!("CARGO"))
        .args(["check", "--quiet", "--offline", "--lib", "--target", TARGET])
        .args(["--manifest-path", manifest, "--target-dir", folder])
        .output()
        .expect("cargo runs");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
}
