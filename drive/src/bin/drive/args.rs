//! Command-line arguments of `drive`.

use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;

use clap::Parser;
use supple::scenario::session::SceneKind;

const ROBOTS: &str = "Robots and scene";
const VIEW: &str = "Page and viewer";
const SESSION: &str = "Sessions";

/// Drive robots live in a browser: push them, pull them, compare them.
///
/// Prints an address and opens it: the robots in rerun's viewer beside the controls. Policies, robots and scene can be changed
/// while it runs.
#[derive(Parser, Debug)]
#[command(name = env!("CARGO_BIN_NAME"), version = supple::provenance::version())]
pub struct Args {
    /// Policy file, run folder, YAML file of an external policy, or name of a shipped policy [default: real, with a commanded compliance of
    /// 0.03 m/s/N]
    ///
    /// The policy of a running training run is reloaded whenever the run saves a newer one.
    #[arg(long, help_heading = ROBOTS, value_name = "FILE|NAME[@C]")]
    pub policy: Option<String>,
    /// Policy of the second robot, `none` for one robot alone [default: real without a commanded compliance, if --policy is not given]
    #[arg(long, help_heading = ROBOTS, value_name = "FILE|NAME[@C]")]
    pub compare: Option<String>,
    /// Robot: an MJCF file, or a YAML file that names one and its joints [default: the policy's]
    #[arg(long, help_heading = ROBOTS, value_name = "FILE")]
    pub model: Option<String>,
    /// Scene in which the robots stand
    #[arg(long, help_heading = ROBOTS, value_name = "SCENE", default_value = "flat")]
    pub scene: SceneKind,
    /// Seed of the scene's random numbers
    #[arg(long, help_heading = ROBOTS, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Address to listen on; with 0.0.0.0, other machines that have the token can drive
    #[arg(long, help_heading = VIEW, value_name = "IP", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    pub bind: IpAddr,
    /// Port to listen on, 0 for any free port
    #[arg(long, help_heading = VIEW, value_name = "PORT", default_value_t = 9100)]
    pub port: u16,
    /// Show the robots in a running rerun viewer instead of on the page
    #[arg(long, help_heading = VIEW, value_name = "URL", num_args = 0..=1, require_equals = true)]
    pub connect: Option<Option<String>>,
    /// Print the address without opening it
    #[arg(long, help_heading = VIEW)]
    pub no_open: bool,
    /// Folder for saved sessions and recordings
    #[arg(long, help_heading = SESSION, value_name = "DIR", default_value = ".")]
    pub keep: PathBuf,
    /// Replay a saved session, bit for bit
    #[arg(long, help_heading = SESSION, value_name = "FILE", conflicts_with_all = ["policy", "compare", "model"])]
    pub replay: Option<PathBuf>,
    /// Replay as fast as possible, without a page, and print the result
    #[arg(long, help_heading = SESSION, requires = "replay")]
    pub headless: bool,
    /// Write a recording of the replay, without a page
    #[arg(long, help_heading = SESSION, value_name = "FILE", requires = "replay")]
    pub record: Option<PathBuf>,
}
