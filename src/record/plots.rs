/*! The time series of a recording: one table that both the logging and the layout read.

A plot shows every robot's quantity in the robot's colour and, where there is one, the first robot's command.
*/

use rerun::{EntityPath, Scalars, SeriesLines};

use super::RecordError;
use super::geometry::child;
use super::stream::Stream;
use super::style::{BLUE, GREEN, GREY, ORANGE, PURPLE, Rgb, SKY, opaque};
use crate::trace::Frame;

/// A plot.
pub(super) struct Plot {
    /// Name of its entities.
    pub(super) entity: &'static str,
    /// Title with the unit.
    pub(super) title: &'static str,
    /// Tab that it belongs to.
    pub(super) tab: Tab,
    /// What its series are.
    pub(super) series: Series,
    /// Fixed range of its axis; without, that of its values.
    pub(super) range: Option<[f64; 2]>,
    values: fn(&Frame) -> Vec<f64>,
}

/// Tabs of the plots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Tab {
    /// Where the robot goes.
    Motion,
    /// What it costs.
    Effort,
    /// What it is paid.
    Reward,
}

/// Tabs in their order.
pub(super) const TABS: [(Tab, &str); 3] = [(Tab::Motion, "Motion"), (Tab::Effort, "Effort"), (Tab::Reward, "Reward")];

/// Series of a plot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Series {
    /// One number in the robot's colour.
    Single,
    /// What was commanded, drawn first, and what happened.
    Tracking,
    /// Parts of a whole, each robot in a plot of its own.
    Parts(&'static [(&'static str, Rgb)]),
}

/// Every plot. The terms r_e and r_τ are not among the parts of the reward: they are power and torque.
const PLOTS: &[Plot] = &[
    Plot {
        entity: "forward",
        title: "Forward velocity [m/s]",
        tab: Tab::Motion,
        series: Series::Tracking,
        range: None,
        values: |frame| vec![frame.command.forward, frame.velocity[0]],
    },
    Plot {
        entity: "left",
        title: "Left velocity [m/s]",
        tab: Tab::Motion,
        series: Series::Tracking,
        range: None,
        values: |frame| vec![frame.command.left, frame.velocity[1]],
    },
    Plot {
        entity: "yaw_rate",
        title: "Yaw rate [rad/s]",
        tab: Tab::Motion,
        series: Series::Tracking,
        range: None,
        values: |frame| vec![frame.command.yaw, frame.yaw_rate],
    },
    Plot {
        entity: "height",
        title: "Base height [m]",
        tab: Tab::Motion,
        series: Series::Single,
        range: None,
        values: |frame| vec![frame.height_m],
    },
    Plot {
        entity: "power",
        title: "Mechanical power [W]",
        tab: Tab::Effort,
        series: Series::Single,
        range: None,
        values: |frame| vec![frame.power_w],
    },
    Plot {
        entity: "torque",
        title: "Torque norm [N·m]",
        tab: Tab::Effort,
        series: Series::Single,
        range: None,
        values: |frame| vec![frame.torque_n_m],
    },
    Plot {
        entity: "foot_force",
        title: "Largest foot force [N]",
        tab: Tab::Effort,
        series: Series::Single,
        range: None,
        values: |frame| vec![frame.peak_foot_force_n],
    },
    Plot {
        entity: OBSTACLE_FORCE,
        title: "Largest obstacle force [N]",
        tab: Tab::Effort,
        series: Series::Single,
        range: None,
        values: |frame| vec![frame.peak_obstacle_force_n],
    },
    Plot {
        entity: "reward",
        title: "Reward",
        tab: Tab::Reward,
        series: Series::Single,
        range: None,
        values: |frame| vec![frame.reward],
    },
    Plot {
        entity: "terms",
        title: "Reward terms",
        tab: Tab::Reward,
        series: Series::Parts(&[
            ("r_lin", BLUE),
            ("r_ang", ORANGE),
            ("r_pose", GREEN),
            ("r_cl [m⁴/s²]", PURPLE),
            ("r_h", SKY),
        ]),
        // A robot on its back would make r_pose hide the rest.
        range: Some([0.0, 1.1]),
        values: |frame| {
            let terms = &frame.terms;
            vec![terms.linear_velocity, terms.angular_velocity, terms.pose, terms.foot_clearance, terms.foot_height]
        },
    },
];

/// Name of the plot that says nothing without obstacles.
const OBSTACLE_FORCE: &str = "obstacle_force";

/// The plots of a recording.
pub(super) fn plots(has_obstacles: bool) -> impl Iterator<Item = &'static Plot> {
    PLOTS.iter().filter(move |plot| has_obstacles || plot.entity != OBSTACLE_FORCE)
}

impl Plot {
    /// The plot's entity of a robot.
    pub(super) fn path(&self, robot: &str) -> EntityPath {
        child(&child(&EntityPath::from("plots"), robot), self.entity)
    }
}

/// Logs names and colours of a robot's series, once.
pub(super) fn log_styles(stream: &Stream, robot: &str, colour: Rgb, is_first: bool) -> Result<(), RecordError> {
    for plot in PLOTS {
        let (names, colours): (Vec<&str>, Vec<Rgb>) = match plot.series {
            Series::Parts(parts) => parts.iter().copied().unzip(),
            Series::Tracking if is_first => [("commanded", GREY), (robot, colour)].into_iter().unzip(),
            Series::Tracking | Series::Single => [(robot, colour)].into_iter().unzip(),
        };
        let style =
            SeriesLines::new().with_names(names).with_colors(colours.into_iter().map(opaque)).with_widths([2.0]);
        stream.log_static(&plot.path(robot), &style)?;
    }
    Ok(())
}

/// Logs a robot's values.
pub(super) fn log_values(
    stream: &Stream,
    robot: &str,
    is_first: bool,
    has_obstacles: bool,
    frame: &Frame,
) -> Result<(), RecordError> {
    for plot in plots(has_obstacles) {
        let mut values = (plot.values)(frame);
        if plot.series == Series::Tracking && !is_first {
            values.remove(0);
        }
        stream.log(&plot.path(robot), &Scalars::new(values))?;
    }
    Ok(())
}
