//! Tests of the program `scenario` as users run it.

#[path = "../../tests/it/support.rs"]
mod support;

use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::{Value, json};
use supple::scenario::session::{Act, AgentCache, Input, LiveSession, PushUnit, SceneKind, Setup, Writer};
use support::{complaint, example, fails, program, robot, run, standing_policy, success, with_policy};

/// Plays a scenario in a folder, and returns its one JSON object.
fn play(folder: &Path, arguments: &[&str]) -> Value {
    let output = success(run("scenario", folder, &[arguments, &["--json"]].concat()));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn a_closed_pipe_is_neither_a_panic_nor_an_error() {
    let folder = with_policy();
    let scenario: &[&str] = &["walk", "--policy", "p.safetensors", "--duration-s", "0.2", "--no-record", "--json"];
    for arguments in [scenario, &["list"]] {
        let mut command = Command::new(program("scenario"));
        command.args(arguments).current_dir(folder.path()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{arguments:?}: {}", complaint(&output));
        assert_eq!(complaint(&output), "", "{arguments:?}");
    }
}

#[test]
fn a_standard_output_that_is_full_is_an_error() {
    let Ok(full) = std::fs::File::options().write(true).open("/dev/full") else { return };
    let child = Command::new(program("scenario")).arg("list").stdout(full).stderr(Stdio::piped()).spawn();
    let output = child.unwrap().wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(complaint(&output).starts_with("error: cannot write to standard output: No space left"));
}

#[test]
fn recording_or_not_and_the_same_seed_twice_give_the_same_bits() {
    let folder = with_policy();
    let play = |csv: &str, recording: &[&str]| {
        let line = ["push", "--policy", "p.safetensors", "--duration-s", "2", "--at-s", "0.5", "--json", "--csv", csv];
        let output = success(run("scenario", folder.path(), &[&line[..], recording].concat()));
        (output.stdout, std::fs::read(folder.path().join(csv)).unwrap())
    };
    let plain = play("a.csv", &["--no-record"]);
    let columns: Vec<usize> = String::from_utf8_lossy(&plain.1).lines().map(|row| row.split(',').count()).collect();
    assert_eq!(columns, [columns[0]; 121]);
    assert_eq!(plain, play("b.csv", &["--no-record"]));
    assert_eq!(plain, play("c.csv", &["--record", "c.rrd"]));
    assert!(folder.path().join("c.rrd").exists());
}

/// Plays a session and saves it in a file.
fn keep(inputs: &[(u64, Input)], until: u64, path: &Path) {
    let mut shelf = AgentCache::default();
    let robots = vec![shelf.find("baseline", None).unwrap()];
    let setup = Setup { scene: SceneKind::Flat, seed: 0, robots };
    let mut world = LiveSession::new(setup.clone(), &mut shelf).unwrap();
    let mut writer = Writer::new(tempfile::tempfile().unwrap());
    writer.input(0, &Input::Setup(setup), &shelf).unwrap();
    let mut inputs = inputs.iter().peekable();
    while world.tick() < until {
        while let Some((tick, input)) = inputs.next_if(|(tick, _)| *tick <= world.tick()) {
            writer.input(*tick, input, &shelf).unwrap();
            world.apply(input, &mut shelf).unwrap();
        }
        world.step().unwrap();
    }
    writer.part(None, until, world.fingerprint()).unwrap().write_new(path).unwrap();
}

#[test]
fn a_session_is_measured_before_and_after_its_robot_is_told_to_yield() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kept.jsonl");
    let inputs = [
        (240, Input::Act(Act::Push { size: [0.0, 0.5], unit: PushUnit::Velocity })),
        (1440, Input::Act(Act::Comply { robot: 0, compliance: Some(0.03) })),
        (1680, Input::Act(Act::Hand(Some([0.0, 10.0])))),
        (1920, Input::Act(Act::Hand(None))),
    ];
    keep(&inputs, 2160, &path);
    let measured = play(folder.path(), &["session", "kept.jsonl"]);
    let of = |name: &str| [0, 1].map(|run| measured["runs"][run]["metrics"][name].clone());
    assert_eq!(measured["runs"].as_array().unwrap().len(), 2);
    assert_eq!([0, 1].map(|run| measured["runs"][run]["compliance"].clone()), [json!(null), json!(0.03)]);
    assert_eq!((of("duration_s"), of("pushes")), ([json!(6.0), json!(3.0)], [json!(1.0), json!(0.0)]));
    assert_eq!((of("push_m_s"), of("pull_n")), ([json!(0.5), Value::Null], [Value::Null, json!(10.0)]));

    // Changed by hand, it ends elsewhere.
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("[0.0,0.5]", "[0.0,0.6]")).unwrap();
    for (arguments, words) in [
        (&["session", "kept.jsonl"][..], "the final state differs from the original"),
        (&["--policy", "baseline", "session", "kept.jsonl"], "its own policies"),
    ] {
        let told = complaint(&run("scenario", folder.path(), arguments));
        assert!(told.contains(words), "{told}");
    }
}

#[test]
fn scenario_prints_one_json_object_and_nothing_else() {
    let folder = with_policy();
    let arguments = ["push", "--policy", "p.safetensors", "--push-m-s", "0.1", "--csv", "t.csv"];
    let object = play(folder.path(), &arguments);
    assert_eq!(object["scenario"], "push");
    assert_eq!(object["parameters"]["push_m_s"], 0.1);
    assert!(object["runs"][0]["metrics"]["decay_10_s"].is_number(), "{object}");
    assert_eq!(std::fs::read_to_string(folder.path().join("t.csv")).unwrap().lines().count(), 1 + 480);
    assert!(folder.path().join("push.rrd").exists());
}

#[test]
fn scenario_tells_how_good_the_estimates_of_a_robot_on_sensors_are() {
    let folder = with_policy();
    let walk = ["walk", "--policy", "p.safetensors", "--duration-s", "1", "--no-record", "--csv", "t.csv", "--sensing"];
    // The result, and two cells of the last row of the CSV.
    let play = |sensing: &str| {
        let object = play(folder.path(), &[&walk[..], &[sensing]].concat());
        let text = std::fs::read_to_string(folder.path().join("t.csv")).unwrap();
        let rows: Vec<Vec<&str>> = text.lines().map(|row| row.split(',').collect()).collect();
        let last = &rows[rows.len() - 1];
        assert_eq!(last.len(), rows[0].len());
        let cell = |name: &str| last[rows[0].iter().position(|found| *found == name).unwrap()].to_owned();
        (object, ["height_m", "estimated_height_m"].map(cell))
    };
    let ((truth, true_heights), (estimated, heights)) = (play("true"), play("estimated"));
    assert_eq!((&truth["sensing"], &estimated["sensing"]), (&"true".into(), &"estimated".into()));
    assert_eq!(truth["runs"][0]["metrics"]["contact_f1"], Value::Null);
    for name in ["estimate_velocity_rmse_m_s", "estimate_height_rmse_m", "estimate_drift_m", "contact_f1"] {
        assert!(estimated["runs"][0]["metrics"][name].is_number(), "{name}: {estimated}");
    }
    // The estimates stand beside the truth in the CSV, which has none without sensors.
    let heights = heights.map(|cell| cell.parse::<f64>().unwrap());
    assert!(heights[0] != heights[1] && (heights[0] - heights[1]).abs() < 0.01, "{heights:?}");
    assert_eq!(true_heights[1], "");
    // The estimate of a standing robot has a small error.
    assert!(estimated["runs"][0]["metrics"]["estimate_velocity_rmse_m_s"].as_f64().unwrap() < 0.05);
}

#[test]
fn a_policy_that_is_told_how_far_to_yield_does() {
    let folder = tempfile::tempdir().unwrap();
    let line = ["leash", "--policy", "baseline", "--force-n", "12", "--duration-s", "8", "--no-record"];
    for compliance in ["0.008", "0.03"] {
        let json = play(folder.path(), &[&line[..], &["--compliance", compliance]].concat());
        let found = json["runs"][0]["metrics"]["leash_offset_m_s"].as_f64().unwrap();
        // To a side, a policy may be off by some hundredths undisturbed.
        let expected = 12.0 * compliance.parse::<f64>().unwrap();
        assert!((found - expected).abs() < 0.05, "{compliance}: {found} instead of {expected}");
    }
}

#[test]
fn scenario_refuses_bad_input_with_exit_code_2() {
    let (folder, bytes) = (with_policy(), standing_policy().to_bytes().unwrap());
    std::fs::write(folder.path().join("cut.safetensors"), &bytes[..bytes.len() / 2]).unwrap();
    std::fs::write(folder.path().join("odd.yaml"), "push_m_ss: 1\n").unwrap();
    std::fs::write(folder.path().join("hard.yaml"), "push_m_s: 30\n").unwrap();
    let cases: [(&[&str], &str); 12] = [
        (&["push", "--policy", "nobody"], "there is no policy 'nobody'"),
        (&["push", "--policy", "cut.safetensors"], "was it cut off"),
        (&["push", "--policy", "p.safetensors", "--push-m-s", "-1"], "--push-m-s is -1, expected 0 to 20 m/s"),
        (&["box", "--policy", "p.safetensors", "--mass-kg", "0"], "--mass-kg is 0, expected 0.001"),
        (&["push", "--policy", "p.safetensors", "--params", "odd.yaml"], "no parameter 'push_m_ss'"),
        (
            &["push", "--policy", "p.safetensors", "--params", "hard.yaml"],
            "with the parameters of hard.yaml: --push-m-s is 30, expected 0 to 20 m/s",
        ),
        (&["walk", "--policy", "p.safetensors", "--duration-s", "NaN"], "--duration-s is NaN"),
        (&["walk", "--policy", "p.safetensors", "--compliance", "0.02"], "run `policy calibrate`"),
        (&["walk", "--policy", "baseline", "--compliance", "0.5"], "baseline: compliance 0.5"),
        (&["walk", "--policy", "compliant", "--compare", "baseline@0.5"], "baseline@0.5: compliance 0.5"),
        (&["walk", "--policy", "baseline@-1"], "baseline@-1: compliance -1"),
        (&["terrain", "--policy", "p.safetensors", "--duration-s", "100"], "--duration-s is 100, expected a way"),
    ];
    for (arguments, expected) in cases {
        fails("scenario", folder.path(), arguments, expected);
    }
}

#[test]
fn rsl_rl_and_playground_examples_are_played() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["rsl_rl", "playground"] {
        example(folder.path(), name);
        let policy = format!("{name}.yaml");
        let object = play(folder.path(), &["push", "--policy", &policy, "--duration-s", "1", "--no-record"]);
        assert_eq!(object["runs"][0]["policy"], name);
        assert_eq!(object["runs"][0]["sha256"].as_str().unwrap().len(), 64);
    }
}

#[test]
fn unfit_policies_and_robots_are_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(example(folder.path(), "rsl_rl")).unwrap();
    let write = |name: &str, from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        std::fs::write(folder.path().join(name), text.replacen(from, to, 1)).unwrap();
    };
    write("short.yaml", "  - {quantity: last_action}\n", "");
    write("joint.yaml", "FL_hip,", "tail,");
    write("twice.yaml", "FL_hip,", "FL_thigh,");
    write("key.yaml", "observation_clip:", "observation_klip:");
    write("fast.yaml", "physics_rate_hz: 200", "physics_rate_hz: 4000000000");
    write("axis.yaml", "{quantity: projected_gravity}", "{quantity: projected_gravity, elements: [up, yaw]}");
    write("scale.yaml", "scale: [2.0, 2.0, 0.25]", "scale: [2.0, 2.0]");
    write("old.yaml", "{quantity: projected_gravity}", "{quantity: projected_gravity, steps_ago: 4000000000}");
    write("gone.yaml", "rsl_rl.onnx", "gone.onnx");
    write("cut.yaml", "rsl_rl.onnx", "cut.onnx");
    let network = std::fs::read(folder.path().join("rsl_rl.onnx")).unwrap();
    std::fs::write(folder.path().join("cut.onnx"), &network[..network.len() / 2]).unwrap();
    let bomb: String = (1..40).map(|k| format!("a{k}: &a{k} [*a{j}, *a{j}, *a{j}]\n", j = k - 1)).collect();
    std::fs::write(folder.path().join("bomb.yaml"), format!("a0: &a0 [1, 1, 1]\n{bomb}")).unwrap();
    // Its keyframe would no longer have the right length.
    let xml = std::fs::read_to_string(robot("quadruped.xml")).unwrap();
    let (before, after) = (xml.find("<keyframe>").unwrap(), xml.find("</keyframe>").unwrap() + "</keyframe>".len());
    let xml = format!("{}{}", &xml[..before], &xml[after..]);
    let assets = robot("assets").display().to_string();
    let model = |name: &str, from: &str, to: &str| {
        assert!(xml.contains(from), "{from}");
        let changed = xml.replace("meshdir=\"assets\"", &format!("meshdir=\"{assets}\"")).replace(from, to);
        std::fs::write(folder.path().join(name), changed).unwrap();
    };
    model("fixed.xml", "<freejoint/>", "");
    model("loop.xml", "<mujoco model=\"quadruped\">", "<mujoco><include file=\"loop.xml\"/>");
    model("broken.xml", "</default>", "");
    standing_policy().save(&folder.path().join("ours.safetensors")).unwrap();

    let cases: [(&[&str], &str); 17] = [
        (&["--policy", "rsl_rl.onnx"], "describe it in a YAML file"),
        (&["--policy", "short.yaml"], "its observation has 36 numbers (base_velocity 3,"),
        (&["--policy", "short.yaml"], "but the input 'obs' of rsl_rl.onnx takes 48"),
        (&["--policy", "joint.yaml"], "`joints` has 'tail', which is no joint of the robot"),
        (&["--policy", "twice.yaml"], "must name each of these once"),
        (&["--policy", "key.yaml"], "unknown field `observation_klip`"),
        (&["--policy", "fast.yaml"], "up to 20000"),
        (&["--policy", "axis.yaml"], "entry 3 (projected_gravity): `elements` has 'yaw'"),
        (&["--policy", "scale.yaml"], "`scale` has 2 numbers, expected one, or 3"),
        (&["--policy", "old.yaml"], "ages from 0 to 200 policy steps"),
        (&["--policy", "gone.yaml"], "gone.onnx: No such file"),
        (&["--policy", "cut.yaml"], "cut.onnx: it is cut off or not ONNX"),
        (&["--policy", "bomb.yaml"], "repetition limit exceeded"),
        (&["--policy", "ours.safetensors", "--model", "fixed.xml"], "its trunk is fixed to the world"),
        (&["--policy", "ours.safetensors", "--model", "loop.xml"], "does one include itself?"),
        (&["--policy", "ours.safetensors", "--model", "broken.xml"], "is not XML"),
        (&["--policy", "ours.safetensors", "--model", "none.xml"], "none.xml: there is no such file"),
    ];
    for (arguments, expected) in cases {
        let complaint = fails("scenario", folder.path(), &[&["walk", "--no-record"], arguments].concat(), expected);
        let lines = complaint.lines().filter(|line| !line.ends_with(".xml:")).count();
        assert_eq!(lines, 1, "{complaint}");
    }
}

#[test]
fn numbers_end_with_the_fall_and_what_is_undefined_has_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let play = |more: &[&str]| {
        play(folder.path(), &[&["push", "--policy", "compliant", "--no-record"], more].concat())["runs"][0].clone()
    };
    let fallen = play(&["--push-m-s", "6"]);
    let (metrics, undefined) = (&fallen["metrics"], &fallen["undefined"]);
    assert_eq!(metrics["fell"], Value::Bool(true));
    let [simulated, fell, window] =
        ["duration_s", "fall_time_s", "window_s"].map(|name| metrics[name].as_f64().unwrap());
    assert!((simulated - fell - 1.0).abs() < 1e-9 && (window - 0.5 * fell).abs() < 0.02, "{metrics}");
    // On its back it would be in flight half of the time.
    assert!(metrics["flight_percent"].as_f64().unwrap() < 15.0, "{metrics}");
    assert_eq!((&metrics["power_after_w"], undefined["power_after_w"].as_str()), (&Value::Null, Some("it fell")));
    assert_eq!(metrics["push_time_s"], fallen["events"][0]["time_s"]);

    let late = play(&["--at-s", "30"]);
    assert_eq!(late["metrics"]["push_time_s"], Value::Null);
    assert_eq!(late["undefined"]["push_time_s"], "it was not pushed");
    assert_eq!(late["metrics"]["fell"], Value::Bool(false));
}

#[test]
fn seeds_give_means_and_spread_of_the_numbers_that_each_gives_alone() {
    let folder = tempfile::tempdir().unwrap();
    let play = |more: &[&str]| {
        let base = ["push", "--policy", "compliant", "--duration-s", "4"];
        play(folder.path(), &[&base, more].concat())["runs"][0]["metrics"].clone()
    };
    let all = play(&["--seeds", "3..4"]);
    let alone = ["3", "4"].map(|seed| play(&["--no-record", "--seed", seed])["push_time_s"].as_f64().unwrap());
    let [low, high] = alone;
    let found = |name: &str| all["push_time_s"][name].as_f64().unwrap();
    assert!((found("mean") - 0.5 * (low + high)).abs() < 1e-12);
    assert!((found("standard_deviation") - (high - low).abs() / 2.0_f64.sqrt()).abs() < 1e-12);
    assert_eq!(found("count"), 2.0);
    assert_eq!(all["fell"]["of_seeds"], serde_json::json!([false, false]));
    assert_eq!(all["fall_time_s"]["undefined"], serde_json::json!(["it did not fall", "it did not fall"]));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "a recording of one of them was written");
    let output = run("scenario", folder.path(), &["walk", "--seeds", "9..0"]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn seeds_that_draw_nothing_are_one_trial() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["leash", "--policy", "compliant", "--duration-s", "1", "--seeds", "3..5", "--json"];
    let output = run("scenario", folder.path(), &arguments);
    assert!(complaint(&output).contains("the seed changes nothing in leash"), "{}", complaint(&output));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["seeds"], serde_json::json!([3, 3]));
    let power = &found["runs"][0]["metrics"]["power_w"];
    assert_eq!((&power["count"], &power["standard_deviation"]), (&1.into(), &Value::Null));
}

#[test]
fn recording_with_another_ending_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["walk", "--policy", "compliant", "--record", "walk.mp4"];
    assert!(fails("scenario", folder.path(), &arguments, "walk.mp4").contains("walk.rrd"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn csv_is_whole_or_absent_on_a_full_disk() {
    let folder = tempfile::tempdir().unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../policies/compliant-seed0.safetensors");
    std::fs::copy(shipped, folder.path().join("a,b.safetensors")).unwrap();
    let base = ["walk", "--policy", "a,b.safetensors", "--duration-s", "1", "--no-record"];
    let output = run("scenario", folder.path(), &[&base[..], &["--csv", "-"]].concat());
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.starts_with("policy,time_s") && text.lines().count() == 61, "{text}");
    assert!(text.lines().skip(1).all(|row| row.starts_with("\"a,b\",")), "{text}");
    std::os::unix::fs::symlink("/dev/full", folder.path().join("full.csv")).unwrap();
    let output = run("scenario", folder.path(), &[&base[..], &["--csv", "full.csv"]].concat());
    assert!(complaint(&output).contains("cannot write full.csv: No space left"), "{}", complaint(&output));
    assert!(folder.path().join("full.csv").is_symlink());
}
