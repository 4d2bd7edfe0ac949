//! Measurement of a session saved by `drive`.

use std::path::Path;

use serde_json::json;
use supple::provenance::{git_revision, mujoco_version};
use supple::scenario::session::{SavedSession, Take, takes};

use crate::args::Args;
use crate::output::{self, Outcome};

/// Replays a session and prints its metrics.
pub fn measure(args: &Args, file: &Path) -> anyhow::Result<()> {
    output::check(args)?;
    let asked = [args.policy.is_some(), args.compare.is_some(), args.model.is_some(), args.params.is_some()];
    let problem = "a session has its own policies and robots: measure it without naming others";
    anyhow::ensure!(!asked.contains(&true), problem);
    let drawn = [&args.record, &args.on_fall, &args.video].map(Option::is_some).contains(&true)
        || args.connect.is_some()
        || args.serve.is_some();
    anyhow::ensure!(!drawn, "record a session with `drive --replay {} --record FILE`", file.display());

    let mut playback = SavedSession::load(file)?.play()?;
    let takes = takes(&mut playback)?;
    let names: Vec<String> = takes.iter().map(name).collect();
    let outcomes: Vec<Outcome<'_>> = takes.iter().zip(&names).map(|(take, name)| outcome(take, name)).collect();
    output::tell(args, "session", &outcomes, || {
        let run = |(take, outcome): (&Take, &Outcome<'_>)| {
            let mut run = output::run(outcome);
            run["policy"] = json!(take.seat.policy);
            run["scene"] = json!(take.scene);
            run["seed"] = json!(take.seed);
            run["compliance"] = json!(take.seat.compliance);
            run["pushes"] = json!(take.pushes);
            run["pulls"] = json!(take.pulls);
            run
        };
        let runs: Vec<_> = takes.iter().zip(&outcomes).map(run).collect();
        json!({ "scenario": "session", "revision": git_revision(), "mujoco": mujoco_version(), "units": output::units(&outcomes), "runs": runs })
    })?;
    playback.verify().unwrap_or(Ok(())).map_err(anyhow::Error::msg)
}

fn name(take: &Take) -> String {
    let Take { seat, scene, .. } = take;
    let compliance = seat.compliance.map(|compliance| format!("@{compliance}")).unwrap_or_default();
    format!("{}{compliance} {}", seat.label(), scene.name())
}

fn outcome<'a>(take: &'a Take, name: &'a str) -> Outcome<'a> {
    let Take { seat, trace, .. } = take;
    Outcome { policy: name, sha256: seat.sha256.clone(), robot: &seat.robot, trace, metrics: take.metrics() }
}
