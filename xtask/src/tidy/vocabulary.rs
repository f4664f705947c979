//! Names that can be searched for: one public type a name, and no function called by a bare verb.

use std::collections::BTreeMap;
use std::fmt;

use syn::visit::{self, Visit};

use super::{SourceLocation, is_test, item_attributes};

/// Verbs without a specific meaning: none of them is a function's whole name.
const VAGUE: [&str; 15] = [
    "take", "tell", "told", "look", "keep", "put", "turn", "give", "say", "said", "hear", "heard",
    "go", "come", "owe",
];
/// Types that have one name for each operating system, of which a build has one.
const PER_SYSTEM: [&str; 2] = ["SerialPort", "TcpSocket"];
/// Share of functions whose name is one word, in per cent.
const ONE_WORD_MAX: usize = 50;

/// The names of types and functions in shipped code, collected file by file.
#[derive(Debug, Default)]
pub(crate) struct Vocabulary {
    /// Public types outside protocols and drive families, each with the places of its definitions.
    types: BTreeMap<String, Vec<String>>,
    /// Functions with a vague name.
    vague: Vec<String>,
    /// Functions and methods; methods of a trait are counted where the trait is defined.
    functions: usize,
    /// Number of them whose name is one word.
    one_word: usize,
}

impl Vocabulary {
    /// Adds the names of one file. `path` is relative to the workspace, with slashes.
    pub(crate) fn add_file(&mut self, path: &str, text: &str, parsed: &syn::File) {
        let location = SourceLocation::from_path(path);
        let generated = text.starts_with("//! Generated");
        // It replaces another file in a build without a feature, so its names are the same.
        let is_stand_in = path.ends_with("_left_out.rs");
        if location.is_test || generated || is_stand_in {
            return;
        }
        let specific = path.contains("/proto/") || path.starts_with("crates/drives/");
        NameVisitor { vocabulary: self, path, specific, in_trait_impl: false }.visit_file(parsed);
    }

    /// One line for each violation.
    pub(crate) fn violations(&self) -> Vec<String> {
        let mut violations: Vec<String> = self.vague.clone();
        for (name, places) in self.types.iter().filter(|(_, places)| places.len() > 1) {
            violations.push(format!("{}: public types of one name: {name}", places.join(", ")));
        }
        if self.one_word * 100 > self.functions * ONE_WORD_MAX {
            violations.push(format!("{self}; at most {ONE_WORD_MAX} %"));
        }
        violations
    }
}

impl fmt::Display for Vocabulary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let share = self.one_word * 100 / self.functions.max(1);
        write!(f, "{share} % of {} function names are one word", self.functions)
    }
}

struct NameVisitor<'a> {
    vocabulary: &'a mut Vocabulary,
    path: &'a str,
    /// True in a protocol or a drive family, whose types are distinguished by their module.
    specific: bool,
    in_trait_impl: bool,
}

impl NameVisitor<'_> {
    fn add_type(&mut self, visibility: &syn::Visibility, name: &syn::Ident) {
        let public = !matches!(visibility, syn::Visibility::Inherited);
        if public && !self.specific && !PER_SYSTEM.iter().any(|twin| name == twin) {
            let line = name.span().start().line;
            let places = self.vocabulary.types.entry(name.to_string()).or_default();
            places.push(format!("{}:{line}", self.path));
        }
    }

    fn add_function(&mut self, signature: &syn::Signature) {
        if self.in_trait_impl {
            return;
        }
        let name = signature.ident.to_string();
        self.vocabulary.functions += 1;
        self.vocabulary.one_word += usize::from(!name.contains('_'));
        let like_option = name == "take" && returns_option(signature);
        if VAGUE.contains(&name.as_str()) && !like_option {
            let line = signature.ident.span().start().line;
            let what = format!("{}:{line}: a function called only `{name}`", self.path);
            self.vocabulary.vague.push(what);
        }
    }
}

/// Returns whether a function gives what may not be there, as `Option::take` does.
fn returns_option(signature: &syn::Signature) -> bool {
    let syn::ReturnType::Type(_, output) = &signature.output else { return false };
    let syn::Type::Path(path) = &**output else { return false };
    path.path.segments.last().is_some_and(|last| last.ident == "Option")
}

impl<'ast> Visit<'ast> for NameVisitor<'_> {
    fn visit_item(&mut self, item: &'ast syn::Item) {
        if !is_test(item_attributes(item)) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_struct(&mut self, item: &'ast syn::ItemStruct) {
        self.add_type(&item.vis, &item.ident);
        visit::visit_item_struct(self, item);
    }

    fn visit_item_enum(&mut self, item: &'ast syn::ItemEnum) {
        self.add_type(&item.vis, &item.ident);
        visit::visit_item_enum(self, item);
    }

    fn visit_item_trait(&mut self, item: &'ast syn::ItemTrait) {
        self.add_type(&item.vis, &item.ident);
        visit::visit_item_trait(self, item);
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        let outer = std::mem::replace(&mut self.in_trait_impl, item.trait_.is_some());
        visit::visit_item_impl(self, item);
        self.in_trait_impl = outer;
    }

    fn visit_signature(&mut self, signature: &'ast syn::Signature) {
        self.add_function(signature);
        visit::visit_signature(self, signature);
    }
}
