//! A running server: its functions by REST requests.

use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;
use std::task::{Wake, Waker};

use polepair_messages::{
    AddDrives, AddedAxes, AxisState, BenchView, CommandOutcome, DeviceDetailView, DismissAbsent,
    DismissStop, ParameterChange, ParameterInfo, ParameterReading, ProgramState, ProgramView,
    RawRequest, ScanRequest, ScanView, SetWatchdog, SignalValue, SimulationAction, StopReport,
    StopRequest, WatchdogView, WriteParameters,
};
use tokio::runtime::{Builder, Handle, Runtime};
use tokio::sync::oneshot;

use crate::address::Address;
use crate::dialer::Dialer;
use crate::lease::PendingOperation;
use crate::live::LiveConnection;
use crate::rest::RestClient;
use crate::{GatewayError, secret, tls};

/// Address of a server, and the credentials for it.
#[derive(Debug, Clone, Default)]
pub struct GatewayOptions {
    /// `http://127.0.0.1:7365`; `https`, `ws`, `wss` as well.
    pub url: String,
    /// A file whose first token is used. Otherwise `POLEPAIR_TOKEN`; on the loopback only, the token of this
    /// account's own server, if the server proves that it has it.
    pub token_file: Option<PathBuf>,
    /// The certificate that the server must have: its file, or its SHA-256; else that of this
    /// account's own server.
    pub certificate: Option<String>,
    /// The certificate that we show, in PEM, where the server wants one (`--client-ca`).
    pub client_cert: Option<PathBuf>,
    /// Private key of the client certificate; without it the certificate's file holds both.
    pub client_key: Option<PathBuf>,
}

/// A running server. Cheap to clone; all clones ask through one connection.
#[derive(Clone)]
pub struct Gateway(Arc<GatewayInner>);

struct GatewayInner {
    url: String,
    dialer: Dialer,
    rest: RestClient,
    /// There until the end.
    runtime: Option<Runtime>,
    handle: Handle,
}

impl fmt::Debug for Gateway {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Gateway").field("url", &self.0.url).finish_non_exhaustive()
    }
}

struct DetachedWaker {
    handle: Handle,
    waker: Waker,
}

impl Wake for DetachedWaker {
    fn wake(self: Arc<Self>) {
        let waker = self.waker.clone();
        self.handle.spawn_blocking(move || waker.wake());
    }
}

impl Drop for GatewayInner {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            // Dropped within another runtime, waiting for its threads would panic.
            runtime.shutdown_background();
        }
    }
}

impl Gateway {
    /// Finds token and certificate. The first request contacts the server.
    ///
    /// # Errors
    /// `E256`, `E252` for invalid options; `E301` to `E305` for files.
    pub fn new(options: &GatewayOptions) -> Result<Self, GatewayError> {
        let address = Arc::new(Address::parse(&options.url)?);
        let tls = address.tls.then(|| tls::load_tls(options)).transpose()?;
        let secret = secret::find_token(options.token_file.as_deref(), &address)?;
        // A thread of its own: leases are renewed while the caller computes.
        let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.map_err(|error| {
            GatewayError::new("E318", format!("no thread can be started: {error}"))
        })?;
        let handle = runtime.handle().clone();
        let url =
            format!("{}://{}", if tls.is_some() { "https" } else { "http" }, address.authority());
        let wire = Dialer { address, secret, tls };
        let rest = RestClient::new(wire.clone());
        Ok(Self(Arc::new(GatewayInner { url, dialer: wire, rest, runtime: Some(runtime), handle })))
    }

    /// Address of the server, without secrets.
    #[must_use]
    pub fn url(&self) -> &str {
        &self.0.url
    }

    /// Reads the bench: links, axes, and the commands of each axis.
    ///
    /// # Errors
    /// The server's error, here and below; `E314`, `E315`, `E321` where it cannot be reached.
    pub fn bench(&self) -> Result<BenchView, GatewayError> {
        self.block_on(self.0.rest.list("/api/v1/bench"))
    }

    /// Reads the last known state of an axis. Nothing is sent to the drive.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn axis_state(&self, id: u16) -> Result<AxisState, GatewayError> {
        self.block_on(self.0.rest.get(&format!("/api/v1/axes/{id}")))
    }

    /// Reads signals of an axis now, by their words.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn signals(&self, id: u16, words: &[&str]) -> Result<Vec<SignalValue>, GatewayError> {
        let words: Vec<_> = words.iter().map(|word| escaped(word)).collect();
        self.block_on(self.0.rest.get(&format!("/api/v1/axes/{id}/signals/{}", words.join(","))))
    }

    /// Lists the parameters of an axis, without values.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn parameters(&self, id: u16) -> Result<Vec<ParameterInfo>, GatewayError> {
        self.block_on(self.0.rest.get(&format!("/api/v1/axes/{id}/parameters")))
    }

    /// Reads a drive's name, versions and similar facts.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn device(&self, id: u16) -> Result<Vec<DeviceDetailView>, GatewayError> {
        self.block_on(self.0.rest.get(&format!("/api/v1/axes/{id}/device")))
    }

    /// Reads the program in a module's memory.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn program(&self, id: u16) -> Result<ProgramView, GatewayError> {
        self.block_on(self.0.rest.get(&format!("/api/v1/axes/{id}/program")))
    }

    /// Reads the state of a module's program.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn program_state(&self, id: u16) -> Result<ProgramState, GatewayError> {
        self.block_on(self.0.rest.get(&format!("/api/v1/axes/{id}/program/state")))
    }

    /// Reads a parameter now, by its name, its symbol or its address.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn parameter(&self, id: u16, name: &str) -> Result<ParameterReading, GatewayError> {
        let name = escaped(name);
        self.block_on(self.0.rest.get(&format!("/api/v1/axes/{id}/parameters/{name}")))
    }

    /// Writes parameters, or returns what would change. Sent once.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn write_parameters(
        &self,
        id: u16,
        wanted: &WriteParameters,
    ) -> Result<Vec<ParameterChange>, GatewayError> {
        self.block_on(self.0.rest.post(&format!("/api/v1/axes/{id}/parameters"), wanted))
    }

    /// Reads how an axis' own watchdog is set now.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn watchdog(&self, id: u16) -> Result<WatchdogView, GatewayError> {
        self.block_on(self.0.rest.get(&format!("/api/v1/axes/{id}/watchdog")))
    }

    /// Sets an axis' own watchdog, and returns its new setting. Sent once.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn set_watchdog(
        &self,
        id: u16,
        wanted: &SetWatchdog,
    ) -> Result<WatchdogView, GatewayError> {
        self.block_on(self.0.rest.post(&format!("/api/v1/axes/{id}/watchdog"), wanted))
    }

    /// Starts a scan for drives on a link, by reads only. Returns when it has started.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn start_scan(&self, link: u16, request: &ScanRequest) -> Result<ScanView, GatewayError> {
        self.block_on(self.0.rest.post(&format!("/api/v1/links/{link}/look"), request))
    }

    /// The look on a link that is under way, or the last.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn scan_view(&self, link: u16) -> Result<ScanView, GatewayError> {
        self.block_on(self.0.rest.get(&format!("/api/v1/links/{link}/look")))
    }

    /// Breaks a look off.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn cancel_scan(&self, link: u16) -> Result<(), GatewayError> {
        self.block_on(self.0.rest.delete(&format!("/api/v1/links/{link}/look")))
    }

    /// Makes axes of drives that the last look on a link found. Sent once.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn add_drives(&self, link: u16, take: &AddDrives) -> Result<AddedAxes, GatewayError> {
        self.block_on(self.0.rest.post(&format!("/api/v1/links/{link}/look/take"), take))
    }

    /// Stops axes, also those whose leases other clients hold. Without names it stops all axes and locks motion.
    /// Returns when the result is known, at the latest after 12 s.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn stop(&self, request: &StopRequest) -> Result<StopReport, GatewayError> {
        self.block_on(self.0.rest.stop("/api/v1/stop", request)).map_err(|refused| match &*refused
            .code
        {
            "E313" | "E314" | "E315" | "E501" => refused.hint(
                "cut the supply of motors that still turn; when the server's process has ended, \
                 `polepair stop URL` stops them directly",
            ),
            _ => refused,
        })
    }

    /// Lets axes move again after everything was stopped. Nothing moves by it.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn release(&self) -> Result<(), GatewayError> {
        self.block_on(self.0.rest.post("/api/v1/release", &serde_json::json!({})))
    }

    /// Does something to a simulated drive from outside its wire: a word of the axis' acts, with its
    /// value where it takes one. `place` counts the axes of its link from 0.
    ///
    /// # Errors
    /// As [`bench`](Self::bench); `gateway.simulated` for a real drive, `E217` for what cannot be done.
    pub fn act(
        &self,
        link: u16,
        place: usize,
        act: &str,
        value: Option<f64>,
    ) -> Result<(), GatewayError> {
        let action = SimulationAction { act: act.to_owned(), value };
        let path = format!("/api/v1/simulation/{link}/{place}");
        self.block_on(self.0.rest.post(&path, &action))
    }

    /// Clears the pending stop of an axis whose standstill is not confirmed. The journal records the user.
    ///
    /// # Errors
    /// As [`bench`](Self::bench); `gateway.lease` for a caller without the axis' lease.
    pub fn dismiss(&self, id: u16, dismiss: &DismissStop) -> Result<(), GatewayError> {
        self.block_on(self.0.rest.post(&format!("/api/v1/axes/{id}/dismiss"), dismiss))
    }

    /// Clears the pending stop, from before a restart of the server, of a drive that is not connected.
    ///
    /// # Errors
    /// As [`bench`](Self::bench); `E212` where no stop is pending, or the drive is connected.
    pub fn dismiss_absent(&self, dismiss: &DismissAbsent) -> Result<(), GatewayError> {
        self.block_on(self.0.rest.post("/api/v1/dismiss", dismiss))
    }

    /// Sends a request in the protocol's own text. Sent once.
    pub(crate) fn raw(
        &self,
        id: u16,
        request: &RawRequest,
    ) -> Result<CommandOutcome, GatewayError> {
        self.block_on(self.0.rest.post(&format!("/api/v1/axes/{id}/raw"), request))
    }

    /// Runs a call that blocks on a thread of its own, and returns at once.
    pub fn spawn_blocking(&self, call: impl FnOnce() + Send + 'static) {
        self.0.handle.spawn_blocking(call);
    }

    /// Has something of this done by a thread of its own, and returns without waiting for it.
    pub fn spawn<T: Send + 'static>(
        &self,
        what: impl FnOnce(&Self) -> Result<T, GatewayError> + Send + 'static,
    ) -> PendingOperation<T> {
        let (reply_sender, reply) = oneshot::channel();
        let gateway = self.clone();
        // The waiting task may have been dropped.
        self.0.handle.spawn_blocking(move || drop(reply_sender.send(what(&gateway))));
        PendingOperation::new(reply, self.clone())
    }

    /// Stays: for leases and telemetry.
    ///
    /// # Errors
    /// As [`bench`](Self::bench).
    pub fn live(&self) -> Result<LiveConnection, GatewayError> {
        self.block_on(LiveConnection::open(self.clone(), self.0.dialer.clone()))
    }

    /// A waker that wakes another from a thread of its own: the woken code may be slow, and the client's one thread
    /// renews leases.
    pub(crate) fn detached_waker(&self, waker: &Waker) -> Waker {
        Waker::from(Arc::new(DetachedWaker { handle: self.0.handle.clone(), waker: waker.clone() }))
    }

    /// Waits for something, in the caller's thread.
    pub(crate) fn block_on<T>(&self, what: impl Future<Output = T>) -> T {
        self.0.handle.block_on(what)
    }
}

/// Escapes characters that a path must not contain.
fn escaped(name: &str) -> String {
    name.bytes().fold(String::with_capacity(name.len()), |mut text, byte| {
        if is_plain_byte(byte) {
            text.push(char::from(byte))
        } else {
            text.push_str(&format!("%{byte:02X}"))
        }
        text
    })
}

fn is_plain_byte(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.')
}

#[cfg(test)]
mod tests {
    #[test]
    fn names_are_written_so_that_they_stay_one_part_of_a_path() {
        assert_eq!(super::escaped("max current"), "max%20current");
        assert_eq!(super::escaped("a/b?°"), "a%2Fb%3F%C2%B0");
    }
}
