//! A small writer of SVG: just what the figures need, with attributes that every viewer and rasteriser knows.

use std::fmt::Write as _;

/// A drawing that is being written. Lengths in pixels, y down.
#[derive(Debug, Clone, PartialEq)]
pub struct Svg {
    width: f64,
    height: f64,
    body: String,
}

/// How a line looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stroke {
    /// The colour as `#rrggbb`.
    pub colour: &'static str,
    /// \[px\]
    pub width: f64,
    /// `stroke-dasharray`, empty for a full line.
    pub dash: &'static str,
    /// 0 to 1.
    pub opacity: f64,
}

impl Stroke {
    /// A full line.
    pub const fn new(colour: &'static str, width: f64) -> Self {
        Stroke { colour, width, dash: "", opacity: 1.0 }
    }

    /// The same, dashed.
    pub const fn dashed(mut self, dash: &'static str) -> Self {
        self.dash = dash;
        self
    }

    /// The same, see-through.
    pub const fn faint(mut self, opacity: f64) -> Self {
        self.opacity = opacity;
        self
    }

    fn attributes(&self) -> String {
        let dash = if self.dash.is_empty() { String::new() } else { format!(r#" stroke-dasharray="{}""#, self.dash) };
        // Round ends would fill the gaps of a dashed line.
        let cap = if self.dash.is_empty() { "round" } else { "butt" };
        let opacity = if self.opacity < 1.0 { format!(r#" stroke-opacity="{}""#, self.opacity) } else { String::new() };
        format!(
            r#"stroke="{}" stroke-width="{}"{dash}{opacity} stroke-linejoin="round" stroke-linecap="{cap}""#,
            self.colour, self.width
        )
    }
}

/// Where a text's given point is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// At its left end.
    Start,
    /// The middle of the text.
    Middle,
    /// At its right end.
    End,
}

/// How a text looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Text {
    /// \[px\]
    pub size: f64,
    /// The colour as `#rrggbb`.
    pub colour: &'static str,
    /// Heavier.
    pub bold: bool,
    /// Where the point is.
    pub anchor: Anchor,
    /// Reads upwards.
    pub upwards: bool,
    /// Draws a white rim, so that the text can be read over lines.
    pub rimmed: bool,
}

impl Text {
    /// Dark, regular, level.
    pub const fn new(size: f64, anchor: Anchor) -> Self {
        Text { size, colour: super::INK, bold: false, anchor, upwards: false, rimmed: false }
    }

    /// Sets the colour.
    pub const fn coloured(mut self, colour: &'static str) -> Self {
        self.colour = colour;
        self
    }

    /// Heavier.
    pub const fn bold(mut self) -> Self {
        self.bold = true;
        self
    }

    /// Adds a white rim.
    pub const fn rimmed(mut self) -> Self {
        self.rimmed = true;
        self
    }

    /// Reads upwards.
    pub const fn upwards(mut self) -> Self {
        self.upwards = true;
        self
    }
}

impl Svg {
    /// An empty white drawing.
    pub fn new(width: f64, height: f64) -> Self {
        Svg { width, height, body: String::new() }
    }

    fn add(&mut self, element: std::fmt::Arguments<'_>) {
        // Writing into a String cannot fail.
        let _ = self.body.write_fmt(element);
        self.body.push('\n');
    }

    /// A line from one point to another.
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], stroke: Stroke) {
        let ([x1, y1], [x2, y2]) = (from, to);
        self.add(format_args!(
            r#"<line x1="{x1:.2}" y1="{y1:.2}" x2="{x2:.2}" y2="{y2:.2}" {}/>"#,
            stroke.attributes()
        ));
    }

    /// A line through points.
    pub fn polyline(&mut self, points: &[[f64; 2]], stroke: Stroke) {
        self.add(format_args!(r#"<polyline points="{}" fill="none" {}/>"#, list(points), stroke.attributes()));
    }

    /// A closed line through points.
    pub fn outline(&mut self, points: &[[f64; 2]], stroke: Stroke) {
        self.add(format_args!(r#"<polygon points="{}" fill="none" {}/>"#, list(points), stroke.attributes()));
    }

    /// A filled area within closed lines; where two overlap, it is empty.
    pub fn area(&mut self, loops: &[&[[f64; 2]]], colour: &str, opacity: f64) {
        let path: String =
            loops.iter().filter(|points| !points.is_empty()).map(|points| format!("M{}Z", list(points))).collect();
        self.add(format_args!(
            r#"<path d="{path}" fill="{colour}" fill-opacity="{opacity}" fill-rule="evenodd" stroke="none"/>"#
        ));
    }

    /// A filled rectangle. Its edges are not smoothed, so that neighbours meet without a seam.
    pub fn rectangle(&mut self, corner: [f64; 2], size: [f64; 2], colour: &str) {
        self.add(format_args!(
            r#"<rect x="{:.2}" y="{:.2}" width="{:.2}" height="{:.2}" fill="{colour}" shape-rendering="crispEdges"/>"#,
            corner[0], corner[1], size[0], size[1]
        ));
    }

    /// A circle; `fill` may be `none`.
    pub fn circle(&mut self, centre: [f64; 2], radius: f64, fill: &str, stroke: Stroke) {
        self.add(format_args!(
            r#"<circle cx="{:.2}" cy="{:.2}" r="{radius:.2}" fill="{fill}" {}/>"#,
            centre[0],
            centre[1],
            stroke.attributes()
        ));
    }

    /// A text on the line through its point.
    pub fn text(&mut self, at: [f64; 2], text: &str, style: Text) {
        let [x, y] = at;
        let anchor = match style.anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let weight = if style.bold { r#" font-weight="bold""# } else { "" };
        let turn = if style.upwards { format!(r#" transform="rotate(-90 {x:.2} {y:.2})""#) } else { String::new() };
        let rim = if style.rimmed {
            r#" stroke="white" stroke-width="3.5" stroke-linejoin="round" paint-order="stroke""#
        } else {
            ""
        };
        self.add(format_args!(
            r#"<text x="{x:.2}" y="{y:.2}" font-size="{}" fill="{}" text-anchor="{anchor}"{weight}{rim}{turn}>{}</text>"#,
            style.size,
            style.colour,
            escaped(text)
        ));
    }

    /// The finished drawing; `title` is read out instead of it.
    pub fn finish(self, title: &str) -> String {
        let Svg { width, height, body } = self;
        format!(
            r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" font-family="DejaVu Sans, Verdana, sans-serif" role="img">
<title>{}</title>
<rect width="{width}" height="{height}" fill="white"/>
{body}</svg>
"#,
            escaped(title)
        )
    }
}

fn list(points: &[[f64; 2]]) -> String {
    points.iter().map(|[x, y]| format!("{x:.2},{y:.2}")).collect::<Vec<_>>().join(" ")
}

/// Returns a text with the characters replaced that XML reserves.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
