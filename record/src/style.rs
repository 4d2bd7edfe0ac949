//! Colours and scales of a recording in one place. Colours are Okabe and Ito's, told apart by colour-blind people too.

use std::time::Duration;

use rerun::Color;

/// Red, green, blue.
pub type Rgb = [u8; 3];

/// The compliant policy.
pub const BLUE: Rgb = [0, 114, 178];
/// The baseline.
pub const ORANGE: Rgb = [230, 159, 0];
/// A series of a plot.
pub(super) const GREEN: Rgb = [0, 158, 115];
/// Foot forces, and labels of what went well.
pub(super) const LIGHT_GREEN: Rgb = [90, 225, 165];
/// Labels of falls and faults.
pub(super) const ALARM: Rgb = [255, 150, 110];
/// Pushes and pulls.
pub(super) const VERMILLION: Rgb = [213, 94, 0];
/// The rope of a pull.
pub(super) const YELLOW: Rgb = [240, 228, 66];
/// Paths of the feet.
pub(super) const SKY: Rgb = [86, 180, 233];
/// More series of a plot.
pub(super) const PURPLE: Rgb = [204, 121, 167];
/// The colour of commands.
pub(super) const GREY: Rgb = [160, 160, 160];

/// Behind everything in 3D; the ground fades into it.
pub(super) const BACKGROUND: Rgb = [38, 43, 50];

/// Length of a force arrow [m/N].
pub(super) const METRES_PER_NEWTON: f64 = 1.0 / 300.0;
/// Length of a push arrow [m per m/s].
pub(super) const METRES_PER_PUSH: f64 = 0.5;
/// How long a push stays visible \[s\].
pub(super) const PUSH_SHOWN_S: f64 = 0.3;
/// How long the label of an event stays visible \[s\]; that of a fall stays for good.
pub(super) const LABEL_SHOWN_S: f64 = 1.2;
/// Length of a rope between trunk and force arrow \[m\].
pub(super) const ROPE_LENGTH_M: f64 = 0.6;
/// Distance of the eye from the robot \[m\].
pub(super) const EYE_DISTANCE_M: f32 = 1.6;
/// From the robot to the eye: right of it, a little behind and above. World frame, any length.
pub(super) const EYE_DIRECTION: [f32; 3] = [-0.3, -1.0, 0.48];

/// How long to wait for a disk or a viewer before giving up on it.
pub(super) const PATIENCE: Duration = Duration::from_secs(5);

/// Halfway to white.
pub(super) fn lighter(colour: Rgb) -> Rgb {
    colour.map(|part| part / 2 + 128)
}

/// A colour of rerun.
pub(super) fn opaque([red, green, blue]: Rgb) -> Color {
    Color::from_rgb(red, green, blue)
}
