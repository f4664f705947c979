//! The scan of one wire: its client, its progress, and its results.

use std::sync::{Arc, Mutex, MutexGuard, OnceLock};

use polepair::Connector;
use polepair::scan::{DetectedDrive, ScanAddresses};

use super::clock::BenchClock;
use super::context::{BenchContext, BenchEvent};
use super::lease::SessionName;
use super::lock::lock_unpoisoned;
use super::scan_flag::scan_error;
use crate::message::{GatewayError, ScanState, ScanView};

/// State of scans on one wire.
pub(super) struct LinkScan {
    pub link: u16,
    pub connector: Connector,
    /// The opened link, with all added drives, and the index of this wire in it; empty before it was opened.
    root: OnceLock<(Arc<Mutex<polepair::LocalLink>>, usize)>,
    pub requested: Mutex<Option<ScanAddresses>>,
    /// The look under way, or the last.
    pub view: Mutex<Option<ScanView>>,
    pub found: Mutex<Vec<DetectedDrive>>,
}

impl LinkScan {
    pub fn new(link: u16, connector: Connector) -> Self {
        let (requested, view, found) = (Mutex::default(), Mutex::default(), Mutex::default());
        Self { link, connector, root: OnceLock::new(), requested, view, found }
    }

    /// Sets the opened link and the index of this wire in it.
    pub fn set_opened(&self, root: &Arc<Mutex<polepair::LocalLink>>, index: usize) {
        // A link is opened once.
        let _ = self.root.set((Arc::clone(root), index));
    }

    /// The opened link, and the index of this wire in it.
    pub fn root(&self) -> Result<(MutexGuard<'_, polepair::LocalLink>, usize), GatewayError> {
        let (root, index) = self.root.get().ok_or_else(|| scan_error("the link is not open"))?;
        Ok((lock_unpoisoned(root), *index))
    }

    /// With which names and profiles drives are looked for.
    pub fn connector(&self) -> &Connector {
        &self.connector
    }

    /// The last look.
    pub fn last_view(&self) -> Option<ScanView> {
        lock_unpoisoned(&self.view).clone()
    }

    /// Requests a scan from the poller.
    pub fn begin(
        &self,
        shared: &BenchContext,
        session: &SessionName,
        numbers: ScanAddresses,
    ) -> ScanView {
        let view = ScanView {
            link: self.link,
            by: session.to_string(),
            began_ms: BenchClock::wall_ms(shared.now()),
            state: ScanState::UnderWay,
            number: None,
            done: 0,
            of: 0,
            found: Vec::new(),
            axes: Vec::new(),
            tried: Vec::new(),
            unasked: 0,
            has_unconfigured: false,
            error: None,
        };
        lock_unpoisoned(&self.found).clear();
        let mut scan_view = lock_unpoisoned(&self.view);
        *scan_view = Some(view.clone());
        *lock_unpoisoned(&self.requested) = Some(numbers);
        shared.publish(BenchEvent::Scan(view.clone()));
        view
    }

    /// Changes the view and publishes it, in this order also with several callers.
    pub fn update_view(&self, shared: &BenchContext, change: impl FnOnce(&mut ScanView)) {
        let mut scan_view = lock_unpoisoned(&self.view);
        let Some(view) = scan_view.as_mut() else { return };
        change(view);
        shared.publish(BenchEvent::Scan(view.clone()));
    }
}
