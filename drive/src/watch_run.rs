//! Watches policies of running training runs and reads each newer one.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, SystemTime};

use supple::policy::shipped;
use supple::scenario::session::AgentCache;
use supple::util::files;

use crate::message::{Message, NewPolicy};

/// Time between two checks.
const PERIOD: Duration = Duration::from_millis(500);

/// Starts a thread that reads every watched policy file whenever it changes, until the receiver is dropped.
///
/// # Errors
/// The thread cannot be started.
pub fn start(watched: Arc<Mutex<Vec<PathBuf>>>, to: SyncSender<Message>) -> std::io::Result<()> {
    let mut seen: HashMap<PathBuf, SystemTime> = HashMap::new();
    let look = move || {
        loop {
            thread::sleep(PERIOD);
            // The lock is held only while the list is replaced.
            let paths = watched.lock().map(|paths| paths.clone()).unwrap_or_default();
            seen.retain(|path, _| paths.contains(path));
            for path in paths {
                let Ok(time) = path.metadata().and_then(|metadata| metadata.modified()) else { continue };
                if seen.insert(path.clone(), time) == Some(time) {
                    continue;
                }
                let message = match AgentCache::read(&path.display().to_string()) {
                    Ok((agent, file)) => Message::PolicySaved(Box::new(NewPolicy { path, agent, file })),
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

/// Returns the file of a policy that may change while it is used, if it has one.
pub fn file_of(policy: &str) -> Option<PathBuf> {
    shipped::file_of(policy).filter(|path| !files::is_yaml(path))
}
