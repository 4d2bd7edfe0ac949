//! Colours and scales of recordings. The colours are those of Okabe and Ito, which colour-blind people can distinguish.

use std::time::Duration;

use re_sdk_types::components::Color;

/// A colour: red, green, blue.
pub type Rgb = [u8; 3];

/// Colour of the compliant policy.
pub const BLUE: Rgb = [0, 114, 178];
/// Colour of the baseline.
pub const ORANGE: Rgb = [230, 159, 0];
/// Colour of a series in plots.
pub(super) const GREEN: Rgb = [0, 158, 115];
/// Colour of foot forces and of the labels of successes.
pub(super) const LIGHT_GREEN: Rgb = [90, 225, 165];
/// Colour of the labels of falls and faults.
pub(super) const ALARM: Rgb = [255, 150, 110];
/// Colour of pushes and pulls.
pub(super) const VERMILLION: Rgb = [213, 94, 0];
/// Colour of a pull's rope.
pub(super) const YELLOW: Rgb = [240, 228, 66];
/// Colour of the feet's trails.
pub(super) const SKY: Rgb = [86, 180, 233];
/// Another colour of series in plots.
pub(super) const PURPLE: Rgb = [204, 121, 167];
/// Colour of commands.
pub(super) const GREY: Rgb = [160, 160, 160];

/// Background colour of 3D views; the ground fades into it.
pub(super) const BACKGROUND: Rgb = [38, 43, 50];

/// Length of a force arrow [m/N].
pub(super) const METRES_PER_NEWTON: f64 = 1.0 / 300.0;
/// Length of a push arrow [m per m/s].
pub(super) const METRES_PER_PUSH: f64 = 0.5;
/// Time for which the label of an event stays visible \[s\]; that of a fall stays for good.
pub(super) const LABEL_SHOWN_S: f64 = 1.2;
/// Length of a rope between trunk and force arrow \[m\].
pub(super) const ROPE_LENGTH_M: f64 = 0.6;
/// Distance of the camera from the robot \[m\].
pub(super) const EYE_DISTANCE_M: f32 = 1.6;
/// Direction from the robot to the camera: right of it, a little behind and above. World frame, any length.
pub(super) const EYE_DIRECTION: [f32; 3] = [-0.3, -1.0, 0.48];

/// Time constant of the camera \[s\].
pub(super) const CAMERA_LAG_S: f32 = 0.25;

/// Longest wait for a disk or a viewer before it counts as failed.
pub(super) const PATIENCE: Duration = Duration::from_secs(5);

/// Returns the colour halfway to white.
pub(super) fn lighter(colour: Rgb) -> Rgb {
    colour.map(|part| part / 2 + 128)
}

/// Converts a colour to rerun's type.
pub(super) fn opaque([red, green, blue]: Rgb) -> Color {
    Color::from_rgb(red, green, blue)
}
