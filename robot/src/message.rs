/*! The messages of the Go2's low-level interface, and the checksum that guards them.

One declaration gives each message its DDS type, its C layout (for the checksum) and its CDR, the encoding in which DDS and ROS 2 send and
record it. Joints and feet have Supple's order (FR, FL, RR, RL; hip, thigh, calf), which is Unitree's; entries 12 to 19 of the motors are
unused.
*/

use dust_dds::infrastructure::type_support::DdsType;
use supple::robot::{JOINTS, Joints};

/// Number of entries for motors in a message, of which the Go2 uses the first 12.
pub const MOTORS: usize = 20;

/// First two bytes of every frame.
pub const HEAD: [u8; 2] = [0xFE, 0xEF];

/// Level flag of frames of the low-level interface.
pub const LOW_LEVEL: u8 = 0xFF;

/// Motor mode in which the motor obeys; 0 switches it off.
pub const SERVO: u8 = 1;

/// Joint target that means "no position control".
pub const POS_STOP: f32 = 2.146e9;

/// Joint rate target that means "no velocity control".
pub const VEL_STOP: f32 = 16_000.0;

/// The layout of a message's bytes: both align numbers by their size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// As a C compiler lays a struct out: structs begin and end on their alignment.
    C,
    /// As DDS sends it: nothing but numbers is aligned.
    Cdr,
}

/// A message in CDR that is read from its beginning.
pub struct Cdr<'a> {
    body: &'a [u8],
    at: usize,
    big_endian: bool,
}

impl<'a> Cdr<'a> {
    /// Begins with the four bytes that state the encoding; `None` if it is not plain CDR.
    pub fn new(message: &'a [u8]) -> Option<Self> {
        let ([0, endianness @ 0..=1, _, _], body) = message.split_first_chunk()? else { return None };
        Some(Cdr { body, at: 0, big_endian: *endianness == 0 })
    }

    /// Returns the next number in little-endian order; `None` after the end.
    fn number<const N: usize>(&mut self) -> Option<[u8; N]> {
        let from = self.at.next_multiple_of(N);
        let mut bytes: [u8; N] = self.body.get(from..from + N)?.try_into().ok()?;
        self.at = from + N;
        if self.big_endian {
            bytes.reverse();
        }
        Some(bytes)
    }
}

/// A value of a message: it can be written in a layout, read from CDR, and filled from a stream of words.
pub trait Field: Sized {
    /// Alignment in C \[bytes\].
    const ALIGN: usize;
    /// Returns the value whose bytes are zero.
    fn zero() -> Self;
    /// Appends the value.
    fn put(&self, out: &mut Vec<u8>, layout: Layout);
    /// Reads the value; `None` if the message ends before.
    fn read(from: &mut Cdr) -> Option<Self>;
    /// Replaces the value by one made of the next words.
    fn fill(&mut self, next: &mut dyn FnMut() -> u32);
}

fn pad(out: &mut Vec<u8>, align: usize) {
    out.resize(out.len().next_multiple_of(align), 0);
}

macro_rules! scalar {
    ($($t:ty: $from:expr),*) => {$(
        impl Field for $t {
            const ALIGN: usize = size_of::<$t>();
            fn zero() -> Self {
                0 as $t
            }
            fn put(&self, out: &mut Vec<u8>, _: Layout) {
                pad(out, Self::ALIGN);
                out.extend(self.to_le_bytes());
            }
            fn read(from: &mut Cdr) -> Option<Self> {
                from.number().map(Self::from_le_bytes)
            }
            fn fill(&mut self, next: &mut dyn FnMut() -> u32) {
                *self = $from(next());
            }
        }
    )*};
}
// An f32 made of 24 bits is exact, so that a peer can compare with ==.
scalar!(u8: |x| x as u8, i16: |x| x as i16, u16: |x| x as u16, i32: |x| x as i32, u32: |x| x,
        f32: |x| (x as i32 >> 8) as f32 / 256.0);

impl<T: Field, const N: usize> Field for [T; N] {
    const ALIGN: usize = T::ALIGN;
    fn zero() -> Self {
        std::array::from_fn(|_| T::zero())
    }
    fn put(&self, out: &mut Vec<u8>, layout: Layout) {
        self.iter().for_each(|value| value.put(out, layout));
    }
    fn read(from: &mut Cdr) -> Option<Self> {
        let mut values = Self::zero();
        for value in &mut values {
            *value = T::read(from)?;
        }
        Some(values)
    }
    fn fill(&mut self, next: &mut dyn FnMut() -> u32) {
        self.iter_mut().for_each(|value| value.fill(next));
    }
}

/// Defines messages by their DDS names and their alignment in C \[bytes\].
macro_rules! messages {
    ($($(#[$about:meta])* $name:ident = $dds:literal, align $align:literal { $($field:ident: $t:ty),* $(,)? })*) => {$(
        $(#[$about])*
        #[derive(DdsType, Debug, Clone, PartialEq)]
        #[dust_dds(name = $dds)]
        #[allow(missing_docs)] // comments beside the fields describe them
        pub struct $name { $(pub $field: $t),* }
        impl Field for $name {
            const ALIGN: usize = $align;
            fn zero() -> Self {
                $name { $($field: <$t>::zero()),* }
            }
            fn put(&self, out: &mut Vec<u8>, layout: Layout) {
                let align = if layout == Layout::C { Self::ALIGN } else { 1 };
                pad(out, align);
                $(self.$field.put(out, layout);)*
                pad(out, align);
            }
            fn read(from: &mut Cdr) -> Option<Self> {
                Some($name { $($field: Field::read(from)?),* })
            }
            fn fill(&mut self, next: &mut dyn FnMut() -> u32) {
                $(self.$field.fill(next);)*
            }
        }
        impl Default for $name {
            fn default() -> Self {
                Self::zero()
            }
        }
        impl $name {
            /// Name of the DDS type.
            pub const TYPE: &str = $dds;
        }
    )*};
}

messages! {
    /// The command to one motor: torque = `tau + kp (q − angle) + kd (dq − rate)`.
    MotorCmd = "unitree_go::msg::dds_::MotorCmd_", align 4 {
        mode: u8,               // 1 to obey, 0 to switch the motor off
        q: f32,                 // joint target [rad], or POS_STOP
        dq: f32,                // joint rate target [rad/s], or VEL_STOP
        tau: f32,               // additional torque [N·m]
        kp: f32,                // proportional gain [N·m/rad]
        kd: f32,                // derivative gain [N·m·s/rad]
        reserve: [u32; 3],
    }

    /// The command to the battery.
    BmsCmd = "unitree_go::msg::dds_::BmsCmd_", align 1 {
        off: u8,                // 0xA5 switches the battery off
        reserve: [u8; 3],
    }

    /// A command to all motors, on the topic `rt/lowcmd`.
    LowCmd = "unitree_go::msg::dds_::LowCmd_", align 4 {
        head: [u8; 2],          // HEAD
        level_flag: u8,         // LOW_LEVEL
        frame_reserve: u8,
        sn: [u32; 2],           // serial number
        version: [u32; 2],
        bandwidth: u16,
        motor_cmd: [MotorCmd; 20],
        bms_cmd: BmsCmd,
        wireless_remote: [u8; 40],
        led: [u8; 12],          // lights
        fan: [u8; 2],
        gpio: u8,
        reserve: u32,
        crc: u32,               // the checksum, see `crc`
    }

    /// The reading of the IMU.
    ImuState = "unitree_go::msg::dds_::IMUState_", align 4 {
        quaternion: [f32; 4],   // orientation, world from IMU (w, x, y, z)
        gyroscope: [f32; 3],    // angular velocity, base frame [rad/s]
        accelerometer: [f32; 3], // specific force, base frame [m/s²]; about +9.81 along z at rest
        rpy: [f32; 3],          // roll, pitch, yaw [rad]
        temperature: u8,        // [°C]
    }

    /// The state of one motor.
    MotorState = "unitree_go::msg::dds_::MotorState_", align 4 {
        mode: u8,
        q: f32,                 // joint angle [rad]
        dq: f32,                // joint rate [rad/s]
        ddq: f32,               // joint acceleration [rad/s²]
        tau_est: f32,           // estimated torque [N·m]
        q_raw: f32,             // the same, not filtered
        dq_raw: f32,
        ddq_raw: f32,
        temperature: u8,        // of the winding [°C]
        lost: u32,              // number of lost packets between computer and motor
        reserve: [u32; 2],
    }

    /// The state of the battery.
    BmsState = "unitree_go::msg::dds_::BmsState_", align 4 {
        version_high: u8,
        version_low: u8,
        status: u8,
        soc: u8,                // state of charge [%]
        current: i32,           // [mA]; negative while it is discharged
        cycle: u16,             // number of charging cycles
        bq_ntc: [u8; 2],        // temperatures of the battery [°C]
        mcu_ntc: [u8; 2],       // temperatures of its electronics [°C]
        cell_vol: [u16; 15],    // voltages of the cells [mV]
    }

    /// The state of the robot, on the topic `rt/lowstate` at 500 Hz.
    LowState = "unitree_go::msg::dds_::LowState_", align 4 {
        head: [u8; 2],          // HEAD
        level_flag: u8,         // LOW_LEVEL
        frame_reserve: u8,
        sn: [u32; 2],           // serial number
        version: [u32; 2],
        bandwidth: u16,
        imu_state: ImuState,
        motor_state: [MotorState; 20],
        bms_state: BmsState,
        foot_force: [i16; 4],   // FR FL RR RL, in units of the sensor
        foot_force_est: [i16; 4],
        tick: u32,              // clock of the robot [ms]
        wireless_remote: [u8; 40], // see `Remote`
        bit_flag: u8,
        adc_reel: f32,
        temperature_ntc1: u8,   // [°C]
        temperature_ntc2: u8,   // [°C]
        power_v: f32,           // of the battery [V]
        power_a: f32,           // of the battery [A]
        fan_frequency: [u16; 4],
        reserve: u32,
        crc: u32,               // the checksum, see `crc`
    }
}

const _: () = assert!(JOINTS <= MOTORS);

/// Computes the checksum of a frame: CRC-32 with polynomial 04C11DB7, MSB first, over all little-endian words of its C layout
/// except the last, which holds the checksum itself.
pub fn crc(frame: &impl Field) -> u32 {
    let mut bytes = Vec::with_capacity(1200);
    frame.put(&mut bytes, Layout::C);
    bytes.truncate(bytes.len().saturating_sub(4));
    let words = bytes.chunks_exact(4).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]));
    words.flat_map(u32::to_be_bytes).fold(!0, |crc, byte| (crc << 8) ^ TABLE[(crc >> 24) as usize ^ usize::from(byte)])
}

/// The checksum's change for each leading byte.
const TABLE: [u32; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = (byte as u32) << 24;
        let mut bit = 0;
        while bit < 8 {
            crc = (crc << 1) ^ if crc >> 31 == 1 { 0x04C1_1DB7 } else { 0 };
            bit += 1;
        }
        table[byte] = crc;
        byte += 1;
    }
    table
};

/// Returns a frame whose fields are all filled from a generator that a peer in another language can repeat (see `scripts/check_go2`).
/// Even seeds keep the top bit of bytes and half-words clear, which the vendor's own checksum helper needs.
#[cfg(test)]
pub(crate) fn filled<T: Field>(seed: u32) -> T {
    let (mut frame, mut x) = (T::zero(), seed.wrapping_mul(2_654_435_761) ^ 0x9E37_79B9);
    frame.fill(&mut || {
        x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let y = x ^ (x >> 15);
        if seed.is_multiple_of(2) { y & 0x7F7F_7F7F } else { y }
    });
    frame
}

impl LowCmd {
    /// Returns a command with head, flag and checksum in place, whose first 12 motors are those given, and whose others are
    /// in servo mode without gains.
    pub fn of_motors(motors: &[MotorCmd; JOINTS]) -> Self {
        let idle = MotorCmd { mode: SERVO, q: POS_STOP, dq: VEL_STOP, ..MotorCmd::zero() };
        let motor_cmd = std::array::from_fn(|index| motors.get(index).unwrap_or(&idle).clone());
        LowCmd { head: HEAD, level_flag: LOW_LEVEL, motor_cmd, ..LowCmd::zero() }.sealed()
    }

    /// Returns the command with its checksum.
    pub fn sealed(self) -> Self {
        LowCmd { crc: crc(&self), ..self }
    }
}

impl LowState {
    /// Returns a value of each of the Go2's motors.
    pub fn of_motors(&self, value: impl Fn(&MotorState) -> f32) -> Joints {
        std::array::from_fn(|joint| f64::from(value(&self.motor_state[joint])))
    }

    /// Returns the state with its checksum.
    pub fn sealed(self) -> Self {
        LowState { crc: crc(&self), ..self }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    #[test]
    fn sizes_are_those_of_the_c_structs() {
        let (mut command, mut state) = (Vec::new(), Vec::new());
        LowCmd::zero().put(&mut command, Layout::C);
        LowState::zero().put(&mut state, Layout::C);
        assert_eq!((command.len(), state.len()), (812, 1180));
    }

    #[test]
    fn checksum_is_the_vendors_on_filled_frames() {
        // What the vendor's library gives for the same frames: `scripts/check_go2 crc`.
        let golden = [(0, 0x4B39_D8AB, 0x7BE8_6F5B), (2, 0x2FE7_E9D4, 0x0308_DF78), (4, 0x3A30_71CA, 0x1A27_0C51)];
        for (seed, of_command, of_state) in golden {
            assert_eq!((crc(&filled::<LowCmd>(seed)), crc(&filled::<LowState>(seed))), (of_command, of_state));
        }
    }

    /// Returns a message in CDR, little-endian.
    pub fn cdr(message: &impl Field) -> Vec<u8> {
        let mut body = Vec::new();
        message.put(&mut body, Layout::Cdr);
        [vec![0, 1, 0, 0], body].concat()
    }

    #[test]
    fn cdr_is_the_vendors_on_filled_frames() {
        // FNV-1a of what the vendor's library writes: `scripts/check_go2 crc`.
        let mix = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x100_0000_01B3);
        let fnv = |bytes: &[u8]| bytes.iter().fold(0xCBF2_9CE4_8422_2325, mix);
        let golden = [(0, 0xB381_73BD_27DD_570C), (2, 0xB094_FA61_C1A6_DA65), (4, 0x8B5E_E262_C260_3A34)];
        for (seed, of_state) in golden {
            let state = filled::<LowState>(seed);
            let bytes = cdr(&state);
            assert_eq!(fnv(&bytes), of_state, "{seed}");
            assert_eq!(LowState::read(&mut Cdr::new(&bytes).unwrap()), Some(state));
            assert_eq!(LowState::read(&mut Cdr::new(&bytes[..bytes.len() - 1]).unwrap()), None);
        }
        let big = [&[0, 0, 0, 0, 7, 0][..], &[1, 2]].concat();
        let mut big = Cdr::new(&big).unwrap();
        assert_eq!((u8::read(&mut big), u16::read(&mut big), u8::read(&mut big)), (Some(7), Some(0x0102), None));
    }

    #[test]
    fn every_flipped_bit_changes_the_checksum() {
        let command = LowCmd::of_motors(&std::array::from_fn(|_| MotorCmd { mode: SERVO, ..MotorCmd::zero() }));
        assert_eq!(crc(&command), command.crc);
        for motor in 0..MOTORS {
            for bit in 0..32 {
                let mut broken = command.clone();
                let q = &mut broken.motor_cmd[motor].q;
                *q = f32::from_bits(q.to_bits() ^ (1 << bit));
                assert_ne!(crc(&broken), broken.crc, "motor {motor}, bit {bit}");
            }
        }
    }
}
