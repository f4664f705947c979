//! Links of the built documentation: each leads to a page that is there, and to a heading of it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

/// Address of the published documentation. A link there means the page here.
const PUBLISHED: &str = "https://polepair.github.io/polepair/";
/// Pages whose links are those of all others, or are made for another address.
const LEFT_OUT: [&str; 3] = ["print.html", "404.html", "toc.html"];

/// Checks every page of the book in a folder.
pub(crate) fn run(site: &Path) -> Result<(), String> {
    let mut pages = BTreeMap::new();
    collect_pages(site, site, &mut pages)?;
    if !pages.contains_key(Path::new("index.html")) {
        return Err(format!("{} has no index.html: `make site` builds it", site.display()));
    }
    let mut broken = Vec::new();
    let mut count = 0;
    for (page, text) in &pages {
        // Other programs wrote these, and check them.
        if page.starts_with("api") || LEFT_OUT.iter().any(|name| page.ends_with(name)) {
            continue;
        }
        for link in attributes(text, "href=\"").chain(attributes(text, "src=\"")) {
            count += 1;
            if let Some(what) = broken_link(site, &pages, page, link) {
                broken.push(format!("{}: {what}", page.display()));
            }
        }
    }
    if broken.is_empty() {
        println!("{count} links of {} pages lead somewhere", pages.len());
        return Ok(());
    }
    Err(broken.join("\n"))
}

fn collect_pages(
    site: &Path,
    folder: &Path,
    pages: &mut BTreeMap<PathBuf, String>,
) -> Result<(), String> {
    let fail = |error: std::io::Error| format!("{}: {error}", folder.display());
    for entry in std::fs::read_dir(folder).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        // Thousands of pages, of which only the entries are linked.
        if path.is_dir() && !path.ends_with("api/rust") {
            collect_pages(site, &path, pages)?;
        } else if path.extension().is_some_and(|extension| extension == "html") {
            let name = path.strip_prefix(site).unwrap_or(&path).to_path_buf();
            pages.insert(name, std::fs::read_to_string(&path).map_err(fail)?);
        }
    }
    Ok(())
}

fn attributes<'a>(text: &'a str, name: &'a str) -> impl Iterator<Item = &'a str> {
    text.split(name).skip(1).filter_map(|rest| rest.split_once('"').map(|(value, _)| value))
}

/// Fault of a link of a page, if there is one.
fn broken_link(
    site: &Path,
    pages: &BTreeMap<PathBuf, String>,
    page: &Path,
    link: &str,
) -> Option<String> {
    let (from, link) = match link.strip_prefix(PUBLISHED) {
        Some(rest) => (Path::new("index.html"), rest),
        None => (page, link),
    };
    if link.contains("://") || link.starts_with("mailto:") || link.starts_with("data:") {
        return None;
    }
    let (path, heading) = link.split_once('#').unwrap_or((link, ""));
    let mut target = PathBuf::new();
    if path.is_empty() {
        target.push(from);
    } else {
        let whole = from.parent().unwrap_or(Path::new("")).join(path);
        for part in whole.components() {
            match part {
                Component::ParentDir if !target.pop() => {
                    return Some(format!("`{link}` leads out of the documentation"));
                }
                Component::Normal(name) => target.push(name),
                _ => {}
            }
        }
    }
    if !site.join(&target).exists() {
        return Some(format!("`{link}` leads to no page"));
    }
    let headings: BTreeSet<&str> = attributes(pages.get(&target)?, "id=\"").collect();
    let found = heading.is_empty() || headings.contains(heading);
    (!found).then(|| format!("`{link}`: {} has no such heading", target.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_to_nothing_are_found() {
        let site = std::env::temp_dir().join(format!("polepair-links-{}", std::process::id()));
        std::fs::create_dir_all(site.join("guides")).expect("a folder");
        let check = |text: &str| {
            std::fs::write(site.join("guides/one.html"), text).expect("written");
            run(&site)
        };
        assert!(run(&site).is_err(), "nothing is built");
        std::fs::write(site.join("index.html"), "<h1 id=\"top\">").expect("written");
        let good = "<a href=\"../index.html#top\"><a href=\"https://example.org/\"><h2 id=\"x\"><a href=\"#x\">";
        assert_eq!(check(good), Ok(()));
        let published = format!("<a href=\"{PUBLISHED}guides/one.html\">");
        assert_eq!(check(&published), Ok(()));
        for bad in ["../none.html", "../index.html#none", "#none", "../../index.html", "x.png"] {
            let found = check(&format!("<a href=\"{bad}\">")).expect_err(bad);
            assert!(found.starts_with("guides/one.html: ") && found.contains(bad), "{found}");
        }
        std::fs::remove_dir_all(site).expect("removed");
    }
}
