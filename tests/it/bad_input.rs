//! What people, disks and other programs put before ours by mistake or malice.

use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::{
    complaint, fails, metrics, program, refused, repository, robot, run, send_signal, success, with_input, with_policy,
    with_small_config,
};

fn trained(folder: &Path, out: &str, more: &[&str]) {
    success(run("train", folder, &[&["--config", "small.yaml", "--samples", "768", "--out", out], more].concat()));
}

#[test]
fn exports_follow_links_and_never_replace_devices() {
    let folder = with_policy();
    let export =
        |out: &str| run("policy", folder.path(), &["export", "p.safetensors", "--format", "onnx", "--out", out]);
    assert!(export("p.onnx").status.success());
    let onnx = std::fs::read(folder.path().join("p.onnx")).unwrap();
    for stdout in ["-", "/dev/stdout"] {
        assert!(export(stdout).stdout == onnx, "{stdout}");
    }
    std::os::unix::fs::symlink("/dev/full", folder.path().join("full.onnx")).unwrap();
    let full = ["export", "p.safetensors", "--format", "onnx", "--out", "full.onnx"];
    fails("policy", folder.path(), &full, "No space left");
    assert!(folder.path().join("full.onnx").is_symlink());
    // Nothing else came to be, not beside a device either.
    let names = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(names, 4, "p.safetensors, p.onnx, p.yaml, full.onnx");
}

#[test]
fn numbers_out_of_range_are_reported_with_their_line() {
    let folder = tempfile::tempdir().unwrap();
    // A network with weights, of which a huge observation overflows.
    let output = run("policy", folder.path(), &["show", "compliant", "--json"]);
    let shown: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let length = shown["usage"]["observation_elements"].as_array().unwrap().len();
    let line = |number: &str| format!("[{}]\n", vec![number; length].join(","));
    let output = with_input("policy", folder.path(), &["run", "compliant"], (line("0") + &line("1e300")).as_bytes());
    assert_eq!(output.status.code(), Some(2));
    assert_eq!(String::from_utf8_lossy(&output.stdout).lines().count(), 1);
    assert!(complaint(&output).contains("line 2: the joint target of FR_hip is"), "{}", complaint(&output));
    for (input, words) in [
        (vec![b'1'; 8 << 20], "line 1: it has more than the 1048576 bytes"),
        (b"[1, 2]\n".to_vec(), "line 1: 2 numbers, expected 83"),
    ] {
        let output = with_input("policy", folder.path(), &["run", "compliant"], &input);
        assert!(output.status.code() == Some(2) && complaint(&output).contains(words), "{}", complaint(&output));
    }
}

#[test]
fn robots_that_exhaust_memory_are_refused() {
    let folder = with_small_config();
    let whole = std::fs::read_to_string(robot("quadruped.xml")).unwrap();
    std::os::unix::fs::symlink(robot("assets"), folder.path().join("assets")).unwrap();
    let with = |before: &str, text: &str| {
        assert!(whole.contains(before), "{before}");
        std::fs::write(folder.path().join("r.xml"), whole.replacen(before, &format!("{text}{before}"), 1)).unwrap();
    };
    let arguments = ["--config", "small.yaml", "--set", "robot.model=r.xml", "--samples", "256", "--out", "x"];
    let fields: String =
        (0..100).map(|k| format!("<hfield name='h{k}' nrow='4096' ncol='4096' size='1 1 1 1'/>")).collect();
    let wide = "<hfield name='h' nrow='2147483647' ncol='2' size='1 1 1 1'/>";
    for (before, text, words) in [
        ("<worldbody", format!("<asset>{wide}</asset>"), "nrow is"),
        // Each within the limits, all of them 6.7 GB.
        ("<worldbody", format!("<asset>{fields}</asset>"), "robot"),
        ("</worldbody", "<geom size='1'/>".repeat(100_000), "elements"),
    ] {
        with(before, &text);
        refused("train", folder.path(), &arguments, words);
    }
    std::fs::write(folder.path().join("r.xml"), "<mujoco><include file='/dev/zero'/></mujoco>").unwrap();
    refused("train", folder.path(), &arguments, "it is a device");
    with("</worldbody", "<body pos='nan 0 0'/>");
    refused("train", folder.path(), &arguments, "pos of <body> is 'nan 0 0', expected finite numbers");
    // What a scene has of its own is not taken from a robot's file.
    let harmless = "<size nuser_body='2147483647' nkey='1000000'/><!-- nrow='2147483647' --><option iterations='2147483647'/>\
                    <sensor><user dim='2147483647'/></sensor>";
    with("<worldbody", harmless);
    success(run("train", folder.path(), &arguments));
}

#[test]
fn a_run_is_one_thing() {
    let folder = with_small_config();
    trained(folder.path(), "run", &[]);
    trained(folder.path(), "other", &["--seed", "1"]);
    let at = |name: &str| folder.path().join(name);
    let text = |name: &str| std::fs::read_to_string(at(name)).unwrap();
    let resume = ["--resume", "run", "--samples", "1024"];
    let (config, lines) = (text("run/config.yaml"), text("run/metrics.jsonl"));
    let endless = ["--resume", "run", "--samples", "9999999999999999"];
    refused("train", folder.path(), &endless, "run.samples is 9999999999999999");

    std::fs::write(at("run/config.yaml"), config.replacen("epochs: 2", "epochs: 3", 1)).unwrap();
    refused("train", folder.path(), &resume, "run/config.yaml was changed after the run began: ppo.epochs: 3 and 2");
    assert!(text("run/config.yaml").contains("epochs: 3"), "the edited file was overwritten");
    // Nor is the faulty edit.
    std::fs::write(at("run/config.yaml"), config.replacen("epochs: 2", "epochs: 2e1", 1)).unwrap();
    refused("train", folder.path(), &resume, "run/config.yaml, line ");
    assert!(text("run/config.yaml").contains("epochs: 2e1"), "the edited file was overwritten");
    std::fs::write(at("run/config.yaml"), &config).unwrap();

    let checkpoint = std::fs::read(at("run/checkpoint.safetensors")).unwrap();
    std::fs::copy(at("other/checkpoint.safetensors"), at("run/checkpoint.safetensors")).unwrap();
    refused("train", folder.path(), &resume, "two runs are mixed: its checkpoint is of seed 1, run.json of seed 0");
    std::fs::write(at("run/checkpoint.safetensors"), &checkpoint).unwrap();

    std::fs::copy(at("other/metrics.jsonl"), at("run/metrics.jsonl")).unwrap();
    refused("train", folder.path(), &resume, "two runs are mixed: after iteration 3");
    let cut: String = lines.lines().enumerate().filter(|(k, _)| *k != 1).map(|(_, line)| format!("{line}\n")).collect();
    std::fs::write(at("run/metrics.jsonl"), cut + "{\"iter").unwrap();

    // The length of the run may be changed; other changes are reported.
    std::fs::write(at("run/config.yaml"), config.replacen("samples: 768", "samples: 1280", 1)).unwrap();
    let output = run("train", folder.path(), &["--resume", "run"]);
    let words = complaint(&output);
    assert!(output.status.success(), "{words}");
    assert!(words.contains("lacks iterations 2 of 3") && words.contains("run.samples is 1280"), "{words}");
    let iterations: Vec<u64> = metrics(&at("run")).iter().map(|line| line["iteration"].as_u64().unwrap()).collect();
    assert_eq!(iterations, [1, 3, 4, 5]);
}

#[test]
fn paths_that_are_not_utf8_are_refused() {
    let odd = OsStr::from_bytes(b"caf\xe9.yaml");
    for (name, arguments) in [("train", &["--config"][..]), ("policy", &["show"]), ("policy", &["card"])] {
        let output = Command::new(program(name)).args(arguments).arg(odd).output().unwrap();
        assert_eq!(output.status.code(), Some(2));
        assert!(complaint(&output).contains("UTF-8"), "{}", complaint(&output));
    }
}

#[test]
fn sizes_that_nobody_meant_are_refused_before_they_are_taken() {
    let folder = with_small_config();
    let set = |changes: &[&str], words: &str| {
        let mut arguments = vec!["--config", "small.yaml", "--out", "x"];
        arguments.extend(changes.iter().flat_map(|change| ["--set", change]));
        refused("train", folder.path(), &arguments, words);
    };
    set(&["ppo.environments=1048576", "ppo.batch_size=1048576"], "GiB of memory");
    set(&["ppo.epochs=4.5"], "config --set ppo.epochs=4.5: ppo.epochs: invalid type: floating point `4.5`");
    set(&["ppo=4"], "expected keys with values");
    set(&["randomisation.enabled=true", "randomisation.trunk_mass_kg=6"], "kg of the robot's trunk");
    set(&[&format!("ppo.hidden_layers=[{}]", vec!["4096"; 101].join(","))], "1 to 16 widths");
    assert!(!folder.path().join("x").exists());
}

#[test]
fn ctrl_c_while_a_run_is_set_up_stops_it() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe.yaml");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let mut train = Command::new(program("train"));
    train.args(["--config", "pipe.yaml", "--out", "x"]).current_dir(folder.path()).stderr(Stdio::piped());
    let child = train.spawn().unwrap();
    // Open as soon as `train` opens it, which waits then for the configuration.
    let _writer = std::fs::File::options().write(true).open(pipe).unwrap();
    send_signal("-INT", child.id());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130));
    assert!(complaint(&output).contains("stopped before training began") && !folder.path().join("x").exists());
}

#[test]
fn errors_name_file_line_and_key_once() {
    let folder = with_small_config();
    let write = |name: &str, text: &[u8]| std::fs::write(folder.path().join(name), text).unwrap();
    write("float.yaml", b"base: small.yaml\nrun:\n  samples: 2e7\n");
    write("utf16.yaml", b"\xff\xfeb\0a\0s\0e\0");
    write("escape.yaml", "base: \"\\e[31mred\"\n".as_bytes());
    write("robot.yaml", b"base: small.yaml\nrobot: {model: nowhere/robot.xml}\n");
    write("negative.yaml", b"base: small.yaml\nepisode: {walking_s: -0.3}\n");
    // What it is, and not that there is no policy of this name.
    refused("policy", folder.path(), &["show", "/dev/zero"], "policy /dev/zero: it is a device");
    for (name, words) in [
        (
            "float.yaml",
            "config float.yaml, line 3: run.samples: invalid type: floating point `20000000.0`, expected a whole number",
        ),
        ("utf16.yaml", "not text in UTF-8"),
        ("escape.yaml", "\\u001b[31mred"),
        ("/dev/zero", "it is a device"),
        ("nowhere.yaml", "nowhere.yaml"),
        ("robot.yaml", "nowhere/robot.xml"),
        ("negative.yaml", "episode.walking_s is -0.3, expected at least one policy step"),
    ] {
        let complaint = refused("train", folder.path(), &["--config", name, "--out", "x"], words);
        assert!(!complaint.contains('\u{1b}'));
        assert!(!folder.path().join("x").exists(), "{name} left a folder");
    }
    write("marked.yaml", "\u{feff}base: small.yaml\n".as_bytes());
    trained(folder.path(), "run", &[]);
    success(run("train", folder.path(), &["--config", "marked.yaml", "--samples", "256", "--out", "marked"]));

    std::fs::create_dir(folder.path().join("empty")).unwrap();
    let start = ["--config", "small.yaml", "--out"];
    let words = "empty exists already and is not a training run";
    let taken = refused("train", folder.path(), &[&start[..], &["empty"]].concat(), words);
    assert!(!taken.contains("--resume"), "{taken}");
    let none = refused("train", folder.path(), &["--resume", "empty"], "empty is not a run's folder");
    assert!(!none.contains("--out"), "{none}");
    refused("train", folder.path(), &["--resume", "nowhere"], "nowhere is not a run's folder");
    refused("train", folder.path(), &[&start[..], &["run"]].concat(), "continue it with --resume run");
}

#[test]
fn shipped_policies_are_listed_and_have_cards_in_any_folder() {
    let folder = tempfile::tempdir().unwrap();
    let listed = run("policy", folder.path(), &["list"]);
    let text = String::from_utf8_lossy(&listed.stdout);
    assert!(text.lines().any(|line| line.starts_with("compliant-seed0 ")) && text.contains("go2/compliant-seed0"));
    let card = run("policy", folder.path(), &["card", "compliant-seed0"]);
    let text = String::from_utf8_lossy(&card.stdout);
    assert!(text.starts_with("# compliant-seed0\n") && text.contains("## Walking undisturbed"), "{text}");
    let shipped = std::fs::read_to_string(repository("policies/compliant-seed0.md")).unwrap();
    let hash = shipped.lines().find(|line| line.contains("SHA-256")).unwrap();
    assert!(text.contains(hash) && !text.contains("Learning curve"));
}
