//! Looks after policies that are still being trained: reads them anew when their run has saved a better one.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, SystemTime};

use supple::policy::shipped;
use supple::scenario::session::AgentCache;
use supple::util::{files, paths};

use crate::live::Message;

/// Time between two looks.
const PERIOD: Duration = Duration::from_millis(500);

/// Looks at the files of policies for as long as somebody listens, and reads those that have changed.
///
/// # Errors
/// There is no room for a thread.
pub fn start(watched: Arc<Mutex<Vec<PathBuf>>>, to: SyncSender<Message>) -> std::io::Result<()> {
    let mut seen: HashMap<PathBuf, SystemTime> = HashMap::new();
    let look = move || {
        loop {
            thread::sleep(PERIOD);
            // Whoever holds the lock only replaces the list.
            let paths = watched.lock().map(|paths| paths.clone()).unwrap_or_default();
            seen.retain(|path, _| paths.contains(path));
            for path in paths {
                let Ok(time) = path.metadata().and_then(|metadata| metadata.modified()) else { continue };
                if seen.insert(path.clone(), time) == Some(time) {
                    continue;
                }
                let message = match AgentCache::read(&paths::as_text(&path)) {
                    Ok((agent, file)) => Message::Read { path, agent: Box::new(agent), file },
                    Err(error) => Message::Notice(error.to_string()),
                };
                if to.send(message).is_err() {
                    return;
                }
            }
        }
    };
    thread::Builder::new().name("watching runs".to_owned()).spawn(look).map(drop)
}

/// The file that a policy is read from, if it is one that may change.
pub fn file_of(policy: &str) -> Option<PathBuf> {
    shipped::file_of(policy).filter(|path| !files::is_yaml(path))
}
