//! A quantity by direction: mean ± standard deviation of all sets in one panel (Figs. 4 and 5).

use std::f64::consts::TAU;

use super::axes::{draw_legend, draw_mark, tick_text, ticks};
use super::svg::{Anchor, Stroke, Svg, Text};
use super::{BAND, GREY, LARGE, PALE, SMALL, WIDTH, colour, line};
use crate::statistics::Spread;

/// The radius of a panel \[px\].
const RADIUS: f64 = 134.0;

/// A panel with a quantity in directions that divide the circle evenly, counter-clockwise from forward.
pub struct Polar {
    pub title: String,
    /// The values by set, then by direction; none where a value is undefined.
    pub sets: Vec<Vec<Option<Spread>>>,
}

/// The scales of the panels, one for all or their own; all sets of a panel share one.
pub enum Scales {
    Shared,
    Own,
    /// The outermost circle of all panels is 100 %, and what lies beyond it is cut off.
    Percent,
}

/// Returns directions that divide the circle evenly, counter-clockwise from forward \[deg\].
pub fn evenly(count: u32) -> Vec<f64> {
    (0..count).map(|k| 360.0 * f64::from(k) / f64::from(count)).collect()
}

/// Draws panels side by side.
pub fn draw(title: &str, panels: &[Polar], names: &[String], axis: &str, scales: Scales) -> String {
    let mut svg = Svg::new(WIDTH, 410.0);
    for (index, panel) in panels.iter().enumerate() {
        let scale = match scales {
            Scales::Shared => Scale::new(panels),
            Scales::Own => Scale::new(std::slice::from_ref(panel)),
            Scales::Percent => Scale { low: 0.0, high: 100.0 },
        };
        let centre = [WIDTH * (index as f64 + 0.5) / panels.len() as f64 - 6.0, 188.0];
        draw_rings(&mut svg, centre, scale, axis);
        for (set, values) in panel.sets.iter().enumerate().rev() {
            draw_set(&mut svg, centre, scale, values, set);
        }
        draw_ring_labels(&mut svg, centre, scale);
        svg.text([centre[0], 20.0], &panel.title, Text { bold: true, ..Text::new(LARGE, Anchor::Middle) });
    }
    draw_legend(&mut svg, [WIDTH * 0.5, 400.0], names);
    svg.finish(title)
}

/// The scale from values to radii; negative values lie inside the circle of zero.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Scale {
    low: f64,
    high: f64,
}

impl Scale {
    fn new(panels: &[Polar]) -> Self {
        let spreads = panels.iter().flat_map(|panel| panel.sets.iter().flatten().flatten());
        // A band reaches below zero only if a mean does: times that vary much are not negative.
        let is_signed = spreads.clone().any(|spread| spread.mean < 0.0);
        let ends = spreads.flat_map(|spread| {
            let sd = spread.sd.unwrap_or(0.0);
            [if is_signed { spread.mean - sd } else { spread.mean }, spread.mean + sd]
        });
        let (low, high) = ends.fold((0.0_f64, 0.0_f64), |(low, high), value| (low.min(value), high.max(value)));
        Scale { low: 1.02 * low, high: if high > low { 1.02 * high } else { 1.0 } }
    }

    fn at(&self, centre: [f64; 2], angle: f64, value: f64) -> [f64; 2] {
        let radius = RADIUS * ((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0);
        [centre[0] + radius * angle.cos(), centre[1] - radius * angle.sin()]
    }
}

fn draw_rings(svg: &mut Svg, centre: [f64; 2], scale: Scale, axis: &str) {
    for spoke in 0..8 {
        let angle = TAU * f64::from(spoke) / 8.0;
        svg.line(scale.at(centre, angle, scale.low), scale.at(centre, angle, scale.high), Stroke::new(PALE, 1.0));
    }
    let rings = ticks([scale.low, scale.high], 5);
    let lowest = rings.first().copied().unwrap_or(0.0);
    for ring in rings.iter().filter(|ring| **ring > scale.low + 1e-9) {
        let radius = RADIUS * (ring - scale.low) / (scale.high - scale.low);
        // The ring of zero is darker if there are negative values inside it.
        let colour = if *ring == 0.0 && lowest < 0.0 { GREY } else { PALE };
        svg.circle(centre, radius, "none", Stroke::new(colour, 1.0));
    }
    svg.circle(centre, RADIUS, "none", Stroke::new(GREY, 1.0));
    let out = RADIUS + 8.0;
    let style = |anchor| Text::new(SMALL, anchor);
    svg.text([centre[0] + out, centre[1] + 4.0], "forward", style(Anchor::Start));
    svg.text([centre[0], centre[1] - out], "left", style(Anchor::Middle));
    svg.text([centre[0] - out, centre[1] + 4.0], "back", style(Anchor::End));
    svg.text([centre[0], centre[1] + out + 9.0], "right", style(Anchor::Middle));
    svg.text([centre[0], centre[1] + out + 26.0], axis, Text { colour: GREY, ..style(Anchor::Middle) });
}

/// Draws the values of the rings, over everything else.
fn draw_ring_labels(svg: &mut Svg, centre: [f64; 2], scale: Scale) {
    let rings = ticks([scale.low, scale.high], 5);
    // An angle between two directions.
    let angle = TAU / 16.0 + TAU / 64.0;
    for ring in rings.iter().filter(|ring| **ring > scale.low + 0.05 * (scale.high - scale.low)) {
        let [x, y] = scale.at(centre, angle, *ring);
        svg.text([x, y + 4.0], &tick_text(*ring, &rings), Text { rimmed: true, ..Text::new(SMALL, Anchor::Middle) });
    }
}

fn draw_set(svg: &mut Svg, centre: [f64; 2], scale: Scale, values: &[Option<Spread>], set: usize) {
    let count = values.len();
    let point = |direction: usize, offset: f64| {
        let spread = values[direction % count]?;
        let angle = TAU * (direction % count) as f64 / count as f64;
        Some(scale.at(centre, angle, spread.mean + offset * spread.sd.unwrap_or(0.0)))
    };
    let all = |offset| (0..count).map(|direction| point(direction, offset)).collect::<Option<Vec<_>>>();
    if let (Some(outer), Some(inner), Some(middle)) = (all(1.0), all(-1.0), all(0.0)) {
        svg.area(&[&outer, &inner], colour(set), BAND);
        svg.outline(&middle, line(set));
    }
    // A direction without a number is a gap.
    let has_gap = all(0.0).is_none();
    for direction in 0..count {
        let between = |offset| Some([point(direction, offset)?, point(direction + 1, offset)?]);
        if let (true, Some([from, to]), Some(outer), Some(inner)) = (has_gap, between(0.0), between(1.0), between(-1.0))
        {
            svg.area(&[&[outer[0], outer[1], inner[1], inner[0]]], colour(set), BAND);
            svg.line(from, to, line(set));
        }
        if let Some(at) = point(direction, 0.0) {
            draw_mark(svg, at, set, 2.6, true);
        }
    }
}
