//! Conversion of traces to NumPy arrays.

use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use supple::robot::JOINTS;
use supple::scenario::trace::{Frame, Trace};

/// Name of an array of shape (frames), and its number in a frame.
type Scalar = (&'static str, fn(&Frame) -> f64);

const SCALARS: [Scalar; 10] = [
    ("time_s", |frame| frame.time_s),
    ("yaw_rate", |frame| frame.yaw_rate),
    ("height_m", |frame| frame.height_m),
    ("power_w", |frame| frame.power_w),
    ("torque_n_m", |frame| frame.torque_n_m),
    ("reward", |frame| frame.reward),
    ("peak_foot_force_n", |frame| frame.peak_foot_force_n),
    ("peak_obstacle_force_n", |frame| frame.peak_obstacle_force_n),
    ("obstacle_impulse_n_s", |frame| frame.obstacle_impulse_n_s),
    ("obstacle_contact_s", |frame| frame.obstacle_contact_s),
];

/// Name of an array of shape (frames, 3), and its vector in a frame.
type Vector = (&'static str, fn(&Frame) -> [f64; 3]);

const VECTORS: [Vector; 5] = [
    ("command", |frame| [frame.command.forward, frame.command.left, frame.command.yaw]),
    ("velocity", |frame| frame.velocity),
    ("velocity_in_heading", |frame| frame.velocity_in_heading),
    ("position", |frame| frame.position),
    ("roll_pitch_yaw", |frame| frame.roll_pitch_yaw),
];

/// Name of an array of shape (frames, 12), and its number for each joint in a frame.
type OfJoints = (&'static str, fn(&Frame) -> [f64; JOINTS]);

const JOINT_VALUES: [OfJoints; 3] = [
    ("joint_angles", |frame| frame.joint_angles),
    ("joint_targets", |frame| frame.joint_targets),
    ("torques", |frame| frame.torques),
];

/// Returns all arrays of a trace by name; `docs/python.md` has shapes, units and frames.
pub fn arrays<'py>(py: Python<'py>, trace: &Trace) -> PyResult<Bound<'py, PyDict>> {
    let arrays = PyDict::new(py);
    let frames = &trace.frames;
    let put = |name: &str, tail: &[usize], values: Vec<f64>| -> PyResult<()> {
        let shape: Vec<usize> = [&[frames.len()], tail].concat();
        arrays.set_item(name, values.into_pyarray(py).reshape(shape)?)
    };
    for (name, of) in SCALARS {
        put(name, &[], frames.iter().map(of).collect())?;
    }
    for (name, of) in VECTORS {
        put(name, &[3], frames.iter().flat_map(of).collect())?;
    }
    for (name, of) in JOINT_VALUES {
        put(name, &[JOINTS], frames.iter().flat_map(of).collect())?;
    }
    put("foot_heights", &[4], frames.iter().flat_map(|frame| frame.foot_heights).collect())?;
    put("foot_positions", &[4, 3], frames.iter().flat_map(|frame| frame.foot_positions).flatten().collect())?;
    put("foot_forces", &[4, 3], frames.iter().flat_map(|frame| frame.foot_forces).flatten().collect())?;
    if let Some(first) = frames.first() {
        for (index, (name, _)) in first.terms.fields().enumerate() {
            let value = |frame: &Frame| frame.terms.fields().nth(index).map_or(f64::NAN, |(_, value)| value);
            put(&format!("term_{name}"), &[], frames.iter().map(value).collect())?;
        }
    }
    if frames.iter().any(|frame| frame.rope.is_some()) {
        let force = |frame: &Frame| frame.rope.as_ref().map_or(f64::NAN, |rope| rope.force_n);
        put("rope_force_n", &[], frames.iter().map(force).collect())?;
    }
    if frames.iter().any(|frame| frame.goal.is_some()) {
        let position = |frame: &Frame| frame.goal.map_or([f64::NAN; 3], |pose| pose.position.map(f64::from));
        put("goal_position", &[3], frames.iter().flat_map(position).collect())?;
    }
    if frames.iter().any(|frame| frame.sensed.is_some()) {
        let sensed = |frame: &Frame| frame.sensed.unwrap_or_default();
        put("estimated_velocity", &[3], frames.iter().flat_map(|frame| sensed(frame).velocity).collect())?;
        put("estimated_height_m", &[], frames.iter().map(|frame| sensed(frame).height_m).collect())?;
        put("estimated_position", &[3], frames.iter().flat_map(|frame| sensed(frame).position).collect())?;
        let contacts: Vec<bool> = frames.iter().flat_map(|frame| sensed(frame).contacts).collect();
        arrays.set_item("estimated_contacts", contacts.into_pyarray(py).reshape([frames.len(), 4])?)?;
    }
    if frames.iter().any(|frame| frame.felt.is_some()) {
        let felt = |frame: &Frame| frame.felt.unwrap_or_default();
        put("felt_force", &[3], frames.iter().flat_map(|frame| felt(frame).force).collect())?;
        put("true_force", &[3], frames.iter().flat_map(|frame| felt(frame).true_force).collect())?;
        put("felt_foot_forces", &[4, 3], frames.iter().flat_map(|frame| felt(frame).feet).flatten().collect())?;
        let trusted: Vec<bool> = frames.iter().map(|frame| felt(frame).doubt.is_none()).collect();
        arrays.set_item("felt_is_trusted", trusted.into_pyarray(py))?;
    }
    Ok(arrays)
}
