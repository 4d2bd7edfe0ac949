"""Scenarios: disturbances of a robot, and how its policy reacts."""

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
    """An event of a playback, at a simulation time [s]."""

    time_s: float
    kind: str
    """Kind of the event: disturbance, fall, success or fault."""
    text: str


class Run(NamedTuple):
    """The result of a playback."""

    metrics: dict[str, float | None]
    """Metrics by name, whose end is the unit; None where the playback does not define one."""
    units: dict[str, str]
    """Units of the metrics, by name."""
    trace: dict[str, NDArray[Any]]
    """Arrays by name, one row for each policy step (1/60 s), SI units; docs/python.md lists names and frames."""
    events: list[Event]
    """Events in order of time."""

    @property
    def fell(self) -> bool | None:
        """True if the robot fell; None if a fault ended the playback before."""
        if any(event.kind == "fall" for event in self.events):
            return True
        return None if self.fault is not None else False

    @property
    def fault(self) -> str | None:
        """Message of the fault of policy, physics or sensors that ended the playback; None if there was none."""
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
    """Plays a scenario with a policy and returns metrics, trace and events.

    `policy` is a Policy, the name of one, a PyTorch module, or any function from a normalised observation, float32 (length,),
    to an action, shape (12,). A function gets the observations of the environment of `config`, by default "fast". With
    `sensing="estimated"` the policy acts on a state estimated from noisy sensors, with "true" on the true state.
    `parameters` override those of the scenario, in the units of their names: `push_m_s=0.75`; `scenarios()` lists them.
    `record` is the path of an .rrd file to write for the rerun viewer.
    """
    if record is not None and not _supple.RECORDS:
        raise RuntimeError(
            "this wheel was built without recordings: pip install ./python --config-settings build-args=--features=record"
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
    """Returns the default parameters of every scenario by name, as YAML text with comments and units."""
    return dict(_supple.scenarios())


def estimated(sensing: str) -> bool:
    """Returns True if the policy acts on a state estimated from sensors."""
    if sensing not in ("true", "estimated"):
        raise ValueError(f"sensing is {sensing!r}, expected 'true' or 'estimated'")
    return sensing == "estimated"


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise ValueError(f"a parameter is {value!r}, expected a number, a text, or True or False")
