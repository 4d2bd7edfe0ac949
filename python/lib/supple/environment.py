"""The training environments behind Gymnasium's interfaces.

An observation is what the networks see: float32, each number (value - offset) * scale. An action is a number for each joint:
joint target = nominal pose + scale * action.
"""

import os
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from . import _supple

STAGES = ("walking", "recovery", "post-recovery")
"""What the numbers in `info["stage"]` stand for."""

Observations = NDArray[np.float32]
Flags = NDArray[np.bool_]
Info = dict[str, Any]


class Curriculum(NamedTuple):
    """What is asked of an episode."""

    command_fraction: float
    """Fraction of the command range that commands are drawn from, 0 to 1."""
    pushes: bool
    """Whether there is a push, and the stages that follow it."""
    force_fraction: float = 0.0
    """Fraction of the pulls' range and of the outer loop's gain, 0 to 1; where compliance is commanded."""


def make_vec(
    config: str | os.PathLike[str] = "fast",
    num_envs: int = 64,
    seed: int = 0,
    threads: int | None = None,
    *,
    curriculum: Curriculum | None = None,
) -> "LocomotionVectorEnv":
    """Environments of a configuration, by name or file.

    `threads` step them: all cores if it is left out. A `curriculum` stays as it is given; without one it is that of
    training, which gets harder as walking gets better.
    """
    return LocomotionVectorEnv(config, num_envs, seed, threads, curriculum=curriculum)


def make(
    config: str | os.PathLike[str] = "fast", seed: int = 0, *, curriculum: Curriculum | None = None
) -> "LocomotionEnv":
    """A single environment: the first one of `make_vec`, without resets of its own."""
    return LocomotionEnv(config, seed, curriculum=curriculum)


class _Described:
    """What an environment's numbers are."""

    _native: _supple.Environments

    @property
    def observation_names(self) -> list[str]:
        """Name and unit of every number of an observation, before it is scaled."""
        return self._native.observation_names()

    @property
    def observation_offset(self) -> NDArray[np.float64]:
        """Subtracted from each of them, shape (length,)."""
        return self._native.observation_scaling()[0]

    @property
    def observation_scale(self) -> NDArray[np.float64]:
        """What each is multiplied with after that, shape (length,)."""
        return self._native.observation_scaling()[1]

    @property
    def action_names(self) -> list[str]:
        """Names of the joints."""
        return self._native.action_names()

    @property
    def curriculum(self) -> Curriculum:
        """Of episodes that start now. Setting it holds for those that start from then on, and after `reset(seed=…)`."""
        return Curriculum(*self._native.curriculum())

    @curriculum.setter
    def curriculum(self, curriculum: Curriculum) -> None:
        self._native.set_curriculum(Curriculum(*curriculum))

    def _spaces(self) -> "tuple[spaces.Space[Observations], spaces.Space[NDArray[np.float32]]]":
        limit = self._native.observation_scaling()[2].astype(np.float32)
        low, high = self._native.action_bounds()
        return spaces.Box(-limit, limit, dtype=np.float32), spaces.Box(low, high, dtype=np.float32)


class LocomotionVectorEnv(_Described, VectorEnv[Observations, NDArray[np.float32], NDArray[Any]]):
    """Environments that are stepped together. One whose episode ends goes on with its next one in the same step."""

    def __init__(
        self,
        config: str | os.PathLike[str] = "fast",
        num_envs: int = 64,
        seed: int = 0,
        threads: int | None = None,
        *,
        curriculum: Curriculum | None = None,
    ) -> None:
        self._native = _supple.Environments(os.fspath(config), num_envs, seed, _cores(threads), curriculum)
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = self._spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = {
            "autoreset_mode": AutoresetMode.SAME_STEP,
            "render_modes": [],
            "render_fps": self._native.rate_hz(),
        }
        self._all = np.ones(num_envs, dtype=np.bool_)
        self._all.flags.writeable = False
        self._terms = self._native.term_names()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Info]:
        """Starts new episodes: the first ones of `seed`, or the next ones."""
        super().reset(seed=seed)
        _no_options(options)
        observations, commands = self._native.reset(seed)
        return observations, {"command": commands, "_command": self._all}

    def step(
        self, actions: ArrayLike
    ) -> tuple[Observations, NDArray[np.float64], Flags, Flags, Info]:
        """One policy step. docs/python.md lists what is in the info."""
        actions = np.ascontiguousarray(actions, dtype=np.float32)
        seen, rewards, terminations, truncations, terms, stages, commands, ended = self._native.step(actions, True)
        info: Info = {
            "reward_terms": self._by_term(terms),
            "stage": stages,
            "command": commands,
            "fall": terminations.copy(),
            "_reward_terms": self._all,
            "_stage": self._all,
            "_command": self._all,
            "_fall": self._all,
        }
        if ended is not None:
            self._tell_of_ends(info, *ended)
        return seen, rewards, terminations, truncations, info

    def close_extras(self, **_: Any) -> None:
        """Frees the environments."""
        self._native.close()

    def _by_term(self, terms: NDArray[np.float64]) -> Info:
        found: Info = {}
        for k, name in enumerate(self._terms):
            found[name], found[f"_{name}"] = terms[:, k], self._all
        return found

    def _tell_of_ends(
        self,
        info: Info,
        which: NDArray[np.int64],
        observations: Observations,
        returns: NDArray[np.float64],
        lengths: NDArray[np.int64],
        pushed: Flags,
        faults: list[tuple[int, str]],
    ) -> None:
        mask = np.zeros(self.num_envs, dtype=np.bool_)
        mask[which] = True

        def spread(values: NDArray[Any]) -> NDArray[Any]:
            whole = np.zeros(self.num_envs, dtype=values.dtype)
            whole[which] = values
            return whole

        final = np.full(self.num_envs, None, dtype=object)
        for index, observation in zip(which, observations):
            final[index] = observation
        episode = {"r": spread(returns), "l": spread(lengths), "_r": mask, "_l": mask}
        about: Info = {"episode": episode, "_episode": mask, "pushed": spread(pushed), "_pushed": mask}
        if faults:
            about["fault"], about["_fault"] = np.full(self.num_envs, None, dtype=object), np.zeros_like(mask)
            for index, words in faults:
                about["fault"][index], about["_fault"][index] = words, True
        info.update(final_obs=final, _final_obs=mask, final_info=about, _final_info=mask)


class LocomotionEnv(_Described, gymnasium.Env[Observations, NDArray[np.float32]]):
    """A single environment, for checkers, and for code that resets by itself."""

    def __init__(
        self, config: str | os.PathLike[str] = "fast", seed: int = 0, *, curriculum: Curriculum | None = None
    ) -> None:
        self._native = _supple.Environments(os.fspath(config), 1, seed, 1, curriculum)
        self.observation_space, self.action_space = self._spaces()
        self.metadata = {"render_modes": [], "render_fps": self._native.rate_hz()}
        self._terms = self._native.term_names()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Info]:
        """Starts a new episode: the first one of `seed`, or the next one."""
        super().reset(seed=seed)
        _no_options(options)
        observations, commands = self._native.reset(seed)
        return observations[0], {"command": commands[0]}

    def step(self, action: ArrayLike) -> tuple[Observations, float, bool, bool, Info]:
        """One policy step."""
        actions = np.ascontiguousarray(action, dtype=np.float32)[None]
        seen, rewards, terminations, truncations, terms, stages, commands, ended = self._native.step(actions, False)
        info: Info = {
            "reward_terms": dict(zip(self._terms, terms[0].tolist())),
            "stage": int(stages[0]),
            "command": commands[0],
            "fall": bool(terminations[0]),
        }
        if ended is not None:
            _, _, returns, lengths, pushed, faults = ended
            info["episode"] = {"r": float(returns[0]), "l": int(lengths[0])}
            info["pushed"] = bool(pushed[0])
            info.update({"fault": words for _, words in faults})
        return seen[0], float(rewards[0]), bool(terminations[0]), bool(truncations[0]), info

    def close(self) -> None:
        """Frees the environment."""
        self._native.close()


def _cores(threads: int | None) -> int:
    if threads is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if threads < 1:
        raise ValueError(f"threads is {threads}, expected at least 1")
    return threads


def _no_options(options: dict[str, Any] | None) -> None:
    if options:
        raise ValueError(f"there are no options to reset with, found {sorted(options)}")


gymnasium.register(
    "supple/Locomotion-v0", entry_point="supple.environment:make", vector_entry_point="supple.environment:make_vec"
)
