"""The environments: the same bits as in Rust, and what Gymnasium expects."""

import copy
import os
import pickle
import signal
import subprocess
import sys
import threading
import time

import gymnasium
import numpy as np
import pytest
import supple
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import (
    DictInfoToList,
    FlattenObservation,
    NormalizeObservation,
    RecordEpisodeStatistics,
)

COMPLETE = supple.Curriculum(1.0, True)


def random_actions(steps, num_envs, seed=0):
    return (0.3 * np.random.default_rng(seed).standard_normal((steps, num_envs, 12))).astype(np.float32)


def play(env, actions):
    """Observations, rewards, terminations and truncations of all steps."""
    return [np.stack(column) for column in zip(*(env.step(action)[:4] for action in actions))]


@pytest.mark.parametrize("threads", [1, 3])
def test_the_same_seed_gives_the_bits_of_trainings_rollout_while_the_curriculum_goes_on(programs, tmp_path, threads):
    batches = 4
    programs.run("examples/rollout", "fast", 3, batches, tmp_path)

    def read(name, kind, *shape):
        # By batch, environment and step there; by step and environment here.
        found = np.fromfile(tmp_path / name, dtype=kind).reshape(batches, 64, 128, *shape)
        return found.swapaxes(1, 2).reshape(batches * 128, 64, *shape)

    actions, ends = read("actions", "<f4", 12), read("ends", "u1")
    curricula = np.fromfile(tmp_path / "curriculum", dtype="<f8").reshape(batches, 2)
    env = supple.make_vec("fast", num_envs=64, seed=3, threads=threads)
    seen, _ = env.reset()
    for step, (action, observation, reward) in enumerate(
        zip(actions, read("observations", "<f4", 83), read("rewards", "<f4"))
    ):
        assert np.array_equal(seen, observation), f"step {step}"
        assert tuple(env.curriculum)[:2] == tuple(curricula[step // 128])
        seen, rewards, terminations, truncations, info = env.step(action)
        assert np.array_equal(rewards.astype(np.float32), reward), f"step {step}"
        assert np.array_equal(terminations, ends[step] == 1) and np.array_equal(truncations, ends[step] > 1)
    # The curriculum did go on, and there were both kinds of ends.
    assert curricula[0, 0] < curricula[-1, 0] and {1, 2} <= set(ends.flat)


def assert_no_more_than_advice(warnings):
    """Observations have no limits, and an action is an action of `train`, not of -1 to 1."""
    messages = [str(warning.message) for warning in warnings]
    assert not [message for message in messages if "infinity" not in message and "normalized" not in message]


def test_gymnasiums_checker_passes(recwarn):
    check_env(gymnasium.make("supple/Locomotion-v0", disable_env_checker=True).unwrapped)
    assert_no_more_than_advice(recwarn)


def test_stable_baselines3s_checker_passes(recwarn):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(supple.make())
    assert_no_more_than_advice(recwarn)


def test_stable_baselines3_takes_the_environments():
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecMonitor

    import supple.sb3

    env = supple.sb3.SB3VecEnv(supple.make_vec(num_envs=4, seed=1, threads=1))
    env.seed(5)
    reference = supple.make_vec(num_envs=4, seed=5, threads=1)
    assert np.array_equal(env.reset(), reference.reset()[0])
    for action in random_actions(150, 4):
        seen, rewards, dones, infos = env.step(action)
        expected = reference.step(action)
        assert np.array_equal(seen, expected[0]) and np.array_equal(rewards, expected[1].astype(np.float32))
        for k in np.flatnonzero(dones):
            assert np.array_equal(infos[k]["terminal_observation"], expected[4]["final_obs"][k])
            assert infos[k]["TimeLimit.truncated"] == expected[3][k]
    env.set_options({"a": 1})
    with pytest.raises(ValueError, match="expected none"):
        env.reset()
    for other in (supple.make(), supple.make_vec(num_envs=1, autoreset_mode=AutoresetMode.NEXT_STEP)):
        with pytest.raises(TypeError, match="expected what supple.make_vec makes"):
            supple.sb3.SB3VecEnv(other)
    PPO("MlpPolicy", VecMonitor(env), n_steps=16, batch_size=32, n_epochs=1, device="cpu").learn(128)


def test_spaces_have_the_sizes_names_and_bounds_of_the_configuration():
    env = supple.make_vec("compliant", num_envs=3, threads=1)
    assert env.observation_space.shape == (3, 83) and env.action_space.shape == (3, 12)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert env.observation_names[0] == "previous base height [m]" and len(env.observation_names) == 83
    assert env.action_names[:3] == ["FR_hip", "FR_thigh", "FR_calf"]
    # Hip: (0.863 rad + 23.7 N·m / 40 N·m/rad − 0) / 0.3 rad.
    assert env.single_action_space.high[0] == pytest.approx((0.863 + 23.7 / 40) / 0.3)
    assert env.single_action_space.low[0] == -env.single_action_space.high[0]
    seen, _ = env.reset()
    # (height − 0.31) · 10 of a robot that stands on its nominal pose.
    assert abs(seen[0, 0]) < 0.2 and env.observation_space.contains(seen)
    assert env.observation_offset[0] == 0.31 and env.observation_scale[0] == 10.0
    assert env.action_offset[:3].tolist() == [0.0, 0.72, -1.44] and set(env.action_scale) == {0.3}


def test_an_episode_that_ends_goes_on_with_the_next_one_and_its_last_observation_is_told():
    env = supple.make_vec(num_envs=2, seed=4, threads=1, curriculum=COMPLETE, stagger=False)
    single = supple.make(seed=4, curriculum=COMPLETE)
    env.reset()
    alone, _ = single.reset()
    ends, rewards_of = 0, []
    for action in random_actions(400, 2):
        seen, rewards, terminations, truncations, info = env.step(action)
        alone, reward, terminated, truncated, about = single.step(action[0])
        rewards_of.append(reward)
        assert (reward, terminated, truncated) == (rewards[0], terminations[0], truncations[0])
        assert about["stage"] == info["stage"][0]
        assert about["reward_terms"] == {k: v[0] for k, v in info["reward_terms"].items() if k[0] != "_"}
        if terminated or truncated:
            ends += 1
            assert np.array_equal(info["final_obs"][0], alone)
            final = info["final_info"]
            assert final["episode"]["r"][0] == pytest.approx(sum(rewards_of)) and final["episode"]["l"][0] == len(rewards_of)
            assert final["stage"][0] == about["stage"] and final["fall"][0] == about["fall"]
            assert final["pushed"][0] == about["pushed"] and np.array_equal(final["command"][0], about["command"])
            assert final["reward_terms"]["pose"][0] == about["reward_terms"]["pose"]
            assert not np.array_equal(final["command"][0], info["command"][0])
            rewards_of = []
            with pytest.raises(RuntimeError, match=r"call reset\(\)"):
                single.step(action[0])
            alone, start = single.reset()
            assert np.array_equal(start["command"], info["command"][0])
        else:
            assert "final_obs" not in info or info["final_obs"][0] is None
        assert np.array_equal(seen[0], alone)
    assert ends > 1


def test_a_robot_is_pushed_after_two_seconds_if_the_curriculum_says_so():
    policy = supple.Policy.load("compliant")
    for curriculum, length in [(supple.Curriculum(0.0, False), 120), (supple.Curriculum(0.0, True), 240)]:
        env = supple.make(seed=7, curriculum=curriculum)
        seen, _ = env.reset()
        stages, truncated = [], False
        while not truncated:
            seen, _, terminated, truncated, info = env.step(policy(seen))
            stages.append(info["stage"])
            assert not terminated, "it stays on its feet"
        assert len(stages) == length and info["pushed"] is curriculum.pushes
        assert np.array_equal(info["command"], np.zeros(3))
        assert [supple.STAGES[k] for k in sorted(set(stages))] == list(supple.STAGES[: 3 if curriculum.pushes else 1])


def test_rewards_are_made_of_their_terms():
    env = supple.make_vec("compliant", num_envs=8, threads=1, curriculum=supple.Curriculum(1.0, False))
    env.reset()
    for action in random_actions(30, 8):
        _, rewards, _, _, info = env.step(action)
        term = info["reward_terms"]
        positive = 0.8 * term["linear_velocity"] + 0.5 * term["angular_velocity"] - 0.7 * term["foot_height"]
        negative = (
            -0.015 * term["energy"] - 0.0015 * term["torque"] - 2.0 * term["pose"] - 0.1 * term["foot_clearance"]
        )
        assert np.allclose(rewards, np.maximum(positive, 0.0) * np.exp(0.45 * negative), rtol=1e-12)


def test_a_seed_begins_everything_anew_and_no_seed_goes_on():
    env, actions = supple.make_vec(num_envs=5, seed=1, threads=2), random_actions(80, 5)
    first, _ = env.reset()
    played = play(env, actions)
    other, _ = env.reset()
    assert not np.array_equal(first, other)
    again, _ = env.reset(seed=1)
    assert np.array_equal(first, again)
    assert all(np.array_equal(a, b) for a, b in zip(played, play(env, actions)))
    assert not np.array_equal(first, env.reset(seed=2)[0])
    assert np.array_equal(supple.make_vec(num_envs=5, seed=2).reset()[0], env.reset(seed=2)[0])


def test_a_curriculum_that_is_set_is_that_of_make_vec_from_the_first_episode_on_and_for_good(tmp_path):
    # A batch is 16 steps, and each makes it harder.
    (tmp_path / "mine.yaml").write_text("base: fast\ncommand: {fraction_gate: 0.0}\nppo: {batch_size: 512}\n")

    def made(**curriculum):
        return supple.make_vec(tmp_path / "mine.yaml", num_envs=32, seed=1, threads=1, **curriculum)

    env, expected, grows = made(), made(curriculum=(1.0, True)), made()
    assert env.curriculum == supple.Curriculum(0.5, False)
    env.curriculum = COMPLETE
    assert all(np.array_equal(a, b) for a, b in zip(env.reset()[0], expected.reset()[0]))
    grows.reset()
    env.curriculum = expected.curriculum = supple.Curriculum(0.25, False)
    actions = np.zeros((150, 32, 12))
    assert all(np.array_equal(a, b) for a, b in zip(play(env, actions), play(expected, actions)))
    play(grows, actions)
    assert grows.curriculum.command_fraction > 0.5
    env.reset(seed=3)
    assert env.curriculum == supple.Curriculum(0.25, False)
    with pytest.raises(ValueError, match="command_fraction is 2, expected 0 to 1"):
        env.curriculum = supple.Curriculum(2.0, True)


def test_first_episodes_are_cut_at_random_unless_they_are_not_to_be_staggered():
    for stagger in (True, False):
        env = supple.make_vec(num_envs=16, seed=1, threads=1, stagger=stagger)
        for _ in range(2):
            env.reset(seed=2)
            truncations = play(env, np.zeros((120, 16, 12)))[3]
            first = truncations.argmax(axis=0)
            assert (len(set(first)) > 4 and first.max() < 120) if stagger else set(first) == {119}


def test_the_command_in_the_info_is_the_one_in_the_observation():
    env = supple.make_vec("fast", num_envs=8, seed=3, threads=1, curriculum=supple.Curriculum(1.0, True, 1.0))
    places = [k for k, name in enumerate(env.observation_names) if name.startswith("commanded") and "compl" not in name]

    def asked(seen):
        left, forward, yaw = (seen[..., places] / env.observation_scale[places] + env.observation_offset[places]).T
        return np.stack([forward, left, yaw], axis=-1)

    (seen, info), ends = env.reset(), 0
    drawn = info["command"]
    assert len(places) == 3 and np.allclose(asked(seen), drawn, atol=1e-6)
    for action in random_actions(150, 8):
        seen, *_, info = env.step(action)
        assert np.allclose(asked(seen), info["command"], atol=1e-6)
        for k in np.flatnonzero(info.get("_final_info", [])):
            ends += 1
            assert np.allclose(asked(info["final_obs"][k]), info["final_info"]["command"][k], atol=1e-6)
    assert ends > 0 and not np.allclose(drawn, info["command"])


def test_what_only_the_critic_observes_is_in_the_info():
    complete = supple.Curriculum(1.0, True, 1.0)
    env = supple.make_vec("real", num_envs=8, seed=3, threads=1, curriculum=complete, stagger=False)
    names = env.critic_observation_names
    assert len(names) == 42 and not any(name in env.observation_names for name in names)
    push, mass = names.index("push left [m/s]"), names.index("additional trunk mass [kg]")
    (_, info), pushed, ends = env.reset(), 0, 0
    masses = info["critic_observation"][:, mass]
    assert info["critic_observation"].shape == (8, 42) and (np.abs(masses) <= 1).all() and len(set(masses)) == 8
    for _ in range(250):
        before = info["critic_observation"]
        _, *_, info = env.step(np.zeros((8, 12), dtype=np.float32))
        pushed += np.count_nonzero(info["critic_observation"][:, push])
        for k in np.flatnonzero(info.get("_final_info", [])):
            ends += 1
            # An episode keeps its mass to its end; the next one has another.
            last = info["final_info"]["critic_observation"][k]
            assert last[mass] == before[k, mass] != info["critic_observation"][k, mass]
    assert pushed > 0 and ends >= 8
    single = supple.make("real", seed=3)
    assert single.reset()[1]["critic_observation"].shape == (42,)
    assert single.step(np.zeros(12, dtype=np.float32))[-1]["critic_observation"].shape == (42,)
    plain = supple.make_vec("fast", num_envs=1)
    assert plain.critic_observation_names == [] and "critic_observation" not in plain.reset()[1]


def test_the_next_episode_begins_when_the_autoreset_mode_says():
    actions = random_actions(150, 4)
    same, after, never = (
        supple.make_vec(num_envs=4, seed=5, threads=2, curriculum=COMPLETE, autoreset_mode=mode)
        for mode in (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED)
    )
    # Observations, rewards and flags with resets in the same step, without the steps that reset in the others.
    expected, found = [[] for _ in range(4)], [[[] for _ in range(4)] for _ in range(2)]
    seen, _ = same.reset()
    for action in actions:
        before = seen
        seen, rewards, terminations, truncations, info = same.step(before[:, :12])
        last = info.get("final_obs", [None] * 4)
        for k in range(4):
            end = seen[k] if last[k] is None else last[k]
            expected[k].append((before[k], end, rewards[k], terminations[k], truncations[k]))
    for env, found_of in zip((after, never), found):
        assert env.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP
        seen, _ = env.reset()
        over, ends = np.zeros(4, dtype=bool), 0
        for _ in actions:
            if env is never and over.any():
                with pytest.raises(RuntimeError, match=r"call reset\(\)"):
                    env.step(np.zeros((4, 12)))
                others = seen[~over]
                seen, info = env.reset(options={"reset_mask": over})
                assert np.array_equal(seen[~over], others) and info["command"].shape == (4, 3)
                over = np.zeros(4, dtype=bool)
            before = seen
            seen, rewards, terminations, truncations, info = env.step(before[:, :12])
            assert "final_obs" not in info and ("pushed" in info) == (terminations | truncations).any()
            for k in range(4):
                if over[k]:
                    assert rewards[k] == 0.0 and not terminations[k] and not truncations[k]
                else:
                    found_of[k].append((before[k], seen[k], rewards[k], terminations[k], truncations[k]))
            over = terminations | truncations
            ends += over.sum()
        assert ends > 4
        for of_env, of_same in zip(found_of, expected):
            for ours, theirs in zip(of_env, of_same):
                assert all(np.array_equal(a, b) for a, b in zip(ours, theirs))
    with pytest.raises(ValueError, match="reset_mask: expected 4 truth values"):
        never.reset(options={"reset_mask": np.zeros(4, dtype=bool)})
    with pytest.raises(ValueError, match="nonsense"):
        supple.make_vec(num_envs=1, autoreset_mode="nonsense")


@pytest.mark.parametrize("mode", AutoresetMode)
def test_gymnasiums_vector_environments_of_single_ones_come_to_the_same(mode):
    ours = supple.make_vec(num_envs=1, seed=5, threads=1, stagger=False, curriculum=COMPLETE, autoreset_mode=mode)
    theirs = gymnasium.vector.SyncVectorEnv([lambda: supple.make(seed=5, curriculum=COMPLETE)], autoreset_mode=mode)
    assert np.array_equal(ours.reset()[0], theirs.reset()[0])
    ends = 0
    for action in random_actions(500, 1):
        (*found, info), (*expected, about) = ours.step(action), theirs.step(action)
        assert all(np.array_equal(a, b) for a, b in zip(found, expected))
        # A step that only resets tells nothing but the command.
        assert about.keys() <= info.keys()
        if found[2][0] or found[3][0]:
            ends += 1
            final, expected_final = info.get("final_info", info), about.get("final_info", about)
            assert expected_final.keys() <= final.keys()
            assert np.array_equal(final["command"], expected_final["command"])
            if mode is AutoresetMode.DISABLED:
                for env in (ours, theirs):
                    env.reset(options={"reset_mask": np.array([True])})
    assert ends > 1


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_gymnasiums_wrappers_of_observations_take_what_does_not_reset_in_the_same_step(mode):
    env = gymnasium.make_vec("supple/Locomotion-v0", num_envs=3, seed=1, threads=1, autoreset_mode=mode)
    statistics = RecordEpisodeStatistics(env)
    env = FlattenObservation(statistics)
    if mode is AutoresetMode.NEXT_STEP:
        env = NormalizeObservation(env)
    env.reset()
    for action in random_actions(150, 3):
        _, _, terminations, truncations, info = env.step(action)
        over = terminations | truncations
        assert ("episode" in info) == over.any()
        if mode is AutoresetMode.DISABLED and over.any():
            env.reset(options={"reset_mask": over})
    assert statistics.episode_count > 2
    env.close()


def test_without_a_seed_every_environment_has_its_own():
    env = gymnasium.make_vec("supple/Locomotion-v0", num_envs=2, vectorization_mode="sync")
    seen, _ = env.reset()
    assert not np.array_equal(seen[0], seen[1])
    first, second = (supple.make_vec(num_envs=1) for _ in range(2))
    drawn, _ = first.reset()
    assert not np.array_equal(drawn, second.reset()[0])
    assert np.array_equal(drawn, supple.make_vec(num_envs=1, seed=first.np_random_seed).reset()[0])


def test_gymnasiums_vector_wrappers_work():
    env = gymnasium.make_vec("supple/Locomotion-v0", num_envs=3, config="fast", seed=1, threads=1)
    env = DictInfoToList(RecordEpisodeStatistics(env))
    env.reset()
    ended = [info for action in random_actions(150, 3) for info in env.step(action)[4] if "final_info" in info]
    assert ended and all(info["final_info"]["episode"]["l"] > 0 for info in ended)
    env.close()


def test_what_is_given_wrongly_is_refused_in_words():
    env, single = supple.make_vec(num_envs=2, threads=1), supple.make()
    broken = np.zeros((2, 12))
    broken[1, 2] = np.nan
    for attempt, words in [
        (lambda: env.step(np.zeros((3, 12))), r"actions: expected numbers of shape \[2, 12\], found shape \[3, 12\]"),
        (lambda: env.step(np.zeros(12)), r"actions: .*\[2, 12\], found shape \[12\]"),
        (lambda: env.step(None), r"actions: .*\[2, 12\], found shape \[\]"),
        (lambda: env.step({}), r"actions: .*\[2, 12\], found dict"),
        (lambda: env.step(broken), r"actions: expected finite numbers, found nan at \[1, 2\]"),
        (lambda: single.step(np.zeros(5)), r"action: .*\[12\], found shape \[5\]"),
        (lambda: supple.make_vec("nowhere.yaml"), "there is no config nowhere.yaml.*compliant, baseline, fast"),
        (lambda: supple.make_vec(num_envs=0), "num_envs is 0, expected a whole number from 1"),
        (lambda: supple.make_vec(num_envs=-1), "num_envs is -1, expected"),
        (lambda: supple.make_vec(num_envs=10**13), "num_envs is 10000000000000, expected"),
        (lambda: supple.make_vec(num_envs=1, seed=-1), "seed is -1, expected"),
        (lambda: supple.make_vec(num_envs=1, seed=1.5), "seed is 1.5, expected"),
        (lambda: supple.make_vec(num_envs=1, threads=0), "threads is 0, expected"),
        (lambda: env.reset(seed=-1), "seed is -1, expected"),
        (lambda: env.reset(options={"reset_mask": np.array([True, False])}), "reset_mask"),
        (lambda: env.reset(options={1: 2, "a": 3}), r"found \[1, 'a'\]"),
        (lambda: single.reset(options={"a": 3}), r"expected none, found \['a'\]"),
        (lambda: setattr(env, "curriculum", (2.0, True)), "command_fraction is 2, expected 0 to 1"),
    ]:
        with pytest.raises(ValueError, match=words):
            attempt()
    env.close()
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.reset()


def test_a_configuration_of_ones_own_is_taken(tmp_path):
    (tmp_path / "mine.yaml").write_text("base: fast\nepisode: {walking_s: 0.5}\ncommand: {initial_fraction: 0.25}\n")
    env = supple.make(tmp_path / "mine.yaml")
    assert env.curriculum.command_fraction == 0.25
    env.reset()
    assert [env.step(np.zeros(12))[3] for _ in range(30)] == [False] * 29 + [True]


def test_a_fault_of_the_physics_truncates_its_episode_says_why_and_leaves_the_others_alone(tmp_path):
    # Ten steps a second without damping, and joints that are torn from one end to the other.
    (tmp_path / "bad.yaml").write_text(
        "base: fast\nsimulation: {physics_rate_hz: 10, policy_rate_hz: 10, kd_n_m_s_per_rad: 0.0}\n"
    )
    env, rng = supple.make_vec(tmp_path / "bad.yaml", num_envs=32, threads=2), np.random.default_rng(0)
    env.reset()
    faults = 0
    for _ in range(20):
        seen, rewards, terminations, truncations, info = env.step(rng.choice([-50.0, 50.0], size=(32, 12)))
        told = info.get("final_info", {})
        for k in np.flatnonzero(told.get("_fault", [])):
            faults += 1
            assert truncations[k] and not terminations[k] and rewards[k] == 0.0
            assert "buffer" in told["fault"][k] or "unstable" in told["fault"][k]
            assert np.isfinite(info["final_obs"][k]).all()
        assert np.isfinite(seen).all()
    assert faults > 0


def test_copies_of_environments_are_refused():
    env = supple.make_vec(num_envs=1, threads=1)
    for attempt in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match="call supple.make_vec in the process"):
            attempt(env)


def test_environments_do_not_outlive_a_fork():
    program = """
import os, supple, numpy
env = supple.make_vec(num_envs=8, threads=2)
env.reset()
env.step(numpy.zeros((8, 12)))
child = os.fork()
if child == 0:
    try:
        env.step(numpy.zeros((8, 12)))
    except RuntimeError as error:
        assert "call supple.make_vec after the fork" in str(error)
        supple.make_vec(num_envs=8, threads=2).step(numpy.zeros((8, 12)))
        env.close()
        os._exit(17)
    os._exit(1)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 17
env.step(numpy.zeros((8, 12)))
"""
    subprocess.run([sys.executable, "-W", "ignore", "-c", program], check=True, timeout=60)


def test_the_interpreter_goes_on_while_environments_step_and_a_second_thread_is_refused():
    env, refused, stop = supple.make_vec(num_envs=512, threads=1), [], threading.Event()
    env.reset()

    def step():
        while not stop.is_set():
            try:
                env.step(np.zeros((512, 12)))
            except RuntimeError as error:
                refused.append(str(error))
                stop.set()

    threads = [threading.Thread(target=step) for _ in range(2)]
    [thread.start() for thread in threads]
    stop.wait(timeout=30)
    stop.set()
    [thread.join() for thread in threads]
    assert refused and "another thread" in refused[0]


@pytest.mark.parametrize("where", ["the process", "a fork of it"])
def test_environments_are_closed_while_another_thread_steps_them(where):
    program = """
import os, sys, supple, numpy, threading, time
env = supple.make_vec(num_envs=512, threads=2)
told = []
def step():
    try:
        while True: env.step(numpy.zeros((512, 12)))
    except RuntimeError as error:
        told.append(str(error))
thread = threading.Thread(target=step)
thread.start()
time.sleep(0.2)
if sys.argv[1] == "a fork of it":
    for _ in range(5):
        child = os.fork()
        if child == 0:
            env.close()
            os._exit(0)
        assert os.waitpid(child, 0)[1] == 0
env.close()
thread.join()
step()
assert "closed" in told[-1], told
"""
    subprocess.run([sys.executable, "-W", "ignore", "-c", program, where], check=True, timeout=60)


def test_a_panic_becomes_an_exception():
    with pytest.raises(RuntimeError, match="a defect of supple, please report it: asked for by a test"):
        supple._supple._panic()


@pytest.mark.parametrize(
    "work",
    [
        "env = supple.make_vec(num_envs=256)\nwhile True: env.step(numpy.zeros((256, 12)))",
        "while True: supple.make_vec(num_envs=1000)",
        "supple.run_scenario('walk', duration_s=3600.0)",
        "supple.run_scenario('walk', lambda seen: numpy.zeros(12), duration_s=3600.0)",
        "supple.evaluate('compliant', protocol='full')",
        "supple.evaluate(lambda seen: numpy.zeros(12), protocol='full')",
    ],
)
def test_ctrl_c_ends_whatever_is_under_way(work):
    # What is started in the background of a script would ignore it.
    listen = "signal.signal(signal.SIGINT, signal.default_int_handler)"
    program = f"import numpy, signal, supple\n{listen}\nprint('begun', flush=True)\n{work}"
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stdout is not None and child.stdout.readline() == "begun\n"
    time.sleep(1.0)
    os.kill(child.pid, signal.SIGINT)
    _, errors = child.communicate(timeout=20)
    assert child.returncode == -signal.SIGINT and "KeyboardInterrupt" in errors


def test_a_render_mode_is_refused_with_what_there_is_instead():
    for create in (supple.make, supple.make_vec):
        with pytest.raises(ValueError, match="render_mode is 'human', expected None.*record="):
            create(render_mode="human")
    with pytest.raises(ValueError, match="render_mode is 'rgb_array'"):
        gymnasium.make("supple/Locomotion-v0", render_mode="rgb_array")
    for env in (supple.make(), supple.make_vec(num_envs=1, threads=1)):
        with pytest.raises(NotImplementedError, match="draw nothing"):
            env.render()


def test_a_list_of_seeds_has_one_for_each_environment():
    env = supple.make_vec(num_envs=3, seed=0, threads=1)
    alone = {seed: env.reset(seed=seed)[0] for seed in (5, 6)}
    mixed = env.reset(seed=[5, 6, np.int64(5)])[0]
    for k, seed in enumerate((5, 6, 5)):
        assert np.array_equal(mixed[k], alone[seed][k])
    for wrong in ([5, 6], [5, 6, -1], "abc", [5, 6, 7.5]):
        with pytest.raises(ValueError, match="seed"):
            env.reset(seed=wrong)


def test_more_environments_than_memory_are_refused():
    with pytest.raises(ValueError, match="num_envs is 1000000.*GiB.*lower num_envs"):
        supple.make_vec(num_envs=1_000_000)
