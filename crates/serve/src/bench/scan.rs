//! Scans an open wire, and adds the found drives. The poller of the wire scans one address in each round.
//! The command worker decides whether a scan may start.
//!
//! Why: GW-6, GW-7.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use polepair::LocalAxis;
use polepair::axis::summarize_details;
use polepair::scan::{DetectedDrive, DriveScanner, ScanAddresses, ScanProgress, ScanReport};
use polepair_core::time::Instant;
use serde_json::json;
use tokio::sync::oneshot;

use super::AXES_MAX;
use super::context::{BenchContext, BenchEvent};
use super::describe::axis_info;
use super::journal_queue::ActionSubject;
use super::journal_sink::SERVER;
use super::lease::SessionName;
use super::link_scan::LinkScan;
use super::lock::lock_unpoisoned;
use super::open::BenchLink;
use super::reply::PendingReply;
use super::scan_flag::scan_error;
use super::simulated_drive::SimulatedDrive;
use super::wire::{BenchWire, WireRequest};
use super::{AxisEntry, Bench};
use crate::message::{
    AddDrives, AddedAxes, DriveAddress, FoundDrive, GatewayError, JournalAction, ProbedAxis,
    ScanRequest, ScanState, ScanView,
};

/// Interval of progress reports.
const REPORT_INTERVAL: Duration = Duration::from_millis(100);

/// Scanner of one wire.
pub(super) struct LinkScanner {
    link_scan: Arc<LinkScan>,
    wire: Arc<BenchWire>,
    context: Arc<BenchContext>,
    scan: Option<DriveScanner>,
    reported_at: Instant,
}

impl LinkScanner {
    pub fn new(link: &BenchLink, shared: &Arc<BenchContext>) -> Self {
        let (link_scan, wire) = (Arc::clone(&link.scan), Arc::clone(&link.wire));
        Self {
            link_scan,
            wire,
            context: Arc::clone(shared),
            scan: None,
            reported_at: Instant::ZERO,
        }
    }

    /// Asks the next address. False without a scan here.
    pub fn step(&mut self) -> bool {
        if !self.wire.scan_flag.is_active() {
            return false;
        }
        let scanner = match self.scan.take() {
            Some(scanner) => scanner,
            None => {
                let Some(numbers) = lock_unpoisoned(&self.link_scan.requested).take() else {
                    return false;
                };
                let root = self.link_scan.root().map(|(root, index)| (root.clone(), index));
                let scan = root.and_then(|(root, index)| {
                    Ok(DriveScanner::on_link(&self.link_scan.connector, &root, index, numbers)?)
                });
                match scan {
                    Ok(scanner) => scanner,
                    Err(error) => {
                        self.finish(ScanReport::default(), Some(error));
                        return true;
                    }
                }
            }
        };
        self.probe_next(scanner);
        true
    }

    fn probe_next(&mut self, mut scanner: DriveScanner) {
        let (wire, shared) = (Arc::clone(&self.wire), Arc::clone(&self.context));
        let broken = || wire.scan_flag.is_cancelled() || shared.is_closing();
        if broken() {
            scanner.cancel();
        }
        let result = scanner.next_address(&broken).and_then(|at| {
            let Some(at) = at else { return Ok(false) };
            self.report_progress(at);
            scanner.query_next(&broken).map(|()| true)
        });
        match result {
            Ok(true) => self.scan = Some(scanner),
            Ok(false) => self.finish(scanner.finish(), None),
            Err(error) => self.finish(scanner.finish(), Some(error.into())),
        }
    }

    fn report_progress(&mut self, at: ScanProgress) {
        let now = self.context.now();
        // Addresses that do not answer pass within milliseconds, faster than a page can draw.
        if now.since(self.reported_at) < REPORT_INTERVAL {
            return;
        }
        self.reported_at = now;
        self.link_scan.update_view(&self.context, |view| {
            view.number = Some(at.number);
            (view.done, view.of) = (at.done as u32, at.of as u32);
        });
    }

    fn finish(&self, scan: ScanReport, error: Option<GatewayError>) {
        let broken = self.wire.scan_flag.is_cancelled() || scan.not_queried > 0;
        let state = match (&error, broken) {
            (Some(_), _) => ScanState::Failed,
            (None, true) => ScanState::BrokenOff,
            (None, false) => ScanState::Done,
        };
        let found: Vec<FoundDrive> = scan.found.iter().map(|one| self.found_drive(one)).collect();
        let axes =
            self.link_scan.root().map_or_else(|_| Vec::new(), |(root, _)| root.axes().to_vec());
        let requests = scan.axes.iter().filter_map(|one| {
            let axis = self.find_axis_id(axes.get(one.index)?)?;
            Some(ProbedAxis { axis, answers: one.answers, clash: one.clash.clone() })
        });
        let queried: Vec<ProbedAxis> = requests.collect();
        let silent: Vec<u16> = queried.iter().filter(|one| !one.answers).map(|o| o.axis).collect();
        let numbers: Vec<u32> = found.iter().map(|one| one.number).collect();
        let detail = json!({
            "link": self.link_scan.link, "state": state, "found": numbers, "silent": silent,
        });
        *lock_unpoisoned(&self.link_scan.found) = scan.found;
        // A client that receives the end may take an axis at once.
        self.wire.scan_flag.end();
        self.context.record(&SERVER.into(), JournalAction::Look, None, detail);
        self.link_scan.update_view(&self.context, |view| {
            (view.state, view.number, view.error) = (state, None, error);
            view.done = view.of;
            (view.found, view.axes, view.tried) = (found, queried, scan.tried);
            view.unasked = scan.not_queried as u32;
            view.has_unconfigured = scan.has_unconfigured;
            // Before the report: its receiver may start the next scan.
            self.context.scan_active.store(false, Ordering::SeqCst);
        });
    }

    fn found_drive(&self, found: &DetectedDrive) -> FoundDrive {
        FoundDrive {
            number: found.number,
            protocol: found.protocol.to_owned(),
            profile: found.profile.name.to_owned(),
            drive: found.profile.title.to_owned(),
            known: found.identified.to_string(),
            reported: summarize_details(&found.details),
            clash: found.clash.clone(),
            axis: None,
        }
    }

    /// Finds the number of an axis in the bench.
    fn find_axis_id(&self, axis: &LocalAxis) -> Option<u16> {
        self.wire
            .axes
            .iter()
            .find(|(_, known)| {
                known.number() == axis.number() && known.protocol() == axis.protocol()
            })
            .map(|(id, _)| *id)
    }
}

impl Bench {
    /// Scans a link for drives, by reads only. The reply comes at its start; [`BenchEvent::Scan`] reports its progress
    /// and its end.
    ///
    /// Refused with `gateway.look` while a look is under way on this bench, or an axis of the link is
    /// commanded, armed, powered, turning or being stopped.
    pub fn start_scan(
        &self,
        link: u16,
        session: &SessionName,
        request: ScanRequest,
    ) -> PendingReply<ScanView> {
        let (reply_sender, reply) = oneshot::channel();
        let result = self.find_link(link).and_then(|link| {
            let numbers = requested_addresses(&request)?;
            let sequence = link.wire.reserve_number()?;
            if self.0.context.scan_active.swap(true, Ordering::SeqCst) {
                let what = "a scan is already running";
                return Err(scan_error(what).hint("wait for its end, or cancel it"));
            }
            let (search, wire) = (Arc::clone(&link.scan), Arc::clone(&link.wire));
            let (shared, who) = (Arc::clone(&self.0.context), session.clone());
            let begin = move |may: Result<(), GatewayError>| {
                let started = may.map(|()| search.begin(&shared, &who, numbers));
                if started.is_err() {
                    // Not started: the next request must not wait for an end that never comes.
                    shared.scan_active.store(false, Ordering::SeqCst);
                }
                // The receiver may have been dropped.
                let _ = reply_sender.send(started);
            };
            let what = ActionSubject::new(session, JournalAction::Look, None);
            let detail = json!({ "link": link.id, "first": request.first, "last": request.last });
            self.0.context.journal.write_ahead(
                what,
                detail,
                self.0.context.now(),
                Box::new(move |recorded: Result<(), GatewayError>| match recorded {
                    // After the journal's record: a scan that sends requests has to be on record first.
                    Ok(()) => wire.submit_reserved(sequence, WireRequest::Scan(Box::new(begin))),
                    Err(refused) => begin(Err(refused)),
                }),
            );
            Ok(())
        });
        PendingReply::from_receiver(reply, result)
    }

    /// The look on a link that is under way, or the last.
    ///
    /// # Errors
    /// `gateway.missing` where there was none, or no such link.
    pub fn scan_view(&self, link: u16) -> Result<ScanView, GatewayError> {
        self.find_link(link)?
            .scan
            .last_view()
            .ok_or_else(|| GatewayError::new("gateway.missing", "this link was not scanned"))
    }

    /// Breaks a look off: no address is asked after the one that is being asked.
    ///
    /// # Errors
    /// `gateway.missing` without a scan.
    pub fn cancel_scan(&self, link: u16, session: &SessionName) -> Result<(), GatewayError> {
        let id = link;
        let link = self.find_link(id)?;
        if !link.wire.scan_flag.is_active() {
            let what = "no scan of this link is running";
            return Err(GatewayError::new("gateway.missing", what));
        }
        link.wire.scan_flag.cancel();
        let detail = json!({ "link": id, "broken_off": true });
        self.0.context.record(session, JournalAction::Look, None, detail);
        Ok(())
    }

    /// Makes axes of drives that the last look on a link found. What all other axes are doing goes on.
    ///
    /// The reply is `gateway.missing` for drives that were not found, `gateway.look` for a drive that clashes with
    /// another, during a scan, and without room; otherwise as in [`polepair::LocalLink::add_drives`]. No drive is added
    /// then.
    pub fn add_drives(
        &self,
        link: u16,
        session: &SessionName,
        take: &AddDrives,
    ) -> PendingReply<AddedAxes> {
        let (n, bench) = (usize::from(link), self.clone());
        let found = self.find_link(link).and_then(|link| {
            if link.wire.scan_flag.is_active() {
                return Err(scan_error("the scan is still running").hint("wait for its end"));
            }
            select_drives(link, take)
        });
        let found = match found {
            Ok(found) if found.is_empty() => {
                return PendingReply::ready(Ok(AddedAxes { axes: Vec::new() }));
            }
            Ok(found) => found,
            Err(refused) => return PendingReply::ready(Err(refused)),
        };
        let numbers: Vec<u32> = found.iter().map(|one| one.number).collect();
        let detail = json!({ "link": link, "drives": numbers });
        let (reply_sender, reply) = oneshot::channel();
        let (worker, who) = (Arc::clone(&self.0.links[n].request_worker), session.clone());
        // Limits may have to be asked of the drive: the request worker does that.
        let what = ActionSubject::new(session, JournalAction::TakeIn, None);
        self.0.context.journal.write_ahead(
            what,
            detail,
            self.0.context.now(),
            Box::new(move |recorded: Result<(), GatewayError>| match recorded {
                Ok(()) => worker.submit_query(reply_sender, move || {
                    let taken = bench.add_found_drives(n, &found);
                    let detail = match &taken {
                        Ok(added) => json!({ "link": link, "axes": added.axes }),
                        Err(refused) => json!({ "link": link, "error": refused }),
                    };
                    bench.0.context.record(&who, JournalAction::Outcome, None, detail);
                    taken
                }),
                // The receiver may have been dropped.
                Err(refused) => drop(reply_sender.send(Err(refused))),
            }),
        );
        PendingReply::from_receiver(reply, Ok(()))
    }

    /// Makes axes of drives that were found. Runs in the request worker.
    pub(super) fn add_found_drives(
        &self,
        n: usize,
        found: &[DetectedDrive],
    ) -> Result<AddedAxes, GatewayError> {
        let link = &self.0.links[n];
        // Two clients that add drives at once would both be given the same next axis number.
        let _one_at_a_time = lock_unpoisoned(&self.0.join_lock);
        if link.wire.scan_flag.is_active() {
            return Err(scan_error("a new scan of it is running").hint("wait for its end"));
        }
        if self.0.axes.len() + found.len() > AXES_MAX {
            return Err(scan_error(format!("a bench holds {AXES_MAX} axes")));
        }
        let (all, before) = {
            let (mut root, index) = link.scan.root()?;
            let before = root.axes().len();
            *root = root.add_drives(index, found)?;
            (root.clone(), before)
        };
        debug_assert!(self.0.axes.len() < usize::from(u16::MAX));
        let base = self.0.axes.len() as u16;
        let mut ids = Vec::new();
        for axis in &all.axes()[before..] {
            ids.extend(self.add_axis(n, axis));
        }
        self.0.traffic.replace_decoder(n, link.decoder());
        link.scan.update_view(&self.0.context, |view| {
            for (found, id) in found.iter().zip(&ids) {
                view.found
                    .iter_mut()
                    .filter(|one| one.number == found.number && one.protocol == found.protocol)
                    .for_each(|one| one.axis = Some(*id));
            }
        });
        self.0.context.publish(BenchEvent::BenchChanged);
        if let Err(error) = self.listen_events(base, before, &all) {
            tracing::warn!(%error, "cannot listen for unsolicited messages of the added drives");
        }
        Ok(AddedAxes { axes: ids })
    }

    /// One more axis on a link: who looks after it finds it there before anybody can ask for it.
    pub(super) fn add_axis(&self, n: usize, axis: &LocalAxis) -> Option<u16> {
        let link = &self.0.links[n];
        let BenchLink { wire, id, .. } = link;
        let (entry, index) = (self.0.axes.len() as u16, wire.axes.len());
        let drive = link.simulation().and_then(|(simulation, link)| {
            SimulatedDrive::find(simulation, *link, axis.number(), index)
        });
        let info = axis_info(entry, *id, axis, drive.as_ref());
        self.0.telemetry.add_axis();
        // A stop that the server before could not confirm goes with the drive, not with its number.
        let pending_stop = self.0.context.inherited_stop(&link.url, axis);
        wire.add_axis(entry, axis.clone(), pending_stop.map(|stop| stop.view()))?;
        self.0.axes.push(AxisEntry { link: n, local_index: index, info, drive })?;
        wire.wake_worker();
        Some(entry)
    }

    fn find_link(&self, id: u16) -> Result<&BenchLink, GatewayError> {
        self.0.links.get(usize::from(id)).ok_or_else(|| {
            GatewayError::new("gateway.missing", format!("the bench has no link {id}"))
                .hint("links count from 0, in the order of the bench's list")
        })
    }
}

/// The drives that are meant, and may be taken in.
fn select_drives(link: &BenchLink, take: &AddDrives) -> Result<Vec<DetectedDrive>, GatewayError> {
    let found = lock_unpoisoned(&link.scan.found).clone();
    let last_found: Vec<_> =
        link.scan.last_view().into_iter().flat_map(|view| view.found).collect();
    let axis = |one: &DetectedDrive| {
        last_found
            .iter()
            .find(|found_drive| {
                found_drive.number == one.number && found_drive.protocol == one.protocol
            })
            .and_then(|found_drive| found_drive.axis)
    };
    if let Some(missing) =
        take.drives.iter().find(|d| !found.iter().any(|f| drive_address(f) == **d))
    {
        let what = format!("no drive was found at {} {}", missing.protocol, missing.number);
        return Err(GatewayError::new("gateway.missing", what).hint("scan the link first"));
    }
    let every = take.drives.is_empty();
    let mut chosen = Vec::new();
    for one in &found {
        let named = take.drives.contains(&drive_address(one));
        let fits = axis(one).is_none() && one.clash.is_none();
        match (&one.clash, axis(one)) {
            _ if every && fits => {}
            _ if !named => continue,
            (_, Some(axis)) => {
                return Err(scan_error(format!("that drive is already axis {axis}")));
            }
            (Some(clash), _) => {
                let what = format!("requests to {} may reach two drives: {clash}", one.number);
                return Err(scan_error(what).hint("give each its own address, and scan again"));
            }
            (None, None) => {}
        }
        chosen.push(one.clone());
    }
    Ok(chosen)
}

fn drive_address(one: &DetectedDrive) -> DriveAddress {
    DriveAddress { protocol: one.protocol.to_owned(), number: one.number }
}

/// The addresses that are meant.
fn requested_addresses(request: &ScanRequest) -> Result<ScanAddresses, GatewayError> {
    match (request.first, request.last) {
        (None, None) => Ok(ScanAddresses::ALL),
        (Some(first), last) if last.is_none_or(|last| first <= last) => {
            Ok(ScanAddresses::from(first..=last.unwrap_or(first)))
        }
        _ => Err(GatewayError::new(
            "gateway.request",
            "the addresses must go from `first` to \
             `last`",
        )),
    }
}
