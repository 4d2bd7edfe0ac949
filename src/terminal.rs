//! What programs say: to a standard output and a standard error that may be closed at any moment, as by `| head -1`.

use std::fmt::Display;
use std::io::{self, Write};

/// Writes to standard output. That nobody reads it any more is no error: whoever reads decides how much.
///
/// # Errors
/// The system's, such as a full disk.
pub fn print(text: impl Display) -> io::Result<()> {
    let mut out = io::stdout().lock();
    match write!(out, "{text}").and_then(|()| out.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Err(error) => Err(io::Error::new(error.kind(), format!("cannot write to standard output: {error}"))),
        Ok(()) => Ok(()),
    }
}

/// Writes a line to standard error, if there is still one: nobody is left to tell if not.
pub fn note(text: impl Display) {
    let _ = writeln!(io::stderr(), "{text}");
}
