//! Policy cards in Markdown: the origin of a policy, its learning curve, and how it walks.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use anyhow::Context;
use supple::policy::{Agent, shipped};
use supple::scenario::Playback;
use supple::scenario::catalog::{Scenario, Task, Walk, defaults};
use supple::train::metrics::IterationMetrics;
use supple::util::files;

/// Number of rows of the learning curve.
const ROWS: usize = 10;

/// Maximum length of a line of metrics \[bytes\].
const MAX_LINE_BYTES: u64 = 1 << 16;

/// Test commands: forward \[m/s\], left \[m/s\], yaw rate \[rad/s\]. They are the evaluation's command and the range's
/// ends.
const COMMANDS: [[f64; 3]; 8] = [
    [0.0, 0.0, 0.0],
    [0.5, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, 0.5, 0.0],
    [0.0, 0.0, 0.5],
    [1.0, 0.5, 0.5],
    [-1.0, -0.5, -0.5],
];

/// Writes the card of a policy, titled `name` or as the policy was given; with its learning curve if it is in a run's
/// folder.
pub fn card(policy: &str, name: Option<&str>) -> anyhow::Result<String> {
    let path = Path::new(policy);
    let named = if path.is_file() { path.file_stem() } else { path.file_name().filter(|_| path.is_dir()) };
    let named = named.map_or(policy.into(), |name| name.to_string_lossy());
    let name = name.unwrap_or(&named);
    let agent = shipped::find(policy)?;
    let policy =
        agent.policy().with_context(|| format!("{named} is an external policy: cards are of policies of Supple"))?;
    let provenance = &policy.provenance;
    let curve = path.is_dir().then(|| read_metrics(&path.join("metrics.jsonl"), provenance.samples)).transpose()?;
    let config = &provenance.config;
    let hours = curve.as_ref().and_then(|curve| curve.last()).map(|last| last.time.elapsed_s / 3600.0);
    let hours = hours.map_or_else(String::new, |hours| format!("| training time | {hours:.1} h |\n"));
    let learning = curve.map_or_else(String::new, |curve| format!("## Learning curve\n\n{}\n", curve_table(&curve)));
    Ok(format!(
        "# {name}\n\n\
         | | |\n|---|---|\n\
         | configuration | `{}` ({} epochs, recovery stage {}) |\n\
         | seed | {} |\n\
         | samples | {}{} |\n\
         {hours}\
         | trained by | Supple {}, MuJoCo {} |\n\
         | SHA-256 | `{}` |\n\n\
         {learning}\
         ## Walking undisturbed\n\n\
         Deterministic, flat ground, 10 s from rest; mean velocity minus command after the first 2 s.\n\n{}",
        provenance.config_name,
        config.ppo.epochs,
        if config.episode.recovery_stage { "on" } else { "off" },
        provenance.seed,
        provenance.samples,
        provenance.mean(),
        provenance.git_revision,
        provenance.mujoco_version,
        policy.sha256(),
        walking_table(&agent)?,
    ))
}

/// Reads the metrics of the iterations up to the policy's samples.
fn read_metrics(path: &Path, samples: u64) -> anyhow::Result<Vec<IterationMetrics>> {
    let file = File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
    let lines = files::lines(BufReader::new(file), MAX_LINE_BYTES).enumerate().map(|(index, line)| {
        let at = || format!("{}, line {}", path.display(), index + 1);
        serde_json::from_str::<IterationMetrics>(&line.with_context(at)?).with_context(at)
    });
    let mut all = lines.collect::<anyhow::Result<Vec<_>>>()?;
    all.retain(|iteration| iteration.samples <= samples);
    anyhow::ensure!(!all.is_empty(), "{} has no iteration", path.display());
    Ok(all)
}

/// Formats the learning curve as a table of means over parts of the run.
fn curve_table(curve: &[IterationMetrics]) -> String {
    let mut text = String::from(
        "| samples | wall-clock | r_lin | falls | falls after a push | pushed | commands open | swing | std | reward |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    for row in 1..=ROWS {
        let stretch = &curve[(row - 1) * curve.len() / ROWS..row * curve.len() / ROWS];
        let Some(last) = stretch.last() else { continue };
        let mean = |of: fn(&IterationMetrics) -> Option<f64>| {
            let values: Vec<f64> = stretch.iter().filter_map(of).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        text.push_str(&format!(
            "| {:.1} M | {:.1} min | {} | {} | {} | {} | {:.0} % | {} | {} | {} |\n",
            last.samples as f64 / 1e6,
            last.time.elapsed_s / 60.0,
            cell(mean(|iteration| iteration.means.walking_linear), 1.0, 3, ""),
            cell(mean(|iteration| iteration.means.fall_rate), 100.0, 1, " %"),
            cell(mean(|iteration| iteration.means.pushed_fall_rate), 100.0, 1, " %"),
            cell(mean(|iteration| iteration.means.push_fraction), 100.0, 0, " %"),
            100.0 * last.command_fraction,
            cell(mean(|iteration| iteration.means.swing_height_m), 1e3, 0, " mm"),
            cell(mean(|iteration| Some(iteration.action_std)), 1.0, 2, ""),
            cell(mean(|iteration| Some(iteration.step_reward)), 1.0, 2, ""),
        ));
    }
    text
}

/// Formats a number times a factor, or a dash if there is none.
fn cell(value: Option<f64>, factor: f64, decimals: usize, unit: &str) -> String {
    value.map_or("–".to_owned(), |value| format!("{:.decimals$}{unit}", factor * value))
}

fn walking_table(agent: &Agent) -> anyhow::Result<String> {
    let base: Walk = defaults("walk")?;
    let mut table = String::from(
        "| command: forward, left, turn | forward error | sideways error | yaw rate error | power | cost of transport | \
         strides | in flight | foot height | fell |\n|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for [forward_m_s, left_m_s, yaw_rad_s] in COMMANDS {
        let task = Task { forward_m_s, left_m_s, yaw_rad_s, ..base.task.clone() };
        let scenario = Scenario::Walk(Walk { task });
        let script = scenario.script(0, &agent.config)?;
        let trace = Playback::new(&script, &agent.config, agent.controller())?.trace();
        let found = scenario.metrics(&script, &trace);
        let number = |name: &str| found.iter().find(|metric| metric.name == name).and_then(|metric| metric.value);
        let cell = |name: &str, factor, decimals, unit| cell(number(name), factor, decimals, unit);
        let fell = match (trace.fall(), trace.fault()) {
            (Some(fall), _) => format!("after {:.1} s", fall.time_s),
            (None, Some(fault)) => format!("fault after {:.1} s: {}", fault.time_s, fault.text),
            (None, None) => "no".to_owned(),
        };
        table.push_str(&format!(
            "| {forward_m_s} m/s, {left_m_s} m/s, {yaw_rad_s} rad/s | {} | {} | {} | {} | {} | {} | {} | {} | {fell} |\n",
            cell("forward_error_m_s", 1.0, 3, " m/s"),
            cell("left_error_m_s", 1.0, 3, " m/s"),
            cell("yaw_error_rad_s", 1.0, 3, " rad/s"),
            cell("power_w", 1.0, 0, " W"),
            cell("cost_of_transport", 1.0, 2, ""),
            cell("stride_frequency_hz", 1.0, 2, " Hz"),
            cell("flight_percent", 1.0, 0, " %"),
            cell("swing_height_m", 1e3, 0, " mm"),
        ));
    }
    Ok(table)
}
