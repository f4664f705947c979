//! Connections, of which there are only so many: those that have not shown a token yet make room for
//! new ones, the oldest first. So whoever only opens sockets keeps nobody from stopping a motor.
//!
//! Why: GW-18.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;

/// Connections at once, where the system lets a process have so many.
pub const CONNECTIONS_MAX: usize = 16_384;
/// Files that are left for links, the journal and captures.
const FILES_MIN: u64 = 128;

/// All of them.
#[derive(Debug, Clone)]
pub(crate) struct Connections(Arc<Mutex<Open>>);

#[derive(Debug)]
struct Open {
    most: usize,
    next: u64,
    /// Those that have not shown a token, with what ends them.
    unproven: BTreeMap<u64, oneshot::Sender<()>>,
    /// Those that have.
    proven: BTreeMap<u64, oneshot::Sender<()>>,
}

/// One of them, as its requests know it.
#[derive(Debug, Clone)]
pub(crate) struct Connection {
    /// The other end, by the socket.
    pub peer: IpAddr,
    id: u64,
    all: Connections,
}

/// Where a connection ends, at this side.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Here(pub SocketAddr);

/// Keeps a connection counted while it lives.
#[derive(Debug)]
pub(crate) struct Place(Connection);

impl Connections {
    /// None yet, and at most so many as a process with that many open files can have.
    pub fn new(files: Option<u64>) -> Self {
        let left = files.map_or(u64::MAX, |files| files.saturating_sub(FILES_MIN).max(1));
        let most = usize::try_from(left).unwrap_or(usize::MAX).min(CONNECTIONS_MAX);
        let (unproven, proven) = (BTreeMap::new(), BTreeMap::new());
        Self(Arc::new(Mutex::new(Open { most, next: 0, unproven, proven })))
    }

    /// A place for a new connection, and what tells it to go. `None` when all places are taken by
    /// connections that have shown a token.
    pub fn take(&self, peer: IpAddr) -> Option<(Place, oneshot::Receiver<()>)> {
        let mut open = self.open();
        if open.count() >= open.most {
            open.make_room();
        }
        if open.count() >= open.most {
            return None;
        }
        let id = open.next;
        open.next += 1;
        let (end, ended) = oneshot::channel();
        open.unproven.insert(id, end);
        Some((Place(Connection { peer, id, all: self.clone() }), ended))
    }

    /// Ends the oldest that has not shown a token.
    pub fn make_room(&self) {
        self.open().make_room();
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.open().count()
    }

    fn open(&self) -> MutexGuard<'_, Open> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Open {
    fn count(&self) -> usize {
        self.unproven.len() + self.proven.len()
    }

    /// The one that goes is counted no more from now on: its place is free at once.
    fn make_room(&mut self) {
        if let Some((_, end)) = self.unproven.pop_first() {
            // One that has just ended by itself does not hear it.
            let _ = end.send(());
        }
    }
}

impl Connection {
    /// It has shown a token.
    pub fn prove(&self) {
        let mut open = self.all.open();
        if let Some(end) = open.unproven.remove(&self.id) {
            open.proven.insert(self.id, end);
        }
    }
}

impl Place {
    /// What its requests know.
    pub fn connection(&self) -> Connection {
        self.0.clone()
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut open = self.0.all.open();
        open.unproven.remove(&self.0.id);
        open.proven.remove(&self.0.id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PEER: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    #[test]
    fn idle_connections_make_room_and_those_with_a_token_do_not() {
        let (all, most) = (Connections::new(Some(FILES_MIN + 100)), 100);
        let mut places: Vec<_> = (0..most).filter_map(|_| all.take(PEER)).collect();
        places[0].0.connection().prove();
        let (_new, _) = all.take(PEER).expect("the oldest idle one goes");
        assert!(places[0].1.try_recv().is_err(), "it has shown a token");
        assert!(places[1].1.try_recv().is_ok(), "it was told to go");
        places.iter().for_each(|(place, _)| place.connection().prove());
        _new.connection().prove();
        assert_eq!(all.count(), most);
        assert!(all.take(PEER).is_none());
        drop(places);
        assert_eq!(all.count(), 1);
    }
}
