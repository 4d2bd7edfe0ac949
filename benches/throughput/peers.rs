/*! What Supple is measured against: PyTorch's update and Stable-Baselines3's whole iteration, in the same run.

`benches/peers/setup` installs them under `target/peers`; without that there is nothing to compare with, and that is
fine. The peers get the configuration as JSON and the scene as the MJCF that MuJoCo gets from us, in `target/peers/input`,
and answer with one JSON object on their last line. A peer that fails is reported and left out; a quick run leaves out
both.
*/

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use serde::Serialize;
use serde_json::Value;
use supple::config::Config;
use supple::robot::Robot;
use supple::sim::Scene;

use crate::stopwatch::Effort;

/// The rates that the peers' scripts report.
#[derive(Debug, Serialize)]
pub struct Peers {
    /// `benches/peers/torch_update.py`
    pub torch_update: Option<Value>,
    /// `benches/peers/sb3.py`
    pub sb3: Option<Value>,
    /// The same on our environment, by the Python package.
    pub sb3_on_supple: Option<Value>,
}

/// Runs the peers if they are installed.
pub fn measure(config: &Config, threads: usize, effort: &Effort) -> anyhow::Result<Option<Peers>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let installed = root.join("target/peers");
    if !installed.join("ready").exists() {
        return Ok(None);
    }
    let folder = installed.join("input");
    std::fs::create_dir_all(&folder)?;
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).context(name.to_owned());
    let layout = config.layout()?;
    let mut told = serde_json::to_value(config)?;
    told["normaliser"] = serde_json::json!({ "offset": layout.offset(), "scale": layout.scale() });
    write("config.json", &told.to_string())?;
    let scene = Scene::flat(Robot::load("go1")?, config.simulation.timestep_s());
    write("scene.xml", &scene.xml(true))?;
    write("robot.xml", scene.robot.mjcf())?;
    if effort.quick {
        return Ok(None);
    }
    let runner = Runner { root, python: installed.join("bin/python"), folder: &folder, threads, effort };
    Ok(Some(Peers {
        torch_update: runner.run("torch_update.py", &[]),
        sb3: runner.run("sb3.py", &[]),
        sb3_on_supple: runner.run("sb3.py", &["--environment", "supple"]),
    }))
}

struct Runner<'a> {
    root: &'a Path,
    python: PathBuf,
    folder: &'a Path,
    threads: usize,
    effort: &'a Effort,
}

impl Runner<'_> {
    fn run(&self, script: &str, options: &[&str]) -> Option<Value> {
        eprintln!("{script} {} …", options.join(" "));
        self.try_run(script, options).inspect_err(|error| eprintln!("warning: {script} is left out: {error:#}")).ok()
    }

    fn try_run(&self, script: &str, options: &[&str]) -> anyhow::Result<Value> {
        let output = Command::new(&self.python)
            .arg(self.root.join("benches/peers").join(script))
            .arg(self.folder)
            .args(options)
            .args(["--threads", &self.threads.to_string()])
            .args(["--epochs", &self.effort.epochs.to_string()])
            .args(["--repetitions", &self.effort.repetitions.to_string()])
            .stderr(Stdio::inherit())
            .output()?;
        if !output.status.success() {
            bail!("it ended with {}", output.status);
        }
        let text = String::from_utf8(output.stdout)?;
        let last = text.lines().last().context("it printed nothing")?;
        Ok(serde_json::from_str(last)?)
    }
}
