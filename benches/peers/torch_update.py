"""The learner's minibatches in PyTorch: the same networks, losses, gradient clip, KL rule and Adam, without a framework.

    torch_update.py FOLDER [--threads N] [--epochs N] [--repetitions N] [--compile]

FOLDER holds config.json. Prints one JSON object; `sample_passes_per_s` is the median at the best number of threads and
the faster precision, f32 or autocast to bf16, which the tiles of newer processors multiply. The batch is random numbers: it has the sizes of a real one, and the time does not depend on more.
"""
import argparse
import itertools
import json
import math
import pathlib
import statistics
import time

import torch
from torch import nn

OBSERVATIONS, ACTIONS = 83, 12


class Learner:
    """Policy, value function and optimiser."""

    def __init__(self, ppo, compiled, bf16):
        torch.manual_seed(0)
        self.ppo, self.bf16 = ppo, bf16
        self.policy, self.value = (mlp(ppo["hidden_layers"], outputs) for outputs in (ACTIONS, 1))
        self.log_std = nn.Parameter(torch.full((ACTIONS,), float(ppo["initial_log_std"])))
        self.parameters = [*self.policy.parameters(), *self.value.parameters(), self.log_std]
        rate = ppo["initial_learning_rate"]
        self.adam = torch.optim.Adam(self.parameters, lr=rate, eps=ppo["adam_epsilon"], fused=True)
        self.losses = torch.compile(self.loss) if compiled else self.loss

    def loss(self, observations, actions, old_means, old_log_std, old_log_probs, advantages, returns):
        """Loss, and the divergence from the policy that acted."""
        ppo = self.ppo
        means, values = self.policy(observations), self.value(observations).squeeze(1)
        std = self.log_std.exp()
        log_probs = (-0.5 * ((actions - means) / std) ** 2 - self.log_std - 0.5 * math.log(2 * math.pi)).sum(1)
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        ratio = (log_probs - old_log_probs).exp()
        clipped = ratio.clamp(1 - ppo["clip_range"], 1 + ppo["clip_range"])
        policy_loss = -torch.min(advantages * ratio, advantages * clipped).mean()
        value_loss = ((values - returns) ** 2).mean()
        entropy = (self.log_std + 0.5 * math.log(2 * math.pi * math.e)).sum()
        with torch.no_grad():
            variance = (2 * old_log_std).exp() + (old_means - means) ** 2
            kl = (self.log_std - old_log_std + variance / (2 * std**2) - 0.5).sum(1).mean()
        return policy_loss + ppo["value_coefficient"] * value_loss - ppo["entropy_coefficient"] * entropy, kl

    def minibatch(self, batch, rows):
        observations, actions, means, log_std, log_probs, advantages, returns = batch
        with torch.autocast("cpu", torch.bfloat16, enabled=self.bf16):
            loss, kl = self.losses(observations[rows], actions[rows], means[rows], log_std, log_probs[rows],
                                   advantages[rows], returns[rows])
        self.adapt(kl.item())
        self.adam.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.parameters, self.ppo["max_gradient_norm"])
        self.adam.step()

    def adapt(self, kl):
        """The learning rate follows the divergence (Rudin et al., 2022)."""
        group, desired = self.adam.param_groups[0], self.ppo["desired_kl"]
        if kl > 2 * desired:
            group["lr"] = max(group["lr"] / 1.5, self.ppo["min_learning_rate"])
        elif 0 < kl < desired / 2:
            group["lr"] = min(group["lr"] * 1.5, self.ppo["max_learning_rate"])

    def update(self, batch, epochs):
        """One PPO update; its time [s]."""
        samples, size = self.ppo["batch_size"], self.ppo["minibatch_size"]
        started = time.perf_counter()
        for _ in range(epochs):
            for rows in torch.randperm(samples).split(size):
                self.minibatch(batch, rows)
        return time.perf_counter() - started


def mlp(hidden, outputs):
    layers, inputs = [], OBSERVATIONS
    for width in hidden:
        layers += [nn.Linear(inputs, width), nn.ELU()]
        inputs = width
    return nn.Sequential(*layers, nn.Linear(inputs, outputs))


def random_batch(learner):
    """With the means and log-probabilities of the learner's own policy."""
    samples = learner.ppo["batch_size"]
    observations = torch.randn(samples, OBSERVATIONS)
    with torch.no_grad():
        means, log_std = learner.policy(observations), learner.log_std.detach().clone()
        noise = torch.randn(samples, ACTIONS)
        log_probs = (-0.5 * noise**2 - log_std - 0.5 * math.log(2 * math.pi)).sum(1)
    return (observations, means + noise * log_std.exp(), means, log_std, log_probs, torch.randn(samples),
            torch.randn(samples))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--epochs", type=int, default=30)
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--compile", action="store_true")
    args = parser.parse_args()
    ppo = json.loads((args.folder / "config.json").read_text())["ppo"]
    trial_s = {}
    for threads, bf16 in itertools.product(sorted({1, args.threads // 2 or 1, args.threads}), (False, True)):
        torch.set_num_threads(threads)
        learner = Learner(ppo, args.compile, bf16)
        batch = random_batch(learner)
        learner.update(batch, 1)
        trial_s[threads, bf16] = learner.update(batch, min(3, args.epochs))
    threads, bf16 = min(trial_s, key=trial_s.get)
    torch.set_num_threads(threads)
    times = []
    for _ in range(args.repetitions):
        learner = Learner(ppo, args.compile, bf16)
        batch = random_batch(learner)
        times.append(learner.update(batch, args.epochs))
    passes = args.epochs * ppo["batch_size"]
    print(json.dumps({
        "sample_passes_per_s": passes / statistics.median(times),
        "threads": threads,
        "bf16": bf16,
        "trial_s": {f"{threads} threads, {'bf16' if bf16 else 'f32'}": s for (threads, bf16), s in trial_s.items()},
        "compiled": args.compile,
        "torch": torch.__version__,
    }))


if __name__ == "__main__":
    main()
