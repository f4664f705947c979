//! Man pages, made from the command line's own description.

use std::path::Path;

use clap_mangen::Man;

/// Writes `polepair.1` and a page for each verb, `polepair-spin.1` and so on, into a folder.
pub(crate) fn run(folder: &Path) -> Result<(), String> {
    let fail = |error: std::io::Error| format!("{}: {error}", folder.display());
    std::fs::create_dir_all(folder).map_err(fail)?;
    let mut command = polepair_cli::command();
    command.build();
    let mut pages = vec![command];
    while let Some(page) = pages.pop() {
        pages.extend(
            page.get_subcommands()
                .filter(|verb| !verb.is_hide_set() && verb.get_name() != "help")
                .cloned(),
        );
        let name = page.get_display_name().unwrap_or_else(|| page.get_name()).to_owned();
        let file = folder.join(format!("{name}.1"));
        let page = Man::new(page).title(name.to_uppercase()).manual("Polepair");
        let mut text = Vec::new();
        page.render(&mut text).map_err(fail)?;
        std::fs::write(file, text).map_err(fail)?;
    }
    Ok(())
}
