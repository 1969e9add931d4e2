"""Estimates T of a noisy plane by least squares with the true V, to compare with the method `unified`."""

from __future__ import annotations

import argparse
import math
import statistics
import tempfile
from pathlib import Path

import numpy as np
from scipy import ndimage

from images import read_field, read_grey
from program import Parfocal
from similarity import Similarity

STEP_PX2 = 0.1
"""Step between the computed blurs of an image. Blurs between them are interpolated."""
BORDER_PX = 10
"""Excluded border: the largest blur, 4 px², reaches 6 px, and the displacement is 2 px."""
STEPS = 4
"""Gauss-Newton steps from the true T."""


def blurred(image: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Blurs each pixel by a Gaussian of its variance, px²."""
    count = math.ceil(variance.max() / STEP_PX2) + 2
    stack = np.array([ndimage.gaussian_filter(image, math.sqrt(n * STEP_PX2), truncate=6) for n in range(count)])
    below = (variance / STEP_PX2).astype(int)
    share = variance / STEP_PX2 - below
    rows, columns = np.indices(image.shape)
    return (1 - share) * stack[below, rows, columns] + share * stack[below + 1, rows, columns]


def registered(i1: np.ndarray, i2: np.ndarray, blur: np.ndarray, start: Similarity) -> Similarity:
    """Estimates T by least squares of the difference between the sharper image, blurred by V, and the other image."""
    height, width = i1.shape
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    y, x = np.indices(i1.shape, dtype=float)
    x, y = x - centre[0], y - centre[1]
    spline = ndimage.spline_filter(i2.astype(float), order=3)
    first = blurred(i1.astype(float), np.abs(blur))
    inside = np.zeros(i1.shape, bool)
    inside[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    inside &= np.abs(blur) > STEP_PX2  # smaller blurs cannot be distinguished from no blur
    found = start
    for _ in range(STEPS):
        a, b = found.linear()[:, 0]
        places = [b * x + a * y + found.ty_px + centre[1], a * x - b * y + found.tx_px + centre[0]]
        second = ndimage.map_coordinates(spline, places, order=3, prefilter=False, mode="mirror")
        second_blurred = blurred(second, np.abs(blur))
        residual = np.where(blur > 0, first - second, second_blurred - i1)
        down, right = np.gradient(np.where(blur > 0, -second, second_blurred))
        slopes = np.stack([right, down, right * x + down * y, down * x - right * y], -1)[inside]
        tx, ty, da, db = -np.linalg.lstsq(slopes, residual[inside], rcond=None)[0]
        a, b = a + da, b + db
        found = Similarity(found.tx_px + tx, found.ty_px + ty, math.degrees(math.atan2(b, a)), math.hypot(a, b))
    return found


def corners(program: Parfocal, noise: float, seed: int, out: Path) -> tuple[float, float]:
    """Returns the corner errors of one plane, px: with the true V, and by the unified method."""
    truth = program.simulate(["plane", "--noise", str(noise), "--seed", str(seed)], out)
    pair = (out / "i1.png", out / "i2.png")
    i1, i2 = map(read_grey, pair)
    size = (i1.shape[1], i1.shape[0])
    with_true_v = registered(i1, i2, read_field(out / "relative_blur.exr"), truth)
    unified = program.solve(pair, out / "solved", "unified", ["--decode", "none", "--no-html"])
    return with_true_v.corner_distance(truth, size), unified.transform.corner_distance(truth, size)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parfocal", type=Path, required=True, help="the program")
    parser.add_argument("--seeds", type=int, default=5, help="pairs of each noise")
    arguments = parser.parse_args()
    program = Parfocal(arguments.parfocal)
    print("| noise | true V: median corner, px | unified |\n| --- | --- | --- |")
    for noise in (0.003, 0.01, 0.03):
        with tempfile.TemporaryDirectory() as folder:
            found = [corners(program, noise, seed, Path(folder) / str(seed)) for seed in range(1, arguments.seeds + 1)]
        with_true_v, unified = (statistics.median(column) for column in zip(*found, strict=True))
        print(f"| {noise} | {with_true_v:.4f} | {unified:.4f} |", flush=True)


if __name__ == "__main__":
    main()
