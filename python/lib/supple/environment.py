"""The training environments behind Gymnasium's interfaces.

An observation is what the networks see: float32, each number (value - offset) * scale. An action is a number for each joint:
joint target = offset + scale * action.
"""

import os
import secrets
from collections.abc import Sequence
from typing import Any, NamedTuple, NoReturn

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from . import _supple
from .given import cores, numbers, whole
from .named import Named

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
    """Fraction of the largest force of sustained pulls, 0 to 1; for configurations with `pulls`."""


def make_vec(
    config: str | os.PathLike[str] = "fast",
    num_envs: int = 64,
    seed: int | None = None,
    threads: int | None = None,
    *,
    curriculum: Curriculum | None = None,
    stagger: bool = True,
    autoreset_mode: AutoresetMode = AutoresetMode.SAME_STEP,
) -> "LocomotionVectorEnv":
    """Environments of a configuration, by name or file.

    A seed is drawn if none is given. `threads` step them: all cores if it is left out. A `curriculum` stays as it is given;
    without one it is that of training, which gets harder as walking gets better. `stagger` cuts each first episode at
    random, so that not all environments are in the same phase. `autoreset_mode` says when the next episode begins: in the
    step that ends one, in the step after it, or when `reset` is called.
    """
    return LocomotionVectorEnv(
        config, num_envs, seed, threads, curriculum=curriculum, stagger=stagger, autoreset_mode=autoreset_mode
    )


def make(
    config: str | os.PathLike[str] = "fast", seed: int | None = None, *, curriculum: Curriculum | None = None
) -> "LocomotionEnv":
    """A single environment: the first one of `make_vec`, without stagger and without resets of its own."""
    return LocomotionEnv(config, seed, curriculum=curriculum)


class _Described(Named):
    """What an environment's numbers are."""

    _native: _supple.Environments

    def __init__(
        self,
        config: str | os.PathLike[str],
        num_envs: int,
        seed: int | None,
        threads: int | None,
        curriculum: Curriculum | None,
        stagger: bool,
        autoreset_mode: AutoresetMode,
    ) -> None:
        self._native = _supple.Environments(
            os.fspath(config),
            whole("num_envs", num_envs, 1, 1_000_000),
            secrets.randbits(64) if seed is None else whole("seed", seed),
            cores(threads),
            stagger,
            AutoresetMode(autoreset_mode).value,
        )
        if curriculum is not None:
            self.curriculum = curriculum
        self._terms = self._native.term_names()

    @property
    def observation_offset(self) -> NDArray[np.float64]:
        """Subtracted from each of them, shape (length,)."""
        return self._native.observation_scaling()[0]

    @property
    def observation_scale(self) -> NDArray[np.float64]:
        """What each is multiplied with after that, shape (length,)."""
        return self._native.observation_scaling()[1]

    @property
    def curriculum(self) -> Curriculum:
        """Of episodes that start now. Setting it holds for those that start from then on, for good, as with
        `make_vec(curriculum=…)`."""
        return Curriculum(*self._native.curriculum())

    @curriculum.setter
    def curriculum(self, curriculum: Curriculum) -> None:
        self._native.set_curriculum(Curriculum(*curriculum))

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "environments cannot be pickled or copied: call supple.make_vec in the process that is to step them"
        )

    def _spaces(self) -> "tuple[spaces.Space[Observations], spaces.Space[NDArray[np.float32]]]":
        limit = self._native.observation_scaling()[2].astype(np.float32)
        low, high = self._native.action_bounds()
        return spaces.Box(-limit, limit, dtype=np.float32), spaces.Box(low, high, dtype=np.float32)


class LocomotionVectorEnv(_Described, VectorEnv[Observations, NDArray[np.float32], NDArray[Any]]):
    """Environments that are stepped together. docs/python.md lists what is in their infos."""

    def __init__(
        self,
        config: str | os.PathLike[str] = "fast",
        num_envs: int = 64,
        seed: int | None = None,
        threads: int | None = None,
        *,
        curriculum: Curriculum | None = None,
        stagger: bool = True,
        autoreset_mode: AutoresetMode = AutoresetMode.SAME_STEP,
    ) -> None:
        super().__init__(config, num_envs, seed, threads, curriculum, stagger, autoreset_mode)
        self.num_envs = int(num_envs)
        self.single_observation_space, self.single_action_space = self._spaces()
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._mode = AutoresetMode(autoreset_mode)
        self.metadata = {"autoreset_mode": self._mode, "render_modes": [], "render_fps": self._native.rate_hz()}
        self._all = np.ones(self.num_envs, dtype=np.bool_)
        self._all.flags.writeable = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Info]:
        """Starts new episodes: the first ones of `seed`, or the next ones. Where nothing resets by itself,
        `options["reset_mask"]`, shape (num_envs,), can say which environments start one."""
        seed = None if seed is None else whole("seed", seed)
        mask = self._mask(seed, options)
        VectorEnv.reset(self, seed=seed)
        observations, commands = self._native.reset(seed, mask)
        return observations, {"command": commands, "_command": self._all}

    def step(self, actions: ArrayLike) -> tuple[Observations, NDArray[np.float64], Flags, Flags, Info]:
        """One policy step."""
        actions = numbers("actions", actions, (self.num_envs, len(self._native.action_names())))
        seen, rewards, terminations, truncations, terms, stages, commands, ended = self._native.step(actions)
        info = self._info(terms, stages, commands, terminations, self._all)
        if ended is not None:
            which, last_seen, last_commands, returns, lengths, pushed, faults = ended
            mask = np.zeros(self.num_envs, dtype=np.bool_)
            mask[which] = True
            about: Info = {"pushed": self._spread(which, pushed), "_pushed": mask}
            if faults:
                at, words = zip(*faults)
                about["fault"] = self._spread(np.array(at), words)
                about["_fault"] = about["fault"] != None  # noqa: E711
            if self._mode is AutoresetMode.SAME_STEP:
                episode = {"r": self._spread(which, returns), "l": self._spread(which, lengths), "_r": mask, "_l": mask}
                final = self._info(terms, stages, self._spread(which, last_commands), terminations, mask)
                info["final_info"] = {**final, "episode": episode, "_episode": mask, **about}
                info["final_obs"] = self._spread(which, list(last_seen))
                info["_final_info"] = info["_final_obs"] = mask
            else:
                info.update(about)
        return seen, rewards, terminations, truncations, info

    def close_extras(self, **_: Any) -> None:
        """Frees the environments."""
        self._native.close()

    def _mask(self, seed: int | None, options: dict[str, Any] | None) -> list[bool] | None:
        if not options:
            return None
        if list(options) != ["reset_mask"] or self._mode is not AutoresetMode.DISABLED or seed is not None:
            raise ValueError(
                f"options to reset with: expected none, or with autoreset_mode DISABLED and without a seed a reset_mask, "
                f"found {list(options)}"
            )
        mask = np.asarray(options["reset_mask"])
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(
                f"reset_mask: expected {self.num_envs} truth values, not all of them false, found {mask.tolist()}"
            )
        chosen: list[bool] = mask.tolist()
        return chosen

    def _info(
        self,
        terms: NDArray[np.float64],
        stages: NDArray[np.int8],
        commands: NDArray[np.float64],
        falls: Flags,
        mask: Flags,
    ) -> Info:
        by_term: Info = {}
        for k, name in enumerate(self._terms):
            by_term[name], by_term[f"_{name}"] = terms[:, k], mask
        return {
            "reward_terms": by_term,
            "stage": stages,
            "command": commands,
            "fall": falls.copy(),
            "_reward_terms": mask,
            "_stage": mask,
            "_command": mask,
            "_fall": mask,
        }

    def _spread(self, which: NDArray[np.int64], values: NDArray[Any] | Sequence[Any]) -> NDArray[Any]:
        """Values of some environments among all of them: zeros elsewhere, or None between objects."""
        if isinstance(values, np.ndarray):
            whole = np.zeros((self.num_envs, *values.shape[1:]), dtype=values.dtype)
            whole[which] = values
            return whole
        objects = np.full(self.num_envs, None, dtype=object)
        for index, value in zip(which, values):
            objects[index] = value
        return objects


class LocomotionEnv(_Described, gymnasium.Env[Observations, NDArray[np.float32]]):
    """A single environment, for checkers, and for code that resets by itself."""

    def __init__(
        self, config: str | os.PathLike[str] = "fast", seed: int | None = None, *, curriculum: Curriculum | None = None
    ) -> None:
        super().__init__(config, 1, seed, 1, curriculum, False, AutoresetMode.DISABLED)
        self.observation_space, self.action_space = self._spaces()
        self.metadata = {"render_modes": [], "render_fps": self._native.rate_hz()}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Info]:
        """Starts a new episode: the first one of `seed`, or the next one."""
        seed = None if seed is None else whole("seed", seed)
        if options:
            raise ValueError(f"options to reset with: expected none, found {list(options)}")
        gymnasium.Env.reset(self, seed=seed)
        observations, commands = self._native.reset(seed, None)
        return observations[0], {"command": commands[0]}

    def step(self, action: ArrayLike) -> tuple[Observations, float, bool, bool, Info]:
        """One policy step."""
        actions = numbers("action", action, (len(self._native.action_names()),))[None]
        seen, rewards, terminations, truncations, terms, stages, commands, ended = self._native.step(actions)
        info: Info = {
            "reward_terms": dict(zip(self._terms, terms[0].tolist())),
            "stage": int(stages[0]),
            "command": commands[0],
            "fall": bool(terminations[0]),
        }
        if ended is not None:
            *_, pushed, faults = ended
            info["pushed"] = bool(pushed[0])
            info.update({"fault": words for _, words in faults})
        return seen[0], float(rewards[0]), bool(terminations[0]), bool(truncations[0]), info

    def close(self) -> None:
        """Frees the environment."""
        self._native.close()


gymnasium.register(
    "supple/Locomotion-v0", entry_point="supple.environment:make", vector_entry_point="supple.environment:make_vec"
)
