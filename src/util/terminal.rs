//! Output of programs to a standard output and a standard error that may be closed at any moment, as by `| head -1`, and the signals
//! that end them.

use std::borrow::Cow;
use std::error::Error;
use std::ffi::OsStr;
use std::fmt::Display;
use std::io::{self, Write};
use std::os::unix::ffi::OsStrExt;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Time within which two signals count as one: programs that forward signals, such as timeout, send the same one twice.
const SAME_SIGNAL: Duration = Duration::from_millis(200);

/// Writes text to standard output, made [`plain`]. A closed pipe is no error.
///
/// # Errors
/// Standard output cannot be written, for example because the disk is full.
pub fn print(text: impl Display) -> io::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(plain(&text.to_string()).as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Err(error) => Err(io::Error::new(error.kind(), format!("cannot write to standard output: {error}"))),
        Ok(()) => Ok(()),
    }
}

/// Ends a program: prints the error, if there is one, and returns the exit code, 0 or 2.
pub fn conclude(outcome: Result<(), impl AsRef<dyn Error + Send + Sync>>) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            note(format_args!("error: {}", complaint(error.as_ref())));
            ExitCode::from(2)
        }
    }
}

/// Formats an error and its causes on one line, without repeating a cause that a message already contains.
pub fn complaint(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let words = error.to_string();
        if !text.contains(&words) {
            text = format!("{text}: {words}");
        }
        cause = error.source();
    }
    text
}

/// Quotes a word for a shell if necessary, whatever its bytes are.
pub fn shell_word(word: impl AsRef<OsStr>) -> String {
    let bytes = word.as_ref().as_bytes();
    if let Some(quoted) = word.as_ref().to_str().and_then(|text| shlex::try_quote(text).ok()) {
        return quoted.into_owned();
    }
    let escape = |byte: &u8| match byte {
        b'\'' | b'\\' => format!("\\{}", char::from(*byte)),
        b' '..=b'~' => char::from(*byte).to_string(),
        byte => format!("\\x{byte:02x}"),
    };
    format!("$'{}'", bytes.iter().map(escape).collect::<String>())
}

/// Removes terminal commands from a text: control characters (except line ends and tabs) are escaped as in JSON.
pub fn plain(text: &str) -> Cow<'_, str> {
    let commands = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    if !text.contains(commands) {
        return text.into();
    }
    let spelt = |c: char| if commands(c) { format!("\\u{:04x}", u32::from(c)) } else { c.to_string() };
    text.chars().map(spelt).collect::<String>().into()
}

/// Largest number of letters of an input that a message repeats.
const ECHO: usize = 200;

/// Returns the beginning of an input for a message, with an ellipsis if that is not all.
pub fn echo(input: &str) -> Cow<'_, str> {
    match input.char_indices().nth(ECHO) {
        Some((end, _)) => format!("{}…", &input[..end]).into(),
        None => input.into(),
    }
}

/// Writes a line, made [`plain`], to standard error, if it is still open.
pub fn note(text: impl Display) {
    let _ = writeln!(io::stderr(), "{}", plain(&text.to_string()));
}

/// Handles Ctrl-C, SIGTERM and SIGHUP: the first one calls `stop`, which asks the program to end; the second one prints
/// `last_words` and ends it at once, with exit code 130.
///
/// # Errors
/// The operating system refuses it, or signals are handled already.
pub fn on_signals(mut stop: impl FnMut() + Send + 'static, last_words: &'static str) -> Result<(), ctrlc::Error> {
    let mut first: Option<Instant> = None;
    ctrlc::set_handler(move || match first {
        None => {
            first = Some(Instant::now());
            stop();
        }
        Some(first) if first.elapsed() < SAME_SIGNAL => {}
        Some(_) => {
            note(last_words);
            std::process::exit(130);
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("file x: {source}")]
    struct Wrapping {
        source: io::Error,
    }

    #[test]
    fn words_for_a_shell_are_read_as_what_they_were() {
        for word in [&b"plain"[..], b"it's two", b"caf\xe9 'x' \\y", b"\xff"] {
            let line = format!("printf %s {}", shell_word(OsStr::from_bytes(word)));
            let output = std::process::Command::new("bash").args(["-c", &line]).output().unwrap();
            assert_eq!(output.stdout, word, "{line}");
        }
    }

    #[test]
    fn control_characters_are_spelt_out() {
        assert_eq!(plain("a\tb\u{1b}[31mred\u{7}\u{9b}\n"), "a\tb\\u001b[31mred\\u0007\\u009b\n");
    }

    #[test]
    fn a_cause_that_the_message_has_is_not_repeated() {
        let error = Wrapping { source: io::Error::other("disk full") };
        assert_eq!(complaint(&error), "file x: disk full");
        let told = anyhow::Error::from(io::Error::other("disk full")).context("x: disk full; make room");
        assert_eq!(complaint(told.as_ref()), "x: disk full; make room");
        let error = anyhow::Error::from(error).context("stopped");
        assert_eq!(complaint(error.as_ref()), "stopped: file x: disk full");
    }
}
