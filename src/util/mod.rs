//! Small helpers, independent of robots. Programs need [`files`] and [`terminal`] first, numerical code [`random`] and
//! [`numbers`]; [`yaml`], `xml` and `tensors` read and write formats, [`progress`] and [`memory`] serve long
//! runs.

pub mod files;
pub mod memory;
pub mod numbers;
pub mod progress;
pub mod random;
pub(crate) mod tensors;
pub mod terminal;
pub(crate) mod xml;
pub mod yaml;
