/*! PyTorch's update and Stable-Baselines3's whole iteration, in the same run, if `benches/peers/setup` has installed them.

The peers get the configuration as JSON and the scene as the MJCF that MuJoCo gets from us, in `target/peers/input`, and
answer with one JSON object on their last line. A peer that fails is reported and left out.
*/

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, ensure};
use serde_json::{Value, json};
use supple::config::Config;
use supple::robot::Robot;
use supple::sim::Scene;

use crate::{Effort, Figures};

/// Name, script, its options, the figure that is compared, and the name of ours over that of the peer.
const PEERS: [(&str, &str, &[&str], &str, &str); 3] = [
    ("torch", "torch_update.py", &[], "sample_passes_per_s", "update_over_torch"),
    ("sb3", "sb3.py", &[], "samples_per_s", "end_to_end_over_sb3"),
    ("sb3_on_supple", "sb3.py", &["--environment", "supple"], "samples_per_s", "end_to_end_over_sb3_on_supple"),
];

pub fn measure(config: &Config, threads: usize, effort: &Effort, figures: &mut Figures) -> anyhow::Result<()> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let installed = root.join("target/peers");
    if !installed.join("ready").exists() {
        return Ok(());
    }
    let folder = installed.join("input");
    std::fs::create_dir_all(&folder)?;
    let layout = config.layout()?;
    let mut told = serde_json::to_value(config)?;
    told["normaliser"] = json!({ "offset": layout.offset(), "scale": layout.scale() });
    let scene = Scene::flat(Robot::load("go1")?, config.simulation.timestep_s());
    std::fs::write(folder.join("config.json"), told.to_string())?;
    std::fs::write(folder.join("scene.xml"), scene.xml(true))?;
    std::fs::write(folder.join("robot.xml"), scene.robot.mjcf())?;
    let ask = |script: &str, options: &[&str]| -> anyhow::Result<Value> {
        let mut peer = Command::new(installed.join("bin/python"));
        peer.arg(root.join("benches/peers").join(script)).arg(&folder).args(options);
        for (flag, number) in [("threads", threads), ("epochs", effort.epochs), ("repetitions", effort.repetitions)] {
            peer.args([format!("--{flag}"), number.to_string()]);
        }
        let output = peer.stderr(Stdio::inherit()).output()?;
        ensure!(output.status.success(), "it ended with {}", output.status);
        let text = String::from_utf8(output.stdout)?;
        Ok(serde_json::from_str(text.lines().last().context("it printed nothing")?)?)
    };
    for (name, script, options, figure, ratio) in PEERS {
        let answer = match ask(script, options) {
            Ok(answer) => answer,
            Err(error) => {
                eprintln!("warning: {name} is left out: {error:#}");
                continue;
            }
        };
        for key in ["sample_passes_per_s", "samples_per_s", "rollout_s", "update_s"] {
            if let Some(value) = answer[key].as_f64() {
                figures.note(format!("{name}_{key}"), [value]);
            }
        }
        figures.note(ratio, [figures.get(figure) / figures.get(&format!("{name}_{figure}"))]);
    }
    Ok(())
}
