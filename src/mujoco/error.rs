//! Errors of MuJoCo as values.

/// Result of a MuJoCo call.
pub type Result<T> = std::result::Result<T, Error>;

/// A fault reported by MuJoCo.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The libmujoco loaded at run time has another version than the headers of these bindings.
    #[error("libmujoco has version {found} at run time, expected {expected}; build again, and unset LD_LIBRARY_PATH")]
    Version {
        /// Version of the headers, as `mj_version` counts.
        expected: i32,
        /// Version of the library, as `mj_version` counts.
        found: i32,
    },
    /// The model could not be read or compiled.
    #[error("MuJoCo cannot load {what}: {message}")]
    Load {
        /// Name of the file or scene.
        what: String,
        /// Message of MuJoCo.
        message: String,
    },
    /// The model has no element of this name.
    #[error("the model has no {kind} named '{name}'; it has: {known}")]
    Name {
        /// Kind of the element, such as `joint`.
        kind: &'static str,
        /// The name that was looked up.
        name: String,
        /// The names that the model has.
        known: String,
    },
    /// MuJoCo called its fatal error handler.
    #[error("MuJoCo's {call} failed: {message}")]
    Engine {
        /// Name of the C function that was running.
        call: &'static str,
        /// Message of MuJoCo.
        message: String,
    },
    /// No picture can be drawn: OpenGL is missing, or the picture's size is out of range.
    #[error("cannot draw a picture: {0}")]
    Renderer(String),
    /// An input of the simulation is NaN or infinite, and was not passed to MuJoCo.
    #[error("{what} is {found}, expected a finite number: the fault is in the controller, not in the physics")]
    Input {
        /// Name of the input, such as a joint's target.
        what: String,
        /// The value that was found.
        found: String,
    },
    /// The simulation became unstable, and MuJoCo has reset it.
    #[error("the simulation became unstable: invalid {kind} at index {index}")]
    Unstable {
        /// The part of the state that was NaN or beyond 1e10, or `Inertia`: the mass matrix could not be factorised.
        kind: &'static str,
        /// Index of the first invalid entry.
        index: i32,
    },
    /// A fixed buffer was full and contacts or constraints were dropped.
    #[error("the buffer for {buffer} is full at {size}: enlarge it in the scene (nconmax, njmax)")]
    BufferFull {
        /// The buffer that was full: `Contacts` (nconmax) or `Constraints` (njmax).
        buffer: &'static str,
        /// Capacity of the buffer.
        size: usize,
    },
}
