//! Heat maps, two in a row, with the contour of a level (Fig. 2).

use super::axes::Panel;
use super::svg::{Anchor, Stroke, Svg, Text};
use super::{INK, SMALL, WIDTH};
use crate::square_grid::SquareGrid;

/// The colour map Viridis at equal steps, whose lightness differences are equal, also in grey (red, green, blue).
const COLOURS: [[f64; 3]; 9] = [
    [68.0, 1.0, 84.0],
    [71.0, 45.0, 123.0],
    [59.0, 82.0, 139.0],
    [44.0, 114.0, 142.0],
    [33.0, 145.0, 140.0],
    [40.0, 174.0, 128.0],
    [94.0, 201.0, 98.0],
    [173.0, 220.0, 48.0],
    [253.0, 231.0, 37.0],
];

/// A heat map of fractions, 0 to 1, with its title.
pub struct Map<'a> {
    pub title: String,
    pub grid: &'a SquareGrid,
}

/// The height of a row of maps \[px\].
const ROW: f64 = 366.0;

/// Draws all maps. The grid's first coordinate runs to the right, its second up; `labels` are those of x, y and the scale.
pub fn draw(title: &str, maps: &[Map], level: f64, labels: [&str; 3]) -> String {
    let mut svg = Svg::new(WIDTH, ROW * maps.len().div_ceil(2) as f64);
    let side = 278.0;
    for (index, map) in maps.iter().enumerate() {
        let (row, column) = (index / 2, index % 2);
        let corner = [62.0 + column as f64 * (side + 30.0), ROW * row as f64 + 32.0];
        let panel = panel(corner, side, map.grid);
        panel.draw_axes(&mut svg, labels[0], (column == 0).then_some(labels[1]));
        draw_map(&mut svg, &panel, map.grid, level);
        panel.draw_frame(&mut svg);
        panel.draw_title(&mut svg, &map.title);
    }
    draw_scale(&mut svg, [62.0 + 2.0 * side + 52.0, 32.0], side, level, labels[2]);
    svg.finish(title)
}

/// Returns the panel of a grid. Cells are centred on their grid points, so it reaches half a cell beyond the grid.
fn panel(corner: [f64; 2], side: f64, grid: &SquareGrid) -> Panel {
    let last = grid.coordinates.len() - 1;
    let half = 0.5 * (grid.coordinates[1] - grid.coordinates[0]);
    let range = [grid.coordinates[0] - half, grid.coordinates[last] + half];
    Panel { corner, size: [side, side], x: range, y: range }
}

fn draw_map(svg: &mut Svg, panel: &Panel, grid: &SquareGrid, level: f64) {
    let half = 0.5 * (grid.coordinates[1] - grid.coordinates[0]);
    let side = grid.coordinates.len();
    for (index, value) in grid.values.iter().enumerate() {
        let (x, y) = (grid.coordinates[index / side], grid.coordinates[index % side]);
        let corner = panel.at([x - half, y + half]);
        let opposite = panel.at([x + half, y - half]);
        // Cells reach a little under their right and lower neighbours, or rounding to pixels would leave seams.
        let under = |has_neighbour: bool| if has_neighbour { 0.7 } else { 0.0 };
        let width = opposite[0] - corner[0] + under(index / side + 1 < side);
        let height = opposite[1] - corner[1] + under(index % side > 0);
        svg.rectangle(corner, [width, height], &colour(*value));
    }
    // White under black is visible on every colour.
    let segments = grid.contour(level);
    for stroke in [Stroke::new("#ffffff", 4.5), Stroke::new(INK, 2.0)] {
        for [from, to] in &segments {
            svg.line(panel.at(*from), panel.at(*to), stroke);
        }
    }
}

fn draw_scale(svg: &mut Svg, corner: [f64; 2], height: f64, level: f64, label: &str) {
    let (width, steps) = (15.0, 50);
    for step in 0..steps {
        let fraction = (step as f64 + 0.5) / steps as f64;
        let y = corner[1] + height * (1.0 - (step + 1) as f64 / steps as f64);
        svg.rectangle([corner[0], y], [width, height / steps as f64 + 0.3], &colour(fraction));
    }
    for percent in [0.0, 20.0, 40.0, 60.0, 80.0, 100.0] {
        let y = corner[1] + height * (1.0 - percent / 100.0);
        svg.text([corner[0] + width + 6.0, y + 4.0], &format!("{percent:.0}"), Text::new(SMALL, Anchor::Start));
    }
    let y = corner[1] + height * (1.0 - level);
    for stroke in [Stroke::new("#ffffff", 4.5), Stroke::new(INK, 2.0)] {
        svg.line([corner[0], y], [corner[0] + width, y], stroke);
    }
    let at = [corner[0] + width + 44.0, corner[1] + 0.5 * height];
    svg.text(at, label, Text { upwards: true, ..Text::new(SMALL, Anchor::Middle) });
}

fn colour(fraction: f64) -> String {
    let position = fraction.clamp(0.0, 1.0) * (COLOURS.len() - 1) as f64;
    let lower = (position as usize).min(COLOURS.len() - 2);
    let part = position - lower as f64;
    let mix =
        |channel: usize| (COLOURS[lower][channel] * (1.0 - part) + COLOURS[lower + 1][channel] * part).round() as u8;
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}
