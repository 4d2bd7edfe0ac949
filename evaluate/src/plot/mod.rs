/*! Figures as SVG, and as PNG rendered from the same SVG.

The colours of Okabe and Ito's palette are told apart by every kind of colour vision; the lines of the second set of policies
are dashed and its marks square, and so on, for print without colour. All sets are always drawn on the same scale.
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

/// Text and axes.
pub const INK: &str = "#222222";

/// Second-rank text and frames.
pub const GREY: &str = "#777777";

/// The colour of grid lines.
pub const PALE: &str = "#dddddd";

/// Colours of the sets of policies: blue, orange, green, purple, sky, vermilion.
const COLOURS: [&str; 6] = ["#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00"];

/// Dashes of their lines.
const DASHES: [&str; 4] = ["", "6 3", "2 3", "9 3 2 3"];

/// Colour of a set of policies.
pub fn colour(set: usize) -> &'static str {
    COLOURS[set % COLOURS.len()]
}

/// Line of a set of policies.
pub fn line(set: usize) -> Stroke {
    Stroke::new(colour(set), 2.0).dashed(DASHES[set % DASHES.len()])
}

/// Opacity of bands.
pub const BAND: f64 = 0.22;

/// Width of a figure \[px\]; 7 inches in print.
pub const WIDTH: f64 = 760.0;

/// Text sizes \[px\].
pub const SMALL: f64 = 11.5;
/// Panel titles and legends \[px\].
pub const LARGE: f64 = 13.5;
