//! Descriptions of policies: what they observe, what their outputs mean, and where they come from.

use std::fmt::Write as _;

use supple::config::Simulation;
use supple::policy::{Agent, Inference, JointPositionAction, Meaning, Policy};
use supple::robot::{JOINTS, Robot, joint_name, joint_names, joint_table};

/// Describes a policy file of Supple.
pub fn description(policy: &Policy) -> String {
    let provenance = &policy.provenance;
    let widths: Vec<String> = std::iter::once(policy.actor.inputs())
        .chain(policy.actor.layers.iter().map(|layer| layer.outputs()))
        .map(|width| width.to_string())
        .collect();
    let mut text = format!(
        "trained   {} samples{}, config {}, seed {}, git {}, MuJoCo {}\n\
         sha256    {}\n\
         network   {}, ELU\n\
         rates     {}\n\
         action    joint target [rad] = nominal pose + {} * output\n\
         \nobservation ({} numbers)\n",
        provenance.samples,
        provenance.mean(),
        provenance.config_name,
        provenance.seed,
        provenance.git_revision,
        provenance.mujoco_version,
        policy.sha256(),
        widths.join(" > "),
        rates(&provenance.config.simulation),
        policy.scale_rad(),
        policy.actor.inputs(),
    );
    let mut start = 0;
    for block in policy.layout().blocks() {
        let elements = block.elements().join(", ");
        let name = block.quantity.to_string().replace('_', " ");
        let name = if elements.is_empty() { name } else { format!("{name}: {elements}") };
        let when: Vec<String> = block.steps_ago.iter().map(|steps| ago(*steps)).collect();
        let (length, unit, when) = (block.length(), block.unit(), when.join(", "));
        text.push_str(&format!("  {start:3} {length:3}  {name:40} {unit:16} {when}\n"));
        start += length;
    }
    let usage = &policy.usage;
    text.push('\n');
    text += &joint_table(policy.nominal_pose(), &usage.joint_limits_rad, &usage.torque_limits_n_m);
    text
}

/// Describes the interpretation of an external policy: every number that it observes, and every joint in the order of its outputs.
pub fn external_description(name: &str, agent: &Agent) -> String {
    let Inference { layout, action, .. } = agent.inference();
    let JointPositionAction { nominal_pose, meaning, scale_rad, clip } = action;
    let offset = match meaning {
        Meaning::OffsetFromNominal => "nominal + ",
        Meaning::JointAngle => "",
    };
    let clipped = if clip.is_finite() { format!(", output clipped to +-{clip}") } else { String::new() };
    let mut text = format!(
        "external  {name}, robot {}\n\
         sha256    {}\n\
         network   {} > {JOINTS}, ONNX\n\
         rates     {}\n\
         action    joint target [rad] = {offset}scale * output{clipped}\n\
         \nobservation ({} numbers), as the network sees it: (value - offset) * scale, clipped to +-limit\n  \
         {:45} {:>10} {:>10} {:>10}\n",
        agent.config.robot.model,
        agent.sha256,
        layout.length(),
        rates(&agent.config.simulation),
        layout.length(),
        "",
        "offset",
        "scale",
        "limit",
    );
    // Writing into a String cannot fail.
    for (k, name) in layout.names().iter().enumerate() {
        let (offset, scale, limit) = (layout.offset()[k], layout.scale()[k], layout.clip()[k]);
        let limit = if limit.is_finite() { limit.to_string() } else { "none".to_owned() };
        let _ = writeln!(text, "  {k:3}  {name:40} {offset:>10} {scale:>10} {limit:>10}");
    }
    let robot = Robot::load(&agent.config.robot.model).ok();
    let _ = writeln!(text, "\noutputs           nominal [rad]  scale [rad]  range [rad]");
    for (index, joint) in layout.order().iter().enumerate() {
        let (name, nominal, scale) = (joint_name(*joint), nominal_pose[*joint], scale_rad[index]);
        let range = robot.as_ref().map_or_else(
            || "unknown: the robot's file cannot be read".to_owned(),
            |robot| {
                let [low, high] = robot.joint_limits[*joint];
                if low.is_finite() || high.is_finite() { format!("{low:+.3} to {high:+.3}") } else { "none".to_owned() }
            },
        );
        let _ = writeln!(text, "  {index:2}  {name:12}{nominal:+.4}        {scale:<11}  {range}");
    }
    let targets = joint_names().join(", ");
    let _ =
        writeln!(text, "\n`policy run` takes the values before they are scaled, and prints joint targets as {targets}");
    text
}

/// Describes an external policy as JSON; numbers are in the order of its observation and of its outputs.
pub fn external_json(name: &str, agent: &Agent) -> serde_json::Value {
    let Inference { layout, action, .. } = agent.inference();
    let limited = |limit: &f64| Some(*limit).filter(|limit| limit.is_finite());
    let order = layout.order();
    serde_json::json!({
        "external": name,
        "sha256": agent.sha256,
        "robot": agent.config.robot,
        "simulation": agent.config.simulation,
        "observation_elements": layout.names(),
        "observation_offset": layout.offset(),
        "observation_scale": layout.scale(),
        "observation_limit": layout.clip().iter().map(limited).collect::<Vec<_>>(),
        "joints": order.map(joint_name),
        "nominal_pose_rad": order.map(|joint| action.nominal_pose[joint]),
        "action": {
            "meaning": action.meaning,
            "scale_rad": action.scale_rad,
            "clip": limited(&action.clip),
        },
    })
}

fn rates(simulation: &Simulation) -> String {
    format!(
        "policy {} Hz, PD law {} Hz with Kp {} N m/rad, Kd {} N m s/rad, target delayed by {} s",
        simulation.policy_rate_hz,
        simulation.physics_rate_hz,
        simulation.kp_n_m_per_rad,
        simulation.kd_n_m_s_per_rad,
        simulation.latency_s,
    )
}

fn ago(steps: u32) -> String {
    match steps {
        0 => "now".into(),
        1 => "one step ago".into(),
        steps => format!("{steps} steps ago"),
    }
}
