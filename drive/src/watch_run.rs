//! Watches policies of running training runs and reads each newer one.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, SystemTime};

use supple::policy::shipped;
use supple::scenario::session::{AgentCache, SessionError};
use supple::util::{files, terminal};

use crate::message::{Message, NewPolicy};

/// Time between two checks.
const PERIOD: Duration = Duration::from_millis(500);

/// Starts a thread that reads every watched policy file whenever it changes, until the receiver is dropped. With `is_shared`,
/// people elsewhere may name files: only the terminal then shows what is wrong with one.
///
/// # Errors
/// The thread cannot be started.
pub fn start(watched: Arc<Mutex<Vec<PathBuf>>>, to: SyncSender<Message>, is_shared: bool) -> std::io::Result<()> {
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
                    Err(error) => Message::Notice(told(&error, is_shared)),
                };
                if to.send(message).is_err() {
                    return;
                }
            }
        }
    };
    thread::Builder::new().name("watching runs".to_owned()).spawn(look).map(drop)
}

/// Returns the notice that pages show for a policy that cannot be read.
fn told(error: &SessionError, is_shared: bool) -> String {
    if !is_shared {
        return error.to_string();
    }
    // It may quote any file of this machine.
    terminal::note(error);
    "a newer policy cannot be loaded: the terminal says why".to_owned()
}

/// Returns the file of a policy that may change while it is used, if it has one.
pub fn file_of(policy: &str) -> Option<PathBuf> {
    shipped::file_of(policy).filter(|path| !files::is_yaml(path))
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
            match messages.recv().unwrap() {
                Message::Notice(text) => text,
                message => panic!("{message:?}"),
            }
        };
        assert!(told(false).contains("private.safetensors"));
        assert_eq!(told(true), "a newer policy cannot be loaded: the terminal says why");
    }
}
