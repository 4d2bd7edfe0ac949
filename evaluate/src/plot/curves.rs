//! A quantity over time with mean and band, one panel for each set, on the same scale (Fig. 3).

use super::axes::Panel;
use super::svg::{Anchor, Stroke, Svg, Text};
use super::{BAND, GREY, INK, SMALL, WIDTH, colour};

/// Mean and extremes of several runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// Above it.
    pub title: String,
    /// (time, mean) in order of time.
    pub mean: Vec<[f64; 2]>,
    /// (time, least).
    pub least: Vec<[f64; 2]>,
    /// (time, largest).
    pub largest: Vec<[f64; 2]>,
    /// A time to mark, with its label.
    pub mark: Option<(f64, String)>,
    /// A band to draw around a level: level, half-width.
    pub tolerance: Option<[f64; 2]>,
}

/// Height of a row of panels \[px\].
const ROW: f64 = 300.0;

/// Draws all curves, two side by side.
pub fn draw(title: &str, curves: &[Curve], x_label: &str, y_label: &str) -> String {
    let mut svg = Svg::new(WIDTH, ROW * curves.len().div_ceil(2) as f64);
    let extremes = || curves.iter().flat_map(|curve| curve.least.iter().chain(&curve.largest));
    let range = |of: fn(&[f64; 2]) -> f64| {
        extremes().map(of).fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)])
    };
    let (x, [low, high]) = (range(|point| point[0]), range(|point| point[1]));
    if x[0] >= x[1] {
        svg.text([0.5 * WIDTH, 150.0], "no run reached its push", Text::new(SMALL, Anchor::Middle));
        return svg.finish(title);
    }
    let margin = 0.06 * (high - low).max(1e-3);
    let width = 326.0;
    for (set, curve) in curves.iter().enumerate() {
        let (row, column) = (set / 2, set % 2);
        let corner = [62.0 + column as f64 * (width + 26.0), ROW * row as f64 + 30.0];
        let panel = Panel { corner, size: [width, 216.0], x, y: [low - margin, high + margin] };
        panel.draw_axes(&mut svg, x_label, (column == 0).then_some(y_label));
        panel.draw_title(&mut svg, &curve.title);
        draw_curve(&mut svg, &panel, curve, set);
    }
    svg.finish(title)
}

fn draw_curve(svg: &mut Svg, panel: &Panel, curve: &Curve, set: usize) {
    let points = |of: &[[f64; 2]]| of.iter().map(|point| panel.at(*point)).collect::<Vec<_>>();
    let mut band = points(&curve.largest);
    band.extend(points(&curve.least).iter().rev());
    svg.area(&[&band], colour(set), BAND);
    if let Some([level, half]) = curve.tolerance {
        for value in [level - half, level + half] {
            let line = Stroke::new(GREY, 1.0).dashed("2 3");
            svg.line(panel.at([panel.x[0], value]), panel.at([panel.x[1], value]), line);
        }
    }
    svg.line(panel.at([0.0, panel.y[0]]), panel.at([0.0, panel.y[1]]), Stroke::new(GREY, 1.0));
    svg.polyline(&points(&curve.mean), Stroke::new(colour(set), 2.0));
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
        let level = |size: f64| Curve {
            title: String::new(),
            mean: vec![[0.0, 0.5], [1.0, 0.5]],
            least: vec![[0.0, -size], [1.0, -size]],
            largest: vec![[0.0, size], [1.0, size]],
            mark: None,
            tolerance: None,
        };
        let svg = draw("", &[level(1.0), level(10.0)], "", "");
        let heights: Vec<&str> = svg
            .split("<polyline points=\"")
            .skip(1)
            .map(|rest| rest.split('"').next().unwrap().split([',', ' ']).nth(1).unwrap())
            .collect();
        assert!(heights.len() == 2 && heights[0] == heights[1], "{heights:?}");
    }
}
