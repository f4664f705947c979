//! `polepair --server URL scan --look`: the server scans its links.

use std::ops::RangeInclusive;
use std::time::Duration;

use polepair::url::AxisNumber;
use polepair_capture::jsonl;
use polepair_client::message::{AddDrives, AxisInfo, FoundDrive, ScanRequest, ScanState, ScanView};
use polepair_link::clock;

use super::{conflicts_result, report_unconfigured};
use crate::interrupt;
use crate::problem::{Exit, Problem, Result};
use crate::progress::Progress;
use crate::remote::{RemoteSession, refusal_problem};
use crate::target::OutputFormat;
use crate::terminal::{DataOutput, TextTable, colour_out, csv_line, print_note, print_warning};

/// Between two questions how far it is.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Looks on each link that one of these axes is on, one after the other.
pub fn run_remote_scan(
    server: &RemoteSession,
    axes: &[AxisInfo],
    ids: Option<RangeInclusive<u32>>,
    format: OutputFormat,
    take: bool,
) -> Result {
    interrupt::listen(|| {});
    let mut links: Vec<u16> = axes.iter().map(|axis| axis.link).collect();
    // Axes that were taken in stand behind all others.
    links.sort_unstable();
    links.dedup();
    let request = ScanRequest {
        first: ids.as_ref().map(|ids| *ids.start()),
        last: ids.as_ref().map(|ids| *ids.end()),
    };
    let mut views = Vec::new();
    for link in links {
        let view = scan_link(server, link, &request)?;
        let ends = view.state == ScanState::BrokenOff;
        views.push(view);
        if ends {
            break;
        }
    }
    print_found(&views, format)?;
    for view in &views {
        report_scan(server, view);
    }
    if let Some(error) = views.iter().find_map(|view| view.error.clone()) {
        return Err(refusal_problem(error));
    }
    if let Some(view) = views.iter().find(|view| view.state == ScanState::BrokenOff) {
        print_warning(&format!("cancelled: {} addresses were not tried", view.unasked));
        return Err(if interrupt::was_interrupted() {
            Problem::interrupted()
        } else {
            Problem::new(Exit::Refused, "E102", "the scan was cancelled.").hint("scan again later")
        });
    }
    if take {
        for view in views.iter().filter(|view| view.found.iter().any(|one| one.clash.is_none())) {
            let added = server
                .gateway
                .add_drives(view.link, &AddDrives::default())
                .map_err(refusal_problem)?;
            let count = added.axes.len();
            print_note(&format!("link {}: {count} added after all other axes", view.link));
        }
    }
    let found = || views.iter().flat_map(|view| &view.found);
    conflicts_result(found().filter(|one| one.clash.is_some()).count(), found().count())
}

/// Looks on a link until the end.
fn scan_link(server: &RemoteSession, link: u16, request: &ScanRequest) -> Result<ScanView> {
    let bar = Progress::of_count(0, "addresses");
    let mut view = server.gateway.start_scan(link, request).map_err(refusal_problem)?;
    let mut broken = false;
    while view.state == ScanState::UnderWay {
        if interrupt::was_interrupted() && !std::mem::replace(&mut broken, true) {
            // It may just have ended.
            let _ = server.gateway.cancel_scan(link);
        }
        bar.set_of(view.done as usize, view.of as usize);
        clock::sleep_until(clock::now() + POLL_INTERVAL);
        view = server.gateway.scan_view(link).map_err(refusal_problem)?;
    }
    Ok(view)
}

fn print_found(views: &[ScanView], format: OutputFormat) -> Result<()> {
    let mut out = DataOutput::stdout().with_text(format == OutputFormat::Text);
    let found = || views.iter().flat_map(|view| view.found.iter().map(move |one| (view.link, one)));
    match format {
        OutputFormat::Text if found().next().is_none() => {}
        OutputFormat::Text => {
            let mut table =
                TextTable::with_heads(&["axis", "link", "drive", "known by", "product"]);
            for (link, one) in found() {
                let FoundDrive { number, profile, known, drive, .. } = one.clone();
                table.add_row([number.to_string(), link.to_string(), profile, known, drive]);
            }
            out.buffer().extend_from_slice(table.render(colour_out()).as_bytes());
            for (link, one) in found() {
                if let Some(clash) = &one.clash {
                    out.write_line(&format!(
                        "axis {} of link {link}: {clash}",
                        AxisNumber(one.number)
                    ));
                }
            }
        }
        OutputFormat::Jsonl => found().for_each(|(link, one)| write_json(link, one, out.buffer())),
        OutputFormat::Csv => {
            out.write_line("axis,link,drive,known,product,clash");
            for (link, one) in found() {
                let (number, link) = (AxisNumber(one.number).to_string(), link.to_string());
                let clash = one.clash.as_deref().unwrap_or_default();
                out.write_line(&csv_line([
                    &*number,
                    &link,
                    &one.profile,
                    &one.known,
                    &one.drive,
                    clash,
                ]));
            }
        }
    }
    out.flush()
}

fn write_json(link: u16, found: &FoundDrive, out: &mut Vec<u8>) {
    let head = format!("{{\"axis\":{},\"link\":{link},\"drive\":", AxisNumber(found.number).json());
    out.extend_from_slice(head.as_bytes());
    jsonl::write_string(out, &found.profile);
    out.extend_from_slice(b",\"product\":");
    jsonl::write_string(out, &found.drive);
    out.extend_from_slice(b",\"known\":");
    jsonl::write_string(out, &found.known);
    out.extend_from_slice(format!(",\"clash\":{}}}\n", found.clash.is_some()).as_bytes());
}

/// Prints the further results of a scan.
fn report_scan(server: &RemoteSession, view: &ScanView) {
    for tried in &view.tried {
        print_note(&format!("link {}: tried {tried}", view.link));
    }
    let label = |id: u16| server.bench.axes.iter().find(|axis| axis.id == id).map(|a| &*a.label);
    for probed_axis in &view.axes {
        let label = label(probed_axis.axis).unwrap_or("an axis");
        if !probed_axis.answers {
            print_note(&format!("{label} did not answer"));
        }
        if let Some(clash) = &probed_axis.clash {
            print_warning(&format!("{label}: {clash}"));
        }
    }
    if view.has_unconfigured {
        report_unconfigured(&server.bench.links[usize::from(view.link)].url);
    }
    if view.found.is_empty() {
        print_note(&format!("link {}: no new drive replied", view.link));
    }
}
