// A policy: its file, its network, and what it observes; as src/observation, src/policy/inference.rs and src/task/compliance.rs.

/** Element of a vector, forward, left and up; yaw of a command. */
const AXES = { forward: 0, left: 1, up: 2, yaw: 2 };

/** What a shipped policy observes: numbers of the state, the command [forward, left, yaw] or the last joint targets. */
const QUANTITIES = {
  base_height: ({ height }) => [height],
  gravity: ({ gravity }) => gravity,
  joint_angles: ({ angles }) => angles,
  base_velocity: ({ velocity }) => velocity,
  angular_velocity: ({ turning }) => turning,
  joint_rates: ({ rates }) => rates,
  felt_force: ({ felt }) => [...(felt ?? [0, 0]), 0].map((force) => clamp(force, 100)),
  command: (state, command) => command,
  last_target: (state, command, target) => target,
};

/** Shortest time constant of the virtual mass [s], and what a pull changes the command by at most and at least [m/s]. */
const [SHORTEST_S, LARGEST_M_S, LEAST_M_S] = [0.05, 1, 0.5];

const clamp = (value, limit) => Math.min(limit, Math.max(-limit, value));

/** The policy in the bytes of a file of safetensors, with its calibration. */
export class Policy {
  constructor(buffer, calibration) {
    const start = 8 + Number(new DataView(buffer).getBigUint64(0, true));
    const { __metadata__, ...tensors } = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, start - 8)));
    const tensor = (name) => {
      const { dtype, data_offsets } = tensors[name];
      return new { F32: Float32Array, F64: Float64Array }[dtype](buffer.slice(...data_offsets.map((offset) => start + offset)));
    };
    const { nominal_pose_rad, scale_rad, simulation, provenance } = JSON.parse(__metadata__.supple);
    Object.assign(this, { calibration, simulation, nominal: nominal_pose_rad, scale: scale_rad });
    const { command, observation, episode } = provenance.config;
    this.range = [command.forward_m_s, command.left_m_s, command.yaw_rad_s];
    this.fallHeight = episode.min_height_m;
    this.entries = observation.map(({ quantity, elements, steps_ago = 0 }) => {
      if (!(quantity in QUANTITIES)) throw new Error(`this page does not know the quantity ${quantity}`);
      return { quantity, axes: elements?.map((name) => AXES[name]), ages: [steps_ago].flat() };
    });
    [this.offset, this.normal] = [tensor("normaliser.offset"), tensor("normaliser.scale")];
    this.layers = [];
    for (let k = 0; `policy.${k}.weight` in tensors; k += 1) {
      this.layers.push([tensor(`policy.${k}.weight`), tensor(`policy.${k}.bias`)]);
    }
    this.check(tensor("golden.observation"), tensor("golden.joint_target"));
  }

  /** Compares the network with the answers that its file has from training. */
  check(observations, targets) {
    const length = this.offset.length;
    for (let row = 0; row * length < observations.length; row += 1) {
      this.act(observations.subarray(row * length, (row + 1) * length)).forEach((found, joint) => {
        const expected = targets[row * this.nominal.length + joint];
        if (!(Math.abs(found - expected) < 1e-5)) throw new Error(`the network answers ${found} rad, its file says ${expected}`);
      });
    }
  }

  /** Joint targets [rad] for an observation in physical units. */
  act(observation) {
    let values = Float32Array.from(observation, (raw, k) => (raw - this.offset[k]) * this.normal[k]);
    this.layers.forEach(([weights, biases], k) => {
      const last = k === this.layers.length - 1;
      values = biases.map((bias, row) => {
        let sum = bias;
        for (let column = 0, at = row * values.length; column < values.length; column += 1, at += 1) sum += weights[at] * values[column];
        return last || sum > 0 ? sum : Math.expm1(sum);
      });
    });
    return this.nominal.map((angle, joint) => angle + this.scale * values[joint]);
  }
}

/** A policy at work on one robot, with the past that it observes, and the virtual mass that makes it yield as commanded. */
export class Controller {
  constructor(policy) {
    this.policy = policy;
    this.begin();
  }

  begin() {
    [this.frames, this.target, this.change] = [[], this.policy.nominal, [0, 0]];
  }

  /** Joint targets [rad] for a command [m/s, m/s, rad/s] and a commanded compliance [m/s/N], null for the policy's own. */
  targets(state, command, compliance) {
    const { entries } = this.policy;
    const asked = compliance === null ? command : this.yielding(state.felt ?? [0, 0], command, compliance);
    if (compliance === null) this.change = [0, 0];
    const frame = entries.map(({ quantity, axes }) => {
      const numbers = QUANTITIES[quantity](state, asked, this.target);
      return axes ? axes.map((axis) => numbers[axis]) : numbers;
    });
    const depth = 1 + Math.max(...entries.flatMap(({ ages }) => ages));
    // Before the first step, all was as it is then.
    this.frames = this.frames.length ? [frame, ...this.frames].slice(0, depth) : Array(depth).fill(frame);
    this.target = this.policy.act(entries.flatMap(({ ages }, k) => ages.flatMap((age) => this.frames[age][k])));
    return this.target;
  }

  /** The command that makes the policy yield: m |c − C₀| u̇ = (c − C₀) F / k − u. */
  yielding(force, command, compliance) {
    const { calibration, simulation, range } = this.policy;
    const { mass_kg, own_m_s_per_n: own, tracking } = calibration;
    this.change = this.change.map((change, axis) => {
      const gain = compliance - own[axis];
      const time_s = Math.max(SHORTEST_S, mass_kg * Math.abs(gain));
      return change + (1 - Math.exp(-1 / simulation.policy_rate_hz / time_s)) * ((gain * force[axis]) / tracking[axis] - change);
    });
    const most = Math.max(LEAST_M_S, LARGEST_M_S - Math.hypot(own[0] * force[0], own[1] * force[1]));
    const over = Math.max(1, Math.hypot(...this.change) / most);
    this.change = this.change.map((change) => change / over);
    const asked = [0, 1].map((axis) => clamp(command[axis] + this.change[axis], Math.max(range[axis], Math.abs(command[axis]))));
    return [...asked, command[2]];
  }
}
