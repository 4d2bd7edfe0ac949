//! Small helpers: files, tensors in files, YAML, random streams, what programs print, where the program comes from.

pub mod files;
pub mod provenance;
pub mod random;
pub mod tensors;
pub mod terminal;
pub mod yaml;
