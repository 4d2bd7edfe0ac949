/*! The layout of a recording: its views, their arrangement and their content.

rerun's layout builder cannot set a view's camera, background or axes, which are ordinary components of entities
below the view in the layout's own store; so the layout is logged entity by entity, as the builder does internally. Its
identifiers are counted, not random: the same robots give the same layout.
*/

use re_sdk_types::blueprint::archetypes::{
    Background, ContainerBlueprint, EyeControls3D, LineGrid3D, PanelBlueprint, PlotLegend, ScalarAxis, TextLogColumns,
    TimeAxis, TimePanelBlueprint, ViewBlueprint, ViewContents, ViewportBlueprint,
};
use re_sdk_types::blueprint::components::{
    BackgroundKind, ContainerKind, Corner2D, LinkAxis, LoopMode, PanelState, PlayState, RootContainer, TextLogColumn,
    TimelineColumn,
};
use re_sdk_types::blueprint::datatypes;
use rerun::external::re_log_types::{BlueprintActivationCommand, LogMsg};
use rerun::{AsComponents, EntityPath, RecordingStream, RecordingStreamBuilder};

use super::Result;
use super::plots::{Plot, Series, Shown, plots, tabs};
use super::robot::{camera_path, events_path, robot_path};
use super::stream::{APPLICATION, TIMELINE};
use super::style::{BACKGROUND, EYE_DIRECTION, EYE_DISTANCE_M, opaque};

/// Sends the layout for these robots to a recording and activates it.
pub(super) fn send(recording: &RecordingStream, robots: &[&str], shown: Shown, is_live: bool) -> Result<()> {
    let (store, memory) = RecordingStreamBuilder::new(APPLICATION).enabled(true).blueprint().memory()?;
    let logged = log(&store, robots, shown, is_live);
    let messages = memory.take();
    // The sink and the store refer to each other: without this, neither would be dropped, nor its threads end.
    store.disconnect();
    logged?;
    let id = messages.iter().find_map(|message| match message {
        LogMsg::SetStoreInfo(info) => Some(info.info.store_id.clone()),
        _ => None,
    });
    if let Some(blueprint_id) = id {
        let activation = BlueprintActivationCommand { blueprint_id, make_active: true, make_default: true };
        recording.send_blueprint(messages, activation);
    }
    Ok(())
}

/// Logs the layout into its own store.
fn log(store: &RecordingStream, robots: &[&str], shown: Shown, is_live: bool) -> Result<()> {
    store.set_time_sequence("blueprint", 0);
    let mut layout = Layout { store, shown, count: 0 };
    let root = match robots {
        robots if is_live => layout.live(robots)?.1,
        [robot] => layout.single(robot)?,
        robots => layout.comparison(robots)?,
    };
    store.log("viewport", &ViewportBlueprint::new().with_root_container(root).with_auto_views(false))?;
    let hidden = PanelBlueprint::new().with_state(PanelState::Hidden);
    store.log("blueprint_panel", &hidden)?;
    store.log("selection_panel", &hidden)?;
    if is_live {
        return Ok(store.log("time_panel", &hidden)?);
    }
    let time = TimePanelBlueprint::new()
        .with_state(PanelState::Collapsed)
        .with_timeline(TIMELINE)
        .with_loop_mode(LoopMode::All)
        .with_play_state(PlayState::Playing);
    Ok(store.log("time_panel", &time)?)
}

/// Path of a view or container, and its share of its parent's space.
type Item = (String, f32);

struct Layout<'a> {
    store: &'a RecordingStream,
    shown: Shown,
    count: u8,
}

impl Layout<'_> {
    /// Adds the layout of one robot: robot and events on the left, plots on the right.
    fn single(&mut self, robot: &str) -> Result<RootContainer> {
        let left = [(self.world(robot)?, 0.84), (self.events(&[robot])?, 0.16)];
        let left = self.container(ContainerKind::Vertical, "Robot", &left)?.0;
        let right = self.plots(&[robot], ContainerKind::Vertical)?;
        Ok(self.container(ContainerKind::Horizontal, "Recording", &[(left, 0.64), (right, 0.36)])?.1)
    }

    /// Adds the layout of several robots: side by side, with their plots and events below.
    fn comparison(&mut self, robots: &[&str]) -> Result<RootContainer> {
        let above = self.live(robots)?.0;
        let plots = self.plots(robots, ContainerKind::Horizontal)?;
        let below = [(plots, 0.76), (self.events(robots)?, 0.24)];
        let below = self.container(ContainerKind::Horizontal, "Data", &below)?.0;
        Ok(self.container(ContainerKind::Vertical, "Recording", &[(above, 0.6), (below, 0.4)])?.1)
    }

    /// Adds the layout of a live view: robots side by side, nothing else.
    fn live(&mut self, robots: &[&str]) -> Result<(String, RootContainer)> {
        let worlds = robots.iter().map(|robot| Ok((self.world(robot)?, 1.0))).collect::<Result<Vec<_>>>()?;
        self.container(ContainerKind::Horizontal, "Robots", &worlds)
    }

    /// Adds the 3D view of a robot, with a camera that follows it.
    fn world(&mut self, robot: &str) -> Result<String> {
        let length = EYE_DIRECTION.iter().map(|x| x * x).sum::<f32>().sqrt();
        let target = [0.0, 0.0, 0.3];
        let position: [f32; 3] = std::array::from_fn(|k| target[k] + EYE_DIRECTION[k] / length * EYE_DISTANCE_M);
        let eye = EyeControls3D::new()
            .with_position(position)
            .with_look_target(target)
            .with_eye_up([0.0, 0.0, 1.0])
            .with_tracking_entity(camera_path(robot).to_string());
        let background = Background::new(BackgroundKind::SolidColor).with_color(opaque(BACKGROUND));
        let grid = LineGrid3D::new().with_visible(false);
        let root = robot_path(robot);
        let contents = [format!("+ {root}/**")];
        let looks: [(_, &dyn AsComponents); 3] =
            [("EyeControls3D", &eye), ("Background", &background), ("LineGrid3D", &grid)];
        self.view("3D", robot, &root, &contents, &looks)
    }

    /// Adds tabs with all plots; those of a tab are stacked or side by side.
    fn plots(&mut self, robots: &[&str], arrangement: ContainerKind) -> Result<String> {
        let mut containers = Vec::new();
        for (tab, title) in tabs(self.shown) {
            let mut items: Vec<Item> = Vec::new();
            for plot in plots(self.shown).filter(|plot| plot.tab == tab) {
                match plot.series {
                    Series::Terms if robots.len() > 1 => {
                        for robot in robots {
                            items.push((self.plot(plot, &[robot], &format!("{}, {robot}", plot.title), true)?, 1.0));
                        }
                    }
                    _ => items.push((self.plot(plot, robots, plot.title, items.is_empty())?, 1.0)),
                }
            }
            containers.push((self.container(arrangement, title, &items)?.0, 1.0));
        }
        Ok(self.container(ContainerKind::Tabs, "Plots", &containers)?.0)
    }

    /// Adds a plot. Colours have the same meaning in all plots of a tab, so only the first one and those with parts
    /// have a legend.
    fn plot(&mut self, plot: &Plot, robots: &[&str], title: &str, is_first: bool) -> Result<String> {
        let contents: Vec<String> = robots.iter().map(|robot| format!("+ {}", plot.path(robot))).collect();
        let legend = PlotLegend::new()
            .with_corner(Corner2D::LeftTop)
            .with_visible(is_first || matches!(plot.series, Series::Terms));
        let axis = TimeAxis::new().with_link(LinkAxis::LinkToGlobal);
        let values = plot.range.map_or_else(ScalarAxis::new, |range| ScalarAxis::new().with_range(range));
        let origin = EntityPath::from("plots");
        let properties: [(&str, &dyn AsComponents); 3] =
            [("PlotLegend", &legend), ("TimeAxis", &axis), ("ScalarAxis", &values)];
        self.view("TimeSeries", title, &origin, &contents, &properties)
    }

    /// Adds the text log: time, level and text, which begins with the robot's name.
    fn events(&mut self, robots: &[&str]) -> Result<String> {
        use datatypes::TextLogColumnKind::{Body, LogLevel};
        let column = |kind| TextLogColumn(datatypes::TextLogColumn { visible: true.into(), kind });
        let time = TimelineColumn(datatypes::TimelineColumn { visible: true.into(), timeline: TIMELINE.into() });
        let columns =
            TextLogColumns::new().with_timeline_columns([time]).with_text_log_columns([LogLevel, Body].map(column));
        let contents: Vec<String> = robots.iter().map(|robot| format!("+ {}", events_path(robot))).collect();
        self.view("TextLog", "Events", &EntityPath::from("events"), &contents, &[("TextLogColumns", &columns)])
    }

    fn view(
        &mut self,
        class: &str,
        title: &str,
        origin: &EntityPath,
        contents: &[String],
        properties: &[(&str, &dyn AsComponents)],
    ) -> Result<String> {
        let path = format!("view/{}", text(self.identifier()));
        let view = ViewBlueprint::new(class).with_display_name(title).with_space_origin(origin.to_string());
        self.store.log(path.as_str(), &view)?;
        let contents = ViewContents::new(contents.iter().map(String::as_str));
        self.store.log(format!("{path}/ViewContents"), &contents)?;
        for (name, property) in properties {
            self.store.log(format!("{path}/{name}"), *property)?;
        }
        Ok(path)
    }

    fn container(&mut self, kind: ContainerKind, title: &str, items: &[Item]) -> Result<(String, RootContainer)> {
        let identifier = self.identifier();
        let path = format!("container/{}", text(identifier));
        let shares = items.iter().map(|item| item.1);
        let container = ContainerBlueprint::new(kind)
            .with_display_name(title)
            .with_contents(items.iter().map(|item| item.0.as_str()));
        let container = match kind {
            ContainerKind::Horizontal => container.with_col_shares(shares),
            ContainerKind::Vertical => container.with_row_shares(shares),
            ContainerKind::Tabs | ContainerKind::Grid => container,
        };
        self.store.log(path.as_str(), &container)?;
        Ok((path, RootContainer(re_sdk_types::datatypes::Uuid { bytes: identifier })))
    }

    /// Returns the next identifier: a UUID in the form of version 4, counted in its last byte.
    fn identifier(&mut self) -> [u8; 16] {
        self.count += 1;
        [0x5u8, 0, 0, 0, 0, 0, 0x40, 0, 0x80, 0, 0, 0, 0, 0, 0, self.count]
    }
}

/// Formats a UUID as text.
fn text(bytes: [u8; 16]) -> String {
    let hex: Vec<String> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    [&hex[..4], &hex[4..6], &hex[6..8], &hex[8..10], &hex[10..]].map(<[String]>::concat).join("-")
}
