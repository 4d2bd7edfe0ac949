/*! The safe wrapper of MuJoCo 2.2.2: start with [`Model`] (compiled from MJCF), then [`Data`] (one simulation), then
[`Error`].

MuJoCo reports errors in four ways, and all of them become an [`Error`] here: a fatal error handler that would end the process (caught in
`mujoco-sys`' C shim), warning counters in `mjData`, text in a caller's buffer (XML), and null pointers. Only the counters show that an
unstable state has reset the simulation or that a full buffer has dropped contacts. Apart from `mujoco-sys` this module is the only one that
holds `unsafe` code.
*/
#![allow(unsafe_code)]

mod data;
mod error;
mod library;
mod model;
mod render;
mod sizes;

pub use data::{Contact, Data};
pub use error::{Error, Result};
pub use library::library_file;
pub use model::{Actuator, Geom, GeomContact, GeomShape, Inertial, Model, Object};
pub use render::{Camera, LARGEST_PICTURE, MOST_MARKS, Mark, MarkShape, Renderer};
pub(crate) use sizes::{SizeError, check_sizes};

use std::ffi::CStr;
use std::sync::OnceLock;

use nalgebra::{Quaternion, UnitQuaternion};

/// The MuJoCo version these bindings were written for, as `mj_version` counts.
pub const VERSION: i32 = mujoco_sys::mjVERSION_HEADER as i32;

/// True if contacts and constraints have buffers of fixed size, as before MuJoCo 3; later they share one with everything else.
#[cfg(test)]
pub(crate) const FIXED_BUFFERS: bool = VERSION < 300;

/// Installs the error handlers and checks the version of the library that was loaded, once per process.
fn initialise() -> Result<()> {
    static FOUND: OnceLock<i32> = OnceLock::new();
    let found = *FOUND.get_or_init(|| {
        // SAFETY: runs once, before any other MuJoCo call, and only sets two function pointers.
        unsafe { mujoco_sys::supple_init() };
        // SAFETY: no preconditions.
        unsafe { mujoco_sys::mj_version() }
    });
    if found == VERSION { Ok(()) } else { Err(Error::Version { expected: VERSION, found }) }
}

/// Gives freed memory back to the system. The C library keeps that of a large scene otherwise, once for each thread that built one.
pub fn release_memory() {
    // SAFETY: no preconditions; the C library locks what it walks through.
    unsafe { mujoco_sys::supple_release_memory() };
}

/// Returns the rotation of a quaternion as MuJoCo has it.
pub(crate) fn unit([w, x, y, z]: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z))
}

/// Buffer into which the shim writes MuJoCo's message.
type MessageBuffer = [std::ffi::c_char; mujoco_sys::SUPPLE_ERROR_SIZE as usize];

const EMPTY_MESSAGE: MessageBuffer = [0; mujoco_sys::SUPPLE_ERROR_SIZE as usize];

/// Joins MuJoCo's message into one line.
fn text(message: &MessageBuffer) -> String {
    // SAFETY: the shim and MuJoCo always terminate the message within the buffer, which starts as zeros.
    let text = unsafe { CStr::from_ptr(message.as_ptr()) }.to_string_lossy();
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Turns the return code of a guarded call into a result.
fn check(call: &'static str, failed: i32, message: &MessageBuffer) -> Result<()> {
    if failed == 0 { Ok(()) } else { Err(Error::Engine { call, message: text(message) }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_raised_inside_mujoco_comes_back_as_a_value() {
        initialise().unwrap();
        let mut message = EMPTY_MESSAGE;
        // SAFETY: both strings are valid; the shim catches the error.
        let failed = unsafe { mujoco_sys::supple_raise(c"on purpose".as_ptr(), message.as_mut_ptr()) };
        let error = check("raise", failed, &message).unwrap_err();
        assert_eq!(error.to_string(), "MuJoCo's raise failed: on purpose");
    }
}
