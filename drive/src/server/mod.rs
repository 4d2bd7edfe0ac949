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

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::sync::mpsc::SyncSender;
use std::thread;
use std::time::SystemTime;

use anyhow::Context;
use axum::Router;
use axum::middleware::from_fn_with_state;
use axum::routing::get;
use tokio::net::TcpListener;
use tokio::runtime::Handle;
use tokio::sync::Semaphore;

use crate::message::Message;
use crate::publisher::Updates;
use crate::request::Hello;

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
    hello: Arc<Hello>,
    pages: Arc<AtomicU64>,
    page_permits: Arc<Semaphore>,
    viewer_permits: Arc<Semaphore>,
}

/// A server that runs on a thread of its own until the program ends.
#[derive(Debug)]
pub struct Serving {
    /// Address to open in a browser.
    pub url: String,
    /// The runtime of the server, for other tasks.
    pub runtime: Handle,
}

/// Starts to serve pages and viewers; port 0 takes any free one.
///
/// # Errors
/// The port cannot be opened, no thread can be had, or the clock of this machine is before 1970.
pub fn start(
    ip: IpAddr,
    port: u16,
    robots: SyncSender<Message>,
    updates: Updates,
    hello: Hello,
) -> anyhow::Result<Serving> {
    anyhow::ensure!(is_clock_right(), "cannot serve pages: the clock of this machine is before 1970; set it");
    // On a thread of our own: one that cannot be had is then no panic.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let at = || format!("cannot listen on port {port} of {ip}; choose another port with --port");
    let server = runtime.block_on(Server::bind(ip, port)).with_context(at)?;
    let serving = Serving { url: server.url(), runtime: runtime.handle().clone() };
    let work = server.serve(robots, updates, hello);
    start_thread("serving pages", move || runtime.block_on(work))?;
    Ok(serving)
}

/// Starts a thread.
///
/// # Errors
/// None can be had.
pub fn start_thread(name: &str, work: impl FnOnce() + Send + 'static) -> anyhow::Result<()> {
    let started = thread::Builder::new().name(name.to_owned()).spawn(work);
    started.map(drop).with_context(|| format!("cannot start the thread for {name}"))
}

/// A server that listens on its port.
#[derive(Debug)]
struct Server {
    listener: TcpListener,
    /// Address that the server listens on.
    address: SocketAddr,
    token: Token,
}

impl Server {
    /// Listens on an address and port; port 0 takes any free one.
    ///
    /// # Errors
    /// The port cannot be opened, e.g. because it is in use.
    async fn bind(ip: IpAddr, port: u16) -> std::io::Result<Self> {
        let listener = TcpListener::bind((ip, port)).await?;
        let address = listener.local_addr()?;
        Ok(Server { listener, address, token: Token::random() })
    }

    /// Returns the address to open in a browser.
    fn url(&self) -> String {
        let address = match self.address.ip() {
            ip if ip.is_unspecified() && ip.is_ipv4() => {
                SocketAddr::new(IpAddr::from([127, 0, 0, 1]), self.address.port())
            }
            ip if ip.is_unspecified() => SocketAddr::new(IpAddr::from([0, 0, 0, 0, 0, 0, 0, 1]), self.address.port()),
            _ => self.address,
        };
        format!("http://{address}/?token={}", self.token)
    }

    /// Serves until the future is dropped.
    async fn serve(self, robots: SyncSender<Message>, updates: Updates, hello: Hello) {
        let shared = Shared {
            token: self.token,
            port: self.address.port(),
            robots,
            updates,
            hello: Arc::new(hello),
            pages: Arc::default(),
            page_permits: Arc::new(Semaphore::new(MOST_PAGES)),
            viewer_permits: Arc::new(Semaphore::new(MOST_VIEWERS)),
        };
        let router = files::routes()
            .route("/control", get(sockets::control))
            .route("/view", get(sockets::view))
            .layer(from_fn_with_state(shared.clone(), guard::check))
            .with_state(shared);
        connections::serve(self.listener, router).await;
    }
}

/// Returns false if the clock of this machine is before 1970: hyper panics then.
fn is_clock_right() -> bool {
    SystemTime::now() >= SystemTime::UNIX_EPOCH
}

/// Routes that still lack the shared state.
type Routes = Router<Shared>;
