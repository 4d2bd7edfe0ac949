// A simulated robot: latency, PD law, physics, pushes and pulls, as src/sim and src/world.

import { Controller } from "./policy.js";
import { ForceObserver } from "./felt.js";
import { sceneXml } from "./scene.js";
import { heading, rotation, transposed, turned, yawOf } from "./vectors.js";

/** Time for which a fallen robot lies before it is set on its feet [s]. */
const LIES_S = 2;
const GRAVITY = [0, 0, -9.81];

/** Compiles MJCF that may include the robot. */
export function compile(mujoco, xml, robot) {
  mujoco.FS.writeFile("/robot.xml", robot);
  mujoco.FS.writeFile("/scene.xml", xml);
  const model = mujoco.MjModel.loadFromXML("/scene.xml");
  if (!model) throw new Error("MuJoCo does not compile the scene");
  return model;
}

/** Delays joint targets; a part of a step is an average of two. */
class Latency {
  constructor(latency_s, timestep_s) {
    const steps = Math.round((latency_s / timestep_s) * 1e6) / 1e6;
    [this.fraction, this.length] = [steps % 1, Math.floor(steps) + 2];
  }

  reset(target) {
    this.targets = Array(this.length).fill(target);
  }

  delay(target) {
    this.targets = [...this.targets.slice(1), target];
    const [older, newer] = this.targets;
    return older.map((angle, joint) => this.fraction * angle + (1 - this.fraction) * newer[joint]);
  }
}

/** A robot in its own world. */
export class Robot {
  /** `alone` is the compiled model of the robot alone; `scene` a name, `files` those of the page. */
  constructor(mujoco, files, alone, policy, scene) {
    this.mujoco = mujoco;
    const { simulation } = policy;
    [this.dt_s, this.substeps] = [1 / simulation.physics_rate_hz, simulation.physics_rate_hz / simulation.policy_rate_hz];
    this.period_s = 1 / simulation.policy_rate_hz;
    const name = (geom) => mujoco.mj_id2name(alone, mujoco.mjtObj.mjOBJ_GEOM.value, geom);
    const colliding = Array.from({ length: alone.ngeom }, (_, geom) => geom).filter((geom) => alone.geom_contype[geom] > 0).map(name);
    this.model = compile(mujoco, sceneXml(scene, files, colliding, this.dt_s), files.robot);
    // A robot alone touches only what its scene lists.
    const masks = ["geom_contype", "geom_conaffinity", "body_contype", "body_conaffinity"];
    if (scene === "flat") masks.forEach((mask) => this.model[mask].fill(0));
    this.data = new mujoco.MjData(this.model);
    this.joints = alone.nu;
    this.stand = [...this.model.numeric_data.slice(0, alone.nq)];
    this.limits = [...alone.actuator_ctrlrange].filter((_, k) => k % 2);
    this.trunk = mujoco.mj_name2id(this.model, mujoco.mjtObj.mjOBJ_BODY.value, "trunk");
    this.soles = ["FR", "FL", "RR", "RL"].map((leg) => mujoco.mj_name2id(this.model, mujoco.mjtObj.mjOBJ_GEOM.value, `${leg}_foot`));
    this.latency = new Latency(simulation.latency_s, this.dt_s);
    this.observer = new ForceObserver(mujoco, alone);
    Object.assign(this, { policy, compliance: null, controller: new Controller(policy) });
    Object.assign(this, { command: [0, 0, 0], coming: null, last: null, pull: null, time_s: 0, falls: 0, starts: 0 });
    this.restart();
  }

  delete() {
    for (const owned of [this.observer.forces, this.observer.data, this.data, this.model]) owned.delete();
  }

  /** Puts robot and obstacles at their start. */
  restart() {
    this.mujoco.mj_resetData(this.model, this.data);
    this.place(this.stand);
  }

  /** Sets the robot on its feet at its present place and heading. */
  standUp() {
    const [x, y] = this.data.qpos;
    const half = yawOf(this.base()) / 2;
    this.place([x, y, this.stand[2], Math.cos(half), 0, 0, Math.sin(half), ...this.stand.slice(7)]);
  }

  place(positions) {
    this.data.qpos.set(positions);
    this.data.qvel.fill(0, 0, positions.length - 1);
    this.latency.reset(this.policy.nominal);
    this.mujoco.mj_step1(this.model, this.data);
    this.observer.reset();
    this.controller.begin();
    Object.assign(this, { felt: null, fallen_s: null, starts: this.starts + 1 });
  }

  /** Rows of the rotation from the base to the world. */
  base() {
    return rotation(this.data.qpos.slice(3, 7));
  }

  encoders() {
    const part = (all, first) => Array.from(all.slice(first, first + this.joints));
    return { angles: part(this.data.qpos, 7), rates: part(this.data.qvel, 6) };
  }

  /** What policies observe; vectors in the base frame. */
  state() {
    const { qpos, qvel } = this.data;
    const base = this.base();
    const toBase = transposed(base);
    const [velocity, gravity] = [[...qvel.slice(0, 3)], GRAVITY].map((vector) => turned(toBase, vector));
    return { base, height: qpos[2], gravity, velocity, turning: [...qvel.slice(3, 6)], ...this.encoders(), felt: this.felt };
  }

  /**
   * Runs one policy step; returns its frame. `this.coming` is a push, a change of the trunk's velocity, forward and left [m/s];
   * `this.pull` is a force on the trunk, forward and left, or in the world [N].
   */
  step() {
    const { data, model, mujoco } = this;
    if (this.fallen_s !== null && this.time_s > this.fallen_s + LIES_S) this.standUp();
    const state = this.state();
    const target = this.controller.targets(state, this.command, this.compliance);
    const ahead = heading(yawOf(state.base));
    const pushed = this.coming;
    if (pushed) {
      const along = turned(ahead, [...pushed, 0]);
      Object.assign(this, { coming: null, last: { at_s: this.time_s, along } });
      along.forEach((part, axis) => (data.qvel[axis] += part));
      mujoco.mj_step1(model, data);
    }
    const force = this.pull ? turned(this.pull.inWorld ? heading(0) : ahead, [...this.pull.force, 0]) : [0, 0, 0];
    data.xfrc_applied.set(force, 6 * this.trunk);
    const began = data.time;
    let power = 0;
    for (let substep = 0; substep < this.substeps; substep += 1) power += this.physicsStep(target) / this.substeps;
    this.time_s += this.period_s;
    const felt = this.observer.takeMean(this.period_s);
    this.felt = felt.doubted ? null : felt.force.slice(0, 2);
    // MuJoCo starts anew where its numbers are no longer finite: that counts as a fall.
    const failed = !(data.time > began);
    if (failed) this.restart();
    const [base, { qpos, qvel, geom_xpos }, { command, time_s, starts, last, observer }] = [this.base(), data, this];
    // Low, or on its side. (Programs also look for parts on the ground.)
    const isDown = qpos[2] < this.policy.fallHeight || base[2][2] < 0.5;
    const fell = failed || (isDown && this.fallen_s === null);
    if (fell) Object.assign(this, { fallen_s: failed ? null : time_s, falls: this.falls + 1 });
    const yaw = yawOf(base);
    const [forward, left] = turned(heading(-yaw), [...qvel.slice(0, 3)]);
    const feet = this.soles.map((sole) => [...geom_xpos.slice(3 * sole, 3 * sole + 3)]);
    return {
      time_s, starts, position: [...qpos.slice(0, 3)], yaw, velocity: [forward, left, qvel[5]], feet, lies: this.fallen_s !== null,
      command, target, power, pushed, last, force, fell, falls: this.falls, felt: observer.low,
    };
  }

  /** Runs one physics step towards joint targets; returns the mechanical power [W]. */
  physicsStep(target) {
    const { data, model, mujoco, policy, limits } = this;
    const acting = this.latency.delay(target);
    const { kp_n_m_per_rad: kp, kd_n_m_s_per_rad: kd } = policy.simulation;
    const { angles, rates } = this.encoders();
    const torques = acting.map((angle, joint) =>
      Math.min(limits[joint], Math.max(-limits[joint], kp * (angle - angles[joint]) - kd * rates[joint])));
    data.ctrl.set(torques);
    mujoco.mj_step2(model, data);
    this.observer.read({ base: this.base(), ...this.encoders(), velocity: [...data.qvel.slice(0, 6)], torques }, this.dt_s);
    mujoco.mj_step1(model, data);
    return torques.reduce((sum, torque, joint) => sum + Math.abs(torque * rates[joint]), 0);
  }
}
