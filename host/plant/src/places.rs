//! Places of a listener: how many connections at a time, and which one is closed for a new one.
//!
//! A connection that has not proven anything (a token, a complete request) is closed first, the one that was silent longest before
//! the others. So connections that never speak displace each other, and a client that speaks at once always finds a place.

use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::os::fd::{AsFd, OwnedFd};
use std::sync::{Arc, Mutex, PoisonError};

use rustix::net::{Shutdown, shutdown};

/// The connections of a listener.
#[derive(Clone, Debug)]
pub struct Places(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    most: usize,
    most_per_address: usize,
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    /// Counts connections and their requests: a larger number is later.
    next: u64,
    by_id: BTreeMap<u64, Connection>,
}

#[derive(Debug)]
struct Connection {
    address: IpAddr,
    is_proven: bool,
    /// Number of its last request, else of the connection.
    last_used: u64,
    /// A second handle of the socket, by which it is closed.
    socket: OwnedFd,
}

impl Held {
    fn next(&mut self) -> u64 {
        self.next += 1;
        self.next
    }

    /// Closes the connection that is missed least: one that has proven nothing before others, and the longest silent one of those.
    fn close_one(&mut self, from: Option<IpAddr>) {
        let mut found: Option<(u64, (bool, u64))> = None;
        for (id, connection) in &self.by_id {
            let rank = (connection.is_proven, connection.last_used);
            let is_meant = from.is_none_or(|from| connection.address == from);
            if is_meant && found.is_none_or(|(_, least)| rank < least) {
                found = Some((*id, rank));
            }
        }
        if let Some((id, _)) = found
            && let Some(closed) = self.by_id.remove(&id)
        {
            // Its task reads the end, and ends.
            let _ = shutdown(closed.socket, Shutdown::Both);
        }
    }
}

impl Places {
    pub fn new(most: usize, most_per_address: usize) -> Self {
        Self(Arc::new(Shared {
            most,
            most_per_address,
            held: Mutex::default(),
        }))
    }

    /// A place for a new connection, for which another one is closed if there are too many.
    ///
    /// # Errors
    /// There is no file descriptor left.
    pub fn take(&self, socket: &impl AsFd, from: SocketAddr) -> io::Result<Place> {
        let socket = socket.as_fd().try_clone_to_owned()?;
        let address = from.ip().to_canonical();
        let mut held = self.held();
        let of_address = held.by_id.values().filter(|held| held.address == address);
        if of_address.count() >= self.0.most_per_address {
            held.close_one(Some(address));
        } else if held.by_id.len() >= self.0.most {
            held.close_one(None);
        }
        let id = held.next();
        let connection = Connection {
            address,
            is_proven: false,
            last_used: id,
            socket,
        };
        held.by_id.insert(id, connection);
        Ok(Place {
            id,
            places: self.clone(),
        })
    }

    fn held(&self) -> std::sync::MutexGuard<'_, Held> {
        self.0.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Connections that are open.
    #[cfg(test)]
    fn count(&self) -> usize {
        self.held().by_id.len()
    }
}

/// The place of one connection, given back when it is dropped.
#[derive(Debug)]
pub struct Place {
    id: u64,
    places: Places,
}

impl Place {
    /// Notes that the connection has proven itself just now, and is closed after those that have not.
    pub fn prove(&self) {
        let mut held = self.places.held();
        let now = held.next();
        if let Some(connection) = held.by_id.get_mut(&self.id) {
            connection.is_proven = true;
            connection.last_used = now;
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.places.held().by_id.remove(&self.id);
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;
    use std::net::{TcpListener, TcpStream};

    use super::*;

    /// A client and the place that its connection has.
    fn connected(listener: &TcpListener, places: &Places, address: &str) -> (TcpStream, Place) {
        let client = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (socket, _) = listener.accept().unwrap();
        let from = SocketAddr::new(address.parse().unwrap(), 1000);
        (client, places.take(&socket, from).unwrap())
    }

    fn is_closed(client: &mut TcpStream) -> bool {
        client.set_nonblocking(true).unwrap();
        matches!(client.read(&mut [0]), Ok(0))
    }

    #[test]
    fn the_longest_silent_connection_without_proof_makes_room() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let places = Places::new(3, 2);
        let open = |address: &str| connected(&listener, &places, address);
        let (mut proven, proof) = open("10.0.0.1");
        proof.prove();
        let (mut first, _first) = open("10.0.0.2");
        let (mut second, _second) = open("10.0.0.3");
        assert_eq!(places.count(), 3);
        let (mut third, _third) = open("10.0.0.3");
        assert!(is_closed(&mut first) && !is_closed(&mut proven));
        // A third connection of one address displaces that address' own, although its place is not the longest silent one.
        let (mut fourth, place) = open("10.0.0.3");
        assert!(is_closed(&mut second) && !is_closed(&mut third) && !is_closed(&mut fourth));
        assert_eq!(places.count(), 3);
        // Among connections that are all proven, the one whose last request is longest ago makes room.
        place.prove();
        _third.prove();
        proof.prove();
        let (_fifth, _) = open("10.0.0.4");
        assert!(is_closed(&mut fourth) && !is_closed(&mut proven) && !is_closed(&mut third));
        drop(proof);
        assert_eq!(places.count(), 1);
    }
}
