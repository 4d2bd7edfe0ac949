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
    "_panic",
    "describe",
    "evaluate",
    "experiments",
    "run_scenario",
    "scenarios",
]

CONFIGURATIONS: list[str]
POLICIES: list[str]
RECORDS: bool
REVISION: str

@final
class Environments:
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
        self, seed: int | None, mask: list[bool] | None
    ) -> tuple[NDArray[np.float32], NDArray[np.float64]]: ...
    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[
        NDArray[np.float32],
        NDArray[np.float64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        NDArray[np.float64],
        NDArray[np.int8],
        NDArray[np.float64],
        tuple[
            NDArray[np.int64],
            NDArray[np.float32],
            NDArray[np.float64],
            NDArray[np.float64],
            NDArray[np.int64],
            NDArray[np.bool_],
            list[tuple[int, str]],
        ]
        | None,
    ]: ...
    def close(self) -> None: ...
    def curriculum(self) -> tuple[float, bool, float]: ...
    def set_curriculum(self, curriculum: tuple[float, bool, float]) -> None: ...
    def observation_names(self) -> list[str]: ...
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
    @staticmethod
    def load(name: str) -> Policy: ...
    @staticmethod
    def of_function(
        config: str, function: Callable[[NDArray[np.float32]], NDArray[np.float32]]
    ) -> Policy: ...
    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]: ...
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
]: ...
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
]: ...
def describe(config: str, onnx: str) -> str: ...
def scenarios() -> list[tuple[str, str]]: ...
def experiments() -> list[tuple[str, str]]: ...
def _panic() -> None: ...
