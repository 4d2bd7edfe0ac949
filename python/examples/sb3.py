"""Stable-Baselines3 learns to walk in Supple's environment.

    pip install './python[sb3]' onnx onnxscript
    python python/examples/sb3.py --samples 3000000 --out my-policy
    cargo run --bin scenario -- push --policy my-policy/policy.yaml
"""

import argparse
import csv
import pathlib
import time

import supple
import supple.sb3
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback


class Watch(BaseCallback):
    """A row of the curve for each batch; and the learning rate, which keeps the divergence of an update near its target."""

    rate, target = 3e-4, 0.02

    def __init__(self, path):
        super().__init__()
        self.rows = csv.writer(open(path, "w", newline="", buffering=1))
        self.rows.writerow(["samples", "time_s", "step_reward", "r_lin", "command_fraction", "pushes", "force_fraction"])
        self.started = time.perf_counter()

    def _on_rollout_start(self):
        divergence = self.logger.name_to_value.get("train/approx_kl", self.target)
        factor = 1 / 1.5 if divergence > 2 * self.target else 1.5 if divergence < self.target / 2 else 1.0
        self.rate = min(max(self.rate * factor, 1e-5), 1e-2)
        self.model.lr_schedule = lambda _: self.rate
        self.r_lin, self.reward, self.steps = 0.0, 0.0, 0

    def _on_step(self):
        env = self.training_env
        self.r_lin += env.info["reward_terms"]["linear_velocity"].mean()
        self.reward += self.locals["rewards"].mean()
        self.steps += 1
        return True

    def _on_rollout_end(self):
        means = [self.reward / self.steps, self.r_lin / self.steps, *self.training_env.env.curriculum]
        numbers = [time.perf_counter() - self.started, *means]
        self.rows.writerow([self.num_timesteps, *(f"{number:.4g}" for number in numbers)])


parser = argparse.ArgumentParser()
parser.add_argument("--config", default="fast")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--samples", type=int, default=3_000_000)
parser.add_argument("--threads", type=int, default=2)
parser.add_argument("--out", type=pathlib.Path, default="policy")
args = parser.parse_args()
args.out.mkdir(parents=True, exist_ok=True)
torch.set_num_threads(1)  # enough for networks this small, and steady on a machine that is shared

env = supple.sb3.SB3VecEnv(supple.make_vec(args.config, num_envs=64, seed=args.seed, threads=args.threads))
hidden = [256, 128, 64]
model = PPO(
    "MlpPolicy", env, seed=args.seed, device="cpu", n_steps=128, batch_size=512, n_epochs=8,
    gamma=0.99, gae_lambda=0.95, clip_range=0.2, ent_coef=0.01, vf_coef=0.5, max_grad_norm=0.5,
    policy_kwargs={"net_arch": {"pi": hidden, "vf": hidden}, "activation_fn": torch.nn.ELU, "log_std_init": -0.5,
                   "optimizer_kwargs": {"eps": 1e-5}},
)
model.learn(args.samples, callback=Watch(args.out / "curve.csv"))

policy = model.policy
actor = torch.nn.Sequential(*policy.mlp_extractor.policy_net, policy.action_net).eval()
torch.onnx.export(actor, (torch.zeros(1, *env.observation_space.shape),), args.out / "policy.onnx", external_data=False,
                  input_names=["observation"], output_names=["action"])
(args.out / "policy.yaml").write_text(supple.describe(args.config, "policy.onnx"))
run = supple.run_scenario("push", actor, config=args.config)
print(f"pushed, it {'fell' if run.fell else 'stayed on its feet'}; {args.out}/policy.yaml plays in `scenario`")
