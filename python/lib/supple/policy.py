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
"""From an observation, shape (length,), to an action, shape (joints,)."""


class Policy(Named):
    """A policy that acts on observations as the environment of its configuration gives them.

    `Policy.load` finds it: a shipped one by name, a policy file, a run's folder, the YAML file of an external policy.
    """

    _native: _supple.Policy

    def __init__(self, native: _supple.Policy) -> None:
        self._native = native
        self._length = len(native.observation_names())

    @classmethod
    def load(cls, name_or_path: str | os.PathLike[str]) -> "Policy":
        """By name or path."""
        return cls(_supple.Policy.load(os.fspath(name_or_path)))

    def __call__(self, observations: ArrayLike) -> NDArray[np.float32]:
        """Actions, shape (n, joints), for observations of shape (n, length); or one for one of shape (length,).

        They are actions of an environment whose names, offsets and scales are those of this policy: not so for external
        policies that were trained elsewhere.
        """
        seen = numbers(f"observations for {self.name}", observations, (self._length,), (None, self._length))
        actions = self._native.act(np.atleast_2d(seen))
        return actions if seen.ndim == 2 else actions[0]

    @property
    def name(self) -> str:
        """As it was asked for."""
        return self._native.name

    @property
    def sha256(self) -> str:
        """Identity: the SHA-256 of its files."""
        return self._native.sha256

    @property
    def seed(self) -> int | None:
        """Seed of its training, if it is one of ours."""
        return self._native.seed

    def __repr__(self) -> str:
        return f"Policy({self.name!r})"


def describe(config: str | os.PathLike[str], onnx: str | os.PathLike[str]) -> str:
    """The YAML file that goes beside an ONNX file of a network that was trained in the environment of `config`: with it
    the network is a policy for every program. `onnx` is the file's name."""
    return _supple.describe(os.fspath(config), os.fspath(onnx))


def resolve(
    policy: "Policy | Function | str | os.PathLike[str]", config: str | os.PathLike[str] | None
) -> _supple.Policy:
    """Whatever can be asked to act, as a policy. `config` is for functions."""
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
    """A PyTorch module takes tensors with a batch dimension; everything else is taken at its word."""
    torch: Any = sys.modules.get("torch")
    if torch is None or not isinstance(policy, torch.nn.Module):
        return policy

    def act(observation: NDArray[np.float32]) -> Any:
        with torch.no_grad():
            return policy(torch.from_numpy(observation)[None]).cpu().numpy()

    return act
