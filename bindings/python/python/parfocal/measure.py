"""Measures levels, steps and profiles of a field (relative blur, depth or focus), in the unit of the field."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native

__all__ = ["Estimate", "level", "profile", "step"]


class Estimate(NamedTuple):
    """A value and its standard error, in the unit of the field."""

    value: float
    standard_error: float


def _field(values: ArrayLike) -> NDArray[np.float32]:
    field = np.asarray(values, np.float32)
    if field.ndim != 2 or not field.size:
        raise ValueError(f"a field has two dimensions; this array has the shape {field.shape}")
    return field


def level(values: ArrayLike, region: Sequence[int]) -> Estimate | None:
    """Returns the median of a region (x, y, width, height) after removing its tilt; None if fewer than 16 pixels are valid."""
    estimate = _native.level(_field(values), region)
    return estimate and Estimate(*estimate)


def step(values: ArrayLike, start: Sequence[int], end: Sequence[int]) -> Estimate | None:
    """Returns the level of the region `end` minus that of `start`."""
    estimate = _native.step(_field(values), start, end)
    return estimate and Estimate(*estimate)


def profile(values: ArrayLike, start: Sequence[float], end: Sequence[float], width: float = 1) -> NDArray[np.float64]:
    """Returns the values along a line between two pixels (x, y), each the mean over `width` px across; NaN where none is valid."""
    return _native.profile(_field(values), start, end, width)
