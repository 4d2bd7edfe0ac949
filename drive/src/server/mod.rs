/*! The web server: pages, rerun's viewer, and two WebSockets.

| path | what |
|---|---|
| `/` and what it names | the page of controls, and the viewer's page beside it; nothing secret |
| `/rerun/…` | rerun's viewer: the files that its crate holds |
| `/control` | a WebSocket: requests and states as JSON |
| `/view` | a WebSocket: `.rrd` files, one after another |

What is done with the robots goes through the sockets alone, and they want the token of the address. Everything is refused that
does not come to an address of this machine by its number, so that no name can be bent towards it, and every socket that a
page of another origin opens. Connections, messages, their sizes and rates are bounded; who is slow misses frames, who says
nothing is hung up on.
*/

mod connections;
mod files;
mod guard;
mod sockets;

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::sync::mpsc::SyncSender;

use axum::Router;
use axum::middleware::from_fn_with_state;
use axum::routing::get;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;

use crate::display::News;
use crate::live::Message;
use crate::request::Hello;

pub use guard::Token;

/// Viewers at a time: each has a recording of its own.
const MOST_VIEWERS: usize = 4;
/// Pages at a time.
const MOST_PAGES: usize = 16;

/// What handlers share.
#[derive(Debug, Clone)]
struct Shared {
    token: Token,
    port: u16,
    robots: SyncSender<Message>,
    news: News,
    hello: Arc<Hello>,
    pages: Arc<AtomicU64>,
    page_permits: Arc<Semaphore>,
    viewer_permits: Arc<Semaphore>,
}

/// A server that listens.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    /// Where it listens.
    pub address: SocketAddr,
    token: Token,
}

impl Server {
    /// Listens on a port of an address; port 0 is any that is free.
    ///
    /// # Errors
    /// The system's, as if the port is taken.
    pub async fn bind(ip: IpAddr, port: u16) -> std::io::Result<Self> {
        let listener = TcpListener::bind((ip, port)).await?;
        let address = listener.local_addr()?;
        Ok(Server { listener, address, token: Token::random() })
    }

    /// What to open in a browser.
    pub fn url(&self) -> String {
        let address = match self.address.ip() {
            ip if ip.is_unspecified() && ip.is_ipv4() => {
                SocketAddr::new(IpAddr::from([127, 0, 0, 1]), self.address.port())
            }
            ip if ip.is_unspecified() => SocketAddr::new(IpAddr::from([0, 0, 0, 0, 0, 0, 0, 1]), self.address.port()),
            _ => self.address,
        };
        format!("http://{address}/?token={}", self.token)
    }

    /// Serves for as long as it is waited for.
    pub async fn serve(self, robots: SyncSender<Message>, news: News, hello: Hello) {
        let shared = Shared {
            token: self.token,
            port: self.address.port(),
            robots,
            news,
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

/// Routes before they know what they share.
type Routes = Router<Shared>;
