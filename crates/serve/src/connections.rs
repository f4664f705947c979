//! Limits the number of connections. Connections without a valid token are dropped first, the oldest before
//! the others, so idle connections cannot prevent a stop.
//!
//! Why: GW-18.

use polepair_core::convert::saturating;
use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::extract::Request;
use tokio::sync::oneshot;

/// Limit of simultaneous connections, where the system allows that many.
pub const CONNECTIONS_MAX: usize = 16_384;
/// Files that are left for links, the journal and captures.
const FILES_RESERVED: u64 = 128;

/// All of them.
#[derive(Debug, Clone)]
pub(crate) struct ConnectionLimiter(Arc<Mutex<OpenConnections>>);

#[derive(Debug)]
struct OpenConnections {
    most: usize,
    next: u64,
    /// Connections without a valid token yet, with the sender that ends them.
    unauthenticated: BTreeMap<u64, oneshot::Sender<()>>,
    /// Authenticated connections.
    authenticated: BTreeMap<u64, oneshot::Sender<()>>,
}

/// One of them, as its requests know it.
#[derive(Debug, Clone)]
pub(crate) struct PeerConnection {
    /// The other end, by the socket.
    pub peer: IpAddr,
    id: u64,
    limiter: ConnectionLimiter,
}

/// Local address of a connection.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalAddress(pub SocketAddr);

/// Keeps a connection counted while it lives.
#[derive(Debug)]
pub(crate) struct ConnectionSlot(PeerConnection);

impl ConnectionLimiter {
    /// Creates the empty list, with a limit that fits the limit of open files.
    pub fn new(files: Option<u64>) -> Self {
        let left = files.map_or(u64::MAX, |files| files.saturating_sub(FILES_RESERVED).max(1));
        let max = saturating::<usize>(left).min(CONNECTIONS_MAX);
        let (unproven, proven) = (BTreeMap::new(), BTreeMap::new());
        Self(Arc::new(Mutex::new(OpenConnections {
            most: max,
            next: 0,
            unauthenticated: unproven,
            authenticated: proven,
        })))
    }

    /// Slot of a new connection, and the receiver that ends it. `None` if all slots are taken by authenticated
    /// connections.
    pub fn acquire_slot(&self, peer: IpAddr) -> Option<(ConnectionSlot, oneshot::Receiver<()>)> {
        let mut open = self.lock();
        if open.count() >= open.most {
            open.make_room();
        }
        if open.count() >= open.most {
            return None;
        }
        let id = open.next;
        open.next += 1;
        let (end, ended) = oneshot::channel();
        open.unauthenticated.insert(id, end);
        Some((ConnectionSlot(PeerConnection { peer, id, limiter: self.clone() }), ended))
    }

    /// Ends the oldest that has not shown a token.
    pub fn make_room(&self) {
        self.lock().make_room();
    }

    /// Number of connections.
    pub fn count(&self) -> usize {
        self.lock().count()
    }

    fn lock(&self) -> MutexGuard<'_, OpenConnections> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl OpenConnections {
    fn count(&self) -> usize {
        self.unauthenticated.len() + self.authenticated.len()
    }

    /// The one that goes is counted no more from now on: its place is free at once.
    fn make_room(&mut self) {
        if let Some((_, end)) = self.unauthenticated.pop_first() {
            // One that has just ended by itself does not hear it.
            let _ = end.send(());
        }
    }
}

impl PeerConnection {
    /// Marks the connection as authenticated.
    pub fn mark_authenticated(&self) {
        let mut open = self.limiter.lock();
        if let Some(end) = open.unauthenticated.remove(&self.id) {
            open.authenticated.insert(self.id, end);
        }
    }
}

impl ConnectionSlot {
    /// Connection data for its requests.
    pub fn connection(&self) -> PeerConnection {
        self.0.clone()
    }
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        let mut open = self.0.limiter.lock();
        open.unauthenticated.remove(&self.0.id);
        open.authenticated.remove(&self.0.id);
    }
}

/// Address of the client, by its socket.
pub(crate) fn peer(request: &Request) -> IpAddr {
    let connection = request.extensions().get::<PeerConnection>();
    connection.map_or(IpAddr::V4(std::net::Ipv4Addr::UNSPECIFIED), |connection| connection.peer)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PEER: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    #[test]
    fn idle_connections_make_room_and_those_with_a_token_do_not() {
        let (all, max) = (ConnectionLimiter::new(Some(FILES_RESERVED + 100)), 100);
        let mut places: Vec<_> = (0..max).filter_map(|_| all.acquire_slot(PEER)).collect();
        places[0].0.connection().mark_authenticated();
        let (_new, _) = all.acquire_slot(PEER).expect("the oldest idle one goes");
        assert!(places[0].1.try_recv().is_err(), "it has shown a token");
        assert!(places[1].1.try_recv().is_ok(), "it was told to go");
        places.iter().for_each(|(slot, _)| slot.connection().mark_authenticated());
        _new.connection().mark_authenticated();
        assert_eq!(all.count(), max);
        assert!(all.acquire_slot(PEER).is_none());
        drop(places);
        assert_eq!(all.count(), 1);
    }
}
