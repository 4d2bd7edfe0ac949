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
    """The measurements of an experiment."""

    conditions: list[str]
    """Labels of the conditions, such as the size of a push."""
    quantities: list[str]
    """Names of the measured quantities; the end of each is its unit, and fractions are 0 to 1."""
    values: NDArray[np.float64]
    """Measured values, shape (conditions, trials, quantities); NaN where a trial does not define one."""
    ends: NDArray[np.str_]
    """The end of each trial, shape (conditions, trials): upright, fell, fault, or out_of_reach (the commanded compliance is out of the policy's range)."""

    def mean(self, quantity: str) -> NDArray[np.float64]:
        """Returns the mean of a quantity over the trials that define it, shape (conditions,); NaN if there are none."""
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
    """Measures a policy in experiments, by default in all of them, and returns the results by name.

    `protocol` is "quick", "full", or the path of a YAML file with the differences from the full one. The trials are those
    of the program `evaluate`; two policies measured with the same `seed` are paired, trial by trial. `seed` defaults to the
    training seed of the policy, or 0; `threads` to all cores. A function is called on the thread that calls `evaluate`, with
    the observations of the environment of `config`, by default "fast".
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
    """Returns the title of each experiment by name."""
    return dict(_supple.experiments())
