//! The server: opens the bench, listens, passes requests to the guard, and shuts down in order.

use polepair::url::without_axes;
use polepair_core::convert::saturating;
use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use polepair::Connector;
use polepair::url::shell_word;
use polepair_link::clock;
use serde_json::json;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::{oneshot, watch};
use tower::ServiceExt as _;

use crate::api;
use crate::app_state::{AppState, LiveRuntimes, SharedAppState};
use crate::auth::Authenticator;
use crate::bench::{self, Bench};
use crate::connections::{ConnectionLimiter, ConnectionSlot, LocalAddress};
use crate::error::SetupError;
use crate::guard::guard;
use crate::hosts::AllowedHosts;
use crate::journal::JournalFile;
use crate::message::{GatewayError, JournalAction};
use crate::options::ServerOptions;
use crate::tls::{self, ServerTls};
use crate::token;

/// Time limit of a request's head, and of the pause between two; a TLS greeting likewise.
const HEAD_MAX: Duration = Duration::from_secs(5);
/// Bytes of a request's head.
const HEAD_BYTES_MAX: usize = 32 * 1024;
/// Time limit of open connections at the end.
const SHUTDOWN_MAX: Duration = Duration::from_millis(500);
/// Pause in accepting when the system has no more sockets.
const ACCEPT_BACKOFF: Duration = Duration::from_millis(20);
/// The tokens' file in the server's folder.
const TOKENS: &str = "tokens";
/// The journal's.
const JOURNAL: &str = "journal.jsonl";
/// Name of the file with logins of browsers.
const SESSIONS: &str = "sessions";

/// A server that runs.
pub struct GatewayServer {
    /// Runtimes of readers and of writers.
    runtimes: Option<Runtimes>,
    /// Thread that polls for viewers, and the sender that ends it.
    broadcaster: Option<(JoinHandle<()>, oneshot::Sender<()>)>,
    state: SharedAppState,
    address: SocketAddr,
    url: String,
    fingerprint: Option<String>,
    truncated_bytes: u64,
    inherited_stops: Vec<(String, u32)>,
    end: watch::Sender<bool>,
}

/// Threads for tasks: each group has its own, so that none waits in another's queue.
struct Runtimes {
    /// Requests that need no login: connections, handshakes, pages, REST.
    http: Runtime,
    /// Messages of viewers.
    inbound: Runtime,
    /// Messages to viewers.
    outbound: Runtime,
}

impl std::fmt::Debug for GatewayServer {
    /// Without its URL, which contains a login.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Server at {}", self.address)
    }
}

/// Ends a server, from any thread.
#[derive(Debug, Clone)]
pub struct ShutdownHandle(watch::Sender<bool>);

impl ShutdownHandle {
    /// Ends it: [`GatewayServer::wait`] returns.
    pub fn shutdown(&self) {
        self.0.send_replace(true);
    }
}

impl GatewayServer {
    /// Opens the links, without any a simulated rack, and serves them.
    ///
    /// # Errors
    /// The options would let others in, a file is not as it has to be, the address is taken, a link
    /// cannot be opened.
    pub fn start(
        options: &ServerOptions,
        urls: &[String],
        connector: Connector,
    ) -> Result<Self, SetupError> {
        options.check()?;
        create_folder(&options.folder)?;
        let grants = token::load(&options.folder.join(TOKENS))?;
        let tls = if options.tls { Some(tls::load(options)?) } else { None };
        let (listener, address) = listen(options.bind)?;
        let path = options.folder.join(JOURNAL);
        let (journal, cut) = JournalFile::open(&path)?;
        let pending =
            journal.pending_stops().map_err(|error| SetupError::file(&path, "read", &error))?;
        let journal = Arc::new(journal);
        let opened = bench::BenchOptions {
            connector,
            lease_duration: clock::scale_timeout(bench::LEASE_DURATION),
            last_epoch: journal.count(),
            inherited_stops: pending.clone(),
            journal: Arc::<JournalFile>::clone(&journal),
            search_ports: options.search_ports.clone(),
        };
        let bench = Bench::open(urls, opened)?;
        let links: Vec<_> = bench.snapshot().links.into_iter().map(|link| link.url).collect();
        let detail = json!({
            "version": env!("CARGO_PKG_VERSION"), "links": links, "address": address,
            "scopes": options.scopes.iter().collect::<Vec<_>>(), "cut": cut,
        });
        let started = bench.write_journal("server", JournalAction::Started, detail).wait();
        started.map_err(|refused| journal_start_error(refused, urls))?;
        let authenticator = Authenticator::new(grants, options.scopes, address.port(), options.tls)
            .with_session_file(&options.folder.join(SESSIONS));
        let hosts = AllowedHosts::new(
            options.scheme(),
            address.ip(),
            address.port(),
            &options.host_names,
            &options.origins,
        );
        let once = authenticator.issue_one_time_token()?.reveal();
        // Encrypted, who shows shares the cipher with who reads, and must not be put off with it.
        let encrypts = options.tls;
        let runtimes = Runtimes {
            http: runtime(|| {})?,
            inbound: runtime(|| {})?,
            outbound: runtime(move || {
                if !encrypts {
                    polepair_link::lower_priority();
                }
            })?,
        };
        let (inbound, outbound) =
            (runtimes.inbound.handle().clone(), runtimes.outbound.handle().clone());
        let threads = LiveRuntimes { inbound, outbound, encrypted: encrypts };
        let app_state = Arc::new(AppState::new(bench, authenticator, hosts, journal, threads));
        let fingerprint = tls.as_ref().map(|tls| tls.fingerprint.clone());
        let (end, ended) = watch::channel(false);
        let (board_ends, board_ended) = oneshot::channel();
        let board =
            Some((app_state.broadcaster.start(app_state.bench.clone(), board_ended)?, board_ends));
        runtimes.http.spawn(accept_connections(listener, Arc::clone(&app_state), tls, ended));
        let shown = SocketAddr::new(browser_ip(address), address.port());
        let url = format!("{}://{shown}/?once={once}", options.scheme());
        let runtimes = Some(runtimes);
        Ok(Self {
            runtimes,
            broadcaster: board,
            state: app_state,
            address,
            url,
            fingerprint,
            truncated_bytes: cut,
            inherited_stops: pending,
            end,
        })
    }

    /// Listening address.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// URL that logs one browser in, once.
    #[must_use]
    pub fn url(&self) -> &str {
        &self.url
    }

    /// SHA-256 of its certificate, where it encrypts.
    #[must_use]
    pub fn fingerprint(&self) -> Option<&str> {
        self.fingerprint.as_deref()
    }

    /// Bytes of a record without end that were found in the journal: the server before was killed.
    #[must_use]
    pub fn truncated_bytes(&self) -> u64 {
        self.truncated_bytes
    }

    /// Axes whose stop was pending when the previous server ended, by connection string and number: present ones are
    /// stopped now.
    #[must_use]
    pub fn inherited_stops(&self) -> &[(String, u32)] {
        &self.inherited_stops
    }

    /// The bench.
    #[must_use]
    pub fn bench(&self) -> &Bench {
        &self.state.bench
    }

    /// Handle that ends the server.
    #[must_use]
    pub fn shutdown_handle(&self) -> ShutdownHandle {
        ShutdownHandle(self.end.clone())
    }

    /// Waits until the server is ended, then stops all motion and closes everything. Returns the axes without measured
    /// standstill: see [`Bench::shutdown`].
    pub fn wait(mut self) -> Vec<String> {
        if let Some(Runtimes { http, .. }) = &self.runtimes {
            let mut end = self.end.subscribe();
            // The sender is ours: it lives.
            let _ = http.block_on(end.wait_for(|end| *end));
        }
        self.close()
    }

    fn close(&mut self) -> Vec<String> {
        let Some(Runtimes { http, inbound, outbound }) = self.runtimes.take() else {
            return Vec::new();
        };
        self.end.send_replace(true);
        // Motors are stopped before anything that only displays is waited for.
        let left = self.state.bench.shutdown();
        if let Some((thread, end)) = self.broadcaster.take() {
            // One that panicked is over as well.
            let _ = end.send(());
            let _ = thread.join();
            inbound.block_on(
                self.state.broadcaster.wait_until_empty(clock::scale_timeout(SHUTDOWN_MAX)),
            );
        }
        let ended = self.state.bench.write_journal("server", JournalAction::Ended, json!({}));
        if let Err(error) = self.state.bench.close_journal().and_then(|()| ended.wait()) {
            tracing::error!(%error, "cannot write the end of the journal");
        }
        http.shutdown_timeout(SHUTDOWN_MAX);
        inbound.shutdown_timeout(SHUTDOWN_MAX);
        outbound.shutdown_timeout(SHUTDOWN_MAX);
        left
    }
}

impl Drop for GatewayServer {
    fn drop(&mut self) {
        // Only the journal is left to record it.
        let _ = self.close();
    }
}

impl bench::JournalSink for JournalFile {
    fn write_entry(
        &self,
        note: bench::JournalEntry<'_>,
    ) -> Result<(), crate::message::GatewayError> {
        self.write(note.who, note.action, note.axis, note.detail).map(drop)
    }
}

/// Threads for tasks, each of which does that first.
fn runtime(first: impl Fn() + Send + Sync + 'static) -> Result<Runtime, SetupError> {
    let threads = Builder::new_multi_thread().enable_all().on_thread_start(first).build();
    threads.map_err(|error| {
        SetupError::adapter("E318", "no threads can be started").why(error.to_string())
    })
}

/// Error of a journal that does not accept its first record: without it no server runs that could stop anything.
fn journal_start_error(refused: GatewayError, urls: &[String]) -> SetupError {
    let stops = urls.iter().filter(|url| !url.starts_with("sim:"));
    let stops: Vec<_> =
        stops.map(|url| format!("`polepair stop {}`", shell_word(without_axes(url)))).collect();
    let without = if stops.is_empty() {
        String::new()
    } else {
        format!("; to stop motors without a server: {}", stops.join(", "))
    };
    SetupError::from(refused)
        .why("The server was not started.")
        .hint(format!("free space on the disk, or use another folder by --state{without}"))
}

/// Makes the server's folder, for its owner alone.
fn create_folder(path: &Path) -> Result<(), SetupError> {
    let mut builder = std::fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(path).map_err(|error| SetupError::file(path, "make", &error))
}

/// Address for a browser on this machine.
fn browser_ip(address: SocketAddr) -> std::net::IpAddr {
    let ip = address.ip();
    if !ip.is_unspecified() {
        return ip;
    }
    if ip.is_ipv4() { [127, 0, 0, 1].into() } else { std::net::Ipv6Addr::LOCALHOST.into() }
}

fn listen(bind: SocketAddr) -> Result<(std::net::TcpListener, SocketAddr), SetupError> {
    bind_listener(bind).map_err(|error: io::Error| {
        SetupError::adapter("E320", format!("cannot listen on {bind}"))
            .why(format!("The system says: {error}."))
            .hint("another server may use it: --bind 127.0.0.1:0 selects a free port")
    })
}

fn bind_listener(bind: SocketAddr) -> Result<(std::net::TcpListener, SocketAddr), io::Error> {
    let listener = std::net::TcpListener::bind(bind)?;
    listener.set_nonblocking(true)?;
    let address = listener.local_addr()?;
    Ok((listener, address))
}

async fn accept_connections(
    listener: std::net::TcpListener,
    state: SharedAppState,
    tls: Option<ServerTls>,
    mut end: watch::Receiver<bool>,
) {
    let Ok(listener) = TcpListener::from_std(listener) else {
        return tracing::error!("the operating system closed the listening socket");
    };
    let files = polepair_link::raise_file_limit();
    let guarding = axum::middleware::from_fn_with_state(Arc::clone(&state), guard);
    let app = api::router(&state).layer(guarding);
    let connections = ConnectionLimiter::new(files);
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            _ = end.wait_for(|end| *end) => return,
        };
        state.metrics.connections.set(saturating(connections.count()));
        let Ok((stream, peer)) = accepted else {
            connections.make_room();
            tokio::time::sleep(ACCEPT_BACKOFF).await;
            continue;
        };
        let Some((slot, go)) = connections.acquire_slot(peer.ip()) else { continue };
        let acceptor = tls.as_ref().map(|tls| tls.acceptor.clone());
        let (app, mut end) = (app.clone(), end.clone());
        tokio::spawn(async move {
            tokio::select! {
                () = serve_connection(stream, acceptor, app, slot) => {}
                _ = go => {}
                _ = end.wait_for(|end| *end) => {}
            }
        });
    }
}

async fn serve_connection(
    stream: TcpStream,
    tls: Option<tls::Acceptor>,
    app: Router,
    slot: ConnectionSlot,
) {
    // Without this option the socket is slower, no worse.
    let _ = stream.set_nodelay(true);
    let Ok(here) = stream.local_addr().map(LocalAddress) else { return };
    match tls {
        None => serve_requests(stream, app, &slot, here).await,
        Some(tls) => {
            if let Ok(Some(stream)) =
                tokio::time::timeout(clock::scale_timeout(HEAD_MAX), tls.accept(stream)).await
            {
                serve_requests(stream, app, &slot, here).await;
            }
        }
    }
}

async fn serve_requests(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    app: Router,
    slot: &ConnectionSlot,
    here: LocalAddress,
) {
    let connection = slot.connection();
    let service = hyper::service::service_fn(move |mut request: hyper::Request<Incoming>| {
        request.extensions_mut().insert(connection.clone());
        request.extensions_mut().insert(here);
        let app = app.clone();
        async move { Ok::<_, Infallible>(unwrap_infallible(app.oneshot(request.map(Body::new)).await)) }
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new())
        .header_read_timeout(clock::scale_timeout(HEAD_MAX))
        .max_buf_size(HEAD_BYTES_MAX);
    // A client that disconnects or sends no HTTP gets no reply.
    let _ = http.serve_connection(TokioIo::new(stream), service).with_upgrades().await;
}

fn unwrap_infallible(answer: Result<hyper::Response<Body>, Infallible>) -> hyper::Response<Body> {
    match answer {
        Ok(answer) => answer,
        Err(never) => match never {},
    }
}
