"""What is timed: parfocal's methods and OpenCV's, each as one call that gives one reading of a pair."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

import registration
from images import read_grey
from program import Parfocal

FIXED_POINT = 5
SOR = 5
"""OpenCV's defaults for VariationalRefinement, stated since its sweeps are counted by them."""
MORE_SOR = 25


@dataclass(frozen=True)
class Reading:
    """One run, from images in memory to results in memory; of parfocal also where it ran and how fast it relaxed."""

    ms: float
    device: str | None = None
    mpx_sweeps_per_s: float | None = None


@dataclass(frozen=True)
class System:
    """A name, what one run of it leaves one with, and the run."""

    name: str
    delivers: str
    measure: Callable[[], Reading]


ECC = "OpenCV ECC affine"
REFINEMENT = f"OpenCV VariationalRefinement {FIXED_POINT} x {SOR}"
MORE_REFINEMENT = f"OpenCV VariationalRefinement {FIXED_POINT} x {MORE_SOR}"


def systems(parfocal: Parfocal, pair: tuple[Path, Path], truth: Path | None) -> list[System]:
    """All of them, on one pair; each reads the same pixels."""
    grey = [read_grey(path) for path in pair]
    return [*ours(parfocal, pair, truth), *registrations(*grey), *flows(*map(_in_bytes, grey))]


def ours(parfocal: Parfocal, pair: tuple[Path, Path], truth: Path | None) -> list[System]:
    """A process a reading, which warms up before it is timed; starting it and reading files are no part of the time."""

    def measure(method: str) -> Reading:
        report = parfocal.bench(pair, method, truth)
        run = report["runs"][0]
        relaxation = run["relaxation"] or {}  # null where the device has no clock
        return Reading(run["solve_ms"]["median"], report["device"]["name"], relaxation.get("mpx_sweeps_per_s"))

    def system(method: str, delivers: str) -> System:
        return System(f"parfocal {method}", delivers, lambda: measure(method))

    return [
        system("unified", "registration (similarity), depth (V, confidence), photometry (gain, offset), fused image"),
        system("aligned", "depth, photometry, fused image; no registration"),
    ]


def registrations(i1: np.ndarray, i2: np.ndarray) -> list[System]:
    """ECC and SIFT of `registration`, on float32 in 0 to 1; what they reduce to bytes they reduce in their time."""

    def system(
        name: str, register: Callable[[np.ndarray, np.ndarray], object], delivers: str = "registration (affine)"
    ) -> System:
        return System(name, delivers, lambda: _timed(lambda: register(i1, i2)))

    return [
        system(ECC, registration.ecc_default),
        system(f"{ECC}, pyramid", registration.ecc),
        system("OpenCV ECC MultiScale", registration.ecc_multi_scale_default),
        system("OpenCV ECC MultiScale, converged", registration.ecc_multi_scale),
        system("OpenCV SIFT", registration.sift, "registration (similarity)"),
    ]


def flows(i1: np.ndarray, i2: np.ndarray) -> list[System]:
    """Two displacements at each pixel, on bytes."""

    def refinement(name: str, sor: int) -> System:
        refine = cv2.VariationalRefinement_create()
        refine.setFixedPointIterations(FIXED_POINT)
        refine.setSorIterations(sor)

        def measure() -> Reading:
            flow = np.zeros((*i1.shape, 2), dtype=np.float32)  # read and written in place: each run starts from none
            return _timed(lambda: refine.calc(i1, i2, flow))

        return System(name, "flow (one level, from zero)", measure)

    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    return [
        refinement(REFINEMENT, SOR),
        refinement(MORE_REFINEMENT, MORE_SOR),
        System("OpenCV DIS medium", "flow", lambda: _timed(lambda: dis.calc(i1, i2, None))),
    ]


def _timed(call: Callable[[], object]) -> Reading:
    start = time.perf_counter()
    try:
        call()
    except cv2.error as e:
        raise registration.Failed(e.err) from e
    return Reading(1000 * (time.perf_counter() - start))


def _in_bytes(image: np.ndarray) -> np.ndarray:
    return np.rint(255 * image).astype(np.uint8)
