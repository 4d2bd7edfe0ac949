/*! Robots live in a browser.

One thread owns the robots and plays them in real time ([`live`]); what it is told comes through a queue, what happens goes
out as the newest state and the newest frames, of which everybody takes what they can ([`show`]). A web [`server`] carries
both: a page of controls talks to it over one WebSocket, rerun's viewer beside it is fed over another. Everything that was
done is kept as a session, from which it can be played again ([`replay`]).

This package is the only one that knows a web server.
*/

pub mod clock;
pub mod display;
pub mod keep;
pub mod live;
pub mod replay;
pub mod request;
pub mod server;
pub mod show;
mod watch;
