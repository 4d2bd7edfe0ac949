//! Tests of live sessions, saved sessions and readouts.

use std::path::Path;

use super::*;
use crate::config::Config;
use crate::network::ActorCritic;
use crate::policy::file::tests::untrained;
use crate::policy::{Agent, Policy};
use crate::robot::{JOINTS, Robot};
use crate::scenario::metrics::{self, STRIDE_S};
use crate::scenario::trace::{EventKind, Frame, Trace};
use crate::util::random::{Purpose, stream};

/// Returns the file of a policy that holds a pose.
fn standing(pose: [f64; 3]) -> Vec<u8> {
    let mut config = Config::load("compliant").unwrap();
    config.action.nominal_pose_rad = crate::config::PerJoint::Alike(pose);
    let inputs = config.layout().unwrap().length();
    let network = ActorCritic::orthogonal(inputs, &[8], JOINTS, -1.0, &mut stream(0, Purpose::Weights, 0, 0));
    untrained(&network.zeros_like(), config).to_bytes().unwrap()
}

const UPRIGHT: [f64; 3] = [0.0, 0.72, -1.44];
const LYING: [f64; 3] = [0.0, 1.5, -2.7];

/// Returns the setup of robots that hold a pose, in a scene.
fn setup(poses: &[[f64; 3]], scene: SceneKind, shelf: &mut AgentCache) -> Setup {
    let seat = |pose: &[f64; 3]| {
        let file = standing(*pose);
        shelf.put_file("standing", file.clone()).unwrap();
        let sha256 = Agent::from(Policy::from_bytes(&file, Path::new("standing")).unwrap()).sha256;
        let robot_sha256 = Robot::load("go1").unwrap().sha256().to_owned();
        Seat { policy: "standing".into(), sha256, robot: "go1".into(), robot_sha256, compliance: None }
    };
    Setup { scene, seed: 0, robots: poses.iter().map(seat).collect() }
}

/// Plays shipped policies with inputs at ticks and writes the session; returns the live session and its writer.
fn drive(inputs: &[(u64, Input)], until: u64) -> (LiveSession, Writer) {
    let mut shelf = AgentCache::default();
    let robots = ["compliant", "baseline"].map(|name| shelf.find(name, None).unwrap()).to_vec();
    let setup = Setup { scene: SceneKind::Flat, seed: 0, robots };
    let mut world = LiveSession::new(setup.clone(), &mut shelf).unwrap();
    let mut writer = Writer::new(tempfile::tempfile().unwrap());
    writer.input(0, &Input::Setup(setup), &shelf).unwrap();
    let mut inputs = inputs.iter().peekable();
    while world.tick() < until {
        while let Some((_, input)) = inputs.next_if(|(tick, _)| *tick <= world.tick()) {
            writer.input(world.tick(), input, &shelf).unwrap();
            world.apply(input, &mut shelf).unwrap();
        }
        world.step().unwrap();
    }
    (world, writer)
}

/// Saves a driven session from a tick on and reads it.
fn saved(world: &LiveSession, writer: &mut Writer, from: Option<u64>) -> SavedSession {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kept.jsonl");
    writer.part(from, world.tick(), world.fingerprint()).unwrap().write_new(&path).unwrap();
    SavedSession::load(&path).unwrap()
}

fn walk(forward: f64) -> Input {
    Input::Act(Act::Command(Command::velocity(forward, 0.0, 0.0)))
}

#[test]
fn sessions_replay_to_the_last_bit_from_any_setup() {
    let mut shelf = AgentCache::default();
    let robots = ["baseline", "compliant"].map(|name| shelf.find(name, None).unwrap()).to_vec();
    let boxed = Setup { scene: SceneKind::Box, seed: 7, robots };
    let inputs = [
        (8, walk(0.4)),
        (60, Input::Act(Act::Push { size: [0.1, 0.3], unit: PushUnit::Velocity })),
        (100, Input::Act(Act::Hand(Some([5.0, -10.0])))),
        (160, Input::Act(Act::Reset)),
        (200, Input::Act(Act::Hand(None))),
        (240, Input::Setup(boxed)),
        (244, walk(0.3)),
        (300, Input::Act(Act::Push { size: [4.0, 0.0], unit: PushUnit::Momentum })),
    ];
    let (world, mut writer) = drive(&inputs, 360);
    for from in [None, Some(280), Some(120)] {
        let session = saved(&world, &mut writer, from);
        // From 280 on, nothing from before the box matters.
        let count = if from == Some(280) { 3 } else { inputs.len() + 1 };
        assert_eq!(session.inputs().len(), count);
        let mut playback = session.play().unwrap();
        let mut shown = Vec::new();
        while let Some(step) = playback.step().unwrap() {
            if playback.is_shown(step.tick) {
                shown.push(step.tick);
            }
        }
        assert_eq!((shown[0], *shown.last().unwrap()), (from.unwrap_or(0), 356));
        assert_eq!(playback.verify(), Some(Ok(())));
    }
}

#[test]
fn commanded_compliance_changes_one_robot_only() {
    let comply = |compliance| Input::Act(Act::Comply { robot: 1, compliance: Some(compliance) });
    let inputs = [
        (8, walk(0.5)),
        (240, Input::Act(Act::Hand(Some([10.0, 0.0])))),
        (1200, Input::Act(Act::Hand(None))),
        (1440, comply(0.04)),
        (1680, Input::Act(Act::Hand(Some([10.0, 0.0])))),
        (2640, Input::Act(Act::Hand(None))),
    ];
    let (world, mut writer) = drive(&inputs, 2700);
    let mut playback = saved(&world, &mut writer, None).play().unwrap();
    let takes = takes(&mut playback).unwrap();
    assert_eq!(playback.verify(), Some(Ok(())));
    let told: Vec<_> = takes.iter().map(|take| (take.seat.policy.as_str(), take.seat.compliance)).collect();
    assert_eq!(told, [("baseline", None), ("compliant", None), ("baseline", Some(0.04))]);
    let yields = |take: &Take| take.pulls.iter().map(|pull| pull.gives_m_s / pull.force_n).collect::<Vec<_>>();
    let (before, after) = (yields(&takes[0])[0], yields(&takes[2])[0]);
    assert!((0.03..0.05).contains(&after) && before < 0.02, "{before} {after}");
    let [first, second] = yields(&takes[1])[..] else { panic!("two pulls") };
    assert!((first - second).abs() < 0.01, "{first} {second}");
}

#[test]
fn inputs_of_one_tick_are_measured_as_they_leave_the_world() {
    let mut shelf = AgentCache::default();
    let alone = |shelf: &mut AgentCache| vec![shelf.find("baseline", None).unwrap()];
    let alone = Setup { scene: SceneKind::Flat, seed: 0, robots: alone(&mut shelf) };
    let push = Input::Act(Act::Push { size: [0.0, 0.3], unit: PushUnit::Velocity });
    // Inputs in the tick in which a robot is removed, and a push while another one is being measured.
    let inputs = [
        (240, Input::Act(Act::Comply { robot: 1, compliance: Some(0.03) })),
        (240, push.clone()),
        (240, Input::Setup(alone)),
        (480, push.clone()),
        (720, push),
    ];
    let (world, mut writer) = drive(&inputs, 960);
    let takes = takes(&mut saved(&world, &mut writer, None).play().unwrap()).unwrap();
    let policies: Vec<_> = takes.iter().map(|take| take.seat.policy.as_str()).collect();
    assert_eq!(policies, ["compliant", "baseline", "baseline"]);
    let outcomes = |take: &Take| take.pushes.iter().map(|push| push.outcome).collect::<Vec<_>>();
    assert_eq!(outcomes(&takes[2]), [Outcome::Disturbed, Outcome::Disturbed]);
}

#[test]
fn unsupported_compliance_is_refused_or_reset() {
    let mut shelf = AgentCache::default();
    let Setup { robots: standing, .. } = setup(&[UPRIGHT], SceneKind::Flat, &mut shelf);
    let robots = vec![shelf.find("baseline", None).unwrap(), standing[0].clone()];
    let told = Setup { scene: SceneKind::Flat, seed: 0, robots };
    let mut world = LiveSession::new(told, &mut shelf).unwrap();
    let mut comply =
        |robot, compliance| world.apply(&Input::Act(Act::Comply { robot, compliance }), &mut shelf).is_ok();
    for beyond in [-0.01, 0.0, 1e-6, 1.0, f64::NAN] {
        assert!(!comply(0, Some(beyond)), "{beyond}");
    }
    assert!(comply(0, Some(0.03)) && comply(1, None) && !comply(1, Some(0.03)) && !comply(2, Some(0.03)));
    assert_eq!(world.setup().robots[0].compliance, Some(0.03));
    // Another scene, and a command, leave it as it is; an uncalibrated policy resets it.
    let hills = Setup { scene: SceneKind::Box, ..world.setup().clone() };
    world.apply(&Input::Setup(hills), &mut shelf).unwrap();
    world.apply(&walk(0.5), &mut shelf).unwrap();
    let frame = |world: &mut LiveSession| world.step().unwrap()[0].frame.clone().unwrap();
    assert_eq!(frame(&mut world).command, Command { compliance: Some(0.03), ..Command::velocity(0.5, 0.0, 0.0) });
    let sha256 = standing[0].sha256.clone();
    world.apply(&Input::Renew { robot: 0, sha256 }, &mut shelf).unwrap();
    assert_eq!(frame(&mut world).command, Command::velocity(0.5, 0.0, 0.0));
    assert_eq!(world.setup().robots[0].compliance, None);
}

#[test]
fn a_command_moves_a_robot_in_the_second_frame_after_it() {
    // The joint target comes out of the step's policy, and acts 30 ms later: 7.2 of 240 Hz, in the second step.
    let positions = |forward: f64, steps: u64| drive(&[(40, walk(forward))], 40 + 4 * steps).0.fingerprint();
    assert_eq!(positions(0.0, 1), positions(0.5, 1));
    assert_ne!(positions(0.0, 2), positions(0.5, 2));
}

#[test]
fn fallen_robots_are_set_on_their_feet_and_counted() {
    let mut shelf = AgentCache::default();
    let mut world = LiveSession::new(setup(&[UPRIGHT], SceneKind::Flat, &mut shelf), &mut shelf).unwrap();
    let mut frames: Vec<(bool, std::sync::Arc<Frame>)> = Vec::new();
    let mut fell_s = None;
    while world.tick() < 240 * 6 {
        if world.tick() == 240 {
            world.apply(&Input::Act(Act::Push { size: [0.5, 3.0], unit: PushUnit::Velocity }), &mut shelf).unwrap();
        }
        for played in world.step().unwrap() {
            let fall = played.events.iter().find(|event| event.kind == EventKind::Fall);
            fell_s = fell_s.or(fall.map(|fall| fall.time_s));
            frames.push((played.is_beginning, played.frame.unwrap()));
        }
    }
    let fell_s = fell_s.unwrap();
    assert_eq!(world.falls().collect::<Vec<_>>(), [1]);
    let again = frames.iter().rposition(|(is_beginning, _)| *is_beginning).unwrap();
    let (before, after) = (&frames[again - 1].1, &frames[again].1);
    assert!((after.time_s - fell_s - 2.0).abs() < 0.04, "fell at {fell_s}, stood at {}", after.time_s);
    for axis in [0, 1] {
        assert!((before.position[axis] - after.position[axis]).abs() < 0.01, "{before:?} {after:?}");
    }
    let turned = (before.roll_pitch_yaw[2] - after.roll_pitch_yaw[2]).abs();
    assert!(turned < 0.01 && after.roll_pitch_yaw[0].abs() < 0.02 && after.height_m > 0.25, "{after:?}");
    assert!(before.position[1] > 0.1, "it was thrown to the left");
}

#[test]
fn robots_of_one_world_do_not_touch_each_other() {
    // The same robot alone, and beside one that lies on the floor and is set up again and again.
    let mut shelf = AgentCache::default();
    let play = |poses: &[[f64; 3]], shelf: &mut AgentCache| {
        let mut world = LiveSession::new(setup(poses, SceneKind::Box, shelf), shelf).unwrap();
        let mut last = None;
        while world.tick() < 720 {
            last = world.step().unwrap().into_iter().find(|played| played.robot == 0).or(last);
        }
        (last.unwrap().frame.unwrap(), world.falls().collect::<Vec<_>>())
    };
    let (alone, _) = play(&[UPRIGHT], &mut shelf);
    let (beside, falls) = play(&[UPRIGHT, LYING], &mut shelf);
    assert_eq!(alone, beside);
    assert!(falls[0] == 0 && falls[1] >= 1, "{falls:?}");
}

#[test]
fn a_world_needs_one_robot_or_two_and_an_input_that_fits() {
    let mut shelf = AgentCache::default();
    let three = setup(&[UPRIGHT, UPRIGHT, UPRIGHT], SceneKind::Flat, &mut shelf);
    assert!(LiveSession::new(three, &mut shelf).unwrap_err().to_string().contains("robots: found 3"));
    let mut world = LiveSession::new(setup(&[UPRIGHT], SceneKind::Flat, &mut shelf), &mut shelf).unwrap();
    let before = world.fingerprint();
    let mut gone = world.setup().clone();
    gone.robots[0] = Seat { policy: "nobody".into(), sha256: "0".into(), ..gone.robots[0].clone() };
    for (input, words) in [
        (Input::Renew { robot: 1, sha256: "0".into() }, "robots: found number 1, expected 0 to 0"),
        (Input::Setup(gone), "nobody"),
        (Input::Act(Act::Push { size: [f64::INFINITY, 0.0], unit: PushUnit::Velocity }), "not finite"),
    ] {
        let error = world.apply(&input, &mut shelf).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
    assert_eq!(world.fingerprint(), before);
    let mut undisturbed = LiveSession::new(world.setup().clone(), &mut shelf).unwrap();
    [&mut world, &mut undisturbed].into_iter().for_each(|world| drop(world.step().unwrap()));
    assert_eq!(world.fingerprint(), undisturbed.fingerprint());
}

#[test]
fn a_meter_reads_of_a_push_what_the_metrics_read_of_its_whole_trace() {
    let period_s = 1.0 / 60.0;
    let velocity = |time_s: f64| 0.4 + if time_s > 2.0 { 0.5 * (-(time_s - 2.0) / 0.3).exp() } else { 0.0 };
    let frame = |step: u32| {
        let time_s = f64::from(step) * period_s;
        Frame { time_s, velocity_in_heading: [velocity(time_s), 0.0, 0.0], power_w: 20.0, ..Frame::default() }
    };
    let mut meter = LiveReadout::new((120.0, period_s));
    let mut trace = Trace { period_s, weight_n: 120.0, ..Trace::default() };
    for step in 1..=480 {
        if step == 121 {
            meter.push([0.5, 0.0]);
        }
        trace.frames.push(frame(step));
        let frame = Some(std::sync::Arc::new(frame(step)));
        meter.note(&RobotStep { robot: 0, is_beginning: step == 1, frame, events: Vec::new() });
    }
    let reading = meter.read().unwrap();
    let push = reading.push.unwrap();
    assert_eq!(push.outcome, Outcome::Over);
    // The integral of 0.5 exp(−t / 0.3) over 2 s is 0.15 (1 − exp(−6.7)) = 0.1498 m; a step's width off at most.
    let carried = push.carried_m.unwrap();
    assert!((carried - 0.1498).abs() < 0.5 * period_s, "{carried}");
    assert!((carried - metrics::carried(&trace, 2.0, [0.5, 0.0], CARRIED_S).unwrap()).abs() < 1e-12);
    let decay = metrics::decay(&trace.until(6.0), 2.0, [0.5, 0.0], 0.1, STRIDE_S).unwrap();
    assert_eq!(push.decay_s, decay.ended_s());
    assert!((reading.power_w - 20.0).abs() < 1e-12 && (reading.velocity[0] - 0.4).abs() < 1e-3, "{reading:?}");
}

#[test]
fn a_push_that_is_disturbed_is_said_to_be() {
    let period_s = 1.0 / 60.0;
    let outcome = |disturb: fn(&mut LiveReadout, &mut Frame)| {
        let mut meter = LiveReadout::new((120.0, period_s));
        for step in 1..=240_u32 {
            if step == 121 {
                meter.push([0.5, 0.0]);
            }
            let mut frame = Frame { time_s: f64::from(step) * period_s, ..Frame::default() };
            if step > 150 {
                disturb(&mut meter, &mut frame);
            }
            let frame = Some(std::sync::Arc::new(frame));
            meter.note(&RobotStep { robot: 0, is_beginning: false, frame, events: Vec::new() });
        }
        meter.read().unwrap().push.unwrap().outcome
    };
    assert_eq!(outcome(|_, _| ()), Outcome::Watching);
    assert_eq!(outcome(|_, frame| frame.command.forward = 0.5), Outcome::Disturbed);
    assert_eq!(outcome(|meter, _| meter.pull(Some([1.0, 0.0]))), Outcome::Disturbed);
}

#[test]
fn what_is_no_session_is_refused_line_by_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jsonl");
    let head = r#"{"session":{"format":1,"program":"","from_tick":0}}"#;
    let walk = r#"{"input":{"tick":4,"input":{"command":{"forward":1.0,"left":0.0,"yaw":0.0}}}}"#;
    let set_up = r#"{"input":{"tick":4,"input":{"setup":{"scene":"flat","seed":0,"robots":[]}}}}"#;
    let end = |tick: u64| format!(r#"{{"end":{{"tick":{tick},"state":""}}}}"#);
    for (text, expected) in [
        (String::new(), "does not begin with a set-up"),
        (format!("{walk}\n"), "line 1: it does not say that it is a session"),
        (format!("{head}\n{walk}\n"), "does not begin with a set-up"),
        (format!("{head}\n{head}\n"), "line 2: a second session begins"),
        (format!("{head}\n{{\"input\":{{\"tick\":-1,\"input\":\"reset\"}}}}\n"), "line 2: it is no session"),
        (head.replace("\"format\":1", "\"format\":2") + "\n", "line 1: it has format 2, this program reads 1"),
        (
            format!("{head}\n{{\"policy\":{{\"name\":\"p\",\"sha256\":\"0\",\"file\":\"00\"}}}}\n"),
            "line 2: the policy 'p' is damaged",
        ),
        (
            format!("{head}\n{{\"policy\":{{\"name\":\"p\",\"sha256\":\"0\",\"file\":\"0\"}}}}\n"),
            "line 2: the policy's file is not",
        ),
        (format!("{head}\n{set_up}\n{}\n", end(1 << 62)), "more than 30 days after its start at tick 4"),
        (format!("{head}\n{}\n", set_up.replace(":4,", &format!(":{},", u64::MAX))), "more than 30 days"),
    ] {
        std::fs::write(&path, &text).unwrap();
        let error = SavedSession::load(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{text}: {error}");
    }
}

#[test]
fn words_of_session_files_are_read() {
    let acts = [
        (walk(0.5), r#"{"command":{"forward":0.5,"left":0.0,"yaw":0.0}}"#),
        (
            Input::Act(Act::Push { size: [0.0, 1.0], unit: PushUnit::Momentum }),
            r#"{"push":{"size":[0.0,1.0],"unit":"N·s"}}"#,
        ),
        (Input::Act(Act::Hand(None)), r#"{"pull":null}"#),
        (Input::Act(Act::Comply { robot: 1, compliance: None }), r#"{"comply":{"robot":1,"compliance":null}}"#),
        (Input::Act(Act::Reset), r#""reset""#),
        (Input::Renew { robot: 0, sha256: "a".into() }, r#"{"renew":{"robot":0,"sha256":"a"}}"#),
    ];
    for (input, text) in acts {
        assert_eq!(serde_json::from_str::<Input>(text).unwrap(), input);
        let written = serde_json::to_string(&input).unwrap();
        assert_eq!(serde_json::from_str::<Input>(&written).unwrap(), input);
    }
}
