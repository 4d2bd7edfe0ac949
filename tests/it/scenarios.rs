//! One list of properties over every scenario.

use std::sync::Arc;

use clap::{FromArgMatches, Subcommand};
use supple::mujoco::Object;
use supple::policy::Agent;
use supple::scenario::catalog::{DEFAULTS, Scenario};
use supple::scenario::estimation::Estimation;
use supple::scenario::metrics::in_world;
use supple::scenario::trace::{DisturbanceMark, EventKind, Trace};
use supple::scenario::{Playback, Script, Sensing};
use supple::task::Command;
use supple::util::yaml::{Text, flat_parameters};

use crate::support::standing_policy;

/// A scenario from its defaults and a few changes, as the program would build it.
pub fn scenario(name: &str, changes: &[&str]) -> Scenario {
    let (_, text) = DEFAULTS.iter().find(|(known, _)| *known == name).unwrap();
    let mut line = vec!["scenario".to_owned(), name.to_owned()];
    for (key, value) in flat_parameters(&Text::new(name, text)).unwrap() {
        let flag = format!("--{}", key.replace('_', "-"));
        if !changes.iter().any(|change| change.starts_with(&format!("{flag}="))) {
            line.extend(value.map(|value| format!("{flag}={value}")));
        }
    }
    line.extend(changes.iter().map(ToString::to_string));
    let command = Scenario::augment_subcommands(clap::Command::new("scenario"));
    Scenario::from_arg_matches(&command.get_matches_from(line)).unwrap()
}

#[test]
fn scenario_by_name_equals_that_of_the_command_line() {
    for (name, _) in DEFAULTS {
        assert_eq!(Scenario::named(name, "{}").unwrap(), scenario(name, &[]));
        let changed = Scenario::named(name, r#"{"duration_s": 3, "forward_m_s": -0.25}"#).unwrap();
        assert_eq!(changed, scenario(name, &["--duration-s=3", "--forward-m-s=-0.25"]));
    }
    let refused = |name, parameters| Scenario::named(name, parameters).unwrap_err().to_string();
    for (error, expected) in [
        (refused("nothing", "{}"), "walk, push, leash"),
        (refused("walk", "{push_m_s: 1}"), "'push_m_s'; it has: forward_m_s"),
        (refused("push", "{push_m_s: much}"), "push, line 1: push_m_s: invalid type"),
        (refused("push", "{push_m_s: 1, duration_s: long}"), "duration_s: invalid type"),
        (refused("push", "[]"), "expected lines"),
    ] {
        assert!(error.contains(expected), "{error}");
    }
}

fn trace(scenario: &Scenario, seed: u64) -> Trace {
    trace_with(scenario, seed, Sensing::True)
}

fn trace_with(scenario: &Scenario, seed: u64, sensing: Sensing) -> Trace {
    playback(&script(scenario, seed)).with_bodies().with_sensing(sensing, seed).unwrap().trace()
}

fn script(scenario: &Scenario, seed: u64) -> Script {
    scenario.script(seed, &standing_policy().provenance.config).unwrap()
}

fn playback(script: &Script) -> Playback<'static> {
    let agent = Arc::new(Agent::from(standing_policy()));
    Playback::new(script, &agent.config, agent.shared_controller()).unwrap()
}

/// Every scenario, cut short.
pub fn all() -> Vec<Scenario> {
    DEFAULTS
        .iter()
        .map(|(name, _)| match *name {
            "push" | "leash" | "lead" | "pulley" | "pendulum" => scenario(name, &["--duration-s=2", "--at-s=0.5"]),
            _ => scenario(name, &["--duration-s=1"]),
        })
        .collect()
}

#[test]
fn what_would_come_after_the_end_is_told() {
    for (name, change, what) in [
        ("push", "--at-s=100", Some("the push at 100.")),
        ("leash", "--at-s=100", Some("the pull at 100.00 s")),
        ("lead", "--at-s=100", Some("the start of the leash at 100.00 s")),
        ("wall", "--duration-s=1", None),
        ("pulley", "--duration-s=0.5", Some("the release of the load at 2.00 s")),
        ("push", "--at-s=1", None),
        ("walk", "--duration-s=1", None),
    ] {
        let script = script(&scenario(name, &[change]), 0);
        let found = script.too_late();
        assert_eq!(found.is_some(), what.is_some(), "{name}: {found:?}");
        assert!(what.is_none_or(|what| found.unwrap().starts_with(what)), "{name}");
    }
}

#[test]
fn encoders_are_off_by_what_the_seed_draws_if_asked() {
    let offsets = |changes: &[&str], seed| script(&scenario("walk", changes), seed).conditions.encoder_bias;
    assert_eq!(offsets(&[], 1), [0.0; 12]);
    let asked = ["--encoder-bias-sd-rad=0.01"];
    assert_eq!(offsets(&asked, 1), offsets(&asked, 1));
    assert_ne!(offsets(&asked, 1), offsets(&asked, 2));
    assert!(offsets(&asked, 1).iter().all(|offset| *offset != 0.0 && offset.abs() < 0.05));
}

#[test]
fn scenarios_that_do_not_fit_their_command_are_refused() {
    for (name, changes, words) in [
        ("pulley", &["--yaw-rad-s=0.5"][..], "--yaw-rad-s is 0.5, expected 0"),
        ("pendulum", &["--yaw-rad-s=0.5"], "--yaw-rad-s is 0.5, expected 0"),
        ("outdoor", &["--forward-m-s=1", "--duration-s=75"], "a way of at most 57 m at the command"),
    ] {
        let config = standing_policy().provenance.config;
        let refusal = scenario(name, changes).script(0, &config).unwrap_err().to_string();
        assert!(refusal.contains(words), "{refusal}");
    }
}

#[test]
fn traces_are_deterministic_whole_and_finite_and_metrics_in_range() {
    for scenario in all() {
        let name = scenario.name();
        for sensing in [Sensing::True, Sensing::Estimated] {
            let trace = trace_with(&scenario, 3, sensing);
            assert_eq!(trace, trace_with(&scenario, 3, sensing), "{name}");
            assert_eq!(trace.frames.len(), (scenario.task().duration_s * 60.0) as usize, "{name}: {:?}", trace.events);
            for frame in &trace.frames {
                let numbers = [frame.height_m, frame.power_w, frame.torque_n_m, frame.reward, frame.peak_foot_force_n];
                assert!(numbers.iter().all(|number| number.is_finite()), "{name}");
                assert!(frame.power_w >= 0.0 && frame.reward >= 0.0 && frame.reward <= 1.3, "{name}");
                assert_eq!(frame.sensed.is_some(), sensing == Sensing::Estimated, "{name}");
                if let Some(sensed) = &frame.sensed {
                    let numbers = sensed.velocity.iter().chain(&sensed.position).chain([&sensed.height_m]);
                    assert!(numbers.copied().all(f64::is_finite), "{name}: {sensed:?}");
                }
            }
            for metric in scenario.metrics(&script(&scenario, 3), &trace) {
                assert!(metric.value.is_none_or(f64::is_finite), "{name}: {metric:?}");
            }
            let errors = Estimation::metrics(&trace);
            let is_told = |value: Option<f64>| value.map_or(sensing == Sensing::True, f64::is_finite);
            assert!(errors.iter().all(|metric| is_told(metric.value)), "{name}: {errors:?}");
        }
    }
}

#[test]
fn estimates_stay_finite_when_the_robot_is_thrown() {
    let far = scenario("push", &["--duration-s=3", "--at-s=0.2", "--push-m-s=20", "--direction-deg=120"]);
    let trace = trace_with(&far, 1, Sensing::Estimated);
    let fall = trace.fall().unwrap();
    assert!(fall.text.contains(" s after: push: -10.00 m/s forward, +17.32 m/s left"), "{}", fall.text);
    for frame in &trace.frames {
        let sensed = frame.sensed.unwrap();
        assert!(sensed.velocity.iter().chain(&sensed.position).all(|number| number.abs() < 1e4), "{sensed:?}");
    }
}

#[test]
fn every_element_of_every_scene_has_a_name() {
    let kinds = [Object::Body, Object::Joint, Object::Geom, Object::Site, Object::Actuator];
    for scenario in all() {
        let scene = script(&scenario, 0).scene;
        for model in [scene.compile().unwrap(), scene.compile_visual().unwrap()] {
            for kind in kinds.into_iter().chain([Object::HeightField, Object::Tendon]) {
                for id in 0..model.count(kind) {
                    assert!(!model.name(kind, id).is_empty(), "{}: {kind:?} {id} has no name", scenario.name());
                }
            }
        }
    }
}

#[test]
fn box_and_400_balls_have_their_masses_and_sizes() {
    for (scene, name, count, mass_kg, size_m) in
        [("box", "box", 1, 2.0, &[0.25; 3][..]), ("ball-pit", "ball_0", 400, 0.5, &[0.05])]
    {
        let model = script(&scenario(scene, &[]), 0).scene.compile().unwrap();
        let is_one = |body: &usize| model.name(Object::Body, *body).starts_with(&name[..3]);
        let bodies: Vec<usize> = (0..model.count(Object::Body)).filter(is_one).collect();
        assert!(bodies.len() == count && bodies.iter().all(|body| model.body_mass()[*body] == mass_kg), "{scene}");
        assert_eq!(&model.geom(model.id(Object::Geom, name).unwrap()).size[..size_m.len()], size_m);
    }
}

#[test]
fn a_push_changes_the_velocity_by_its_size_in_its_direction() {
    let scenario = scenario("push", &["--duration-s=2", "--at-s=0.5", "--push-m-s=0.4", "--direction-deg=90"]);
    let script = script(&scenario, 2);
    let trace = trace(&scenario, 2);
    let first = trace.frames.iter().find(|frame| frame.mark.is_some()).unwrap();
    assert!((first.time_s - script.pushes().next().unwrap().at_s).abs() < 1.5 / 60.0);
    // One policy step later the feet have already taken some of it away.
    let left = first.velocity_in_heading[1];
    assert!(left > 0.1 && left < 0.45, "{left}");
}

#[test]
fn odd_numbers_of_balls_and_strong_leashes_do_not_crash() {
    for balls in [0, 1, 1000] {
        let pit = scenario("ball-pit", &["--duration-s=0.2", &format!("--balls={balls}")]);
        let model = script(&pit, 0).scene.compile().unwrap();
        let found = (0..model.count(Object::Body)).filter(|body| model.name(Object::Body, *body).starts_with("ball_"));
        assert_eq!((found.count(), trace(&pit, 0).frames.len()), (balls, 12));
    }
    for force in ["--force-n=50", "--force-n=500"] {
        let trace = trace(&scenario("leash", &["--duration-s=4", "--at-s=0.5", force]), 0);
        assert!(!trace.frames.is_empty() && trace.events.iter().all(|event| !event.text.contains("unstable")));
    }
}

#[test]
fn set_point_commands_a_pulled_robot_back() {
    let changes = ["--forward-m-s=0", "--set-point-per-s=1", "--force-n=30", "--at-s=0", "--duration-s=0.8"];
    let trace = trace(&scenario("leash", &changes), 0);
    let mut points = trace.frames.windows(2).map(|pair| {
        let Command { forward, left, .. } = pair[1].command;
        let back = in_world([forward, left], pair[0].roll_pitch_yaw[2]);
        [0, 1].map(|axis| pair[0].position[axis] + back[axis])
    });
    // All commands lead back to one point, the start.
    let first = points.next().unwrap();
    for (step, point) in points.enumerate() {
        assert!((0..2).all(|axis| (point[axis] - first[axis]).abs() < 1e-9), "{step}: {point:?}, at first {first:?}");
    }
    let last = trace.frames.last().unwrap();
    assert!(last.position[1] > 0.01 && (-0.4..-0.01).contains(&last.command.left), "{:?}", last.command);
}

#[test]
fn pushes_grow_from_one_to_the_next() {
    let script =
        script(&scenario("push", &["--every-s=1", "--growth-m-s=0.25", "--for-s=0.1", "--direction-deg=0"]), 0);
    let pushes: Vec<_> = script.pushes().map(|push| (push.linear[0], push.for_s)).collect();
    assert_eq!(pushes[..3], [(0.5, 0.1), (0.75, 0.1), (1.0, 0.1)]);
}

#[test]
fn a_leash_that_is_led_away_gets_taut_and_pulls_where_it_leads() {
    let lead = scenario("lead", &["--duration-s=1", "--at-s=0.5", "--slack-m=0.1", "--direction-deg=90"]);
    let trace = trace(&lead, 0);
    // 0.1 m at 0.5 m/s: taut after 0.2 s, by what a robot that stands gives way at first.
    let taut = trace.events.iter().find(|event| event.text == "the leash is taut").unwrap();
    assert!((taut.time_s - 0.7).abs() < 2.5 / 60.0, "{taut:?}");
    for frame in &trace.frames {
        let force_n = frame.spring.map_or(0.0, |spring| spring.force_n);
        assert!(force_n == 0.0 || frame.time_s + 1e-9 >= taut.time_s, "{}", frame.time_s);
        let pull = DisturbanceMark::Rope { force: [force_n * 90.0_f64.to_radians().cos(), force_n, 0.0] };
        assert_eq!(frame.mark, (force_n > 0.0).then_some(pull));
    }
    // At the end 200 N/m · 0.15 m + 20 N·s/m · 0.5 m/s, less what the robot gives way.
    let last = trace.frames.last().unwrap().spring.unwrap();
    assert!((10.0..40.0).contains(&last.force_n) && last.peak_force_n >= last.force_n, "{last:?}");
}

#[test]
fn a_wall_stops_a_robot_that_walks_into_it_where_it_stands() {
    let agent = supple::policy::shipped::find("compliant").unwrap();
    let wall = scenario("wall", &["--duration-s=4", "--distance-m=1"]);
    let script = wall.script(0, &agent.config).unwrap();
    let trace = Playback::new(&script, &agent.config, agent.controller()).unwrap().trace();
    let met = trace.events.iter().find(|event| event.text == "meets the wall").unwrap();
    let first = trace.frames.iter().find(|frame| frame.time_s > met.time_s - 1e-9).unwrap();
    assert!((first.position[0] - 1.0).abs() < 0.03, "{first:?}");
    let Some(DisturbanceMark::Press { force }) = first.mark else { panic!("{:?}", first.mark) };
    assert!(force[0] < 0.0 && force[1].abs() < 1e-9 && force[2] == 0.0, "{force:?}");
    let metrics = wall.metrics(&script, &trace);
    let of = |name: &str| metrics.iter().find(|metric| metric.name == name).unwrap().value.unwrap();
    // Where it is deepest its speed is zero: what presses it is the stiffness alone, and damping before.
    let (peak, depth) = (of("peak_force_n"), of("depth_m"));
    assert!((700.0 * depth - 1e-9..700.0 * depth + 4.0).contains(&peak), "{peak} N, {depth} m");
    assert!(of("blow_n_s") > 5.0 && of("impulse_n_s") > of("blow_n_s") && of("blow_n_s") < peak, "{metrics:?}");
}

#[test]
fn a_rope_carries_its_weight_and_never_pushes() {
    let scenario = scenario("pulley", &["--duration-s=5", "--at-s=0.5", "--for-s=4"]);
    let trace = trace(&scenario, 0);
    let ropes = || trace.frames.iter().map(|frame| (frame.time_s, frame.rope.as_ref().unwrap()));
    assert!(ropes().all(|(_, rope)| rope.least_force_n >= 0.0));
    assert!(ropes().filter(|(time_s, _)| *time_s < 0.5).all(|(_, rope)| rope.peak_force_n == 0.0));
    // Held by a robot that stands, the weight is at rest after a while: m g.
    let settled: Vec<f64> = ropes().filter(|(t, _)| (3.5..4.5).contains(t)).map(|(_, rope)| rope.force_n).collect();
    let mean = settled.iter().sum::<f64>() / settled.len() as f64;
    assert!((mean / 9.81 - 1.0).abs() < 0.02, "{mean}");
    let (_, last) = ropes().next_back().unwrap();
    assert!(last.peak_force_n == 0.0 && last.points.is_empty(), "{last:?}");
    let texts: Vec<&str> = trace.events.iter().map(|event| event.text.as_str()).collect();
    assert_eq!(texts[..2], ["the weight is let go", "the rope is taken off"]);
}

#[test]
fn a_slack_rope_jerks_harder_than_a_taut_one() {
    let peak = |slack: &str| {
        let trace = trace(&scenario("pulley", &["--duration-s=2", "--at-s=0.5", slack]), 0);
        trace.frames.iter().map(|frame| frame.rope.as_ref().unwrap().peak_force_n).fold(0.0, f64::max)
    };
    let (taut, slack) = (peak("--slack-m=0"), peak("--slack-m=0.3"));
    assert!(slack > 2.0 * taut, "{taut} {slack}");
}

#[test]
fn a_swinging_ball_hits_the_trunk_with_the_speed_of_its_fall() {
    for height_m in [0.1_f64, 0.4] {
        let height = format!("--release-height-m={height_m}");
        let scenario = scenario("pendulum", &["--duration-s=2", "--at-s=0.5", &height]);
        let trace = trace(&scenario, 0);
        let hit = trace.events.iter().find(|event| event.text.starts_with("the ball hits")).unwrap();
        let speed: f64 =
            hit.text.strip_prefix("the ball hits trunk at ").unwrap().trim_end_matches(" m/s").parse().unwrap();
        let expected = (2.0 * 9.81 * height_m).sqrt();
        assert!((speed / expected - 1.0).abs() < 0.04, "{}, expected {expected:.2} m/s", hit.text);
        // 3 kg that come with 2.8 m/s and bounce off give between one and two times their momentum in the first blow.
        let Scenario::Pendulum(pendulum) = &scenario else { panic!() };
        let push = pendulum.impact(&trace).unwrap().push;
        assert!(push[1] > 0.1 && push[1] < expected && push[0].abs() < 1e-9, "{push:?}");
    }
}

#[test]
fn rubble_is_clear_of_the_robot_at_its_start_and_lies_still() {
    for seed in 0..3 {
        let trace = trace(&scenario("rubble", &["--duration-s=0.5"]), seed);
        assert!(trace.frames.iter().all(|frame| frame.peak_obstacle_force_n == 0.0));
        let (first, last) = (&trace.frames[0].bodies, &trace.frames[29].bodies);
        // The blocks are the last bodies.
        let still = first
            .iter()
            .zip(last)
            .rev()
            .take(40)
            .all(|(a, b)| (0..3).all(|k| (a.position[k] - b.position[k]).abs() < 2e-3));
        assert!(still, "seed {seed}");
    }
}

#[test]
fn a_seed_is_a_scene_and_another_seed_another_one() {
    for name in ["rubble", "outdoor", "terrain"] {
        let scene = |seed| script(&scenario(name, &["--duration-s=1"]), seed).scene;
        assert!(scene(3) == scene(3) && scene(3) != scene(4), "{name}");
    }
}

/// Returns the script of an empty field whose end lies behind the robot at once.
fn crossed(half_width_m: f64) -> Script {
    let mut script = script(&scenario("rubble", &["--duration-s=1", "--blocks=0", "--mats=0"]), 0);
    let goal = script.goal.as_mut().unwrap();
    assert_eq!(goal.half_width_m, 1.2);
    (goal.ahead_m, goal.half_width_m) = (-1.0, half_width_m);
    script
}

#[test]
fn getting_past_an_obstacle_is_an_event_and_happens_once_from_each_start() {
    let mut rollout = playback(&crossed(1.2));
    let mut successes = || {
        let events = rollout.by_ref().take(30).flat_map(|played| played.events);
        let found: Vec<_> = events.filter(|event| event.kind == EventKind::Success).map(|event| event.text).collect();
        rollout.restart().unwrap();
        found
    };
    // Put back to its start, it gets there again.
    assert_eq!([successes(), successes()], [["got across the rubble"]; 2]);
    // As if the robot had gone round.
    assert!(!playback(&crossed(0.0)).trace().reached_goal());
}

#[test]
fn crossed_field_ends_a_second_later() {
    let seconds = |name: &str, options: &[&str]| {
        let mut script = script(&scenario(name, options), 0);
        script.goal.as_mut().unwrap().ahead_m = -10.0;
        let trace = playback(&script).trace();
        assert!(trace.reached_goal(), "{name}");
        trace.frames.last().unwrap().time_s
    };
    // Across in the first step of 1/60 s.
    for (name, options) in [("rubble", &["--duration-s=3", "--blocks=0", "--mats=0"][..]), ("ball-pit", &["--balls=4"])]
    {
        assert!((seconds(name, options) - 1.0 - 1.0 / 60.0).abs() < 1e-9, "{name}");
    }
    assert!((seconds("box", &["--duration-s=3"]) - 3.0).abs() < 1e-9);
}

#[test]
fn the_end_of_a_trace_has_all_that_comes_after_a_time_and_no_more() {
    let trace = trace(&scenario("push", &["--duration-s=1", "--at-s=0.5"]), 0);
    assert_eq!(trace.after(-1.0), trace);
    let pushed_s = trace.events[0].time_s;
    let end = trace.after(pushed_s);
    let before = trace.frames.iter().filter(|frame| frame.time_s <= pushed_s).count();
    assert!(before > 0);
    assert_eq!(end.frames, trace.frames[before..]);
    assert!(end.events.len() < trace.events.len());
}
