//! Everything that can go wrong inside MuJoCo.

/// Result of a MuJoCo call.
pub type Result<T> = std::result::Result<T, Error>;

/// Which part of the state became invalid (NaN or beyond 1e10).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StateKind {
    /// Generalised positions.
    Position,
    /// Generalised velocities.
    Velocity,
    /// Generalised accelerations.
    Acceleration,
    /// Actuator controls.
    Control,
    /// The mass matrix could not be factorised.
    Inertia,
}

/// Which of the fixed-size buffers of `mjData` was too small.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Buffer {
    /// Contacts, `nconmax`.
    Contacts,
    /// Constraint rows, `njmax`.
    Constraints,
}

/// A fault reported by MuJoCo.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// Another libmujoco than the one these bindings were generated for was loaded at run time.
    #[error("libmujoco has version {found} at run time, expected {expected}; install Debian 12's libmujoco2.2.2")]
    Version {
        /// Version of the headers.
        expected: i32,
        /// Version of the library.
        found: i32,
    },
    /// The model could not be read or compiled.
    #[error("MuJoCo cannot load {what}: {message}")]
    Load {
        /// File or scene name.
        what: String,
        /// MuJoCo's own words.
        message: String,
    },
    /// The model has no element of this name.
    #[error("the model has no {kind} named '{name}'; it has: {known}")]
    Name {
        /// Element kind.
        kind: &'static str,
        /// The name asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// The fatal error handler was called.
    #[error("MuJoCo's {call} failed: {message}")]
    Engine {
        /// The call that was running.
        call: &'static str,
        /// MuJoCo's own words.
        message: String,
    },
    /// What drives the simulation is NaN or infinite: no fault of MuJoCo, which does not get to see it.
    #[error("{what} is {found}, expected a finite number: whatever controls the robot is at fault, not the physics")]
    Input {
        /// The input, such as a joint's target.
        what: String,
        /// The number.
        found: String,
    },
    /// The simulation became unstable; MuJoCo has reset it.
    #[error("the simulation became unstable: invalid {kind:?} at index {index}")]
    Unstable {
        /// The quantity that was NaN or huge.
        kind: StateKind,
        /// Index of the first invalid entry.
        index: i32,
    },
    /// A fixed buffer was full and contacts or constraints were dropped.
    #[error("the buffer for {buffer:?} is full at {size}: enlarge it in the scene (nconmax, njmax)")]
    BufferFull {
        /// Which buffer.
        buffer: Buffer,
        /// The size of the array.
        size: usize,
    },
}
