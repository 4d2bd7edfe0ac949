/*! Figures as SVG, and as PNG rendered from the same SVG.

Blue and orange of Okabe and Ito's palette are told apart by every kind of colour vision; the lines of the second method are
dashed and its marks square, for print without colour. Both methods are always drawn on the same scale.
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

/// Grid lines.
pub const PALE: &str = "#dddddd";

/// The two sets of policies: blue, orange.
pub const COLOURS: [&str; 2] = ["#0072B2", "#E69F00"];

/// Lines of the two sets of policies.
pub const LINES: [Stroke; 2] = [Stroke::new(COLOURS[0], 2.0), Stroke::new(COLOURS[1], 2.0).dashed("6 3")];

/// Opacity of bands.
pub const BAND: f64 = 0.22;

/// Width of a figure \[px\]; 7 inches in print.
pub const WIDTH: f64 = 760.0;

/// Text sizes \[px\].
pub const SMALL: f64 = 11.5;
/// Panel titles and legends \[px\].
pub const LARGE: f64 = 13.5;
