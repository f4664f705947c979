//! A wire in front of a server that can fall silent, as a pulled plug does: neither end gets a notice.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The wire. Its threads end with the connections that they carry.
pub struct Cut {
    port: u16,
    silent: Arc<AtomicBool>,
}

impl Cut {
    pub fn before(server: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let silent = Arc::new(AtomicBool::new(false));
        let cut = silent.clone();
        std::thread::spawn(move || {
            for client in listener.incoming() {
                let (Ok(client), Ok(far)) = (client, TcpStream::connect(("127.0.0.1", server)))
                else {
                    return;
                };
                let names = (format!("127.0.0.1:{port}"), format!("127.0.0.1:{server}"));
                carry(client.try_clone().unwrap(), far.try_clone().unwrap(), Some(names), &cut);
                carry(far, client, None, &cut);
            }
        });
        Self { port, silent }
    }

    pub fn port(&self) -> u16 {
        self.port
    }

    pub fn pull(&self) {
        self.silent.store(true, Ordering::SeqCst);
    }
}

/// Carries bytes one way. The server answers to its own name alone: in text, which has the `Host`, the one
/// name becomes the other.
fn carry(
    mut from: TcpStream,
    mut to: TcpStream,
    names: Option<(String, String)>,
    silent: &Arc<AtomicBool>,
) {
    let silent = silent.clone();
    std::thread::spawn(move || {
        let mut bytes = [0; 16 * 1024];
        while let Ok(count @ 1..) = from.read(&mut bytes) {
            if silent.load(Ordering::SeqCst) {
                continue;
            }
            let text = std::str::from_utf8(&bytes[..count]).ok();
            let carried = match names.as_ref().zip(text) {
                Some(((ours, its), text)) => to.write_all(text.replace(ours, its).as_bytes()),
                None => to.write_all(&bytes[..count]),
            };
            if carried.is_err() {
                return;
            }
        }
        if !silent.load(Ordering::SeqCst) {
            let _ = to.shutdown(std::net::Shutdown::Both);
        }
    });
}
