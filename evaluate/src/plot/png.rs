//! PNG files from SVG figures, with an embedded font, so that they are the same on every machine.

use std::sync::Arc;

use resvg::{tiny_skia, usvg};

/// The number of pixels of the PNG per pixel of the figure: about 300 per inch at a width of 7 inches.
const SCALE: f32 = 2.75;

/// The reason why a figure cannot be rendered as PNG: it is not a valid SVG, is too large for memory, or cannot be encoded.
#[derive(Debug, thiserror::Error)]
#[error("the figure cannot be rendered: {0}")]
pub struct RenderError(Box<dyn std::error::Error + Send + Sync>);

/// Renders SVG figures as PNG.
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
    /// Returns the bytes of a PNG file; see [`RenderError`].
    pub fn png(&self, svg: &str) -> Result<Vec<u8>, RenderError> {
        let tree = usvg::Tree::from_str(svg, &self.options).map_err(|error| RenderError(error.into()))?;
        let size = tree.size();
        let (width, height) = ((SCALE * size.width()).round() as u32, (SCALE * size.height()).round() as u32);
        let size = || RenderError(format!("{width} by {height} pixels").into());
        let mut picture = tiny_skia::Pixmap::new(width, height).ok_or_else(size)?;
        resvg::render(&tree, tiny_skia::Transform::from_scale(SCALE, SCALE), &mut picture.as_mut());
        picture.encode_png().map_err(|error| RenderError(error.into()))
    }
}
