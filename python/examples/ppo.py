"""PPO in one file: a network of PyTorch learns to walk in Supple's environment.

    pip install ./python torch onnx onnxscript
    python python/examples/ppo.py --samples 3000000 --out my-policy
    cargo run --bin scenario -- push --policy my-policy/policy.yaml

Table III of the paper but for 8 instead of 30 epochs and wider exploration at first, as the configuration `fast` has it. OUT
gets `curve.csv`, a row for each batch, and the policy: `policy.onnx`, and `policy.yaml`, which describes it.
"""

import argparse
import csv
import pathlib
import time

import numpy as np
import supple
import torch
from torch import nn

STEPS, MINIBATCH, EPOCHS = 128, 512, 8
GAMMA, LAMBDA, CLIP, ENTROPY, VALUE, MAX_NORM, KL = 0.99, 0.95, 0.2, 0.01, 0.5, 0.5, 0.02


def mlp(inputs, outputs, last_gain):
    layers, widths = [], [inputs, 256, 128, 64]
    for width, next_width in zip(widths, widths[1:]):
        layers += [linear(width, next_width, 2**0.5), nn.ELU()]
    return nn.Sequential(*layers, linear(64, outputs, last_gain))


def linear(inputs, outputs, gain):
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


parser = argparse.ArgumentParser()
parser.add_argument("--config", default="fast")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--samples", type=int, default=3_000_000)
parser.add_argument("--threads", type=int, default=2)
parser.add_argument("--out", type=pathlib.Path, default="policy")
args = parser.parse_args()
args.out.mkdir(parents=True, exist_ok=True)
torch.manual_seed(args.seed)
torch.set_num_threads(1)  # enough for networks this small, and steady on a machine that is shared

env = supple.make_vec(args.config, num_envs=64, seed=args.seed, threads=args.threads)
inputs, joints, n = env.single_observation_space.shape[0], env.single_action_space.shape[0], env.num_envs
actor, critic = mlp(inputs, joints, 0.01), mlp(inputs, 1, 1.0)
log_std = nn.Parameter(torch.full((joints,), -0.5))
parameters = [*actor.parameters(), *critic.parameters(), log_std]
adam = torch.optim.Adam(parameters, lr=1e-3, eps=1e-5, fused=True)

observations = torch.zeros(STEPS, n, inputs)
actions, means = torch.zeros(STEPS, n, joints), torch.zeros(STEPS, n, joints)
log_probs, rewards, values, dones = (torch.zeros(STEPS, n) for _ in range(4))
seen = torch.from_numpy(env.reset(seed=args.seed)[0])
curve = csv.writer(open(args.out / "curve.csv", "w", newline="", buffering=1))
curve.writerow(["samples", "time_s", "step_reward", "r_lin", "episode_steps", "fall_rate", "command_fraction", "pushes", "force_fraction"])
started = time.perf_counter()

for batch in range(args.samples // (STEPS * n)):
    lengths, falls, r_lin, step_reward = [], 0, 0.0, 0.0
    with torch.no_grad():
        for t in range(STEPS):
            policy = torch.distributions.Normal(actor(seen), log_std.exp(), validate_args=False)
            observations[t], means[t], actions[t] = seen, policy.mean, policy.sample()
            log_probs[t], values[t] = policy.log_prob(actions[t]).sum(1), critic(seen).squeeze(1)
            seen, reward, terminated, truncated, info = env.step(actions[t].numpy())
            seen, rewards[t] = torch.from_numpy(seen), torch.from_numpy(reward)
            dones[t] = torch.from_numpy(terminated | truncated)
            r_lin += info["reward_terms"]["linear_velocity"].mean() / STEPS
            step_reward += reward.mean() / STEPS
            if truncated.any():  # time was up: the return goes on with the value of the last observation
                last = torch.from_numpy(np.stack(info["final_obs"][truncated]))
                rewards[t, torch.from_numpy(truncated)] += GAMMA * critic(last).squeeze(1)
            if "final_info" in info:
                lengths += info["final_info"]["episode"]["l"][info["_final_info"]].tolist()
                falls += terminated.sum()
        advantages, advantage, next_value = torch.zeros(STEPS, n), 0.0, critic(seen).squeeze(1)
        for t in reversed(range(STEPS)):
            delta = rewards[t] + GAMMA * next_value * (1 - dones[t]) - values[t]
            advantage = delta + GAMMA * LAMBDA * (1 - dones[t]) * advantage
            advantages[t], next_value = advantage, values[t]
    data = [x.flatten(0, 1) for x in (observations, actions, means, log_probs, advantages, advantages + values)]
    old_std = log_std.detach().exp()

    for _ in range(EPOCHS):
        for rows in torch.randperm(STEPS * n).split(MINIBATCH):
            o, a, old_mean, old_log_prob, adv, target = (x[rows] for x in data)
            policy = torch.distributions.Normal(actor(o), log_std.exp(), validate_args=False)
            with torch.no_grad():  # the learning rate keeps the divergence from the policy that acted near its target
                kl = torch.log(policy.stddev / old_std) + (old_std**2 + (old_mean - policy.mean) ** 2) / (2 * policy.variance)
                kl, rate = (kl - 0.5).sum(1).mean().item(), adam.param_groups[0]["lr"]
                factor = 1 / 1.5 if kl > 2 * KL else 1.5 if 0 < kl < KL / 2 else 1.0
                adam.param_groups[0]["lr"] = min(max(rate * factor, 1e-5), 1e-2)
            adv = (adv - adv.mean()) / (adv.std() + 1e-8)
            ratio = (policy.log_prob(a).sum(1) - old_log_prob).exp()
            policy_loss = -torch.min(adv * ratio, adv * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
            value_loss = (critic(o).squeeze(1) - target).pow(2).mean()
            loss = policy_loss + VALUE * value_loss - ENTROPY * policy.entropy().sum(1).mean()
            adam.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(parameters, MAX_NORM)
            adam.step()

    samples, elapsed_s = (batch + 1) * STEPS * n, time.perf_counter() - started
    mean_length, fall_rate = np.mean(lengths or [np.nan]), falls / max(len(lengths), 1)
    curve.writerow([samples, *(f"{x:.4g}" for x in (elapsed_s, step_reward, r_lin, mean_length, fall_rate, *env.curriculum))])
    if batch % 10 == 9:
        print(f"{samples / 1e6:5.2f} M samples, {elapsed_s:4.0f} s: reward {step_reward:.3f}, r_lin {r_lin:.3f}, "
              f"{fall_rate:4.0%} falls")

actor.eval()
torch.onnx.export(actor, (torch.zeros(1, inputs),), args.out / "policy.onnx", external_data=False,
                  input_names=["observation"], output_names=["action"])
(args.out / "policy.yaml").write_text(supple.describe(args.config, "policy.onnx"))
run = supple.run_scenario("push", actor, config=args.config)
print(f"pushed, it {'fell' if run.fell else 'stayed on its feet'}; {args.out}/policy.yaml plays in `scenario`")
