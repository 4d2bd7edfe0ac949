//! Connections, bounded in number and time.

use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::sync::Notify;
use tokio::time::sleep;

/// Largest number of connections without the token. Sockets of pages and viewers have bounds of their own.
const MOST: usize = 64;
/// Largest number of them for each address.
const MOST_OF_ADDRESS: usize = 32;
/// Longest time to read a request's head, also between requests of one connection.
const PATIENCE: Duration = Duration::from_secs(5);
/// Longest time for all requests and responses of a connection: enough for the viewer's 40 MB over 1 Mbit/s.
const LONGEST: Duration = Duration::from_secs(360);
/// Largest head of a request \[bytes\].
const LARGEST_HEAD: usize = 16 << 10;

/// An open connection.
#[derive(Debug)]
pub(super) struct Connection {
    address: IpAddr,
    has_token: AtomicBool,
    closed: Notify,
}

impl Connection {
    /// Notes that a request had the token: connections without it are closed first.
    pub(super) fn trust(&self) {
        self.has_token.store(true, Ordering::Relaxed);
    }
}

/// The open connections, oldest first.
#[derive(Debug, Default)]
struct Connections(Mutex<Vec<Arc<Connection>>>);

impl Connections {
    /// Adds a connection. If there are too many without the token, one of them is closed: the oldest of the same address, or
    /// of the address that has most.
    fn add(&self, address: IpAddr) -> Arc<Connection> {
        let address = network(address);
        let new = Arc::new(Connection { address, has_token: AtomicBool::new(false), closed: Notify::new() });
        let mut open = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let strangers = || open.iter().enumerate().filter(|(_, other)| !other.has_token.load(Ordering::Relaxed));
        let of = |address: IpAddr| strangers().filter(move |(_, other)| other.address == address);
        let addresses: Vec<IpAddr> = strangers().map(|(_, other)| other.address).collect();
        let crowded = match addresses.len() {
            _ if of(address).count() >= MOST_OF_ADDRESS => Some(address),
            MOST.. => addresses.into_iter().rev().max_by_key(|address| of(*address).count()),
            _ => None,
        };
        if let Some((oldest, _)) = crowded.and_then(|address| of(address).next()) {
            open.remove(oldest).closed.notify_one();
        }
        open.push(Arc::clone(&new));
        new
    }

    fn remove(&self, connection: &Arc<Connection>) {
        let mut open = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        open.retain(|other| !Arc::ptr_eq(other, connection));
    }
}

/// Returns the part of an address that stands for one client: all of it, or the first 64 bits of an IPv6 address.
fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => IpAddr::V6((u128::from(address) >> 64 << 64).into()),
        address => address,
    }
}

/// Serves connections until the future is dropped.
pub(super) async fn serve(listener: TcpListener, router: Router) {
    let connections = Arc::new(Connections::default());
    loop {
        let Ok((stream, address)) = listener.accept().await else {
            // Most likely too many open files: some will be closed.
            sleep(Duration::from_millis(100)).await;
            continue;
        };
        // It may have been set meanwhile.
        if !super::is_clock_right() {
            continue;
        }
        // Send small messages at once.
        let _ = stream.set_nodelay(true);
        let (connections, this) = (Arc::clone(&connections), connections.add(address.ip()));
        let routes = TowerToHyperService::new(router.clone());
        let of_request = Arc::clone(&this);
        let service = service_fn(move |mut request: hyper::Request<hyper::body::Incoming>| {
            request.extensions_mut().insert(Arc::clone(&of_request));
            routes.call(request)
        });
        tokio::spawn(async move {
            let connection = http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(PATIENCE)
                .max_buf_size(LARGEST_HEAD)
                .serve_connection(TokioIo::new(stream), service)
                .with_upgrades();
            tokio::select! {
                // A broken connection needs no error message.
                _ = connection => {}
                () = this.closed.notified() => {}
                () = sleep(LONGEST) => {}
            }
            connections.remove(&this);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crowd_costs_its_own_oldest_connections_first() {
        let connections = Connections::default();
        let [crowd, other] = [[192, 168, 0, 1], [192, 168, 0, 2]].map(IpAddr::from);
        let guests: Vec<_> = (0..MOST - 2).map(|k| connections.add([10, 0, 0, k as u8].into())).collect();
        let (trusted, newcomer) = (connections.add(crowd), connections.add(other));
        trusted.trust();
        for _ in 0..10 * MOST {
            connections.add(crowd);
        }
        let open = connections.0.lock().unwrap().clone();
        assert!(open.len() <= MOST + 1, "beside the trusted one");
        let of = |address: IpAddr| open.iter().filter(|connection| connection.address == address).count();
        assert!((2..=MOST_OF_ADDRESS).contains(&of(crowd)), "{}", of(crowd));
        assert!([&trusted, &newcomer].iter().all(|kept| open.iter().any(|other| Arc::ptr_eq(other, kept))));
        assert!(guests.iter().filter(|guest| open.iter().any(|other| Arc::ptr_eq(other, guest))).count() > MOST - 4);
    }

    #[test]
    fn client_has_64_bits_of_an_ipv6_address() {
        let network = |text: &str| network(text.parse().unwrap());
        assert_eq!(network("2001:db8::1"), network("2001:db8::2:3"));
        assert_ne!(network("2001:db8::1"), network("2001:db8:0:1::1"));
        assert_eq!(network("::ffff:10.0.0.1"), network("10.0.0.1"));
    }
}
