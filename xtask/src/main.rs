//! Tool drawer of the workspace: code generation, tidy checks, swarm and soak runs.
#![forbid(unsafe_code)]

mod c_header;
mod catalogue_pages;
mod codegen;
mod command_pages;
mod gateway;
mod instructions;
mod key_pages;
mod language;
mod links;
mod man;
mod pages;
mod picture;
mod pytrinamic;
mod release;
mod swarm;
mod tidy;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

const USAGE: &str = "\
usage: cargo xtask COMMAND
  codegen [--check]   profiles/*.toml as Rust constants and drive pages, or what is stale
  tidy                the architecture's never-rules, checked
  instructions [--write]  instructions for each frame of the bench's logs, counted by valgrind
  links DIR           the links of the documentation that `make site` built, checked
  man DIR             the command line's man pages, written into a folder
  picture             a terminal's output on stdin as an SVG picture on stdout
  pytrinamic PACKAGE  profiles of Trinamic's modules from the folder of an installed pytrinamic
  release VERSION [--dry-run]  one version in all files, the changelog's section, a commit and a tag
  swarm [--help] ...  seeded worlds with faults; `swarm --help` explains all of it";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let result = match words.as_slice() {
        ["codegen"] => codegen::run(&root(), false),
        ["codegen", "--check"] => codegen::run(&root(), true),
        ["tidy"] => tidy::run(&root()).map(|names| println!("{names}")),
        ["instructions"] => instructions::run(&root(), false),
        ["instructions", "--write"] => instructions::run(&root(), true),
        ["links", site] => links::run(Path::new(site)),
        ["man", folder] => man::run(Path::new(folder)),
        ["picture"] => picture::run(),
        ["pytrinamic", package] => pytrinamic::run(&root(), Path::new(package)),
        ["release", version] => release::run(&root(), version, false),
        ["release", version, "--dry-run"] => release::run(&root(), version, true),
        ["swarm", "--help" | "-h" | "help"] => {
            println!("{}", swarm::HELP);
            Ok(())
        }
        ["swarm", rest @ ..] if gateway::is_requested(rest) => gateway::run(&root(), rest),
        ["swarm", "--debug", rest @ ..] => swarm::run(rest),
        ["swarm", rest @ ..] if cfg!(debug_assertions) => in_release(rest),
        ["swarm", rest @ ..] => swarm::run(rest),
        _ => {
            eprintln!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            eprintln!("{reason}");
            ExitCode::FAILURE
        }
    }
}

/// Worlds go ten times as fast in a release build: hands over to one, which Cargo makes first.
fn in_release(words: &[&str]) -> Result<(), String> {
    let status = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .args(["run", "--quiet", "--release", "--package", "xtask", "--", "swarm"])
        .args(words)
        .current_dir(root())
        .status()
        .map_err(|e| format!("cargo: {e}"))?;
    if status.success() { Ok(()) } else { Err("the swarm broke something, see above".into()) }
}

/// The workspace's root, where this tool was built from.
fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().unwrap_or(here).to_path_buf()
}
