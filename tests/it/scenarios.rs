//! One list of properties over every scenario.

use clap::{FromArgMatches, Subcommand};
use supple::config::flat_parameters;
use supple::mujoco::Kind;
use supple::scenario::catalog::{DEFAULTS, Scenario};
use supple::scenario::estimation::Estimation;
use supple::scenario::{Rollout, Sensing};
use supple::trace::Trace;

use crate::support::standing_policy;

/// A scenario from its defaults and a few changes, as the program would build it.
fn scenario(name: &str, changes: &[&str]) -> Scenario {
    let (_, text) = DEFAULTS.iter().find(|(known, _)| *known == name).unwrap();
    let mut line = vec!["scenario".to_owned(), name.to_owned()];
    for (key, value) in flat_parameters(name, text).unwrap() {
        let flag = format!("--{}", key.replace('_', "-"));
        if !changes.iter().any(|change| change.starts_with(&format!("{flag}="))) {
            line.push(format!("{flag}={value}"));
        }
    }
    line.extend(changes.iter().map(ToString::to_string));
    let command = Scenario::augment_subcommands(clap::Command::new("scenario"));
    Scenario::from_arg_matches(&command.get_matches_from(line)).unwrap()
}

fn trace(scenario: &Scenario, seed: u64) -> Trace {
    trace_with(scenario, seed, Sensing::True)
}

fn trace_with(scenario: &Scenario, seed: u64, sensing: Sensing) -> Trace {
    let policy = standing_policy();
    let script = scenario.script(seed, &policy.provenance.config).unwrap();
    let rollout = Rollout::new(&script, &policy.provenance.config, Box::new(policy.controller()), true).unwrap();
    rollout.with_sensing(sensing, seed).unwrap().trace()
}

/// Every scenario, cut short.
fn all() -> Vec<Scenario> {
    DEFAULTS
        .iter()
        .map(|(name, _)| match *name {
            "push" | "leash" => scenario(name, &["--duration-s=2", "--at-s=0.5"]),
            _ => scenario(name, &["--duration-s=1"]),
        })
        .collect()
}

#[test]
fn the_same_seed_gives_the_same_trace_bit_for_bit() {
    for scenario in all() {
        assert_eq!(trace(&scenario, 3), trace(&scenario, 3), "{}", scenario.name());
    }
}

#[test]
fn traces_are_whole_and_finite_and_metrics_in_range() {
    let config = standing_policy().provenance.config;
    for scenario in all() {
        let trace = trace(&scenario, 1);
        let name = scenario.name();
        assert_eq!(trace.frames.len(), (scenario.task().duration_s * 60.0) as usize, "{name}: {:?}", trace.events);
        for frame in &trace.frames {
            let numbers = [frame.height_m, frame.power_w, frame.torque_n_m, frame.reward, frame.peak_foot_force_n];
            assert!(numbers.iter().all(|number| number.is_finite()), "{name}");
            assert!(frame.power_w >= 0.0 && frame.reward >= 0.0 && frame.reward <= 1.3, "{name}");
        }
        for metric in scenario.metrics(&scenario.script(1, &config).unwrap(), &trace) {
            assert!(metric.value.is_none_or(f64::is_finite), "{name}: {metric:?}");
        }
    }
}

#[test]
fn estimates_are_deterministic_and_finite_in_every_scenario() {
    for scenario in all() {
        let (name, trace) = (scenario.name(), trace_with(&scenario, 3, Sensing::Estimated));
        assert_eq!(trace, trace_with(&scenario, 3, Sensing::Estimated), "{name}");
        assert_eq!(trace.frames.len(), (scenario.task().duration_s * 60.0) as usize, "{name}: {:?}", trace.events);
        for frame in &trace.frames {
            let sensed = frame.sensed.unwrap();
            let numbers = sensed.velocity.iter().chain(&sensed.position).chain([&sensed.height_m]);
            assert!(numbers.copied().all(f64::is_finite), "{name}: {sensed:?}");
        }
        let metrics = Estimation::metrics(&trace);
        assert!(metrics.iter().all(|metric| metric.value.is_some_and(f64::is_finite)), "{name}: {metrics:?}");
    }
}

#[test]
fn estimates_stay_finite_when_the_robot_is_thrown() {
    let far = scenario("push", &["--duration-s=3", "--at-s=0.2", "--push-m-s=20", "--direction-deg=120"]);
    let trace = trace_with(&far, 1, Sensing::Estimated);
    assert!(trace.fall().is_some());
    for frame in &trace.frames {
        let sensed = frame.sensed.unwrap();
        assert!(sensed.velocity.iter().chain(&sensed.position).all(|number| number.abs() < 1e4), "{sensed:?}");
    }
}

#[test]
fn every_element_of_every_scene_has_a_name() {
    let config = standing_policy().provenance.config;
    for scenario in all() {
        let model = scenario.script(0, &config).unwrap().scene.compile_visual().unwrap();
        for kind in [Kind::Body, Kind::Joint, Kind::Geom, Kind::HeightField] {
            for id in 0..model.count(kind) {
                assert!(!model.name(kind, id).is_empty(), "{}: {kind:?} {id} has no name", scenario.name());
            }
        }
    }
}

#[test]
fn the_box_weighs_2_kg_and_is_a_half_metre_cube() {
    let config = standing_policy().provenance.config;
    let model = scenario("box", &[]).script(0, &config).unwrap().scene.compile().unwrap();
    let body = model.id(Kind::Body, "box").unwrap();
    assert_eq!(model.body_mass()[body], 2.0);
    assert_eq!(model.geom(model.id(Kind::Geom, "box").unwrap()).size, [0.25; 3]);
}

#[test]
fn the_ball_pit_has_400_balls_of_half_a_kilogram_3_cm_apart() {
    let config = standing_policy().provenance.config;
    let model = scenario("ball-pit", &[]).script(0, &config).unwrap().scene.compile().unwrap();
    let balls: Vec<usize> = (0..400).map(|ball| model.id(Kind::Body, &format!("ball_{ball}")).unwrap()).collect();
    assert!(model.id(Kind::Body, "ball_400").is_err());
    assert!(balls.iter().all(|ball| model.body_mass()[*ball] == 0.5));
    let geom = |ball: usize| model.geom(model.id(Kind::Geom, &format!("ball_{ball}")).unwrap());
    assert_eq!(geom(0).size[0], 0.05);
}

#[test]
fn a_push_changes_the_velocity_by_its_size_in_its_direction() {
    let scenario = scenario("push", &["--duration-s=2", "--at-s=0.5", "--push-m-s=0.4", "--direction-deg=90"]);
    let config = standing_policy().provenance.config;
    let script = scenario.script(2, &config).unwrap();
    let trace = trace(&scenario, 2);
    let first = trace.frames.iter().find(|frame| frame.disturbance.is_some()).unwrap();
    assert!((first.time_s - script.pushes[0].time_s).abs() < 1.5 / 60.0);
    // One policy step later the feet have already taken some of it away.
    let left = first.velocity_in_heading[1];
    assert!(left > 0.1 && left < 0.45, "{left}");
}

#[test]
fn odd_numbers_of_balls_and_strong_leashes_do_not_crash() {
    for balls in ["--balls=0", "--balls=1"] {
        let trace = trace(&scenario("ball-pit", &["--duration-s=0.5", balls]), 0);
        assert_eq!(trace.frames.len(), 30);
    }
    for force in ["--force-n=50", "--force-n=500"] {
        let trace = trace(&scenario("leash", &["--duration-s=4", "--at-s=0.5", force]), 0);
        assert!(!trace.frames.is_empty() && trace.events.iter().all(|event| !event.text.contains("unstable")));
    }
}
