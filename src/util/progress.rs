//! Progress bars that fit any terminal and show the remaining time once it can be estimated.

use std::fmt::Write;
use std::os::fd::AsFd;

pub use indicatif::{MultiProgress, ProgressBar};
use indicatif::{ProgressDrawTarget, ProgressState, ProgressStyle};
use rustix::termios::tcgetwinsize;

/// Width of the bar itself \[columns\].
const BAR: usize = 30;

/// Creates a progress bar of `steps` steps on standard error, if that is a terminal; its message is cut at the line's
/// end.
pub fn progress(steps: u64) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(steps), ProgressDrawTarget::stderr_with_hz(4));
    let draw = |state: &ProgressState, out: &mut dyn Write| {
        let left_s = Some(state.eta().as_secs()).filter(|left_s| *left_s > 0);
        // Writing into a line cannot fail.
        let _ = out.write_str(&gauge(columns(std::io::stderr()), state.fraction(), left_s));
    };
    match ProgressStyle::with_template("{gauge}{wide_msg}") {
        Ok(style) => bar.with_style(style.with_key("gauge", draw)),
        Err(_) => bar,
    }
}

/// Returns the number of columns of the terminal that a stream writes to; 80 without one.
pub fn columns(stream: impl AsFd) -> usize {
    tcgetwinsize(stream).map_or(80, |size| usize::from(size.ws_col)).max(1)
}

/// Formats the part of a line of `columns` before the message; `left_s` is the remaining time \[s\], once it is known.
fn gauge(columns: usize, fraction: f32, left_s: Option<u64>) -> String {
    let mut text = String::new();
    if columns >= BAR + 40 {
        let full = (fraction.clamp(0.0, 1.0) * BAR as f32) as usize;
        text = format!("{}{} ", "█".repeat(full), "░".repeat(BAR - full));
    }
    text.push_str(&format!("{:3.0} %", 100.0 * fraction));
    if let Some(left_s) = left_s {
        text.push_str(&format!(", {} left", duration(left_s)));
    }
    text.push_str("  ");
    text.chars().take(columns).collect()
}

/// Formats the pace of work of which `done` units took `elapsed_s` and `left` remain, for logs in which no bar can be drawn.
pub fn pace(done: u64, elapsed_s: f64, left: u64, unit: &str) -> String {
    let rate = done as f64 / elapsed_s.max(1e-3);
    if done == 0 {
        return format!("0 {unit}/s");
    }
    format!("{rate:.0} {unit}/s, {} left", duration((left as f64 / rate).ceil() as u64))
}

fn duration(seconds: u64) -> String {
    match seconds {
        0..60 => format!("{seconds}s"),
        60..3600 => format!("{}m", seconds / 60),
        3600..360_000 => format!("{}h{:02}m", seconds / 3600, seconds / 60 % 60),
        _ => format!("{}d", seconds / 86_400),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pace_tells_the_time_that_is_left() {
        // 6000 in 3 s are 2000 per second: 7000 more take 3.5 s.
        assert_eq!(pace(6000, 3.0, 7000, "samples"), "2000 samples/s, 4s left");
        assert_eq!(pace(0, 0.0, 7000, "samples"), "0 samples/s");
    }

    #[test]
    fn the_gauge_fits_20_columns_and_tells_no_time_before_there_is_one() {
        for left_s in [None, Some(1), Some(59), Some(3599), Some(86_399), Some(u64::MAX / 2)] {
            for fraction in [0.0, 0.5, 1.0] {
                let width = gauge(20, fraction, left_s).chars().count();
                assert!(width <= 20, "{left_s:?}: {width}");
            }
        }
        assert_eq!(gauge(20, 0.5, None).trim(), "50 %");
        assert_eq!(gauge(20, 0.5, Some(125)).trim(), "50 %, 2m left");
        assert_eq!(gauge(80, 0.5, Some(3661)), format!("{}{}  50 %, 1h01m left  ", "█".repeat(15), "░".repeat(15)));
        assert_eq!(gauge(3, 0.5, None).chars().count(), 3);
    }
}
