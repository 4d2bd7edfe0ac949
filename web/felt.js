// The force on the trunk from outside that the robot feels in its joints and its IMU, as src/estimate/external_force.rs, which
// explains it: leg i: J_iᵀ f_i = r_i; trunk: w = r_base − Σ J_base,iᵀ f_i.

import { add, cofactors, cross, dot, heading, less, rotationAbout, times, transposed, turned, yawOf } from "./vectors.js";

const [TIME_CONSTANT_S, GROUND_TIME_S] = [0.1, 0.5];
const [LIMIT_WEIGHTS, CARRIES, LIFTED] = [30, 0.125, 1 / 3];
const [SINGULAR, AT_LIMIT_RAD, LOW_KNEE_M, LEVEL_M2, STEEPEST_RAD] = [0.06, 0.005, 0.05, 1e-4, 0.5];
const UP = [0, 0, 1];
const NONE = { force: [0, 0, 0], feet: Array(4).fill([0, 0, 0]) };

/** The part of a step of `dt_s` in a first-order low-pass. */
const part = (dt_s, constant_s) => 1 - Math.exp(-dt_s / constant_s);
const toward = (from, to, step) => add(from, times(step, less(to, from)));
const vector = (all, k) => [all[3 * k], all[3 * k + 1], all[3 * k + 2]];

/** Observes the forces on one robot. */
export class ForceObserver {
  /** `alone` is the model of the robot alone; `mujoco` the library. */
  constructor(mujoco, alone) {
    this.mujoco = mujoco;
    this.model = alone;
    // Gravity is an acceleration of the frame.
    alone.opt.gravity.fill(0);
    this.data = new mujoco.MjData(alone);
    this.forces = new mujoco.DoubleBuffer(alone.nv);
    this.weight = 9.81 * alone.body_mass.reduce((sum, mass) => sum + mass);
    const of = (kind, name) => mujoco.mj_name2id(alone, mujoco.mjtObj[kind].value, name);
    this.feet = ["FR", "FL", "RR", "RL"].map((leg) => of("mjOBJ_GEOM", `${leg}_foot`));
    this.radii = this.feet.map((foot) => alone.geom_size[3 * foot]);
    this.imu = vector(alone.site_pos, of("mjOBJ_SITE", "imu"));
    this.armature = [...alone.dof_armature.slice(6)];
    // The root is joint 0.
    this.limits = [...alone.jnt_range.slice(2)];
    this.reset();
  }

  /** Clears the history, after the robot was moved. */
  reset(velocity = Array(6).fill(0)) {
    Object.assign(this, { velocity, before: null, now: NONE, lines: Array(3).fill([0, 0, 0]), lift: 0, readings: [], low: NONE });
  }

  /** Takes the state after a physics step: rows of the base, angles, rates, the trunk's velocity, and the torques in the step. */
  read({ base, angles, rates, velocity, torques }, dt_s) {
    const change = velocity.map((value, k) => (value - this.velocity[k]) / dt_s);
    this.velocity = velocity;
    const rate = velocity.slice(3);
    const linear = turned(transposed(base), add(change.slice(0, 3), [0, 0, 9.81]));
    const ofArm = add(cross(change.slice(3), this.imu), cross(rate, cross(rate, this.imu)));
    const reading = { base, angles, rates, rate, specific: add(linear, ofArm) };
    const doubted = this.before ? this.balance(this.before, reading, torques, dt_s) : true;
    this.before = reading;
    this.readings.push({ ...this.now, doubted });
  }

  /** The mean since the last call; also low-passed, for a step of `dt_s`, in `low`. */
  takeMean(dt_s) {
    const mean = (vectors) => times(1 / vectors.length, vectors.reduce(add));
    const { readings } = this;
    const feet = [0, 1, 2, 3].map((leg) => mean(readings.map((reading) => reading.feet[leg])));
    const [force, doubted] = [mean(readings.map(({ force }) => force)), readings.some(({ doubted }) => doubted)];
    const step = part(dt_s, TIME_CONSTANT_S);
    const lowFeet = this.low.feet.map((foot, leg) => toward(foot, feet[leg], step));
    this.low = { force: toward(this.low.force, force, step), feet: lowFeet, doubted };
    this.readings = [];
    return { force, doubted };
  }

  /** Solves the equations of the step between two readings; returns true where they cannot be trusted. */
  balance(before, now, torques, dt_s) {
    const { data, model, limits } = this;
    if (now.angles.some((angle, k) => angle < limits[2 * k] + AT_LIMIT_RAD || angle > limits[2 * k + 1] - AT_LIMIT_RAD)) return true;
    this.place(before, now, dt_s);
    const solved = this.forces.GetView();
    const [anchors, axes, places] = [data.xanchor, data.xaxis, data.geom_xpos];
    const up = before.base[2];
    const normal = turned(transposed(before.base), normalOf(this.lines));
    const centres = this.feet.map((foot) => vector(places, foot));
    let force = [...solved.slice(0, 3)];
    let [lowest, knee] = [Infinity, Infinity];
    const feet = [];
    for (let leg = 0; leg < 4; leg += 1) {
      const contact = less(centres[leg], times(this.radii[leg], normal));
      const joints = [0, 1, 2].map((k) => 1 + 3 * leg + k);
      const anchor = (k) => vector(anchors, joints[k]);
      // Rows of Jᵀ: the column of each joint.
      const columns = joints.map((joint, k) => cross(vector(axes, joint), less(contact, anchor(k))));
      const rows = joints.map((joint, k) => {
        const dof = 3 * leg + k;
        return solved[6 + dof] + (this.armature[dof] * (now.rates[dof] - before.rates[dof])) / dt_s - torques[dof];
      });
      const size = dot(columns[0], cross(columns[1], columns[2]));
      const inverse = transposed(cofactors(columns)).map((row) => times(1 / size, row));
      const length = Math.hypot(...less(anchor(2), anchor(1))) + Math.hypot(...less(contact, anchor(2)));
      if (!(Math.hypot(...inverse.flat()) * SINGULAR * length < 1)) return true;
      const foot = turned(inverse, rows);
      feet.push(foot);
      force = less(force, foot);
      [lowest, knee] = [Math.min(lowest, dot(contact, up)), Math.min(knee, dot(anchor(2), up))];
    }
    if (!force.every(Number.isFinite)) return true;
    this.follow(before, centres, feet.map((foot) => dot(foot, up) > CARRIES * this.weight), dt_s);
    const toHeading = (found) => {
      const limit = LIMIT_WEIGHTS * this.weight;
      return turned(heading(-yawOf(before.base)), turned(before.base, times(limit / Math.max(limit, Math.hypot(...found)), found)));
    };
    this.now = { force: toHeading(force), feet: feet.map(toHeading) };
    this.lift += part(dt_s, TIME_CONSTANT_S) * (this.now.force[2] - this.lift);
    return knee < lowest + LOW_KNEE_M || up[2] < 0.5 || this.lift > LIFTED * this.weight;
  }

  /** Writes state and accelerations of the step into MuJoCo's data, trunk frame, and computes M a + h. */
  place(before, now, dt_s) {
    const { mujoco, model, data } = this;
    const turning = times(1 / dt_s, less(now.rate, before.rate));
    const ofArm = add(cross(turning, this.imu), cross(now.rate, cross(now.rate, this.imu)));
    const linear = turned(rotationAbout(times(dt_s, now.rate)), less(now.specific, ofArm));
    data.qpos.set([0, 0, 0, 1, 0, 0, 0, ...before.angles]);
    data.qvel.set([0, 0, 0, ...before.rate, ...before.rates]);
    data.qacc.set([...linear, ...turning, ...now.rates.map((rate, k) => (rate - before.rates[k]) / dt_s)]);
    mujoco.mj_kinematics(model, data);
    mujoco.mj_comPos(model, data);
    mujoco.mj_comVel(model, data);
    mujoco.mj_rne(model, data, 1, this.forces);
  }

  /** Follows the lines between feet that carry weight. */
  follow({ base }, centres, carries, dt_s) {
    let sum = Array(3).fill([0, 0, 0]);
    for (let leg = 0; leg < 4; leg += 1) {
      for (let other = 0; other < leg; other += 1) {
        if (!carries[leg] || !carries[other]) continue;
        const line = turned(base, less(centres[leg], centres[other]));
        sum = sum.map((row, k) => add(row, times(line[k], line)));
      }
    }
    const step = part(dt_s, GROUND_TIME_S);
    this.lines = this.lines.map((row, k) => toward(row, sum[k], step));
  }
}

/** The upward normal of the plane that fits lines of this sum of v vᵀ best; straight up if that plane is steep. */
function normalOf(lines) {
  const level = lines.map((row, k) => row.map((value, column) => value + (k === column && k < 2 ? LEVEL_M2 : 0)));
  // The cofactors have the same eigenvectors, and the largest eigenvalue where the lines have the smallest. Squared often enough,
  // nothing else is left of them.
  let powers = cofactors(level);
  for (let k = 0; k < 12; k += 1) {
    const size = Math.hypot(...powers.flat());
    powers = powers.map((row) => times(1 / size, row));
    powers = powers.map((row) => turned(powers, row));
  }
  const column = powers[2];
  const normal = times(Math.sign(column[2]) / Math.hypot(...column), column);
  return normal[2] > Math.cos(STEEPEST_RAD) ? normal : UP;
}
