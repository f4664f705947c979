//! `polepair --server URL scan --look`: the server scans its links.

use std::ops::RangeInclusive;
use std::time::Duration;

use polepair_client::message::{AddDrives, AxisInfo, ScanRequest, ScanState, ScanView};
use polepair_link::clock;

use super::drive_table::DriveColumn::{Axis, Clash, Drive, Known, Link, Product, Reported};
use super::drive_table::{DriveRow, print_drives};
use super::{conflicts_result, report_unconfigured};
use crate::interrupt;
use crate::problem::{Exit, Problem, Result};
use crate::progress::Progress;
use crate::remote::{RemoteSession, refusal_problem};
use crate::target::OutputFormat;
use crate::terminal::{print_note, print_warning};

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
    let found =
        views.iter().flat_map(|view| view.found.iter().map(move |found| (view.link, found)));
    let drives: Vec<DriveRow> =
        found.map(|(link, found)| DriveRow::found_by_server(link, found)).collect();
    print_drives(&drives, &[Axis, Link, Drive, Known, Product, Clash, Reported], format)?;
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
    conflicts_result(drives.iter().filter(|one| one.clash.is_some()).count(), drives.len())
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
