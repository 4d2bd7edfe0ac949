/*! The web server: pages, rerun's viewer, and two WebSockets.

| path | content |
|---|---|
| `/` and its files | the page of controls and the page of the viewer; nothing secret |
| `/rerun/…` | rerun's viewer, from its crate |
| `/control` | a WebSocket: requests and states as JSON |
| `/view` | a WebSocket: `.rrd` files, one after another |

Only the sockets control the robots, and they require the token of the printed address. Requests by host name are refused (DNS
rebinding), and so are sockets opened by pages of another origin. Number and time of connections, size and rate of messages
are bounded; a slow client misses frames, a silent one is disconnected, and newcomers take the place of those without a token.
*/

mod connections;
mod files;
mod guard;
mod sockets;

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::sync::mpsc::SyncSender;
use std::thread;
use std::time::SystemTime;

use anyhow::{Context, Result};
use axum::Router;
use axum::middleware::from_fn_with_state;
use axum::routing::get;
use serde_json::Value;
use tokio::net::TcpListener;
use tokio::runtime::Handle;
use tokio::sync::Semaphore;

use crate::message::Message;
use crate::publisher::Updates;

use guard::Token;

/// Largest number of viewers; each has its own recording.
const MOST_VIEWERS: usize = 4;
/// Largest number of pages.
const MOST_PAGES: usize = 16;

/// The state that all handlers share.
#[derive(Debug, Clone)]
struct Shared {
    token: Token,
    port: u16,
    robots: SyncSender<Message>,
    updates: Updates,
    hello: Arc<Value>,
    pages: Arc<AtomicU64>,
    page_permits: Arc<Semaphore>,
    viewer_permits: Arc<Semaphore>,
}

/// Starts to serve pages and viewers on a thread of its own until the program ends; port 0 takes any free one. Returns the address to open
/// in a browser, and the runtime for other tasks. New pages receive `hello`: the names of the shipped `policies`; the `scenes` that can be
/// chosen; `most`, the largest push [m/s] and [N·s] and the largest pull \[N\]; `viewer`, true if the page embeds the viewer; `is_served`,
/// true if another program plays the robot: the page cannot change robots, scene or time, nor save.
///
/// # Errors
/// The port cannot be opened, no thread can be started, or the clock of this machine is before 1970.
pub fn start(
    ip: IpAddr,
    port: u16,
    robots: SyncSender<Message>,
    updates: Updates,
    hello: Value,
) -> Result<(String, Handle)> {
    anyhow::ensure!(is_clock_right(), "cannot serve pages: the clock of this machine is before 1970; set it");
    // On our own thread, so that a failure to start one is no panic.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let at = || format!("cannot listen on port {port} of {ip}; choose another port with --port");
    let listener = runtime.block_on(TcpListener::bind((ip, port))).with_context(at)?;
    let (address, token) = (listener.local_addr()?, Token::random());
    let serving = (url(address, &token), runtime.handle().clone());
    let (port, hello, page_permits) = (address.port(), Arc::new(hello), Arc::new(Semaphore::new(MOST_PAGES)));
    let viewer_permits = Arc::new(Semaphore::new(MOST_VIEWERS));
    let shared = Shared { token, port, robots, updates, hello, pages: Arc::default(), page_permits, viewer_permits };
    let router = files::routes()
        .route("/control", get(sockets::control))
        .route("/view", get(sockets::view))
        .layer(from_fn_with_state(shared.clone(), guard::check))
        .with_state(shared);
    start_thread("serving pages", move || runtime.block_on(connections::serve(listener, router)))?;
    Ok(serving)
}

/// Returns the address to open in a browser.
fn url(mut address: SocketAddr, token: &Token) -> String {
    match address.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => address.set_ip(Ipv4Addr::LOCALHOST.into()),
        IpAddr::V6(ip) if ip.is_unspecified() => address.set_ip(Ipv6Addr::LOCALHOST.into()),
        _ => {}
    }
    format!("http://{address}/?token={}", token.0)
}

/// Starts a thread.
///
/// # Errors
/// The system cannot start one.
pub fn start_thread(name: &str, work: impl FnOnce() + Send + 'static) -> Result<()> {
    let started = thread::Builder::new().name(name.to_owned()).spawn(work);
    started.map(drop).with_context(|| format!("cannot start the thread for {name}"))
}

/// Returns false if the clock of this machine is before 1970: hyper panics then.
fn is_clock_right() -> bool {
    SystemTime::now() >= SystemTime::UNIX_EPOCH
}

/// Routes that still lack the shared state.
type Routes = Router<Shared>;
