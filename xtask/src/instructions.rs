//! Instructions that decoding a frame takes: a change that makes it slower is noticed on any machine, however busy.
//!
//! They are counted in the build that tests use, whose code is far from that of a release. What counts is the change.
//! The figures of a release are in `docs/concepts/speed.md`.

use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

/// The committed counts.
const FILE: &str = "crates/columns/benches/instructions.txt";
const LOGS: [&str; 6] = ["mapped", "unmapped", "sdo", "thruster", "tmcl", "modbus"];
const OUTPUTS: [&str; 2] = ["text", "summary"];
/// Frames of a log. Those of the mapped one begin with 320 frames that map.
const FRAMES: &str = "2000";
/// Percent by which a count may rise, and by which one that fell is to be written anew.
const TOLERANCE: u64 = 5;

/// Counts, and compares with the committed counts; with `write` they become the committed ones.
pub(crate) fn run(root: &Path, write: bool) -> Result<(), String> {
    if Command::new("valgrind").arg("--version").output().is_err() {
        println!("instructions a frame: not counted, valgrind is not installed");
        return Ok(());
    }
    let compiler = compiler()?;
    let before = std::fs::read_to_string(root.join(FILE)).unwrap_or_default();
    if !write && before.lines().next() != Some(&compiler) {
        println!("instructions a frame: not compared, {FILE} is of another compiler");
        return Ok(());
    }
    let program = build(root)?;
    let frames: u64 = FRAMES.parse().map_err(|_| "frames are a number")?;
    let mut counts = format!("{compiler}\n");
    for log in LOGS {
        let generated = count(&program, log, "none")?;
        for output in OUTPUTS {
            let spent = count(&program, log, output)?.saturating_sub(generated) / frames;
            // Writing into a String cannot fail.
            let _ = writeln!(counts, "{log} {output} {spent}");
        }
    }
    if write {
        return std::fs::write(root.join(FILE), counts).map_err(|error| format!("{FILE}: {error}"));
    }
    compare(&before, &counts)
}

/// Compares counts line by line.
fn compare(before: &str, counts: &str) -> Result<(), String> {
    const ADVICE: &str = "`cargo xtask instructions --write` writes the counts anew";
    let mut risen = Vec::new();
    for (old, new) in before.lines().zip(counts.lines()).skip(1) {
        let number = |line: &str| line.rsplit(' ').next().and_then(|word| word.parse::<u64>().ok());
        let (Some(was), Some(is)) = (number(old), number(new)) else {
            return Err(format!("{FILE}: {old:?} has no number; {ADVICE}"));
        };
        if is * 100 > was * (100 + TOLERANCE) {
            risen.push(format!("{new} instructions a frame, {was} before"));
        } else if is * (100 + TOLERANCE) < was * 100 {
            println!("{new} instructions a frame, {was} before; {ADVICE}");
        }
    }
    if before.lines().count() != counts.lines().count() {
        risen.push(format!("{FILE} has other lines; {ADVICE}"));
    }
    if risen.is_empty() { Ok(()) } else { Err(risen.join("\n")) }
}

fn compiler() -> Result<String, String> {
    let told = Command::new("rustc").arg("--version").output();
    let told = told.map_err(|error| format!("rustc: {error}"))?;
    Ok(String::from_utf8_lossy(&told.stdout).trim().to_owned())
}

/// Builds the bench's example as tests are built, and returns its path.
fn build(root: &Path) -> Result<std::path::PathBuf, String> {
    let status = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .args(["build", "--locked", "--quiet", "--package", "polepair-columns"])
        .args(["--example", "captures"])
        .current_dir(root)
        .status()
        .map_err(|error| format!("cargo: {error}"))?;
    if !status.success() {
        return Err("the bench's example does not build".into());
    }
    let target = std::env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into());
    Ok(root.join(target).join("debug/examples/captures"))
}

/// Instructions of one run.
fn count(program: &Path, log: &str, output: &str) -> Result<u64, String> {
    let run = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
        .arg(program)
        .args([log, FRAMES, output])
        .output()
        .map_err(|error| format!("valgrind: {error}"))?;
    let report = String::from_utf8_lossy(&run.stderr);
    let collected = report.lines().find_map(|line| line.split_once("Collected :"));
    let number = collected.and_then(|(_, number)| number.trim().parse().ok());
    number.filter(|_| run.status.success()).ok_or_else(|| format!("valgrind: {report}"))
}

#[cfg(test)]
mod tests {
    use super::compare;

    #[test]
    fn a_count_may_rise_by_a_twentieth() {
        let counts = |one: u32, two: u32| format!("rustc\ntmcl text {one}\nsdo text {two}\n");
        assert!(compare(&counts(1000, 2000), &counts(1050, 1500)).is_ok());
        let risen = compare(&counts(1000, 2000), &counts(1051, 2101)).expect_err("both");
        assert_eq!(risen.lines().count(), 2, "{risen}");
        assert!(compare("rustc\n", &counts(1, 1)).is_err());
    }
}
