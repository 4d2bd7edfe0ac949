//! The messages to the thread that owns the robots.

use std::path::PathBuf;

use supple::policy::Agent;
use supple::scenario::session::{AgentCache, LiveSession, SessionReplay};

use crate::request::{PageId, Request};

/// A message to the thread that owns the robots.
#[derive(Debug)]
pub enum Message {
    /// A page connected.
    PageOpened(PageId),
    /// A page disconnected.
    PageClosed(PageId),
    /// A page sent a request.
    Request(PageId, Request),
    /// A training run saved a newer policy.
    PolicySaved(Box<NewPolicy>),
    /// The change of robots or scene with this number is ready, or the reason why it has failed.
    Built(u64, Result<Box<Built>, String>),
    /// A replayed session is at its first shown step again, or the reason why it cannot be.
    Rewound(Result<Box<SessionReplay>, String>),
    /// A text to show on all pages.
    Notice(String),
    /// Ends the program.
    Stop,
}

/// A newer policy of a training run.
#[derive(Debug)]
pub struct NewPolicy {
    /// Path of its file.
    pub path: PathBuf,
    /// The policy, loaded.
    pub agent: Agent,
    /// Content of its file.
    pub file: Option<Vec<u8>>,
}

/// Robots in a scene, ready to take over.
#[derive(Debug)]
pub struct Built {
    /// The robots and their scene before the first step.
    pub world: LiveSession,
    /// The policies that they need.
    pub cache: AgentCache,
    /// File of each robot's policy, if it may change while it is used.
    pub files: Vec<Option<PathBuf>>,
}
