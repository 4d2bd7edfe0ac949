//! Curves with mean and band, one panel for each, all on the same scale (Fig. 3).

use super::axes::{Panel, draw_mark, range, range_from_zero};
use super::svg::{Anchor, Stroke, Svg, Text};
use super::{BAND, GREY, INK, SMALL, WIDTH, colour};
use crate::statistics::mean;

/// The mean and the extremes of several runs, in the colour of a set, with the annotations of their panel.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Curve {
    pub set: usize,
    pub title: String,
    /// The points (x, mean, least, largest) in order of x.
    pub points: Vec<[f64; 4]>,
    /// A value of x to mark, with its label.
    pub mark: Option<(f64, String)>,
    /// A level and the half-width of a band around it; both edges are drawn.
    pub tolerance: Option<[f64; 2]>,
    /// True to draw the line on which both axes have the same value.
    pub diagonal: bool,
    /// The reason that the panel shows if there are no points.
    pub if_empty: &'static str,
}

/// Returns the point of a curve (x, mean, least, largest) from the values at x; none if there are none.
pub fn point(x: f64, values: &[f64]) -> Option<[f64; 4]> {
    let [least, largest] = range(values.iter().copied());
    Some([x, mean(values.iter().copied())?, least, largest])
}

/// The height of a row of panels \[px\].
const ROW: f64 = 300.0;

/// The width of a panel, and the space between two for their outermost tick labels \[px\].
const PANEL: [f64; 2] = [314.0, 50.0];

/// Draws all curves, two panels in a row. Where all points have the same x, they are marks on axes from zero.
pub fn draw(title: &str, curves: &[Curve], x_label: &str, y_label: &str) -> String {
    let mut svg = Svg::new(WIDTH, ROW * curves.len().div_ceil(2) as f64);
    let points = || curves.iter().flat_map(|curve| &curve.points);
    let at = || points().map(|point| point[0]);
    let equal = curves.iter().any(|curve| curve.diagonal).then(at);
    let values =
        || points().flat_map(|[.., least, largest]| [*least, *largest]).chain(equal.clone().into_iter().flatten());
    let (mut x, [low, high]) = (range(at()), range(values()));
    let margin = 0.06 * (high - low).max(1e-3);
    let mut y = [low - margin, high + margin];
    if x[0] >= x[1] {
        (x, y) = (range_from_zero(at()), range_from_zero(values()));
    }
    let [width, gap] = PANEL;
    for (index, curve) in curves.iter().enumerate() {
        let (row, column) = (index / 2, index % 2);
        let corner = [62.0 + column as f64 * (width + gap), ROW * row as f64 + 30.0];
        let panel = Panel { corner, size: [width, 216.0], x, y };
        match points().next() {
            Some(_) => panel.draw_axes(&mut svg, x_label, (column == 0).then_some(y_label)),
            None => panel.draw_frame(&mut svg),
        }
        panel.draw_title(&mut svg, &curve.title);
        draw_curve(&mut svg, &panel, curve);
    }
    svg.finish(title)
}

fn draw_curve(svg: &mut Svg, panel: &Panel, curve: &Curve) {
    if curve.points.is_empty() {
        let middle = [panel.corner[0] + 0.5 * panel.size[0], panel.corner[1] + 0.5 * panel.size[1]];
        // Without grid lines behind it.
        let width = 6.4 * curve.if_empty.chars().count() as f64;
        svg.rectangle([middle[0] - 0.5 * width, middle[1] - 14.0], [width, 20.0], "white");
        return svg.text(middle, curve.if_empty, Text { colour: GREY, ..Text::new(SMALL, Anchor::Middle) });
    }
    svg.area(&[&panel.band(&curve.points)], colour(curve.set), BAND);
    if let Some([level, half]) = curve.tolerance {
        for value in [level - half, level + half] {
            let line = Stroke::new(GREY, 1.0).dashed("2 3");
            svg.line(panel.at([panel.x[0], value]), panel.at([panel.x[1], value]), line);
        }
    }
    if curve.diagonal {
        let ends = [panel.x[0].max(panel.y[0]), panel.x[1].min(panel.y[1])];
        svg.line(panel.at([ends[0]; 2]), panel.at([ends[1]; 2]), Stroke::new(GREY, 1.3).dashed("5 3"));
    }
    if panel.x[0] <= 0.0 {
        svg.line(panel.at([0.0, panel.y[0]]), panel.at([0.0, panel.y[1]]), Stroke::new(GREY, 1.0));
    }
    if let [[x, mean, least, largest]] = curve.points[..] {
        svg.line(panel.at([x, least]), panel.at([x, largest]), Stroke::new(colour(curve.set), 2.0));
        draw_mark(svg, panel.at([x, mean]), curve.set, 4.2, true);
    } else {
        svg.polyline(&panel.path(&curve.points, 1), Stroke::new(colour(curve.set), 2.0));
    }
    if let Some((time, label)) = &curve.mark {
        let top = panel.at([*time, panel.y[1]]);
        svg.line(panel.at([*time, panel.y[0]]), top, Stroke::new(INK, 1.3).dashed("5 3"));
        let near_the_end = *time > 0.6 * panel.x[1];
        let (anchor, shift) = if near_the_end { (Anchor::End, -6.0) } else { (Anchor::Start, 6.0) };
        svg.text([top[0] + shift, top[1] + 17.0], label, Text::new(SMALL, anchor));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_sets_are_drawn_on_one_scale() {
        let level =
            |size: f64| Curve { points: vec![[0.0, 0.5, -size, size], [1.0, 0.5, -size, size]], ..Curve::default() };
        let svg = draw("", &[level(1.0), level(10.0)], "", "");
        let heights: Vec<&str> = svg
            .split("<polyline points=\"")
            .skip(1)
            .map(|rest| rest.split('"').next().unwrap().split([',', ' ']).nth(1).unwrap())
            .collect();
        assert!(heights.len() == 2 && heights[0] == heights[1], "{heights:?}");
    }

    #[test]
    fn single_force_is_a_mark_with_its_range() {
        let one = Curve { points: vec![[20.0, 19.0, 18.0, 21.0]], diagonal: true, ..Curve::default() };
        let none = Curve { if_empty: "no pull", ..Curve::default() };
        let svg = draw("", &[one, none], "", "");
        // Axes from zero; 20 N at 1/1.08 of the width, the range from 18 to 21 N of 1.08 · 21 N high.
        let bar = [62.0 + 314.0 / 1.08, 30.0 + 216.0 * (1.0 - 18.0 / 22.68), 30.0 + 216.0 * (1.0 - 21.0 / 22.68)];
        let line = format!("x1=\"{0:.2}\" y1=\"{1:.2}\" x2=\"{0:.2}\" y2=\"{2:.2}\"", bar[0], bar[1], bar[2]);
        assert!(svg.contains(&line) && svg.contains("<circle") && svg.contains(">no pull</text>"), "{line}: {svg}");
    }
}
