//! Quantities by condition: mean ± standard deviation of each set (of percentages, as far as 0 and 100 %), and each seed as a small
//! hollow mark.

use super::axes::{Panel, draw_legend, draw_mark, range_from_zero};
use super::svg::{Anchor, Stroke, Svg, Text};
use super::{GREY, PALE, SMALL, WIDTH, colour, shortened};
use crate::Quantity;
use crate::statistics::{PerSeed, Spread};

/// The height of a set within the row of a condition \[px\].
const SET: f64 = 14.0;

/// The largest number of characters of a label; tables have the whole label.
const MOST_LABEL: usize = 60;

/// The least width of a panel \[px\].
const LEAST_WIDTH: f64 = 40.0;

/// Returns the height of the row of a condition \[px\].
fn row_height(sets: usize) -> f64 {
    SET * sets as f64 + 6.0
}

/// A panel with one quantity along x, whose rows are its values by condition, then by set.
#[derive(Debug, Clone, PartialEq)]
pub struct Dots {
    pub quantity: Quantity,
    pub rows: Vec<Vec<PerSeed>>,
}

/// Draws panels side by side with a row for each condition. `labels` has one text for each row.
pub fn draw(title: &str, panels: &[Dots], labels: &[String], names: &[String]) -> String {
    let line = row_height(names.len());
    let height = line * labels.len() as f64;
    let mut svg = Svg::new(WIDTH, height + 92.0);
    let labels: Vec<String> = labels.iter().map(|label| shortened(label, MOST_LABEL)).collect();
    let longest = labels.iter().map(|label| label.chars().count()).max().unwrap_or(0) as f64;
    let left = 20.0 + 0.56 * SMALL * longest;
    let gap = 24.0;
    let width = ((WIDTH - left - 16.0) / panels.len().max(1) as f64 - gap).max(LEAST_WIDTH);
    for (row, label) in labels.iter().enumerate() {
        let y = 14.0 + line * (row as f64 + 0.5);
        svg.text([left - 4.0, y + 4.0], label, Text::new(SMALL, Anchor::End));
    }
    for (index, dots) in panels.iter().enumerate() {
        let scale = dots.quantity.scale();
        let reach = |values: &PerSeed| Spread::from_values(values).map(|spread| spread.mean + spread.sd.unwrap_or(0.0));
        let rows = || dots.rows.iter().flatten();
        let values = rows().flat_map(|values| values.values().copied()).chain(rows().filter_map(reach));
        let values = values.map(|value| scale * value);
        let x = if scale > 1.0 { [-4.0, 104.0] } else { range_from_zero(values) };
        let corner = [left + gap * 0.5 + index as f64 * (width + gap), 14.0];
        let panel = Panel { corner, size: [width, height], x, y: [0.0, 1.0] };
        draw_panel(&mut svg, &panel, dots, scale);
    }
    draw_legend(&mut svg, [0.5 * WIDTH, height + 80.0], names);
    svg.finish(title)
}

fn draw_panel(svg: &mut Svg, panel: &Panel, dots: &Dots, scale: f64) {
    let [left, top] = panel.corner;
    let bottom = top + panel.size[1];
    let ticks = super::axes::ticks(panel.x, (panel.size[0] / 45.0).clamp(2.0, 5.0) as usize);
    for tick in &ticks {
        let x = panel.at([*tick, 0.0])[0];
        svg.line([x, top], [x, bottom], Stroke::new(PALE, 1.0));
        svg.text([x, bottom + 15.0], &super::axes::tick_text(*tick, &ticks), Text::new(SMALL, Anchor::Middle));
    }
    panel.draw_frame(svg);
    svg.text([left + 0.5 * panel.size[0], bottom + 33.0], &dots.quantity.axis(), Text::new(SMALL, Anchor::Middle));
    for (row, sets) in dots.rows.iter().enumerate() {
        for (set, values) in sets.iter().enumerate() {
            let from_middle = SET * (set as f64 - 0.5 * (sets.len() as f64 - 1.0));
            let y = top + row_height(sets.len()) * (row as f64 + 0.5) + from_middle;
            // A standard deviation may reach beyond possible values.
            let [least, most] = if scale > 1.0 { [0.0, 1.0] } else { panel.x };
            let at = |value: f64| [panel.at([scale * value.clamp(least, most), 0.0])[0], y];
            if values.len() > 1 {
                for value in values.values() {
                    draw_mark(svg, at(*value), set, 2.2, false);
                }
            }
            let Some(spread) = Spread::from_values(values) else {
                svg.text([left + 5.0, y + 4.0], "no value", Text { colour: GREY, ..Text::new(SMALL, Anchor::Start) });
                continue;
            };
            let sd = spread.sd.unwrap_or(0.0);
            svg.line(at(spread.mean - sd), at(spread.mean + sd), Stroke::new(colour(set), 2.0));
            draw_mark(svg, at(spread.mean), set, 4.2, true);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panels_fit_beside_labels_of_any_length() {
        let quantity = Quantity::new("x_m", "x", "m", 1);
        let rows = vec![vec![PerSeed::from([(0, 1.0), (1, 2.0)])]];
        let panels = vec![Dots { quantity, rows }; 6];
        let label = "0".repeat(400);
        let svg = draw("title", &panels, std::slice::from_ref(&label), &["a".to_owned()]);
        assert!(svg.contains("…") && !svg.contains(&label));
    }
}
