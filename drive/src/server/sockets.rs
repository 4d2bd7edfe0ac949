//! The two WebSockets.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::TrySendError;
use std::time::{Duration, Instant};

use axum::extract::State;
use axum::extract::ws::{Message as Frame, Utf8Bytes, WebSocket, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use supple::mujoco;
use tokio::runtime::Handle;
use tokio::sync::{OwnedSemaphorePermit, mpsc};
use tokio::time::{interval, sleep, timeout};

use super::{Shared, start_thread};
use crate::message::Message;
use crate::request::{PageId, Request};
use crate::viewer_stream;

/// Largest message of a page \[bytes\].
const LARGEST: usize = 4 << 10;
/// Largest mean rate of a page's messages \[1/s\].
const RATE: f64 = 1000.0;
/// Largest number of a page's messages at once.
const BURST: f64 = 2000.0;
/// Longest time a page may take to read a message.
const PATIENCE: Duration = Duration::from_secs(5);
/// Largest number of files sent to a viewer and not yet shown.
const AHEAD: u32 = 2;
/// Time between two pings.
const PING_EVERY: Duration = Duration::from_secs(5);
/// Longest silence before a connection is closed.
const SILENT: Duration = Duration::from_secs(15);

/// Opens the socket of a page of controls.
pub(super) async fn control(State(shared): State<Shared>, upgrade: WebSocketUpgrade) -> Response {
    let Ok(permit) = Arc::clone(&shared.page_permits).try_acquire_owned() else { return full() };
    bounded(upgrade).on_upgrade(move |socket| async move {
        let page = shared.pages.fetch_add(1, Ordering::Relaxed) + 1;
        if notify(&shared, Message::PageOpened(page)).await {
            talk(socket, page, &shared).await;
            notify(&shared, Message::PageClosed(page)).await;
        }
        drop(permit);
    })
}

/// Opens the socket of a viewer. It waits for a place, as one that was just closed may take a moment to end.
pub(super) async fn view(State(shared): State<Shared>, upgrade: WebSocketUpgrade) -> Response {
    let permits = Arc::clone(&shared.viewer_permits);
    let Ok(Ok(permit)) = timeout(PATIENCE, permits.acquire_owned()).await else { return full() };
    bounded(upgrade).on_upgrade(move |socket| async move { feed(socket, &shared, permit).await })
}

fn full() -> Response {
    (StatusCode::SERVICE_UNAVAILABLE, "too many pages or viewers are open; close one and reload\n").into_response()
}

fn bounded(upgrade: WebSocketUpgrade) -> WebSocketUpgrade {
    upgrade.max_message_size(LARGEST).max_frame_size(LARGEST).read_buffer_size(LARGEST)
}

/// Sends a message that must not be lost, without blocking the server; returns false if the robots are gone.
async fn notify(shared: &Shared, mut message: Message) -> bool {
    loop {
        message = match shared.robots.try_send(message) {
            Ok(()) => return true,
            Err(TrySendError::Full(message)) => message,
            Err(TrySendError::Disconnected(_)) => return false,
        };
        sleep(Duration::from_millis(20)).await;
    }
}

/// Carries requests and states until the page disconnects, breaks a rule, or falls silent.
async fn talk(mut socket: WebSocket, page: PageId, shared: &Shared) {
    let mut states = shared.updates.state.subscribe();
    let hello = serde_json::json!({ "hello": { "page": page, "about": &*shared.hello } });
    let mut heard = Instant::now();
    let (mut allowance, mut counted) = (BURST, Instant::now());
    let mut look = interval(PING_EVERY);
    if !send(&mut socket, Frame::text(hello.to_string())).await {
        return;
    }
    loop {
        let going_on = tokio::select! {
            message = socket.recv() => {
                heard = Instant::now();
                let since_s = counted.elapsed().as_secs_f64();
                counted = Instant::now();
                allowance = (allowance + RATE * since_s).min(BURST) - 1.0;
                match message {
                    Some(Ok(_)) if allowance < 0.0 => refuse(&mut socket, "too many messages per second").await,
                    Some(Ok(Frame::Text(text))) => ask(&mut socket, page, shared, &text).await,
                    Some(Ok(Frame::Binary(_))) => refuse(&mut socket, "binary message: expected JSON text").await,
                    Some(Ok(Frame::Ping(_) | Frame::Pong(_))) => true,
                    Some(Ok(Frame::Close(_)) | Err(_)) | None => false,
                }
            }
            changed = states.changed() => {
                let text = states.borrow_and_update().clone();
                changed.is_ok() && send(&mut socket, Frame::Text(Utf8Bytes::from(&*text))).await
            }
            _ = look.tick() => heard.elapsed() < SILENT && send(&mut socket, Frame::Ping(Vec::new().into())).await,
        };
        if !going_on {
            return;
        }
    }
}

async fn ask(socket: &mut WebSocket, page: PageId, shared: &Shared, text: &str) -> bool {
    match Request::parse(text).map(|request| shared.robots.try_send(Message::Request(page, request))) {
        // Requests queue while a scene is built; a full queue drops them, and the page repeats its commands.
        Ok(sent) => !matches!(sent, Err(TrySendError::Disconnected(_))),
        Err(problem) => refuse(socket, &problem).await,
    }
}

async fn refuse(socket: &mut WebSocket, problem: &str) -> bool {
    send(socket, Frame::text(serde_json::json!({ "refused": problem }).to_string())).await;
    send(socket, Frame::Close(None)).await;
    false
}

/// Sends a message; returns false if that fails or takes too long.
async fn send(socket: &mut WebSocket, message: Frame) -> bool {
    matches!(timeout(PATIENCE, socket.send(message)).await, Ok(Ok(())))
}

/// Carries `.rrd` files to a viewer until it disconnects.
async fn feed(mut socket: WebSocket, shared: &Shared, permit: OwnedSemaphorePermit) {
    let (files, mut arriving) = mpsc::channel(1);
    let (updates, runtime) = (shared.updates.shown.subscribe(), Handle::current());
    let notices = shared.robots.clone();
    let work = move || {
        if let Err(error) = viewer_stream::to_channel(updates, &runtime, &files) {
            // The robots continue without this viewer.
            let _ = notices.try_send(Message::Notice(format!("a viewer stopped: {error}")));
        }
        mujoco::release_memory();
        drop(permit);
    };
    if let Err(error) = start_thread("feeding a viewer", work) {
        let _ = shared.robots.try_send(Message::Notice(format!("{error:#}")));
        return;
    }
    let (mut ahead, mut heard, mut look) = (0, Instant::now(), interval(PING_EVERY));
    loop {
        let going_on = tokio::select! {
            file = arriving.recv(), if ahead < AHEAD => {
                ahead += 1;
                file.is_some() && send(&mut socket, Frame::Binary(file.unwrap_or_default().into())).await
            }
            message = socket.recv() => {
                heard = Instant::now();
                // A text means that the viewer has shown a file.
                ahead = ahead.saturating_sub(u32::from(matches!(message, Some(Ok(Frame::Text(_))))));
                matches!(message, Some(Ok(Frame::Text(_) | Frame::Ping(_) | Frame::Pong(_))))
            }
            _ = look.tick() => heard.elapsed() < SILENT && send(&mut socket, Frame::Ping(Vec::new().into())).await,
        };
        if !going_on {
            return;
        }
    }
}
