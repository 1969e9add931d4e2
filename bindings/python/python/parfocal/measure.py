"""Levels, steps and profiles of a field: of relative blur, depth or focus, in its unit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native

__all__ = ["Estimate", "level", "profile", "step"]


class Estimate(NamedTuple):
    """A number and its standard error, in the unit of the field."""

    value: float
    standard_error: float


def _field(values: ArrayLike) -> NDArray[np.float32]:
    field = np.asarray(values, np.float32)
    if field.ndim != 2 or not field.size:
        raise ValueError(f"a field has two dimensions, not the shape {field.shape}")
    return field


def level(values: ArrayLike, region: Sequence[int]) -> Estimate | None:
    """The level of a region (x, y, width, height): the median without its tilt; None where less than 16 pixels are valid."""
    found = _native.level(_field(values), region)
    return found and Estimate(*found)


def step(values: ArrayLike, start: Sequence[int], end: Sequence[int]) -> Estimate | None:
    """How far the region `end` lies above `start`, the difference of their levels."""
    found = _native.step(_field(values), start, end)
    return found and Estimate(*found)


def profile(values: ArrayLike, start: Sequence[float], end: Sequence[float], width: float = 1) -> NDArray[np.float64]:
    """The values along a line from pixel (x, y) to pixel, each the mean over `width` px across; NaN where none is valid."""
    return _native.profile(_field(values), start, end, width)
