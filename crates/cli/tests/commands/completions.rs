//! Shell completion, `help`, and `--quiet`.

use crate::run::{self, ok, polepair};

/// Completion candidates for the last word.
fn candidates(words: &[&str]) -> Vec<String> {
    let index = (words.len() - 1).to_string();
    let output = run::command(&[&["--"], words].concat())
        .env("POLEPAIR_COMPLETE", "bash")
        .env("_CLAP_COMPLETE_INDEX", index)
        .output()
        .expect("starts");
    let ran = run::ran(output);
    assert_eq!((ran.code, &*ran.err), (0, ""), "{words:?}");
    ran.out.lines().map(str::to_owned).collect()
}

#[test]
fn words_are_completed_by_what_there_is() {
    assert_eq!(candidates(&["polepair", "spi"]), ["spin"]);
    assert_eq!(candidates(&["polepair", "spin", "sim:tmcm-17"]), ["sim:tmcm-171", "sim:tmcm-170"]);
    let ways = candidates(&["polepair", "info", "tmcl+"]);
    assert!(ways.iter().any(|way| way == "tmcl+tcp://"), "{ways:?}");
    assert!(ways.iter().any(|way| way == "tmcl+socketcan://"), "{ways:?}");
    let ways = candidates(&["polepair", "info", "modbus-rtu+"]);
    assert!(!ways.iter().any(|way| way.contains("can")), "{ways:?}");
    let parameters = candidates(&["polepair", "get", "sim:tmcm-171", "max"]);
    assert!(parameters.contains(&"max current".to_owned()), "{parameters:?}");
    assert!(candidates(&["polepair", "set", "sim:tmcl", "max c"]) == ["max current="]);
    assert!(candidates(&["polepair", "set", "sim:tmcl", "supply"]).is_empty(), "it is read alone");
    let rack = concat!("sim:", env!("CARGO_MANIFEST_DIR"), "/../../docs/examples/cell.toml#");
    let axes = candidates(&["polepair", "move", &format!("{rack}x,")]);
    assert!(axes.contains(&format!("{rack}x,y")), "{axes:?}");
    let keys = candidates(&["polepair", "get", "tml+serial:///dev/ttyUSB0?timeout=50&w"]);
    assert_eq!(keys, ["tml+serial:///dev/ttyUSB0?timeout=50&wire="]);
    let words = candidates(&["polepair", "get", "tml+serial:///dev/ttyUSB0?wire="]);
    assert_eq!(words.len(), 2, "{words:?}");
    assert!(candidates(&["polepair", "get", "modbus-rtu+tcp://10.0.0.5:502?he"]).is_empty());
    assert!(candidates(&["polepair", "params", "thruster-s"]) == ["thruster-servo"]);
    assert!(candidates(&["polepair", "encode", "tml"]).contains(&"tml".to_owned()));
}

/// Bash takes `:` for the end of a word.
#[test]
fn bash_completes_connection_strings_and_names_with_spaces() {
    let binary = run::program();
    let folder = std::path::Path::new(&binary).parent().expect("a folder");
    let path = format!("{}:{}", folder.display(), std::env::var("PATH").unwrap_or_default());
    let script = r#"
        source <(polepair completions bash)
        complete -p polepair
        ask() {
            COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))
            _polepair polepair "${!#}" "" 2>/dev/null
            printf '%s|' "${COMPREPLY[@]}"
            echo
        }
        ask polepair info sim:tmcm-17
        ask polepair get sim:tmcm-171 "max c"
        ask polepair info sim:nothing-like-that"#;
    let output = std::process::Command::new("bash")
        .args(["--norc", "-c", script])
        .env("PATH", path)
        .output()
        .expect("bash");
    let ran = run::ran(output);
    let lines: Vec<&str> = ran.out.lines().collect();
    assert_eq!(lines[0], "complete -o bashdefault -F _polepair polepair", "{}", ran.err);
    assert_eq!(lines[1..], ["sim:tmcm-171|sim:tmcm-170|", "max current|", "|"], "{}", ran.err);
}

#[test]
fn every_shell_has_a_script() {
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = ok(&["completions", shell]);
        assert!(script.contains("polepair") && script.contains("POLEPAIR_COMPLETE"), "{script}");
    }
    assert_eq!(polepair(&["completions", "tcsh"]).code, 2);
}

#[test]
fn help_explains_a_verb() {
    let help = ok(&["help", "spin"]);
    assert_eq!(help, ok(&["spin", "--help"]));
    assert!(ok(&["help", "config", "save"]).contains("polepair config save"));
    assert_eq!(polepair(&["help", "sping"]).code, 2);
}

#[test]
fn quiet_leaves_out_notes_and_nothing_else() {
    let spin = ["spin", "sim:tmcl?time=virtual", "60rpm", "--for", "1s"];
    let (all, quiet) = (polepair(&spin), polepair(&[&["--quiet"][..], &spin].concat()));
    assert_eq!((all.code, &*all.out), (quiet.code, &*quiet.out));
    assert!(all.err.contains("Ctrl-C stops it; watchdog off: "), "{}", all.err);
    assert!(quiet.err.is_empty(), "{}", quiet.err);
    let wrong = polepair(&["get", "sim:tmcl", "no such thing", "-q"]);
    assert!(wrong.code == 2 && wrong.err.contains("error[E213]"), "{}", wrong.err);
    let detached = polepair(&["spin", "sim:tmcl", "60rpm", "--detach", "-q"]);
    assert!(detached.err.contains("left running"), "{}", detached.err);
}
