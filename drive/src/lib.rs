/*! Robots driven live in a browser; start reading in [`live`].

One thread owns the robots and plays them in real time ([`live`]). It receives [`message`]s through a queue and publishes
the newest state and frames ([`publisher`]); each page and viewer takes as many of them as it can ([`viewer_stream`]). A web
[`server`] carries both: the page of controls uses one WebSocket, the embedded rerun viewer another. Every input is recorded
in a session, which can be played again bit for bit ([`replay`]).

This is the only package that contains a web server.
*/

mod change;
pub mod clock;
pub mod driver;
pub mod live;
pub mod message;
pub mod publisher;
pub mod replay;
pub mod request;
mod save;
pub mod server;
pub mod viewer_stream;
mod watch_run;
