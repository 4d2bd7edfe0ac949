//! The command line.

use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;

use clap::Parser;
use supple::scenario::session::SceneKind;
use supple::util::terminal;

/// Headings in the help.
const ROBOTS: &str = "Robots and scene";
const VIEW: &str = "Page and viewer";
const SESSION: &str = "Sessions";

/// Drive robots live in a browser: push them, pull them, compare them.
///
/// Prints an address and opens it: the robots in rerun's viewer, beside it the controls. Everything can be chosen anew while
/// it runs.
#[derive(Parser, Debug)]
#[command(version)]
pub struct Args {
    /// Policy file, run folder, YAML file of an external policy, or name of a shipped policy [default: compliant]
    ///
    /// A policy that is still being trained is read anew whenever its run saves a newer one.
    #[arg(long, help_heading = ROBOTS, value_name = "FILE|NAME", value_parser = terminal::path_as_text())]
    pub policy: Option<String>,
    /// Second policy beside it, `none` for none [default: baseline, if --policy is not given]
    #[arg(long, help_heading = ROBOTS, value_name = "FILE|NAME", value_parser = terminal::path_as_text())]
    pub compare: Option<String>,
    /// Another robot: its MJCF file, or a YAML file that names one and its joints [default: the policy's]
    #[arg(long, help_heading = ROBOTS, value_name = "FILE", value_parser = terminal::path_as_text())]
    pub model: Option<String>,
    /// Where to drive
    #[arg(long, help_heading = ROBOTS, value_name = "SCENE", default_value = "flat")]
    pub scene: SceneKind,
    /// Seed of everything random in the scene
    #[arg(long, help_heading = ROBOTS, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Address to listen on; with any but this machine's own, others who have the token can drive
    #[arg(long, help_heading = VIEW, value_name = "IP", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    pub bind: IpAddr,
    /// Port to listen on, 0 for any that is free
    #[arg(long, help_heading = VIEW, value_name = "PORT", default_value_t = 9100)]
    pub port: u16,
    /// Show the robots in a rerun viewer that is already running instead of on the page
    #[arg(long, help_heading = VIEW, value_name = "URL", num_args = 0..=1, require_equals = true)]
    pub connect: Option<Option<String>>,
    /// Print the address, and leave it to you to open it
    #[arg(long, help_heading = VIEW)]
    pub no_open: bool,
    /// Folder for what is kept
    #[arg(long, help_heading = SESSION, value_name = "DIR", default_value = ".")]
    pub keep: PathBuf,
    /// Replay a kept session, bit for bit
    #[arg(long, help_heading = SESSION, value_name = "FILE", conflicts_with_all = ["policy", "compare", "model"])]
    pub replay: Option<PathBuf>,
    /// Play it as fast as it goes, without a page, and tell how it went
    #[arg(long, help_heading = SESSION, requires = "replay")]
    pub headless: bool,
    /// Write a recording of it, without a page
    #[arg(long, help_heading = SESSION, value_name = "FILE", requires = "replay")]
    pub record: Option<PathBuf>,
}
