//! The least inertia at the joints, which determines the physics rate at which a PD law is stable.

use nalgebra::DMatrix;

use super::{JOINTS, Joints, Robot, joint_name};
use crate::mujoco::{Data, Model, Object, Result};

/// Returns the least inertia over all combinations of joint motions in a pose, with the trunk free and the feet in the air [kg·m²].
///
/// # Errors
/// MuJoCo fails.
pub fn least_inertia(robot: &Robot, pose: &Joints) -> Result<f64> {
    let mut model = Model::from_xml(&[("robot.xml", robot.mjcf())])?;
    model.set_gravity([0.0; 3]);
    let joints: [usize; JOINTS] = model.ids(Object::Joint, |k| format!("{}_joint", joint_name(k)))?;
    let joints = joints.map(|id| (model.joint_position_index(id), model.joint_velocity_index(id)));
    let freedoms = model.nv();
    let mut inertia = DMatrix::from_diagonal(&model.armature().to_vec().into());
    let mut data = Data::new(model)?;
    data.positions_mut().copy_from_slice(&robot.stand);
    for ((position, _), angle) in joints.iter().zip(pose) {
        data.positions_mut()[*position] = *angle;
    }
    // A column of the mass matrix is the force that a unit acceleration takes.
    for column in 0..freedoms {
        data.accelerations_mut().fill(0.0);
        data.accelerations_mut()[column] = 1.0;
        data.inverse_dynamics()?;
        for (row, force) in data.inverse_forces().iter().enumerate() {
            inertia[(row, column)] += force;
        }
    }
    // If a motion has no inertia, no rate is fast enough.
    let Some(response) = inertia.try_inverse() else { return Ok(0.0) };
    let of_joints = DMatrix::from_fn(JOINTS, JOINTS, |row, column| response[(joints[row].1, joints[column].1)]);
    let fastest = ((&of_joints + of_joints.transpose()) / 2.0).symmetric_eigenvalues().max();
    Ok(if fastest > 0.0 { 1.0 / fastest } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_go1s_calves_are_the_lightest_that_a_joint_moves() {
        let robot = Robot::load("go1").unwrap();
        let least = least_inertia(&robot, &robot.nominal_pose).unwrap();
        // The rotor and the calf about the knee, less the motion of the thigh.
        assert!((0.005..0.0176).contains(&least), "{least}");
    }
}
