//! `polepair --server URL scan --look`: the server looks for drives on its links.

use std::io::IsTerminal as _;
use std::ops::RangeInclusive;
use std::time::Duration;

use polepair_capture::jsonl;
use polepair_client::message::{AxisInfo, FoundDrive, LookOrder, LookState, LookView, TakeIn};
use polepair_link::clock;

use super::clashes;
use crate::interrupt;
use crate::joined::{Joined, refused};
use crate::problem::{Exit, Problem, Result};
use crate::target::Format;
use crate::terminal::{self, Output, Table, colour_out, csv, say};

/// Between two questions how far it is.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Looks on each link that one of these axes is on, one after the other.
pub fn run(
    server: &Joined,
    axes: &[AxisInfo],
    ids: Option<RangeInclusive<u32>>,
    format: Format,
    take: bool,
) -> Result {
    interrupt::listen(|| {});
    let mut links: Vec<u16> = axes.iter().map(|axis| axis.link).collect();
    // Axes that were taken in stand behind all others.
    links.sort_unstable();
    links.dedup();
    let order = LookOrder {
        first: ids.as_ref().map(|ids| *ids.start()),
        last: ids.as_ref().map(|ids| *ids.end()),
    };
    let mut views = Vec::new();
    for link in links {
        let view = look(server, link, &order)?;
        let ends = view.state == LookState::BrokenOff;
        views.push(view);
        if ends {
            break;
        }
    }
    show(&views, format)?;
    for view in &views {
        tell(server, view);
    }
    if let Some(error) = views.iter().find_map(|view| view.error.clone()) {
        return Err(refused(error));
    }
    if let Some(view) = views.iter().find(|view| view.state == LookState::BrokenOff) {
        say(&format!("broken off: {} addresses were not asked", view.unasked));
        return Err(match interrupt::came() {
            true => Problem::interrupted(),
            false => Problem::new(Exit::Refused, "E102", "somebody broke the look off.")
                .hint("look again when nothing has to be stopped"),
        });
    }
    if take {
        for view in views.iter().filter(|view| view.found.iter().any(|one| one.clash.is_none())) {
            let taken = server.gateway.take_in(view.link, &TakeIn::default()).map_err(refused)?;
            let count = taken.axes.len();
            say(&format!("link {}: {count} taken in, behind all other axes", view.link));
        }
    }
    let found = || views.iter().flat_map(|view| &view.found);
    clashes(found().filter(|one| one.clash.is_some()).count(), found().count())
}

/// Looks on a link until the end.
fn look(server: &Joined, link: u16, order: &LookOrder) -> Result<LookView> {
    let live = std::io::stderr().is_terminal();
    let mut view = server.gateway.look(link, order).map_err(refused)?;
    let mut broken = false;
    while view.state == LookState::UnderWay {
        if interrupt::came() && !std::mem::replace(&mut broken, true) {
            // It may just have ended.
            let _ = server.gateway.break_look_off(link);
        }
        if let Some(number) = view.number.filter(|_| live) {
            terminal::draw(&format!(
                "\r\x1b[Kasking address {number} ({} of {})",
                view.done + 1,
                view.of
            ));
        }
        clock::sleep_until(clock::now() + LOOK_EVERY);
        view = server.gateway.look_told(link).map_err(refused)?;
    }
    if live {
        terminal::draw("\r\x1b[K");
    }
    Ok(view)
}

fn show(views: &[LookView], format: Format) -> Result<()> {
    let mut out = Output::stdout();
    let found = || views.iter().flat_map(|view| view.found.iter().map(move |one| (view.link, one)));
    match format {
        Format::Text if found().next().is_none() => {}
        Format::Text => {
            let mut table = Table::with_heads(&["axis", "link", "drive", "known by", "product"]);
            for (link, one) in found() {
                let FoundDrive { number, profile, known, drive, .. } = one.clone();
                table.row([number.to_string(), link.to_string(), profile, known, drive]);
            }
            out.buffer().extend_from_slice(table.render(colour_out()).as_bytes());
            for (link, one) in found() {
                if let Some(clash) = &one.clash {
                    out.line(&format!("axis {} of link {link}: {clash}", one.number));
                }
            }
        }
        Format::Jsonl => found().for_each(|(link, one)| object(link, one, out.buffer())),
        Format::Csv => {
            out.line("axis,link,drive,known,product,clash");
            for (link, one) in found() {
                let (number, link) = (one.number.to_string(), link.to_string());
                let clash = one.clash.as_deref().unwrap_or_default();
                out.line(&csv([&*number, &link, &one.profile, &one.known, &one.drive, clash]));
            }
        }
    }
    out.flush()
}

fn object(link: u16, found: &FoundDrive, out: &mut Vec<u8>) {
    let head = format!("{{\"axis\":{},\"link\":{link},\"drive\":", found.number);
    out.extend_from_slice(head.as_bytes());
    jsonl::string(out, &found.profile);
    out.extend_from_slice(b",\"product\":");
    jsonl::string(out, &found.drive);
    out.extend_from_slice(b",\"known\":");
    jsonl::string(out, &found.known);
    out.extend_from_slice(format!(",\"clash\":{}}}\n", found.clash.is_some()).as_bytes());
}

/// What there is to say of a look besides.
fn tell(server: &Joined, view: &LookView) {
    for tried in &view.tried {
        say(&format!("link {}: tried {tried}", view.link));
    }
    let label = |id: u16| server.bench.axes.iter().find(|axis| axis.id == id).map(|a| &*a.label);
    for asked in &view.axes {
        let label = label(asked.axis).unwrap_or("an axis");
        if !asked.answers {
            say(&format!("{label} did not answer"));
        }
        if let Some(clash) = &asked.clash {
            say(&format!("{label}: {clash}"));
        }
    }
    if view.found.is_empty() {
        say(&format!("link {}: no drive answered that is no axis", view.link));
    }
}
