"""Checks of arguments. Errors name the argument, what was expected and what was found."""

import operator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _supple


def whole(name: str, value: Any, least: int = 0, most: int = 2**64 - 1) -> int:
    """Returns a whole number of Python or NumPy, if it is within the range."""
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or not least <= number <= most:
        raise ValueError(f"{name} is {value!r}, expected a whole number from {least} to {most}")
    return number


def cores(threads: int | None) -> int:
    """Returns the requested number of threads, by default the number of cores that the process may use, quotas included."""
    if threads is None:
        return _supple.cores()
    return whole("threads", threads, 1, 10_000)


def numbers(name: str, values: ArrayLike, *shapes: tuple[int | None, ...]) -> NDArray[np.float32]:
    """Returns float32 values, if they are finite and have one of the shapes; None in a shape stands for any length."""
    expected = " or ".join("[" + ", ".join("n" if n is None else str(n) for n in shape) + "]" for shape in shapes)
    try:
        found = np.asarray(values, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: expected numbers of shape {expected}, found {type(values).__name__}: {error}") from error
    if not any(_fits(found.shape, shape) for shape in shapes):
        raise ValueError(f"{name}: expected numbers of shape {expected}, found shape {list(found.shape)}")
    if not np.isfinite(found).all():
        index = np.argwhere(~np.isfinite(found))[0].tolist()
        raise ValueError(f"{name}: expected finite numbers, found {found[tuple(index)]} at {index}")
    return np.ascontiguousarray(found)


def _fits(found: tuple[int, ...], shape: tuple[int | None, ...]) -> bool:
    return len(found) == len(shape) and all(n is None or n == k for k, n in zip(found, shape))
