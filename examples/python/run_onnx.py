#!/usr/bin/env python3
"""Walk an exported policy with the paper's observation in PyPI's MuJoCo for 5 s and print the velocity error.

    cargo run --release --bin policy -- export compliant --format onnx --out policy.onnx
    pip install mujoco onnxruntime numpy
    python3 examples/python/run_onnx.py policy.onnx 0.5 [ROBOT.xml]

Another robot has a free joint, joints FR_hip, FR_thigh, … or FR_hip_joint, …, and motors.
"""
import json
import pathlib
import sys

import mujoco
import numpy as np
import onnxruntime

session = onnxruntime.InferenceSession(sys.argv[1], providers=["CPUExecutionProvider"])
about = json.loads(session.get_modelmeta().custom_metadata_map["supple"])
numbers = session.get_inputs()[0].shape[-1]
if numbers != 83:
    sys.exit(f"error: {sys.argv[1]} observes {numbers} numbers; this example forms the paper's 83, as compliant and baseline observe them")
forward = float(sys.argv[2]) if len(sys.argv) > 2 else 0.5
robot = about["provenance"]["config"].get("robot", {}).get("model", "go1")
file = sys.argv[3] if len(sys.argv) > 3 else str(pathlib.Path(__file__).parents[2] / f"models/{robot}.xml")
simulation, nominal = about["simulation"], np.array(about["nominal_pose_rad"])

spec = mujoco.MjSpec.from_file(file)
if not any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.geoms):
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], friction=[1, 0.005, 0.0001])
spec.option.timestep = 1 / simulation["physics_rate_hz"]
model = spec.compile()
data = mujoco.MjData(model)
names = {model.joint(index).name.removesuffix("_joint"): index for index in range(model.njnt)}
joints = [names[name] for name in about["joints"]]
angles, rates = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
motors = [list(model.actuator_trnid[:, 0]).index(joint) for joint in joints]
limits = model.actuator_ctrlrange[motors, 1]
trunk = data.body(model.jnt_bodyid[list(model.jnt_type).index(mujoco.mjtJoint.mjJNT_FREE)])
kp, kd = (np.resize(simulation[key], 12) for key in ("kp_n_m_per_rad", "kd_n_m_s_per_rad"))  # one, three (a leg) or twelve
paper_axes = [1, 2, 0]  # the paper's x, y, z are left, up, forward

# On its feet, which are spheres.
data.qpos[:7] = [0, 0, 1, 1, 0, 0, 0]
data.qpos[angles] = nominal
mujoco.mj_kinematics(model, data)
spheres = (model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE) & (model.geom_contype > 0)
data.qpos[2] -= (data.geom_xpos[:, 2] - model.geom_size[:, 0])[spheres].min()


def reduced():
    """Table I: height, gravity, joint angles, velocity, angular velocity, joint rates, vectors in the base frame."""
    base_from_world = trunk.xmat.reshape(3, 3).T
    return np.concatenate([
        [data.qpos[2]], (base_from_world @ model.opt.gravity)[paper_axes], data.qpos[angles],
        (base_from_world @ data.qvel[:3])[paper_axes], data.qvel[3:6][paper_axes], data.qvel[rates]])


mujoco.mj_forward(model, data)
delay = simulation["latency_s"] * simulation["physics_rate_hz"]  # 7.2 physics steps
issued = [nominal] * (int(delay) + 2)  # targets of the last physics steps, the newest last
previous = current = reduced()
target, speeds = nominal, []
for step in range(5 * simulation["policy_rate_hz"]):
    observation = np.concatenate([previous, target, current, [0.0, forward, 0.0]]).astype(np.float32)
    target = session.run(["joint_target"], {"observation": observation[None]})[0][0].astype(float)
    for _ in range(simulation["physics_rate_hz"] // simulation["policy_rate_hz"]):
        issued = issued[1:] + [target]
        acting = (delay % 1) * issued[0] + (1 - delay % 1) * issued[1]
        torque = kp * (acting - data.qpos[angles]) - kd * data.qvel[rates]
        data.ctrl[motors] = np.clip(torque, -limits, limits)
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    previous, current = current, reduced()
    speeds.append(current[18])
print(f"forward velocity error over the last 3 s: {np.mean(speeds[-180:]) - forward:+.4f} m/s, base at {current[0]:.3f} m")
