"""An admittance on a learned estimate of the force beside a frozen walker, after HAC-LOCO (arXiv 2507.02447).

    cargo run --release --bin policy -- export real --format onnx --out walker.onnx
    pip install ./python onnx onnxruntime scikit-learn
    python python/examples/admittance.py walker.onnx --compliance 0.05 --out admittance
    cargo run --release -p supple-evaluate --bin evaluate -- --exam admittance/policy.yaml --out exam

An estimator learns the force on the trunk and the velocity of the base from what the walker observes, now and up to four steps
ago, while hands pull at it in the environment of `real`: first on the walker alone, then also on the walker that yields. Beyond a
dead band the force changes the walker's command to v* + c F, within its training range, and the walker observes the estimate in
place of the felt force. OUT gets `policy.onnx` and `policy.yaml`.
"""

import argparse
import pathlib

import numpy as np
import onnx
import onnxruntime
import supple
from onnx import helper, numpy_helper
from sklearn.neural_network import MLPRegressor

RANGE_M_S = np.array([0.5, 1.0])  # largest command, left and forward: the walker's training range
PULL_SCALE, VELOCITY_SCALE = 0.05, 1.0  # of critic_observation in configs/real.yaml

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("walker", type=pathlib.Path, help="ONNX file of `policy export`; its YAML file is beside it")
parser.add_argument("--config", default="real")
parser.add_argument("--compliance", type=float, default=0.05, help="m/s per newton beyond the dead band")
parser.add_argument("--samples", type=int, default=600_000)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--threads", type=int, default=2)
parser.add_argument("--out", type=pathlib.Path, default="admittance")
args = parser.parse_args()

walker = onnxruntime.InferenceSession(str(args.walker), providers=["CPUExecutionProvider"])
env = supple.make_vec(args.config, num_envs=64, seed=args.seed, threads=args.threads, curriculum=supple.Curriculum(1.0, True, 1.0))
names, critic = env.observation_names, env.critic_observation_names
felt = [k for k, name in enumerate(names) if name.startswith("felt force")]
seen = [k for k in range(len(names)) if k not in felt]
commands = [k for k, name in enumerate(names) if name.startswith("commanded")][:2]
labels = [critic.index(name) for name in ["pull left [N]", "pull forward [N]", "velocity left [m/s]", "velocity forward [m/s]"]]


def yielding(raw, force):
    """What the walker observes: the command that yields to an estimated force, and that force."""
    fed = raw.copy()
    beyond = force - np.clip(force, -dead_band, dead_band)
    fed[:, commands] = np.clip(raw[:, commands] + args.compliance * beyond, -RANGE_M_S, RANGE_M_S)
    fed[:, felt] = force
    return fed


# What the walker does while it is pulled and pushed, with the noise of a policy that learns. The last fifth of a round is for measuring.
rng = np.random.default_rng(args.seed)
observations, info = env.reset()
inputs, outputs, estimator = [], [], None
for steps in [args.samples // 2 // env.num_envs] * 2:
    for _ in range(steps):
        raw = (observations / env.observation_scale + env.observation_offset).astype(np.float32)
        inputs.append(raw)
        outputs.append(info["critic_observation"][:, labels] / [PULL_SCALE, PULL_SCALE, VELOCITY_SCALE, VELOCITY_SCALE])
        fed = raw if estimator is None else yielding(raw, (estimator.predict((raw[:, seen] - mean) / deviation) * scale)[:, :2])
        targets = walker.run(None, {walker.get_inputs()[0].name: fed})[0]
        actions = (targets - env.action_offset) / env.action_scale + rng.normal(0, 0.05, targets.shape)
        observations, *_, info = env.step(actions.astype(np.float32))
    known = len(inputs) - steps // 5
    seen_then, truth = np.concatenate(inputs)[:, seen], np.concatenate(outputs)
    mean, deviation, scale = seen_then.mean(0), seen_then.std(0) + 1e-6, truth.std(0)
    scaled, known = (seen_then - mean) / deviation, known * env.num_envs
    estimator = MLPRegressor(hidden_layer_sizes=(256, 128), batch_size=1024, learning_rate_init=1e-3, max_iter=15, random_state=args.seed)
    estimator.fit(scaled[:known], truth[:known] / scale)
    estimates, truth = estimator.predict(scaled[known:]) * scale, truth[known:]
    calm = np.hypot(*truth[:, :2].T) == 0
    dead_band = float(np.quantile(np.abs(estimates[calm, :2]), 0.95))
force, velocity = np.sqrt(((estimates - truth) ** 2).mean(0).reshape(2, 2).mean(1))
gain = (estimates[:, :2] * truth[:, :2]).sum() / (truth[:, :2] ** 2).sum()
print(f"estimates: force within {force:.2f} N RMSE (gain {gain:.2f}), velocity {velocity:.3f} m/s; dead band {dead_band:.1f} N")

# One graph: the estimator, the dead band, the command, and the walker.
graph = onnx.load(args.walker).graph
whole, target = graph.input[0].name, graph.output[0].name
nodes, constants = [], []


def constant(name, values, kind=np.float32):
    constants.append(numpy_helper.from_array(np.asarray(values, kind), name))
    return name


def node(operator, inputs, output, **attributes):
    nodes.append(helper.make_node(operator, inputs, [output], **attributes))
    return output


first = estimator.coefs_[0] / deviation[:, None]
weights = np.zeros((len(names), first.shape[1]))
weights[seen] = first
layers = [(weights, estimator.intercepts_[0] - mean @ first), *zip(estimator.coefs_[1:], estimator.intercepts_[1:])]
layers[-1] = (layers[-1][0][:, :2] * scale[:2], layers[-1][1][:2] * scale[:2])  # the force alone
last = "observed"
for k, (weights, bias) in enumerate(layers):
    last = node("Gemm", [last, constant(f"w{k}", weights), constant(f"b{k}", bias)], f"layer{k}")
    if k + 1 < len(layers):
        last = node("Relu", [last], f"relu{k}")
within = node("Clip", [last, constant("low", -dead_band), constant("high", dead_band)], "within")
beyond = node("Sub", [last, within], "beyond")
change = node("Mul", [beyond, constant("compliance", args.compliance)], "change")
to_command, to_felt = np.zeros((2, len(names))), np.zeros((2, len(names)))
to_command[[0, 1], commands] = 1
to_felt[[0, 1], felt] = 1
kept = np.ones(len(names))
kept[felt + commands] = 0
wanted = node("Add", [node("MatMul", ["observed", constant("of_command", to_command.T)], "asked"), change], "wanted")
command = node("Max", [node("Min", [wanted, constant("most", RANGE_M_S)], "capped"), constant("least", -RANGE_M_S)], "command")
others = node("Mul", ["observed", constant("kept", kept)], "others")
feels = node("Add", [others, node("MatMul", [last, constant("to_felt", to_felt)], "as_felt")], "feels")
node("Add", [feels, node("MatMul", [command, constant("to_command", to_command)], "as_command")], whole)
graph.input[0].name = "observed"
nodes.extend(graph.node)
del graph.node[:]
graph.node.extend(nodes)
graph.initializer.extend(constants)
args.out.mkdir(parents=True, exist_ok=True)
onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), args.out / "policy.onnx")
description = args.walker.with_suffix(".yaml").read_text().replace(f'"{args.walker.name}"', '"policy.onnx"')
(args.out / "policy.yaml").write_text(description)

# The graph does what the loop above did.
raw = inputs[-1]
fed = yielding(raw, (estimator.predict((raw[:, seen] - mean) / deviation) * scale)[:, :2])
found = onnxruntime.InferenceSession(str(args.out / "policy.onnx")).run(None, {"observed": raw})[0]
np.testing.assert_allclose(found, walker.run(None, {walker.get_inputs()[0].name: fed})[0], atol=1e-3)
