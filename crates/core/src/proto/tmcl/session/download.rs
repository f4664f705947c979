//! Download mode: between 132 and 133 a module adds what it receives to its program.
//!
//! Nothing but the program may be sent then: no probe, no repetition, no reading of another part of this host. A
//! stored instruction has no effect, whatever it is: `MST` stops no motor, 136 returns no text, and each reply has
//! status 101.

use super::{HostRequest, Opcode, Session};
use crate::error::{Failure, Unsupported};
use crate::proto::tmcl::host_request::Storing;
use crate::proto::tmcl::opcode::Status;

impl Session {
    /// Why a request is not sent because of download mode, or the lack of it.
    pub(super) fn download_refusal(&self, request: &HostRequest) -> Option<Failure> {
        const RULE: &str =
            "the module's download mode has ended, so it would execute the instruction";
        let stores = self.storing_modules.contains(request.request.address);
        match request.storing {
            Storing::Required if !stores => Some(Failure::Impossible(Unsupported::Forbidden(RULE))),
            // What the module itself would answer after it has stored the request.
            Storing::Never if stores && request.request.opcode != Opcode::DownloadEnd => {
                Some(Failure::Refused { code: Status::Loaded.number().into() })
            }
            _ => None,
        }
    }

    /// Returns whether the module will store the request instead of executing it.
    pub(super) fn is_stored(&self, request: &HostRequest) -> bool {
        self.storing_modules.contains(request.request.address)
            && request.request.opcode != Opcode::DownloadEnd
    }

    /// A request was answered or given up: 133 ends the mode. Without a reply to it the module may still be in that
    /// mode; status 101 of its next reply shows it.
    pub(super) fn note_download_end(&mut self, request: &HostRequest) {
        let module = request.request.address;
        if request.request.opcode != Opcode::DownloadEnd || !self.storing_modules.contains(module) {
            return;
        }
        self.storing_modules.remove(module);
        // Doubt that arose meanwhile is settled now.
        self.suspects.set_probe_due(module, true);
        self.update_suspicious();
    }

    /// The module executed what it was to store, or refused 132: it is not in download mode.
    pub(super) fn note_not_storing(&mut self, module: u8) {
        self.storing_modules.remove(module);
        self.update_suspicious();
    }
}
