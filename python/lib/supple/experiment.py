"""The experiments of the paper, with any policy."""

import os
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import _supple
from .given import cores, whole
from .policy import Function, Policy, resolve
from .scenario import estimated

ENDS = ("upright", "fell", "fault", "out_of_reach")


class Experiment(NamedTuple):
    """What an experiment measured."""

    conditions: list[str]
    """What was varied."""
    quantities: list[str]
    """What was measured, each with its unit at the end of its name; fractions are 0 to 1."""
    values: NDArray[np.float64]
    """Shape (conditions, trials, quantities); NaN where a trial does not define one."""
    ends: NDArray[np.str_]
    """How each trial ended, shape (conditions, trials): upright, fell, fault, or out_of_reach (the commanded compliance is out of the policy's range)."""

    def mean(self, quantity: str) -> NDArray[np.float64]:
        """Mean over the trials that define the quantity, for each condition; NaN if there are none."""
        if quantity not in self.quantities:
            raise ValueError(f"no quantity {quantity!r}; there are: {', '.join(self.quantities)}")
        values = self.values[:, :, self.quantities.index(quantity)]
        known = ~np.isnan(values)
        with np.errstate(invalid="ignore"):
            means: NDArray[np.float64] = np.where(known, values, 0.0).sum(axis=1) / known.sum(axis=1)
        return means


def evaluate(
    policy: Policy | Function | str | os.PathLike[str],
    experiments: Iterable[str] | None = None,
    *,
    protocol: str | os.PathLike[str] = "quick",
    seed: int | None = None,
    config: str | os.PathLike[str] | None = None,
    sensing: str = "true",
    threads: int | None = None,
) -> dict[str, Experiment]:
    """Measures experiments with a policy, all of them if none is named; results by name.

    `protocol` is "quick", "full", or a YAML file with what differs from the full one. Trials are those that the program
    `evaluate` plays with a policy of this training seed: measure two policies with the same `seed`, and their trials are
    pairs. It is that of the policy, or 0. `threads` play them: all cores if it is left out. A function is called on the
    thread that calls this, and sees what the environment of `config` observes, `fast` if it is left out.
    """
    native = resolve(policy, config)
    if isinstance(experiments, str):
        experiments = [experiments]
    measured = _supple.evaluate(
        native,
        None if experiments is None else list(experiments),
        os.fspath(protocol),
        (native.seed or 0) if seed is None else whole("seed", seed),
        estimated(sensing),
        cores(threads),
    )
    return {
        name: Experiment(conditions, quantities, values, np.array(ENDS)[ends])
        for name, conditions, quantities, values, ends in measured
    }


def experiments() -> dict[str, str]:
    """What each experiment is about, by name."""
    return dict(_supple.experiments())
