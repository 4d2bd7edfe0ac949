/*! The robot's side: a simulated Go2 that is as strict as a real one.

Start with [`Served`], which plays; [`body`] is the simulation behind the interface, [`judge`] decides which commands it obeys,
[`operator`] is the person with the remote, [`link`] makes the connection worse on demand, [`page`] lets people push and pull.
*/

pub mod body;
pub mod judge;
pub mod link;
pub mod operator;
pub mod page;
mod play;

pub use play::{COMMANDS, STATES, ServeError, Served, Settings, Summary, play};
