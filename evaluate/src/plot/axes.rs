//! Rectangular panels (data to pixels, grid lines, ticks, labels), legends and marks.

use super::svg::{Anchor, Stroke, Svg, Text};
use super::{GREY, LARGE, PALE, SMALL, colour, line};

/// A rectangle of a figure, from its upper left corner \[px\], with the data ranges along x and, upwards, along y.
pub struct Panel {
    pub corner: [f64; 2],
    pub size: [f64; 2],
    pub x: [f64; 2],
    pub y: [f64; 2],
}

impl Panel {
    /// Converts a point from data coordinates to pixels.
    pub fn at(&self, point: [f64; 2]) -> [f64; 2] {
        let part = |axis: usize, [low, high]: [f64; 2]| (point[axis] - low) / (high - low);
        let parts = [part(0, self.x), 1.0 - part(1, self.y)];
        [0, 1].map(|axis| self.corner[axis] + self.size[axis] * parts[axis])
    }

    /// Returns a column of the points of a curve (x, mean, least, largest) in pixels.
    pub fn path(&self, points: &[[f64; 4]], column: usize) -> Vec<[f64; 2]> {
        points.iter().map(|point| self.at([point[0], point[column]])).collect()
    }

    /// Returns the outline between the least and the largest values of a curve, in pixels.
    pub fn band(&self, points: &[[f64; 4]]) -> Vec<[f64; 2]> {
        self.path(points, 3).into_iter().chain(self.path(points, 2).into_iter().rev()).collect()
    }

    /// Draws frame, grid lines with ticks, and labels. Without `y_label`, it omits the numbers along y.
    pub fn draw_axes(&self, svg: &mut Svg, x_label: &str, y_label: Option<&str>) {
        let [left, top] = self.corner;
        let [right, bottom] = [left + self.size[0], top + self.size[1]];
        let (x_ticks, y_ticks) = (ticks(self.x, 7), ticks(self.y, 7));
        for tick in &x_ticks {
            let [x, _] = self.at([*tick, 0.0]);
            svg.line([x, top], [x, bottom + 4.0], Stroke::new(PALE, 1.0));
            svg.text([x, bottom + 16.0], &tick_text(*tick, &x_ticks), Text::new(SMALL, Anchor::Middle));
        }
        for tick in &y_ticks {
            let [_, y] = self.at([0.0, *tick]);
            svg.line([left - 4.0, y], [right, y], Stroke::new(PALE, 1.0));
            if y_label.is_some() {
                svg.text([left - 6.0, y + 4.0], &tick_text(*tick, &y_ticks), Text::new(SMALL, Anchor::End));
            }
        }
        self.draw_frame(svg);
        svg.text([0.5 * (left + right), bottom + 35.0], x_label, Text::new(SMALL, Anchor::Middle));
        if let Some(label) = y_label {
            let style = Text { upwards: true, ..Text::new(SMALL, Anchor::Middle) };
            svg.text([left - 42.0, 0.5 * (top + bottom)], label, style);
        }
    }

    pub fn draw_frame(&self, svg: &mut Svg) {
        let [left, top] = self.corner;
        let [right, bottom] = [left + self.size[0], top + self.size[1]];
        svg.outline(&[[left, top], [right, top], [right, bottom], [left, bottom]], Stroke::new(GREY, 1.0));
    }

    /// Draws a title above the panel, in smaller letters if it would be wider than the panel.
    pub fn draw_title(&self, svg: &mut Svg, title: &str) {
        let centre = self.corner[0] + 0.5 * self.size[0];
        let size = LARGE.min(self.size[0] / (0.68 * title.chars().count() as f64));
        svg.text([centre, self.corner[1] - 9.0], title, Text { bold: true, ..Text::new(size, Anchor::Middle) });
    }
}

/// Draws the names of the sets with their lines and marks, centred at a point.
pub fn draw_legend(svg: &mut Svg, at: [f64; 2], names: &[String]) {
    let width = |name: &String| 34.0 + 0.6 * LARGE * name.chars().count() as f64 + 28.0;
    let mut x = at[0] - 0.5 * (names.iter().map(width).sum::<f64>() - 28.0);
    for (set, name) in names.iter().enumerate() {
        svg.line([x, at[1] - 4.0], [x + 28.0, at[1] - 4.0], line(set));
        draw_mark(svg, [x + 14.0, at[1] - 4.0], set, 4.0, true);
        svg.text([x + 34.0, at[1]], name, Text::new(LARGE, Anchor::Start));
        x += width(name);
    }
}

/// Draws a set's mark: circles for the first, squares for the second, then triangles and diamonds.
pub fn draw_mark(svg: &mut Svg, [x, y]: [f64; 2], set: usize, radius: f64, filled: bool) {
    let fill = if filled { colour(set) } else { "white" };
    let stroke = Stroke::new(colour(set), 1.2);
    let r = 0.9 * radius;
    let corners: &[[f64; 2]] = match set % 4 {
        0 => return svg.circle([x, y], radius, fill, stroke),
        1 => &[[x - r, y - r], [x + r, y - r], [x + r, y + r], [x - r, y + r]],
        2 => &[[x, y - radius], [x + radius, y + r], [x - radius, y + r]],
        _ => &[[x, y - radius], [x + radius, y], [x, y + radius], [x - radius, y]],
    };
    svg.area(&[corners], fill, 1.0);
    svg.outline(corners, stroke);
}

/// Returns about `count` round numbers within a range.
pub fn ticks(range: [f64; 2], count: usize) -> Vec<f64> {
    let [low, high] = range;
    let span = high - low;
    if span.is_nan() || span <= 0.0 || !span.is_finite() {
        return vec![low];
    }
    let raw = span / count as f64;
    let magnitude = 10.0_f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 2.5, 5.0, 10.0].into_iter().map(|m| m * magnitude).find(|step| *step >= 0.999 * raw);
    let step = step.unwrap_or(10.0 * magnitude);
    let first = (low / step - 1e-6).ceil() as i64;
    let last = (high / step + 1e-6).floor() as i64;
    (first..=last).map(|k| k as f64 * step).collect()
}

/// Returns the text of a tick with as many digits as all ticks need, with an exponent if they are large.
pub fn tick_text(tick: f64, all: &[f64]) -> String {
    if all.iter().any(|value| value.abs() >= 1e7) {
        return format!("{tick:.2e}").replace('-', "−");
    }
    let needs = |value: f64| {
        (0..=6).find(|digits| {
            let scale = 10.0_f64.powi(*digits);
            ((value * scale).round() / scale - value).abs() < 1e-9 * (1.0 + value.abs())
        })
    };
    let digits = all.iter().filter_map(|value| needs(*value)).max().unwrap_or(0);
    let text = format!("{tick:.*}", digits as usize);
    if tick.abs() < 1e-12 { "0".to_owned() } else { text.replace('-', "−") }
}

/// Returns the least and the largest value.
pub fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)])
}

/// Returns a range from zero, or a little below the least value if it is negative, to a little above the largest value.
pub fn range_from_zero(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let (low, high) = values.filter(|v| v.is_finite()).fold((0.0_f64, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
    if high - low <= 0.0 { [0.0, 1.0] } else { [1.08 * low, 1.08 * high] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within_the_range() {
        assert_eq!(ticks([-1.5, 1.5], 5), [-1.0, 0.0, 1.0]);
        assert_eq!(ticks([0.0, 0.5], 5), [0.0, 0.1, 0.2, 0.30000000000000004, 0.4, 0.5]);
        assert_eq!(ticks([3.0, 3.0], 5), [3.0]);
        assert_eq!(tick_text(0.5, &[0.0, 0.25, 0.5]), "0.50");
        assert_eq!(tick_text(-1.0, &[-1.0, 0.0]), "−1");
        assert_eq!(tick_text(-2.5e9, &[-2.5e9, 0.0]), "−2.50e9");
    }

    #[test]
    fn panel_corners_are_its_ranges() {
        let panel = Panel { corner: [10.0, 20.0], size: [100.0, 50.0], x: [0.0, 2.0], y: [-1.0, 1.0] };
        assert_eq!(panel.at([0.0, -1.0]), [10.0, 70.0]);
        assert_eq!(panel.at([2.0, 1.0]), [110.0, 20.0]);
    }
}
