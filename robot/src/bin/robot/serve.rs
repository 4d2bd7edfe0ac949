//! `robot serve`: command line.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use supple::estimate::SensorNoise;
use supple::robot::JointLosses;
use supple::scenario::catalog::Scenario;
use supple::util::terminal;
use supple_robot::remote::FullSticks;
use supple_robot::serve::{Faults, Settings, play};

use crate::{Network, stop_flag};

/// The command line.
#[derive(Args, Debug)]
pub struct Serve {
    /// Scenario to play, as `scenario list` names them
    #[arg(long, value_name = "NAME")]
    scenario: Option<String>,
    /// A parameter of the scenario by the name of its flag, such as push_m_s=0.5; may be repeated
    #[arg(long, value_name = "KEY=VALUE", requires = "scenario")]
    set: Vec<String>,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Losses in the joints
    #[arg(long, value_enum, default_value = "ideal")]
    joints: JointLosses,
    /// Sensors without noise
    #[arg(long)]
    exact_sensors: bool,
    /// Physics rate (Hz), a multiple of 500
    #[arg(long, value_name = "HZ", default_value_t = 1000)]
    physics_hz: u32,
    /// Obey without a release of the robot's own controller, as simulators do
    #[arg(long)]
    released: bool,
    /// Do not look at head and level flag, which some clients leave at zero
    #[arg(long)]
    any_head: bool,
    /// Velocities that full sticks of the remote mean: forward (m/s), left (m/s), turning (rad/s)
    #[arg(long, value_name = "V,V,W", value_delimiter = ',', default_values_t = [1.0, 0.5, 0.5])]
    full_sticks: Vec<f64>,
    /// Delay of every message, each way (s)
    #[arg(long, value_name = "S", default_value_t = 0.0, help_heading = "Faults of the connection")]
    latency_s: f64,
    /// Largest additional delay of a message (s)
    #[arg(long, value_name = "S", default_value_t = 0.0, help_heading = "Faults of the connection")]
    jitter_s: f64,
    /// Fraction of messages that are lost
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0, help_heading = "Faults of the connection")]
    loss: f64,
    /// Recording to write
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    record: Option<PathBuf>,
    /// Open a page in which the robot is pushed and pulled by hand, and without a scenario its remote's stick is moved
    #[arg(long, help_heading = "Page")]
    page: bool,
    /// Port of the page, 0 for any free port
    #[arg(long, value_name = "PORT", default_value_t = 9100, requires = "page", help_heading = "Page")]
    port: u16,
    /// Print one JSON object on stdout and nothing else there
    #[arg(long, help_heading = "Output")]
    json: bool,
    /// End after this time (s)
    #[arg(long, value_name = "S", help_heading = "Output")]
    seconds: Option<f64>,
    #[command(flatten)]
    network: Network,
}

/// Serves until the scenario ends or Ctrl-C.
pub fn run(args: &Serve) -> anyhow::Result<()> {
    for (name, found) in [("latency-s", args.latency_s), ("jitter-s", args.jitter_s), ("loss", args.loss)] {
        anyhow::ensure!((0.0..=1.0).contains(&found), "--{name} is {found}, expected 0 to 1");
    }
    let [forward, left, yaw] = args.full_sticks[..] else { anyhow::bail!("--full-sticks: expected three numbers") };
    anyhow::ensure!(
        [forward, left, yaw].iter().all(|full| (0.01..=10.0).contains(full)),
        "--full-sticks is {forward},{left},{yaw}, expected numbers from 0.01 to 10"
    );
    let settings = Settings {
        place: args.network.place()?,
        scenario: args.scenario.as_deref().map(|name| scenario(name, &args.set)).transpose()?,
        seed: args.seed,
        joints: args.joints,
        noise: (!args.exact_sensors).then(SensorNoise::default),
        physics_hz: args.physics_hz,
        faults: Faults { latency_s: args.latency_s, jitter_s: args.jitter_s, loss: args.loss },
        released: args.released,
        any_head: args.any_head,
        full_sticks: FullSticks([forward, left, yaw]),
        record: args.record.clone(),
        page: args.page.then_some(args.port),
        seconds: args.seconds,
    };
    let stop = stop_flag()?;
    let summary = play(&settings, &stop)?;
    if args.json {
        terminal::print(format_args!("{}\n", summary.to_json(&settings)))?;
    } else {
        terminal::print(summary.text())?;
    }
    Ok(())
}

/// Builds the scenario from its name and `key=value` pairs.
pub fn scenario(name: &str, parameters: &[String]) -> anyhow::Result<Scenario> {
    let mut yaml = String::from("{}");
    if !parameters.is_empty() {
        let pair = |text: &String| {
            let (key, value) = text.split_once('=').with_context(|| format!("--set {text}: expected KEY=VALUE"))?;
            anyhow::Ok(format!("{}: {value}\n", key.replace('-', "_")))
        };
        yaml = parameters.iter().map(pair).collect::<anyhow::Result<String>>()?;
    }
    Ok(Scenario::named(name, &yaml)?)
}
