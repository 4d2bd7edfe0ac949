//! What programs say: to a standard output and a standard error that may be closed at any moment, as by `| head -1`.

use std::error::Error;
use std::fmt::Display;
use std::io::{self, Write};
use std::process::ExitCode;

use indicatif::{ProgressBar, ProgressStyle};

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

/// The end of a program: says what went wrong, if something did, and gives the exit code, 0 or 2.
pub fn conclude(outcome: Result<(), impl AsRef<dyn Error + Send + Sync>>) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            note(format_args!("error: {}", complaint(error.as_ref())));
            ExitCode::from(2)
        }
    }
}

/// An error and its causes on one line, without repeating a cause that a message already ends with.
pub fn complaint(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let words = error.to_string();
        if !text.ends_with(&words) {
            text = format!("{text}: {words}");
        }
        cause = error.source();
    }
    text
}

/// Writes a line to standard error, if there is still one: nobody is left to tell if not.
pub fn note(text: impl Display) {
    let _ = writeln!(io::stderr(), "{text}");
}

/// A progress bar of this length on standard error; the template is indicatif's.
pub fn progress_bar(length: u64, template: &str) -> ProgressBar {
    let bar = ProgressBar::new(length);
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("file x: {source}")]
    struct Named {
        source: io::Error,
    }

    #[test]
    fn a_cause_that_the_message_ends_with_is_not_repeated() {
        let error = Named { source: io::Error::other("disk full") };
        assert_eq!(complaint(&error), "file x: disk full");
        let error = anyhow::Error::from(error).context("stopped");
        assert_eq!(complaint(error.as_ref()), "stopped: file x: disk full");
    }
}
