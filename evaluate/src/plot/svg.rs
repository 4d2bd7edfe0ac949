//! A small SVG writer for the figures, with attributes that every viewer and rasteriser supports.

use std::fmt::Write as _;

/// An SVG drawing under construction. Lengths are in pixels, y points down.
pub struct Svg {
    width: f64,
    height: f64,
    body: String,
}

/// The style of a line: colour as `#rrggbb`, width \[px\], `stroke-dasharray`, and opacity, 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stroke {
    pub colour: &'static str,
    pub width: f64,
    pub dash: &'static str,
    pub opacity: f64,
}

impl Stroke {
    /// Creates a solid, opaque line.
    pub const fn new(colour: &'static str, width: f64) -> Self {
        Stroke { colour, width, dash: "", opacity: 1.0 }
    }

    pub const fn dashed(mut self, dash: &'static str) -> Self {
        self.dash = dash;
        self
    }

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

/// The part of a text that lies at its given point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    Start,
    Middle,
    End,
}

/// The style of a text of a font size \[px\]; `upwards` text reads from bottom to top.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Text {
    pub size: f64,
    pub colour: &'static str,
    pub bold: bool,
    pub anchor: Anchor,
    pub upwards: bool,
    /// True for a white rim, which keeps text readable over lines.
    pub rimmed: bool,
}

impl Text {
    /// Creates a dark, regular, horizontal text style.
    pub const fn new(size: f64, anchor: Anchor) -> Self {
        Text { size, colour: super::INK, bold: false, anchor, upwards: false, rimmed: false }
    }
}

impl Svg {
    pub fn new(width: f64, height: f64) -> Self {
        Svg { width, height, body: String::new() }
    }

    fn add(&mut self, element: std::fmt::Arguments<'_>) {
        // Writing into a String cannot fail.
        let _ = self.body.write_fmt(element);
        self.body.push('\n');
    }

    /// Adds a line from one point to another.
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], stroke: Stroke) {
        let ([x1, y1], [x2, y2], style) = (from, to, stroke.attributes());
        self.add(format_args!(r#"<line x1="{x1:.2}" y1="{y1:.2}" x2="{x2:.2}" y2="{y2:.2}" {style}/>"#));
    }

    /// Adds a line through points.
    pub fn polyline(&mut self, points: &[[f64; 2]], stroke: Stroke) {
        self.add(format_args!(r#"<polyline points="{}" fill="none" {}/>"#, list(points), stroke.attributes()));
    }

    /// Adds a closed line through points.
    pub fn outline(&mut self, points: &[[f64; 2]], stroke: Stroke) {
        self.add(format_args!(r#"<polygon points="{}" fill="none" {}/>"#, list(points), stroke.attributes()));
    }

    /// Adds a filled area within closed lines; where two lines overlap, it is empty.
    pub fn area(&mut self, loops: &[&[[f64; 2]]], colour: &str, opacity: f64) {
        let loops = loops.iter().filter(|points| !points.is_empty());
        let path: String = loops.map(|points| format!("M{}Z", list(points))).collect();
        let style = format!(r#"fill="{colour}" fill-opacity="{opacity}" fill-rule="evenodd" stroke="none""#);
        self.add(format_args!(r#"<path d="{path}" {style}/>"#));
    }

    /// Adds a filled rectangle. Its edges are not smoothed, so that neighbours meet without a seam.
    pub fn rectangle(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], colour: &str) {
        let style = format!(r#"fill="{colour}" shape-rendering="crispEdges""#);
        self.add(format_args!(r#"<rect x="{x:.2}" y="{y:.2}" width="{width:.2}" height="{height:.2}" {style}/>"#));
    }

    /// Adds a circle; `fill` may be `none`.
    pub fn circle(&mut self, [x, y]: [f64; 2], radius: f64, fill: &str, stroke: Stroke) {
        let style = stroke.attributes();
        self.add(format_args!(r#"<circle cx="{x:.2}" cy="{y:.2}" r="{radius:.2}" fill="{fill}" {style}/>"#));
    }

    /// Adds a text whose baseline goes through its point.
    pub fn text(&mut self, [x, y]: [f64; 2], text: &str, style: Text) {
        let Text { size, colour, .. } = style;
        let anchor = match style.anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let weight = if style.bold { r#" font-weight="bold""# } else { "" };
        let turn = if style.upwards { format!(r#" transform="rotate(-90 {x:.2} {y:.2})""#) } else { String::new() };
        let rim = r#" stroke="white" stroke-width="3.5" stroke-linejoin="round" paint-order="stroke""#;
        let rim = if style.rimmed { rim } else { "" };
        let (text, style) = (escaped(text), format!(r#"text-anchor="{anchor}"{weight}{rim}{turn}"#));
        self.add(format_args!(
            r#"<text x="{x:.2}" y="{y:.2}" font-size="{size}" fill="{colour}" {style}>{text}</text>"#
        ));
    }

    /// Returns the SVG document; screen readers read `title`.
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

/// Returns a text with the characters replaced that XML reserves or cannot hold.
fn escaped(text: &str) -> String {
    let text = text.replace(char::is_control, " ").replace('&', "&amp;");
    text.replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
