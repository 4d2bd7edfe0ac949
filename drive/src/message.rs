//! The messages to the thread that owns the robots.

use std::path::PathBuf;

use supple::policy::Agent;

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
    PolicySaved {
        /// Path of the policy.
        path: PathBuf,
        /// The newer policy, loaded.
        agent: Box<Agent>,
        /// Content of the policy's file.
        file: Option<Vec<u8>>,
    },
    /// A text to show on all pages.
    Notice(String),
    /// Ends the program.
    Stop,
}
