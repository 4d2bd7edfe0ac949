"""The training environment of src/env.rs for Stable-Baselines3: the same scene, the same task, on PyPI's MuJoCo.

It is written to be fast as Python goes: one VecEnv for all environments, arrays over environments for everything but
the physics, MuJoCo called in its two halves so that nothing is computed twice, and the environments split between
threads, which MuJoCo's calls let run at the same time. Axes inside are MuJoCo's: x forward, y left, z up; the paper's
(left, up, forward) appear in the observation alone.
"""
import copy
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

LEGS = ("FR", "FL", "RR", "RL")
PARTS = ("hip", "thigh", "calf")
TO_PAPER = [1, 2, 0]
OBSERVATIONS, REDUCED, ACTIONS = 83, 34, 12


class Physics:
    """A stretch of the environments, stepped by one thread. Arrays have shape (environments, …)."""

    def __init__(self, model, count, config):
        sim = config["simulation"]
        self.models = [copy.copy(model) for _ in range(count)]
        self.datas = [mujoco.MjData(model) for model in self.models]
        self.all = np.arange(count)
        self.kp, self.kd = sim["kp_n_m_per_rad"], sim["kd_n_m_s_per_rad"]
        self.substeps = round(sim["physics_rate_hz"] / sim["policy_rate_hz"])
        self.min_height, self.desired = config["episode"]["min_height_m"], config["reward"]["foot_height_m"]
        self.limits = model.actuator_ctrlrange[:, 1].copy()
        self.feet = [model.geom(f"{leg}_foot").id for leg in LEGS]
        self.calves = [model.geom_bodyid[foot] for foot in self.feet]
        self.foot_radius = model.geom_size[self.feet, 0]
        self.trunk = model.body("trunk").id
        # What a contact's second geometry is: 1 to 4 for the feet, -1 for other parts of the robot, 0 for the ground.
        self.kind = np.zeros(model.ngeom, dtype=int)
        self.kind[model.geom_bodyid != 0] = -1
        self.kind[self.feet] = range(1, 5)
        self.start = model.numeric("stand_qpos").data.copy()
        self.positions, self.velocities = np.empty((count, model.nq)), np.empty((count, model.nv))
        self.geoms, self.centres = np.empty((count, model.ngeom, 3)), np.empty((count, 4, 3))
        self.contact, self.touch = np.zeros((count, 4), dtype=bool), np.zeros(count, dtype=bool)
        # The physics' own memory, looked up once.
        self.views = [(d.qpos, d.qvel, d.geom_xpos, d.ctrl) for d in self.datas]
        latency = round(sim["latency_s"] * sim["physics_rate_hz"], 6)
        self.whole, self.fraction = int(latency), latency - int(latency)
        self.targets, self.next = np.zeros((self.whole + 2, count, ACTIONS)), 0
        self.peak, self.was_down = np.zeros((count, 4)), np.zeros((count, 4), dtype=bool)

    def reset(self, which, gravity, target):
        for i in which:
            model, data = self.models[i], self.datas[i]
            mujoco.mj_resetData(model, data)
            model.opt.gravity[:] = gravity[i]
            data.qpos[:] = self.start
            mujoco.mj_step1(model, data)
        if len(which):
            self.look(which)
        self.targets[:, which] = target
        self.peak[which], self.was_down[which] = 0.0, self.contact[which]

    def push(self, which, linear, angular):
        """Linear (forward, left) in the heading frame, angular in the base frame."""
        for i in which:
            yaw = roll_pitch_yaw(self.positions[i : i + 1, 3:7])[2][0]
            c, s = np.cos(yaw), np.sin(yaw)
            velocity = self.datas[i].qvel
            velocity[:2] += [c * linear[i, 0] - s * linear[i, 1], s * linear[i, 0] + c * linear[i, 1]]
            velocity[3:6] += angular[i]
            mujoco.mj_step1(self.models[i], self.datas[i])
        if len(which):
            self.look(which)

    def look(self, which):
        """Copies what the arrays hold, and finds out what touches the ground."""
        pairs = []
        for i in which:
            self.positions[i], self.velocities[i], self.geoms[i], _ = self.views[i]
            pairs.append(self.datas[i].contact.geom)
        self.centres[which] = self.geoms[which][:, self.feet]
        owner = np.repeat(which, [len(pair) for pair in pairs])
        kinds = self.kind[np.concatenate(pairs)[:, 1]]
        is_foot = kinds > 0
        self.contact[which], self.touch[which] = False, False
        self.contact[owner[is_foot], kinds[is_foot] - 1] = True
        self.touch[owner[kinds < 0]] = True

    def step(self, target):
        """One policy step towards joint targets; means over its physics steps, falls, and what the feet earned."""
        count = len(self.datas)
        power, squared, foot_height = np.zeros(count), np.zeros(count), np.zeros(count)
        fell = np.zeros(count, dtype=bool)
        length = len(self.targets)
        for _ in range(self.substeps):
            self.targets[self.next] = target
            self.next = (self.next + 1) % length
            older, newer = self.targets[self.next], self.targets[(self.next + 1) % length]
            acting = self.fraction * older + (1.0 - self.fraction) * newer
            rates = self.velocities[:, 6:].copy()
            torques = self.kp * (acting - self.positions[:, 7:]) - self.kd * rates
            np.clip(torques, -self.limits, self.limits, out=torques)
            for model, data, view, torque in zip(self.models, self.datas, self.views, torques):
                view[3][:] = torque
                mujoco.mj_step2(model, data)
                mujoco.mj_step1(model, data)
            self.look(self.all)
            fell |= self.touch | (self.positions[:, 2] < self.min_height)
            power += np.abs(torques * rates).sum(1)
            squared += (torques * torques).sum(1)
            landed = self.contact & ~self.was_down
            foot_height += np.where(landed, (self.peak / self.desired - 1.0) ** 2, 0.0).sum(1)
            height = self.centres[:, :, 2] - self.foot_radius
            self.peak = np.where(landed, 0.0, np.where(self.contact, self.peak, np.maximum(self.peak, height)))
            self.was_down = self.contact.copy()
        return power / self.substeps, squared / self.substeps, fell, foot_height

    def foot_velocities(self):
        spatial = np.array([data.cvel[self.calves] for data in self.datas])
        origin = np.array([data.subtree_com[self.trunk] for data in self.datas])
        return spatial[:, :, 3:] + cross(spatial[:, :, :3], self.centres - origin[:, None])


class Go1VecEnv(VecEnv):
    """Environments with their episodes, rewards and observations."""

    def __init__(self, scene, config, count, threads, seed=0):
        # Stable-Baselines3 wants finite bounds of actions; these are never reached.
        box = spaces.Box(-np.inf, np.inf, (OBSERVATIONS,), np.float32), spaces.Box(-100, 100, (ACTIONS,), np.float32)
        super().__init__(count, *box)
        # MuJoCo 2.2.2 looks at the scene's pairs only; later versions have no such option, but nothing to find
        # where masks are zero.
        text = scene.read_text().replace('collision="predefined"', "").replace("robot.xml", str(scene.parent / "robot.xml"))
        model = mujoco.MjModel.from_xml_string(text)
        for masks in (model.geom_contype, model.geom_conaffinity, model.body_contype, model.body_conaffinity):
            masks[:] = 0
        shares = [stretch for stretch in np.array_split(np.arange(count), threads) if len(stretch)]
        self.stretches = [slice(share[0], share[-1] + 1) for share in shares]
        self.physics = [Physics(model, len(share), config) for share in shares]
        self.pool = ThreadPoolExecutor(len(shares)) if len(shares) > 1 else None
        self.config, self.random = config, np.random.default_rng(seed)
        rate, episode = config["simulation"]["policy_rate_hz"], config["episode"]
        self.recovery = round(rate * episode["walking_s"])
        self.post_recovery = self.recovery + round(rate * episode["recovery_s"])
        self.last = self.post_recovery + round(rate * episode["post_recovery_s"])
        self.nominal = np.tile(config["action"]["nominal_pose_rad"], 4)
        self.offset, self.scale = (np.array(config["normaliser"][key]) for key in ("offset", "scale"))
        self.command_fraction = config["command"]["initial_fraction"]
        self.age, self.cut = np.zeros(count, dtype=int), self.random.integers(1, self.recovery + 1, count)
        self.command, self.gravity = np.zeros((count, 3)), np.zeros((count, 3))
        self.push_linear, self.push_angular = np.zeros((count, 2)), np.zeros((count, 3))
        # Whether pushes have begun, and whether each episode has one.
        self.pushes, self.has_push = False, np.zeros(count, dtype=bool)
        # Sums of r_lin and r_ang over the walking stage.
        self.walking, self.episode_reward = np.zeros((count, 2)), np.zeros(count)
        self.walked = []
        self.previous, self.current = np.zeros((count, REDUCED)), np.zeros((count, REDUCED))
        self.last_target = np.tile(self.nominal, (count, 1))
        self.actions = None

    def reset(self):
        self.begin(np.arange(self.num_envs))
        return self.observation()

    def begin(self, which):
        """New episodes."""
        count, random, ranges = len(which), self.random, self.config["command"]
        widest = np.array([ranges["forward_m_s"], ranges["left_m_s"], ranges["yaw_rad_s"]])
        self.command[which] = self.command_fraction * widest * random.uniform(-1, 1, (count, 3))
        episode = self.config["episode"]
        self.push_linear[which] = episode["push_speed_m_s"] * random.uniform(-1, 1, (count, 2))
        self.has_push[which] = self.pushes
        self.push_angular[which] = episode["push_rate_rad_s"] * random.uniform(-1, 1, (count, 3))
        tilt = np.arctan(episode["slope"] * random.uniform(0, 1, count))
        uphill = random.uniform(-np.pi, np.pi, count)
        down = [-np.sin(tilt) * np.cos(uphill), -np.sin(tilt) * np.sin(uphill), -np.cos(tilt)]
        self.gravity[which] = 9.81 * np.stack(down, 1)
        for stretch, physics in zip(self.stretches, self.physics):
            local = which[(which >= stretch.start) & (which < stretch.stop)] - stretch.start
            physics.reset(local, self.gravity[stretch], self.nominal)
        self.age[which], self.walking[which], self.episode_reward[which] = 0, 0.0, 0.0
        self.last_target[which] = self.nominal
        self.current[which] = self.reduced()[which]
        self.previous[which] = self.current[which]

    def step_async(self, actions):
        self.actions = actions

    def step_wait(self):
        target = self.nominal + self.config["action"]["scale_rad"] * self.actions.astype(np.float64)
        pushed = np.flatnonzero(self.age == self.recovery)
        work = [(p, s, pushed[(pushed >= s.start) & (pushed < s.stop)] - s.start, target[s])
                for p, s in zip(self.physics, self.stretches)]
        parts = self.pool.map(self.advance, work) if self.pool else map(self.advance, work)
        power, squared, fell, foot_height = (np.concatenate(part) for part in zip(*parts))
        reward, r_lin, r_ang = self.reward(power, squared, foot_height)

        is_walking = self.age < self.recovery
        self.walking += np.where(is_walking[:, None], np.stack([r_lin, r_ang], 1), 0.0)
        self.episode_reward += reward
        self.age += 1
        self.previous, self.current, self.last_target = self.current, self.reduced(), target

        mean_walking = self.walking[:, 0] / self.recovery
        walk_alone = (self.age == self.recovery) & ~self.has_push
        out_of_time = walk_alone | (self.age >= self.last) | (self.age >= self.cut)
        done = fell | out_of_time
        observation = self.observation()
        infos = [{} for _ in range(self.num_envs)]
        ended = np.flatnonzero(done)
        if len(ended):
            for i in ended:
                infos[i] = {
                    "terminal_observation": observation[i],
                    "TimeLimit.truncated": bool(out_of_time[i] and not fell[i]),
                    "episode": {"r": self.episode_reward[i], "l": int(self.age[i]), "t": 0.0},
                }
            self.walked.extend(mean_walking[ended[self.age[ended] >= self.recovery]])
            self.cut[ended] = np.iinfo(int).max
            self.begin(ended)
            observation = observation.copy()
            observation[ended] = self.observation()[ended]
        return observation, reward.astype(np.float32), done, infos

    def advance(self, work):
        physics, stretch, pushed, target = work
        physics.push(pushed, self.push_linear[stretch], self.push_angular[stretch])
        return physics.step(target)

    def reward(self, power, squared, foot_height):
        """Table II and equations 1 to 3, with the tracking terms of the stage; and r_lin and r_ang as measured."""
        weights = self.config["reward"]
        position, velocity = self.joined("positions"), self.joined("velocities")
        centres = self.joined("centres")
        speed = rotate_back(position[:, 3:7], velocity[:, :3])
        sharpness = weights["tracking_sharpness"]
        r_lin = np.exp(-sharpness * ((speed[:, :2] - self.command[:, :2]) ** 2).sum(1))
        r_ang = np.exp(-sharpness * (velocity[:, 5] - self.command[:, 2]) ** 2)
        roll, pitch, _ = roll_pitch_yaw(position[:, 3:7])
        pose = roll**2 + pitch**2 + weights["height_sharpness"] * (position[:, 2] - weights["base_height_m"]) ** 2
        feet = np.concatenate([physics.foot_velocities() for physics in self.physics])
        height = centres[:, :, 2] - self.physics[0].foot_radius
        clearance = ((feet[:, :, :2] ** 2).sum(2) * (height - weights["foot_height_m"]) ** 2).sum(1)
        paid_lin, paid_ang = r_lin, r_ang
        if self.config["episode"]["recovery_stage"]:
            in_recovery = (self.age >= self.recovery) & (self.age < self.post_recovery)
            paid_lin = np.where(in_recovery, self.walking[:, 0] / self.recovery, r_lin)
            paid_ang = np.where(in_recovery, self.walking[:, 1] / self.recovery, r_ang)
        positive = (weights["linear_velocity"] * paid_lin + weights["angular_velocity"] * paid_ang
                    + weights["foot_height"] * foot_height)
        negative = (weights["energy"] * power + weights["torque"] * squared + weights["pose"] * pose
                    + weights["foot_clearance"] * clearance)
        return np.maximum(positive, 0.0) * np.exp(weights["negative_sharpness"] * negative), r_lin, r_ang

    def reduced(self):
        """Table I, shape (environments, 34)."""
        position, velocity = self.joined("positions"), self.joined("velocities")
        quaternion = position[:, 3:7]
        gravity, speed = rotate_back(quaternion, self.gravity), rotate_back(quaternion, velocity[:, :3])
        return np.concatenate([position[:, 2:3], gravity[:, TO_PAPER], position[:, 7:], speed[:, TO_PAPER],
                               velocity[:, 3:6][:, TO_PAPER], velocity[:, 6:]], 1)

    def observation(self):
        command = self.command[:, [1, 0, 2]]
        raw = np.concatenate([self.previous, self.last_target, self.current, command], 1)
        return ((raw - self.offset) * self.scale).astype(np.float32)

    def joined(self, name):
        return np.concatenate([getattr(physics, name) for physics in self.physics])

    def advance_curriculum(self):
        """The curriculum of commands and pushes, at the end of an iteration."""
        ranges = self.config["command"]
        if self.walked:
            if np.mean(self.walked) > ranges["fraction_gate"]:
                self.command_fraction = min(1.0, self.command_fraction + ranges["fraction_step"])
            self.pushes = self.pushes or np.mean(self.walked) > self.config["episode"]["push_gate"]
        self.walked = []

    def close(self):
        if self.pool:
            self.pool.shutdown()

    def get_attr(self, attr_name, indices=None):
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name, value, indices=None):
        raise NotImplementedError

    def env_method(self, method_name, *args, indices=None, **kwargs):
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs


def rotate_back(quaternion, vector):
    """World vectors in the base frame; quaternions (w, x, y, z), world from base."""
    w, axis = quaternion[:, :1], -quaternion[:, 1:]
    twice = 2.0 * cross(axis, vector)
    return vector + w * twice + cross(axis, twice)


def cross(a, b):
    """np.cross for equal shapes, at a fraction of its time."""
    result = np.empty_like(a)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        result[..., k] = a[..., i] * b[..., j] - a[..., j] * b[..., i]
    return result


def roll_pitch_yaw(quaternion):
    w, x, y, z = quaternion.T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    return roll, pitch, np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
