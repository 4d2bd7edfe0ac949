//! PNG from the figures' SVG, with a font of our own, so that it is the same on every machine.

use std::sync::Arc;

use resvg::{tiny_skia, usvg};

/// Pixels of the PNG per pixel of the drawing: about 300 per inch at 7 inches.
const SCALE: f32 = 2.75;

/// Why no PNG was made.
#[derive(Debug, thiserror::Error)]
pub enum PngError {
    /// Our SVG is not SVG.
    #[error("the figure is not valid SVG: {0}")]
    Svg(#[from] usvg::Error),
    /// Larger than a picture can be, or it does not encode.
    #[error("the figure cannot be rendered: {0}")]
    Render(String),
}

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
    /// [`PngError`]
    pub fn png(&self, svg: &str) -> Result<Vec<u8>, PngError> {
        let tree = usvg::Tree::from_str(svg, &self.options)?;
        let size = tree.size();
        let (width, height) = ((SCALE * size.width()).round() as u32, (SCALE * size.height()).round() as u32);
        let mut picture = tiny_skia::Pixmap::new(width, height)
            .ok_or_else(|| PngError::Render(format!("{width} by {height} pixels")))?;
        resvg::render(&tree, tiny_skia::Transform::from_scale(SCALE, SCALE), &mut picture.as_mut());
        picture.encode_png().map_err(|error| PngError::Render(error.to_string()))
    }
}
