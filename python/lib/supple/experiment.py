"""The experiments of the paper, with any policy or set of policies."""

import glob
import json
import os
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, overload

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


class Comparison(NamedTuple):
    """The measurements of two sets of policies, and of others beside them. Tables are dicts of arrays of one length,
    as `pandas.DataFrame` and `polars.DataFrame` take them; NaN where there is no number."""

    claims: dict[str, NDArray[Any]]
    """One row for each claim: experiment, claim, paper, quantity, unit, verdict, NAME_mean and NAME_sd of each set, pairs of
    seeds, and the difference of the first set from the second with its interval of 95 %: difference, low, high."""
    numbers: dict[str, NDArray[Any]]
    """One row for each number of the tables: experiment, table, condition, quantity, unit, set, seed, value."""
    summary: dict[str, Any]
    """Everything, as in the file summary.json of a report."""


Path = str | os.PathLike[str]


@overload
def evaluate(
    policy: Policy | Function | Path,
    experiments: Iterable[str] | None = None,
    *,
    protocol: Path = "quick",
    seed: int | None = None,
    config: Path | None = None,
    sensing: str = "true",
    threads: int | None = None,
) -> dict[str, Experiment]: ...


@overload
def evaluate(
    policy: None = None,
    experiments: Iterable[str] | None = None,
    *,
    a: Path,
    b: Path,
    also: Mapping[str, Path] = {},
    protocol: Path = "quick",
    sensing: str = "true",
    threads: int | None = None,
    out: Path | None = None,
) -> Comparison: ...


def evaluate(
    policy: Policy | Function | Path | None = None,
    experiments: Iterable[str] | None = None,
    *,
    a: Path | None = None,
    b: Path | None = None,
    also: Mapping[str, Path] = {},
    protocol: Path = "quick",
    seed: int | None = None,
    config: Path | None = None,
    sensing: str = "true",
    threads: int | None = None,
    out: Path | None = None,
) -> dict[str, Experiment] | Comparison:
    """Measures a policy, or compares two sets of policies, in experiments, by default in all of them.

    `evaluate("compliant")` returns the trials of one policy by the name of the experiment. `seed` defaults to the training seed
    of the policy, or 0; two policies measured with the same `seed` are paired, trial by trial. A function is called on the
    thread that calls `evaluate`, with the observations of the environment of `config`, by default "fast".

    `evaluate(a="runs/fast", b="runs/mine")` compares two sets as the program `evaluate` does: a set is all seeds of a run, a
    folder, a file or a shipped policy's name. `also` names further sets, which stand beside them. Numbers are kept in the
    folder `out`, if one is given, and not measured again; the program makes the report of them (`evaluate --out`).

    `protocol` is "quick", "full", or the path of a YAML file with the differences from the full one; `threads` defaults to all
    cores. The trials are those of the program `evaluate`.
    """
    if isinstance(experiments, str):
        experiments = [experiments]
    if policy is None:
        if a is None or b is None:
            raise ValueError("give one policy, or two sets a and b")
        if seed is not None or config is not None:
            raise ValueError("seed and config are for one policy; sets have the seeds of their training")
        sets = {label(a): a, label(b): b} | dict(also)
        if len(sets) < 2 + len(also):
            raise ValueError(f"two sets have one name: {label(a)}, {label(b)}, {', '.join(also)}; rename a folder, or give one by `also`")
        with tempfile.TemporaryDirectory() as temporary:
            summary = _supple.compare(
                [(name, os.fspath(path)) for name, path in sets.items()],
                list(experiments or []),
                os.fspath(protocol),
                estimated(sensing),
                cores(threads),
                temporary if out is None else os.fspath(out),
            )
        return tables(json.loads(summary))
    if not (a is None and b is None and not also and out is None):
        raise ValueError("a, b, also and out are for sets of policies; give them, or one policy")
    native = resolve(policy, config)
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


def label(path: Path) -> str:
    """Returns the name of a set: that of its file or folder."""
    return os.path.basename(os.path.normpath(os.fspath(path))).removesuffix(".safetensors")


def tables(summary: dict[str, Any]) -> Comparison:
    """Returns the summary of a report with its claims and numbers as tables."""
    claims: dict[str, list[Any]] = defaultdict(list)
    numbers: dict[str, list[Any]] = defaultdict(list)
    for experiment in summary["experiments"]:
        name = experiment["name"]
        for claim in experiment["claims"]:
            ours, words = claim["ours"], ("claim", "paper", "quantity", "unit", "verdict")
            difference = ours["difference"] or {}
            low, high = difference.get("interval") or (None, None)
            row = {"experiment": name} | {word: claim[word] for word in words}
            row |= {f"{of}_{what}": found[what] for of, found in ours["sets"].items() for what in ("mean", "sd")}
            row |= {"pairs": difference.get("pairs", 0), "difference": difference.get("value"), "low": low, "high": high}
            for column, value in row.items():
                claims[column].append(value)
        for table, rows in experiment["tables"].items():
            for of in rows:
                for set_name, found in of["ours"]["sets"].items():
                    for seed, value in found["by_seed"].items():
                        cells = (name, table, of["condition"], of["quantity"], of["unit"], set_name, int(seed), value)
                        columns = ("experiment", "table", "condition", "quantity", "unit", "set", "seed", "value")
                        for column, cell in zip(columns, cells):
                            numbers[column].append(cell)
    return Comparison(arrays(claims), arrays(numbers), summary)


def arrays(columns: Mapping[str, list[Any]]) -> dict[str, NDArray[Any]]:
    """Returns columns as arrays, with NaN in place of None among numbers."""

    def array(cells: list[Any]) -> NDArray[Any]:
        is_text = any(isinstance(cell, str) for cell in cells)
        return np.array(["" if cell is None else cell for cell in cells] if is_text else [np.nan if cell is None else cell for cell in cells])

    return {name: array(cells) for name, cells in columns.items()}


def _seed(metrics: str) -> int | None:
    """Returns the seed in the name of the folder of a file of metrics, if there is one."""
    seed = os.path.dirname(metrics).rpartition("-seed")[2]
    return int(seed) if seed.isdecimal() else None


def learning_curves(run: Path) -> dict[int, dict[str, NDArray[Any]]]:
    """Returns the metrics of a run, or of all seeds of a set such as "runs/fast", by seed: arrays with one element for each
    iteration, such as "samples", "step_reward", "walking_linear" (r_lin of walking stages), "fall_rate" and "time.elapsed_s".
    NaN where an iteration lacks a number."""
    path = os.path.abspath(run)
    files = [os.path.join(path, "metrics.jsonl")]
    if not os.path.exists(files[0]):
        # Not of a folder such as `fast-seed0-old`.
        files = [file for file in glob.glob(f"{glob.escape(path)}-seed*/metrics.jsonl") if _seed(file) is not None]
    if not files:
        raise FileNotFoundError(f"{path}: no metrics.jsonl in it, and none in {path}-seed*")
    curves = {}
    for file in files:
        with open(file, encoding="utf-8") as lines:
            iterations = [flat(json.loads(line)) for line in lines if line.endswith("\n")]
        names = dict.fromkeys(name for iteration in iterations for name in iteration)
        columns = {name: [iteration.get(name) for iteration in iterations] for name in names}
        curves[_seed(file) or 0] = arrays(columns)
    return dict(sorted(curves.items()))


def flat(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Returns a mapping of mappings as one, whose keys are joined by dots."""
    found: dict[str, Any] = {}
    for key, value in nested.items():
        found |= flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {prefix + key: value}
    return found
