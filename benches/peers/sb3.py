"""Whole iterations of Stable-Baselines3's PPO with Table III on the environment of go1_env.py, or on ours.

    sb3.py FOLDER [--environment supple] [--threads N] [--epochs N] [--repetitions N]

FOLDER holds config.json, scene.xml and robot.xml. Prints one JSON object; times are medians over iterations. Threads of
the environment and of PyTorch's update are whichever is faster here, one or N, and so is the update's precision, f32 or
autocast to bf16, which the tiles of newer processors multiply. Differences from ours, all in its favour
or without effect on the time: current MuJoCo (but for our environment, which is the one of `train`), fused Adam, a
constant learning rate.
"""
import argparse
import itertools
import json
import pathlib
import statistics
import time

import mujoco
import numpy as np
import stable_baselines3
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from go1_env import ACTIONS, Go1VecEnv


class TimedPPO(PPO):
    """Notes how long each rollout and each update took."""

    def collect_rollouts(self, *args, **kwargs):
        torch.set_num_threads(1)  # one forward pass of a small batch at a time: more threads only cost
        started = time.perf_counter()
        result = super().collect_rollouts(*args, **kwargs)
        self.rollout_times.append(time.perf_counter() - started)
        return result

    def train(self):
        threads, bf16 = self.update_choice
        torch.set_num_threads(threads)
        started = time.perf_counter()
        with torch.autocast("cpu", torch.bfloat16, enabled=bf16):
            super().train()
        self.update_times.append(time.perf_counter() - started)


class Curriculum(BaseCallback):
    """Widens the commands after every rollout; our environment does so by itself."""

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        if isinstance(self.training_env, Go1VecEnv):
            self.training_env.advance_curriculum()


def ppo(env, config, epochs):
    p = config["ppo"]
    torch.manual_seed(0)
    model = TimedPPO(
        "MlpPolicy", env, device="cpu", verbose=0,
        n_steps=p["batch_size"] // p["environments"], batch_size=p["minibatch_size"], n_epochs=epochs,
        learning_rate=p["initial_learning_rate"], clip_range=p["clip_range"], ent_coef=p["entropy_coefficient"],
        gamma=p["discount"], gae_lambda=p["gae_lambda"], vf_coef=p["value_coefficient"],
        max_grad_norm=p["max_gradient_norm"],
        policy_kwargs={
            "net_arch": {"pi": p["hidden_layers"], "vf": p["hidden_layers"]},
            "activation_fn": torch.nn.ELU,
            "log_std_init": p["initial_log_std"],
            "optimizer_kwargs": {"eps": p["adam_epsilon"], "fused": True},
        },
    )
    model.rollout_times, model.update_times, model.update_choice = [], [], (1, False)
    return model


def environment_s(env, steps):
    """Time of some steps with random actions."""
    random = np.random.default_rng(0)
    env.reset()
    started = time.perf_counter()
    for _ in range(steps):
        env.step(0.3 * random.standard_normal((env.num_envs, ACTIONS), dtype=np.float32))
    return time.perf_counter() - started


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--environment", choices=["go1_env", "supple"], default="go1_env")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--epochs", type=int, default=30)
    parser.add_argument("--repetitions", type=int, default=5)
    args = parser.parse_args()
    config = json.loads((args.folder / "config.json").read_text())
    count, batch_size = config["ppo"]["environments"], config["ppo"]["batch_size"]
    choices = sorted({1, args.threads})

    def make(threads):
        if args.environment == "go1_env":
            return Go1VecEnv(args.folder / "scene.xml", config, count, threads)
        import supple.sb3

        return supple.sb3.SB3VecEnv(supple.make_vec("compliant", num_envs=count, threads=threads))

    env_trial_s = {threads: environment_s(make(threads), 64) for threads in choices}
    env_threads = min(env_trial_s, key=env_trial_s.get)
    model = ppo(make(env_threads), config, args.epochs)

    model.n_epochs, update_trial_s = min(2, args.epochs), {}
    for choice in itertools.product(choices, (False, True)):
        model.update_choice = choice
        model.learn(batch_size, reset_num_timesteps=False)
        update_trial_s[choice] = model.update_times[-1]
    model.update_choice = min(update_trial_s, key=update_trial_s.get)

    model.n_epochs, model.rollout_times, model.update_times = args.epochs, [], []
    started = time.perf_counter()
    model.learn(args.repetitions * batch_size, callback=Curriculum(), reset_num_timesteps=False)
    elapsed_s = time.perf_counter() - started
    whole = [rollout + update for rollout, update in zip(model.rollout_times, model.update_times)]
    print(json.dumps({
        "samples_per_s": batch_size / statistics.median(whole),
        "rollout_s": statistics.median(model.rollout_times),
        "update_s": statistics.median(model.update_times),
        "rest_s": elapsed_s / args.repetitions - statistics.mean(whole),
        "env_threads": env_threads,
        "env_trial_s_by_threads": env_trial_s,
        "update_threads": model.update_choice[0],
        "update_bf16": model.update_choice[1],
        "update_trial_s": {f"{threads} threads, {'bf16' if bf16 else 'f32'}": s for (threads, bf16), s in update_trial_s.items()},
        "env_samples_per_s": 64 * count / env_trial_s[env_threads],
        "stable_baselines3": stable_baselines3.__version__,
        "torch": torch.__version__,
        "mujoco": mujoco.__version__,
    }))


if __name__ == "__main__":
    main()
