/*! The state of the robot's remote, as the 40 bytes `wireless_remote` of the robot's state carry it. */

/// Buttons of the remote, by the bit that carries them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // their names are printed on them
pub enum Button {
    R1 = 0,
    L1 = 1,
    Start = 2,
    Select = 3,
    R2 = 4,
    L2 = 5,
    F1 = 6,
    F2 = 7,
    A = 8,
    B = 9,
    X = 10,
    Y = 11,
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
            let value = f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
            if value.is_finite() { value.clamp(-1.0, 1.0) } else { 0.0 }
        };
        Remote {
            left: [stick(4), stick(20)],
            right: [stick(8), stick(12)],
            buttons: u16::from_le_bytes([bytes[2], bytes[3]]),
        }
    }

    /// Writes the bytes.
    pub fn to_bytes(self) -> [u8; 40] {
        let mut bytes = [0; 40];
        (bytes[0], bytes[1]) = (0x55, 0x51);
        bytes[2..4].copy_from_slice(&self.buttons.to_le_bytes());
        for (at, value) in [(4, self.left[0]), (8, self.right[0]), (12, self.right[1]), (20, self.left[1])] {
            bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        bytes
    }

    /// Returns true if a button is pressed.
    pub fn is_pressed(&self, button: Button) -> bool {
        self.buttons >> button as u16 & 1 == 1
    }

    /// Returns the remote with this button pressed too.
    pub fn with(self, button: Button) -> Self {
        Remote { buttons: self.buttons | 1 << button as u16, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    }

    #[test]
    fn stick_that_is_not_finite_counts_as_released() {
        let mut bytes = Remote::default().to_bytes();
        bytes[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
        assert_eq!(Remote::from_bytes(&bytes).left, [0.0, 0.0]);
    }
}
