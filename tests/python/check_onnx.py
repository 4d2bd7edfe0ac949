#!/usr/bin/env python3
"""Policies as the rest of the world sees them: ONNX in onnxruntime, safetensors in its own package, MuJoCo from PyPI.

    python3 tests/python/check_onnx.py FOLDER_WITH_PROGRAMS [POLICY[@ROBOT.xml] ...]

scripts/check_python calls it. Checks, for each policy: the exported graph passes ONNX' checker; onnxruntime and our own
inference (`policy run`) agree to 1e-5 rad on the stored golden observations and on random ones, alone and in a batch; the
policy file opens with Python's safetensors and its metadata parse; examples/python/run_onnx.py walks as `scenario walk`, and on another model of its robot where one is
named, such as `go2/compliant@path/to/go2.xml`.
"""
import json
import pathlib
import re
import subprocess
import sys
import tempfile

import numpy as np
import onnx
import onnxruntime
from safetensors import safe_open

ROOT = pathlib.Path(__file__).parents[2]
PROGRAMS = pathlib.Path(sys.argv[1]).resolve()
POLICIES = sys.argv[2:] or ["compliant", "baseline"]
TOLERANCE_RAD = 1e-5
TOLERANCE_M_S = 0.05
ELSEWHERE_M_S = 0.2  # with other joint losses, contacts and inertias


def run(*command, text=None):
    done = subprocess.run([str(part) for part in command], input=text, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, f"{command}: {done.stderr}"
    return done.stdout


def check_graph(path):
    """The graph and the names that others rely on."""
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    about = json.loads({entry.key: entry.value for entry in model.metadata_props}["supple"])
    [observation], [target] = model.graph.input, model.graph.output
    shapes = [[dim.dim_param or dim.dim_value for dim in value.type.tensor_type.shape.dim] for value in (observation, target)]
    assert (observation.name, target.name, shapes) == ("observation", "joint_target", [["batch", 83], ["batch", 12]]), shapes
    assert len(about["observation"]) == 14 and sum(block["length"] for block in about["observation"]) == 83
    return about


def check_numbers(path, policy, tensors):
    """Golden and random observations through both runtimes."""
    offset, scale = tensors["normaliser.offset"], tensors["normaliser.scale"]
    rng = np.random.default_rng(0)
    random = offset + rng.normal(size=(200, 83)) * rng.choice([0.1, 1.0, 3.0], size=(200, 1)) / scale
    observations = np.concatenate([tensors["golden.observation"], random])
    lines = "".join(json.dumps(row.tolist()) + "\n" for row in observations)
    ours = np.array([json.loads(line) for line in run(PROGRAMS / "policy", "run", policy, text=lines).splitlines()])
    assert np.abs(ours[:3] - tensors["golden.joint_target"]).max() < TOLERANCE_RAD
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    single = observations.astype(np.float32)
    batch = session.run(["joint_target"], {"observation": single})[0]
    alone = np.concatenate([session.run(["joint_target"], {"observation": row[None]})[0] for row in single])
    worst = max(np.abs(batch - ours).max(), np.abs(alone - ours).max())
    assert worst < TOLERANCE_RAD, f"onnxruntime differs by {worst} rad"
    return worst


def walk(path, *model):
    """PyPI's MuJoCo: how far the velocity is off [m/s], and the height of the base [m]."""
    printed = run(sys.executable, "examples/python/run_onnx.py", path, "0.5", *model)
    return [float(number) for number in re.search(r"([+-]\d+\.\d+) m/s, base at (-?\d+\.\d+) m", printed).groups()]


def check_walk(path, policy, robot):
    """PyPI's MuJoCo against ours, and on another model."""
    theirs, _ = walk(path)
    played = json.loads(run(
        PROGRAMS / "scenario", "walk", "--policy", policy, "--compare", "none", "--forward-m-s", "0.5", "--duration-s", "5",
        "--json", "--no-record"))
    ours = played["runs"][0]["metrics"]["forward_error_m_s"]
    assert abs(theirs - ours) < TOLERANCE_M_S, f"velocity error {theirs} in PyPI's MuJoCo, {ours} in scenario walk"
    said = f"forward velocity error {theirs:+.4f} m/s in PyPI's MuJoCo, {ours:+.4f} m/s in scenario walk"
    if robot:
        off, height = walk(path, pathlib.Path(robot).resolve())
        assert abs(off) < ELSEWHERE_M_S and height > 0.2, f"{robot}: velocity error {off} m/s, base at {height} m"
        said += f", {off:+.4f} m/s on {robot}"
    return said


with tempfile.TemporaryDirectory() as folder:
    for policy, _, robot in (name.partition("@") for name in POLICIES):
        path = pathlib.Path(folder) / "policy.onnx"
        run(PROGRAMS / "policy", "export", policy, "--format", "onnx", "--out", path)
        about = check_graph(path)
        file = ROOT / "policies" / f"{policy}-seed0.safetensors"
        with safe_open(str(file if file.exists() else policy), framework="numpy") as opened:
            stored = json.loads(opened.metadata()["supple"])
            tensors = {name: opened.get_tensor(name) for name in opened.keys()}
        # The file may be of an older format, which has other words for these.
        for said in (stored, about):
            del said["format"], said["observation"], said["provenance"]["config"]
        assert stored == about
        worst = check_numbers(path, policy, tensors)
        said = check_walk(path, policy, robot)
        print(f"{policy}: onnxruntime {onnxruntime.__version__} within {worst:.1e} rad; {said}")
