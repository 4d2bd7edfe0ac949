"""The environments for Stable-Baselines3.

    import supple.sb3            # not by `import supple` alone
    from stable_baselines3 import PPO
    model = PPO("MlpPolicy", supple.sb3.SB3VecEnv(supple.make_vec("fast")))
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from .environment import LocomotionVectorEnv

Indices = None | int | Iterable[int]


class SB3VecEnv(VecEnv):  # type: ignore[misc]
    """A `LocomotionVectorEnv` with the interface of Stable-Baselines3's `VecEnv`.

    `env` is the wrapped environment and `info` the Gymnasium info of its last step or reset; the infos that `step` returns, one for
    each environment, only have the keys of a finished episode. A fault of the physics is in `info["final_info"]["fault"]`.
    """

    def __init__(self, env: LocomotionVectorEnv) -> None:
        if not isinstance(env, LocomotionVectorEnv) or env.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            raise TypeError(f"env is {env!r}, expected what supple.make_vec makes, with its own autoreset_mode")
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._actions: NDArray[np.float32] | None = None
        self.info: dict[str, Any] = {}

    def reset(self) -> NDArray[np.float32]:
        """Starts new episodes: the first ones of the seed given to `seed`, if it was called, else the next ones."""
        seed, options = self._seeds[0], self._options[0]
        self._reset_seeds()
        self._reset_options()
        observations, self.info = self.env.reset(seed=seed, options=options)
        self.reset_infos = [{"command": command} for command in self.info["command"]]
        return observations

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Sets one seed for all environments, each of which has its own random streams."""
        self._seeds = [seed] * self.num_envs
        return self._seeds

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Stores the actions, float32 (num_envs, 12), for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Steps with the stored actions: observations, rewards, dones (num_envs,), and an info for each environment."""
        if self._actions is None:
            raise RuntimeError("there are no actions to step with: call step_async() first")
        actions, self._actions = self._actions, None
        observations, rewards, terminations, truncations, self.info = self.env.step(actions)
        info = self.info
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if "final_obs" in info:
            episode = info["final_info"]["episode"]
            for k in np.flatnonzero(info["_final_obs"]):
                infos[k] = {
                    "terminal_observation": info["final_obs"][k],
                    "TimeLimit.truncated": bool(truncations[k]),
                    "episode": {"r": float(episode["r"][k]), "l": int(episode["l"][k])},
                }
        return observations, rewards.astype(np.float32), terminations | truncations, infos

    def close(self) -> None:
        """Frees the environments."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Returns the attribute of the one object that holds all environments, once for each index."""
        return [getattr(self.env, attr_name)] * len(self._chosen(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Sets the attribute for all environments at once, which are one object."""
        if indices is not None:
            raise ValueError(f"{attr_name} can only be set for all environments at once: leave out the indices")
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
        """Raises: there are no objects for single environments."""
        raise NotImplementedError(f"there are no single environments to call {method_name} of; `env` has them all")

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Indices = None) -> list[bool]:
        """Single environments are never wrapped."""
        return [False] * len(self._chosen(indices))

    def _chosen(self, indices: Indices) -> list[int]:
        return list(self._get_indices(indices))
