/*! The robot's side: a simulated Go2 that is as strict as a real one.

Start with [`play()`]; `body` is the simulation behind the interface, `judge` decides which commands it obeys, `operator` is the person with
the remote. `link` adds delay and loss to the connection, and `page` is a page to push and pull the robot.
*/

pub(crate) mod body;
pub(crate) mod judge;
mod link;
pub(crate) mod operator;
mod page;
mod play;
mod settings;

pub use play::{COMMANDS, STATES, Summary, play, told};
pub use settings::{Settings, scenario};
