"""rsl_rl learns to walk in Supple's environment; its critic sees more where the configuration has `critic_observation`.

    pip install ./python rsl-rl-lib onnx onnxscript
    python python/examples/train_rsl_rl.py --samples 3000000 --out my-policy
    cargo run --bin scenario -- push --policy my-policy/policy.yaml
"""

import argparse
import pathlib

import numpy as np
import supple
import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict


class SuppleVecEnv(VecEnv):
    """A `LocomotionVectorEnv` with the interface of rsl_rl: observation groups `policy` and, if there is one, `privileged`."""

    def __init__(self, env):
        self.env, self.cfg, self.device = env, {}, "cpu"
        self.num_envs, self.num_actions = env.num_envs, env.single_action_space.shape[0]
        self.max_episode_length = 1000  # only drawn from with init_at_random_ep_len, in whose place make_vec staggers
        self.episode_length_buf = torch.zeros(self.num_envs, dtype=torch.long)
        self.observations = self.groups(*env.reset())

    def groups(self, observations, info):
        groups = {"policy": torch.from_numpy(np.array(observations))}
        if "critic_observation" in info:
            groups["privileged"] = torch.from_numpy(np.array(info["critic_observation"]))
        return TensorDict(groups, batch_size=[self.num_envs])

    def get_observations(self):
        return self.observations

    def step(self, actions):
        observations, rewards, terminations, truncations, info = self.env.step(actions.numpy())
        self.observations = self.groups(observations, info)
        dones = torch.from_numpy(terminations | truncations)
        self.episode_length_buf = torch.where(dones, 0, self.episode_length_buf + 1)
        extras = {"time_outs": torch.from_numpy(truncations.astype(np.float32))}
        return self.observations, torch.from_numpy(rewards.astype(np.float32)), dones.long(), extras


def runner(env, threads=1):
    """PPO with rsl_rl's usual numbers, and the networks, exploration and reward horizon of `fast`."""
    torch.set_num_threads(threads)
    network = {"class_name": "MLPModel", "hidden_dims": [256, 128, 64], "activation": "elu"}
    exploration = {"class_name": "GaussianDistribution", "init_std": 0.6, "std_type": "log"}
    critic = ["policy", "privileged"] if "privileged" in env.get_observations().keys() else ["policy"]
    return OnPolicyRunner(env, {
        "num_steps_per_env": 24, "save_interval": 100, "logger": "tensorboard", "obs_groups": {"actor": ["policy"], "critic": critic},
        "actor": {**network, "distribution_cfg": exploration}, "critic": network,
        "algorithm": {"class_name": "PPO", "num_learning_epochs": 5, "num_mini_batches": 4, "learning_rate": 1e-3,
                      "schedule": "adaptive", "desired_kl": 0.01, "entropy_coef": 0.005, "gamma": 0.99, "lam": 0.95},
    })


def actor(runner):
    """The policy as a module from observation to action."""
    return runner.get_inference_policy().mlp.eval()


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--config", default="fast")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--samples", type=int, default=3_000_000)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--out", type=pathlib.Path, default="policy")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(args.seed)

    env = SuppleVecEnv(supple.make_vec(args.config, num_envs=256, seed=args.seed, threads=args.threads))
    ppo = runner(env)
    ppo.learn(args.samples // (24 * env.num_envs))
    network = actor(ppo)
    torch.onnx.export(network, (torch.zeros(1, *env.env.single_observation_space.shape),), args.out / "policy.onnx",
                      external_data=False, input_names=["observation"], output_names=["action"])
    (args.out / "policy.yaml").write_text(supple.describe(args.config, "policy.onnx"))
    run = supple.run_scenario("push", network, config=args.config)
    print(f"pushed, it {'fell' if run.fell else 'stayed on its feet'}; {args.out}/policy.yaml plays in `scenario`")
