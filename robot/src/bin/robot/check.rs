//! `robot check` and `robot rehearse`: command lines.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use supple::policy::shipped;
use supple::scenario::metrics::{Metric, by_name};
use supple::util::terminal;
use supple::util::yaml;
use supple_robot::check::{Columns, LogRows, Verdict, check};
use supple_robot::lockstep::rehearse;
use supple_robot::serve::{scenario, told};

/// The command line of `robot check`.
#[derive(Args, Debug)]
pub struct Check {
    /// Log of `robot run`, a bag of ROS 2 (.mcap), or a CSV file of another program
    log: PathBuf,
    /// The policy that ran; NAME@C gives its commanded compliance C (m/s/N) where the log has none
    #[arg(value_name = "FILE|NAME[@C]")]
    policy: String,
    /// YAML file that describes a log of another program: its names of our columns, as in `names: {gyro_x: omega_x}`, values of missing
    /// columns, as in `constants: {kp: 40}`, and the time at which the policy began, as in `from_s: 6`
    #[arg(long, value_name = "FILE")]
    columns: Option<PathBuf>,
    /// Expected delay of the joint targets (s) [default: that of the policy's training]
    #[arg(long, value_name = "S")]
    latency_s: Option<f64>,
}

/// Checks a log; returns true if it fits.
pub fn run(args: &Check) -> Result<bool> {
    let agent = shipped::find(&args.policy)?;
    let mut columns = Columns::default();
    if let Some(path) = &args.columns {
        let text = yaml::Text::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        columns = yaml::layered(&[text])?;
    }
    let verdict = check(&LogRows::read(&args.log, &columns)?, &agent, args.latency_s)?;
    let Verdict { at_first_rad, at_last_rad, findings } = &verdict;
    terminal::print(format_args!("replayed and sent joint targets differ by {at_first_rad:.4} rad\n"))?;
    for finding in findings {
        let left = finding.difference_rad.map_or(String::new(), |left| format!(" (once corrected: {left:.4} rad)"));
        terminal::print(format_args!("  {}{left}\n", finding.text))?;
    }
    if verdict.fits() {
        terminal::print("the log fits the policy\n")?;
    } else if findings.len() > 1 {
        terminal::print(format_args!("with all of this corrected: {at_last_rad:.4} rad\n"))?;
    }
    Ok(verdict.fits())
}

/// The command line of `robot rehearse`.
#[derive(Args, Debug)]
pub struct Rehearse {
    /// Policy of the Go2
    #[arg(value_name = "FILE|NAME")]
    policy: String,
    /// Scenario to play, as `scenario list` names them
    #[arg(long, value_name = "NAME", default_value = "walk")]
    scenario: String,
    /// A parameter of the scenario by the name of its flag, such as push_m_s=0.5; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Commanded compliance (m/s/N) [default: the policy's own]
    #[arg(long, value_name = "C")]
    compliance: Option<f64>,
    /// Print one JSON object on stdout and nothing else there
    #[arg(long)]
    json: bool,
}

/// Rehearses, and prints the scenario's metrics.
pub fn run_rehearsal(args: &Rehearse) -> Result<()> {
    let agent = shipped::find(&args.policy)?;
    let compliance = agent.resolve_compliance(None, args.compliance).with_context(|| args.policy.clone())?;
    let scenario = scenario(&args.scenario, &args.set)?;
    let rehearsal = rehearse(&agent, &scenario, args.seed, compliance)?;
    if args.json {
        let metrics = by_name(&rehearsal.metrics, Metric::to_json);
        let object = serde_json::json!({
            "scenario": scenario.name(), "seed": args.seed, "metrics": metrics, "events": rehearsal.events,
            "complaints": rehearsal.complaints, "notes": rehearsal.notes,
        });
        return Ok(terminal::print(format_args!("{object}\n"))?);
    }
    rehearsal.notes.iter().try_for_each(|note| terminal::print(format_args!("  {note}\n")))?;
    Ok(terminal::print(told(&rehearsal.metrics, &rehearsal.events))?)
}
