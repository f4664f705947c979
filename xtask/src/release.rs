//! Prepares a release: one version in all files, the changelog's section, a commit and a tag. Nothing is uploaded.
//!
//! `make release VERSION=X.Y.Z` runs it, `make release VERSION=X.Y.Z --dry-run` prints what it would do. The hosted
//! workflow builds the files when the tag is pushed (docs/guides/releasing.md).

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Kinds of changes, by the ending of a fragment's name, in the order of the changelog.
const KINDS: [(&str, &str); 4] =
    [("added", "Added"), ("changed", "Changed"), ("fixed", "Fixed"), ("removed", "Removed")];
const CHANGELOG: &str = "CHANGELOG.md";
const UNRELEASED: &str = "## Unreleased\n";
const FRAGMENTS: &str = "changes";

/// The guide whose first table lists the released files: name, what makes it, where it goes, how it was tested.
const GUIDE: &str = "docs/guides/releasing.md";

/// Texts of a release, by their file.
type NewTexts = BTreeMap<PathBuf, String>;

/// Runs `release VERSION [--dry-run]`.
///
/// # Errors
/// A reason for which nothing was changed.
pub(crate) fn run(root: &Path, version: &str, dry_run: bool) -> Result<(), String> {
    check_version(version)?;
    let tag = format!("v{version}");
    if !git(root, &["tag", "--list", &tag])?.is_empty() {
        return Err(format!("{tag} is tagged already: a version can never be released twice"));
    }
    let today = command(root, "date", &["-u", "+%Y-%m-%d"])?;
    let fragments = read_fragments(root)?;
    let section = changelog_section(&read(root, CHANGELOG)?, version, &today, &fragments)?;
    let texts = new_texts(root, version, &today, &section)?;
    if dry_run {
        print!("{}", plan(root, version, &section, &texts, &fragments)?);
        return Ok(());
    }
    let open = git(root, &["status", "--porcelain"])?;
    if !open.is_empty() {
        return Err(format!("commit or stash these first:\n{open}"));
    }
    for (file, text) in &texts {
        fs::write(root.join(file), text).map_err(|e| format!("{}: {e}", file.display()))?;
    }
    for (path, ..) in &fragments {
        fs::remove_file(path).map_err(|e| format!("{}: {e}", path.display()))?;
    }
    command(root, "cargo", &["update", "--workspace", "--offline", "--quiet"])?;
    git(root, &["add", "--all"])?;
    git(root, &["commit", "--quiet", "--message", &format!("Release {version}")])?;
    git(root, &["tag", "--annotate", &tag, "--message", &format!("Polepair {version}")])?;
    println!("Tagged {tag}. Push it, and the hosted workflow builds the files:");
    println!("  git push origin HEAD {tag}");
    Ok(())
}

fn check_version(version: &str) -> Result<(), String> {
    let numbers: Vec<&str> = version.split('.').collect();
    let is_number = |text: &&str| text.parse::<u16>().is_ok_and(|n| n.to_string() == **text);
    if numbers.len() == 3 && numbers.iter().all(is_number) {
        return Ok(());
    }
    Err(format!("`{version}` is no version: make release VERSION=0.1.0"))
}

/// The files in `changes`, with their kind and text, in order.
fn read_fragments(root: &Path) -> Result<Vec<(PathBuf, &'static str, String)>, String> {
    let folder = root.join(FRAGMENTS);
    let entries = fs::read_dir(&folder).map_err(|e| format!("{FRAGMENTS}: {e}"))?;
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    let mut found = Vec::new();
    for path in paths.into_iter().filter(|path| !path.ends_with("README.md")) {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let kind = KINDS.iter().find(|(kind, _)| name.ends_with(&format!(".{kind}.md")));
        let Some((_, title)) = kind else {
            return Err(format!("{FRAGMENTS}/{name}: the name ends in no kind, such as .added.md"));
        };
        let text = fs::read_to_string(&path).map_err(|e| format!("{name}: {e}"))?;
        let text = text.trim().trim_start_matches("- ").replace('\n', " ");
        if text.is_empty() {
            return Err(format!("{FRAGMENTS}/{name} is empty"));
        }
        found.push((path, *title, text));
    }
    Ok(found)
}

/// The changelog's section of the version, without its heading's mark.
fn changelog_section(
    changelog: &str,
    version: &str,
    today: &str,
    fragments: &[(PathBuf, &'static str, String)],
) -> Result<String, String> {
    let (_, after) = changelog.split_once(UNRELEASED).ok_or("the changelog has no `Unreleased`")?;
    let body = after.split("\n## ").next().unwrap_or_default().trim();
    let mut section = format!("## {version} - {today}\n\n{body}\n");
    for (_, title) in KINDS {
        let of_kind: Vec<_> = fragments.iter().filter(|(_, kind, _)| *kind == title).collect();
        if of_kind.is_empty() {
            continue;
        }
        // Behind what the section already has of this kind; it has no more than one heading of each.
        if !section.contains(&format!("### {title}\n")) {
            let _ = write!(section, "\n### {title}\n");
        }
        let heading = format!("### {title}\n");
        let at = section.find(&heading).map_or(section.len(), |at| at + heading.len());
        let end = section[at..].find("\n### ").map_or(section.len(), |next| at + next);
        let lines: String = of_kind.iter().map(|(_, _, text)| format!("- {text}\n")).collect();
        let before = section[..end].trim_end().to_owned();
        let is_list = before.lines().last().is_some_and(|line| line.starts_with("- "));
        let gap = if is_list { "" } else { "\n" };
        section = format!("{before}\n{gap}{lines}{}", &section[end..]);
    }
    if section.trim().lines().count() < 2 {
        return Err("the changelog has nothing under `Unreleased`, and there is no change".into());
    }
    Ok(section)
}

/// Every file that names the version, with its new text.
fn new_texts(root: &Path, version: &str, today: &str, section: &str) -> Result<NewTexts, String> {
    let mut texts = NewTexts::new();
    let cargo = read(root, "Cargo.toml")?;
    let old = current_version(&cargo)?;
    let named = format!("version = \"{old}\"");
    let ours = |line: &str| line.starts_with("version = ") || line.contains("path = \"crates/");
    let new = format!("version = \"{version}\"");
    let lines = cargo.lines().map(|line| {
        if ours(line) { line.replace(&named, &new) + "\n" } else { line.to_owned() + "\n" }
    });
    texts.insert("Cargo.toml".into(), lines.collect());
    let changelog = read(root, CHANGELOG)?;
    let (head, after) = changelog.split_once(UNRELEASED).unwrap_or((&changelog, ""));
    let rest = after.find("\n## ").map_or("", |at| &after[at..]);
    texts.insert(CHANGELOG.into(), format!("{head}{UNRELEASED}\n{section}{rest}"));
    let debian = read(root, "packaging/deb/changelog")?;
    let stamp = command(root, "date", &["-u", "-R"])?;
    let entry = debian.split_once(" -- ").map_or("", |(entry, _)| entry);
    let entry = entry.replace(&format!("({old}-1)"), &format!("({version}-1)"));
    let earlier = if version == old { String::new() } else { format!("\n{debian}") };
    let by = " -- The Polepair developers <polepair@users.noreply.github.com>";
    texts.insert("packaging/deb/changelog".into(), format!("{entry}{by}  {stamp}\n{earlier}"));
    let citation = read(root, "CITATION.cff")?;
    let lines = citation.lines().filter(|line| !line.starts_with("date-released:"));
    let lines = lines.map(|line| {
        if line.starts_with("version:") {
            format!("version: {version}\ndate-released: {today}\n")
        } else {
            format!("{line}\n")
        }
    });
    texts.insert("CITATION.cff".into(), lines.collect());
    Ok(texts)
}

/// Text of a dry run: the changed files, the section, the tag and the files to upload.
fn plan(
    root: &Path,
    version: &str,
    section: &str,
    texts: &NewTexts,
    fragments: &[(PathBuf, &'static str, String)],
) -> Result<String, String> {
    let mut text =
        format!("Release {version} (dry run: nothing is changed)\n\nFiles with the version:\n");
    for (file, new) in texts {
        let is_same = &read(root, &file.to_string_lossy())? == new;
        let note = if is_same { ", as it is" } else { "" };
        let _ = writeln!(text, "  {}{note}", file.display());
    }
    let _ = writeln!(text, "  Cargo.lock");
    if !fragments.is_empty() {
        let _ = writeln!(text, "Removed: {} files of {FRAGMENTS}", fragments.len());
    }
    let open = git(root, &["status", "--porcelain"])?;
    if !open.is_empty() {
        let _ = writeln!(text, "\nNot committed yet, which a release refuses:\n{open}");
    }
    let head = git(root, &["log", "-1", "--format=%h %s"])?;
    let _ = writeln!(text, "\nCommit: Release {version}, on {head}\nTag: v{version}\n");
    text += "Uploaded by hand after the hosted workflow has built it (docs/guides/releasing.md):\n";
    for [name, builder, place] in released_files(&read(root, GUIDE)?) {
        let name = name.replace("VERSION", version);
        let _ = writeln!(text, "  {name:<66} {place} ({builder})");
    }
    let lines = section.lines().filter(|line| line.starts_with("- ")).count();
    let _ = writeln!(text, "\nChangelog: {lines} lines\n");
    text.extend(section.lines().take(12).map(|line| format!("  {line}\n")));
    text += "  …\n";
    Ok(text)
}

/// Name, maker and destination of each released file, from the guide's first table.
fn released_files(guide: &str) -> impl Iterator<Item = [String; 3]> {
    let rows = guide.lines().skip_while(|line| !line.starts_with("|---"));
    rows.skip(1).take_while(|line| line.starts_with('|')).map(|row| {
        let mut cells = row.split('|').skip(1).map(|cell| cell.trim().replace('`', ""));
        std::array::from_fn(|_| cells.next().unwrap_or_default())
    })
}

fn current_version(cargo: &str) -> Result<&str, String> {
    let line = cargo.lines().find_map(|line| line.strip_prefix("version = \""));
    line.and_then(|rest| rest.strip_suffix('"')).ok_or_else(|| "Cargo.toml has no version".into())
}

fn read(root: &Path, file: &str) -> Result<String, String> {
    fs::read_to_string(root.join(file)).map_err(|e| format!("{file}: {e}"))
}

fn git(root: &Path, words: &[&str]) -> Result<String, String> {
    command(root, "git", words)
}

/// Output of a command, without its last line break.
fn command(root: &Path, program: &str, words: &[&str]) -> Result<String, String> {
    let ran = Command::new(program).args(words).current_dir(root).output();
    let ran = ran.map_err(|e| format!("{program}: {e}"))?;
    if !ran.status.success() {
        return Err(format!(
            "{program} {}: {}",
            words.join(" "),
            String::from_utf8_lossy(&ran.stderr)
        ));
    }
    Ok(String::from_utf8_lossy(&ran.stdout).trim_end().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    const CARGO: &str = r#"[workspace.package]
version = "0.1.0"
[workspace.dependencies]
polepair = { path = "crates/polepair", version = "0.1.0" }
serde = { version = "0.1.0" }
"#;
    const CHANGES: &str = "\
# Changelog

## Unreleased

### Added

- One thing.

## 0.0.9 - 2026-01-01

- Old.
";

    /// A repository with the files that name the version.
    fn repository(name: &str) -> PathBuf {
        let root =
            std::env::temp_dir().join(format!("polepair-release-{}-{name}", std::process::id()));
        let _ = fs::remove_dir_all(&root);
        for (file, text) in [
            ("Cargo.toml", CARGO),
            (CHANGELOG, CHANGES),
            (
                "packaging/deb/changelog",
                "polepair (0.1.0-1) unstable\n\n  * A change.\n\n -- X  date\n",
            ),
            ("CITATION.cff", "title: Polepair\nversion: 0.1.0\n"),
            (
                GUIDE,
                "| file | by | to |\n|---|---|---|\n| `a-VERSION.whl` | `make wheel` | index | x |\n\n1.\n",
            ),
            ("changes/README.md", "How.\n"),
            ("changes/groups.added.md", "Groups move.\n"),
            ("changes/speed.fixed.md", "- Speeds are\nright.\n"),
        ] {
            let path = root.join(file);
            fs::create_dir_all(path.parent().expect("a folder")).expect("made");
            fs::write(path, text).expect("written");
        }
        git(&root, &["init", "--quiet"]).expect("git");
        root
    }

    #[test]
    fn fragments_join_the_section_of_their_kind() {
        let root = repository("section");
        let fragments = read_fragments(&root).expect("fragments");
        let changelog = read(&root, CHANGELOG).expect("a changelog");
        let section =
            changelog_section(&changelog, "0.2.0", "2026-12-01", &fragments).expect("a section");
        let added = "### Added\n\n- One thing.\n- Groups move.\n";
        let fixed = "### Fixed\n\n- Speeds are right.\n";
        assert_eq!(section, format!("## 0.2.0 - 2026-12-01\n\n{added}\n{fixed}"));
        let texts = new_texts(&root, "0.2.0", "2026-12-01", &section).expect("texts");
        let text = |file: &str| texts[Path::new(file)].clone();
        assert!(
            text(CHANGELOG).contains("## Unreleased\n\n## 0.2.0 - 2026-12-01\n"),
            "{}",
            text(CHANGELOG)
        );
        assert!(text(CHANGELOG).ends_with("right.\n\n## 0.0.9 - 2026-01-01\n\n- Old.\n"));
        let cargo = text("Cargo.toml");
        assert_eq!(
            (cargo.matches("0.2.0").count(), cargo.matches("0.1.0").count()),
            (2, 1),
            "{cargo}"
        );
        assert!(text("packaging/deb/changelog").starts_with("polepair (0.2.0-1)"));
        assert!(text("CITATION.cff").contains("version: 0.2.0\ndate-released: 2026-12-01\n"));
        fs::remove_dir_all(root).expect("removed");
    }

    #[test]
    fn a_dry_run_changes_nothing_and_names_tag_and_files() {
        let root = repository("dry");
        for words in [
            &["add", "-A"][..],
            &["-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "x"],
        ] {
            git(&root, words).expect("git");
        }
        run(&root, "0.1.0", true).expect("a plan");
        assert_eq!(git(&root, &["status", "--porcelain"]).expect("git"), "");
        let section = "## 0.1.0\n\n- One.\n";
        let texts = new_texts(&root, "0.1.0", "2026-12-01", section).expect("texts");
        let plan = plan(&root, "0.1.0", section, &texts, &[]).expect("a plan");
        for expected in ["Tag: v0.1.0", "a-0.1.0.whl", "Cargo.toml, as it is"] {
            assert!(plan.contains(expected), "{expected}: {plan}");
        }
        fs::remove_dir_all(root).expect("removed");
    }

    #[test]
    fn a_wrong_version_or_name_is_refused() {
        for version in ["", "1", "1.2", "v1.2.3", "1.2.3.4", "01.2.3", "1.2.x"] {
            assert!(check_version(version).is_err(), "{version}");
        }
        let root = repository("names");
        fs::write(root.join("changes/other.txt"), "x").expect("written");
        assert!(read_fragments(&root).expect_err("no kind").contains("other.txt"));
        fs::remove_dir_all(root).expect("removed");
    }

    /// The workspace's own fragments and files can be released.
    #[test]
    fn the_workspace_has_what_a_release_needs() {
        let root = crate::root();
        let fragments = read_fragments(&root).expect("fragments");
        let changelog = read(&root, CHANGELOG).expect("a changelog");
        let section =
            changelog_section(&changelog, "9.9.9", "2030-01-01", &fragments).expect("a section");
        let texts = new_texts(&root, "9.9.9", "2030-01-01", &section).expect("texts");
        let cargo = &texts[Path::new("Cargo.toml")];
        assert_eq!(current_version(cargo), Ok("9.9.9"));
        assert_eq!(cargo.matches("version = \"0.1.0\"").count(), 0);
        let files: Vec<_> = released_files(&read(&root, GUIDE).expect("a guide")).collect();
        assert!(
            files.len() > 15 && files.iter().flatten().all(|cell| !cell.is_empty()),
            "{files:?}"
        );
    }
}
