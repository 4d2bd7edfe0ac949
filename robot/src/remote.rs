/*! The state of the robot's remote, as the 40 bytes `wireless_remote` of the robot's state carry it. */

use supple::config::CommandRange;
use supple::task::Command;

/// Buttons of the remote that have a meaning, by the bit that carries them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Button {
    Start = 2,
    Select = 3,
    L2 = 5,
    A = 8,
    B = 9,
    X = 10,
}

/// Sticks and buttons of the remote.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Remote {
    /// Left stick, to the right and up, each from −1 to 1.
    pub left: [f32; 2],
    /// Right stick, to the right and up, each from −1 to 1.
    pub right: [f32; 2],
    /// One bit for each [`Button`].
    pub buttons: u16,
}

impl Remote {
    /// Reads the bytes. Sticks that are not finite count as released.
    pub fn from_bytes(bytes: &[u8; 40]) -> Self {
        let stick = |at: usize| {
            let value = f32::from_le_bytes(std::array::from_fn(|k| bytes[at + k]));
            if value.is_finite() { value.clamp(-1.0, 1.0) } else { 0.0 }
        };
        let buttons = u16::from_le_bytes([bytes[2], bytes[3]]);
        Remote { left: [stick(4), stick(20)], right: [stick(8), stick(12)], buttons }
    }

    pub fn to_bytes(self) -> [u8; 40] {
        let mut bytes = [0; 40];
        (bytes[0], bytes[1]) = (0x55, 0x51);
        bytes[2..4].copy_from_slice(&self.buttons.to_le_bytes());
        for (at, value) in [(4, self.left[0]), (8, self.right[0]), (12, self.right[1]), (20, self.left[1])] {
            bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        bytes
    }

    pub fn is_pressed(&self, button: Button) -> bool {
        self.buttons >> button as u16 & 1 == 1
    }

    /// Returns the remote with this button pressed too.
    pub fn with(self, button: Button) -> Self {
        Remote { buttons: self.buttons | 1 << button as u16, ..self }
    }
}

/// Largest distance beyond the range that counts as a rounding [m/s], [rad/s].
const ROUNDING: f64 = 1e-6;

/// The velocities that full sticks mean: forward [m/s], left [m/s], yaw rate [rad/s].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FullSticks(pub [f64; 3]);

impl FullSticks {
    /// Returns the velocities of full sticks for a policy: the ends of its range.
    pub fn new(range: &CommandRange) -> Self {
        FullSticks([range.forward_m_s, range.left_m_s, range.yaw_rad_s])
    }

    /// Checks that a velocity (forward, left, yaw) is within the range, up to a rounding error.
    ///
    /// # Errors
    /// Names the number that is outside the range.
    pub fn check(&self, velocity: [f64; 3]) -> Result<(), String> {
        let parts = [("forward", "m/s"), ("left", "m/s"), ("yaw", "rad/s")].into_iter().zip(velocity).zip(self.0);
        let beyond = |((_, found), most): &((_, f64), f64)| found.is_nan() || found.abs() > most + ROUNDING;
        parts.filter(beyond).try_for_each(|(((name, unit), found), most)| {
            Err(format!("{name} is {found:?} {unit}, expected -{most} to {most} {unit}"))
        })
    }

    /// Returns the remote's sticks for a command: left stick forward and sideways, right stick turning.
    pub(crate) fn remote(&self, command: &Command) -> Remote {
        let [forward, left, yaw] = self.0;
        let stick = |value: f64, full: f64| (value / full).clamp(-1.0, 1.0) as f32;
        let right = [stick(-command.yaw, yaw), 0.0];
        Remote { left: [stick(-command.left, left), stick(command.forward, forward)], right, ..Remote::default() }
    }

    pub(crate) fn command(&self, remote: &Remote) -> Command {
        let [forward, left, yaw] = self.0;
        let [sideways, ahead] = remote.left.map(f64::from);
        Command::velocity(forward * ahead, -left * sideways, -yaw * f64::from(remote.right[0]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FULL: FullSticks = FullSticks([1.0, 0.5, 0.5]);

    #[test]
    fn sticks_mean_the_command_that_they_stand_for() {
        let command = Command::velocity(0.5, -0.25, 0.125);
        let back = FULL.command(&Remote::from_bytes(&FULL.remote(&command).to_bytes()));
        assert_eq!(back, command);
        // Forward is up, right is right, turning right is right.
        let remote = FULL.remote(&Command::velocity(1.0, -0.5, -0.5));
        assert_eq!((remote.left, remote.right), ([1.0, 1.0], [1.0, 0.0]));
    }

    #[test]
    fn bytes_are_where_the_vendor_has_them() {
        let remote = Remote { left: [0.25, -1.0], right: [0.5, 0.75], ..Remote::default() };
        let bytes = remote.with(Button::Start).with(Button::A).to_bytes();
        assert_eq!((bytes[2], bytes[3]), (0b100, 0b1));
        // lx, rx, ry, L2, ly.
        assert_eq!(bytes[4..8], 0.25_f32.to_le_bytes());
        assert_eq!(bytes[8..12], 0.5_f32.to_le_bytes());
        assert_eq!(bytes[12..16], 0.75_f32.to_le_bytes());
        assert_eq!(bytes[20..24], (-1.0_f32).to_le_bytes());
        let read = Remote::from_bytes(&bytes);
        assert!(read.is_pressed(Button::A) && read.is_pressed(Button::Start) && !read.is_pressed(Button::B));
        assert_eq!((read.left, read.right), (remote.left, remote.right));
        // A stick that is not finite counts as released.
        let broken = Remote { left: [f32::NAN, 1.0], ..Remote::default() };
        assert_eq!(Remote::from_bytes(&broken.to_bytes()).left, [0.0, 1.0]);
    }
}
