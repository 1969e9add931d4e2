"""The timed systems: methods of parfocal and OpenCV. Each call times one run on a pair."""

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
"""Defaults of OpenCV for VariationalRefinement. They are explicit because the number of sweeps follows from them."""
MORE_SOR = 25


@dataclass(frozen=True)
class Reading:
    """The time of one run, from images in memory to results in memory. For parfocal also device and relaxation rate."""

    ms: float
    device: str | None = None
    mpx_sweeps_per_s: float | None = None


@dataclass(frozen=True)
class System:
    """A name, the results of a run, and the function that times a run."""

    name: str
    delivers: str
    measure: Callable[[], Reading]


ECC = "OpenCV ECC affine"
REFINEMENT = f"OpenCV VariationalRefinement {FIXED_POINT} x {SOR}"
MORE_REFINEMENT = f"OpenCV VariationalRefinement {FIXED_POINT} x {MORE_SOR}"


def systems(parfocal: Parfocal, pair: tuple[Path, Path], truth: Path | None) -> list[System]:
    """Returns all systems on one pair. All read the same pixels."""
    grey = [read_grey(path) for path in pair]
    return [*ours(parfocal, pair, truth), *registrations(*grey), *flows(*map(_in_bytes, grey))]


def ours(parfocal: Parfocal, pair: tuple[Path, Path], truth: Path | None) -> list[System]:
    """Returns the methods of parfocal. A reading is a new process; its time excludes start, file reading, warm-up."""

    def measure(method: str) -> Reading:
        report = parfocal.bench(pair, method, truth)
        run = report["runs"][0]
        relaxation = run["relaxation"] or {}  # null if the device has no timestamps
        return Reading(run["solve_ms"]["median"], report["device"]["name"], relaxation.get("mpx_sweeps_per_s"))

    def system(method: str, delivers: str) -> System:
        return System(f"parfocal {method}", delivers, lambda: measure(method))

    return [
        system("unified", "registration (similarity), depth (V, confidence), photometry (gain, offset), fused image"),
        system("aligned", "depth, photometry, fused image; no registration"),
    ]


def registrations(i1: np.ndarray, i2: np.ndarray) -> list[System]:
    """Returns ECC and SIFT of `registration`, on float32 in 0 to 1. Their time includes a conversion to bytes."""

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
    """Returns the optical flow methods: two displacements per pixel, on bytes."""

    def refinement(name: str, sor: int) -> System:
        refine = cv2.VariationalRefinement_create()
        refine.setFixedPointIterations(FIXED_POINT)
        refine.setSorIterations(sor)

        def measure() -> Reading:
            flow = np.zeros((*i1.shape, 2), dtype=np.float32)  # updated in place, so each run starts from zero flow
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
