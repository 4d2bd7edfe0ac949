//! The experiments E0 to E17, one file each: its conditions, its quantities, and its section of the report.

pub mod ball_pit;
pub mod commanded_compliance;
mod crossing;
pub mod decay;
pub mod directions;
pub mod felt;
pub mod free_box;
pub mod lead;
pub mod leash;
pub mod outdoor;
pub mod pendulum;
pub mod pull;
pub mod pulley;
mod push;
pub mod push_grid;
pub mod rubble;
pub mod set_point;
pub mod shove;
pub mod table4;
pub mod terrain;
mod velocity;
pub mod walk;
pub mod wall;

use serde::{Deserialize, Serialize};

use super::{Condition, Experiment};
use supple::scenario::catalog::{ParameterError, Scenario, in_range};

/// The imports that every experiment needs.
mod prelude {
    pub use serde::{Deserialize, Serialize};

    pub(super) use super::{check_directions, conditions, gait, indicator, pairs};
    pub use crate::plot::polar::{Scales, evenly};
    pub use crate::section_builder::{ConditionGroup, SectionBuilder};
    pub use crate::statistics::Expected::{Higher, Lower};
    pub use crate::trial::Trial;
    pub use crate::{Condition, Experiment, ExperimentInfo, FELL, Quantity, TrialValues};
    pub use supple::config::ConfigError;
    pub use supple::scenario::catalog::{ParameterError, Scenario, Task, defaults, in_range};
    pub use supple::scenario::metrics;
    pub use supple::util::numbers::brief;
}

/// Defines [`Protocol`] from the list of experiments: section of the protocol, and type of the parameters.
macro_rules! protocol {
    ($($(#[$attribute:meta])* $section:ident: $Experiment:ty;)*) => {
        /// Every experiment with its parameters, in the order of the report.
        ///
        /// In all of them, `trials` are those of each policy in each condition, `commands_m_s` go forward (0 is standing), and
        /// `directions` is a number that divides the circle evenly. A pull starts `at_s`, which each trial delays by up to 0.65 s,
        /// for `for_s`, and is averaged over `average_s` at its end.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        #[allow(missing_docs)]
        pub struct Protocol {
            $($(#[$attribute])* pub $section: $Experiment,)*
        }

        impl Protocol {
            /// Returns the experiments in the order of the report.
            pub fn experiments(&self) -> Vec<&dyn Experiment> {
                vec![$(&self.$section),*]
            }
        }
    };
}

protocol! {
    walk: walk::Walk;
    push_grid: push_grid::PushGrid;
    decay: decay::Decay;
    table4: table4::Table4;
    directions: directions::Directions;
    leash: leash::Leash;
    r#box: free_box::FreeBox;
    ball_pit: ball_pit::BallPit;
    terrain: terrain::Terrain;
    pulley: pulley::Pulley;
    pendulum: pendulum::Pendulum;
    rubble: rubble::Rubble;
    outdoor: outdoor::Outdoor;
    calibration: commanded_compliance::CommandedCompliance;
    pull: pull::PullSurvival;
    wall: wall::Wall;
    lead: lead::Lead;
    felt: felt::Felt;
    shove: shove::Shove;
    set_point: set_point::SetPoint;
}

/// Returns the name of the gait at a forward command \[m/s\].
fn gait(command_m_s: f64) -> &'static str {
    if command_m_s == 0.0 { "standing" } else { "walking" }
}

/// Returns a condition for each value, with the label and the scenario that `of` gives it.
fn conditions<T>(values: impl IntoIterator<Item = T>, of: impl Fn(T) -> (String, Scenario)) -> Vec<Condition> {
    values.into_iter().map(of).map(|(label, scenario)| Condition { label, scenario }).collect()
}

/// Returns every pair of a first and a second value; the second changes faster.
fn pairs(first: &[f64], second: &[f64]) -> Vec<(f64, f64)> {
    first.iter().flat_map(|a| second.iter().map(|b| (*a, *b))).collect()
}

/// Checks the number of directions: at least three, so that sides can be distinguished.
fn check_directions(count: u32) -> Result<(), ParameterError> {
    in_range("directions", f64::from(count), 3.0, 360.0, "3 to 360")
}

/// Returns 1 for true and 0 for false.
fn indicator(is: bool) -> Option<f64> {
    Some(f64::from(u8::from(is)))
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use super::*;
    use crate::plot::png::Renderer;
    use crate::results::Results;
    use crate::section_content::Row;
    use crate::trial::{Sample, Trial, TrialEnd};
    use crate::{Quantity, TrialValues};
    use supple::config::Config;
    use supple::scenario::Script;
    use supple::scenario::catalog::Scenario;
    use supple::scenario::trace::{Event, EventKind, Frame, Pose, Trace};

    /// Returns a trace at 60 Hz of a robot with a constant velocity in the heading frame.
    fn steady(duration_s: f64, velocity_in_heading: [f64; 3]) -> Trace {
        let period_s = 1.0 / 60.0;
        let steps = 1..=(duration_s / period_s).round() as usize;
        let frame = |step| Frame { time_s: step as f64 * period_s, velocity_in_heading, ..Frame::default() };
        Trace { period_s, weight_n: 128.5, frames: steps.map(frame).collect(), events: Vec::new() }
    }

    /// Returns results of sets of two seeds in which every trial gave the same sample.
    fn results(experiment: &dyn Experiment, sample: &Sample, sets: usize) -> Results {
        let conditions = experiment.conditions().unwrap();
        let policy = vec![vec![sample.clone(); experiment.info().trials as usize]; conditions.len()];
        let set = || BTreeMap::from([(0, policy.clone()), (1, policy.clone())]);
        let names = ["a", "b", "c", "d", "e"][..sets].iter().map(ToString::to_string).collect();
        let quantities = experiment.info().quantities;
        Results { names, conditions, quantities, sets: (0..sets).map(|_| set()).collect() }
    }

    #[test]
    fn experiments_share_no_number() {
        let protocol = Protocol::full().unwrap();
        let mut numbers: Vec<u64> =
            protocol.experiments().iter().map(|experiment| experiment.info().number.into()).collect();
        numbers.sort_unstable();
        assert!(numbers.windows(2).all(|pair| pair[0] < pair[1]), "{numbers:?}");
    }

    #[test]
    fn every_experiment_reports_claims_and_figures_without_values() {
        let protocol = Protocol::quick().unwrap();
        let renderer = Renderer::default();
        for experiment in protocol.experiments() {
            for (value, sets) in [(None, 2), (Some(0.5), 2), (Some(0.5), 5)] {
                let values = vec![value; experiment.info().quantities.len()];
                let sample = Sample::new(TrialEnd::Upright, values);
                let content = experiment.content(&results(experiment, &sample, sets));
                let name = experiment.info().name;
                assert!(!content.claims.is_empty() && !content.tables.is_empty(), "{name}");
                // A report removes outdated files by the experiment's name.
                let figures = content.figures.iter().map(|figure| &figure.name);
                let tables = content.tables.iter().map(|table| &table.name);
                let lines = content.lines.iter().map(|lines| &lines.name);
                assert!(figures.chain(tables).chain(lines).all(|file| file.starts_with(name)));
                // `summary.json` has every number, for it has every table.
                let rows: Vec<&Row> = content.tables.iter().flat_map(|table| &table.rows).collect();
                assert!(rows.iter().all(|row| row.comparison.sets.len() == sets));
                let found: BTreeSet<_> = rows.iter().map(|row| (row.condition.as_str(), row.quantity.name)).collect();
                for condition in experiment.conditions().unwrap() {
                    let missing = |quantity: &&Quantity| !found.contains(&(condition.label.as_str(), quantity.name));
                    assert!(!experiment.info().quantities.iter().any(|it| missing(&it)), "{name}: {}", condition.label);
                }
                for figure in &content.figures {
                    assert!(!figure.svg.contains("NaN") && !figure.svg.contains("inf"), "{}", figure.name);
                    // Rendering is slow.
                    if sets == 2 {
                        renderer.png(&figure.svg).unwrap();
                    }
                }
            }
        }
    }

    /// Returns the scenario and the script of seed 0 in the first condition.
    fn script(experiment: &dyn Experiment) -> (Scenario, Script) {
        let scenario = experiment.conditions().unwrap().remove(0).scenario;
        let script = scenario.script(0, &Config::load("compliant").unwrap()).unwrap();
        (scenario, script)
    }

    fn measured(experiment: &dyn Experiment, trace: &Trace) -> TrialValues {
        let (scenario, script) = script(experiment);
        experiment.measure(&Trial::new(&scenario, &script, trace))
    }

    #[test]
    fn every_experiment_measures_all_its_quantities() {
        let mut trace = steady(12.0, [0.4, 0.0, 0.0]);
        for fell in [false, true] {
            if fell {
                trace.events.push(Event { time_s: 1.0, kind: EventKind::Fall, text: String::new() });
            }
            for experiment in Protocol::quick().unwrap().experiments() {
                let measured = measured(experiment, &trace);
                assert_eq!(measured.values.len(), experiment.info().quantities.len(), "{}", experiment.info().name);
                assert!(measured.values.iter().flatten().all(|value| value.is_finite()));
                for (quantity, value) in experiment.info().quantities.iter().zip(measured.values) {
                    let is_fraction = quantity.unit != "%" || value.is_none_or(|part| (0.0..=1.0).contains(&part));
                    assert!(is_fraction, "{}: {} is {value:?}", experiment.info().name, quantity.name);
                }
            }
        }
    }

    #[test]
    fn power_before_and_after_are_means_over_their_second() {
        let protocol = Protocol::full().unwrap();
        let push_s = script(&protocol.table4).1.pushes().next().unwrap().at_s;
        let mut trace = steady(8.0, [0.5, 0.0, 0.0]);
        for frame in &mut trace.frames {
            let since_s = frame.time_s - push_s;
            // 80 W until the push, then 140 W falling by 10 W in a second: 135 W on average.
            frame.power_w = if since_s < 0.0 { 80.0 } else { 140.0 - 10.0 * since_s };
            frame.torque_n_m = if since_s < 0.0 { 25.0 } else { 26.0 };
        }
        let values: Vec<f64> = measured(&protocol.table4, &trace).values.into_iter().flatten().collect();
        assert!((values[0] - 80.0).abs() < 1.0 && (values[1] - 135.0).abs() < 1.0, "{values:?}");
        assert!((values[3] - 25.0).abs() < 0.1 && (values[4] - 26.0).abs() < 0.1, "{values:?}");
        // What the push adds.
        assert!((values[2] - 55.0).abs() < 1.0 && (values[5] - 1.0).abs() < 0.1, "{values:?}");
        assert_eq!(values[6], 0.0);
    }

    #[test]
    fn course_is_resumed_in_the_starting_direction_only() {
        let protocol = Protocol::full().unwrap();
        let resumed = |yaw: f64| {
            let mut trace = steady(20.0, [0.4, 0.0, 0.0]);
            for frame in &mut trace.frames {
                frame.position = [0.4 * frame.time_s, 0.0, 0.3];
                frame.goal = Some(Pose { position: [1.5, 1.0, 0.25], quaternion: [1.0, 0.0, 0.0, 0.0] });
                frame.obstacle_contact_s = 0.01;
                frame.roll_pitch_yaw[2] = yaw;
            }
            let values = measured(&protocol.r#box, &trace).values;
            assert_eq!((values[0], values[5]), (Some(0.0), Some(1.0)));
            values[6]
        };
        // Walking off at 60° to its course, it is 0.4 m/s away from its command.
        assert_eq!((resumed(0.0), resumed(60.0_f64.to_radians())), (Some(1.0), Some(0.0)));
    }

    #[test]
    fn peak_foot_force_ignores_first_steps_and_later_ground() {
        let protocol = Protocol::full().unwrap();
        let mut trace = steady(14.0, [0.4, 0.0, 0.0]);
        for frame in &mut trace.frames {
            frame.position[0] = 0.4 * frame.time_s;
            // Balls lie from 0.6 to 3.2 m, rubble from 0.6 to 4.6 m.
            frame.peak_foot_force_n = match frame.position[0] {
                ..0.55 => 150.0,
                1.0..2.0 => 120.0,
                5.0.. => 130.0,
                _ => 100.0,
            };
        }
        trace.events.push(Event { time_s: 13.0, kind: EventKind::Success, text: String::new() });
        let peak = |experiment: &dyn Experiment| {
            let index =
                experiment.info().quantities.iter().position(|quantity| quantity.name == "peak_foot_force_n").unwrap();
            measured(experiment, &trace).values[index]
        };
        assert_eq!((peak(&protocol.walk), peak(&protocol.terrain)), (Some(130.0), Some(130.0)));
        assert_eq!((peak(&protocol.ball_pit), peak(&protocol.rubble)), (Some(120.0), Some(120.0)));
    }

    #[test]
    fn fault_after_the_goal_is_no_success_and_has_no_numbers() {
        let protocol = Protocol::full().unwrap();
        let mut trace = steady(14.0, [0.4, 0.0, 0.0]);
        for frame in &mut trace.frames {
            frame.position[0] = 0.4 * frame.time_s;
            // Of the ball on its string, which has no goal.
            frame.peak_obstacle_force_n = if frame.time_s > 3.0 { 50.0 } else { 0.0 };
        }
        trace.events.push(Event { time_s: 13.0, kind: EventKind::Success, text: String::new() });
        let [pit, rubble, pendulum]: [&dyn Experiment; 3] = [&protocol.ball_pit, &protocol.rubble, &protocol.pendulum];
        let numbers = |experiment: &dyn Experiment, trace: &Trace| {
            measured(experiment, trace).values.iter().filter(|value| value.is_some()).count()
        };
        assert_eq!((numbers(pit, &trace), numbers(rubble, &trace)), (6, 5));
        trace.events.push(Event { time_s: 13.5, kind: EventKind::Fault, text: String::new() });
        assert_eq!((numbers(pit, &trace), numbers(rubble, &trace), numbers(pendulum, &trace)), (1, 2, 0));
        assert_eq!(measured(pit, &trace).values[0], Some(0.0));
        assert_eq!(measured(rubble, &trace).values[..2], [Some(0.0); 2]);
    }

    #[test]
    fn standing_robots_have_a_decay_with_a_commanded_compliance_too() {
        let protocol = Protocol::full().unwrap();
        let (scenario, mut script) = script(&protocol.directions);
        script.command.compliance = Some(0.03);
        let trace = steady(8.0, [0.0; 3]);
        let values = protocol.directions.measure(&Trial::new(&scenario, &script, &trace)).values;
        assert_eq!((values.len(), values[5]), (6, Some(0.0)));
    }

    #[test]
    fn fall_after_the_window_changes_no_power() {
        let protocol = Protocol::full().unwrap();
        let push_s = script(&protocol.table4).1.pushes().next().unwrap().at_s;
        let power = |fall_s: f64| {
            let end_s = push_s + fall_s;
            let mut trace = steady(end_s, [0.5, 0.0, 0.0]);
            trace.frames.iter_mut().for_each(|frame| frame.power_w = 20.0);
            trace.events.push(Event { time_s: end_s, kind: EventKind::Fall, text: String::new() });
            let values = measured(&protocol.table4, &trace).values;
            [values[0], values[1]]
        };
        let near = |found: Option<f64>| found.is_some_and(|found| (found - 20.0).abs() < 1e-9);
        assert!(power(1.1).into_iter().all(near));
        let [before, after] = power(0.5);
        assert!(near(before) && after.is_none());
    }

    #[test]
    fn fall_after_the_watch_counts_as_success() {
        let protocol = Protocol::full().unwrap();
        let push_s = script(&protocol.push_grid).1.pushes().next().unwrap().at_s;
        let success = |fall_s: f64| {
            let mut trace = steady(push_s + fall_s, [0.5, 0.0, 0.0]);
            trace.events.push(Event { time_s: push_s + fall_s, kind: EventKind::Fall, text: String::new() });
            measured(&protocol.push_grid, &trace).values[0]
        };
        // It is watched for 3 s.
        assert_eq!(success(2.9), Some(0.0));
        assert_eq!(success(3.1), Some(1.0));
    }
}
