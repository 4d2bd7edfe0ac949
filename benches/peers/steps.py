"""Environment steps per second from Python, beside other vector environments, in turn.

    benches/peers/setup                                             # once
    target/peers/bin/python benches/peers/steps.py [--threads N] [--repetitions N]

What Rust does alone is `env_steps_per_s` of `cargo bench --bench throughput`, in physics steps. The others are Ant-v5, which is the
Gymnasium task that is nearest: MuJoCo, four legs, eight joints, 5 physics steps for one of the policy where ours has 4, each
with four evaluations (RK4) where ours has one: what they do in a step is not what ours do. Each takes its turn in every
repetition; numbers are medians. EnvPool leaves its threads unpinned and waits for all environments, as ours do.
"""

import argparse
import json
import statistics
import time

import numpy as np
import supple

CONFIG, COMPLETE = "fast", supple.Curriculum(1.0, True)


class Ours:
    """Our environment."""

    def __init__(self, actions, threads):
        self.actions, count = actions, actions.shape[1]
        self.env = supple.make_vec(CONFIG, num_envs=count, threads=threads, curriculum=COMPLETE)

    def measure(self):
        self.env.reset(seed=0)
        return timed(self.env, self.actions)


class Sb3:
    """The same through the adaptor for Stable-Baselines3."""

    def __init__(self, actions, threads):
        import supple.sb3

        self.actions = actions
        self.env = supple.sb3.SB3VecEnv(
            supple.make_vec(CONFIG, num_envs=actions.shape[1], threads=threads, curriculum=COMPLETE)
        )

    def measure(self):
        self.env.seed(0)
        self.env.reset()
        return timed(self.env, self.actions)


class Ant:
    """Ant-v5 of some maker; its eight joints get the first eight actions."""

    def __init__(self, env, actions):
        self.env, self.actions = env, np.ascontiguousarray(actions[:, :, :8], dtype=env.action_space.dtype).clip(-1, 1)
        self.env.reset()

    def measure(self):
        return timed(self.env, self.actions)


def timed(env, actions):
    started = time.perf_counter()
    for action in actions:
        env.step(action)
    return time.perf_counter() - started


def envpool_ant(actions, threads):
    import envpool

    return Ant(envpool.make("Ant-v5", env_type="gymnasium", num_envs=actions.shape[1], num_threads=threads), actions)


def gymnasium_ant(mode):
    def make(actions, threads):
        import gymnasium

        # A process for each environment, or all of them one after the other: there is no number of threads.
        return Ant(gymnasium.make_vec("Ant-v5", num_envs=actions.shape[1], vectorization_mode=mode), actions)

    return make


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--environments", type=int, default=64)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--steps", type=int, default=128)
    parser.add_argument("--repetitions", type=int, default=15)
    parser.add_argument("--no-peers", action="store_true")
    args = parser.parse_args()
    shape = (args.steps, args.environments, 12)
    actions = (0.3 * np.random.default_rng(0).standard_normal(shape)).astype(np.float32)
    ours = {"supple": Ours, "supple through SB3's VecEnv": Sb3}
    peers = {
        "EnvPool, Ant-v5": envpool_ant,
        "Gymnasium async, Ant-v5": gymnasium_ant("async"),
        "Gymnasium sync, Ant-v5": gymnasium_ant("sync"),
    }
    contestants = {}
    for name, make in (ours if args.no_peers else ours | peers).items():
        try:
            contestants[name] = make(actions, args.threads)
        except ImportError as error:
            print(f"{name} is left out: {error}")
    times = {name: [] for name in contestants}
    for repetition in range(args.repetitions + 1):
        for name, contestant in contestants.items():
            seconds = contestant.measure()
            # The first fills caches and is not counted.
            times[name] += [seconds] if repetition else []
    samples = args.steps * args.environments
    found = {name: samples / statistics.median(seconds) for name, seconds in times.items()}
    for name, rate in found.items():
        print(f"{name:28} {rate:9.0f} environment steps/s")
    print(json.dumps({"steps_per_s": found, "times_s": times, "threads": args.threads}))


if __name__ == "__main__":
    main()
