//! A TCP proxy between a bench and a drive, which does to the wire what wires do.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

/// Behaviour of the wire.
#[derive(Clone, Copy)]
pub enum Mode {
    /// The wire works.
    Pass,
    /// The port is refused.
    Refuse,
    /// The port takes connections and drops them at once.
    Drop,
    /// Nothing passes, in neither direction.
    Silent,
    /// Requests for which this is true are lost.
    Lose(fn(&[u8]) -> bool),
}

#[derive(Default)]
struct Shared {
    ended: AtomicBool,
    /// Connections that were taken.
    taken: AtomicUsize,
    /// Requests that were lost.
    lost: AtomicUsize,
    mode: Mutex<Option<Mode>>,
}

/// The proxy, for as long as this lives.
pub struct Proxy {
    pub address: SocketAddr,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Proxy {
    pub fn to(drive: SocketAddr) -> Self {
        let listener = listen("127.0.0.1:0".parse().unwrap()).unwrap();
        let address = listener.local_addr().unwrap();
        let shared = Arc::<Shared>::default();
        let its = Arc::clone(&shared);
        let thread = std::thread::spawn(move || run(listener, address, drive, &its));
        Self { address, shared, thread: Some(thread) }
    }

    pub fn set(&self, mode: Mode) {
        *self.shared.mode.lock().unwrap() = Some(mode);
    }

    pub fn taken(&self) -> usize {
        self.shared.taken.load(Ordering::SeqCst)
    }

    pub fn lost(&self) -> usize {
        self.shared.lost.load(Ordering::SeqCst)
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::SeqCst);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn listen(address: SocketAddr) -> std::io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

fn run(listener: TcpListener, address: SocketAddr, drive: SocketAddr, shared: &Shared) {
    let (mut listener, mut pair) = (Some(listener), None);
    while !shared.ended.load(Ordering::SeqCst) {
        std::thread::sleep(Duration::from_micros(200));
        let mode = shared.mode.lock().unwrap().unwrap_or(Mode::Pass);
        if matches!(mode, Mode::Refuse) {
            (listener, pair) = (None, None);
            continue;
        }
        if listener.is_none() {
            listener = listen(address).ok();
        }
        if let Some(Ok((host, _))) = listener.as_ref().map(TcpListener::accept) {
            shared.taken.fetch_add(1, Ordering::SeqCst);
            pair = match mode {
                Mode::Drop => None,
                _ => both(host, drive).ok(),
            };
        }
        if matches!(mode, Mode::Drop) {
            pair = None;
        }
        let alive = pair.as_mut().is_some_and(|(host, drive)| {
            let lost = |bytes: &[u8]| match mode {
                Mode::Silent => true,
                Mode::Lose(is_lost) => is_lost(bytes),
                _ => false,
            };
            let silent = |_: &[u8]| matches!(mode, Mode::Silent);
            copy(host, drive, lost, &shared.lost) && copy(drive, host, silent, &shared.lost)
        });
        if !alive {
            pair = None;
        }
    }
}

fn both(host: TcpStream, drive: SocketAddr) -> std::io::Result<(TcpStream, TcpStream)> {
    let drive = TcpStream::connect(drive)?;
    for stream in [&host, &drive] {
        stream.set_nonblocking(true)?;
        stream.set_nodelay(true)?;
    }
    Ok((host, drive))
}

/// Copies received bytes. Returns false when one end is gone.
fn copy(
    from: &mut TcpStream,
    to: &mut TcpStream,
    is_lost: impl Fn(&[u8]) -> bool,
    lost: &AtomicUsize,
) -> bool {
    let mut buffer = [0; 512];
    match from.read(&mut buffer) {
        Ok(0) => false,
        Ok(len) if is_lost(&buffer[..len]) => {
            lost.fetch_add(1, Ordering::SeqCst);
            true
        }
        Ok(len) => to.write_all(&buffer[..len]).is_ok(),
        Err(error) => error.kind() == ErrorKind::WouldBlock,
    }
}
