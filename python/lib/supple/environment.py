"""The training environments as Gymnasium environments.

An observation is the networks' input: float32, each number (value - offset) * scale. An action has one number for each joint:
joint target [rad] = offset + scale * action.
"""

import os
import secrets
from collections.abc import Sequence
from typing import Any, NamedTuple, NoReturn

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from . import _supple
from .given import cores, numbers, whole
from .named import Named

STAGES = ("walking", "recovery", "post-recovery")
"""Names of the stages, by the index in `info["stage"]`."""

UNDRAWN = (
    "these environments draw nothing: supple.run_scenario(…, record=\"walk.rrd\") writes a recording of a policy for the rerun "
    "viewer"
)
"""The end of errors about pictures: what to use instead."""

Observations = NDArray[np.float32]
Flags = NDArray[np.bool_]
Info = dict[str, Any]


class Curriculum(NamedTuple):
    """The difficulty of new episodes: range of commands, pushes, pulls."""

    command_fraction: float
    """Fraction of the command range that commands are drawn from, 0 to 1."""
    pushes: bool
    """True if the robot is pushed, and goes through the stages that follow the push."""
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
    render_mode: None = None,
) -> "LocomotionVectorEnv":
    """Creates `num_envs` environments of a configuration that are stepped together.

    `config` is a name, such as "fast", or the path of a YAML file. Without a `seed`, one is drawn. `threads` defaults to all
    cores; results do not depend on it. A given `curriculum` stays fixed; without one, it grows as in training. `stagger`
    cuts each first episode at random, so that the environments are not all in the same phase. `autoreset_mode` selects when
    the next episode begins: in the step that ends one (`SAME_STEP`), in the step after it (`NEXT_STEP`), or when `reset` is
    called (`DISABLED`). Nothing is drawn, so `render_mode` is None.

    Observations are float32, shape (num_envs, length), normalised, with 83 numbers in "fast"; actions are
    float32, shape (num_envs, 12). `observation_names` has names and units, `action_names` the joints.
    """
    undrawn(render_mode)
    return LocomotionVectorEnv(
        config, num_envs, seed, threads, curriculum=curriculum, stagger=stagger, autoreset_mode=autoreset_mode
    )


def make(
    config: str | os.PathLike[str] = "fast",
    seed: int | None = None,
    *,
    curriculum: Curriculum | None = None,
    render_mode: None = None,
) -> "LocomotionEnv":
    """Creates a single environment: the first one of `make_vec`, without stagger and without automatic resets. To train, use
    `make_vec`: several of these each have a curriculum of their own, which advances by their own samples.

    Observations are float32, shape (length,), normalised; actions are float32, shape (12,), one for each joint.
    Nothing is drawn, so `render_mode` is None.
    """
    undrawn(render_mode)
    return LocomotionEnv(config, seed, curriculum=curriculum)


def undrawn(render_mode: Any) -> None:
    """Refuses every render mode but None."""
    if render_mode is not None:
        raise ValueError(f"render_mode is {render_mode!r}, expected None: {UNDRAWN}")


class _Described(Named):
    """Descriptions of observations and actions, and the curriculum."""

    _native: _supple.Environments
    _np_random: np.random.Generator | None
    _np_random_seed: int | None

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
        seed = secrets.randbits(64) if seed is None else whole("seed", seed)
        self._np_random, self._np_random_seed = seeding.np_random(seed)
        self._native = _supple.Environments(
            os.fspath(config),
            whole("num_envs", num_envs, 1, 1_000_000),
            seed,
            cores(threads),
            stagger,
            AutoresetMode(autoreset_mode).value,
        )
        if curriculum is not None:
            self.curriculum = curriculum
        self._terms = self._native.term_names()

    @property
    def observation_offset(self) -> NDArray[np.float64]:
        """Offset subtracted from each value of an observation, in its unit, shape (length,)."""
        return self._native.observation_scaling()[0]

    @property
    def observation_scale(self) -> NDArray[np.float64]:
        """Factor applied to each value after the offset is subtracted, shape (length,)."""
        return self._native.observation_scaling()[1]

    @property
    def critic_observation_names(self) -> list[str]:
        """Name and unit of each value that a critic may observe in addition; empty without `critic_observation`."""
        return self._native.critic_observation_names()

    @property
    def curriculum(self) -> Curriculum:
        """Curriculum of episodes that start now. Once set, it stays fixed, as with `make_vec(curriculum=…)`."""
        return Curriculum(*self._native.curriculum())

    @curriculum.setter
    def curriculum(self, curriculum: Curriculum) -> None:
        self._native.set_curriculum(Curriculum(*curriculum))

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "environments cannot be pickled or copied: call supple.make_vec in the process that is to step them"
        )

    def render(self) -> NoReturn:
        """Raises: nothing is drawn."""
        raise NotImplementedError(UNDRAWN)

    def _spaces(self) -> "tuple[spaces.Space[Observations], spaces.Space[NDArray[np.float32]]]":
        limit = self._native.observation_scaling()[2].astype(np.float32)
        low, high = self._native.action_bounds()
        return spaces.Box(-limit, limit, dtype=np.float32), spaces.Box(low, high, dtype=np.float32)


class LocomotionVectorEnv(_Described, VectorEnv[Observations, NDArray[np.float32], NDArray[Any]]):
    """Environments that are stepped together; `make_vec` creates them. docs/python.md lists the keys of their infos."""

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

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Info]:
        """Starts new episodes: with a `seed` the first ones of that seed, else the next ones. A sequence has a seed for each
        environment, whose random streams also differ by its index.

        Returns observations, float32 (num_envs, length), normalised, and `info` with `command`, float64 (num_envs, 3):
        forward, left [m/s], yaw rate [rad/s]. A seed also resets the curriculum. With autoreset mode `DISABLED`,
        `options["reset_mask"]`, bool (num_envs,), selects the environments that start a new episode.
        """
        seeds = self._seeds(seed)
        mask = self._mask(seeds, options)
        VectorEnv.reset(self, seed=None if seeds is None else seeds[0])
        observations, critic, commands = self._native.reset(seeds, mask)
        info: Info = {"command": commands, "_command": self._all}
        if critic is not None:
            info["critic_observation"], info["_critic_observation"] = critic, self._all
        return observations, info

    def step(self, actions: ArrayLike) -> tuple[Observations, NDArray[np.float64], Flags, Flags, Info]:
        """Steps every environment once (1/60 s with the shipped configurations).

        `actions` has shape (num_envs, 12): joint target = `action_offset` + `action_scale` * action [rad]. Returns
        observations, float32 (num_envs, length), normalised; rewards, float64 (num_envs,); terminations (a fall) and
        truncations (a time limit, or a fault of the physics), bool (num_envs,); and `info`.

        **A fault of the physics is reported as a truncation** with a reward of 0. `info["fault"]` then holds MuJoCo's
        message for each environment that failed, else None; with `SAME_STEP`, the default autoreset mode, it is in
        `info["final_info"]["fault"]`. The key is missing in a step without faults. Leave such a step out of what you learn
        from, or bootstrap: the last observation is the one before it.

        `info` also has `reward_terms` (before weights), `stage` (index into `STAGES`), `command` (forward, left [m/s],
        yaw rate [rad/s]; base frame) and `fall`, and with the key `critic_observation` of the configuration the numbers of that
        name, float32 (num_envs, m), which only a critic may observe, in addition to the observation; docs/python.md lists all keys with their shapes.
        """
        actions = numbers("actions", actions, (self.num_envs, len(self._native.action_names())))
        seen, critic, rewards, terminations, truncations, terms, stages, commands, ended = self._native.step(actions)
        info = self._info(terms, stages, commands, terminations, self._all)
        if critic is not None:
            info["critic_observation"], info["_critic_observation"] = critic, self._all
        if ended is not None:
            which, last_seen, last_critic, last_commands, returns, lengths, pushed, faults = ended
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
                if last_critic is not None:
                    final["critic_observation"] = self._spread(which, last_critic)
                    final["_critic_observation"] = mask
                info["final_info"] = {**final, "episode": episode, "_episode": mask, **about}
                info["final_obs"] = self._spread(which, list(last_seen))
                info["_final_info"] = info["_final_obs"] = mask
            else:
                info.update(about)
        return seen, rewards, terminations, truncations, info

    def close_extras(self, **_: Any) -> None:
        """Frees the environments."""
        # Gymnasium 1.2 also closes what could not be created.
        if hasattr(self, "_native"):
            self._native.close()

    def _seeds(self, seed: int | Sequence[int] | None) -> list[int] | None:
        """Returns a seed for each environment."""
        if seed is None:
            return None
        if not isinstance(seed, (Sequence, np.ndarray)):
            return [whole("seed", seed)] * self.num_envs
        if len(seed) != self.num_envs or isinstance(seed, (str, bytes)):
            raise ValueError(f"seed: expected a whole number or one for each of {self.num_envs} environments, found {seed!r}")
        return [whole(f"seed[{index}]", value) for index, value in enumerate(seed)]

    def _mask(self, seeds: list[int] | None, options: dict[str, Any] | None) -> list[bool] | None:
        if not options:
            return None
        if list(options) != ["reset_mask"] or self._mode is not AutoresetMode.DISABLED or seeds is not None:
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
        """Returns an array for all environments: the values at the indices `which`, zeros (None for objects) elsewhere."""
        if isinstance(values, np.ndarray):
            whole = np.zeros((self.num_envs, *values.shape[1:]), dtype=values.dtype)
            whole[which] = values
            return whole
        objects = np.full(self.num_envs, None, dtype=object)
        for index, value in zip(which, values):
            objects[index] = value
        return objects


class LocomotionEnv(_Described, gymnasium.Env[Observations, NDArray[np.float32]]):
    """A single environment, for environment checkers and for code that calls `reset` itself."""

    def __init__(
        self, config: str | os.PathLike[str] = "fast", seed: int | None = None, *, curriculum: Curriculum | None = None
    ) -> None:
        super().__init__(config, 1, seed, 1, curriculum, False, AutoresetMode.DISABLED)
        self.observation_space, self.action_space = self._spaces()
        self.metadata = {"render_modes": [], "render_fps": self._native.rate_hz()}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Info]:
        """Starts a new episode: with a `seed` the first one of that seed, else the next one.

        Returns the observation, float32 (length,), normalised, and `info` with `command`: forward, left [m/s], yaw rate
        [rad/s].
        """
        seed = None if seed is None else whole("seed", seed)
        if options:
            raise ValueError(f"options to reset with: expected none, found {list(options)}")
        gymnasium.Env.reset(self, seed=seed)
        observations, critic, commands = self._native.reset(None if seed is None else [seed], None)
        info: Info = {"command": commands[0]}
        if critic is not None:
            info["critic_observation"] = critic[0]
        return observations[0], info

    def step(self, action: ArrayLike) -> tuple[Observations, float, bool, bool, Info]:
        """Steps the environment once (1/60 s with the shipped configurations).

        `action` has shape (12,): joint target = `action_offset` + `action_scale` * action [rad]. Returns the observation,
        float32 (length,), normalised; the reward; terminated (a fall); truncated (a time limit, or a fault of the physics);
        and `info`.

        **A fault of the physics is reported as a truncation** with a reward of 0; `info["fault"]` then holds MuJoCo's
        message, and the observation is the one before the step. The key is missing otherwise.
        """
        actions = numbers("action", action, (len(self._native.action_names()),))[None]
        seen, critic, rewards, terminations, truncations, terms, stages, commands, ended = self._native.step(actions)
        info: Info = {
            "reward_terms": dict(zip(self._terms, terms[0].tolist())),
            "stage": int(stages[0]),
            "command": commands[0],
            "fall": bool(terminations[0]),
        }
        if critic is not None:
            info["critic_observation"] = critic[0]
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
