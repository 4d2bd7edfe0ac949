//! The command line of `robot serve`.

use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use supple::robot::JointLosses;
use supple::scenario::catalog::Scenario;

use super::link::Faults;
use crate::dds::Network;
use crate::remote::FullSticks;

/// The simulated robot, its scenario and its connection.
#[derive(clap::Args, Debug)]
pub struct Settings {
    /// Scenario to play, as `scenario list` names them
    #[arg(long, value_name = "NAME")]
    pub scenario: Option<String>,
    /// A parameter of the scenario by the name of its flag, such as push_m_s=0.5; may be repeated
    #[arg(long, value_name = "KEY=VALUE", requires = "scenario")]
    pub set: Vec<String>,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Losses in the joints
    #[arg(long, value_enum, default_value = "ideal")]
    pub joints: JointLosses,
    /// Obey without a release of the robot's own controller, as simulators do
    #[arg(long)]
    pub released: bool,
    /// Ignore head and level flag, which some clients leave at zero
    #[arg(long)]
    pub any_head: bool,
    /// Velocities that full sticks of the remote mean: forward (m/s), left (m/s), turning (rad/s)
    #[arg(long, value_name = "V,V,W", value_delimiter = ',', default_values_t = [1.0, 0.5, 0.5])]
    pub full_sticks: Vec<f64>,
    /// Delay of every message, each way (s)
    #[arg(long, value_name = "S", default_value_t = 0.0, help_heading = "Faults of the connection")]
    pub latency_s: f64,
    /// Largest additional delay of a message (s)
    #[arg(long, value_name = "S", default_value_t = 0.0, help_heading = "Faults of the connection")]
    pub jitter_s: f64,
    /// Fraction of messages that are lost
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0, help_heading = "Faults of the connection")]
    pub loss: f64,
    /// Recording to write
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    pub record: Option<PathBuf>,
    /// Open a page to push and pull the robot and, without a scenario, to move the remote's sticks
    #[arg(long, help_heading = "Page")]
    pub page: bool,
    /// Port of the page, 0 for any free port
    #[arg(long, value_name = "PORT", default_value_t = 9100, requires = "page", help_heading = "Page")]
    pub port: u16,
    /// Print one JSON object on stdout and nothing else there
    #[arg(long, help_heading = "Output")]
    pub json: bool,
    /// End after this time (s)
    #[arg(long, value_name = "S", help_heading = "Output")]
    pub seconds: Option<f64>,
    /// The place in the network
    #[command(flatten)]
    pub network: Network,
}

impl Settings {
    pub(super) fn scenario(&self) -> Result<Option<Scenario>> {
        self.scenario.as_deref().map(|name| scenario(name, &self.set)).transpose()
    }

    pub(super) fn faults(&self) -> Result<Faults> {
        let Settings { latency_s, jitter_s, loss, .. } = *self;
        for (name, found) in [("latency-s", latency_s), ("jitter-s", jitter_s), ("loss", loss)] {
            ensure!((0.0..=1.0).contains(&found), "--{name} is {found}, expected 0 to 1");
        }
        Ok(Faults { latency_s, jitter_s, loss })
    }

    pub(super) fn full_sticks(&self) -> Result<FullSticks> {
        let [forward, left, yaw] = self.full_sticks[..] else { bail!("--full-sticks: expected three numbers") };
        ensure!(
            [forward, left, yaw].iter().all(|full| (0.01..=10.0).contains(full)),
            "--full-sticks is {forward},{left},{yaw}, expected numbers from 0.01 to 10"
        );
        Ok(FullSticks([forward, left, yaw]))
    }
}

/// Builds a scenario from its name and `key=value` pairs.
///
/// # Errors
/// A pair has no `=`, or there is no such scenario or parameter.
pub fn scenario(name: &str, parameters: &[String]) -> Result<Scenario> {
    let pair = |text: &String| {
        let (key, value) = text.split_once('=').with_context(|| format!("--set {text}: expected KEY=VALUE"))?;
        anyhow::Ok(format!("{}: {value}\n", key.replace('-', "_")))
    };
    let yaml = parameters.iter().map(pair).collect::<Result<String>>()?;
    Ok(Scenario::named(name, if yaml.is_empty() { "{}" } else { &yaml })?)
}
