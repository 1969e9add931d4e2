"""Repeated readings: their median, how far they scatter, and what follows from readings taken in the same round."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Spread:
    """Median, least and largest of some samples, in their unit, and the samples themselves in order."""

    median: float
    min: float
    max: float
    samples: list[float]

    @classmethod
    def of(cls, samples: Sequence[float]) -> Spread | None:
        """None where there are none."""
        if not samples:
            return None
        return cls(statistics.median(samples), min(samples), max(samples), list(samples))


def ratios(samples: Sequence[float], reference: Sequence[float]) -> Spread | None:
    """Round by round, one over the other: what slows a whole round cancels. Both hold the same rounds, or none."""
    if not samples or not reference:
        return None
    return Spread.of([a / b for a, b in zip(samples, reference, strict=True)])


def sweep_rates(pixels: int, sweeps: int, fewer: Sequence[float], more: Sequence[float]) -> Spread | None:
    """Mpx-sweeps/s of a relaxation alone: `more` (ms) makes so many sweeps of all pixels beyond those of `fewer`.

    What both do besides cancels. A round in which the longer one was no slower says nothing and is left out.
    """
    gained = [b - a for a, b in zip(fewer, more, strict=True)]
    return Spread.of([pixels * sweeps / ms / 1000 for ms in gained if ms > 0])
