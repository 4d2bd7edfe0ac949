/*! Figures as SVG, and as PNG rendered from the same SVG.

People with any kind of colour vision can distinguish the colours of Okabe and Ito's palette. Each set of policies also has its
own dashes and marks, for print without colour. All sets are always drawn on the same scale.
*/

pub mod axes;
pub mod curves;
pub mod dots;
pub mod heatmap;
pub mod png;
pub mod polar;
pub mod svg;
pub mod top_view;

use svg::Stroke;

/// The colour of text and axes.
pub const INK: &str = "#222222";

/// The colour of frames and secondary text.
pub const GREY: &str = "#777777";

/// The colour of grid lines.
pub const PALE: &str = "#dddddd";

/// The colours of the sets of policies: blue, orange, green, purple, sky, vermilion.
const COLOURS: [&str; 6] = ["#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00"];

/// The `stroke-dasharray` of the sets' lines.
const DASHES: [&str; 4] = ["", "6 3", "2 3", "9 3 2 3"];

/// Returns the colour of a set of policies.
pub fn colour(set: usize) -> &'static str {
    COLOURS[set % COLOURS.len()]
}

/// Returns the line style of a set of policies.
pub fn line(set: usize) -> Stroke {
    Stroke::new(colour(set), 2.0).dashed(DASHES[set % DASHES.len()])
}

/// Returns a text of at most `most` characters, cut off with an ellipsis.
pub fn shortened(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    text.chars().take(most - 1).chain(['…']).collect()
}

/// The opacity of bands.
pub const BAND: f64 = 0.22;

/// The width of a figure \[px\]; 7 inches in print.
pub const WIDTH: f64 = 760.0;

/// The text size of labels \[px\].
pub const SMALL: f64 = 11.5;
/// The text size of panel titles and legends \[px\].
pub const LARGE: f64 = 13.5;
