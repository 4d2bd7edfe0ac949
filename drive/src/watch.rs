//! Looks after policies that are still being trained: reads them anew when their run has saved a better one.

use std::path::{Path, PathBuf};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, SystemTime};

use supple::policy::Agent;
use supple::util::files;

use crate::live::Message;

/// Time between two looks.
const PERIOD: Duration = Duration::from_millis(500);

/// A policy that is played: the robot, its path, its identity.
pub type Watched = (usize, PathBuf, String);

/// Larger files are not policies.
const MAX_BYTES: u64 = 64 << 20;

/// Looks at the files of policies for as long as somebody listens.
pub fn start(watched: Arc<Mutex<Vec<Watched>>>, to: SyncSender<Message>) -> std::io::Result<()> {
    let mut seen: Vec<(usize, PathBuf, SystemTime)> = Vec::new();
    let look = move || {
        loop {
            thread::sleep(PERIOD);
            // Whoever holds the lock only replaces the list.
            let list = watched.lock().map(|list| list.clone()).unwrap_or_default();
            seen.retain(|(robot, path, _)| list.iter().any(|(of, watched, _)| (of, watched) == (robot, path)));
            for (robot, path, sha256) in list {
                let Ok(time) = path.metadata().and_then(|metadata| metadata.modified()) else { continue };
                if seen.contains(&(robot, path.clone(), time)) {
                    continue;
                }
                // A file that is no policy now will be one when it has changed again.
                let read = Agent::load(&path).ok().zip(files::read_bounded(&path, MAX_BYTES).ok());
                let Some((agent, file)) = read.filter(|(agent, file)| files::sha256(&[file]) == agent.sha256) else {
                    continue;
                };
                if agent.sha256 != sha256 && to.send(Message::Renewed { robot, agent: Box::new(agent), file }).is_err()
                {
                    return;
                }
                seen.retain(|(of, known, _)| (*of, known) != (robot, &path));
                seen.push((robot, path, time));
            }
        }
    };
    thread::Builder::new().name("watching runs".to_owned()).spawn(look).map(drop)
}

/// The file that a policy is read from, if it is one that may change.
pub fn file_of(policy: &str) -> Option<PathBuf> {
    let path = Path::new(policy);
    let path = if path.is_dir() { path.join("policy.safetensors") } else { path.to_owned() };
    (path.is_file() && !files::is_yaml(&path)).then_some(path)
}
