"""Statistics of repeated readings: median, spread, and ratios within a round."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Spread:
    """The median, minimum and maximum of samples in their unit, and the samples in order."""

    median: float
    min: float
    max: float
    samples: list[float]

    @classmethod
    def of(cls, samples: Sequence[float]) -> Spread | None:
        """Returns None without samples."""
        if not samples:
            return None
        return cls(statistics.median(samples), min(samples), max(samples), list(samples))


def ratios(samples: Sequence[float], reference: Sequence[float]) -> Spread | None:
    """Returns the ratios by round, so that a load on a whole round cancels. Both have the same rounds, or none."""
    if not samples or not reference:
        return None
    return Spread.of([a / b for a, b in zip(samples, reference, strict=True)])


def sweep_rates(pixels: int, sweeps: int, fewer: Sequence[float], more: Sequence[float]) -> Spread | None:
    """Returns the Mpx-sweeps/s of a relaxation. Runs of `more` (ms) do `sweeps` more sweeps of all pixels.

    All other work cancels. A round in which `more` was not slower than `fewer` is excluded.
    """
    gained = [b - a for a, b in zip(fewer, more, strict=True)]
    return Spread.of([pixels * sweeps / ms / 1000 for ms in gained if ms > 0])
