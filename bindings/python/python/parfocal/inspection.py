"""Inspects parts against a golden part: frames in, a verdict out, no files.

    parts = [inspection.Part.of(parfocal.solve(near, far)) for near, far in good]
    golden = inspection.teach(parts)
    for serial, (near, far) in line:
        verdict = golden.inspect(inspection.Part.of(parfocal.solve(near, far)), serial=serial)
        print(serial, verdict.verdict, verdict.reasons, verdict.seconds)

Parts lie in place: nothing is registered. Heights grow towards the camera.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._results import Result

__all__ = ["Golden", "Inspection", "Limits", "Part", "teach"]

Field = NDArray[np.float32]


@dataclass(frozen=True)
class Limits:
    """The limits of an inspection besides the tolerance.

    sigmas: the number of standard deviations that a difference must exceed.
    min_area: the smallest area of a deviating region, px.
    max_unjudged: the largest fraction of the golden part's pixels that may stay without a judgement.
    max_tilt: the largest tilt of the part over the picture, in the unit of the heights; None: ten tolerances.
    """

    sigmas: float = 3
    min_area: int = 50
    max_unjudged: float = 0.25
    max_tilt: float | None = None


@dataclass(frozen=True, eq=False)
class Part:
    """The heights of a part with standard deviations and evidence; NaN where there is none."""

    values: Field
    """Heights, greater towards the camera."""
    deviation: Field
    """Standard deviations, without those that all parts have in common."""
    evidence: Field
    """The standard deviation of the picture's texture over that of its noise; infinite where it is not known."""
    faults: tuple[str, ...] = ()
    """Why the part cannot be judged, one sentence each."""
    started: float | None = None
    """`time.monotonic()` when its photographs were complete, from which the time of a verdict counts."""
    spread: float = 1.0

    @property
    def part_deviation(self) -> Field:
        return self.deviation

    @classmethod
    def of(cls, result: Result, nearer: int = 1, started: float | None = None) -> Part:
        """Takes V, px², of a solved pair. `nearer` is the photograph that is focused nearer to the camera, 1 or 2.

        Raises ValueError if the pair was solved with fused=False.
        """
        if result.fused is None:
            raise ValueError("the fused image shows which heights have texture: solve with fused=True")
        picture = result.fused if result.fused.ndim == 2 else result.fused.mean(2, dtype=np.float32)
        scale = result.scale_deviation * result.relative_blur
        deviation = np.sqrt(np.maximum(np.square(result.uncertainty) - np.square(scale), 0)).astype(np.float32)
        values = result.relative_blur if nearer == 1 else -result.relative_blur
        faults = () if result.converged else ("its solve had not converged: " + "; ".join(result.warnings),)
        return cls(values, deviation, _native.evidence(picture, result.residual), faults, started)


@dataclass(frozen=True, eq=False)
class Inspection:
    """The verdict of a part."""

    verdict: str
    """"go", "no-go" or "cannot-judge"."""
    reasons: list[str]
    """Reasons for any verdict but go, one sentence each."""
    report: dict[str, Any]
    """All numbers, as in inspect.json."""
    difference: Field
    """The part minus the golden part and the plane; NaN where not judged."""
    seconds: float
    """Time from `Part.started`, or from the call, to the verdict, s."""


@dataclass(frozen=True, eq=False)
class Golden:
    """A golden part, taught from good ones."""

    values: Field
    deviation: Field
    part_deviation: Field
    evidence: Field
    spread: float
    tolerance: float
    """The allowed difference of heights, as stated or suggested."""
    least_tolerances: list[float]
    """For each good part the tolerance at which it is go against the others; infinite if there is none."""
    limits: Limits = field(default_factory=Limits)

    def inspect(self, part: Part, serial: str = "", tolerance: float | None = None) -> Inspection:
        """Judges a part. A tolerance may be stated if it is not less than the taught one."""
        began = time.monotonic() if part.started is None else part.started
        tolerance = self.tolerance if tolerance is None else tolerance
        if not tolerance >= self.tolerance:
            raise ValueError(f"tolerance {tolerance} is less than the taught {self.tolerance}: teach again with it")
        stamp = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
        text, difference = _native.inspect([part, self], self.limits, tolerance, [serial, stamp], list(part.faults))
        report = json.loads(text)
        return Inspection(report["verdict"], report["reasons"], report, difference, time.monotonic() - began)


def teach(parts: Sequence[Part], tolerance: float | None = None, limits: Limits | None = None) -> Golden:
    """Teaches a golden part from good parts of one size, three or more. Without a tolerance one is suggested.

    Raises ValueError if a part had not converged, is go at no tolerance, or disagrees with the others.
    """
    limits = limits or Limits()
    for n, part in enumerate(parts):
        if part.faults:
            raise ValueError(f"good part {n}: {part.faults[0]}")
    fields, spread, found, least, disagreeing = _native.teach(list(parts), limits, tolerance)
    if not np.all(np.isfinite(least)):
        n = int(np.argmax(least))
        raise ValueError(f"good part {n} is go against the others at no tolerance: leave it out, or take it again")
    if disagreeing is not None:
        n, (x, y), extreme = disagreeing
        raise ValueError(f"good part {n} disagrees with the others at {x:.0f},{y:.0f} by {extreme:+.4g}: leave it out")
    return Golden(*fields, spread, found, least, limits)
