//! Pictures of a scene, drawn by MuJoCo's own renderer without a screen.

use std::ptr::NonNull;
use std::sync::RwLock;

use mujoco_sys as sys;

use super::error::{Error, Result};
use super::model::{Model, Object};
use super::{Data, EMPTY_MESSAGE, text};

/// Largest number of marks in a picture.
pub const MOST_MARKS: usize = 200;

/// Largest width and height of a picture \[px\].
pub const LARGEST_PICTURE: usize = 4096;

/// MuJoCo has one table of OpenGL's functions, which a new renderer writes and pictures read. Nothing else is behind the lock.
static FUNCTIONS: RwLock<()> = RwLock::new(());

/// Direction and distance from which a picture is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Point in the middle of the picture, world frame \[m\].
    pub target: [f64; 3],
    /// Distance from the target \[m\].
    pub distance_m: f64,
    /// Horizontal direction in which the camera looks: 0 along x, 90 along y \[deg\].
    pub azimuth_deg: f64,
    /// Vertical direction in which the camera looks: negative looks down \[deg\].
    pub elevation_deg: f64,
}

/// Shape of a mark.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MarkShape {
    /// An arrow.
    Arrow,
    /// A rod with round ends.
    Rod,
}

/// An arrow or a rod that is drawn in addition to the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// Arrow or rod.
    pub shape: MarkShape,
    /// Start, world frame \[m\].
    pub from: [f64; 3],
    /// End, world frame; an arrow's tip \[m\].
    pub to: [f64; 3],
    /// Radius \[m\].
    pub radius_m: f64,
    /// Colour and opacity, 0 to 1.
    pub rgba: [f32; 4],
}

/// A renderer of one scene; it stays on its thread, as OpenGL does.
///
/// ```
/// use supple::mujoco::{Camera, Model, Renderer};
///
/// let ball = r#"<mujoco><worldbody><geom name="ball" size="0.1" rgba="1 0 0 1"/></worldbody></mujoco>"#;
/// let model = Model::from_xml(&[("ball.xml", ball)])?;
/// // It is an error where no OpenGL is installed.
/// if let Ok(mut renderer) = Renderer::new(model, [64, 48]) {
///     let world = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]; // position, quaternion
///     let camera = Camera { target: [0.0; 3], distance_m: 1.0, azimuth_deg: 90.0, elevation_deg: 0.0 };
///     let picture = renderer.picture(&[world], &camera, &[])?;
///     let middle = picture[3 * (24 * 64 + 32)..][..3].to_vec();
///     assert!(middle[0] > 100 && middle[1] < 50, "{middle:?}");
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Renderer {
    raw: NonNull<sys::SuppleRenderer>,
    data: Data,
    size: [usize; 2],
    /// The picture as OpenGL gives it, lowest row first.
    upside_down: Vec<u8>,
}

impl Drop for Renderer {
    fn drop(&mut self) {
        let _shared = FUNCTIONS.read();
        // SAFETY: the pointer is owned, came from the shim, and is on the thread that made it.
        unsafe { sys::supple_delete_renderer(self.raw.as_ptr()) }
    }
}

impl Renderer {
    /// Creates a renderer of pictures of this width and height \[px\].
    ///
    /// # Errors
    /// The size is zero or beyond [`LARGEST_PICTURE`], no OpenGL without a screen is installed, or MuJoCo cannot use it.
    pub fn new(model: Model, size: [usize; 2]) -> Result<Self> {
        let [width, height] = size;
        if size.iter().any(|length| !(1..=LARGEST_PICTURE).contains(length)) {
            let largest = LARGEST_PICTURE;
            return Err(Error::Renderer(format!(
                "its size is {width}x{height} px, expected 1x1 to {largest}x{largest}"
            )));
        }
        let data = Data::new(model)?;
        let (mut raw, mut message) = (std::ptr::null_mut(), EMPTY_MESSAGE);
        let (model, marks) = (data.model().as_ptr(), MOST_MARKS as i32);
        let alone = FUNCTIONS.write();
        // SAFETY: the model is valid, and owned by `data`; the shim catches errors.
        let failed = unsafe {
            sys::supple_new_renderer(&mut raw, model, width as i32, height as i32, marks, message.as_mut_ptr())
        };
        drop(alone);
        let failure = || Error::Renderer(text(&message));
        let raw = NonNull::new(raw).ok_or_else(failure)?;
        // From here on it is deleted when it is dropped.
        let upside_down = vec![0; 3 * width * height];
        let renderer = Renderer { raw, data, size, upside_down };
        if failed == 0 { Ok(renderer) } else { Err(failure()) }
    }

    /// Draws bodies at their poses, shape (nbody, 7): position \[m\] and quaternion (w, x, y, z), world frame, in the model's order.
    /// Returns the picture, shape (height, width, 3): red, green, blue, highest row first.
    ///
    /// # Errors
    /// There are more marks than [`MOST_MARKS`], or MuJoCo reports a fatal error.
    ///
    /// # Panics
    /// The number of poses is not that of the model's bodies.
    pub fn picture(&mut self, poses: &[[f32; 7]], camera: &Camera, marks: &[Mark]) -> Result<Vec<u8>> {
        assert_eq!(poses.len(), self.data.model().count(Object::Body), "poses of another model");
        let (azimuth, elevation) = (camera.azimuth_deg, camera.elevation_deg);
        let view = sys::SuppleView { target: camera.target, distance: camera.distance_m, azimuth, elevation };
        let marks: Vec<sys::SuppleMark> = marks
            .iter()
            .map(|mark| sys::SuppleMark {
                from: mark.from,
                to: mark.to,
                radius: mark.radius_m,
                rgba: mark.rgba,
                is_arrow: (mark.shape == MarkShape::Arrow).into(),
            })
            .collect();
        let mut message = EMPTY_MESSAGE;
        let _shared = FUNCTIONS.read();
        // SAFETY: model and data belong together; there is a pose for every body; the buffer holds width · height · 3 bytes; the
        // shim catches errors.
        let failed = unsafe {
            sys::supple_render(
                self.raw.as_ptr(),
                self.data.model().as_ptr(),
                self.data.as_ptr(),
                poses.as_ptr().cast(),
                &view,
                marks.as_ptr(),
                marks.len() as i32,
                self.upside_down.as_mut_ptr(),
                message.as_mut_ptr(),
            )
        };
        ensure!(failed == 0, Error::Renderer(text(&message)));
        Ok(self.upside_down.chunks(3 * self.size[0]).rev().flatten().copied().collect())
    }
}
