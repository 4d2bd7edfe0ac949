/*! Raw bindings to MuJoCo 2.2.2, generated at build time from Debian's `<mujoco/mujoco.h>`.

Calls that can raise a fatal error exist only as `supple_*`: a C shim around the MuJoCo function that returns 1 and
the message where MuJoCo itself would end the process. Nothing here is safe; the safe layer is `supple::mujoco`.
*/
#![allow(unsafe_code, non_camel_case_types, non_snake_case, non_upper_case_globals, clippy::all)]

include!(concat!(env!("OUT_DIR"), "/bindings.rs"));
