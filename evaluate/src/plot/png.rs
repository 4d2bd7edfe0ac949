//! PNG from the figures' SVG, with a font of our own, so that it is the same on every machine.

use std::sync::Arc;

use resvg::{tiny_skia, usvg};

/// Pixels of the PNG per pixel of the drawing: about 300 per inch at 7 inches.
const SCALE: f32 = 2.75;

/// Renders drawings.
pub struct Renderer {
    options: usvg::Options<'static>,
}

impl Default for Renderer {
    fn default() -> Self {
        let mut options = usvg::Options { font_family: "DejaVu Sans".into(), ..usvg::Options::default() };
        let fonts = Arc::make_mut(&mut options.fontdb);
        fonts.load_font_data(dejavu::sans::regular().to_vec());
        fonts.load_font_data(dejavu::sans::bold().to_vec());
        Renderer { options }
    }
}

impl Renderer {
    /// The bytes of a PNG file.
    ///
    /// # Errors
    /// In words: it is not SVG, is larger than a picture can be, or does not encode.
    pub fn png(&self, svg: &str) -> Result<Vec<u8>, String> {
        let tree = usvg::Tree::from_str(svg, &self.options);
        let tree = tree.map_err(|error| format!("the figure is not valid SVG: {error}"))?;
        let size = tree.size();
        let (width, height) = ((SCALE * size.width()).round() as u32, (SCALE * size.height()).round() as u32);
        let mut picture = tiny_skia::Pixmap::new(width, height)
            .ok_or_else(|| format!("the figure cannot be rendered: {width} by {height} pixels"))?;
        resvg::render(&tree, tiny_skia::Transform::from_scale(SCALE, SCALE), &mut picture.as_mut());
        picture.encode_png().map_err(|error| format!("the figure cannot be rendered: {error}"))
    }
}
