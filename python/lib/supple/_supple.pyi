from collections.abc import Callable
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "CONFIGURATIONS",
    "Environments",
    "POLICIES",
    "Policy",
    "RECORDS",
    "REVISION",
    "__version__",
    "_panic",
    "cores",
    "describe",
    "compare",
    "evaluate",
    "experiments",
    "run_scenario",
    "scenarios",
]

CONFIGURATIONS: list[str]
POLICIES: list[str]
RECORDS: bool
REVISION: str
__version__: str

@final
class Environments:
    """Training environments that are stepped together; n environments, observations of `length` numbers."""

    def __new__(
        cls,
        config: str,
        num_envs: int,
        seed: int,
        threads: int,
        stagger: bool,
        autoreset: str,
    ) -> Environments: ...
    def reset(
        self, seeds: list[int] | None, mask: list[bool] | None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None, NDArray[np.float64]]:
        """Returns observations (n, length), normalised, what the critic observes in addition (n, m), if it does, and commands
        (n, 3): forward, left [m/s], yaw rate [rad/s]."""
    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[
        NDArray[np.float32],
        NDArray[np.float32] | None,
        NDArray[np.float64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        NDArray[np.float64],
        NDArray[np.int8],
        NDArray[np.float64],
        tuple[
            NDArray[np.int64],
            NDArray[np.float32],
            NDArray[np.float32] | None,
            NDArray[np.float64],
            NDArray[np.float64],
            NDArray[np.int64],
            NDArray[np.bool_],
            list[tuple[int, str]],
        ]
        | None,
    ]:
        """Steps with actions (n, 12). Returns observations (n, length), what the critic observes in addition (n, m), rewards (n), terminations (n), truncations (n), reward
        terms (n, terms), stages (n), commands (n, 3), and for the k episodes that ended, if any: environments (k), last
        observations (k, length) and what the critic observes in addition (k, m), last commands (k, 3), returns (k), lengths [steps] (k), pushed (k), and the message of each
        physics fault with its environment. A physics fault is a truncation."""
    def close(self) -> None: ...
    def curriculum(self) -> tuple[float, bool, float]: ...
    def set_curriculum(self, curriculum: tuple[float, bool, float]) -> None: ...
    def observation_names(self) -> list[str]: ...
    def critic_observation_names(self) -> list[str]: ...
    def observation_scaling(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
    @staticmethod
    def action_names() -> list[str]: ...
    def action_scaling(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
    def action_bounds(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
    @staticmethod
    def term_names() -> list[str]: ...
    def rate_hz(self) -> int: ...

@final
class Policy:
    """A policy, deterministic."""

    @staticmethod
    def load(name: str) -> Policy: ...
    @staticmethod
    def of_function(
        config: str, function: Callable[[NDArray[np.float32]], NDArray[np.float32]]
    ) -> Policy: ...
    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Returns actions (n, 12) for normalised observations (n, length)."""
    @property
    def name(self) -> str: ...
    @property
    def sha256(self) -> str: ...
    @property
    def seed(self) -> int | None: ...
    def observation_names(self) -> list[str]: ...
    def action_names(self) -> list[str]: ...
    def action_scaling(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...

def run_scenario(
    name: str,
    policy: Policy,
    seed: int,
    estimated: bool,
    parameters: str,
    record: str | None,
) -> tuple[
    list[tuple[str, float | None, str]],
    dict[str, NDArray[Any]],
    list[tuple[float, str, str]],
    str | None,
]:
    """Returns metrics (name, value, unit), trace arrays (frames, …), events (time [s], kind, text), and a warning or None."""

def compare(
    sets: list[tuple[str, str]],
    experiments: list[str],
    protocol: str,
    estimated: bool,
    threads: int,
    out: str,
) -> str: ...
def evaluate(
    policy: Policy,
    experiments: list[str] | None,
    protocol: str,
    seed: int,
    estimated: bool,
    threads: int,
) -> list[
    tuple[
        str,
        list[str],
        list[str],
        NDArray[np.float64],
        NDArray[np.int8],
    ]
]:
    """Returns name, conditions, quantities, values (conditions, trials, quantities) and ends (conditions, trials)."""

def cores() -> int: ...
def describe(config: str, onnx: str) -> str: ...
def scenarios() -> list[tuple[str, str]]: ...
def experiments() -> list[tuple[str, str]]: ...
def _panic() -> None: ...
