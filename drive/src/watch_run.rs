//! Watches policies of running training runs and reads each newer one.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, SystemTime};

use supple::policy::shipped;
use supple::scenario::session::{AgentCache, LiveSession};
use supple::util::{files, terminal};

use crate::message::{Message, NewPolicy};
use crate::server::start_thread;

/// Time between two checks.
const PERIOD: Duration = Duration::from_millis(500);

/// Starts a thread that reads every watched policy file whenever it changes, until the receiver is dropped. With `is_shared`, pages on
/// other machines may name files: only the terminal then shows errors about them.
pub fn start(watched: Arc<Mutex<Vec<PathBuf>>>, to: SyncSender<Message>, is_shared: bool) -> anyhow::Result<()> {
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
                    Err(error) => Message::Notice(told(&error.to_string(), "a newer policy", is_shared)),
                };
                if to.send(message).is_err() {
                    return;
                }
            }
        }
    };
    start_thread("watching runs", look)
}

/// Returns the notice for pages about a file that cannot be loaded. With `is_shared`, only the terminal shows the error, as it may quote
/// any file of this machine.
pub fn told(error: &str, what: &str, is_shared: bool) -> String {
    if !is_shared {
        return error.to_owned();
    }
    terminal::note(error);
    format!("{what} cannot be loaded: the terminal shows the reason")
}

/// Returns the file of each robot's policy, if it may change while it is used.
pub fn files_of(world: &LiveSession) -> Vec<Option<PathBuf>> {
    let file_of = |policy: &str| shipped::file_of(policy).filter(|path| !files::is_yaml(path));
    world.setup().robots.iter().map(|seat| file_of(&seat.policy)).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::sync_channel;

    use super::*;

    #[test]
    fn pages_elsewhere_never_see_what_is_wrong_with_a_newer_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("private.safetensors");
        std::fs::write(&path, "damaged").unwrap();
        let told = |is_shared| {
            let (to, messages) = sync_channel(1);
            start(Arc::new(Mutex::new(vec![path.clone()])), to, is_shared).unwrap();
            let Message::Notice(text) = messages.recv().unwrap() else { panic!("it is read") };
            text
        };
        assert!(told(false).contains("private.safetensors"));
        assert_eq!(told(true), "a newer policy cannot be loaded: the terminal shows the reason");
    }
}
