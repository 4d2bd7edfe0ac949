//! The paths of the robot past a box, seen from above, one panel for each set (Fig. 6).

use super::axes::Panel;
use super::svg::{Stroke, Svg};
use super::{GREY, INK, WIDTH, colour};

/// The pose of a box: x \[m\], y \[m\], yaw \[rad\].
pub type BoxPose = [f64; 3];

/// The path of the trunk (x, y) \[m\] in one trial, which may end with a fall, and the poses of the box before and after.
pub struct Run {
    pub path: Vec<[f64; 2]>,
    pub first: BoxPose,
    pub last: BoxPose,
    pub fell: bool,
}

/// The runs of one set in the order of trials. The first is drawn in full, the others faintly.
pub struct View {
    pub title: String,
    pub runs: Vec<Run>,
}

/// Draws all views on one scale, with equal lengths along both axes.
pub fn draw(title: &str, views: &[View], box_size_m: f64) -> String {
    let boxes = |run: &Run| [run.first, run.last].map(|pose| corners(pose, box_size_m)).concat();
    let of_run = |run: &Run| [&run.path[..], &boxes(run)].concat();
    let points = || views.iter().flat_map(|view| &view.runs).flat_map(of_run);
    let range = |axis: usize| {
        points().map(|point| point[axis]).fold([-0.4_f64, 0.4], |[low, high], v| [low.min(v - 0.1), high.max(v + 0.1)])
    };
    let (x, y) = (range(0), range(1));
    // The figure must fit a page.
    let (left, most) = (62.0, [WIDTH - 62.0 - 14.0, 330.0]);
    let scale = (most[0] / (x[1] - x[0])).min(most[1] / (y[1] - y[0]));
    let [width, height] = [scale * (x[1] - x[0]), scale * (y[1] - y[0])];
    let left = left + 0.5 * (most[0] - width);

    let sets = views.len() as f64;
    let mut svg = Svg::new(WIDTH, sets * (height + 34.0) + (12.0 * sets + 28.0));
    for (set, view) in views.iter().enumerate() {
        let corner = [left, 30.0 + set as f64 * (height + 46.0)];
        let panel = Panel { corner, size: [width, height], x, y };
        panel.draw_axes(&mut svg, if set + 1 == views.len() { "forward [m]" } else { "" }, Some("left [m]"));
        panel.draw_title(&mut svg, &view.title);
        for (index, run) in view.runs.iter().enumerate().rev() {
            draw_run(&mut svg, &panel, run, set, box_size_m, index == 0);
        }
    }
    svg.finish(title)
}

fn corners([x, y, yaw]: BoxPose, size_m: f64) -> [[f64; 2]; 4] {
    let half = 0.5 * size_m;
    [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]].map(|[u, v]: [f64; 2]| {
        let (u, v) = (half * u, half * v);
        [x + u * yaw.cos() - v * yaw.sin(), y + u * yaw.sin() + v * yaw.cos()]
    })
}

fn draw_run(svg: &mut Svg, panel: &Panel, run: &Run, set: usize, size_m: f64, in_full: bool) {
    let pixels = |points: &[[f64; 2]]| points.iter().map(|point| panel.at(*point)).collect::<Vec<_>>();
    let (first, last) = (pixels(&corners(run.first, size_m)), pixels(&corners(run.last, size_m)));
    if in_full {
        svg.outline(&first, Stroke::new(GREY, 1.5).dashed("4 3"));
        svg.area(&[&last], "#b58a55", 0.75);
        svg.outline(&last, Stroke::new(INK, 1.2));
        svg.polyline(&pixels(&run.path), Stroke::new(colour(set), 2.6));
    } else {
        svg.outline(&last, Stroke::new("#b58a55", 0.8).faint(0.45));
        svg.polyline(&pixels(&run.path), Stroke::new(colour(set), 1.0).faint(0.45));
    }
    if let (true, Some(end)) = (run.fell, run.path.last()) {
        let ([x, y], radius) = (panel.at(*end), if in_full { 5.0 } else { 3.5 });
        for rise in [-radius, radius] {
            svg.line([x - radius, y - rise], [x + radius, y + rise], Stroke::new(INK, 1.5));
        }
    }
}
