//! A picture in memory on which panels are drawn: rectangles, lines and text with smooth edges.

use ab_glyph::{Font, FontRef, InvalidFont, ScaleFont, point};

use crate::style::Rgb;

/// Fonts of all text, the same on every machine.
#[derive(Clone)]
pub(super) struct Fonts {
    regular: FontRef<'static>,
    bold: FontRef<'static>,
}

/// The look of a text: its size \[px\], its colour, and whether it is bold.
#[derive(Clone, Copy)]
pub(super) struct Style {
    pub(super) size: f32,
    pub(super) colour: Rgb,
    pub(super) bold: bool,
}

/// The share of a text that is to the left of its position.
pub(super) type Anchor = f32;
pub(super) const LEFT: Anchor = 0.0;
pub(super) const MIDDLE: Anchor = 0.5;
pub(super) const RIGHT: Anchor = 1.0;

impl Fonts {
    pub(super) fn new() -> Result<Self, InvalidFont> {
        let [regular, bold] = [dejavu::sans::regular(), dejavu::sans::bold()].map(FontRef::try_from_slice);
        Ok(Fonts { regular: regular?, bold: bold? })
    }

    /// Returns the width of a text \[px\].
    pub(super) fn width(&self, text: &str, style: Style) -> f32 {
        let font = self.of(style).as_scaled(style.size);
        text.chars().map(|letter| font.h_advance(font.glyph_id(letter))).sum()
    }

    fn of(&self, style: Style) -> &FontRef<'static> {
        if style.bold { &self.bold } else { &self.regular }
    }
}

/// A picture, shape (height, width, 3), highest row first. Positions are in pixels from its upper left corner.
#[derive(Clone)]
pub(super) struct Canvas {
    width: usize,
    pub(super) rgb: Vec<u8>,
}

impl Canvas {
    pub(super) fn new([width, height]: [usize; 2], colour: Rgb) -> Self {
        Canvas { width, rgb: colour.repeat(width * height) }
    }

    /// Mixes a colour into a pixel; `share` is 0 to 1. Pixels beyond the edge are left out.
    fn blend(&mut self, x: i32, y: i32, colour: Rgb, share: f32) {
        if x < 0 || x as usize >= self.width || y < 0 {
            return;
        }
        let start = 3 * (y as usize * self.width + x as usize);
        let Some(pixel) = self.rgb.get_mut(start..start + 3) else { return };
        for (old, new) in pixel.iter_mut().zip(colour) {
            *old = (f32::from(*old) + share.clamp(0.0, 1.0) * (f32::from(new) - f32::from(*old))).round() as u8;
        }
    }

    /// Copies a picture of this width to a position.
    pub(super) fn paste(&mut self, [x, y]: [usize; 2], width: usize, picture: &[u8]) {
        for (row, pixels) in picture.chunks(3 * width).enumerate() {
            let start = 3 * ((y + row) * self.width + x);
            self.rgb[start..start + pixels.len()].copy_from_slice(pixels);
        }
    }

    /// Fills the rectangle between two corners; `share` is its opacity, 0 to 1.
    pub(super) fn rectangle(&mut self, from: [f32; 2], to: [f32; 2], colour: Rgb, share: f32) {
        for y in from[1].round() as i32..to[1].round() as i32 {
            (from[0].round() as i32..to[0].round() as i32).for_each(|x| self.blend(x, y, colour, share));
        }
    }

    /// Draws the lines between successive points; their width is in pixels.
    pub(super) fn lines(&mut self, points: &[[f32; 2]], width: f32, colour: Rgb) {
        // A pixel takes the share of the nearest line, so that joints are not darker.
        let margin = 0.5 * width + 1.0;
        let ends = |axis: usize| points.iter().map(move |point| point[axis]);
        let low = |axis| (ends(axis).fold(f32::INFINITY, f32::min) - margin).floor().max(0.0) as i32;
        let high = |axis| (ends(axis).fold(f32::NEG_INFINITY, f32::max) + margin).ceil() as i32;
        for x in low(0)..=high(0) {
            let centre = x as f32;
            let near = |pair: &&[[f32; 2]]| {
                pair[0][0].min(pair[1][0]) - margin <= centre && centre <= pair[0][0].max(pair[1][0]) + margin
            };
            let here: Vec<&[[f32; 2]]> = points.windows(2).filter(near).collect();
            if here.is_empty() {
                continue;
            }
            for y in low(1)..=high(1) {
                let distances = here.iter().map(|pair| distance([centre, y as f32], pair[0], pair[1]));
                let share = 0.5 * width + 0.5 - distances.fold(f32::INFINITY, f32::min);
                if share > 0.0 {
                    self.blend(x, y, colour, share);
                }
            }
        }
    }

    /// Writes a text on a baseline.
    pub(super) fn text(&mut self, fonts: &Fonts, [x, y]: [f32; 2], anchor: Anchor, style: Style, text: &str) {
        let font = fonts.of(style).as_scaled(style.size);
        let mut x = x - anchor * fonts.width(text, style);
        for letter in text.chars() {
            let id = font.glyph_id(letter);
            let glyph = id.with_scale_and_position(style.size, point(x, y));
            x += font.h_advance(id);
            if let Some(outline) = font.outline_glyph(glyph) {
                let corner = outline.px_bounds().min;
                outline.draw(|column, row, share| {
                    self.blend(corner.x as i32 + column as i32, corner.y as i32 + row as i32, style.colour, share);
                });
            }
        }
    }
}

/// Returns the distance of a point from the line between two others.
fn distance([x, y]: [f32; 2], [ax, ay]: [f32; 2], [bx, by]: [f32; 2]) -> f32 {
    let (dx, dy) = (bx - ax, by - ay);
    let along = (((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy).max(1e-9)).clamp(0.0, 1.0);
    (x - ax - along * dx).hypot(y - ay - along * dy)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLACK: Rgb = [0; 3];

    fn pixel(canvas: &Canvas, x: usize, y: usize) -> u8 {
        canvas.rgb[3 * (y * canvas.width + x)]
    }

    #[test]
    fn lines_have_smooth_edges_and_even_joints() {
        let mut canvas = Canvas::new([20, 10], [200; 3]);
        canvas.lines(&[[2.0, 4.0], [10.0, 4.0], [18.0, 4.0]], 2.0, BLACK);
        // A line of two pixels covers its middle row, and half of each row beside it.
        assert_eq!([2, 3, 4, 5, 6].map(|row| pixel(&canvas, 7, row)), [200, 100, 0, 100, 200]);
        assert_eq!(pixel(&canvas, 10, 3), 100);
        // Beyond the picture.
        canvas.lines(&[[-5.0, -5.0], [50.0, 50.0]], 2.0, BLACK);
    }

    #[test]
    fn text_ends_where_its_anchor_says() {
        let fonts = Fonts::new().unwrap();
        let style = Style { size: 16.0, colour: BLACK, bold: false };
        let columns = |anchor: Anchor| {
            let mut canvas = Canvas::new([200, 30], [255; 3]);
            canvas.text(&fonts, [100.0, 20.0], anchor, style, "walk");
            let is_dark = |x: &usize| (0..30).any(|y| pixel(&canvas, *x, y) < 128);
            let dark: Vec<usize> = (0..200).filter(is_dark).collect();
            [dark[0], dark[dark.len() - 1]]
        };
        let width = fonts.width("walk", style) as usize;
        let [left, middle, right] = [LEFT, MIDDLE, RIGHT].map(columns);
        assert!((100..103).contains(&left[0]) && (98..101).contains(&right[1]), "{left:?} {right:?}");
        assert!(middle[0].abs_diff(100 - width / 2) <= 2, "{middle:?} {width}");
    }
}
