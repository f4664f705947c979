//! Each rule refuses a small snippet that breaks it, and lets its decent twin through.

use super::module_names::ModuleNames;
use super::vocabulary::Vocabulary;
use super::{check_file, decisions, docs, programs, run};
use std::path::Path;

fn sample_names() -> ModuleNames {
    let list = |words: &[&str]| words.iter().map(|w| (*w).to_owned()).collect();
    ModuleNames { protocols: list(&["tmcl", "modbus"]), families: list(&["tmcm17x", "syntron_ts"]) }
}

fn check_sample(path: &str, text: &str) -> Vec<String> {
    check_file(path, text, &sample_names(), &mut Vocabulary::default())
}

#[test]
fn the_workspace_is_tidy() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    if let Err(broken) = run(root) {
        panic!("\n{broken}\n");
    }
}

#[test]
fn every_rule_refuses_a_snippet_that_breaks_it() {
    for (path, text, rule) in [
        ("crates/core/src/plan.rs", "use std::vec::Vec;", "rule 1: core uses std"),
        ("crates/core/src/plan.rs", "fn f() { std::mem::drop(1) }", "rule 1: core uses std"),
        ("crates/core/src/plan.rs", "extern crate std;", "rule 1: core uses std"),
        ("crates/core/src/plan.rs", "use alloc::vec::Vec;", "rule 1: core allocates"),
        ("crates/core/src/proto/tmcl/wire.rs", "use super::host::Host;", "rule 2: wire knows host"),
        ("crates/core/src/proto/tmcl/explain.rs", "use crate::time::Instant;", "rule 2: explain"),
        ("crates/core/src/proto/tmcl/host.rs", "use super::device::Device;", "rule 3: the host"),
        ("crates/core/src/proto/tmcl/device.rs", "use super::host::Host;", "rule 3: the device"),
        ("crates/core/src/proto/tmcl/host.rs", "use crate::proto::modbus::wire;", "rule 4: one p"),
        ("crates/core/src/proto/tmcl/host.rs", "use super::super::modbus::wire;", "rule 4: one p"),
        ("crates/drives/src/bench.rs", "use std::vec::Vec;", "rule 1: core uses std"),
        (
            "crates/drives/src/tmcm17x/axis.rs",
            "use super::super::syntron_ts::device as d;",
            "rule 4: one family",
        ),
        ("crates/core/src/lane.rs", "fn f() { crate::proto::tmcl::f() }", "rule 5: names `tmcl`"),
        ("crates/polepair/src/url.rs", "use polepair_core::proto::modbus;", "rule 5: names"),
        ("crates/cli/src/cmd/get.rs", "use polepair_drives::tmcm17x::f;", "rule 5: names"),
        ("crates/polepair/src/url.rs", "fn f() { std::time::Instant::now(); }", "rule 6: reads"),
        ("crates/link/src/tcp.rs", "fn f() { SystemTime::now(); }", "rule 6: reads"),
        ("crates/sim/src/world.rs", "fn f() { std::thread::sleep(d); }", "rule 6: sleeps"),
        ("crates/polepair/src/url.rs", "fn f() { thread::spawn(g); }", "rule 6: sleeps"),
        ("crates/link/src/tcp.rs", "async fn f() {}", "rule 7: an async fn"),
        ("crates/sim/src/lib.rs", "mod a;", "rule 13: neither forbids"),
        ("crates/cli/src/a.rs", "fn f() { File::create(path); }", "rule 16: writes a file"),
        ("crates/serve/src/a.rs", "fn f() { std::fs::write(path, text); }", "rule 16: writes"),
        ("crates/serve/src/a.rs", "use std::fs::rename;", "rule 16: writes a file"),
        ("crates/cli/src/a.rs", "fn f() { refused.message.contains(\"executed\"); }", "rule 14: a"),
        ("crates/cli/src/a.rs", "fn f() { error.to_string().split(\":\"); }", "rule 14: a"),
        ("crates/cli/src/a.rs", "fn f() { problem.what.as_str() == \"gone\"; }", "rule 14: a"),
        ("crates/cli/src/a.rs", "fn f() { e.hint().starts_with(\"try\"); }", "rule 14: a"),
        ("crates/sim/src/a.rs", "fn f((a, b): (u8, u8)) {}", "rule 18: a tuple"),
        ("crates/sim/src/a.rs", "/// What it has.\nstruct A;", "begins with \"What\""),
        ("crates/sim/src/a.rs", "//! How it goes.", "begins with \"How\""),
        ("crates/sim/src/a.rs", "// Nobody is told.", "\"nobody\" (write:"),
        ("crates/sim/src/a.rs", "struct WireManager;", "`Manager` says nothing"),
        ("crates/sim/src/a.rs", "enum FrameHandler {}", "`Handler` says nothing"),
        ("crates/sim/src/a.rs", "mod common;", "module `common` says nothing"),
        ("crates/sim/src/a.rs", "fn f() { todo!() }", "todo! is not done"),
        ("crates/sim/src/a.rs", "fn f( {", "it does not parse"),
    ] {
        let broken = check_sample(path, text);
        assert!(broken.iter().any(|b| b.contains(rule)), "{path}: {text}: {broken:?}");
    }
}

#[test]
fn long_files_and_wide_lines_are_refused_unless_generated() {
    let long = "\n".repeat(701);
    assert!(check_sample("crates/sim/src/a.rs", &long)[0].contains("701 lines"));
    let wide = format!("// {}", "x".repeat(118));
    assert!(check_sample("crates/sim/src/a.rs", &wide)[0].contains("121 columns"));
    let generated = format!("//! Generated from data.\n{long}{wide}");
    assert_eq!(check_sample("crates/sim/src/a.rs", &generated), [""; 0]);
}

#[test]
fn decent_code_passes() {
    for (path, text) in [
        ("crates/core/src/lane.rs", "use alloc::vec::Vec; use crate::station::Host;"),
        ("crates/core/src/plan.rs", "#[cfg(test)] mod tests { extern crate std; use std::vec; }"),
        ("crates/core/src/lane/tests.rs", "extern crate std; use crate::proto::tmcl;"),
        ("crates/core/src/proto/tmcl/host.rs", "use super::wire::Reply; use crate::time::Instant;"),
        ("crates/core/src/proto/mod.rs", "pub mod tmcl; fn v() { tmcl::f() }"),
        (
            "crates/drives/src/tmcm17x/device.rs",
            "use polepair_core::proto::tmcl::device::Firmware;",
        ),
        ("crates/polepair/src/url.rs", "fn f() -> &'static str { \"tmcl\" }"),
        ("crates/link/src/clock.rs", "fn f() { std::time::Instant::now(); }"),
        ("crates/sim/src/a.rs", "/// A name, and\n/// what it has. `nobody`\nstruct A;"),
        ("crates/link/src/keeper.rs", "fn f() { std::thread::spawn(g); }"),
    ] {
        assert_eq!(check_sample(path, text), [""; 0], "{path}: {text}");
    }
}

#[test]
fn commands_in_docs_must_exist() {
    let list = |words: &[&str]| words.iter().map(|w| (*w).to_owned()).collect::<Vec<_>>();
    let text =
        "polepair nonsense\n```sh\npolepair get sim:tmcl\n$ polepair gte x\nmake demo\n```\n";
    let broken = docs::unknown_commands(text, &list(&["get"]), &list(&["demo"]));
    assert_eq!(broken, [(4, "`polepair gte` does not exist".to_owned())]);
    assert_eq!(docs::unknown_commands(text, &list(&["get", "gte"]), &[]).len(), 1);
}

#[test]
fn codes_are_explained_alone_and_in_ranges() {
    let page = "| 1 | `E101` no · `E110` to `E112` maybe | `E20`, `polepair` to `E2`";
    assert_eq!(docs::explained_codes(page).into_iter().collect::<Vec<_>>(), [101, 110, 111, 112]);
}

#[test]
fn cited_decisions_must_exist() {
    let ids = ["STOP-1", "STOP-2", "GW-10"].map(str::to_owned).into();
    let text = "// so decided (STOP-1, STOP-3); TMCM-170 and UTF-8 are none; GW-1, not GW-10";
    let missing: Vec<_> = decisions::undecided_ids(text, &ids).into_iter().collect();
    assert_eq!(missing, ["GW-1", "STOP-3"]);
}

#[test]
fn a_test_is_in_its_crates_program_or_says_why_not() {
    let reported = |rest: &[&str], text: &str| {
        let path = rest.iter().fold(Path::new("crates/link/tests").to_path_buf(), |p, r| p.join(r));
        let read = |parent: &Path| match parent.to_str()? {
            "crates/link/tests/integration/main.rs" => Some("mod stop;\nmod gateway;\n".to_owned()),
            "crates/link/tests/integration/gateway/mod.rs" => Some("pub mod site;\n".to_owned()),
            _ => None,
        };
        programs::check_test_file(&path, rest, text, read)
    };
    let own = "//! It counts.\n//!\n//! A program of its own: it replaces the allocator.\n";
    for (rest, text) in [
        (&["integration", "main.rs"][..], ""),
        (&["integration", "stop.rs"], ""),
        (&["integration", "gateway", "mod.rs"], ""),
        (&["integration", "gateway", "site.rs"], ""),
        (&["no_alloc.rs"], own),
    ] {
        assert_eq!(reported(rest, text), None, "{rest:?}");
    }
    for (rest, what) in [
        (&["integration", "late.rs"][..], "no program has it: `mod late;`"),
        (&["integration", "gateway", "late.rs"], "no program has it: `mod late;`"),
        (&["late.rs"], "belongs into integration/"),
        (&["late", "main.rs"], "belongs into integration/"),
        (&["late", "mod.rs"], "no program has it: `mod late;`"),
    ] {
        let output = reported(rest, "");
        assert!(
            output.as_ref().is_some_and(|output| output.contains(what)),
            "{rest:?}: {output:?}"
        );
    }
}

#[test]
fn names_that_cannot_be_searched_for_are_refused() {
    let violations = |files: &[(&str, &str)]| {
        let mut vocabulary = Vocabulary::default();
        for (path, text) in files {
            vocabulary.add_file(path, text, &syn::parse_file(text).expect("Rust"));
        }
        vocabulary.violations()
    };
    let named = "fn read_frame() {} fn add_axis() {} fn send_stop() {}";
    let cases = [
        ("impl S { fn tell(&self) {} }", "crates/sim/src/a.rs:1: a function called only `tell`"),
        ("fn take(n: u8) -> u8 { n }", "crates/sim/src/a.rs:1: a function called only `take`"),
        ("trait T { fn put(&self); }", "crates/sim/src/a.rs:1: a function called only `put`"),
        ("fn a() {} fn b() {} fn c() {} fn d() {}", "57 % of 7 function names are one word"),
    ];
    for (text, what) in cases {
        let found = violations(&[("crates/sim/src/a.rs", text), ("crates/sim/src/b.rs", named)]);
        assert!(found.len() == 1 && found[0].starts_with(what), "{text}: {found:?}");
    }
    let twins = |path| {
        violations(&[
            (path, "pub struct Place;"),
            ("crates/cli/src/b.rs", "pub(crate) enum Place {}"),
        ])
    };
    assert_eq!(twins("crates/sim/src/a.rs").len(), 1);
    assert!(twins("crates/core/src/proto/tmcl/wire.rs").is_empty());
    for text in [
        "struct S; impl S { fn take(&mut self) -> Option<u8> { None } }",
        "impl Read for S { fn put(&self) {} }",
        "#[cfg(test)] mod tests { fn tell() {} }",
    ] {
        let files = [("crates/sim/src/a.rs", text), ("crates/sim/src/b.rs", named)];
        assert_eq!(violations(&files), [""; 0], "{text}");
    }
}

#[test]
fn tests_that_a_page_names_are_found() {
    let page = "| a | test |\n|---|---|\n| x `no` | `one`, `two` |\n\n| b | other |\n|---|---|\n| x | `no` |\n";
    let names: Vec<String> = docs::named_tests(page).into_iter().map(|(_, name)| name).collect();
    assert_eq!(names, ["one", "two"]);
}

#[test]
fn riddles_and_long_sentences_are_refused_in_texts_and_documents() {
    use super::language::{check_document, faults};
    assert_eq!(faults("Clears the stop that a server still has pending for these axes."), [""; 0]);
    assert_eq!(faults("Though nobody saw them stand").len(), 1);
    assert_eq!(faults("`nobody` is a name").len(), 0, "code is not checked");
    let long = "word ".repeat(31);
    assert_eq!(faults(&long).len(), 1);
    assert_eq!(faults(&format!("{}. {}", "word ".repeat(20), "word ".repeat(20))).len(), 0);
    let page = "# Title\nIt stands there.\n\n```text\nnobody\n```\n[owed](nobody.md)\n    said\n";
    let found = check_document(page);
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found[0].starts_with("2: \"stands\"") && found[1].starts_with("7: \"owed\""));
}
