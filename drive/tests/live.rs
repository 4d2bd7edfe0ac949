//! Tests of `drive` through its sockets, without a browser.

mod common;

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};

use common::{Drive, PATIENCE, replay, start, text};
use serde_json::{Value, json};
use tungstenite::Message;

/// The last line of a replay with the same bits.
const SAME: &str = "the final state matches the original bit for bit";

#[test]
fn robots_stop_when_driver_falls_silent_or_leaves() {
    let (_folder, drive, mut page) = start(&[]);
    page.ask_for([0.5, 0.0, 0.0], Duration::from_secs(2));
    for robot in [0, 1] {
        let forward = page.number(&format!("/robots/{robot}/reading/velocity/0"));
        assert!((0.25..0.75).contains(&forward), "{}", page.state);
        assert!(page.number(&format!("/robots/{robot}/position/0")) > 0.2, "{}", page.state);
    }
    // The page is connected, but silent.
    let silent = Instant::now();
    page.wait_for("a command of zero", &[("/robots/0/reading/command", json!([0.0, 0.0, 0.0]))]);
    assert!(silent.elapsed() < Duration::from_millis(500), "{:?}", silent.elapsed());

    // The page disconnects while it pulls and drives.
    let mut watcher = drive.page();
    page.send(&json!({ "command": [0.5, 0.0, 0.0] }));
    page.send(&json!({ "pull": [0.0, 20.0] }));
    let pull = |state: &Value| state["robots"][0]["reading"]["pull"]["force_n"].as_f64();
    watcher.wait("a pull of 20 N", |state, _| (pull(state) == Some(20.0)).then_some(()));
    drop(page);
    let gone = Instant::now();
    watcher.wait("the end of the pull", |state, _| (pull(state).is_none() && state["driver"].is_null()).then_some(()));
    assert!(gone.elapsed() < Duration::from_millis(500), "{:?}", gone.elapsed());
    assert_eq!(watcher.state["robots"][0]["reading"]["command"], json!([0.0, 0.0, 0.0]));
}

#[test]
fn push_has_its_size_and_moves_robots_differently() {
    let (_folder, _drive, mut page) = start(&[]);
    page.wait("the robots to stand", |state, _| (state["tick"].as_u64()? > 240).then_some(()));
    page.send(&json!({ "push": { "size": [0.0, 0.8], "unit": "m/s" } }));
    page.wait("the push", |state, _| state["robots"][0]["reading"]["push"]["carried_m"].as_f64().filter(|m| *m > 0.05));
    for robot in [0, 1] {
        assert_eq!(page.state["robots"][robot]["reading"]["push"]["size_m_s"], json!([0.0, 0.8]));
    }
    page.wait("the end of it", |state, _| (state["robots"][1]["reading"]["push"]["outcome"] == "over").then_some(()));
    let carried = [0, 1].map(|robot| page.number(&format!("/robots/{robot}/reading/push/carried_m")));
    assert!(carried.iter().all(|carried| *carried > 0.02) && carried[0] != carried[1], "{carried:?}");

    // 12 kg: 6 N·s are about half a metre per second; and larger pushes are limited to the largest.
    page.send(&json!({ "push": { "size": [6.0, 0.0], "unit": "N·s" } }));
    let speed =
        |state: &Value| state["robots"][0]["reading"]["push"]["size_m_s"][0].as_f64().filter(|size| *size > 0.0);
    let mass_kg = supple::robot::Robot::load("go1").unwrap().mass_kg;
    assert!((page.wait("another push", |state, _| speed(state)) - 6.0 / mass_kg).abs() < 1e-12);
    page.send(&json!({ "push": { "size": [1e300, 0.0], "unit": "m/s" } }));
    page.wait("the largest push", |state, _| speed(state).filter(|size| *size == 3.0));
}

#[test]
fn speed_scene_and_robots_change_while_running() {
    let (_folder, _drive, mut page) = start(&["--policy", "compliant", "--seed", "3"]);
    let ticks = |page: &mut common::Page, time: Duration| {
        let start = (Instant::now(), page.number("/tick"));
        page.wait("time to pass", |_, _| (start.0.elapsed() > time).then_some(()));
        (page.number("/tick") - start.1) / start.0.elapsed().as_secs_f64() / 240.0
    };
    page.wait_for("a state", &[]);
    page.send(&json!({ "speed": 0.25 }));
    page.wait_for("slow motion", &[("/speed", json!(0.25))]);
    let slow = ticks(&mut page, Duration::from_millis(1500));
    assert!((0.2..0.3).contains(&slow), "{slow}");
    page.send(&json!({ "pause": true }));
    page.wait_for("a pause", &[("/paused", json!(true))]);
    let tick = page.number("/tick");
    page.send(&json!("reset"));
    page.send(&json!({ "pause": false }));
    page.wait_for("time to go on", &[("/paused", json!(false))]);
    assert!(page.number("/tick") - tick <= 8.0, "one step shows the reset");
    page.send(&json!({ "speed": 1.0 }));

    page.send(&json!({ "seed": null }));
    page.send(&json!({ "robot": { "index": 1, "policy": "baseline-seed1" } }));
    page.wait("two robots", |state, _| (state["seed"] == 4 && state["robots"].as_array()?.len() == 2).then_some(()));
    for scene in ["box", "hills", "blocks", "terrain", "ball-pit", "flat"] {
        page.send(&json!({ "scene": scene }));
        page.wait(scene, |state, _| {
            (state["scene"] == scene && state["robots"][1]["time_s"].as_f64()? > 0.05).then_some(())
        });
        assert_eq!(page.state["robots"][1]["name"], "baseline-seed1");
    }
    page.send(&json!({ "robot": { "index": 0, "policy": "nobody" } }));
    assert!(page.notice("there is no policy 'nobody'").len() > 40);
    page.send(&json!({ "robot": { "index": 1, "policy": null } }));
    page.wait("one robot", |state, _| (state["robots"].as_array()?.len() == 1).then_some(()));
}

#[test]
fn only_one_page_drives_at_a_time() {
    let (_folder, drive, mut first) = start(&["--policy", "compliant"]);
    let mut second = drive.page();
    first.wait_for("the first to drive", &[("/driver", json!(first.me))]);
    second.send(&json!({ "scene": "box" }));
    second.send(&json!({ "command": [0.5, 0.0, 0.0] }));
    first.ask_for([0.0, 0.0, 0.3], Duration::from_millis(500));
    assert_eq!(first.state["scene"], "flat");
    assert_eq!(first.state["robots"][0]["reading"]["command"], json!([0.0, 0.0, 0.3]));
    second.send(&json!("drive"));
    second.ask_for([0.2, 0.0, 0.0], Duration::from_millis(500));
    assert_eq!(second.state["driver"], second.me);
    assert_eq!(second.state["robots"][0]["reading"]["command"], json!([0.2, 0.0, 0.0]));
}

#[test]
fn wrong_origin_token_or_host_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let drive = Drive::start(folder.path(), &["--policy", "compliant"]);
    let own = format!("http://{}", drive.host);
    let port = drive.host.rsplit_once(':').unwrap().1;
    let localhost = format!("http://localhost:{port}");
    for path in ["/control", "/view"] {
        let refused = |origin: Option<&str>, token: &str| drive.socket(path, origin, token).err();
        for token in [&"0".repeat(32), ""] {
            assert_eq!(refused(Some(&own), token), Some(403));
        }
        for origin in [Some("http://evil.example"), Some("null"), Some(&localhost), None] {
            assert_eq!(refused(origin, &drive.token), Some(403), "{origin:?}");
        }
        assert_eq!(refused(Some(&own), &drive.token), None);
    }
    // DNS rebinding: a foreign name that resolves to this machine.
    let rebound = drive.get("/", &format!("evil.example:{port}"));
    assert!(rebound.starts_with("HTTP/1.1 403") && !rebound.contains("<html"), "{rebound}");
    let page = drive.get("/", &drive.host);
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    assert!(page.to_lowercase().contains("content-security-policy: default-src 'none'"), "{page}");
    assert!(!page.contains(&drive.token));
    assert!(drive.get("/../Cargo.toml", &drive.host).starts_with("HTTP/1.1 404"));
}

#[test]
fn hostile_connections_do_not_disturb_robots() {
    let (_folder, drive, mut page) = start(&["--policy", "compliant"]);
    page.wait_for("a state", &[]);
    let (begun, tick) = (Instant::now(), page.number("/tick"));

    // Half-open connections, a cut-off request, and a head that never ends.
    let mut open: Vec<TcpStream> = (0..30).map(|_| TcpStream::connect(&drive.host).unwrap()).collect();
    open[0].write_all(b"GET / HTTP/1.1\r\nHost: ").unwrap();
    let endless = [b"GET / HTTP/1.1\r\n".to_vec(), b"A: b\r\n".repeat(20_000)].concat();
    let _ = open[1].write_all(&endless);
    let _ = open[2].write_all(&[0xff; 5000]);

    let closes_on = |message: Message| {
        let mut socket = drive.open("/control");
        // The server may close the connection while we are still sending.
        let _ = socket.send(message);
        let start = Instant::now();
        while socket.read().is_ok() {
            assert!(start.elapsed() < PATIENCE);
        }
    };
    for bad in ["", "{", "{\"command\":[1]}", "{\"sudo\":1}", "{\"command\":[1e999,0,0]}"] {
        closes_on(Message::text(bad));
    }
    closes_on(Message::binary(vec![0; 100]));
    closes_on(Message::text("[".repeat(1 << 20)));
    // Too many messages.
    let mut flood = drive.open("/control");
    let start_of_flood = Instant::now();
    while flood.send(Message::text(r#"{"command":[0,0,0]}"#)).is_ok() {
        assert!(start_of_flood.elapsed() < PATIENCE);
    }
    // A viewer that reads nothing.
    let deaf = drive.open("/view");

    page.ask_for([0.3, 0.0, 0.0], Duration::from_secs(3));
    let rate = (page.number("/tick") - tick) / 240.0 / begun.elapsed().as_secs_f64();
    assert!((0.9..1.05).contains(&rate), "{rate}");
    assert_eq!(page.state["robots"][0]["reading"]["command"], json!([0.3, 0.0, 0.0]));
    // A silent connection is closed.
    open[3].set_read_timeout(Some(PATIENCE)).unwrap();
    let mut answer = Vec::new();
    let _ = open[3].read_to_end(&mut answer);
    assert!(begun.elapsed() < PATIENCE);
    drop(deaf);
}

#[test]
fn saved_session_replays_with_same_bits() {
    let (folder, drive, mut page) = start(&[]);
    page.ask_for([0.4, 0.0, 0.2], Duration::from_millis(600));
    page.send(&json!("reset"));
    page.send(&json!({ "push": { "size": [-0.3, 0.5], "unit": "m/s" } }));
    page.send(&json!({ "pull": [10.0, -5.0] }));
    page.ask_for([0.0, 0.3, 0.0], Duration::from_millis(400));
    page.send(&json!({ "keep": "all" }));
    page.notice("drive-1.jsonl");
    page.send(&json!({ "scene": "box" }));
    page.wait_for("the box", &[("/scene", json!("box"))]);
    page.ask_for([0.5, 0.0, 0.0], Duration::from_millis(600));
    page.send(&json!({ "keep": "minute" }));
    page.notice("drive-2.jsonl");
    page.send(&json!({ "keep": "all" }));
    page.notice("drive-3.jsonl");
    let recordings = ["drive-1.rrd", "drive-2.rrd", "drive-3.rrd", "drive-3-2.rrd"];
    let written = |name: &str| std::fs::read(folder.path().join(name)).is_ok_and(|bytes| bytes.len() > 10_000);
    let begun = Instant::now();
    while !recordings.iter().all(|name| written(name)) {
        assert!(begun.elapsed() < PATIENCE);
        page.ask_for([0.0; 3], Duration::from_millis(100));
    }
    drop(drive);

    for session in ["drive-1.jsonl", "drive-2.jsonl", "drive-3.jsonl"] {
        let recording = session.replace(".jsonl", "-again.rrd");
        let output = replay(folder.path(), session, &["--record", &recording]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert!(text(&output.stdout).ends_with(SAME), "{}", text(&output.stdout));
    }
    // The first recording was named, the second one was not.
    let second = folder.path().join("drive-3-again-2.rrd");
    let bytes = std::fs::read(&second).unwrap();
    let session = std::fs::read_to_string(folder.path().join("drive-1.jsonl")).unwrap();
    let changed = session.replace("[-0.3,0.5]", "[-0.3,0.5000000000000001]");
    assert_ne!(session, changed);
    let end = session.rfind(r#"{"end""#).unwrap();
    for (name, content) in [("changed", &changed[..]), ("cut", &session[..end + 20]), ("other", "{\"a\":1}\n")] {
        std::fs::write(folder.path().join(name).with_extension("jsonl"), content).unwrap();
    }
    let again: &[&str] = &["--record", "drive-3-again.rrd"];
    for (session, more, code, words) in [
        ("drive-3.jsonl", again, 2, "drive-3-again-2.rrd exists already"),
        ("changed.jsonl", &[], 2, "the final state differs from the original"),
        ("cut.jsonl", &[], 0, "the session was cut off"),
        ("other.jsonl", &[], 2, "other.jsonl: line 1: it is no session"),
    ] {
        let output = replay(folder.path(), session, more);
        let told = text(&output.stderr);
        assert!(output.status.code() == Some(code) && told.contains(words), "{session}: {told}");
    }
    assert_eq!(std::fs::read(&second).unwrap(), bytes);
}

#[test]
fn newer_policy_of_run_takes_over_while_driving() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    std::fs::create_dir(&run).unwrap();
    let ships = |name: &str| Path::new(env!("CARGO_MANIFEST_DIR")).join("../policies").join(name);
    let save = |name: &str| std::fs::copy(ships(name), run.join("policy.safetensors")).map(drop).unwrap();
    save("baseline-seed2.safetensors");
    std::fs::copy(ships("baseline-seed2.calibration.json"), run.join("policy.calibration.json")).unwrap();
    let drive = Drive::start(folder.path(), &["--policy", "run"]);
    let mut page = drive.page();
    page.send(&json!({ "comply": { "robot": 0, "compliance": 0.04 } }));
    page.send(&json!({ "pull": [15.0, 0.0] }));
    page.ask_for([0.4, 0.0, 0.0], Duration::from_millis(500));
    assert_eq!(page.state["robots"][0]["compliance"], 0.04);
    save("compliant-seed1.safetensors");
    page.notice("run: now walks with the newer policy of its run");
    page.ask_for([0.4, 0.0, 0.0], Duration::from_millis(500));
    // The newer policy is not calibrated.
    assert_eq!(page.state["robots"][0]["compliance"], Value::Null);
    assert!(page.state["robots"][0]["reach"].is_null());
    page.send(&json!({ "keep": "all" }));
    page.notice("drive-1.jsonl");
    page.notice("drive-1.rrd is written");
    drop(drive);
    std::fs::remove_dir_all(&run).unwrap();
    let output = replay(folder.path(), "drive-1.jsonl", &[]);
    assert!(text(&output.stdout).ends_with(SAME), "{}", text(&output.stderr));
}

#[test]
fn viewers_and_changes_leave_no_threads_behind() {
    let (_folder, drive, mut page) = start(&[]);
    // Reads a viewer's files for a while.
    let view = |page: &mut common::Page, count: usize, request: Option<&Value>| {
        let mut viewer = drive.open("/view");
        for _ in 0..count {
            if let Some(request) = request {
                page.send(request);
            }
            page.ask_for([0.0; 3], Duration::from_millis(100));
            while !matches!(viewer.read().unwrap(), Message::Binary(_)) {}
            viewer.send(Message::text("shown")).unwrap();
        }
    };
    let settle = |page: &mut common::Page, most: usize| {
        let start = Instant::now();
        while drive.threads() > most {
            assert!(start.elapsed() < PATIENCE, "{} threads, {most} before", drive.threads());
            page.ask_for([0.0; 3], Duration::from_millis(100));
        }
    };
    view(&mut page, 2, None);
    page.ask_for([0.0; 3], Duration::from_secs(2));
    let before = drive.threads();
    for _ in 0..20 {
        view(&mut page, 1, None);
    }
    settle(&mut page, before);
    view(&mut page, 20, Some(&json!({ "seed": null })));
    settle(&mut page, before);
    assert_eq!(page.number("/seed"), 20.0);
}

#[test]
fn pipes_and_devices_are_refused_while_robots_walk_on() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::create_dir(at("run")).unwrap();
    for pipe in ["pipe", "run/policy.safetensors", "robot.xml", "robot.yaml", "policy.yaml"] {
        assert!(std::process::Command::new("mkfifo").arg(at(pipe)).status().unwrap().success());
    }
    let drive = Drive::start(folder.path(), &[]);
    let mut page = drive.page();
    for (policy, robot) in [
        (at("pipe"), None),
        (at("run"), None),
        (at("policy.yaml"), None),
        ("compliant".to_owned(), Some(at("robot.xml"))),
        ("compliant".to_owned(), Some(at("robot.yaml"))),
        ("/dev/zero".to_owned(), None),
        ("compliant".to_owned(), Some("/dev/zero".to_owned())),
    ] {
        let start = Instant::now();
        let named = robot.clone().unwrap_or(policy.clone());
        page.send(&json!({ "robot": { "index": 0, "policy": policy, "robot": robot } }));
        let told = page.notice(&named);
        assert!(told.contains("it is a pipe") || told.contains("it is a device"), "{told}");
        let tick = page.number("/tick");
        page.wait("steps", |state, _| (state["tick"].as_f64()? > tick + 40.0).then_some(()));
        assert!(start.elapsed() < Duration::from_secs(5));
    }
}

#[test]
fn session_that_takes_hours_to_start_over_stops_nothing() {
    let (folder, mut drive, mut page) = start(&["--policy", "compliant"]);
    page.ask_for([0.0; 3], Duration::from_millis(300));
    page.send(&json!({ "keep": "all" }));
    page.notice("drive-1.jsonl");
    drive.signal("INT");
    assert_eq!(drive.ends_within(PATIENCE), Some(0), "one is enough for a program that is not busy");

    let mut drive = Drive::start(folder.path(), &["--replay", "drive-1.jsonl"]);
    let mut page = drive.page();
    page.wait_for("a state", &[]);
    // From now on it takes hours to start over.
    let session = std::fs::read_to_string(folder.path().join("drive-1.jsonl")).unwrap();
    let end = session.rfind("{\"end\":{\"tick\":").unwrap();
    let late = session[..end].replace("\"from_tick\":0", "\"from_tick\":600000000");
    let late = late + "{\"end\":{\"tick\":600000000,\"state\":\"\"}}\n";
    std::fs::write(folder.path().join("drive-1.jsonl"), late).unwrap();
    page.send(&json!("reset"));
    for speed in [0.25, 0.5] {
        page.send(&json!({ "speed": speed }));
        page.wait_for("another speed", &[("/speed", json!(speed))]);
    }
    drive.signal("INT");
    assert_eq!(drive.ends_within(PATIENCE), Some(0));
}

#[test]
fn idle_connections_keep_no_page_out() {
    let folder = tempfile::tempdir().unwrap();
    let drive = Drive::start(folder.path(), &["--policy", "compliant"]);
    let request = format!("GET / HTTP/1.1\r\nHost: {}\r\n\r\n", drive.host);
    let idle: Vec<TcpStream> = (0..100)
        .map(|_| {
            let mut stream = TcpStream::connect(&drive.host).unwrap();
            stream.write_all(request.as_bytes()).unwrap();
            stream
        })
        .collect();
    let start = Instant::now();
    assert!(drive.get("/", &drive.host).starts_with("HTTP/1.1 200"));
    drive.page();
    assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
    drop(idle);
}

#[test]
fn many_saves_are_written_one_after_another() {
    let (folder, drive, mut page) = start(&[]);
    page.ask_for([0.3, 0.0, 0.0], Duration::from_secs(2));
    let threads = drive.threads();
    for _ in 0..60 {
        page.send(&json!({ "keep": "all" }));
    }
    for _ in 0..10 {
        page.ask_for([0.0; 3], Duration::from_millis(50));
        // Those of two recordings at most: the one being written, and the one being closed.
        assert!(drive.threads() <= threads + 6, "{} threads, {threads} before", drive.threads());
    }
    page.send(&json!({ "keep": "minute" }));
    // How many are refused depends on how fast the disk is; those that are not are written in the end.
    let is_empty = |file: std::io::Result<std::fs::DirEntry>| file.unwrap().metadata().unwrap().len() == 0;
    page.wait("a file that is not empty", |_, _| {
        (!std::fs::read_dir(folder.path()).unwrap().any(is_empty)).then_some(())
    });
}
