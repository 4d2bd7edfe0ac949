//! Connections, bounded in number and patience.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio::time::sleep;

/// Connections at a time; more wait.
const MOST: usize = 64;
/// How long a request may take to say what it wants, also the next one of a connection.
const PATIENCE: Duration = Duration::from_secs(5);
/// Largest head of a request \[bytes\].
const LARGEST_HEAD: usize = 16 << 10;

/// Serves connections for as long as it is waited for.
pub(super) async fn serve(listener: TcpListener, router: Router) {
    let room = Arc::new(Semaphore::new(MOST));
    loop {
        // The semaphore is never closed.
        let Ok(permit) = Arc::clone(&room).acquire_owned().await else { return };
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(_) => {
                // Too many open files, most likely: some will be closed.
                sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        // Small messages are not worth waiting for larger ones.
        let _ = stream.set_nodelay(true);
        let service = TowerToHyperService::new(router.clone());
        tokio::spawn(async move {
            let connection = http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(PATIENCE)
                .max_buf_size(LARGEST_HEAD)
                .serve_connection(TokioIo::new(stream), service)
                .with_upgrades();
            // Whoever breaks a connection off has no use for a complaint.
            let _ = connection.await;
            drop(permit);
        });
    }
}
