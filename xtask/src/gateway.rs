//! The swarm over the gateway is a program of its own: this tool is built without a server.

use std::path::Path;
use std::process::Command;

/// Returns whether these words of `swarm` mean the gateway.
pub fn is_requested(words: &[&str]) -> bool {
    words.windows(2).any(|pair| match pair {
        ["--on", "gateway"] => true,
        ["--replay", which] => which.starts_with("gateway:"),
        _ => false,
    })
}

/// Has Cargo make and run it.
///
/// # Errors
/// When Cargo cannot be run, or the swarm broke something.
pub fn run(root: &Path, words: &[&str]) -> Result<(), String> {
    let (debug, words): (Vec<&str>, Vec<&str>) = words.iter().partition(|word| **word == "--debug");
    let mut its: Vec<String> = Vec::new();
    let mut words = words.into_iter();
    while let Some(word) = words.next() {
        match (word, words.clone().next()) {
            ("--on", Some("gateway")) => drop(words.next()),
            ("--replay", Some(which)) => {
                its.extend([word.to_owned(), which.trim_start_matches("gateway:").to_owned()]);
                words.next();
            }
            _ => its.push(word.to_owned()),
        }
    }
    let release = debug.is_empty().then_some("--release");
    let status = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .args(["run", "--quiet"])
        .args(release)
        .args(["--package", "polepair-swarm", "--"])
        .args(its)
        .current_dir(root)
        .status()
        .map_err(|error| format!("cargo: {error}"))?;
    if status.success() { Ok(()) } else { Err("the swarm broke something, see above".into()) }
}
