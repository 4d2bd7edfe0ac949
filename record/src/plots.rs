/*! The plots of a recording: one table that both the logging and the layout read.

A plot shows every robot's quantity in the robot's colour and, where there is one, the first robot's command.
*/

use re_sdk_types::archetypes::{Scalars, SeriesLines};
use rerun::EntityPath;

use super::Result;
use super::geometry::child;
use super::stream::Stream;
use super::style::{BLUE, GREEN, GREY, ORANGE, PURPLE, Rgb, SKY, lighter, opaque};
use supple::scenario::trace::{Frame, Sensed};
use supple::task::reward::{TERMS, TermDefinition};

/// A plot: one quantity over time.
pub(super) struct Plot {
    pub(super) entity: &'static str,
    /// Title of the plot, with the unit.
    pub(super) title: &'static str,
    pub(super) tab: Tab,
    pub(super) series: Series,
    /// Fixed range of the value axis; `None` for the range of the values.
    pub(super) range: Option<[f64; 2]>,
    values: fn(&Frame) -> Vec<f64>,
}

/// A tab of plots: velocity, height and orientation; power, torque and forces; reward and its terms; state estimated from sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Tab {
    Motion,
    Effort,
    Reward,
    Estimate,
}

/// The optional plots of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shown {
    pub(super) obstacles: bool,
    pub(super) estimates: bool,
}

/// Tabs in order, with their titles; the first one is open.
const TABS: [(Tab, &str); 4] = [(Estimate, "Estimate"), (Motion, "Motion"), (Effort, "Effort"), (Reward, "Reward")];

/// Iterates over the tabs of a recording.
pub(super) fn tabs(shown: Shown) -> impl Iterator<Item = (Tab, &'static str)> {
    TABS.into_iter().filter(move |(tab, _)| shown.estimates || *tab != Estimate)
}

/// Kind of a plot's series.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Series {
    /// A single value, in the robot's colour.
    Single,
    /// The command, drawn first, and the measured value.
    Tracking,
    /// The true value in the robot's colour and the estimate in a lighter one.
    Belief,
    /// The terms of the reward, in a separate plot for each robot.
    Terms,
}

use Series::{Belief, Single, Terms, Tracking};
use Tab::{Effort, Estimate, Motion, Reward};

const fn plot(
    entity: &'static str,
    title: &'static str,
    tab: Tab,
    series: Series,
    values: fn(&Frame) -> Vec<f64>,
) -> Plot {
    Plot { entity, title, tab, series, range: None, values }
}

/// All plots of recordings, in order.
const PLOTS: &[Plot] = &[
    plot("forward", "Forward velocity [m/s]", Motion, Tracking, |frame| vec![frame.command.forward, frame.velocity[0]]),
    plot("left", "Left velocity [m/s]", Motion, Tracking, |frame| vec![frame.command.left, frame.velocity[1]]),
    plot("yaw_rate", "Yaw rate [rad/s]", Motion, Tracking, |frame| vec![frame.command.yaw, frame.yaw_rate]),
    plot("height", "Base height [m]", Motion, Single, |frame| vec![frame.height_m]),
    plot("power", "Mechanical power [W]", Effort, Single, |frame| vec![frame.power_w]),
    plot("torque", "Torque norm [N·m]", Effort, Single, |frame| vec![frame.torque_n_m]),
    plot("foot_force", "Largest foot force [N]", Effort, Single, |frame| vec![frame.peak_foot_force_n]),
    plot(OBSTACLE_FORCE, "Largest obstacle force [N]", Effort, Single, |frame| vec![frame.peak_obstacle_force_n]),
    plot("reward", "Reward", Reward, Single, |frame| vec![frame.reward]),
    Plot {
        // A robot on its back would make r_pose hide the rest.
        range: Some([0.0, 1.1]),
        ..plot("terms", "Reward terms", Reward, Terms, |frame| shown_terms(frame).map(|(_, value)| value).collect())
    },
    plot("estimate_forward", "Forward velocity [m/s]", Estimate, Belief, |frame| {
        believed(frame, frame.velocity[0], |sensed| sensed.velocity[0])
    }),
    plot("estimate_left", "Left velocity [m/s]", Estimate, Belief, |frame| {
        believed(frame, frame.velocity[1], |sensed| sensed.velocity[1])
    }),
    plot("estimate_height", "Base height [m]", Estimate, Belief, |frame| {
        believed(frame, frame.height_m, |sensed| sensed.height_m)
    }),
    Plot {
        range: Some([0.0, 4.2]),
        ..plot("estimate_contacts", "Feet that stand", Estimate, Belief, |frame| {
            let truth = frame.sensed.map_or(f64::NAN, |sensed| count(sensed.true_contacts));
            believed(frame, truth, |sensed| count(sensed.contacts))
        })
    },
];

/// Iterates over the plotted terms; power and torque have plots of their own.
fn shown_terms(frame: &Frame) -> impl Iterator<Item = (&'static TermDefinition, f64)> {
    let terms = TERMS.iter().zip(frame.terms.fields().map(|(_, value)| value));
    terms.filter(|(term, _)| !matches!(term.name, "energy" | "torque"))
}

/// Colours of the terms, used repeatedly.
const TERM_COLOURS: [Rgb; 6] = [BLUE, ORANGE, GREEN, PURPLE, SKY, GREY];

fn count(feet: [bool; 4]) -> f64 {
    feet.iter().filter(|touches| **touches).count() as f64
}

/// Returns the true value and the estimate; without an estimate there is no second line.
fn believed(frame: &Frame, truth: f64, belief: fn(&Sensed) -> f64) -> Vec<f64> {
    vec![truth, frame.sensed.as_ref().map_or(f64::NAN, belief)]
}

/// Name of the plot that is shown only with obstacles.
const OBSTACLE_FORCE: &str = "obstacle_force";

/// Iterates over the plots of a recording.
pub(super) fn plots(shown: Shown) -> impl Iterator<Item = &'static Plot> {
    let is_shown = move |plot: &&Plot| match plot.tab {
        Estimate => shown.estimates,
        _ => shown.obstacles || plot.entity != OBSTACLE_FORCE,
    };
    PLOTS.iter().filter(is_shown)
}

impl Plot {
    /// Returns the path of the plot's entity for a robot.
    pub(super) fn path(&self, robot: &str) -> EntityPath {
        child(&child(&EntityPath::from("plots"), robot), self.entity)
    }
}

/// Logs names and colours of a robot's series, once at the start.
pub(super) fn log_styles(stream: &Stream, robot: &str, colour: Rgb, is_first: bool) -> Result<()> {
    for plot in PLOTS {
        let estimated = format!("{robot}, estimated");
        let (names, colours): (Vec<&str>, Vec<Rgb>) = match plot.series {
            Terms => {
                let names = shown_terms(&Frame::default()).map(|(term, _)| term.symbol).collect::<Vec<_>>();
                names.into_iter().zip(TERM_COLOURS.into_iter().cycle()).unzip()
            }
            Belief => [(robot, colour), (estimated.as_str(), lighter(colour))].into_iter().unzip(),
            Tracking if is_first => [("commanded", GREY), (robot, colour)].into_iter().unzip(),
            Tracking | Single => [(robot, colour)].into_iter().unzip(),
        };
        let style =
            SeriesLines::new().with_names(names).with_colors(colours.into_iter().map(opaque)).with_widths([2.0]);
        stream.log_static(&plot.path(robot), &style)?;
    }
    Ok(())
}

/// Logs a robot's values at the current time.
pub(super) fn log_values(stream: &Stream, robot: &str, is_first: bool, shown: Shown, frame: &Frame) -> Result<()> {
    for plot in plots(shown) {
        let mut values = (plot.values)(frame);
        if plot.series == Tracking && !is_first {
            values.remove(0);
        }
        stream.log(&plot.path(robot), &Scalars::new(values))?;
    }
    Ok(())
}
