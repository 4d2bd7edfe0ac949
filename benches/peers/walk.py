"""Time from nothing to a robot that walks: ours, rsl_rl on our environment, or UniLab's Go2 (which simulates on the CPU, too).

    benches/peers/setup walk                                        # once
    target/peers-walk/bin/python benches/peers/walk.py ours|rsl_rl|unilab [--config fast|go2] [--seed N] [--minutes M]

A robot walks if it is told to go forward at 0.5 m/s, starts from rest, stays on its feet for 7 s, and its mean velocity in the last 5 s
is within 0.1 m/s of that. It is asked about every 200,000 samples (UniLab: every 10 iterations of 24,576), on the policy without exploration; the time that this
takes does not count, start-up does (compiling and importing not). Prints a line for each question and one JSON object at the end. UniLab's environment
begins in random states and with random gains; there the mean over eight robots counts, and none may fall.

UniLab's package leaves the meshes of its Go2 to a hub. They are only seen, do not touch and do not weigh, so a tetrahedron takes the place of each.
"""
import argparse
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
COMMAND_M_S, SECONDS, MEASURED_S, ALLOWED_M_S, EVERY = 0.5, 7.0, 5.0, 0.1, 200_000


def answer(samples, elapsed_s, fell, velocity):
    """Tells what was measured; true if the robot walks."""
    print(f"{samples} samples, {elapsed_s:.0f} s: {'fell' if fell else f'{velocity:.2f} m/s'}", file=sys.stderr, flush=True)
    return not fell and abs(velocity - COMMAND_M_S) < ALLOWED_M_S


def walk(policy, **sees):
    """Whether our robot falls, and its mean velocity [m/s]; a network also needs the `config` that it observes."""
    import supple

    run = supple.run_scenario("walk", policy, forward_m_s=COMMAND_M_S, **sees)
    time_s, velocity = run.trace["time_s"], run.trace["velocity"][:, 0]
    measured = (time_s > SECONDS - MEASURED_S) & (time_s <= SECONDS)
    return run.fell is not False, float(velocity[measured].mean())


def ours(config, seed, deadline_s):
    """`train`, whose policies are kept on the way and asked afterwards."""
    import supple

    folder = pathlib.Path(tempfile.mkdtemp()) / "run"
    command = [os.environ.get("SUPPLE_TRAIN", ROOT / "target/release/train"), "--config", config, "--seed", str(seed), "--out", folder]
    train = subprocess.Popen([*command, "--set", f"run.keep_policy_every={EVERY}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        train.wait(deadline_s)
    except subprocess.TimeoutExpired:
        train.terminate()
        train.wait()
    elapsed_s = {row["samples"]: row["time"]["elapsed_s"] for row in map(json.loads, open(folder / "metrics.jsonl"))}
    kept = sorted((int(path.stem.removeprefix("policy-")), path) for path in folder.glob("policy-*.safetensors"))
    for samples, path in kept:
        reached = min(s for s in elapsed_s if s >= samples)
        if answer(samples, elapsed_s[reached], *walk(supple.Policy.load(path))):
            return samples, elapsed_s[reached]


def rsl_rl(config, seed, deadline_s):
    """rsl_rl's PPO on our environment, on two threads, PyTorch on as many."""
    import supple
    import torch

    sys.path.insert(0, str(ROOT / "python/examples"))
    import train_rsl_rl as example

    torch.manual_seed(seed)
    started = time.perf_counter()
    env = example.SuppleVecEnv(supple.make_vec(config, num_envs=256, seed=seed, threads=2))
    ppo, samples = example.runner(env, threads=2), 0
    iterations = EVERY // (24 * env.num_envs)
    ppo.logger.log = lambda *_, **__: None  # standard output is for the result
    while (elapsed_s := time.perf_counter() - started) < deadline_s:
        ppo.learn(iterations)
        ppo.current_learning_iteration += 1
        samples += iterations * 24 * env.num_envs
        elapsed_s = time.perf_counter() - started
        if answer(samples, elapsed_s, *walk(example.actor(ppo), config=config)):
            return samples, elapsed_s
        ppo.alg.train_mode()
        started += time.perf_counter() - started - elapsed_s


def unilab(_, seed, deadline_s):
    """UniLab's own command; its checkpoints are asked afterwards, in its own environment."""
    import unilab

    assets = pathlib.Path(unilab.__file__).parent / "assets/robots/go2"
    (assets / "assets").mkdir(exist_ok=True)
    tetrahedron = "v 0 0 0\nv .01 0 0\nv 0 .01 0\nv 0 0 .01\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    for name in set(re.findall(r'mesh file="(\w+\.obj)"', "".join(file.read_text() for file in assets.glob("*.xml")))):
        if not (assets / "assets" / name).exists():
            (assets / "assets" / name).write_text(tetrahedron)

    folder = pathlib.Path(tempfile.mkdtemp())
    (folder / "src").mkdir()
    (folder / "src/unilab").symlink_to(assets.parents[2])  # its configurations name files as from a clone
    os.chdir(folder)
    options = [f"training.log_dir={folder / 'run'}", "training.device=cpu", f"algo.seed={seed}", "task=go2_joystick_flat/mujoco"]
    command = [pathlib.Path(unilab.__file__).parent / "scripts/train_rsl_rl.py", *options, "training.no_play=true", "algo.save_interval=10"]
    started = time.time()
    log = open(folder / "log", "w")
    train = subprocess.Popen([sys.executable, *command], stdout=log, stderr=log)
    try:
        train.wait(deadline_s)
    except subprocess.TimeoutExpired:
        train.terminate()
        train.wait()
    checkpoints = sorted((int(path.stem.removeprefix("model_")), path) for path in (folder / "run").rglob("model_*.pt"))
    print(f"{len(checkpoints)} checkpoints; its log is {folder / 'log'}", file=sys.stderr)
    policy = UnilabGo2(options)
    for iteration, path in checkpoints:
        elapsed_s = path.stat().st_mtime - started
        if answer((iteration + 1) * 24 * 1024, elapsed_s, *policy.walk(path)):
            return (iteration + 1) * 24 * 1024, elapsed_s


class UnilabGo2:
    """UniLab's environment with one command, and a runner that loads its checkpoints."""

    def __init__(self, options, robots=8):
        import unilab
        from hydra import compose, initialize_config_dir
        from rsl_rl.runners import OnPolicyRunner
        from unilab.base.config_adapter import create_env
        from unilab.rl import RslRlVecEnvAdapter
        from unilab.scripts import train_rsl_rl
        from unilab.training import algo_config_dict, ensure_registries

        ensure_registries()
        ranges = "env.commands.twist.ranges"
        fixed = [f"{ranges}.lin_vel_x=[{COMMAND_M_S},{COMMAND_M_S}]", f"{ranges}.lin_vel_y=[0,0]", f"{ranges}.ang_vel_z=[0,0]"]
        with initialize_config_dir(str(pathlib.Path(unilab.__file__).parent / "conf/ppo"), version_base="1.3"):
            config = compose("config", overrides=[*options, *fixed])
        env = create_env(config, num_envs=robots, env_cfg_override=train_rsl_rl.build_ppo_env_cfg_override(config))
        self.env = RslRlVecEnvAdapter(env, device="cpu")
        self.runner = OnPolicyRunner(self.env, {**algo_config_dict(config), "logger": "none"}, log_dir=None, device="cpu")

    def walk(self, checkpoint):
        """Whether a robot falls, and their mean velocity [m/s]: the last three numbers of the critic's observation."""
        import torch

        self.runner.load(str(checkpoint), map_location="cpu")
        policy, steps, fell, velocities = self.runner.get_inference_policy("cpu"), int(SECONDS * 50), False, []
        observations, _ = self.env.reset()
        with torch.no_grad():
            for step in range(steps):
                observations, _, dones, _ = self.env.step(policy(observations))
                fell |= bool(dones.any())
                if step >= steps - int(MEASURED_S * 50):
                    velocities.append(observations["critic"][:, -3].mean().item())
        return fell, sum(velocities) / len(velocities)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("who", choices=["ours", "rsl_rl", "unilab"])
    parser.add_argument("--config", default="fast", help="of ours and of rsl_rl")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=10.0, help="of training, at most")
    args = parser.parse_args()
    who = {"ours": ours, "rsl_rl": rsl_rl, "unilab": unilab}[args.who]
    samples, seconds = who(args.config, args.seed, 60 * args.minutes) or (None, None)
    print(json.dumps({"who": args.who, "seed": args.seed, "walks_after_s": seconds, "walks_after_samples": samples}))


if __name__ == "__main__":
    main()
