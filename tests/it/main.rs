//! Tests of the whole: the compiled model, the programs as a user runs them, and properties of every scenario.

mod bad_input;
mod described;
mod faults;
mod foreign;
mod foreign_robots;
mod kill;
mod killing;
mod licences;
mod model;
mod package;
mod pictures;
mod programs;
#[cfg(feature = "mpi")]
mod ranks;
mod readme;
mod robots;
mod scenarios;
mod sets;
mod support;
mod travel;
