//! The never-rules of the architecture, held mechanically: files are parsed and paths resolved.
//!
//! Code below `#[cfg(test)]`, in `tests.rs`, `tests/`, `benches/` and `examples/` may do what tests must; generated
//! files may be long.

mod comments;
mod decisions;
mod docs;
mod language;
mod module_names;
mod programs;
mod prose;
#[cfg(test)]
mod tests;
mod vocabulary;

use module_names::ModuleNames;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use syn::visit::{self, Visit};
use vocabulary::Vocabulary;

/// Lines of a file that people write. Comments with reasons do not count, so that none is left out for its room.
const LINES_MAX: usize = 700;
/// Characters of a line of code; rustfmt holds code to 100, and leaves texts and comments alone.
const COLUMNS_MAX: usize = 120;
/// Words that carry no meaning in a name.
const EMPTY_WORDS: [&str; 5] = ["Manager", "Helper", "Utils", "Util", "Handler"];
const EMPTY_MODULES: [&str; 5] = ["common", "utils", "util", "helpers", "helper"];
/// Files of a protocol that know bytes alone.
const WIRE_FILES: [&str; 6] = ["wire", "explain", "rtu", "ascii", "opcode", "encoding"];

/// Checks the workspace and returns a line about its names; each violation is a line with place and
/// rule.
pub fn run(root: &Path) -> Result<String, String> {
    let names = ModuleNames::load(root);
    let mut vocabulary = Vocabulary::default();
    let mut broken = Vec::new();
    for file in rust_files(root) {
        let text =
            std::fs::read_to_string(&file).map_err(|e| format!("{}: {e}", file.display()))?;
        let path = display_path(root, &file);
        broken.extend(check_file(&path, &text, &names, &mut vocabulary));
    }
    broken.extend(docs::check(root));
    broken.extend(decisions::check(root));
    broken.extend(programs::check(root));
    broken.extend(language::check(root));
    broken.extend(vocabulary.violations());
    if broken.is_empty() { Ok(vocabulary.to_string()) } else { Err(broken.join("\n")) }
}

/// The text of a file that the rules need. Without it they would hold for nothing, so they end here.
fn read_text(file: impl AsRef<Path>) -> String {
    let file = file.as_ref();
    std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

fn display_path(root: &Path, file: &Path) -> String {
    let short = file.strip_prefix(root).unwrap_or(file);
    short.to_string_lossy().replace('\\', "/")
}

fn rust_files(root: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![root.join("crates"), root.join("xtask")];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = std::fs::read_dir(&folder) else { continue };
        for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
            if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

/// Faults of one file; its names are added to the vocabulary. `path` is relative to the workspace, with slashes.
pub(crate) fn check_file(
    path: &str,
    text: &str,
    names: &ModuleNames,
    vocabulary: &mut Vocabulary,
) -> Vec<String> {
    let mut broken = Vec::new();
    if !text.starts_with("//! Generated") {
        check_size(path, text, &mut broken);
    }
    broken.extend(comments::check_comments(path, text));
    let Ok(file) = syn::parse_file(text) else {
        broken.push(format!("{path}: it does not parse"));
        return broken;
    };
    vocabulary.add_file(path, text, &file);
    let source_location = SourceLocation::from_path(path);
    if source_location.is_root && !forbids_unsafe(&file) {
        broken.push(format!("{path}: rule 13: neither forbids nor denies unsafe code"));
    }
    let mut rule_visitor =
        RuleVisitor { path, location: source_location, names, violations: BTreeSet::new() };
    rule_visitor.visit_file(&file);
    broken.extend(
        rule_visitor.violations.into_iter().map(|(line, what)| format!("{path}:{line}: {what}")),
    );
    broken
}

fn check_size(path: &str, text: &str, broken: &mut Vec<String>) {
    let is_reason = |line: &&str| line.trim_start().starts_with("// ");
    let lines = text.lines().filter(|line| !is_reason(line)).count();
    if lines > LINES_MAX {
        broken.push(format!("{path}: {lines} lines; at most {LINES_MAX}"));
    }
    for (n, line) in text.lines().enumerate() {
        let columns = line.chars().count();
        if columns > COLUMNS_MAX {
            broken.push(format!("{path}:{}: {columns} columns; at most {COLUMNS_MAX}", n + 1));
        }
    }
}

fn forbids_unsafe(file: &syn::File) -> bool {
    file.attrs.iter().any(|attribute| {
        let lint = attribute.path().is_ident("forbid") || attribute.path().is_ident("deny");
        let list = attribute.meta.require_list().map(|list| list.tokens.to_string());
        lint && list.is_ok_and(|list| list.contains("unsafe_code"))
    })
}

/// Place of a file in the layers.
struct SourceLocation {
    krate: String,
    /// Folders and file below `src`, without the ending; `mod` dropped.
    modules: Vec<String>,
    is_test: bool,
    is_root: bool,
}

impl SourceLocation {
    fn from_path(path: &str) -> Self {
        let parts: Vec<&str> = path.split('/').collect();
        let (krate, rest) = match parts.as_slice() {
            ["crates", krate, rest @ ..] => (*krate, rest),
            [krate, rest @ ..] => (*krate, rest),
            [] => ("", &[][..]),
        };
        let source = rest.first() == Some(&"src");
        let modules: Vec<String> =
            rest.iter().skip(1).map(|part| part.trim_end_matches(".rs").to_owned()).collect();
        let is_test = !source || modules.iter().any(|m| m == "tests" || m.starts_with("tests_"));
        let root = modules.len() == 1 && (modules[0] == "lib" || modules[0] == "main");
        let modules = modules.into_iter().filter(|module| module != "mod").collect();
        Self { krate: krate.to_owned(), modules, is_test, is_root: source && root }
    }

    /// The crates that build without an operating system.
    fn is_bare(&self) -> bool {
        matches!(self.krate.as_str(), "core" | "drives")
    }

    fn file_name(&self) -> &str {
        self.modules.last().map_or("", String::as_str)
    }

    /// The protocol whose folder this is in.
    fn protocol(&self) -> Option<&str> {
        match self.modules.as_slice() {
            [first, folder, ..] if self.krate == "core" && first == "proto" => Some(folder),
            _ => None,
        }
    }

    /// The family whose folder this is in.
    fn family(&self) -> Option<&str> {
        match self.modules.as_slice() {
            [folder, _, ..] if self.krate == "drives" => Some(folder),
            _ => None,
        }
    }

    /// Files that must not know which protocols and families there are.
    fn is_general(&self) -> bool {
        match self.krate.as_str() {
            "core" => {
                let first = self.modules.first().map_or("", String::as_str);
                matches!(first, "axis" | "lane" | "mux" | "plan" | "profile" | "station")
            }
            "polepair" | "cli" | "link" | "python" | "ffi" => true,
            _ => false,
        }
    }
}

struct RuleVisitor<'a> {
    path: &'a str,
    location: SourceLocation,
    names: &'a ModuleNames,
    violations: BTreeSet<(usize, String)>,
}

impl RuleVisitor<'_> {
    fn report_at(&mut self, span: proc_macro2::Span, what: impl Into<String>) {
        self.violations.insert((span.start().line, what.into()));
    }

    /// Judges a path, `use` trees taken apart, `self` and `super` resolved.
    fn check_path(&mut self, span: proc_macro2::Span, segments: &[String]) {
        let path = self.resolve_path(segments);
        let first = path.first().map_or("", String::as_str);
        if self.location.is_bare() && first == "std" {
            self.report_at(span, "rule 1: core uses std");
        }
        let modules: Vec<&str> = self.location.modules.iter().map(String::as_str).collect();
        let may_allocate =
            matches!(modules[..], ["lane" | "mux", ..] | ["program", "transfer", ..]);
        if self.location.is_bare() && first == "alloc" && !may_allocate {
            self.report_at(span, "rule 1: core allocates outside lane, mux and transfers");
        }
        self.check_layers(span, &path);
        let named = self
            .names
            .all()
            .find(|name| path_has(name, &path))
            .filter(|_| self.location.is_general());
        if let Some(name) = named.map(str::to_owned) {
            self.report_at(span, format!("rule 5: names `{name}`"));
        }
        self.check_time(span, &path);
        self.check_files(span, &path);
    }

    fn check_layers(&mut self, span: proc_macro2::Span, path: &[String]) {
        let protocol = self.location.protocol().map(str::to_owned);
        let family = self.location.family().map(str::to_owned);
        let file = self.location.file_name().to_owned();
        let inside = path.first().is_some_and(|first| first == "crate");
        if !inside || !self.location.is_bare() {
            return;
        }
        if protocol.is_some() && WIRE_FILES.contains(&file.as_str()) {
            for layer in ["host", "device", "session", "time", "station", "axis"] {
                if path.get(1).is_some_and(|p| p == layer)
                    || path.get(3).is_some_and(|p| p == layer)
                {
                    self.report_at(span, format!("rule 2: {file} knows {layer}"));
                }
            }
        }
        if file == "host" && path.get(3).is_some_and(|p| p == "device") {
            self.report_at(span, "rule 3: the host knows the device");
        }
        if file == "device" && path.get(3).is_some_and(|p| p == "host") {
            self.report_at(span, "rule 3: the device knows the host");
        }
        if let Some(protocol) = protocol {
            let other = path.get(1).is_some_and(|p| p == "proto")
                && path.get(2).is_some_and(|p| *p != protocol && self.names.protocols.contains(p));
            if other {
                self.report_at(span, "rule 4: one protocol knows another");
            }
        }
        if let Some(family) = family
            && path.get(1).is_some_and(|word| *word != family && self.names.families.contains(word))
        {
            self.report_at(span, "rule 4: one family knows another");
        }
    }

    fn check_time(&mut self, span: proc_macro2::Span, path: &[String]) {
        let clock = path_ends("SystemTime", "now", path) || path_ends("Instant", "now", path);
        // The tools measure how long their runs take, and tests wait; neither is shipped.
        let is_tool = matches!(self.location.krate.as_str(), "xtask" | "test-support");
        if clock && !is_tool && self.path != "crates/link/src/clock.rs" {
            self.report_at(span, "rule 6: reads the clock outside link/clock");
        }
        let waits = path_ends("thread", "sleep", path) || path_ends("thread", "spawn", path);
        let link = self.location.krate == "link" || is_tool;
        let spawns = matches!(self.location.krate.as_str(), "capture" | "cli")
            && path_ends("thread", "spawn", path);
        if waits && !link && !spawns {
            self.report_at(span, "rule 6: sleeps or spawns outside link");
        }
    }

    /// A file that is created in place is lost where its writing fails.
    fn check_files(&mut self, span: proc_macro2::Span, path: &[String]) {
        let creates = path_ends("File", "create", path)
            || path_ends("fs", "write", path)
            || path_ends("fs", "rename", path);
        // The tools write what git can restore.
        let is_tool = matches!(self.location.krate.as_str(), "xtask" | "test-support");
        if creates && !is_tool && self.location.krate != "files" {
            self.report_at(span, "rule 16: writes a file outside polepair-files");
        }
    }

    /// The path from `crate`, where it begins with `self` or `super`.
    fn resolve_path(&self, segments: &[String]) -> Vec<String> {
        let mut base = self.location.modules.clone();
        if self.location.is_root {
            base.clear();
        }
        let mut rest = segments;
        let mut relative = false;
        while let [first, tail @ ..] = rest {
            match first.as_str() {
                "self" => relative = true,
                "super" => {
                    base.pop();
                    relative = true;
                }
                _ => break,
            }
            rest = tail;
        }
        if !relative {
            return segments.to_vec();
        }
        let root = std::iter::once("crate".to_owned());
        root.chain(base).chain(rest.iter().cloned()).collect()
    }

    fn check_ident(&mut self, ident: &syn::Ident) {
        let name = ident.to_string();
        if let Some(word) = EMPTY_WORDS.iter().find(|word| name.contains(**word)) {
            self.report_at(ident.span(), format!("`{name}`: `{word}` says nothing"));
        }
    }

    fn check_use_tree(&mut self, prefix: &mut Vec<String>, tree: &syn::UseTree) {
        match tree {
            syn::UseTree::Path(path) => {
                prefix.push(path.ident.to_string());
                self.check_use_tree(prefix, &path.tree);
                prefix.pop();
            }
            syn::UseTree::Name(syn::UseName { ident })
            | syn::UseTree::Rename(syn::UseRename { ident, .. }) => {
                prefix.push(ident.to_string());
                self.check_path(ident.span(), prefix);
                prefix.pop();
            }
            syn::UseTree::Glob(glob) => self.check_path(glob.star_token.spans[0], prefix),
            syn::UseTree::Group(group) => {
                group.items.iter().for_each(|t| self.check_use_tree(prefix, t))
            }
        }
    }
}

fn path_ends(a: &str, b: &str, path: &[String]) -> bool {
    matches!(path, [.., x, y] if x == a && y == b)
}

fn path_has(word: &str, path: &[String]) -> bool {
    path.iter().any(|segment| segment == word)
}

fn is_test(attributes: &[syn::Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        let list = attribute.meta.require_list().map(|list| list.tokens.to_string());
        attribute.path().is_ident("test")
            || attribute.path().is_ident("cfg") && list.is_ok_and(|list| list == "test")
    })
}

fn item_attributes(item: &syn::Item) -> &[syn::Attribute] {
    match item {
        syn::Item::Mod(item) => &item.attrs,
        syn::Item::Fn(item) => &item.attrs,
        syn::Item::Use(item) => &item.attrs,
        syn::Item::ExternCrate(item) => &item.attrs,
        syn::Item::Impl(item) => &item.attrs,
        _ => &[],
    }
}

impl<'ast> Visit<'ast> for RuleVisitor<'_> {
    fn visit_item(&mut self, item: &'ast syn::Item) {
        if !self.location.is_test && !is_test(item_attributes(item)) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        self.check_use_tree(&mut Vec::new(), &item.tree);
    }

    fn visit_item_extern_crate(&mut self, item: &'ast syn::ItemExternCrate) {
        if self.location.is_bare() && item.ident == "std" {
            self.report_at(item.ident.span(), "rule 1: core uses std");
        }
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        if EMPTY_MODULES.iter().any(|word| item.ident == word) {
            self.report_at(item.ident.span(), format!("module `{}` says nothing", item.ident));
        }
        visit::visit_item_mod(self, item);
    }

    fn visit_item_struct(&mut self, item: &'ast syn::ItemStruct) {
        self.check_ident(&item.ident);
        visit::visit_item_struct(self, item);
    }

    fn visit_item_enum(&mut self, item: &'ast syn::ItemEnum) {
        self.check_ident(&item.ident);
        visit::visit_item_enum(self, item);
    }

    fn visit_item_trait(&mut self, item: &'ast syn::ItemTrait) {
        self.check_ident(&item.ident);
        visit::visit_item_trait(self, item);
    }

    fn visit_signature(&mut self, signature: &'ast syn::Signature) {
        let sync = ["core", "sim", "link", "polepair"].contains(&self.location.krate.as_str());
        if sync && signature.asyncness.is_some() {
            self.report_at(signature.ident.span(), "rule 7: an async fn");
        }
        let has_tuple = signature.inputs.iter().any(|input| {
            matches!(input, syn::FnArg::Typed(parameter)
                if matches!((&*parameter.pat, &*parameter.ty), (syn::Pat::Tuple(_), syn::Type::Tuple(_))))
        });
        if has_tuple {
            let what = "rule 18: a tuple as a parameter; use parameters of their own, or a struct";
            self.report_at(signature.ident.span(), what);
        }
        visit::visit_signature(self, signature);
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let segments: Vec<String> = path.segments.iter().map(|s| s.ident.to_string()).collect();
        if let (true, Some(last)) = (segments.len() > 1, path.segments.last()) {
            self.check_path(last.ident.span(), &segments);
        }
        visit::visit_path(self, path);
    }

    fn visit_expr(&mut self, expression: &'ast syn::Expr) {
        if prose::depends_on_prose(expression) {
            let span = syn::spanned::Spanned::span(expression);
            self.report_at(span, "rule 14: a message's words decide");
        }
        visit::visit_expr(self, expression);
    }

    fn visit_macro(&mut self, invoked: &'ast syn::Macro) {
        let name = invoked.path.segments.last().map(|segment| &segment.ident);
        if let Some(name) = name.filter(|name| *name == "todo" || *name == "unimplemented") {
            self.report_at(name.span(), format!("{name}! is not done"));
        }
        visit::visit_macro(self, invoked);
    }
}
