//! E15: the force that the robot feels on its trunk, against the true one (src/estimate/external_force.rs).

use super::prelude::*;
use crate::plot::curves::{self, Curve};
use crate::section_content::{Claim, number};
use crate::sensing;
use crate::statistics::{Spread, mean};
use supple::scenario::Script;
use supple::scenario::catalog::{Leash, Pendulum, Pulley, PushTrunk, TerrainKind, UnevenGround, Walk};
use supple::scenario::trace::{Felt as FeltForces, Frame};

const QUANTITIES: &[Quantity] = &[
    Quantity::new("rmse_n", "felt against true force, RMSE", "N", 2),
    Quantity::new("felt_n", "felt along the true force", "N", 1),
    Quantity::new("gain", "felt over true force", "", 2),
    Quantity::new("mean_n", "mean", "N", 2),
    Quantity::new("sd_n", "standard deviation", "N", 2),
    Quantity::new("q95_n", "95 % quantile", "N", 2),
    Quantity::new("in_doubt", "frames in doubt", "%", 1),
    FELL,
];

/// The number of quantities of pulled robots; those of robots without a pull follow.
const OF_PULLS: usize = 3;

/// The time after which a pull is steady: five time constants of the felt force \[s\].
const STEADY_S: f64 = 0.5;

/// The time after a push or blow over which forces are compared \[s\].
const BLOW_S: f64 = 1.0;

/// The time before a fall that does not count: a falling robot may touch the ground with anything \[s\].
const BEFORE_FALL_S: f64 = 0.5;

/// The least time over which a force is measured \[s\].
const LEAST_S: f64 = 0.25;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Felt {
    /// The forward commands of the pulled robots \[m/s\]; 0 is standing.
    pub commands_m_s: Vec<f64>,
    pub forces_n: Vec<f64>,
    pub directions: u32,
    pub at_s: f64,
    pub for_s: f64,
    /// The directions of pushes, and of pulls by a weight: 0 ahead, 90 left \[deg\].
    pub sides_deg: Vec<f64>,
    /// The release heights of the pendulum \[m\].
    pub heights_m: Vec<f64>,
    /// The commands of the undisturbed walks: forward \[m/s\], left \[m/s\], yaw rate \[rad/s\].
    pub walks: Vec<[f64; 3]>,
    /// The inclines of the slopes, rise over run.
    pub inclines: Vec<f64>,
    /// The height of the uneven ground, peak to peak \[m\].
    pub terrain_m: f64,
    /// The masses added to the trunk but not to the observer's model \[kg\].
    pub extra_masses_kg: Vec<f64>,
    /// The rolling frictions of the feet \[m\].
    pub rolling_m: Vec<f64>,
    pub trials: u32,
}

/// The part of a group's conditions in the claims.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    /// Steady pulls.
    Steady,
    /// Other pulls and blows.
    Pulled,
    /// Walks on flat ground without a pull.
    Calm,
    /// Slopes and other masses without a pull.
    Other,
    /// Obstacles under the feet without a pull.
    Rough,
}

/// Conditions that are averaged, with their name.
struct Group {
    name: String,
    role: Role,
    conditions: Vec<Condition>,
}

impl Group {
    /// Creates a group with a condition for each value; `of` gives it the label within the group, and the scenario.
    fn new<T>(
        name: impl Into<String>,
        role: Role,
        values: impl IntoIterator<Item = T>,
        of: impl Fn(T) -> (String, Scenario),
    ) -> Self {
        let name = name.into();
        let conditions = conditions(values, |value| {
            let (label, scenario) = of(value);
            (if label.is_empty() { name.clone() } else { format!("{name}, {label}") }, scenario)
        });
        Group { name, role, conditions }
    }
}

impl Felt {
    /// Returns the conditions by group, in their order.
    fn groups(&self) -> Result<Vec<Group>, ConfigError> {
        let (leash, walk, terrain): (Leash, Walk, UnevenGround) =
            (defaults("leash")?, defaults("walk")?, defaults("terrain")?);
        let (push, pulley, pendulum): (PushTrunk, Pulley, Pendulum) =
            (defaults("push")?, defaults("pulley")?, defaults("pendulum")?);
        let (at_s, for_s) = (self.at_s, self.for_s);
        // What the observer does not know: the mass on the trunk [kg], and the rolling friction of the feet [m].
        let pull = |forward_m_s: f64, force_n: f64, direction_deg: f64, [extra_mass_kg, rolling_m]: [f64; 2]| {
            let task = Task { forward_m_s, duration_s: at_s + for_s, extra_mass_kg, rolling_m, ..leash.task.clone() };
            Scenario::Leash(Leash { task, force_n, direction_deg, at_s, for_s, set_point_per_s: 0.0 })
        };
        let undisturbed = |[forward_m_s, left_m_s, yaw_rad_s]: [f64; 3], [extra_mass_kg, rolling_m]: [f64; 2]| {
            let task = Task { forward_m_s, left_m_s, yaw_rad_s, extra_mass_kg, rolling_m, ..walk.task.clone() };
            Scenario::Walk(Walk { task })
        };
        let gaits = [0.0, 0.5];
        let by_side = pairs(&gaits, &self.sides_deg);
        let side_label = |(command, side): (f64, f64)| format!("{}, {side:.0}°", gait(command));
        let mut groups = Vec::new();
        for command in &self.commands_m_s {
            let each = pairs(&self.forces_n, &evenly(self.directions));
            let speed = if *command == 0.0 { gait(0.0).to_owned() } else { format!("{command} m/s") };
            groups.push(Group::new(format!("pulled, {speed}"), Role::Steady, each, |(force, side)| {
                (format!("{force} N, {side:.0}°"), pull(*command, force, side, [0.0; 2]))
            }));
        }
        groups.push(Group::new("pushed", Role::Pulled, by_side.clone(), |(forward_m_s, direction_deg)| {
            // The seed delays a push by up to 0.65 s.
            let duration_s = at_s + metrics::PHASE_S + BLOW_S + 0.1;
            let task = Task { forward_m_s, duration_s, ..push.task.clone() };
            let scenario = Scenario::Push(PushTrunk { task, direction_deg, at_s, ..push });
            (side_label((forward_m_s, direction_deg)), scenario)
        }));
        groups.push(Group::new("pulled by a weight", Role::Pulled, by_side.clone(), |(forward_m_s, direction_deg)| {
            let task = Task { forward_m_s, duration_s: pulley.at_s + pulley.for_s, ..pulley.task.clone() };
            let scenario = Scenario::Pulley(Pulley { task, direction_deg, ..pulley.clone() });
            (side_label((forward_m_s, direction_deg)), scenario)
        }));
        let heights = pairs(&gaits, &self.heights_m);
        groups.push(Group::new("hit by a ball", Role::Pulled, heights, |(forward_m_s, release_height_m)| {
            let task = Task { forward_m_s, duration_s: pendulum.at_s + 3.0, ..pendulum.task.clone() };
            let label = format!("{}, {:.0} cm", gait(forward_m_s), 100.0 * release_height_m);
            (label, Scenario::Pendulum(Pendulum { task, release_height_m, ..pendulum.clone() }))
        }));
        groups.push(Group::new("undisturbed", Role::Calm, &self.walks, |command| {
            (super::walk::label(*command), undisturbed(*command, [0.0; 2]))
        }));
        groups.push(Group::new("slopes", Role::Other, &self.inclines, |incline| {
            let slope = UnevenGround { kind: TerrainKind::Slope, incline: *incline, ..terrain.clone() };
            (format!("{:+.0} %", 100.0 * incline).replace('-', "−"), Scenario::Terrain(slope))
        }));
        let uneven = UnevenGround { height_m: self.terrain_m, frequency_per_m: 2.0, ..terrain.clone() };
        for (name, scenario) in [
            ("ball pit".to_owned(), Scenario::BallPit(defaults("ball-pit")?)),
            ("rubble".to_owned(), Scenario::Rubble(defaults("rubble")?)),
            (format!("ground of {:.0} cm", 100.0 * self.terrain_m), Scenario::Terrain(uneven)),
        ] {
            groups.push(Group::new(name, Role::Rough, [scenario], |scenario| (String::new(), scenario)));
        }
        let masses = self
            .extra_masses_kg
            .iter()
            .map(|mass| (format!("{mass:+} kg on the trunk").replace('-', "−"), [*mass, 0.0]));
        let rolling = self
            .rolling_m
            .iter()
            .map(|rolling| (format!("{} mm of rolling friction", 1000.0 * rolling), [0.0, *rolling]));
        for (name, unknown) in masses.chain(rolling) {
            groups.push(Group::new(format!("{name}, pulled"), Role::Pulled, by_side.clone(), |(command, side)| {
                (format!("{}, 20 N, {side:.0}°", gait(command)), pull(command, 20.0, side, unknown))
            }));
            groups.push(Group::new(format!("{name}, undisturbed"), Role::Other, gaits, |forward| {
                (gait(forward).to_owned(), undisturbed([forward, 0.0, 0.0], unknown))
            }));
        }
        Ok(groups)
    }
}

/// Returns true if the trial has a pull or blow, and the time over which forces are compared \[s\]; none if no blow landed.
fn window_s(trial: &Trial) -> (bool, Option<[f64; 2]>) {
    let pulled_s = match trial.scenario {
        Scenario::Leash(leash) => Some([leash.at_s + STEADY_S, leash.at_s + leash.for_s]),
        Scenario::Pulley(pulley) => Some([pulley.at_s + STEADY_S, pulley.at_s + pulley.for_s]),
        Scenario::Push(_) => trial.script.pushes().next().map(|push| [push.at_s, push.at_s + BLOW_S]),
        Scenario::Pendulum(pendulum) => {
            pendulum.impact(trial.trace).map(|impact| [impact.time_s, impact.time_s + BLOW_S])
        }
        _ => return (false, Some([metrics::SETTLE_S, trial.script.duration_s])),
    };
    (true, pulled_s)
}

/// Returns the forces that are not in doubt, and the fraction that is, over a time that ends half a second before a fall.
fn forces(trial: &Trial, [from_s, until_s]: [f64; 2]) -> (Vec<FeltForces>, Option<f64>) {
    let fall_s = trial.trace.fall().map_or(f64::INFINITY, |fall| fall.time_s - BEFORE_FALL_S);
    let felt = |frame: &Frame| frame.felt;
    let all: Vec<FeltForces> = metrics::window(trial.trace, from_s, until_s.min(fall_s)).filter_map(felt).collect();
    let doubted = mean(all.iter().map(|felt| f64::from(u8::from(felt.doubt.is_some()))));
    let trusted: Vec<FeltForces> = all.into_iter().filter(|felt| felt.doubt.is_none()).collect();
    let is_long = trusted.len() as f64 * trial.trace.period_s >= LEAST_S;
    (if is_long { trusted } else { Vec::new() }, doubted)
}

/// Returns the felt minus the true force, forward and left \[N\].
fn error(felt: &FeltForces) -> [f64; 2] {
    std::array::from_fn(|axis| felt.force[axis] - felt.true_force[axis])
}

/// Returns RMSE \[N\], felt force along the true one \[N\] and gain under a pull, in the horizontal plane.
fn while_pulled(forces: &[FeltForces]) -> [Option<f64>; OF_PULLS] {
    let product = |a: &[f64], b: &[f64]| a[0] * b[0] + a[1] * b[1];
    let squares = mean(forces.iter().map(|felt| product(&error(felt), &error(felt))));
    let works = mean(forces.iter().map(|felt| product(&felt.force, &felt.true_force)));
    let truths = mean(forces.iter().map(|felt| product(&felt.true_force, &felt.true_force)));
    let along = works.zip(truths).filter(|(_, truth)| *truth > 0.0);
    [squares.map(f64::sqrt), along.map(|(work, truth)| work / truth.sqrt()), along.map(|(work, truth)| work / truth)]
}

/// Returns statistics of the felt minus the true force \[N\]: mean and standard deviation (larger of forward and left), 95 % quantile of
/// the horizontal force.
fn while_not_pulled(forces: &[FeltForces]) -> [Option<f64>; 3] {
    let means = [0, 1].map(|axis| mean(forces.iter().map(|felt| error(felt)[axis])));
    let deviations = [0, 1].map(|axis| {
        let squares = mean(forces.iter().map(|felt| (error(felt)[axis] - means[axis].unwrap_or(0.0)).powi(2)));
        squares.map(f64::sqrt)
    });
    let larger = |of: [Option<f64>; 2]| of[0].zip(of[1]).map(|(forward, left)| forward.abs().max(left.abs()));
    let mut sizes: Vec<f64> = forces.iter().map(|felt| error(felt)[0].hypot(error(felt)[1])).collect();
    sizes.sort_by(f64::total_cmp);
    let quantile = sizes.len().checked_sub(1).map(|last| sizes[(0.95 * last as f64).round() as usize]);
    [larger(means), larger(deviations), quantile]
}

impl Experiment for Felt {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            method: "The robot feels the force on its trunk from joints, motors and IMU. Felt and true force, both in \
                     the heading frame and low-passed over 0.1 s, are compared in the horizontal plane: while a pull \
                     is steady (from half a second after its start), and for a second after a push or blow. Without a \
                     pull, from 2 s on, the error is the felt force minus the true contact force on the trunk. Frames \
                     that the observer marks as doubtful are counted and left out, and so is the last half second \
                     before a fall.",
            ..ExperimentInfo::new("E15", 18, "felt", "Felt force", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        Ok(self.groups()?.into_iter().flat_map(|group| group.conditions).collect())
    }

    fn check(&self) -> Result<(), ParameterError> {
        in_range("for_s", self.for_s, STEADY_S + LEAST_S, 60.0, "0.75 to 60 s")?;
        check_directions(self.directions)
    }

    fn observes_forces(&self) -> bool {
        true
    }

    fn until_s(&self, script: &Script) -> f64 {
        script.pushes().next().map_or(script.duration_s, |push| push.at_s + BLOW_S)
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let (is_pulled, window_s) = window_s(trial);
        let (forces, in_doubt) = window_s.map_or((Vec::new(), None), |window_s| forces(trial, window_s));
        let [pulled, calm] = if is_pulled { [&forces[..], &[]] } else { [&[], &forces[..]] };
        let mut values = Vec::from(while_pulled(pulled));
        values.extend(while_not_pulled(calm));
        values.extend([in_doubt, trial.end.fell()]);
        values.into()
    }

    fn report(&self, section: &mut SectionBuilder) {
        let Ok(groups) = self.groups() else { return };
        let results = section.results;
        let mut indices = 0..;
        let located = groups.into_iter().map(|Group { name, role, conditions }| {
            (role, ConditionGroup::new(name, indices.by_ref().take(conditions.len())))
        });
        let located: Vec<(Role, ConditionGroup)> = located.collect();
        let is_pulled = |role: Role| matches!(role, Role::Steady | Role::Pulled);
        let [steady, calm, rough] = [Role::Steady, Role::Calm, Role::Rough].map(|chosen| -> Vec<usize> {
            let groups = located.iter().filter(|(role, _)| *role == chosen);
            groups.flat_map(|(_, group)| group.conditions.iter().copied()).collect()
        });
        let is_on_sensors = results.names.iter().map(String::as_str).eq(sensing::NAMES);
        // The bounds are those of robots that act on the true state, and on their sensors [N].
        for (place, text, quantity, [bound, on_sensors], over) in [
            ("Pulled steadily", "robots of both sets feel the force with an RMSE", "rmse_n", [1.5, 3.0], &steady),
            ("Undisturbed on the flat", "robots of both sets feel a mean force", "mean_n", [0.5; 2], &calm),
            (
                "Undisturbed on the flat",
                "the felt force of both sets has a standard deviation",
                "sd_n",
                [1.0; 2],
                &calm,
            ),
            (
                "On balls, rubble and uneven ground",
                "the felt minus the true force of both sets is for 95 % of the time",
                "q95_n",
                [5.0; 2],
                &rough,
            ),
        ] {
            let (comparison, quantity) = (results.compare_over(over, quantity), results.quantity(quantity));
            if let (true, Some(found)) = (is_on_sensors, comparison.sets[0].spread) {
                let (label, found) = (quantity.label, number(found.mean, quantity));
                let note = format!("{place}, on sensors: {label} {found} N; aim: < {on_sensors} N.");
                section.content.notes.push(note);
            }
            let text = format!("{place}, {text} below {bound} N");
            section.content.claims.push(Claim::below(bound, text, "", quantity, comparison));
        }
        let rows = located.iter().flat_map(|(role, group)| {
            let of = if is_pulled(*role) { 0..OF_PULLS } else { OF_PULLS..OF_PULLS + 3 };
            let of_all = &QUANTITIES[QUANTITIES.len() - 2..];
            let quantities = QUANTITIES[of].iter().chain(of_all).filter(|it| it.name != "felt_n");
            quantities.map(|quantity| section.row(group, *quantity)).collect::<Vec<_>>()
        });
        let rows = rows.collect();
        section.table_with_rows(
            "Felt against true force on the trunk. Without a pull, mean and standard deviation are the larger of forward \
             and left, and the quantile is of the horizontal force.",
            rows,
        );
        section.table_in_file("all", "Felt and true force on the trunk, by condition.");

        let mut panels = Vec::new();
        for (set, name) in results.names.iter().enumerate() {
            let point = |force: &f64| {
                let is_it = |condition: &&usize| match &results.conditions[**condition].scenario {
                    Scenario::Leash(leash) => leash.force_n == *force,
                    _ => false,
                };
                let felt = |condition| Spread::from_values(&results.per_seed(set, condition, "felt_n"));
                let means: Vec<f64> = steady.iter().filter(is_it).filter_map(|it| Some(felt(*it)?.mean)).collect();
                curves::point(*force, &means)
            };
            let points = self.forces_n.iter().filter_map(point).collect();
            let if_empty = "no steady pull without a fall";
            panels.push(Curve { title: name.clone(), points, diagonal: true, set, if_empty, ..Curve::default() });
        }
        let svg = curves::draw("Felt over true force", &panels, "true force [N]", "felt along it [N]");
        section.figure(
            "",
            "Felt over true force on the trunk under steady pulls: mean over policies, commands and directions, and \
             the range over commands and directions: a band, or a bar for a single force. Dashed: equal forces.",
            svg,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns forces felt by a robot with this true force.
    fn felt(force: [f64; 3], true_force: [f64; 3]) -> FeltForces {
        FeltForces { force, true_force, ..FeltForces::default() }
    }

    #[test]
    fn error_and_gain_are_those_of_the_horizontal_force() {
        // Errors (3, 4) and (0, 0): √(25 / 2). Along the true force of 10 N: 13 and 10; the gain is 11.5 / 10.
        let forces = [felt([13.0, 4.0, 9.0], [10.0, 0.0, 0.0]), felt([10.0, 0.0, 0.0], [10.0, 0.0, 0.0])];
        let [rmse, along, gain] = while_pulled(&forces).map(Option::unwrap);
        assert!((rmse - 12.5_f64.sqrt()).abs() < 1e-12 && (along - 11.5).abs() < 1e-12 && (gain - 1.15).abs() < 1e-12);
        assert_eq!(while_pulled(&[]), [None; OF_PULLS]);
    }

    #[test]
    fn true_contacts_are_no_error_where_nothing_pulls() {
        let forces: Vec<FeltForces> =
            (0..101).map(|k| felt([5.0 + f64::from(k % 2), -3.0, 1.0], [5.0, 0.0, 0.0])).collect();
        let [mean, sd, quantile] = while_not_pulled(&forces).map(Option::unwrap);
        // Forward 0 or 1, left −3: the larger mean is that of left, the larger deviation that of forward.
        assert!(mean == 3.0 && (sd - 0.5).abs() < 0.01);
        assert!((quantile - 10.0_f64.sqrt()).abs() < 1e-12);
    }
}
