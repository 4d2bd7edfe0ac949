"""Scenarios: what disturbs a robot, and what comes of it."""

import json
import os
import warnings
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import _supple
from .given import whole
from .policy import Function, Policy, resolve


class Event(NamedTuple):
    """Something worth a line."""

    time_s: float
    kind: str
    """disturbance, fall, success or fault."""
    text: str


class Run(NamedTuple):
    """What came of a scenario."""

    metrics: dict[str, float | None]
    """Numbers by name, with their unit at the end; None where the run does not define one."""
    units: dict[str, str]
    """Of the metrics."""
    trace: dict[str, NDArray[Any]]
    """By name, one row for each policy step; numbers, and truth values for contacts."""
    events: list[Event]
    """In order of time."""

    @property
    def fell(self) -> bool:
        """Whether the robot fell."""
        return any(event.kind == "fall" for event in self.events)

    @property
    def fault(self) -> str | None:
        """What failed, if the physics or the sensors did and ended the run."""
        return next((event.text for event in self.events if event.kind == "fault"), None)


def run_scenario(
    name: str,
    policy: Policy | Function | str | os.PathLike[str] = "compliant",
    seed: int = 0,
    *,
    config: str | os.PathLike[str] | None = None,
    sensing: str = "true",
    record: str | os.PathLike[str] | None = None,
    **parameters: float | str | bool,
) -> Run:
    """Plays a scenario with a policy: a Policy, the name of one, a PyTorch module, or any function from an observation,
    shape (length,), to an action, shape (joints,).

    A function sees what the environment of `config` observes, `fast` if it is left out. `sensing` is "true", or "estimated": noisy sensors.
    `parameters` are those of the scenario, see `scenarios()`. `record` names an .rrd file for the rerun viewer.
    """
    if record is not None and not _supple.RECORDS:
        raise RuntimeError(
            "this wheel was built without recordings: pip install ./python -C build-args=--features=record"
        )
    metrics, trace, events, note = _supple.run_scenario(
        name,
        resolve(policy, config),
        whole("seed", seed),
        estimated(sensing),
        json.dumps(parameters, default=_plain),
        None if record is None else os.fspath(record),
    )
    if note is not None:
        warnings.warn(note, stacklevel=2)
    return Run(
        metrics={name: value for name, value, _ in metrics},
        units={name: unit for name, _, unit in metrics},
        trace=trace,
        events=[Event(*event) for event in events],
    )


def scenarios() -> dict[str, str]:
    """The default parameters of every scenario, as YAML with comments, by name."""
    return dict(_supple.scenarios())


def estimated(sensing: str) -> bool:
    """Whether the policy acts on sensors."""
    if sensing not in ("true", "estimated"):
        raise ValueError(f"sensing is {sensing!r}, expected 'true' or 'estimated'")
    return sensing == "estimated"


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise ValueError(f"a parameter is {value!r}, expected a number, a text, or True or False")
