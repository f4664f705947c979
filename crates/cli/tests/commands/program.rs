//! Programs made, loaded into simulated drives on real pseudo-terminals, run and ended.
#![cfg(unix)]

use crate::run;

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::Child;
use std::time::Duration;

use run::{Ran, polepair};

const MOVES: &str = "\
main: ENDINIT; TPOS = APOS; AXISON
      CSPD = 30; CACC = 0.5
loop: CPOS = 20000L; CALL move
      CPOS = 0L; CALL move
      GOTO loop
turn: ENDINIT; TPOS = APOS; AXISON; CSPD = 30; CACC = 0.5; CPOS = 4000L
      CALL move; AXISOFF; RET
move: MODE PP; CPA; TUM1; UPD; !MC; WAIT!; RET
";

/// A served drive and a folder for its programs.
struct Bench {
    child: Child,
    url: String,
    folder: PathBuf,
}

impl Bench {
    fn new(name: &str) -> Self {
        Self::of("tml:1", name)
    }

    fn of(drive: &str, name: &str) -> Self {
        let mut child = run::command(&["sim", drive]).spawn().expect("starts");
        let mut lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
        let line = lines.next().expect("a line").expect("text");
        let url = line.strip_prefix("ready ").expect("ready").to_owned();
        let folder = std::env::temp_dir().join(format!("polepair-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        Self { child, url, folder }
    }

    /// A file with that text.
    fn file(&self, name: &str, text: &str) -> String {
        let path = self.folder.join(name);
        std::fs::write(&path, text).expect("a file");
        path.display().to_string()
    }

    fn path(&self, name: &str) -> String {
        self.folder.join(name).display().to_string()
    }

    fn program(&self, verb: &str, arguments: &[&str]) -> Ran {
        polepair(&[&["program", verb, &self.url], arguments].concat())
    }

    fn ok(&self, verb: &str, arguments: &[&str]) -> String {
        let ran = self.program(verb, arguments);
        assert_eq!(ran.code, 0, "{verb} {arguments:?}: {}{}", ran.out, ran.err);
        ran.err
    }

    fn get(&self, name: &str) -> f64 {
        let ran = polepair(&["get", &self.url, "--raw", name]);
        let value = ran.out.rsplit(' ').next().and_then(|text| text.trim().parse().ok());
        value.unwrap_or_else(|| panic!("{name}: {}{}", ran.out, ran.err))
    }

    fn axis_is_on(&self) -> bool {
        self.get("SRL") as u32 & 0x8000 != 0
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

fn interrupt(child: &Child) {
    let pid = child.id().to_string();
    std::process::Command::new("kill").args(["-INT", &pid]).status().expect("kill");
}

#[test]
fn a_program_is_loaded_called_and_run_until_ctrl_c() {
    let bench = Bench::new("run");
    let moves = bench.file("moves.tml", MOVES);
    let output = bench.ok("load", &[&moves]);
    assert!(output.contains("8270 to ") && output.contains(", RAM"), "{output}");
    assert!(output.contains("words written and verified by the drive's checksum"), "{output}");
    assert!(bench.ok("verify", &[&moves]).contains("match"));
    assert!(bench.ok("verify", &[&moves, "--words"]).contains("words match"));
    let output = bench.ok("call", &["turn", "--source", &moves]);
    assert!(output.contains("Ctrl-C stops it; watchdog none: "), "{output}");
    assert!(output.contains("has returned"), "{output}");
    assert!((bench.get("APOS") - 4000.0).abs() < 20.0 && !bench.axis_is_on());
    let arguments = ["program", "run", &bench.url, "main", "--source", &moves];
    let mut child = run::command(&arguments).spawn().expect("starts");
    let mut lines = BufReader::new(child.stderr.take().expect("a pipe")).lines();
    let mut report = std::iter::from_fn(|| lines.next()?.ok());
    assert!(report.any(|line| line.contains("running; Ctrl-C stops it")));
    std::thread::sleep(Duration::from_millis(700));
    interrupt(&child);
    let texts: Vec<String> = report.collect();
    assert_eq!(child.wait().expect("ends").code(), Some(130), "{texts:?}");
    assert!(texts[0].contains("the program was ended and the motor stopped"), "{texts:?}");
    assert!(bench.get("APOS") > 5000.0, "it moved");
    assert!(!bench.axis_is_on(), "and takes the power off again");
    let stood = bench.get("APOS");
    std::thread::sleep(Duration::from_millis(300));
    assert!((bench.get("APOS") - stood).abs() < 5.0, "the program does not go on");
    let detached = bench.ok("run", &["main", "--source", &moves, "--detach"]);
    assert!(detached.contains("polepair program stop"), "{detached}");
    let refused = bench.program("load", &[&moves]);
    assert!(refused.code == 6 && refused.err.contains("has power"), "{}", refused.err);
    bench.ok("stop", &[]);
    let stood = bench.get("APOS");
    std::thread::sleep(Duration::from_millis(300));
    assert!((bench.get("APOS") - stood).abs() < 5.0, "at rest");
    polepair(&["disable", &bench.url]);
    bench.ok("load", &[&moves]);
}

#[test]
fn nothing_goes_to_the_eeprom_unasked_and_each_write_is_reported() {
    let bench = Bench::new("eeprom");
    let moves = bench.file("moves.tml", MOVES);
    let words = bench.path("moves.sw");
    let made = polepair(&["program", "assemble", &moves, "-o", &words, "--eeprom"]);
    assert_eq!(made.code, 0, "{}", made.err);
    assert!(made.err.contains("main = 0x4000") && made.err.contains("EEPROM"), "{}", made.err);
    let refused = bench.program("load", &[&words]);
    assert_eq!(refused.code, 2, "{}", refused.err);
    assert!(refused.err.contains("E222") && refused.err.contains("which wears"), "{}", refused.err);
    assert!(bench.program("verify", &[&words]).err.contains("E103"), "nothing was written");
    let output = bench.ok("load", &[&words, "--eeprom", "--dry-run"]);
    assert!(output.contains("nothing was written"), "{output}");
    assert_eq!(bench.program("verify", &[&words]).code, 1, "nothing was written");
    let output = bench.ok("load", &[&words, "--eeprom"]);
    assert!(output.contains("writes to the drive's permanent memory: "), "{output}");
    bench.ok("verify", &[&words]);
    let saved = bench.path("saved.sw");
    bench.ok("save", &[&saved]);
    let read = |path: &str| std::fs::read_to_string(Path::new(path)).expect("a file");
    assert_eq!(read(&saved), read(&words), "what was loaded is what is there");
    let listing = bench.path("saved.tml");
    bench.ok("save", &[&listing]);
    assert!(read(&listing).contains("MODE PP"), "{}", read(&listing));
    let again = polepair(&["program", "assemble", &listing, "--eeprom"]);
    assert_eq!(again.out, read(&words));
    let other = bench.file("other.sw", "4000\n0001\n0002\n");
    let differs = bench.program("verify", &[&other]);
    assert!(differs.err.contains("has different words at 4000 to 4001"), "{}", differs.err);
    let differs = bench.program("verify", &[&other, "--words"]);
    assert!(differs.code == 1 && differs.err.contains("4001: "), "{}", differs.err);
}

#[test]
fn wrong_programs_are_refused_with_file_line_and_place() {
    let bench = Bench::new("wrong");
    let refused = |arguments: &[&str]| {
        let ran = polepair(arguments);
        assert_eq!(ran.code, 2, "{arguments:?}: {}", ran.err);
        ran.err
    };
    let wrong = bench.file("wrong.tml", "NOP\n  GOTO nowhere\n");
    let output = refused(&["program", "assemble", &wrong]);
    assert!(output.contains("wrong.tml:2:8: `nowhere`: expected an address"), "{output}");
    let wrong = bench.file("wrong.sw", "4000\nxyz\n");
    let output = refused(&["program", "load", &bench.url, &wrong, "--eeprom"]);
    assert!(output.contains("wrong.sw:2:1: `xyz` is no word"), "{output}");
    let moves = bench.file("moves.tml", MOVES);
    let output = refused(&["program", "load", &bench.url, &moves, "--at", "0x8000"]);
    assert!(output.contains("RAM begins at 0x8270"), "{output}");
    let output = refused(&["program", "load", &bench.url, &moves, "--ram", "--at", "0x4000"]);
    assert!(output.contains("lies in the EEPROM"), "{output}");
    let output = refused(&["program", "call", &bench.url, "move"]);
    assert!(output.contains("--source FILE"), "{output}");
    let output = refused(&["program", "call", &bench.url, "moves", "--source", &moves]);
    assert!(output.contains("has no label") && output.contains("turn"), "{output}");
    let output = refused(&["program", "load", "sim:tmcl", &moves]);
    assert!(output.contains("E242") && output.contains("its text is called .tmc"), "{output}");
    let output = refused(&["program", "load", "sim:modbus-rtu", &moves]);
    assert!(output.contains("E218"), "{output}");
    assert!(!bench.axis_is_on());
}

const TMCL: &str = "\
// Motor 2 and a variable
Far = 400
        SAP 140, 2, 4
Loop:   MVP ABS, 2, Far
        WAIT POS, 2, 0
        CSUB Count
        JC NE, Loop
        STOP
Count:  GGP 1, 2
        CALC ADD, 1
        AGP 1, 2
        COMP 2
        RSUB
";

#[test]
fn a_tmcl_program_is_loaded_run_and_stepped_through() {
    let bench = Bench::of("tmcm-6110", "tmcl-program");
    let text = bench.file("moves.tmc", TMCL);
    let assembled = polepair(&["program", "assemble", &text]);
    assert!(assembled.out.contains("Count:\n    GGP 1, 2"), "{}", assembled.out);
    assert!(bench.ok("load", &[&text, "--dry-run"]).contains("nothing was written"));
    assert!(bench.ok("load", &[&text]).contains("11 instructions stored and verified"));
    assert!(bench.ok("verify", &[&text]).contains("11 instructions match"));
    let ended = bench.ok("run", &["--source", &text]);
    assert!(
        ended.contains("the program ended after 5  STOP") && ended.contains("moves.tmc:8"),
        "{ended}"
    );
    assert!((bench.get("user variable 1") - 2.0).abs() < 1e-9);
    let steps = bench.program("step", &["--reset", "--count", "3", "--source", &text]);
    let lines: Vec<&str> = steps.out.lines().collect();
    assert_eq!(lines.len(), 4, "{}{}", steps.out, steps.err);
    assert!(
        lines[3].starts_with("   3  CSUB Count") && lines[3].ends_with("moves.tmc:6"),
        "{lines:?}"
    );
    let at = bench.program("break", &[":9", "--source", &text, "--count", "1"]);
    let lines: Vec<&str> = at.out.lines().collect();
    assert!(
        lines[0].starts_with("   6  GGP 1, 2") && lines[1].starts_with("   7  CALC ADD, 1"),
        "{lines:?}"
    );
    let back = bench.path("back.bin");
    bench.ok("save", &[&back]);
    assert_eq!(std::fs::metadata(&back).expect("a file").len(), 11 * 8);
    assert!(bench.ok("verify", &[&back]).contains("match"));
    let wrong = bench.file("wrong.tmc", "STOP\nMPV ABS, 0, 1");
    let refused = bench.program("load", &[&wrong]);
    assert!(
        refused.code == 2 && refused.err.contains("wrong.tmc:2:1: no instruction `MPV`"),
        "{}",
        refused.err
    );
    let endless = bench.file("endless.tmc", "Loop: ROR 3, 100\nJA Loop");
    bench.ok("load", &[&endless]);
    bench.ok("run", &["--detach"]);
    let busy = bench.program("load", &[&endless]);
    assert!(busy.code == 2 && busy.err.contains("a program runs in the module"), "{}", busy.err);
    bench.ok("stop", &[]);
    bench.ok("load", &[&text]);
}
