"""Policies, and networks as policies."""

import os
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _supple
from .given import numbers
from .named import Named

Function = Callable[[NDArray[np.float32]], Any]
"""A function from an observation, float32 (length,), normalised, to an action, shape (12,)."""


class Policy(Named):
    """A policy: a deterministic function from normalised observations to actions.

    Create one with `Policy.load`. Its observations are those of the environment of its configuration.
    """

    _native: _supple.Policy

    def __init__(self, native: _supple.Policy) -> None:
        self._native = native
        self._length = len(native.observation_names())

    @classmethod
    def load(cls, name_or_path: str | os.PathLike[str]) -> "Policy":
        """Loads a shipped policy by name ("compliant"), a policy file, a run's folder, or the YAML file of an external policy."""
        return cls(_supple.Policy.load(os.fspath(name_or_path)))

    def __call__(self, observations: ArrayLike) -> NDArray[np.float32]:
        """Returns actions, float32 (n, 12), for normalised observations (n, length), or one action (12,) for one (length,).

        Joint target = `action_offset` + `action_scale` * action [rad], in the order of `action_names`. An external policy
        may have other observations and actions than the environments: the program `policy show` prints them.
        """
        seen = numbers(f"observations for {self.name}", observations, (self._length,), (None, self._length))
        actions = self._native.act(np.atleast_2d(seen))
        return actions if seen.ndim == 2 else actions[0]

    @property
    def name(self) -> str:
        """The name or path that was given to `load`."""
        return self._native.name

    @property
    def sha256(self) -> str:
        """SHA-256 of the policy's files, which identifies it."""
        return self._native.sha256

    @property
    def seed(self) -> int | None:
        """Seed of the training run; None for external policies and functions."""
        return self._native.seed

    def __repr__(self) -> str:
        return f"Policy({self.name!r})"


def describe(config: str | os.PathLike[str], onnx: str | os.PathLike[str]) -> str:
    """Returns the text of a YAML file that makes an ONNX network, trained in the environment of `config`, a policy for every
    program. `onnx` is the name of the ONNX file, beside which the YAML file is to be saved."""
    return _supple.describe(os.fspath(config), os.fspath(onnx))


def resolve(
    policy: "Policy | Function | str | os.PathLike[str]", config: str | os.PathLike[str] | None
) -> _supple.Policy:
    """Turns a policy, the name of one or a function into a native policy. `config` is for functions."""
    if isinstance(policy, (Policy, str, os.PathLike)):
        if config is not None:
            raise ValueError(f"config is {config!r}, but {policy!r} has a configuration of its own: leave config out")
        return policy._native if isinstance(policy, Policy) else _supple.Policy.load(os.fspath(policy))
    if not callable(policy):
        raise TypeError(f"policy is {policy!r}, expected a Policy, the name of one, or a function")
    function = _of_network(policy)
    joints = len(_supple.Environments.action_names())

    def act(observation: NDArray[np.float32]) -> NDArray[np.float32]:
        return numbers("the policy's answer", function(observation), (joints,), (1, joints)).reshape(-1)

    return _supple.Policy.of_function("fast" if config is None else os.fspath(config), act)


def _of_network(policy: Function) -> Function:
    """Wraps a PyTorch module, which takes tensors with a batch dimension, on its device; returns any other function unchanged."""
    torch: Any = sys.modules.get("torch")
    if torch is None or not isinstance(policy, torch.nn.Module):
        return policy
    weight = next(policy.parameters(), None)

    def act(observation: NDArray[np.float32]) -> Any:
        seen = torch.from_numpy(observation)[None]
        with torch.no_grad():
            return policy(seen if weight is None else seen.to(weight)).float().cpu().numpy()

    return act
