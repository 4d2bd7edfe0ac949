//! Connections, bounded in number and time.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio::time::sleep;

/// Largest number of connections; more wait.
const MOST: usize = 64;
/// Longest time to read a request's head, also between requests of one connection.
const PATIENCE: Duration = Duration::from_secs(5);
/// Largest head of a request \[bytes\].
const LARGEST_HEAD: usize = 16 << 10;

/// Serves connections until the future is dropped.
pub(super) async fn serve(listener: TcpListener, router: Router) {
    let room = Arc::new(Semaphore::new(MOST));
    loop {
        // The semaphore is never closed.
        let Ok(permit) = Arc::clone(&room).acquire_owned().await else { return };
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(_) => {
                // Most likely too many open files: some will be closed.
                sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        // Send small messages at once.
        let _ = stream.set_nodelay(true);
        let service = TowerToHyperService::new(router.clone());
        tokio::spawn(async move {
            let connection = http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(PATIENCE)
                .max_buf_size(LARGEST_HEAD)
                .serve_connection(TokioIo::new(stream), service)
                .with_upgrades();
            // A broken connection needs no error message.
            let _ = connection.await;
            drop(permit);
        });
    }
}
