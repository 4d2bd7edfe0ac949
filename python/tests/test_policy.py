"""Policies, scenarios and experiments: the numbers of the programs."""

import importlib.metadata
import json
import pickle
import re
import subprocess
import sys
import threading

import numpy as np
import pytest
import supple

POLICY = "policies/compliant-seed0.safetensors"


def test_a_policy_acts_alike_alone_and_in_a_batch():
    policy, env = supple.Policy.load("compliant"), supple.make_vec(num_envs=70, threads=1)
    seen, _ = env.reset()
    batch = policy(seen)
    assert batch.shape == (70, 12) and batch.dtype == np.float32
    assert all(np.array_equal(policy(row), action) for row, action in zip(seen, batch))
    assert policy.observation_names == env.observation_names and policy.action_names == env.action_names


def test_a_policy_gives_the_joint_targets_that_are_stored_with_it(programs):
    safetensors = pytest.importorskip("safetensors.numpy")
    stored = safetensors.load_file(programs.root / POLICY)
    scaled = (stored["golden.observation"] - stored["normaliser.offset"]) * stored["normaliser.scale"]
    targets = np.tile([0.0, 0.72, -1.44], 4) + 0.3 * supple.Policy.load(programs.root / POLICY)(scaled)
    assert np.abs(targets - stored["golden.joint_target"]).max() < 1e-5


def test_a_walking_policy_walks_in_the_environment():
    env = supple.make_vec(num_envs=16, seed=2, threads=2, curriculum=supple.Curriculum(1.0, True))
    policy, (seen, _) = supple.Policy.load("compliant"), env.reset()
    tracking, falls = [], 0
    for _ in range(360):
        seen, _, terminations, _, info = env.step(policy(seen))
        tracking.append(info["reward_terms"]["linear_velocity"].mean())
        falls += terminations.sum()
    assert np.mean(tracking[60:]) > 0.7 and falls <= 2


@pytest.mark.parametrize("sensing", ["true", "estimated"])
def test_a_scenario_has_the_numbers_of_the_program(programs, sensing):
    printed = json.loads(
        programs.run(
            "scenario", "push", "--seed", 3, "--policy", "compliant", "--compare", "none", "--push-m-s", 0.75,
            "--duration-s", 6, "--sensing", sensing, "--json", "--no-record",
        )
    )
    run = supple.run_scenario("push", "compliant", seed=3, sensing=sensing, push_m_s=0.75, duration_s=6.0)
    assert run.metrics == printed["runs"][0]["metrics"] and run.units == printed["units"]
    assert [event._asdict() for event in run.events] == printed["runs"][0]["events"]
    assert run.trace["time_s"].shape == (360,) and run.trace["foot_forces"].shape == (360, 4, 3)
    assert ("estimated_velocity" in run.trace) == (sensing == "estimated")
    assert not run.fell and run.fault is None


def test_a_function_that_answers_as_a_policy_does_comes_to_the_same():
    policy = supple.Policy.load("compliant")
    for name, parameters in [("push", {}), ("box", {"duration_s": 4.0})]:
        of_policy = supple.run_scenario(name, policy, seed=1, **parameters)
        of_function = supple.run_scenario(name, lambda seen: policy(seen), seed=1, config="fast", **parameters)
        assert of_policy.metrics == of_function.metrics and of_policy.trace.keys() == of_function.trace.keys()
        assert all(np.array_equal(values, of_function.trace[key]) for key, values in of_policy.trace.items())


def test_a_function_sees_what_it_would_see_in_training():
    seen = []

    def stand(observation):
        seen.append(observation)
        return np.zeros(12)

    run = supple.run_scenario("walk", stand, duration_s=1.0)
    assert len(seen) == 60 and all(row.shape == (83,) and row.dtype == np.float32 for row in seen)
    # The command, forward 0.5 m/s: left, forward, yaw.
    assert np.array_equal(seen[0][-3:], np.array([0.0, 0.5, 0.0], dtype=np.float32))
    assert np.allclose(run.trace["joint_targets"], np.tile([0.0, 0.72, -1.44], 4))


@pytest.mark.filterwarnings("ignore:.*would come after the end")
def test_every_scenario_plays_a_function():
    assert {"walk", "push", "wall"} <= supple.scenarios().keys() and "push_m_s" in supple.scenarios()["push"]
    for name in supple.scenarios():
        run = supple.run_scenario(name, lambda seen: np.zeros(12), duration_s=0.5)
        assert len(run.trace["time_s"]) == 30 and set(run.units) == set(run.metrics)


def test_what_a_function_raises_comes_out_where_it_was_asked():
    class Own(Exception):
        pass

    def fail(_):
        raise Own("after all")

    for attempt in (
        lambda: supple.run_scenario("walk", fail),
        lambda: supple.evaluate(fail, ["table4"]),
    ):
        with pytest.raises(Own, match="after all"):
            attempt()
    answers = {
        "finite numbers, found nan": np.full(12, np.nan),
        r"\[12\] or \[1, 12\], found shape \[3\]": np.zeros(3),
        r"found shape \[3, 4\]": np.zeros((3, 4)),
        r"found shape \[12, 1\]": np.zeros((12, 1)),
        r"found shape \[\]": None,
        "found str": "walk",
    }
    for words, answer in answers.items():
        with pytest.raises(ValueError, match=f"the policy's answer: expected .*{words}"):
            supple.run_scenario("walk", lambda seen: answer)
    assert supple.run_scenario("walk", lambda seen: np.zeros((1, 12)), duration_s=0.5).trace["time_s"].size == 30


def test_a_function_is_called_on_the_thread_that_asks():
    threads = set()

    def note(_):
        threads.add(threading.get_ident())
        return np.zeros(12)

    supple.run_scenario("walk", note, duration_s=0.5)
    supple.evaluate(note, ["table4"], threads=2)
    assert threads == {threading.get_ident()}


def test_sets_are_compared_with_the_numbers_of_the_report(programs, tmp_path):
    paths = {"a": POLICY, "b": "policies/baseline-seed0.safetensors"}
    found = supple.evaluate(experiments="table4", **{key: programs.root / path for key, path in paths.items()}, out=tmp_path)
    programs.run("evaluate", "table4", "--quick", "--a", paths["a"], "--b", paths["b"], "--out", tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert found.summary["experiments"] == summary["experiments"] and len(list((tmp_path / "results/table4").glob("*.json"))) == 2
    claims = summary["experiments"][0]["claims"]
    assert found.claims["claim"].tolist() == [claim["claim"] for claim in claims]
    means = [claim["ours"]["sets"]["baseline-seed0"]["mean"] for claim in claims]
    assert np.array_equal(found.claims["baseline-seed0_mean"], np.array(means, dtype=float), equal_nan=True)
    # One seed of each set: no interval.
    assert set(found.claims["pairs"]) == {1} and np.isnan(found.claims["low"]).all()
    power = (found.numbers["quantity"] == "power_before_w") & (found.numbers["set"] == "compliant-seed0")
    assert power.any() and found.numbers["seed"][power].tolist() == [0] * power.sum() and (found.numbers["value"][power] > 5).all()


def test_sets_that_cannot_be_compared_are_refused(tmp_path):
    for arguments, words in {
        (): "one policy, or two sets",
        (("a", POLICY),): "one policy, or two sets",
        (("policy", POLICY), ("a", POLICY), ("b", POLICY)): "sets of policies",
        (("a", POLICY), ("b", POLICY)): "one name",
        (("a", POLICY), ("b", "baseline"), ("seed", 1)): "seeds of their training",
        (("a", tmp_path / "runs/mine"), ("b", "baseline")): "runs/mine",
    }.items():
        with pytest.raises(ValueError, match=words):
            supple.evaluate(**dict(arguments))


def test_learning_curves_are_arrays_by_seed(tmp_path):
    rows = [{"samples": 8192 * k, "step_reward": 0.1 * k, "fall_rate": None if k == 1 else 0.5, "time": {"elapsed_s": 2.0 * k}} for k in (1, 2)]
    for seed, count in ((0, 2), (10, 1)):
        folder = tmp_path / f"mine-seed{seed}"
        folder.mkdir()
        # The last line is cut off, as by a run that is at work.
        (folder / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows[:count]) + '{"samples": 3')
    (tmp_path / "mine-seed0-old").mkdir()
    (tmp_path / "mine-seed0-old/metrics.jsonl").write_text(json.dumps(rows[0]) + "\n")
    curves = supple.learning_curves(tmp_path / "mine")
    assert list(curves) == [0, 10] and list(supple.learning_curves(tmp_path / "mine-seed10")) == [10]
    assert curves[0]["samples"].tolist() == [8192, 16384] and curves[0]["time.elapsed_s"].tolist() == [2.0, 4.0]
    assert np.array_equal(curves[0]["fall_rate"], [np.nan, 0.5], equal_nan=True) and np.isnan(curves[10]["fall_rate"]).all()
    with pytest.raises(FileNotFoundError, match="none in .*other-seed"):
        supple.learning_curves(tmp_path / "other")


def test_experiments_have_the_numbers_that_the_program_keeps(programs, tmp_path):
    programs.run(
        "evaluate", "table4", "--quick", "--a", POLICY, "--b", "policies/baseline-seed0.safetensors", "--out", tmp_path
    )
    policy = supple.Policy.load(programs.root / POLICY)
    [kept] = [
        stored
        for file in (tmp_path / "results/table4").glob("*.json")
        if (stored := json.loads(file.read_text()))["sha256"] == policy.sha256
    ]
    measured = supple.evaluate(policy, ["table4"], threads=2)["table4"]
    values = np.array([[sample["values"] for sample in trials] for trials in kept["samples"]], dtype=float)
    assert np.array_equal(measured.values, values, equal_nan=True)
    assert [[sample["end"] for sample in trials] for trials in kept["samples"]] == measured.ends.tolist()
    assert len(measured.conditions) == values.shape[0] and len(measured.quantities) == values.shape[2]
    # The same by a function, of which nothing is kept.
    of_function = supple.evaluate(lambda seen: policy(seen), "table4", config="fast")["table4"]
    assert np.array_equal(of_function.values, measured.values, equal_nan=True)
    quantity = measured.quantities[0]
    assert np.allclose(measured.mean(quantity), np.nanmean(values[:, :, 0], axis=1))
    with pytest.raises(ValueError, match="no quantity"):
        measured.mean("nothing")


def test_what_there_is_not_is_refused_with_what_there_is():
    with pytest.raises(ValueError, match="there is no policy 'absent'.*compliant-seed0"):
        supple.Policy.load("absent")
    with pytest.raises(ValueError, match="no such scenario; there are: walk, push"):
        supple.run_scenario("nothing")
    with pytest.raises(ValueError, match="no parameter 'push'; it has: .*push_m_s"):
        supple.run_scenario("push", push=1.0)
    for value, words in [
        (-1.0, "is -1, expected 0.1 to 3600 s"),
        (0, "is 0, expected"),
        ("x", '.*"x", expected a number'),
        (np.nan, ".*expected a number"),
        (None, ".*expected a number"),
    ]:
        with pytest.raises(ValueError, match=f"(^|push: )duration_s:? ?{words}"):
            supple.run_scenario("push", duration_s=value)
    with pytest.raises(ValueError, match="^push_m_s is -1, expected 0 to 20 m/s"):
        supple.run_scenario("push", push_m_s=-1.0)
    for seed in (-1, 1.0):
        with pytest.raises(ValueError, match="seed is .*expected a whole number"):
            supple.run_scenario("push", seed=seed)
        with pytest.raises(ValueError, match="seed is .*expected a whole number"):
            supple.evaluate("compliant", ["table4"], seed=seed)
    with pytest.raises(ValueError, match="threads is 0, expected a whole number from 1"):
        supple.evaluate("compliant", ["table4"], threads=0)
    with pytest.raises(ValueError, match="config is 'fast', but 'compliant' has a configuration of its own"):
        supple.run_scenario("walk", "compliant", config="fast")
    with pytest.raises(ValueError, match="no experiment 'nothing'; there are: walk, push-grid"):
        supple.evaluate("compliant", ["nothing"])
    with pytest.raises(ValueError, match="sensing is 'maybe'"):
        supple.run_scenario("walk", sensing="maybe")
    with pytest.raises(TypeError, match="expected a Policy, the name of one, or a function"):
        supple.run_scenario("walk", 3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="compliant@0.02 commands a compliance, which acts around the network"):
        supple.Policy.load("compliant@0.02")(np.zeros(83))
    policy = supple.Policy.load("compliant")
    for observations, words in [
        (np.zeros((2, 5)), r"observations for compliant: .*\[83\] or \[n, 83\], found shape \[2, 5\]"),
        (None, r"found shape \[\]"),
        (np.full(83, np.nan), r"expected finite numbers, found nan at \[0\]"),
    ]:
        with pytest.raises(ValueError, match=words):
            policy(observations)
    with pytest.raises(TypeError, match="load them by name"):
        pickle.dumps(policy)


def test_parameters_may_be_numbers_of_numpy():
    parameters = {"duration_s": np.float32(0.5), "seed": np.int64(3)}
    assert supple.run_scenario("walk", **parameters).metrics == supple.run_scenario("walk", duration_s=0.5, seed=3).metrics


def test_what_comes_too_late_is_told():
    with pytest.warns(UserWarning, match="would come after the end at 1.00 s"):
        supple.run_scenario("push", duration_s=1.0)


def test_version_is_that_of_the_package():
    assert supple.__version__ == importlib.metadata.version("supple")


def test_a_recording_is_written_if_the_wheel_can(tmp_path):
    path = tmp_path / "folder/walk.rrd"
    if supple.RECORDS:
        supple.run_scenario("walk", lambda seen: np.zeros(12), duration_s=0.5, record=path)
        assert path.read_bytes()[:3] == b"RRF" and path.stat().st_size > 10_000
    else:
        with pytest.raises(RuntimeError, match="built without recordings: pip install"):
            supple.run_scenario("walk", duration_s=0.5, record=path)


def test_a_network_in_onnx_with_its_description_is_the_function_that_it_was(programs, tmp_path):
    onnx = pytest.importorskip("onnx")
    rng = np.random.default_rng(0)
    weights = [(0.1 * rng.standard_normal(shape)).astype(np.float32) for shape in [(16, 83), (16,), (12, 16), (12,)]]
    tensors = [onnx.numpy_helper.from_array(values, name) for name, values in zip("abcd", weights)]
    node, info = onnx.helper.make_node, onnx.helper.make_tensor_value_info
    graph = onnx.helper.make_graph(
        [
            node("Gemm", ["seen", "a", "b"], ["x"], transB=1),
            node("Elu", ["x"], ["y"]),
            node("Gemm", ["y", "c", "d"], ["action"], transB=1),
        ],
        "policy",
        [info("seen", onnx.TensorProto.FLOAT, [1, 83])],
        [info("action", onnx.TensorProto.FLOAT, [1, 12])],
        tensors,
    )
    onnx.save(onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)]), tmp_path / "net.onnx")
    (tmp_path / "net.yaml").write_text(supple.describe("fast", "net.onnx"))

    def network(seen):
        x = weights[0] @ seen + weights[1]
        return weights[2] @ np.where(x > 0, x, np.expm1(x)) + weights[3]

    policy = supple.Policy.load(tmp_path / "net.yaml")
    assert policy.action_offset.tolist() == [0.0, 0.72, -1.44] * 4 and set(policy.action_scale) == {0.3}
    seen = supple.make_vec(num_envs=3, threads=1).reset()[0]
    assert np.allclose(policy(seen), [network(row) for row in seen], atol=1e-5)
    described = supple.run_scenario("walk", policy, duration_s=0.5).trace["joint_targets"]
    assert np.allclose(described, supple.run_scenario("walk", network, duration_s=0.5).trace["joint_targets"], atol=1e-3)
    printed = json.loads(
        programs.run(
            "scenario", "walk", "--policy", tmp_path / "net.yaml", "--compare", "none", "--json", "--no-record",
            "--duration-s", 0.5,
        )
    )
    assert printed["runs"][0]["metrics"] == supple.run_scenario("walk", policy, duration_s=0.5).metrics


def test_a_described_network_walks_on_the_robot_that_it_was_trained_on(tmp_path):
    onnx = pytest.importorskip("onnx")
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("Gemm", ["seen", "w"], ["action"])],
        "policy",
        [onnx.helper.make_tensor_value_info("seen", onnx.TensorProto.FLOAT, [1, 83])],
        [onnx.helper.make_tensor_value_info("action", onnx.TensorProto.FLOAT, [1, 12])],
        [onnx.numpy_helper.from_array(np.zeros((83, 12), dtype=np.float32), "w")],
    )
    path = tmp_path / "net.onnx"
    onnx.save(onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)]), path)

    def torques(policy, **config):
        return supple.run_scenario("walk", policy, duration_s=0.5, **config).trace["torques"]

    for config in ("fast", "go2"):
        (tmp_path / f"{config}.yaml").write_text(supple.describe(config, path))
        assert np.array_equal(torques(tmp_path / f"{config}.yaml"), torques(lambda _: np.zeros(12), config=config))
    assert not np.array_equal(torques(tmp_path / "fast.yaml"), torques(tmp_path / "go2.yaml"))


def test_what_the_docs_show_runs(programs):
    blocks = re.findall(r"```python\n(.*?)```", (programs.root / "docs/python.md").read_text(), re.DOTALL)
    shown = {"network": supple.Policy.load("baseline")}
    for block in blocks:
        # The last one needs PyTorch: the examples do what it does.
        if "torch" not in block:
            exec(block, shown)
    assert len(blocks) == 3 and shown["observations"].shape == (64, 83) and shown["table4"].values.size


@pytest.mark.parametrize("example", ["ppo", "sb3"])
def test_the_examples_learn_and_leave_a_policy_that_plays(programs, tmp_path, example):
    for package in ("torch", "onnxscript", "stable_baselines3"):
        pytest.importorskip(package)
    subprocess.run(
        [sys.executable, f"python/examples/{example}.py", "--samples", "16384", "--out", tmp_path],
        cwd=programs.root,
        check=True,
    )
    assert len((tmp_path / "curve.csv").read_text().splitlines()) == 3
    programs.run("scenario", "walk", "--policy", tmp_path / "policy.yaml", "--duration-s", 0.5, "--no-record")
    assert supple.Policy.load(tmp_path / "policy.yaml").action_names[0] == "FR_hip"


def test_a_network_that_answers_nan_is_a_fault(programs, tmp_path):
    onnx = pytest.importorskip("onnx")
    network = onnx.load(programs.root / "tests/fixtures/onnx/rsl_rl.onnx")
    bias = next(weight for weight in network.graph.initializer if weight.name == "actor.4.bias")
    bias.raw_data = np.full(12, np.nan, np.float32).tobytes()
    onnx.save(network, tmp_path / "policy.onnx")
    description = (programs.root / "examples/policies/rsl_rl.yaml").read_text()
    (tmp_path / "policy.yaml").write_text(description)
    run = supple.run_scenario("walk", tmp_path / "policy.yaml", duration_s=1.0)
    assert run.fell is None and "is NaN" in run.fault
    with pytest.raises(ValueError, match="the action of FL_hip is NaN"):
        supple.Policy.load(tmp_path / "policy.yaml")(np.zeros(48))


def test_observations_that_overflow_the_network_are_refused():
    policy = supple.Policy.load("compliant")
    seen = np.zeros((3, 83), np.float32)
    seen[1] = 1e38
    with pytest.raises(ValueError, match="observation in row 1"):
        policy(seen)


def test_a_recording_under_the_name_of_a_video_is_refused(tmp_path):
    with pytest.raises(ValueError, match="walk.mp4.*name it .*walk.rrd"):
        supple.run_scenario("walk", duration_s=1.0, record=tmp_path / "walk.mp4")
