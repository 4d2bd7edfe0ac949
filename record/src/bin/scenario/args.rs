//! Command-line arguments of `scenario`: scenarios are subcommands, whose defaults come from `configs/scenarios/`.

use std::ffi::OsString;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use anyhow::Context;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use supple::robot::JointLosses;
use supple::scenario::Sensing;
use supple::scenario::catalog::{DEFAULTS, Scenario};
use supple::util::yaml::{Text, flat_parameters};

/// Headings of the help for arguments that are not the scenario's own.
const INPUT: &str = "Policies, robot and seed";
const OUTPUT: &str = "Output";

/// Disturb a walking robot and watch what it does.
///
/// Plays a scenario with one policy or two, prints metrics and events, and writes a recording for the rerun viewer.
#[derive(Parser, Debug)]
#[command(name = env!("CARGO_BIN_NAME"), version = supple::provenance::version())]
pub struct Args {
    /// Policy file, run folder, YAML file of an external policy, or name of a shipped policy; NAME@C sets this robot's commanded compliance
    /// C (m/s/N) instead of --compliance [default: compliant]
    #[arg(long, global = true, help_heading = INPUT, value_name = "FILE|NAME[@C]")]
    pub policy: Option<String>,
    /// Second policy in the same recording, `none` for none [default: baseline, if --policy is not given and both ship]
    #[arg(long, global = true, help_heading = INPUT, value_name = "FILE|NAME[@C]")]
    pub compare: Option<String>,
    /// Another robot: its MJCF file, or a YAML file that names one and its joints [default: the policy's]
    #[arg(long, global = true, help_heading = INPUT, value_name = "FILE")]
    pub model: Option<String>,
    /// Losses in the joints [default: as each policy was trained]
    #[arg(long, global = true, help_heading = INPUT, value_enum)]
    pub joints: Option<JointLosses>,
    /// Seed of everything random in the scenario
    #[arg(long, global = true, help_heading = INPUT, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Seeds from the first to the last, both included: prints means and spread, and writes no recording
    #[arg(long, global = true, help_heading = INPUT, value_name = "FIRST..LAST", value_parser = seed_range,
          conflicts_with_all = ["seed", "record", "connect", "serve", "on_fall", "csv", "video"])]
    pub seeds: Option<RangeInclusive<u64>>,
    /// State that the policy acts on: the true one, or an estimate from noisy sensors
    #[arg(long, global = true, help_heading = INPUT, value_enum, default_value_t)]
    pub sensing: Sensing,
    /// YAML file with parameters of the scenario, by the names of its flags; flags take precedence
    #[arg(long, global = true, help_heading = INPUT, value_name = "FILE")]
    pub params: Option<PathBuf>,
    /// Recording to write [default: SCENARIO.rrd]
    #[arg(long, global = true, help_heading = OUTPUT, value_name = "FILE", conflicts_with = "no_record")]
    pub record: Option<PathBuf>,
    /// Write no recording
    #[arg(long, global = true, help_heading = OUTPUT)]
    pub no_record: bool,
    /// Stream to a running rerun viewer instead of a file
    #[arg(long, global = true, help_heading = OUTPUT, value_name = "URL", num_args = 0..=1, require_equals = true,
          conflicts_with_all = ["record", "no_record"])]
    pub connect: Option<Option<String>>,
    /// Serve the viewer for a web browser on this port of this machine, until Ctrl-C; the next port carries the data
    #[arg(long, global = true, help_heading = OUTPUT, value_name = "PORT", num_args = 0..=1, require_equals = true,
          default_missing_value = "9090", conflicts_with_all = ["record", "no_record", "connect"])]
    pub serve: Option<u16>,
    /// Also draw a video (.mp4 or .webp), 30 frames a second; for programs built with the feature `video`
    #[arg(long, global = true, help_heading = OUTPUT, value_name = "FILE")]
    pub video: Option<PathBuf>,
    /// Width and height of the video (px), even numbers
    #[arg(long, global = true, help_heading = OUTPUT, value_name = "WIDTHxHEIGHT", default_value = "960x540",
          value_parser = picture_size)]
    pub video_size: [usize; 2],
    /// Keep the last 2 s before a fall as a separate recording in this folder
    #[arg(long, global = true, help_heading = OUTPUT, value_name = "DIR")]
    pub on_fall: Option<PathBuf>,
    /// Print one JSON object on stdout and nothing else there
    #[arg(long, global = true, help_heading = OUTPUT)]
    pub json: bool,
    /// Write the trace, one row for each policy step; `-` writes it to stdout, and the summary to stderr
    #[arg(long, global = true, help_heading = OUTPUT, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    #[command(subcommand)]
    pub what: What,
}

/// A scenario, or the list of them.
#[derive(Subcommand, Debug)]
pub enum What {
    /// List the scenarios
    List,
    /// Replay a session saved by `drive`, and measure its pushes and pulls
    Session {
        /// File of the session
        file: PathBuf,
    },
    #[command(flatten)]
    Play(Scenario),
}

/// Parses the command line. On an error in the arguments, clap prints it and exits with code 2.
pub fn parse() -> anyhow::Result<Args> {
    let line: Vec<OsString> = std::env::args_os().collect();
    let args = from_line(command(None)?, &line);
    let (Some(file), What::Play(scenario)) = (&args.params, &args.what) else { return Ok(args) };
    let text = Text::read(file).with_context(|| format!("cannot read {}", file.display()))?;
    let parameters = flat_parameters(&text)?;
    Ok(from_line(command(Some((scenario.name(), parameters)))?, &line))
}

fn from_line(command: clap::Command, line: &[OsString]) -> Args {
    let matches = command.clone().get_matches_from(line);
    Args::from_arg_matches(&matches).unwrap_or_else(|error| error.format(&mut command.clone()).exit())
}

/// The name of a file and its parameters.
type Parameters<'a> = (&'a str, Vec<(String, Option<String>)>);

/// Builds the clap command with all defaults, overridden by the parameters of a file.
fn command(file: Option<Parameters<'_>>) -> anyhow::Result<clap::Command> {
    let mut command = Args::command();
    for (name, text) in DEFAULTS {
        command = with_defaults(command, (name, flat_parameters(&Text::new(name, text))?))?;
    }
    if let Some(file) = file { with_defaults(command, file) } else { Ok(command) }
}

fn with_defaults(command: clap::Command, (scenario, parameters): Parameters<'_>) -> anyhow::Result<clap::Command> {
    let arguments = command.find_subcommand(scenario).into_iter().flat_map(clap::Command::get_arguments);
    let known: Vec<String> = arguments.map(|argument| argument.get_id().to_string()).collect();
    if let Some((unknown, _)) = parameters.iter().find(|(name, _)| !known.contains(name)) {
        anyhow::bail!("scenario {scenario} has no parameter '{unknown}'; it has: {}", known.join(", "));
    }
    Ok(command.mut_subcommand(scenario, |subcommand| {
        parameters.into_iter().fold(subcommand, |subcommand, (name, value)| {
            subcommand.mut_arg(name, |argument| {
                let argument = argument.required(false).allow_negative_numbers(true);
                value.into_iter().fold(argument, |argument, value| argument.default_value(value))
            })
        })
    }))
}

/// Parses a range of seeds such as `0..9`, both ends included.
fn seed_range(text: &str) -> Result<RangeInclusive<u64>, String> {
    let number = |text: &str| text.parse::<u64>().ok();
    let ends = text.split_once("..").and_then(|(first, last)| number(first).zip(number(last)));
    match ends.filter(|(first, last)| first <= last) {
        Some((first, last)) if last - first < 10_000 => Ok(first..=last),
        _ => Err("expected FIRST..LAST, both included, as in 0..9; at most 10000 seeds".into()),
    }
}

/// Parses a size such as `960x540`.
fn picture_size(text: &str) -> Result<[usize; 2], String> {
    let ends = text.split_once('x').and_then(|(width, height)| Some([width.parse().ok()?, height.parse().ok()?]));
    ends.ok_or_else(|| "expected WIDTHxHEIGHT in pixels, as in 960x540".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ends_of_a_range_count() {
        assert_eq!(seed_range("0..9").unwrap().count(), 10);
        assert_eq!(seed_range("7..7").unwrap(), 7..=7);
        for bad in ["9..0", "3", "0..", "a..b", "-1..2", "0..10000", "0..18446744073709551615"] {
            assert!(seed_range(bad).is_err(), "{bad}");
        }
    }
}
