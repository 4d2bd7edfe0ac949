//! Small helpers: files, paths as text, numbers, tensors in files, XML, YAML, random streams, what programs print, where the program comes from.

pub mod files;
pub mod numbers;
pub mod paths;
pub mod progress;
pub mod provenance;
pub mod random;
pub mod tensors;
pub mod terminal;
pub mod xml;
pub mod yaml;
