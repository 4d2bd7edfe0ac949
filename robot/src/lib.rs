/*! The Go2's own interface, on both sides of it. */

pub mod bridge;
pub mod dds;
pub mod message;
pub mod motor;
pub mod remote;
pub mod serve;
